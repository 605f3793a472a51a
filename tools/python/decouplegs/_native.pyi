"""The native part of the package: sessions, scenes, worlds, renderers, images and rollouts."""

import os
from collections.abc import Sequence
from typing import Any, Generic, Literal, TypedDict, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray
from typing_extensions import TypeVar

__version__: str

PlaneName = Literal["depth", "instance", "range", "normal", "flow_forward", "flow_backward", "scene_flow", "depth_median", "range_median"]
LayerName = Literal["color", "depth", "instance", "range", "normal", "flow_forward", "flow_backward", "scene_flow", "depth_median", "range_median"]

# Type of an image's numbers: np.uint8 of a session with color="u8", np.float32 with color="f32".
Color = TypeVar("Color", np.uint8, np.float32, default=np.uint8)

class Error(RuntimeError):
    """What the engine could not do. The base of the others."""

class DeviceError(Error):
    """No such device, a device that was lost, or one without the memory or the means."""

class FileError(Error):
    """A file that is missing or wrong; the message names it and what was expected."""

class TooManyHeldError(Error):
    """As many frames are held on the device as ``taken_max`` allows: drop some tensors."""

def devices() -> list[Device]:
    """All Vulkan devices of this machine."""

def save_png(path: str | os.PathLike[str], image: NDArray[np.uint8]) -> None:
    """Writes an image, uint8 [H, W, 3] or [H, W, 4], to a PNG file: red, green and blue. It is there whole or not at all, and replaces one that was there."""

class Device:
    """A Vulkan device."""

    @property
    def index(self) -> int:
        """Its index in devices(), which Session takes."""
    @property
    def name(self) -> str:
        """Name of the device."""
    @property
    def driver(self) -> str:
        """Name and version of its driver."""
    @property
    def kind(self) -> Literal["discrete", "integrated", "virtual", "cpu", "other"]:
        """Kind of hardware."""
    @property
    def uuid(self) -> str:
        """``uuid:`` and 32 hexadecimal digits: the same in every process, and CUDA's of the same device."""
    @property
    def memory_bytes(self) -> int:
        """Size of its largest heap, bytes."""
    @property
    def api_version(self) -> tuple[int, int, int]:
        """Highest Vulkan version that it offers."""

class Camera:
    """A camera in the world."""

    def __init__(
        self,
        width: int,
        height: int,
        K: ArrayLike,
        world_from_camera: ArrayLike,
        name: str = "camera",
        *,
        lens: dict[str, Any] | None = None,
        shutter: dict[str, Any] | None = None,
        photometry: dict[str, Any] | None = None,
        windshield: dict[str, Any] | None = None,
    ) -> None:
        """A camera of ``width`` by ``height`` pixels.

        K: float64 [3, 3], pixels, ``[[fx, 0, cx], [0, fy, cy], [0, 0, 1]]``; pixel (i, j) has its center at (i + 0.5, j + 0.5).
        world_from_camera: float64 [4, 4], meters, OpenCV axes.
        lens, shutter, photometry, windshield: what the tables of these names hold in a scene file's [[rig]] (engine/asset/scene-file.md), such
        as ``{"model": "opencv-fisheye", "radial": [0.1, -0.02]}``. None: a pinhole, a global shutter, colors as they are, no windshield.
        """
    @staticmethod
    def from_description(description: str | dict[str, Any]) -> Camera:
        """The camera that a dictionary, JSON or TOML describes by the keys of a scene file's [[rig]]; position_m, and rotation_wxyz or look, are in the world.

        width_px, height_px and fx_px are needed. A camera without the others is a pinhole at the origin that looks along z.
        """
    @property
    def description(self) -> dict[str, Any]:
        """What from_description makes the same camera of, at rest."""
    @staticmethod
    def look_at(
        eye: Sequence[float],
        target: Sequence[float],
        up: Sequence[float] = (0.0, 0.0, 1.0),
        *,
        size: tuple[int, int] = (1280, 720),
        fov_deg: float = 60.0,
        name: str = "camera",
    ) -> Camera:
        """A pinhole at eye that looks at target, meters, with ``up`` up in its image of ``size`` = (width, height) pixels; fov_deg is its horizontal field of view."""
    @property
    def name(self) -> str:
        """Name of its image."""
    @property
    def width(self) -> int:
        """Width, pixels."""
    @property
    def height(self) -> int:
        """Height, pixels."""
    @property
    def K(self) -> NDArray[np.float64]:
        """Intrinsics, float64 [3, 3], pixels."""
    @property
    def world_from_camera(self) -> NDArray[np.float64]:
        """Pose in the world, float64 [4, 4], meters."""
    def with_shutter(self, direction: Literal["global", "top_to_bottom", "bottom_to_top", "left_to_right", "right_to_left"], readout_s: float, start: ArrayLike, end: ArrayLike) -> Camera:
        """The same camera in motion with such a shutter; start and end are world_from_camera at both ends of the readout, float64 [4, 4], meters."""
    def with_photometry(
        self,
        *,
        exposure_ev: float = 0.0,
        curve: Literal["display", "linear"] = "display",
        vignetting: tuple[Sequence[float], Sequence[float], ArrayLike] | None = None,
        balance: ArrayLike | None = None,
        matrix: ArrayLike | None = None,
        gamma: Sequence[float] | None = None,
        response: ArrayLike | None = None,
    ) -> Camera:
        """The same camera with a photometric calibration, whose stages come in this order: exposure in stops; vignetting: center [2] and radius [2], pixels, and coefficients of r^2, r^4 and r^6 [3, 3]; balance [3, 3], a homography of red, green and the sum of all three; color matrix [3, 4]; exponents [3]; response [4, 3]: exponents below and above the center, exponents of the whole, and the center."""

