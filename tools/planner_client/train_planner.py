"""The network of the planner `learned`: roads to learn on, and the training. Needs PyTorch, NumPy and Pillow.

The network copies `lane-follow`, which knows everything, from images of the front camera. It first learns from episodes that
`lane-follow` drove, then from its own, in which it is told what `lane-follow` would have done where it went (DAgger, Ross et
al., 2011). With MAPS a folder:

    python3 train_planner.py roads MAPS --count 24
    decouplegs drive --map MAPS/roads_00.json --level all --episodes 10 --planner lane-follow --images all --out runs/r0_00
    decouplegs export runs/r0_00/logs/easy_0000.log --as plans --out runs/r0_00/plans/easy_0000   # and so on, for each log
    python3 train_planner.py train runs/* --out w0.safetensors
    decouplegs drive --map MAPS/roads_00.json --level all --episodes 10 --planner learned:w0.safetensors --images all --out runs/r1_00

and so on from `export`, until it drives as well as it can. `--jobs` in `train` is the number of processes that read images.
"""

import argparse
import json
import math
import pathlib
import random
import struct
import sys

#: Distance between points of lanes, meters.
SPACING_M = 2.0
#: Distance from the middle of a crossing to where its lanes begin, meters.
CROSSING_M = (13.0, 18.0)
#: Length of an arm, meters.
ARM_M = (160.0, 240.0)


def bent_line(start, heading_rad, length_m, chance):
    """Points and headings along a road that bends, with at most 60 degrees between its ends."""
    points, turned_rad, done_m = [(*start, heading_rad)], 0.0, 0.0
    x, y = start
    while done_m < length_m:
        part_m = chance.uniform(20.0, 60.0)
        curvature = chance.choice([0.0, 1.0, -1.0]) / chance.uniform(25.0, 150.0)
        if abs(turned_rad + curvature * part_m) > math.radians(60.0):
            curvature = 0.0
        for _ in range(round(part_m / SPACING_M)):
            # Bends begin and end softly enough at this spacing.
            turned_rad += curvature * SPACING_M
            x += SPACING_M * math.cos(heading_rad + turned_rad)
            y += SPACING_M * math.sin(heading_rad + turned_rad)
            points.append((x, y, heading_rad + turned_rad))
        done_m += part_m
    return points


def beside(points, left_m):
    """A line `left_m` to the left of another."""
    return [[x - left_m * math.sin(yaw), y + left_m * math.cos(yaw)] for x, y, yaw in points]


def lane(name, points, middle_m, width_m, limit_mps, successors, **more):
    """A lane whose middle is `middle_m` to the left of `points`."""
    borders = {side: beside(points, middle_m + sign * 0.5 * width_m) for side, sign in (("left", 1), ("right", -1))}
    return {"id": name, "centerline": beside(points, middle_m), **borders, "successors": successors, "speed_limit_mps": limit_mps, **more}


def curve(start, end):
    """A smooth way from one point with a heading to another."""
    (ax, ay, a_rad), (bx, by, b_rad) = start, end
    pull_m = 1.2 * math.dist((ax, ay), (bx, by)) / (1.0 + abs(math.cos(0.5 * (b_rad - a_rad))))
    count = max(round(math.dist((ax, ay), (bx, by)) / 1.0), 4)
    points = []
    for at in range(count + 1):
        t = at / count
        h00, h10, h01, h11 = 2 * t**3 - 3 * t**2 + 1, t**3 - 2 * t**2 + t, -2 * t**3 + 3 * t**2, t**3 - t**2
        points.append(
            (
                h00 * ax + h10 * pull_m * math.cos(a_rad) + h01 * bx + h11 * pull_m * math.cos(b_rad),
                h00 * ay + h10 * pull_m * math.sin(a_rad) + h01 * by + h11 * pull_m * math.sin(b_rad),
            )
        )
    headings = [math.atan2(by - ay, bx - ax) for (ax, ay), (bx, by) in zip(points, points[1:])]
    headings = [a_rad, *headings[1:], b_rad]
    return [(x, y, yaw) for (x, y), yaw in zip(points, headings)]


