"""Checks of the hand-off to CUDA, on a machine with an NVIDIA GPU and torch. Prints one JSON object a line, and exits with 1 where one fails.

    python tools/python/tests/gpu_check.py [--scene SCENE] [--frames 10000] [--decouplegs PROGRAM]
"""

import argparse
import contextlib
import gc
import json
import statistics
import struct
import subprocess
import sys
import tempfile
import time
import zlib
from pathlib import Path

import numpy as np
import torch

import decouplegs

CHECKS = []
HAND_OFF_US = 50.0
LEAK_BYTES = 4 << 20


def check(function):
    CHECKS.append(function)
    return function


class Bench:
    """A session that shares its images, and a place with agents in it."""

    def __init__(self, options: argparse.Namespace, **session) -> None:
        self.options = options
        self.session = decouplegs.Session(options.device, exported=True, **session)
        if options.scene:
            self.scene = self.session.open_scene(options.scene)
            self.world = decouplegs.World(self.scene)
            self.cameras = self.scene.cameras
        else:
            site = decouplegs.Site(self.session, background=options.background)
            self.scene, self.rollout = site.scene, decouplegs.Rollout(site, "medium", seed=1)
            self.world = decouplegs.World(self.scene, empty=True)
            ego = self.rollout.show(self.world)
            self.cameras = lambda time_s=0.0, size=None: self.scene.cameras_at(forward(ego, 3.0 * time_s), size)
        self.renderer = self.session.batch_renderer()

    def views(self, time_s: float = 0.0, size=(1600, 900), count: int | None = None):
        return [(self.world, self.cameras(time_s, size)[:count])]

    def tensor(self, views) -> torch.Tensor:
        return torch.from_dlpack(self.renderer.draw_dlpack(views))


def forward(pose: np.ndarray, meters: float) -> np.ndarray:
    moved = pose.copy()
    moved[:3, 3] += meters * moved[:3, 0]
    return moved


@check
def sharing(options) -> dict:
    """The device is found by its UUID, and tensors are on it."""
    bench = Bench(options)
    tensor = bench.tensor(bench.views())
    return {
        "ok": bench.session.exported and tensor.is_cuda,
        "device": bench.session.device.name,
        "uuid": bench.session.device.uuid,
        "tensor": str(tensor.device),
        "torch": torch.__version__,
        "shape": list(tensor.shape),
    }


@check
def same_bytes(options) -> dict:
    """Torch reads what draw returns, in every layer and format."""
    different = {}
    for session in ({}, {"color": "f32"}, {"depth": True, "instance": True}, {"color": "f32", "depth": True, "instance": True}):
        bench = Bench(options, **session)
        views = bench.views(0.5)
        layers = bench.renderer.draw_layers(views)[0]
        images = bench.renderer.draw_dlpack(views)
        for layer, expected in layers.items():
            seen = torch.from_dlpack(images.view(0, layer)).cpu().numpy()
            name = f"{session} {layer}"
            different[name] = int((seen.view(np.uint8) != np.ascontiguousarray(expected).view(np.uint8)).sum())
        one = torch.from_dlpack(images.camera(0, 1)).cpu().numpy()
        different[f"{session} camera"] = int((one != layers["color"][1]).sum())
    return {"ok": not any(different.values()), "different": different}


def read_png(path: Path) -> np.ndarray:
    """An RGB image of 8 bits, [H, W, 3]."""
    data, at, packed, header = path.read_bytes(), 8, b"", b""
    while at < len(data):
        length, kind = struct.unpack(">I4s", data[at : at + 8])
        body = data[at + 8 : at + 8 + length]
        header = body if kind == b"IHDR" else header
        packed += body if kind == b"IDAT" else b""
        at += 12 + length
    width, height, depth, color = struct.unpack(">IIBB", header[:10])
    channels = {2: 3, 6: 4}[color]
    assert depth == 8, depth
    rows = np.frombuffer(zlib.decompress(packed), np.uint8).reshape(height, 1 + width * channels)
    image, above = np.zeros((height, width * channels), np.uint8), np.zeros(width * channels, np.uint8)
    for index, row in enumerate(rows):
        above = image[index] = unfiltered(int(row[0]), row[1:], above, channels)
    return image.reshape(height, width, channels)[..., :3]