class RigCamera:
    """A camera fixed to a vehicle."""

    def __init__(self, name: str, width: int, height: int, K: ArrayLike, rig_from_camera: ArrayLike) -> None:
        """As Camera; rig_from_camera, float64 [4, 4], meters, is where it sits on the vehicle."""
    @staticmethod
    def from_description(description: str | dict[str, Any]) -> RigCamera:
        """The camera that a dictionary, JSON or TOML describes by the keys of a scene file's [[rig]], lens and shutter included, on the vehicle."""
    @property
    def description(self) -> dict[str, Any]:
        """What from_description makes the same camera of."""
    @property
    def name(self) -> str:
        """Name of its image."""
    @property
    def width(self) -> int:
        """Width, pixels."""
    @property
    def height(self) -> int:
        """Height, pixels."""
    @property
    def K(self) -> NDArray[np.float64]:
        """Intrinsics, float64 [3, 3], pixels."""
    @property
    def rig_from_camera(self) -> NDArray[np.float64]:
        """Where it sits on the vehicle, float64 [4, 4], meters."""
    def resized(self, width: int, height: int) -> RigCamera:
        """The same view in another number of pixels."""
    def at(self, world_from_rig: ArrayLike, *, velocity: Sequence[float] = (0.0, 0.0, 0.0), turn: Sequence[float] = (0.0, 0.0, 0.0)) -> Camera:
        """The camera in the world, of a vehicle that is at world_from_rig, float64 [4, 4], meters. A rolling shutter sees its motion: velocity, m/s along the axes of the world, and turn, rad/s about those of the vehicle."""

class Lidar:
    """A LiDAR fixed to a vehicle. Frame: x forward, y left, z up."""

    def __init__(self, sensor: str | os.PathLike[str], rig_from_lidar: ArrayLike | None = None, name: str | None = None) -> None:
        """sensor: a model that comes with the program, such as ``pandar128``, or a file (.toml, NCore .json). rig_from_lidar, float64
        [4, 4], meters, is where it sits on the vehicle; None: on the roof of a car."""
    @property
    def name(self) -> str:
        """Name of its sweep."""
    @property
    def sensor(self) -> str:
        """Name of the model."""
    @property
    def rings(self) -> int:
        """Rows, counted from the highest."""
    @property
    def columns(self) -> int:
        """Columns of a sweep."""
    @property
    def sweep_s(self) -> float:
        """Duration of a sweep, seconds."""
    @property
    def range_m(self) -> tuple[float, float]:
        """Least and greatest range that it reports, meters."""
    @property
    def rig_from_lidar(self) -> NDArray[np.float64]:
        """Pose on the vehicle, float64 [4, 4], meters."""

