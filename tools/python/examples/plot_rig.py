"""Plots what a rig sees, how deep it is, and where the cameras stand.

    python tools/python/examples/plot_rig.py street/scene.toml --time 1.0 --out rig.png

Without a scene it generates a street.
"""

import argparse

import matplotlib

matplotlib.use("Agg")

import matplotlib.pyplot as plt
import numpy as np

import decouplegs


def size(text: str) -> tuple[int, int]:
    width, height = text.split("x")
    return int(width), int(height)


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scene", nargs="?", help="a scene file (.toml); without one, a street is generated")
    parser.add_argument("--time", type=float, default=0.0, help="seconds")
    parser.add_argument("--size", type=size, default=(480, 270), metavar="WxH", help="pixels of each image")
    parser.add_argument("--device", help="a number, a part of a name, or uuid:...")
    parser.add_argument("--out", default="rig.png")
    return parser.parse_args()


def shown(options: argparse.Namespace, session: decouplegs.Session) -> tuple[decouplegs.World, list[decouplegs.Camera]]:
    """The world at the wanted time, and the rig in it."""
    if options.scene:
        scene = session.open_scene(options.scene)
        world = decouplegs.World(scene)
        world.set_time(options.time)
        return world, scene.cameras(options.time, options.size)
    site = decouplegs.Site(session)
    rollout = decouplegs.Rollout(site, "medium", seed=1)
    for _ in range(round(options.time / rollout.step_s)):
        rollout.step_controls(0.0, 0.0)
    world = decouplegs.World(site.scene, empty=True)
    ego = rollout.show(world)
    return world, site.scene.cameras_at(ego, options.size)


# What is farther from the ego is not in the drawing, meters.
NEAR_M = 40.0


def plot_from_above(axes: plt.Axes, world: decouplegs.World, cameras: list[decouplegs.Camera]) -> None:
    """Where cameras and agents are about the ego, and where they look."""
    middle = np.mean([camera.world_from_camera[:2, 3] for camera in cameras], axis=0)
    for camera in cameras:
        pose = camera.world_from_camera
        axes.arrow(*pose[:2, 3], *(4 * pose[:2, 2]), head_width=0.8, color="tab:blue")
    for agent in world.agents:
        length, width, _ = world.scene.asset_size(agent.asset)
        corners = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1], [1, 1]]) * [length / 2, width / 2]
        outline = corners @ agent.pose[:2, :2].T + agent.pose[:2, 3]
        axes.plot(*outline.T, color="tab:orange")
    axes.set(aspect="equal", title="from above", xlabel="x, m", ylabel="y, m")
    axes.set(xlim=(middle[0] - NEAR_M, middle[0] + NEAR_M), ylim=(middle[1] - NEAR_M, middle[1] + NEAR_M))


def main() -> None:
    options = arguments()
    session = decouplegs.Session(options.device, depth=True, exported=False)
    world, cameras = shown(options, session)
    renderer = session.batch_renderer()
    layers = renderer.draw_layers([(world, cameras)])[0]
    columns = len(cameras)
    figure = plt.figure(figsize=(3.4 * columns, 8), layout="constrained")
    grid = figure.add_gridspec(3, columns)
    depth_max_m = float(np.percentile(layers["depth"], 95)) or 1.0
    for column, camera in enumerate(cameras):
        for row, (layer, options_) in enumerate([("color", {}), ("depth", {"vmin": 0, "vmax": depth_max_m, "cmap": "magma_r"})]):
            axes = figure.add_subplot(grid[row, column])
            image = layers[layer][column]
            image = axes.imshow(image[..., :3] if layer == "color" else image, **options_)
            axes.set(xticks=[], yticks=[], title=camera.name if row == 0 else None)
    figure.colorbar(image, ax=axes, label="depth, m")
    plot_from_above(figure.add_subplot(grid[2, :]), world, cameras)
    took = renderer.statistics[0]
    figure.suptitle(f"{session.device.name}: {took.gpu_ms:.2f} ms for {took.cameras} cameras, {took.agents} agents in view")
    figure.savefig(options.out, dpi=110)
    print(f"{options.out}: {columns} cameras")


if __name__ == "__main__":
    main()
