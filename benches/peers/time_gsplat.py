#!/usr/bin/env python3
"""Times gsplat on a scene of ours, on the GPU of this machine, and compares its images with ours.

    time_gsplat.py world.ply transforms.json --images DIR --ours bench.json --json gsplat.json

DIR holds what `decouplegs render world.ply --cameras transforms.json --rules gsplat15 --format npy --out DIR` wrote: the
same splats and cameras under gsplat's rules, so that what differs is arithmetic. Time is that of CUDA events around
`gsplat.rasterization(packed=True)`: from arrays on the GPU to an image on the GPU, as our frame time is.
"""

import argparse
import json
import statistics
import sys
from pathlib import Path

import numpy as np

import scene_files

WARM_UP_FRAMES = 10


def arguments(argv=None):
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("splats", type=Path, help="INRIA PLY")
    parser.add_argument("cameras", type=Path, help="transforms.json (nerfstudio) or cameras.json (INRIA), all of one size")
    parser.add_argument("--cameras-used", type=int, action="append", help="first so many cameras in one call (default: 1, then all)")
    parser.add_argument("--frames", type=int, default=40, help="timed frames after %d of warm-up (default: 40)" % WARM_UP_FRAMES)
    parser.add_argument("--images", type=Path, help="folder of our NAME.npy files to compare with")
    parser.add_argument("--ours", type=Path, action="append", default=[], help="what `decouplegs bench --json` wrote, to print beside")
    parser.add_argument("--json", type=Path, help="write all figures here")
    parsed = parser.parse_args(argv)
    if parsed.frames < 1 or min(parsed.cameras_used or [1]) < 1:
        parser.error("--frames and --cameras-used must be at least 1")
    return parsed


def import_gsplat():
    try:
        import torch
        import gsplat
    except ImportError as error:
        sys.exit(f"gsplat cannot be imported ({error}). Install it beside a CUDA build of torch: pip install gsplat==1.5.3")
    if not torch.cuda.is_available():
        sys.exit("torch sees no CUDA device: gsplat runs on NVIDIA GPUs only.")
    return torch, gsplat


def frame_of(torch, gsplat, splats, cameras):
    """A function that draws `cameras` in one call and returns RGB [C, H, W, 3] and alpha [C, H, W, 1] on the GPU."""
    sizes = {(camera.width_px, camera.height_px) for camera in cameras}
    if len(sizes) != 1:
        sys.exit(f"gsplat draws cameras of one size in a call, found {sorted(sizes)}.")
    (width, height) = sizes.pop()

    def on_gpu(array):
        return torch.from_numpy(np.ascontiguousarray(array, dtype=np.float32)).cuda()

    tensors = {
        "means": on_gpu(splats.means),
        "quats": on_gpu(splats.quaternions),
        "scales": on_gpu(splats.scales),
        "opacities": on_gpu(splats.opacities),
        "colors": on_gpu(splats.sh),
        "viewmats": on_gpu(np.stack([camera.camera_from_world for camera in cameras])),
        "Ks": on_gpu(np.stack([camera.intrinsics for camera in cameras])),
    }

    def frame():
        colors, alphas, _ = gsplat.rasterization(
            **tensors, width=width, height=height, sh_degree=splats.sh_degree, packed=True, near_plane=0.01, rasterize_mode="classic"
        )
        return colors, alphas

    return frame


def time_frames(torch, frame, count):
    """GPU milliseconds of each of `count` frames."""
    for _ in range(WARM_UP_FRAMES):
        frame()
    torch.cuda.synchronize()
    torch.cuda.reset_peak_memory_stats()
    events = [(torch.cuda.Event(enable_timing=True), torch.cuda.Event(enable_timing=True)) for _ in range(count)]
    for start, end in events:
        start.record()
        frame()
        end.record()
    torch.cuda.synchronize()
    return [start.elapsed_time(end) for start, end in events]


def difference(ours, theirs):
    """Error of `theirs` against `ours`, both float arrays [H, W, C] of one shape."""
    error = np.abs(ours.astype(np.float64) - theirs.astype(np.float64))
    mean_square = float(np.mean(error**2))
    return {
        "psnr_db": float("inf") if mean_square == 0.0 else -10.0 * float(np.log10(mean_square)),
        "max_abs": float(error.max()),
        "share_above_1_255": float(np.mean(error > 1.0 / 255.0)),
    }


def compare_images(frame, cameras, folder):
    colors, alphas = (tensor.float().cpu().numpy() for tensor in frame())
    compared = {}
    for camera, color, alpha in zip(cameras, colors, alphas):
        path = folder / f"{camera.name}.npy"
        if not path.exists():
            sys.exit(f"{path} does not exist: render it with `decouplegs render --rules gsplat15 --format npy`.")
        ours = np.load(path, allow_pickle=False)
        if ours.shape != (*color.shape[:2], 4):
            sys.exit(f"{path} has the shape {ours.shape}, expected {(*color.shape[:2], 4)}.")
        compared[camera.name] = {"rgb": difference(ours[..., :3], color), "alpha": difference(ours[..., 3:], alpha)}
    return compared


def print_rows(runs, ours_by_cameras):
    print("| cameras | gsplat ms | ours ms | gsplat / ours |\n|---|---|---|---|")
    for run in runs:
        ours_ms = ours_by_cameras.get(run["cameras"])
        columns = (f"{ours_ms:.3f}", f"{run['median_ms'] / ours_ms:.2f}") if ours_ms else ("not measured", "")
        print(f"| {run['cameras']} | {run['median_ms']:.3f} | {columns[0]} | {columns[1]} |")


def main():
    options = arguments()
    torch, gsplat = import_gsplat()
    try:
        splats, cameras = scene_files.read_ply(options.splats), scene_files.read_cameras(options.cameras)
    except (OSError, scene_files.SceneFileError) as error:
        sys.exit(str(error))
    benches = [json.loads(path.read_text()) for path in options.ours]
    ours_by_cameras = {bench["cameras"]: bench["frame_gpu_ms"]["median"] for bench in benches}

    runs, compared = [], {}
    for used in options.cameras_used or sorted({1, len(cameras)}):
        if used > len(cameras):
            sys.exit(f"--cameras-used {used}: {options.cameras} has {len(cameras)} cameras.")
        with torch.inference_mode():
            frame = frame_of(torch, gsplat, splats, cameras[:used])
            times_ms = time_frames(torch, frame, options.frames)
            if options.images:
                compared.update(compare_images(frame, cameras[:used], options.images))
        runs.append({
            "cameras": used,
            "median_ms": statistics.median(times_ms),
            "min_ms": min(times_ms),
            "max_ms": max(times_ms),
            "memory_bytes_peak": torch.cuda.max_memory_allocated(),
        })

    print_rows(runs, ours_by_cameras)
    for name, images in compared.items():
        rgb = images["rgb"]
        print(f"{name}: PSNR {rgb['psnr_db']:.2f} dB, max {rgb['max_abs']:.5f}, above 1/255 {100.0 * rgb['share_above_1_255']:.5f} %")
    report = {
        "device": torch.cuda.get_device_name(),
        "gsplat": gsplat.__version__,
        "torch": torch.__version__,
        "splats": len(splats.means),
        "sh_degree": splats.sh_degree,
        "width_px": cameras[0].width_px,
        "height_px": cameras[0].height_px,
        "frames": options.frames,
        "runs": runs,
        "images": compared,
    }
    if options.json:
        options.json.write_text(json.dumps(report, indent=2) + "\n")


if __name__ == "__main__":
    main()
