"""Attacks by files: damaged ones, lying ones, and places where nothing can be written."""

import json
import os
import random
import shutil

from judge import end_of

# What stands for a number in a file of text, and breaks what trusts it.
NUMBERS = ["-1", "0", "1e308", "-1e308", "NaN", "nan", "inf", "1e-320", "4294967296", "18446744073709551616", "-9223372036854775808", "0x7f", "1e5"]


def damaged(random_source, data):
    """A copy of `data` with a fault: bits, a cut, a repetition, or a number."""
    data = bytearray(data)
    kind = random_source.randrange(6)
    at = random_source.randrange(len(data))
    if kind == 0:
        for _ in range(random_source.choice([1, 4, 64])):
            data[random_source.randrange(len(data))] ^= 1 << random_source.randrange(8)
    elif kind == 1:
        del data[at:]
    elif kind == 2:
        length = random_source.choice([1, 2, 4, 8, 100])
        data[at : at + length] = random_source.choice([b"\xff", b"\x00", b"\x7f", b"\x80"]) * length
    elif kind == 3:
        end = min(len(data), at + random_source.choice([1, 16, 256, 4096]))
        data[at:at] = data[at:end] * random_source.choice([1, 8])
    elif kind == 4:
        del data[at : at + random_source.choice([1, 2, 3, 16, 300])]
    else:
        digits = [place for place, byte in enumerate(data) if 48 <= byte <= 57]
        if digits:
            place = random_source.choice(digits)
            end = place
            while end < len(data) and (48 <= data[end] <= 57 or data[end] in b".eE+-"):
                end += 1
            data[place:end] = random_source.choice(NUMBERS).encode()
    return bytes(data)


def readers(street):
    """Commands that read a kind of file: name of the kind, a good file, and the words of the command for a path."""
    seeds = street.seeds
    splats = ["inria_ply/cone.ply", "splat/cone.splat", "sog/cone.sog", "compressed_ply/cone.compressed.ply", "coded_asset/cone.safetensors", "khr_glb/cone.glb"]
    splats += [f"spz/cone.v{version}.spz" for version in (1, 2, 3, 4)]
    for name in splats:
        yield name, seeds / name, lambda path: ["inspect", path]
    yield "splats to another format", seeds / "inria_ply/cone.ply", lambda path: ["convert", path, path.with_name("out.spz"), "--force"]
    yield "checkpoint", seeds / "checkpoint/cone.pt", lambda path: ["inspect", path]
    for name in ("drivestudio.pth", "street_gaussians.pth"):
        yield name, seeds / "scene_import" / name, lambda path: ["convert", path, path.with_name("scene"), "--force"]
    for name in ("open_drive/three_lanes.xodr", "open_drive/crossing.xodr", "lanelet2/two.osm", "commonroad/2020a.xml", "lane_json/three.json", "argoverse2/log_map_archive_two.json"):
        yield name, seeds / name, lambda path: ["map", path]
    for name in ("two.csv", "two.json"):
        yield f"track_table/{name}", seeds / "track_table" / name, lambda path: ["map", street.lanes, "--tracks", path]
    yield "scene file", street.scene, lambda path: ["inspect", path]
    yield "episode log", seeds / "episode_log/small.log", lambda path: ["score", path]
    # A model of a LiDAR is named in a scene by its path.
    yield "model of a LiDAR", seeds / "lidar/vlp32c.toml", lambda path: ["lidar", street.scene, "--lidar", path, "--out", path.with_name("points"), "--force"]
    drive = ["drive", "--scene", street.scene, "--map", street.lanes, "--render", "off", "--planner", "constant-velocity", "--force"]
    yield "obstacles", street.obstacles, lambda path: [*drive, "--level", "easy", "--episodes", "1", "--obstacles", path, "--out", path.with_name("run")]
    for name in ("cut_in.xosc",):
        yield f"open_scenario/{name}", seeds / "open_scenario" / name, lambda path: [*drive, path, "--out", path.with_name("run")]
    for name in ("example.toml", "story.toml"):
        yield f"scenario_file/{name}", seeds / "scenario_file" / name, lambda path: [*drive, path, "--out", path.with_name("run")]


def mutate(street, table, tries, seed):
    """Damages a file of each kind, and reads it."""
    for kind, good, words in readers(street):
        # Each kind by itself: others that are added change nothing.
        random_source = random.Random(f"{seed} {kind}")
        data = good.read_bytes()
        for number in range(tries):
            folder = street.out / "mutated"
            shutil.rmtree(folder, ignore_errors=True)
            folder.mkdir(parents=True)
            path = folder / good.name
            path.write_bytes(damaged(random_source, data))
            end = end_of([street.program, *words(path)])
            table.judge("damaged files", f"{kind}, try {number} of seed {seed}", end.fault())
            if end.fault():
                kept = street.out / "found" / f"{kind.replace('/', '_').replace(' ', '_')}_{number}{path.suffix}"
                kept.parent.mkdir(parents=True, exist_ok=True)
                shutil.copy2(path, kept)