def crossing_roads(chance):
    """Arms around a crossing: lists of points and headings, outward."""
    while True:
        count = chance.choice([3, 4, 4])
        first_rad = chance.uniform(0.0, 2.0 * math.pi)
        quarter_rad = [0.0, 0.5 * math.pi, math.pi, 1.5 * math.pi]
        headings = [first_rad + turn + chance.uniform(-0.2, 0.2) for turn in chance.sample(quarter_rad, count)]
        from_m = chance.uniform(*CROSSING_M)
        arms = [bent_line((from_m * math.cos(a), from_m * math.sin(a)), a, chance.uniform(*ARM_M), chance) for a in sorted(headings)]
        near = min(math.dist(a[:2], b[:2]) for one in range(count) for b in arms[one][5:] for two in range(one) for a in arms[two][5:])
        if near > 18.0:
            return arms


def roads(seed):
    """A crossing and its roads, as lane JSON."""
    chance = random.Random(seed)
    arms = crossing_roads(chance)
    per_side = chance.choice([1, 1, 2])
    width_m = chance.uniform(2.9, 3.7)
    limit_mps = chance.choice([8.3, 11.1, 13.9, 16.7])
    lanes, lights = [], []
    for number, arm in enumerate(arms):
        back = [(x, y, yaw + math.pi) for x, y, yaw in reversed(arm)]
        for at in range(per_side):
            # The first lane is the one beside the middle of the road.
            neighbors = {
                "left_neighbor": at > 0 and at - 1,
                "right_neighbor": at + 1 < per_side and at + 1,
            }
            for kind, points in (("in", back), ("out", arm)):
                links = {side: f"{kind}{number}_{other}" for side, other in neighbors.items() if other is not False}
                lanes.append(lane(f"{kind}{number}_{at}", points, -(at + 0.5) * width_m, width_m, limit_mps, [], **links))
            begin = beside([back[-1]], -(at + 0.5) * width_m)[0]
            for other, target in enumerate(arms):
                if other == number:
                    continue
                turn_rad = math.remainder(target[0][2] - back[-1][2], 2.0 * math.pi)
                # Left turns from the lane in the middle, right turns from the lane outside, straight on from all.
                is_straight = abs(turn_rad) < 0.7
                if not is_straight and at != (0 if turn_rad > 0.0 else per_side - 1):
                    continue
                end = beside([target[0]], -(at + 0.5) * width_m)[0]
                name = f"turn{number}_{other}_{at}"
                way = curve((*begin, back[-1][2]), (*end, target[0][2]))
                lanes.append(lane(name, way, 0.0, width_m, limit_mps, [f"out{other}_{at}"]))
                next(one for one in lanes if one["id"] == f"in{number}_{at}")["successors"].append(name)
        length_m = [math.dist(a, b) for one in lanes if one["id"] == f"in{number}_0" for a, b in zip(one["centerline"], one["centerline"][1:])]
        lights.append({"name": f"light{number}", "stop_lines": [[f"in{number}_{at}", sum(length_m) - 2.0] for at in range(per_side)]})
    return {"version": 1, "lanes": lanes, **({"lights": lights} if chance.random() < 0.5 else {})}


#: Size of the image of the network, its focal length, pixels, and how old its earlier image is, seconds.
WIDTH_PX, HEIGHT_PX, FOCAL_PX, EARLIER_S = 160, 96, 126.0, 0.5
#: Points of a plan, and what an output stands for, meters from point to point.
POINTS, STEP_M = 16, (2.5, 0.5)
#: Channels of the convolutions, and outputs of the dense layers but the last.
CHANNELS, DENSE = (24, 32, 48, 64, 64), (128, 128)


def small_image(path):
    """The image of the network from that of a front camera of synthetic places, which looks ahead and has 65 degrees."""
    import numpy
    from PIL import Image

    image = Image.open(path).convert("RGB")
    if image.size != (320, 180):
        sys.exit(f"{path} has {image.size} pixels; expected 320x180, the default of `drive --size`")
    pixels = numpy.asarray(image, numpy.uint16)
    # Two by two pixels make one: the focal length is 252 pixels. Above and below there are three rows that the camera does not show.
    means = (pixels[::2, ::2] + pixels[1::2, ::2] + pixels[::2, 1::2] + pixels[1::2, 1::2] + 2) // 4
    return numpy.pad(means.astype(numpy.uint8), ((3, 3), (0, 0), (0, 0)))