class Session(Generic[Color]):
    """A device, and the scenes that were opened on it: each background and each asset is there once, however many show it."""

    @overload
    def __init__(
        self: Session[np.uint8],
        device: int | str | None = None,
        *,
        color: Literal["u8"] = "u8",
        depth: bool = False,
        instance: bool = False,
        planes: Sequence[PlaneName] = (),
        flow_interval: float = 0.1,
        exported: bool | None = None,
        rules: Literal["default", "gsplat15", "gsplat16", "inria", "nurec"] | None = None,
        storage: Literal["exact", "compact"] = "exact",
        background_pitch: float | None = None,
        taken_max: int = 16,
        frames_in_flight: int = 2,
        stage_times: bool = False,
    ) -> None: ...
    @overload
    def __init__(
        self: Session[np.float32],
        device: int | str | None = None,
        *,
        color: Literal["f32"],
        depth: bool = False,
        instance: bool = False,
        planes: Sequence[PlaneName] = (),
        flow_interval: float = 0.1,
        exported: bool | None = None,
        rules: Literal["default", "gsplat15", "gsplat16", "inria", "nurec"] | None = None,
        storage: Literal["exact", "compact"] = "exact",
        background_pitch: float | None = None,
        taken_max: int = 16,
        frames_in_flight: int = 2,
        stage_times: bool = False,
    ) -> None:
        """Opens a device: the best, or by number, a part of its name, or ``uuid:...``.

        color: ``u8`` for clamped bytes, ``f32`` for values as blended, not clamped.
        depth, instance: whether renderers draw these layers too (BatchRenderer.draw_layers, Images).
        planes: names of more layers; flow is the displacement in flow_interval seconds if cameras and agents go on with their motion.
        exported: whether images are drawn into memory that CUDA shares. None: where that can be; True: or DeviceError.
        rules: the rules of image formation for all scenes. None: each scene's own, as its file says.
        storage: storage of the backgrounds' splats on the device. exact: 152 bytes per splat of degree 3; compact: 120 bytes, with an error of less than one step of an 8-bit image.
        background_pitch: pixels; backgrounds are drawn with fewer splats where they lie at most so far apart. None: always the finest, which is exact.
        taken_max: frames that may be held on the device by tensors before TooManyHeldError.
        frames_in_flight: frames of one call that are submitted before the first is waited for.
        stage_times: whether stages are timed (Statistics.stages_ms). Stages that are timed do not overlap, so frames may take longer.
        """
    @property
    def device(self) -> Device:
        """The device."""
    @property
    def exported(self) -> bool:
        """Whether BatchRenderer.draw_dlpack gives CUDA tensors over the renderer's memory, without a copy."""
    @property
    def not_exported_because(self) -> str | None:
        """Reason why images are not exported; None where they are."""
    @property
    def color(self) -> Literal["u8", "f32"]:
        """Storage format of color."""
    @property
    def layers(self) -> list[PlaneName]:
        """Names of the layers that renderers draw beside color."""
    @property
    def taken_max(self) -> int:
        """Frames that tensors may hold at a time."""
    def open_scene(self, path: str | os.PathLike[str]) -> Scene:
        """The scene of a scene file (.toml) or splat file, loaded unless it is loaded already."""
    def batch_renderer(self) -> BatchRenderer[Color]:
        """A renderer of worlds of this session. Its buffers are kept from frame to frame; use one for each thread that draws."""
    def memory(self) -> dict[str, int]:
        """Bytes on the device by purpose."""
    def take_validation_messages(self) -> list[str]:
        """What the Vulkan validation layer said since the last call; it is on with DECOUPLEGS_VALIDATION=1."""
    def __copy__(self) -> Session[Color]: ...
    def __deepcopy__(self, memo: Any) -> Session[Color]: ...

