"""DecoupleGS: 3D Gaussian Splatting for driving simulation.

>>> import decouplegs
>>> session = decouplegs.Session()
>>> scene = session.open_scene("street/scene.toml")
>>> world, renderer = decouplegs.World(scene), session.batch_renderer()
>>> world.set_time(1.0)
>>> images = renderer.draw([(world, scene.cameras(1.0))])[0]  # uint8 [C, H, W, 4]

Units are meters, seconds and radians. World: z up. Vehicle and agent: x forward, y left, z up. Camera: OpenCV (x right, y down,
z forward). Poses are float64 [4, 4] matrices that take points of the second frame of their name into the first
(``world_from_camera``); a rotation that is not orthonormal within 1e-6 is a ValueError.

Sessions, scenes, worlds and renderers may be used from several threads; the interpreter's lock is released while something is drawn or
loaded. ``decouplegs.gym`` has Gymnasium environments over the closed loop.
"""

from ._native import (
    Agent,
    Camera,
    Device,
    DeviceError,
    Error,
    FileError,
    Images,
    Lidar,
    RigCamera,
    Rollout,
    RolloutEgo,
    Scene,
    Session,
    Site,
    Statistics,
    Tensor,
    TooManyHeldError,
    BatchRenderer,
    World,
    __version__,
    devices,
    save_png,
)

__all__ = [
    "Agent",
    "Camera",
    "Device",
    "DeviceError",
    "Error",
    "FileError",
    "Images",
    "Lidar",
    "RigCamera",
    "Rollout",
    "RolloutEgo",
    "Scene",
    "Session",
    "Site",
    "Statistics",
    "Tensor",
    "TooManyHeldError",
    "BatchRenderer",
    "World",
    "__version__",
    "devices",
    "save_png",
]
