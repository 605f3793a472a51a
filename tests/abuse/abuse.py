#!/usr/bin/env python3
"""Attacks the programs as strangers, broken disks and rude neighbors do, and counts what was found.

Needs a build (`cargo build --workspace`), nothing from the network. Exit code 0: nothing was found. 1: findings, each with its input.
2: usage.
"""

import argparse
import pathlib
import subprocess
import sys

import files
import processes
from judge import Table, end_of

ROOT = pathlib.Path(__file__).resolve().parents[2]


class Street:
    """A small street to attack with, and the program that reads it."""

    def __init__(self, program, out):
        self.program = program
        self.out = out
        self.seeds = ROOT / "engine/asset/fuzz/seeds"
        self.folder = out / "street"
        self.scene = self.folder / "scene.toml"
        self.lanes = self.folder / "lanes.json"
        self.obstacles = out / "obstacles.json"
        self.splats = self.folder / "background.ply"
        words = ["synth", "street", "--background", "3000", "--agents", "2", "--agent-splats", "300", "--degree", "0", "--seed", "3", "--size", "96x54", "--movable", "--force", "--out", self.folder]
        end = end_of([program, *words])
        if end.code != 0:
            sys.exit(f"{program} could not make a street: {end.said}")
        self.obstacles.write_text('{"version": 1, "obstacles": [{"center_m": [60, 12, 0.5], "length_m": 2, "width_m": 1, "height_m": 1, "yaw_rad": 0.3}]}\n')

    def writers(self, folder):
        """Commands that write into `folder`."""
        cone = self.seeds / "inria_ply/cone.ply"
        return [
            ["convert", cone, folder / "cone.spz"],
            ["convert", cone, folder / "cone.sog"],
            ["compress", cone, "--out", folder / "cone.safetensors", "--seed", "1"],
            ["synth", "street", "--background", "2000", "--agents", "1", "--agent-splats", "200", "--degree", "0", "--seed", "4", "--size", "64x36", "--out", folder / "street"],
            ["map", self.lanes, "--svg", folder / "lanes.svg"],
            ["drive", "--level", "easy", "--episodes", "3", "--scene", self.scene, "--map", self.lanes, "--render", "off", "--planner", "lane-follow", "--out", folder / "run"],
        ]

    def again(self, words):
        """Words for a run after one that was killed: `drive` resumes its own folder."""
        return [] if words[0] == "drive" else ["--force"]


GROUPS = {
    "damaged": lambda street, table, options: files.mutate(street, table, options.tries, options.seed),
    "lies": lambda street, table, options: files.lies(street, table),
    "outputs": lambda street, table, options: files.places(street, table),
    "disks": lambda street, table, options: files.full_disk(street, table),
    "kills": lambda street, table, options: processes.kills(street, table, max(options.tries // 4, 1), options.seed),
    "planners": lambda street, table, options: processes.planners(street, table),
    "viewer": lambda street, table, options: processes.viewer(street, table, options.tries, options.seed),
    "server": lambda street, table, options: processes.server(street, table, options.tries, options.seed),
}


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("group", nargs="*", help=f"groups of attacks: {', '.join(GROUPS)} (default: all)")
    parser.add_argument("--program", type=pathlib.Path, required=True, help="the program decouplegs, beside those that it runs")
    parser.add_argument("--out", type=pathlib.Path, default=ROOT / "out/abuse", help="folder for the files of the attacks (default out/abuse)")
    parser.add_argument("--tries", type=int, default=20, help="tries of each random attack (default 20)")
    parser.add_argument("--seed", type=int, default=1, help="seed of random attacks (default 1)")
    parser.add_argument("--verbose", action="store_true", help="print each try")
    options = parser.parse_args()
    unknown = set(options.group) - set(GROUPS)
    if unknown:
        parser.error(f"there is no group {', '.join(sorted(unknown))}; there are {', '.join(GROUPS)}")
    options.out.mkdir(parents=True, exist_ok=True)
    street = Street(options.program.resolve(), options.out.resolve())
    table = Table(options.verbose)
    chosen = [name for name in GROUPS if name in options.group or not options.group]
    for number, name in enumerate(chosen, 1):
        print(f"{number}/{len(chosen)} {name}", flush=True)
        GROUPS[name](street, table, options)
    print(table.text())
    sys.exit(1 if table.findings else 0)


if __name__ == "__main__":
    main()