def numbers(ego, guidance):
    """What the network is told beside images, in the order of `numbers` in engine/sim/src/planner/learned/mod.rs."""

    def clamp(value, least, most):
        return min(max(value, least), most)

    distance_m = clamp(guidance["distance_m"], -40.0, 100.0)
    return [
        clamp(ego["speed_mps"], 0.0, 40.0) / 10.0,
        clamp(ego["steer_rad"], -0.7, 0.7) / 0.3,
        clamp(ego["yaw_rate_radps"], -1.0, 1.0) / 0.3,
        clamp(guidance["cruise_mps"], 0.0, 40.0) / 10.0,
        float(guidance["turn"] == "left"),
        float(guidance["turn"] == "right"),
        clamp(guidance["angle_rad"], -3.2, 3.2),
        distance_m / 40.0,
        math.exp(-max(distance_m, 0.0) / 8.0),
        float(distance_m < 0.0),
        clamp(guidance["length_m"], 0.0, 60.0) / 20.0,
    ]


def episode_samples(plans):
    """Images, numbers, plans, and the numbers of the earlier images, of an episode whose plans are in the file `plans`."""
    import numpy

    folder = plans.parents[2] / "images" / plans.parent.name
    rows = [json.loads(line) for line in plans.read_text().splitlines()]
    rows = [row for row in rows if (folder / f"front_{row['step']:04}.png").exists()]
    images = [small_image(folder / f"front_{row['step']:04}.png") for row in rows]
    times_s = [row["time_s"] for row in rows]
    before = []
    for at, time_s in enumerate(times_s):
        while_old = [other for other in range(at + 1) if time_s - times_s[other] >= EARLIER_S - 1e-3]
        before.append(while_old[-1] if while_old else 0)
    told = [numbers(row["ego"], row["guidance"]) for row in rows]
    points = [[point[1:] for point in row["points"]] for row in rows]
    return numpy.array(images), numpy.array(told, numpy.float32), numpy.array(points, numpy.float32), numpy.array(before)


def samples(folders, jobs):
    """The samples of all episodes of the runs in `folders`, and the number of the episode of each."""
    import multiprocessing

    import numpy

    files = sorted(file for folder in folders for file in pathlib.Path(folder).glob("plans/*/plans.jsonl"))
    if not files:
        sys.exit(f"no plans/*/plans.jsonl in {', '.join(folders)}; expected runs with --images all, and `export --as plans` of their logs")
    with multiprocessing.Pool(jobs) as pool:
        episodes = [episode for episode in pool.map(episode_samples, files, chunksize=4) if len(episode[0])]
    starts = numpy.cumsum([0] + [len(episode[0]) for episode in episodes])
    images, told, points = (numpy.concatenate([episode[part] for episode in episodes]) for part in range(3))
    before = numpy.concatenate([episode[3] + start for episode, start in zip(episodes, starts)])
    numbers_of = numpy.concatenate([numpy.full(len(episode[0]), number) for number, episode in enumerate(episodes)])
    return images, told, points, before, numbers_of