def unfiltered(kind: int, row: np.ndarray, above: np.ndarray, channels: int) -> np.ndarray:
    if kind in (0, 2):
        return row if kind == 0 else row + above
    out, left, corner = [0] * len(row), [0] * channels, [0] * channels
    for i, (value, up) in enumerate(zip(row.tolist(), above.tolist())):
        a, c = left[i % channels], corner[i % channels]
        near = min((abs(up - c), 0, a), (abs(a - c), 1, up), (abs(a + up - 2 * c), 2, c))[2]
        value = (value + {1: a, 3: (a + up) // 2, 4: near}[kind]) & 255
        out[i] = left[i % channels] = value
        corner[i % channels] = up
    return np.array(out, np.uint8)


@check
def png_bytes(options) -> dict:
    """Torch reads what the program writes as PNG."""
    if not (options.scene and options.decouplegs):
        return {"ok": True, "skipped": "give --scene and --decouplegs"}
    bench = Bench(options)
    with tempfile.TemporaryDirectory() as folder:
        subprocess.run([options.decouplegs, "render", options.scene, "--out", folder], check=True, capture_output=True)
        cameras = bench.scene.cameras(0.0)
        tensor = torch.from_dlpack(bench.renderer.draw_dlpack([(bench.world, cameras)])).cpu().numpy()
        worst = 0
        for camera, seen in zip(cameras, tensor):
            written = read_png(Path(folder) / f"{camera.name}.png")
            worst = max(worst, int(np.abs(written.astype(int) - seen[..., :3].astype(int)).max()))
    return {"ok": worst == 0, "largest_difference": worst}


@check
def hand_off(options) -> dict:
    """What taking the images costs beyond the frame."""
    bench = Bench(options)
    taking, beyond, frames = [], [], []
    for step in range(300):
        views = bench.views(0.01 * step)
        begin = time.perf_counter()
        images = bench.renderer.draw_dlpack(views)
        drawn = time.perf_counter()
        tensor = torch.from_dlpack(images)
        end = time.perf_counter()
        del images, tensor
        if step >= 50:
            wall_ms = sum(frame.wall_ms for frame in bench.renderer.statistics)
            taking.append(1e6 * (end - drawn))
            beyond.append(1e6 * (end - begin) - 1e3 * wall_ms)
            frames.append(wall_ms)
    median = statistics.median
    return {
        "ok": median(taking) <= HAND_OFF_US and median(beyond) <= 2 * HAND_OFF_US,
        "from_dlpack_us": round(median(taking), 1),
        "from_dlpack_p99_us": round(float(np.percentile(taking, 99)), 1),
        "call_beyond_frame_us": round(median(beyond), 1),
        "frame_ms": round(median(frames), 3),
        "imports": bench.renderer.imports,
    }


def device_memory(bench: Bench) -> dict:
    gc.collect()
    torch.cuda.synchronize()
    bench.renderer.collect()
    free, _ = torch.cuda.mem_get_info()
    rss = int(Path("/proc/self/statm").read_text().split()[1]) * 4096
    descriptors = len(list(Path("/proc/self/fd").iterdir()))
    return {"cuda_free": free, "session": sum(bench.session.memory().values()), "rss": rss, "descriptors": descriptors}


@check
def no_leak(options) -> dict:
    """Memory of device, session and process after the first tenth of the frames and after the last."""
    bench = Bench(options)
    total, early = torch.zeros((), dtype=torch.int64, device="cuda"), {}
    for step in range(options.frames):
        tensor = bench.tensor(bench.views(0.001 * (step % 1000), (320, 180)))
        total += tensor[0, 0, 0, 0]
        del tensor
        if step == options.frames // 10:
            early = device_memory(bench)
    late = device_memory(bench)
    grown = {name: late[name] - early[name] for name in late}
    grown["cuda_free"] = -grown["cuda_free"]
    smi = subprocess.run(["nvidia-smi", "--query-gpu=memory.used", "--format=csv,noheader"], capture_output=True, text=True)
    ok = grown["cuda_free"] <= LEAK_BYTES and grown["session"] == 0 and grown["rss"] <= 4 * LEAK_BYTES and grown["descriptors"] <= 0
    return {"ok": ok, "frames": options.frames, "grown": grown, "imports": bench.renderer.imports, "nvidia_smi": smi.stdout.split("\n")[0]}


@check
def no_copies(options) -> dict:
    """A trace of the consumer: kernels and no copies, neither to the host nor on the device."""
    from torch.profiler import ProfilerActivity, profile

    bench = Bench(options)
    for step in range(20):
        bench.tensor(bench.views(0.01 * step)).amax()
    torch.cuda.synchronize()
    with profile(activities=[ProfilerActivity.CPU, ProfilerActivity.CUDA]) as traced:
        for step in range(20):
            bench.tensor(bench.views(0.01 * step)).amax()
        torch.cuda.synchronize()
    names = {event.key: event.count for event in traced.key_averages()}
    copies = {name: count for name, count in names.items() if "memcpy" in name.lower() or name == "aten::copy_"}
    staged = bench.session.memory().get("staging", 0)
    return {"ok": not copies and bool(names), "copies": copies, "events": len(names), "staging_bytes": staged}


@check
def no_early_recycling(options) -> dict:
    """A slow reader on a stream of its own, which drops its tensor at once, still reads the right image."""
    bench = Bench(options)
    expected = bench.renderer.draw(bench.views(0.0, (640, 360)))[0]
    wrong, stream, waiting = 0, torch.cuda.Stream(), 0
    for _ in range(20):
        with torch.cuda.stream(stream):
            tensor = bench.tensor(bench.views(0.0, (640, 360)))
            torch.cuda._sleep(500_000_000)
            read = tensor.clone()
            del tensor
        for other in range(1, 6):
            bench.renderer.draw_dlpack(bench.views(float(other), (640, 360)))
        waiting = max(waiting, bench.renderer.collect())
        stream.synchronize()
        wrong += int((read.cpu().numpy() != expected).any())
    return {"ok": wrong == 0 and waiting > 0, "wrong": wrong, "frames_still_read_at_most": waiting}


@check
def too_many(options) -> dict:
    """Who holds too many is told, and goes on when he lets some go."""
    bench = Bench(options, taken_max=8)
    held, message = [], ""
    try:
        for _ in range(100):
            held.append(bench.tensor(bench.views(0.0, (64, 36))))
    except decouplegs.TooManyHeldError as error:
        message = str(error)
    count = len(held)
    distinct = len({tensor.data_ptr() for tensor in held})
    held.clear()
    torch.cuda.synchronize()
    again = bench.tensor(bench.views(0.0, (64, 36))).sum().item()
    return {"ok": count == 8 and distinct == 8 and "8 frames are held" in message and again > 0, "held": count, "message": message}


@check
def sizes_that_change(options) -> dict:
    """Imports of buffers that the renderer has released are forgotten."""
    bench = Bench(options)
    for step in range(60):
        size = (160 + 32 * (step % 5), 90)
        views = bench.views(0.0, size)
        tensor = bench.tensor(views)
        same = bool((tensor.cpu().numpy() == bench.renderer.draw(views)[0]).all())
        del tensor
        if not same:
            return {"ok": False, "size": size}
    torch.cuda.synchronize()
    bench.renderer.collect()
    return {"ok": bench.renderer.imports <= 6, "imports": bench.renderer.imports}


@check
def renderer_gone(options) -> dict:
    """Tensors outlive batch renderer and session."""
    bench = Bench(options)
    expected = bench.renderer.draw(bench.views(0.0, (320, 180)))[0]
    tensor = bench.tensor(bench.views(0.0, (320, 180)))
    del bench
    gc.collect()
    return {"ok": bool((tensor.cpu().numpy() == expected).all())}


@check
def many_worlds(options) -> dict:
    """64 worlds over one background, 512x320, one camera each."""
    bench = Bench(options)
    camera = bench.cameras(0.0, (512, 320))[:1]
    worlds = [bench.world.copy() for _ in range(64)]
    views, seconds = [(world, camera) for world in worlds], []
    for _ in range(60):
        begin = time.perf_counter()
        images = bench.renderer.draw_dlpack(views)
        tensors = [torch.from_dlpack(images.frame(index)) for index in range(images.frames)]
        seconds.append(time.perf_counter() - begin)
        count = sum(len(tensor) for tensor in tensors)
        del images, tensors
    rate = count / statistics.median(seconds[10:])
    return {"ok": count == 64, "images_per_s": round(rate), "frames": len(bench.renderer.statistics)}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--scene", help="a scene file; without one, a street is generated")
    parser.add_argument("--background", type=int, default=400_000, help="splats of the generated street")
    parser.add_argument("--frames", type=int, default=10_000, help="frames of the leak check")
    parser.add_argument("--device", help="a number, a part of a name, or uuid:...")
    parser.add_argument("--decouplegs", help="the program, whose PNG files are compared with")
    parser.add_argument("--only", help="a part of the names of checks")
    options = parser.parse_args()
    failed = False
    for function in CHECKS:
        if options.only and options.only not in function.__name__:
            continue
        begin = time.perf_counter()
        try:
            result = function(options)
        except Exception as error:  # A check that breaks is a check that fails, and the others go on.
            result = {"ok": False, "error": f"{type(error).__name__}: {error}"}
        failed |= not result["ok"]
        print(json.dumps({"check": function.__name__, **result, "seconds": round(time.perf_counter() - begin, 1)}), flush=True)
        with contextlib.suppress(Exception):
            torch.cuda.synchronize()
        gc.collect()
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