def lies(street, table):
    """Small files that claim to be large, or say the impossible."""
    box = {"center_m": [0, 0, 0], "length_m": 1000, "width_m": 1000, "height_m": 1, "yaw_rad": 0}
    cases = {
        "obstacles.json": json.dumps({"version": 1, "obstacles": [box] * 5000}),
        "nested.json": "[" * 200_000,
        "long.csv": "x" * 2_000_000,
        "header.ply": "ply\nformat binary_little_endian 1.0\nelement vertex 4294967295\nproperty float x\nproperty float y\nproperty float z\nend_header\n",
        "zeros.spz": "\0" * 100_000,
        "empty.glb": "glTF\x02\0\0\0\xff\xff\xff\x7f",
        "attributes.xodr": "<OpenDRIVE " + " ".join(f'a{i}=""' for i in range(100_000)) + "/>",
        "deep.osm": "<osm>" + "<a>" * 100_000,
        "name\u202etxt.ply": "ply\n",
        "name\x1b[31m.toml": "version = 1\n",
        "scene.toml": 'version = 1\nbackground = "/dev/zero"\n',
        "climbing.toml": 'version = 1\nbackground = "../../../../etc/passwd"\n',
    }
    folder = street.out / "lies"
    folder.mkdir(parents=True, exist_ok=True)
    drive = ["drive", "--level", "easy", "--episodes", "1", "--scene", street.scene, "--map", street.lanes, "--render", "off", "--planner", "constant-velocity", "--force"]
    for name, text in cases.items():
        path = folder / name
        path.write_bytes(text.encode("latin-1") if text.isascii() or name.endswith((".glb", ".spz")) else text.encode())
        commands = [["inspect", path], ["convert", path, folder / "out.ply", "--force"], ["map", path], ["score", path], ["view", path, "--port", "0"]]
        commands += [[*drive, "--obstacles", path, "--out", folder / "run"], ["map", street.lanes, "--tracks", path]]
        for words in commands:
            end = end_of([street.program, *words])
            fault = end.fault() or ("it was taken for good" if end.code == 0 and words[0] != "map" else None)
            table.judge("files that lie", f"{words[0]} {name!r}", fault)


def places(street, table):
    """Outputs where nothing can be written, and those that would replace what they should not."""
    folder = street.out / "places"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    source = shutil.copy2(street.seeds / "inria_ply/cone.ply", folder / "cone.ply")
    before = (folder / "cone.ply").read_bytes()
    (folder / "there.spz").write_bytes(b"mine")
    (folder / "link.spz").symlink_to(folder / "elsewhere.spz")
    (folder / "folder.spz").mkdir()
    (folder / "file").write_bytes(b"mine")
    refused = ["there.spz", "folder.spz", "file/out.spz", "cone.ply", "no.format", "."]
    for name in refused:
        end = end_of([street.program, "convert", source, folder / name])
        table.judge("outputs", name, end.fault() or ("it was written" if end.code == 0 else None))
    end_of([street.program, "convert", source, folder / "link.spz", "--force"])
    # A link is what a person made it: it is written through, and stays.
    kept = (folder / "link.spz").is_symlink() and (folder / "elsewhere.spz").is_file()
    table.judge("outputs", "through a link", None if kept else "the link was replaced")
    table.judge("outputs", "the input is as it was", None if (folder / "cone.ply").read_bytes() == before else "it changed")
    table.judge("outputs", "what was there is as it was", None if (folder / "there.spz").read_bytes() == b"mine" else "it was replaced")
    litter = [name for name in os.listdir(folder) if name.startswith(".")]
    table.judge("outputs", "nothing is left", f"left: {litter}" if litter else None)


def full_disk(street, table):
    """Commands whose outputs find no room."""
    folder = street.out / "full"
    for number, (words, file_bytes) in enumerate((words, size) for words in street.writers(folder) for size in (0, 1000, 20_000)):
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        end = end_of([street.program, *words], file_bytes=file_bytes)
        fault = end.fault()
        # What was written under its own name is whole, or not there.
        litter = [name for name in os.listdir(folder) if name.startswith(".writing-")]
        fault = fault or (f"left: {litter}" if litter and end.code else None)
        table.judge("full disks", f"{words[0]} with files of {file_bytes} bytes at most, {number}", fault)