def network():
    """The network of engine/sim/src/planner/learned/network.rs, for PyTorch."""
    import torch
    from torch import nn

    class Network(nn.Module):
        def __init__(self):
            super().__init__()
            channels = (6, *CHANNELS)
            convolutions = [nn.Conv2d(*pair, 3, stride=2, padding=1) for pair in zip(channels, channels[1:])]
            self.convolutions = nn.ModuleList(convolutions)
            width, height = WIDTH_PX, HEIGHT_PX
            for _ in CHANNELS:
                width, height = -(-width // 2), -(-height // 2)
            sizes = [CHANNELS[-1] * width * height, *DENSE, 2 * POINTS]
            told = [0, len(numbers({"speed_mps": 0, "steer_rad": 0, "yaw_rate_radps": 0}, NO_GUIDANCE))] + [0] * len(DENSE)
            self.dense = nn.ModuleList(nn.Linear(a + more, b) for a, b, more in zip(sizes, sizes[1:], told))

        def forward(self, images, told):
            values = images
            for convolution in self.convolutions:
                values = torch.relu(convolution(values))
            values = torch.relu(self.dense[0](values.flatten(1)))
            values = torch.cat([values, told], 1)
            for dense in self.dense[1:-1]:
                values = torch.relu(dense(values))
            steps = self.dense[-1](values).view(-1, POINTS, 2) * torch.tensor(STEP_M, device=values.device)
            return steps.cumsum(1)

    return Network()


NO_GUIDANCE = {"turn": "straight", "distance_m": 0.0, "angle_rad": 0.0, "length_m": 0.0, "cruise_mps": 0.0}


def spoiled(images):
    """Images with changes of exposure, contrast and color, noise, blur and lower resolution, half of them; the same for both images of a sample."""
    import torch
    from torch.nn import functional

    count, device = len(images), images.device

    def some(share):
        return (torch.rand(count, device=device) < share).view(-1, 1, 1, 1)

    def drawn(least, most):
        return (least + (most - least) * torch.rand(count, device=device)).view(-1, 1, 1, 1)

    values = images.float() / 255.0
    tint = 1.0 + 0.15 * torch.randn(count, 3, 1, 1, device=device)
    values = torch.where(some(0.5), values * torch.cat([tint, tint], 1), values)
    values = torch.where(some(0.5), values.clamp(1e-4).pow(torch.exp(drawn(-0.5, 0.5))), values)
    values = torch.where(some(0.5), values * torch.exp(drawn(-2.0, 0.5)), values)
    blurred = functional.avg_pool2d(values, 3, stride=1, padding=1, count_include_pad=False)
    blurred = torch.where(some(0.5), functional.avg_pool2d(blurred, 5, stride=1, padding=2, count_include_pad=False), blurred)
    values = torch.where(some(0.3), blurred, values)
    halved = functional.interpolate(functional.avg_pool2d(values, 2), scale_factor=2, mode="bilinear")
    values = torch.where(some(0.15), halved, values)
    noise = torch.randn_like(values) * torch.exp(drawn(-5.5, -1.8))
    values = torch.where(some(0.5), values + noise, values)
    return (values.clamp(0.0, 1.0) * 255.0).round()


def turned_over(images, told, points):
    """The samples in a mirror, half of them."""
    import torch

    mirror = torch.rand(len(images), device=images.device) < 0.5
    images = torch.where(mirror.view(-1, 1, 1, 1), images.flip(3), images)
    signs = torch.ones(told.shape[1], device=told.device)
    signs[[1, 2, 6]] = -1.0
    swapped = told.clone()
    swapped[:, [4, 5]] = told[:, [5, 4]]
    told = torch.where(mirror.view(-1, 1), swapped * signs, told)
    points = torch.where(mirror.view(-1, 1, 1), points * torch.tensor([1.0, -1.0], device=points.device), points)
    return images, told, points


def train(folders, out, epochs, seed, jobs, start):
    """Trains a network on the runs in `folders`, writes it, and prints its error on episodes that were held out."""
    import numpy
    import torch

    torch.manual_seed(seed)
    device = "cuda" if torch.cuda.is_available() else "cpu"
    images, told, points, before, episodes = samples(folders, jobs)
    held = torch.from_numpy(episodes % 20 == 0).to(device)
    images = torch.from_numpy(images).to(device).permute(0, 3, 1, 2).contiguous()
    told, points, before = (torch.from_numpy(values).to(device) for values in (told, points, before))
    model = network().to(device)
    if start:
        model.load_state_dict({name: value.float() for name, value in read_tensors(start).items()})
    kept, tested = (~held).nonzero()[:, 0], held.nonzero()[:, 0]
    batch = 256
    steps = epochs * (len(kept) // batch)
    optimizer = torch.optim.AdamW(model.parameters(), weight_decay=1e-3)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, 1.5e-3, total_steps=max(steps, 1) + 1)
    # Ahead errors are larger than those to the side, and far ones larger than near ones.
    times_s = torch.arange(1, POINTS + 1, device=device).view(1, -1, 1) * 0.25
    weights = torch.tensor([1.0, 3.0], device=device).view(1, 1, -1) / (0.5 + times_s)

    def batch_of(chosen):
        return torch.cat([images[chosen], images[before[chosen]]], 1), told[chosen], points[chosen]

    def inputs(pair):
        # Channels of both images of a pixel are those of the planner: newest, earlier.
        return pair.float() / 64.0 - 2.0

    def error(chosen):
        with torch.no_grad():
            found = []
            for part in chosen.split(2048):
                pair, numbers_of, _ = batch_of(part)
                found.append(model(inputs(pair), numbers_of))
            distance_m = (torch.cat(found) - points[chosen]).norm(dim=2)
        return float(distance_m[:, :12].mean())

    total, done = 0.0, 0
    for epoch in range(epochs):
        order = kept[torch.randperm(len(kept), device=device)]
        for part in order.split(batch):
            if len(part) < batch:
                continue
            pair, numbers_of, wanted = turned_over(*batch_of(part))
            # What it is told of itself is left out at times, so that it looks.
            is_told = (torch.rand(batch, 1, device=device) > 0.1).float()
            mask = torch.ones_like(numbers_of)
            mask[:, 1:3] = is_told
            loss = ((model(inputs(spoiled(pair)), numbers_of * mask) - wanted).abs() * weights).mean()
            optimizer.zero_grad(set_to_none=True)
            loss.backward()
            optimizer.step()
            schedule.step()
            total, done = total + float(loss.detach()) if done % 50 == 0 else total, done + 1
        if epoch % max(epochs // 5, 1) == 0 or epoch + 1 == epochs:
            print(f"epoch {epoch + 1} of {epochs}: mean error over 3 s of held-out episodes {error(tested):.3f} m", flush=True)
    write_tensors(model.state_dict(), out)
    print(f"{out}: {len(kept)} samples, {sum(p.numel() for p in model.parameters())} numbers")


def names():
    """Names of tensors in PyTorch and in the file."""
    pairs = [(f"convolutions.{at}", f"conv{at + 1}") for at in range(len(CHANNELS))]
    pairs += [(f"dense.{at}", f"dense{at + 1}") for at in range(len(DENSE) + 1)]
    return [(f"{here}.{part}", f"{there}.{part}") for here, there in pairs for part in ("weight", "bias")]


def write_tensors(state, path):
    """Writes a network as safetensors, in 16-bit floats."""
    header, data = {}, b""
    for here, there in names():
        values = state[here].detach().cpu().half().numpy()
        header[there] = {"dtype": "F16", "shape": list(values.shape), "data_offsets": [len(data), len(data) + values.nbytes]}
        data += values.astype("<f2").tobytes()
    head = json.dumps(header).encode()
    head += b" " * (-len(head) % 8)
    pathlib.Path(path).write_bytes(struct.pack("<Q", len(head)) + head + data)


def read_tensors(path):
    """The tensors of a file that `write_tensors` wrote, by their names in PyTorch."""
    import numpy
    import torch

    content = pathlib.Path(path).read_bytes()
    (size,) = struct.unpack("<Q", content[:8])
    header, data, found = json.loads(content[8 : 8 + size]), content[8 + size :], {}
    for here, there in names():
        begin, end = header[there]["data_offsets"]
        values = numpy.frombuffer(data[begin:end], "<f2").reshape(header[there]["shape"])
        found[here] = torch.from_numpy(values.astype(numpy.float32))
    return found


def main():
    parser = argparse.ArgumentParser(description="The network of the planner `learned`.")
    words = parser.add_subparsers(dest="word", required=True)
    making = words.add_parser("roads", help="write random roads with a crossing, as maps to learn on")
    making.add_argument("folder", type=pathlib.Path)
    making.add_argument("--count", type=int, default=24)
    making.add_argument("--seed", type=int, default=1, help="number of the first one")
    training = words.add_parser("train", help="train a network on runs of `decouplegs drive`")
    training.add_argument("runs", nargs="+")
    training.add_argument("--out", required=True, metavar="FILE.safetensors")
    training.add_argument("--start", metavar="FILE.safetensors", help="network to begin with")
    training.add_argument("--epochs", type=int, default=30)
    training.add_argument("--seed", type=int, default=1)
    training.add_argument("--jobs", type=int, default=8)
    chosen = parser.parse_args()
    if chosen.word == "roads":
        chosen.folder.mkdir(parents=True, exist_ok=True)
        for number in range(chosen.count):
            path = chosen.folder / f"roads_{number:02}.json"
            path.write_text(json.dumps(roads(chosen.seed + number)))
        print(f"{chosen.folder}: {chosen.count} maps")
    else:
        train(chosen.runs, chosen.out, chosen.epochs, chosen.seed, chosen.jobs, chosen.start)


if __name__ == "__main__":
    main()