class Scene:
    """A scene on the device, which stays there as long as something of it is held."""

    @property
    def rig(self) -> list[RigCamera]:
        """The ego vehicle's cameras; none for a splat file."""
    @property
    def lidars(self) -> list[Lidar]:
        """The ego vehicle's LiDARs; none for a splat file."""
    def ego_motion(self, time_s: float) -> tuple[list[float], list[float]]:
        """Motion of the ego vehicle by the scene file: velocity, m/s along the axes of the world, and turn, rad/s about those of the vehicle."""
    def ego_pose(self, time_s: float) -> NDArray[np.float64]:
        """Where the ego vehicle is by the scene file, world_from_rig, float64 [4, 4], meters."""
    @property
    def ego_span_s(self) -> tuple[float, float]:
        """First and last time of the ego's trajectory, seconds."""
    def cameras(self, time_s: float = 0.0, size: tuple[int, int] | None = None) -> list[Camera]:
        """The rig where the ego is at time_s, in images of ``size`` = (width, height) pixels where it is given."""
    def cameras_at(self, world_from_rig: ArrayLike, size: tuple[int, int] | None = None) -> list[Camera]:
        """The rig on a vehicle that stands at world_from_rig, float64 [4, 4], meters."""
    def frame(
        self, size: tuple[int, int] = (1280, 720), *, direction: Sequence[float] | None = None, up: Sequence[float] | None = None
    ) -> Camera:
        """A camera that shows all splats of a splat file, in an image of ``size`` = (width, height) pixels: the middle 90 % of them on each axis.

        It stands towards ``direction``, with ``up`` up in its image. None: as ``decouplegs render`` has it, with -y up for splat files. ValueError for a scene with cameras of its own.
        """
    @property
    def agents(self) -> list[str]:
        """Agents of the scene file that can be moved, with which a World begins."""
    @property
    def plain_agents(self) -> list[str]:
        """Agents of plain splats, which are part of the background."""
    def agent_pose(self, name: str, time_s: float) -> NDArray[np.float64]:
        """Where an agent is by the scene file, world_from_agent, float64 [4, 4], meters."""
    @property
    def asset_count(self) -> int:
        """Assets that agents may show, counted from 0."""
    def asset_size(self, asset: int) -> tuple[float, float, float]:
        """Length, width and height of an asset, meters. Its origin is the center of its box."""
    def add_asset(self, path: str | os.PathLike[str]) -> int:
        """Copies another compressed asset (.safetensors) to the device, for all worlds over this scene; its number."""
    @property
    def background_splats(self) -> int:
        """Splats of the background."""

class Agent:
    """An agent of a world, as it was when it was asked for."""

    @property
    def name(self) -> str:
        """Name, unique in its world."""
    @property
    def asset(self) -> int:
        """Number of the asset that it shows, from 0."""
    @property
    def instance(self) -> int:
        """Id in the instance plane; 0 is the background."""
    @property
    def pose(self) -> NDArray[np.float64]:
        """world_from_agent, float64 [4, 4], meters."""
    @property
    def present(self) -> bool:
        """False where the scene file says that it is absent: it is in no image."""
    @property
    def moving(self) -> bool:
        """True if it moves."""

class World:
    """A set of agents over a scene, which other worlds may be over as well. It costs a few hundred bytes."""

    def __init__(self, scene: Scene, empty: bool = False) -> None:
        """The agents of the scene file where they are at time 0, or none."""
    def set_time(self, time_s: float) -> None:
        """Puts the agents of the scene file that are still here where their trajectories have them; absent ones are hidden."""
    def move_to(self, name: str, pose: ArrayLike) -> None:
        """Moves an agent; pose is world_from_agent, float64 [4, 4], meters."""
    def set_motion(self, name: str, velocity: Sequence[float], turn: Sequence[float] = (0.0, 0.0, 0.0)) -> None:
        """Sets the motion of an agent, which rolling shutters show: m/s along the axes of the world, rad/s about those of the agent."""
    def place(self, name: str, asset: int, pose: ArrayLike) -> int:
        """Adds an agent that shows an asset, or lets the one of that name show it; its instance id."""
    def remove(self, name: str) -> None:
        """Takes an agent out."""
    @property
    def agents(self) -> list[Agent]:
        """Agents of the world."""
    @property
    def scene(self) -> Scene:
        """The scene that it is over."""
    def copy(self) -> World:
        """Another world with the same agents."""
    def __copy__(self) -> World: ...
    def __len__(self) -> int: ...

class Statistics:
    """Statistics of one frame."""

    @property
    def gpu_ms(self) -> float:
        """Time on the device, without the agents' part where that ran beside the frame before."""
    @property
    def update_ms(self) -> float | None:
        """Time of the agents' part, where it was submitted by itself."""
    @property
    def wall_ms(self) -> float:
        """Time from the submission to the finished images, milliseconds."""
    @property
    def record_ms(self) -> float:
        """Time of the host to record and submit, milliseconds."""
    @property
    def stages_ms(self) -> dict[str, float]:
        """Time on the device by stage; empty unless the session has stage_times."""
    @property
    def cameras(self) -> int:
        """Cameras that were drawn."""
    @property
    def agents(self) -> int:
        """Agents that some camera could see."""
    @property
    def agent_splats(self) -> int:
        """Splats of those agents."""
    @property
    def redrawn(self) -> int:
        """Number of repeated draws, because a list outgrew its buffer."""

class Layers(TypedDict, total=False):
    """Images of one view, [C, H, W] or [C, H, W, channels]: color, and the planes that the session has."""

    color: NDArray[Any]
    depth: NDArray[np.float32]
    instance: NDArray[np.int32]
    range: NDArray[np.float32]
    normal: NDArray[np.float32]
    flow_forward: NDArray[np.float32]
    flow_backward: NDArray[np.float32]
    scene_flow: NDArray[np.float32]
    depth_median: NDArray[np.float32]
    range_median: NDArray[np.float32]

class Sweep(TypedDict):
    """Returns of one sweep of a LiDAR, an entry each."""

    points: NDArray[np.float32]
    range: NDArray[np.float32]
    intensity: NDArray[np.float32]
    offset_ns: NDArray[np.uint32]
    column: NDArray[np.uint32]
    beam: NDArray[np.uint32]
    ring: NDArray[np.uint16]
    laser: NDArray[np.uint16]
    instance: NDArray[np.uint16]
    return_number: NDArray[np.uint8]
    return_count: NDArray[np.uint8]

Views = Sequence[tuple[World, Sequence[Camera]]]

class BatchRenderer(Generic[Color]):
    """Draws worlds of one session. One call at a time; calls of other threads wait."""

    def draw(self, views: Views) -> list[NDArray[Color]]:
        """Draws each world for its cameras, as many as 32 cameras over one scene in one submission.

        Of each view an array [C, H, W, 4] of red, green, blue and alpha, rows from the top: uint8, or float32 as blended. The
        cameras of a view must be of one size.
        """
    def draw_layers(self, views: Views) -> list[Layers]:
        """As draw: ``color`` [C, H, W, 4], and where the session has them ``depth`` float32 [C, H, W], meters along the camera's z, 0
        where nothing was hit, and ``instance`` int32 [C, H, W], 0 the background."""
    def draw_dlpack(self, views: Views) -> Images:
        """As draw, and leaves the images where they were drawn: on the device where Session.exported, otherwise on the host."""
    def sweep(
        self,
        world: World,
        lidar: Lidar,
        world_from_rig: ArrayLike,
        *,
        velocity: Sequence[float] = (0.0, 0.0, 0.0),
        turn: Sequence[float] = (0.0, 0.0, 0.0),
        frame: Literal["raw", "start", "end", "ego", "world"] = "ego",
        returns: Literal["median", "expected", "strongest", "dual"] | None = None,
        opacity_min: float = 0.5,
        seed: int = 0,
    ) -> Sweep:
        """Traces one sweep of a LiDAR through a world, on a vehicle that is at world_from_rig, float64 [4, 4], meters, when the sweep ends.

        It and the agents go on with their motion during the sweep; velocity, m/s along the axes of the world, and turn, rad/s about those
        of the vehicle, are the vehicle's. ``points`` float32 [N, 3], meters, are in ``frame``: of the sensor at each firing (``raw``), at
        the ``start`` or ``end`` of the sweep, of the vehicle at its end (``ego``), or of the ``world``. ``intensity`` is the luma of splats,
        0 to 1: uncalibrated. ``ring`` counts from the highest row; ``instance`` 0 is the background. NumPy arrays, which from_dlpack of
        other libraries takes as they are.
        """
    def collect(self) -> int:
        """Takes back images that nobody reads any more, which each draw_dlpack does first; how many frames the device still reads."""
    @property
    def imports(self) -> int:
        """Buffers of the renderer that are imported into CUDA."""
    @property
    def statistics(self) -> list[Statistics]:
        """Statistics of each frame of the last call."""

class Images:
    """Images of one call, where they were drawn. Of one frame and one size, they are themselves a tensor [C, H, W, 4]."""

    @property
    def frames(self) -> int:
        """Frames that the call took."""
    @property
    def views(self) -> int:
        """Views that were drawn."""
    def frame(self, index: int, layer: LayerName = "color") -> Tensor:
        """All cameras of a frame: [C, H, W, 4] of color, [C, H, W, channels] of normals, flow and scene flow, [C, H, W] of other planes. Cameras must be of one size."""
    def view(self, index: int, layer: LayerName = "color") -> Tensor:
        """All cameras of a view, in the shapes of frame. Cameras must be of one size."""
    def camera(self, view: int, camera: int, layer: LayerName = "color") -> Tensor:
        """One camera: [H, W, 4] of color, [H, W, channels] of normals, flow and scene flow, [H, W] of other planes."""
    def tensor(self) -> Tensor:
        """All cameras of the call, of one frame and one size: [C, H, W, 4]."""
    def __dlpack__(
        self,
        *,
        stream: int | None = None,
        max_version: tuple[int, int] | None = None,
        dl_device: tuple[int, int] | None = None,
        copy: bool | None = None,
    ) -> Any:
        """tensor().__dlpack__(...)"""
    def __dlpack_device__(self) -> tuple[int, int]:
        """tensor().__dlpack_device__()"""

class Tensor:
    """Images for torch.from_dlpack, numpy.from_dlpack, cupy.from_dlpack and others: in C order, to be read, not written.

    On CUDA the consumer's stream waits for the frame. The memory is drawn into again when all tensors over the frame are gone and the streams
    that they were taken on have come so far. A reader on yet another stream must keep the tensor until that is done.
    """

    @property
    def shape(self) -> list[int]:
        """Its axes."""
    @property
    def dtype(self) -> Literal["uint8", "float32", "int32"]:
        """Its type, as NumPy calls it."""
    def __dlpack__(
        self,
        *,
        stream: int | None = None,
        max_version: tuple[int, int] | None = None,
        dl_device: tuple[int, int] | None = None,
        copy: bool | None = None,
    ) -> Any:
        """A capsule, read-only as DLPack 1 has it where max_version allows. stream as in the array API standard."""
    def __dlpack_device__(self) -> tuple[int, int]:
        """(2, number) for CUDA, (1, 0) for the host."""

class Site:
    """A place of episodes, on the device: the synthetic street, or that of a scenario file."""

    def __init__(
        self,
        session: Session,
        *,
        weather: Literal["clear", "overcast", "dusk", "night"] = "clear",
        background: int = 200_000,
        agent_splats: int = 4_000,
        seed: int = 1,
        scenario: str | os.PathLike[str] | None = None,
    ) -> None:
        """The synthetic street of ``background`` splats with cars of ``agent_splats``, its houses by ``seed``; or the place of a scenario
        file (.toml), whose scenario is then the one that is driven."""
    @property
    def scene(self) -> Scene:
        """What is drawn of it: worlds over it show rollouts."""
    @property
    def rig(self) -> list[RigCamera]:
        """The ego's cameras."""
    def __copy__(self) -> Site: ...
    def __deepcopy__(self, memo: Any) -> Site: ...

class StepResult(TypedDict):
    """What came of a step."""

    progress_m: float
    off_road_share: float
    time_s: float
    end: Literal["route_done", "collision", "obstacle", "off_road", "off_route", "story", "time", "planner"] | None

class RolloutEgo:
    """One ego of a rollout."""

    @property
    def name(self) -> str:
        """Name in the scenario."""
    def plan_under(self, steer_rad: float, acceleration_mps2: float) -> NDArray[np.float64]:
        """Plan that turns the wheels towards steer_rad (left above zero, at most 0.6) and accelerates so (-8 to 3) for 2 s: float64 [N, 3], as
        steps take it."""
    def show(self, world: World) -> NDArray[np.float64]:
        """Puts all agents and the other egos into a world over the site's scene, as this ego sees them; world_from_rig of the ego, float64 [4, 4],
        meters."""
    @property
    def motion(self) -> tuple[list[float], list[float]]:
        """Motion of the ego when show was called last: velocity, m/s along the axes of the world, and turn, rad/s about those of the vehicle."""
    @property
    def state(self) -> NDArray[np.float64]:
        """Speed m/s, acceleration m/s2, angle of the wheels rad, yaw rate rad/s: float64 [4]."""
    @property
    def guidance(self) -> dict[str, Any]:
        """What a navigation system says: turn (``left``, ``right``, ``straight``), distance_m, angle_rad, length_m, cruise_mps."""
    def route_ahead(self, points: int = 10, spacing_m: float = 5.0) -> NDArray[np.float64]:
        """Places on the route ahead, in the ego's frame: float64 [points, 2], meters."""
    @property
    def progress_m(self) -> tuple[float, float]:
        """Meters of the route that are behind the ego, and all of them."""
    @property
    def end(self) -> Literal["route_done", "collision", "obstacle", "off_road", "off_route", "story", "time", "planner"] | None:
        """Reason of the end, if it has ended."""
    def score(self) -> dict[str, Any]:
        """Score so far, as that of a rollout."""
    def sub_scores(self) -> dict[str, Any]:
        """Scores beside the driving score so far, as those of a rollout."""

class Rollout:
    """One episode, step by step: the ego does as it is told, traffic answers. The same steps give the same bits."""

    def __init__(
        self,
        site: Site,
        level: Literal["easy", "medium", "hard", "extreme"] = "easy",
        seed: int = 0,
        index: int = 0,
        *,
        step_s: float | None = None,
        duration_s: float | None = None,
        name: str = "python",
        egos: int | None = None,
    ) -> None:
        """Scenario ``index`` of a level, generated from ``seed``; with a site of a scenario file, that scenario. ``name`` is the planner's, for
        logs. With ``egos``, cars of the generated traffic become egos. What is asked of the rollout itself is that of the first ego."""
    @property
    def egos(self) -> list[RolloutEgo]:
        """All egos, in the order of the scenario."""
    def step(self, plans: dict[str, ArrayLike]) -> dict[str, StepResult]:
        """Drives a step of all egos, along a trajectory for each that has not ended: float64 [N, 3] by its name, as ``step_plan`` takes it. What
        came of the step, by name."""
    def step_controls(self, steer_rad: float, acceleration_mps2: float) -> StepResult:
        """Drives a step with the wheels turned towards steer_rad (left above zero, at most 0.6) and accelerating so (-8 to 3).

        The ego is given the trajectory that this would drive for 2 s, so that a log of it replays like any other.
        """
    def step_plan(self, points: ArrayLike) -> StepResult:
        """Drives a step along a trajectory: float64 [N, 3] of time (seconds from now, rising), x (forward) and y (left) in the ego's
        frame, meters."""
    @property
    def ego_motion(self) -> tuple[list[float], list[float]]:
        """Motion of the ego when show was called last: velocity, m/s along the axes of the world, and turn, rad/s about those of the vehicle."""
    def show(self, world: World) -> NDArray[np.float64]:
        """Puts all agents into a world over the site's scene; world_from_rig of the ego, float64 [4, 4], meters."""
    @property
    def ego_state(self) -> NDArray[np.float64]:
        """Speed m/s, acceleration m/s2, angle of the wheels rad, yaw rate rad/s: float64 [4]."""
    @property
    def sizes(self) -> NDArray[np.float64]:
        """Sizes of boxes: length, width, height, meters, float64 [N + 1, 3]. Row 0 is the ego, row i the vehicle or pedestrian whose instance
        is i."""
    @property
    def kinds(self) -> list[Literal["car", "truck", "bus", "cyclist", "pedestrian"]]:
        """Kinds of road users, a name for each row of sizes. The ego is a car."""
    @property
    def guidance(self) -> dict[str, Any]:
        """What a navigation system says: turn (``left``, ``right``, ``straight``), distance_m, angle_rad, length_m, cruise_mps."""
    def route_ahead(self, points: int = 10, spacing_m: float = 5.0) -> NDArray[np.float64]:
        """Places on the route ahead, in the ego's frame: float64 [points, 2], meters."""
    @property
    def progress_m(self) -> tuple[float, float]:
        """Meters of the route that are behind the ego, and all of them."""
    @property
    def end(self) -> Literal["route_done", "collision", "obstacle", "off_road", "off_route", "story", "time", "planner"] | None:
        """Why it is over, if it is."""
    @property
    def steps(self) -> int:
        """Steps that were driven."""
    @property
    def step_s(self) -> float:
        """Length of a step, seconds."""
    @property
    def scenario(self) -> str:
        """The scenario's name."""
    def score(self) -> dict[str, Any]:
        """How it went so far: driving_score, route_completion, success, collisions, pedestrian_collisions, obstacle_collisions, layout_infractions, wrong_ways, red_lights, stop_signs, min_ttc_s, ttc_short_share."""
    def sub_scores(self) -> dict[str, Any]:
        """Scores beside the driving score so far: all_rules_score, reference_progress, pdm_score, extended_pdm_score, lane_kept_share, speed_compliance, over_edge_s, on_crossing, blocking, wrong_turns. None where the map does not tell one."""
    def write_log(self, path: str | os.PathLike[str]) -> None:
        """Writes its log, which ``decouplegs replay`` and ``decouplegs score`` read."""
