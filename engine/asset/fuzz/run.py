#!/usr/bin/env python3
"""Runs every fuzz target for a time, and says what was found.

Needs cargo-fuzz (`cargo install cargo-fuzz`); `make fuzz` installs it. Exit code 0: nothing was found. 1: a target found
something, whose input is named. 2: usage.
"""

import argparse
import concurrent.futures
import os
import pathlib
import re
import shutil
import subprocess
import sys

FUZZ = pathlib.Path(__file__).resolve().parent

# Targets whose seeds lie in the folder of another one.
SEEDS = {
    "spz_round_trip": "inria_ply",
    "checkpoint_structure": None,
    "zip_structure": None,
    "glb_structure": None,
}

# Memory that a process may take, megabytes: readers refuse what would need more, and libFuzzer keeps its corpus beside them.
MEMORY_MB = 4096

# Seconds that one input may take.
INPUT_S = 25


class Result:
    """The result of a target: runs, seconds, and its last output where it failed."""

    def __init__(self, target, code, text):
        done = re.search(r"Done (\d+) runs in (\d+) second", text)
        counted = re.findall(r"^#(\d+)", text, re.MULTILINE)
        self.target = target
        self.runs = int(done[1]) if done else int(counted[-1]) if counted else 0
        self.seconds = int(done[2]) if done else 0
        self.failed = code != 0
        self.text = text

    def finding(self):
        """The file of the input that failed, or the end of the text where none was written."""
        written = re.findall(r"Test unit written to (\S+)", self.text)
        return written[-1] if written else self.text.strip()[-400:]


def environment():
    """The stable compiler takes what fuzzing needs with this variable."""
    return {**os.environ, "RUSTC_BOOTSTRAP": "1"}


def targets():
    """Names of the targets, in the order of the manifest."""
    manifest = (FUZZ / "Cargo.toml").read_text()
    return re.findall(r'\[\[bin\]\]\nname = "(\w+)"', manifest)


def build(name):
    """Builds all targets, or the one called `name`, and returns the folder of the programs."""
    command = ["cargo", "fuzz", "build", "--sanitizer", "none", "--fuzz-dir", str(FUZZ), *([name] if name else [])]
    if subprocess.run(command, cwd=FUZZ.parent, env=environment()).returncode:
        sys.exit("the fuzz targets could not be built (cargo-fuzz is needed: cargo install cargo-fuzz)")
    target = pathlib.Path(os.environ.get("CARGO_TARGET_DIR", FUZZ / "target"))
    folders = sorted(target.glob("*/release"), key=lambda folder: folder.stat().st_mtime)
    programs = [folder for folder in folders if (folder / (name or targets()[0])).is_file()]
    if not programs:
        sys.exit(f"the fuzz targets were built, and are not in {target}/*/release")
    return programs[-1]


def run(program, out, seconds, runs):
    """Runs one target with its seeds, and keeps its inputs under `out`."""
    name = program.name
    corpus, found = out / "corpus" / name, out / "found" / name
    corpus.mkdir(parents=True, exist_ok=True)
    found.mkdir(parents=True, exist_ok=True)
    seeds = FUZZ / "seeds" / (SEEDS.get(name, name) or "none")
    folders = [str(folder) for folder in (corpus, seeds) if folder.is_dir()]
    # A run of a few inputs has no limit of time: what it counts does not depend on the machine.
    limits = [f"-runs={runs}"] if runs else [f"-max_total_time={seconds}"]
    command = [str(program), *folders, *limits, f"-rss_limit_mb={MEMORY_MB}", f"-timeout={INPUT_S}", f"-artifact_prefix={found}/"]
    said = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors="replace")
    return Result(name, said.returncode, said.stdout)


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("target", nargs="*", help="targets to run (default: all)")
    parser.add_argument("--seconds", type=int, default=60, help="time for each target (default 60)")
    parser.add_argument("--runs", type=int, help="number of inputs for each target, instead of a time")
    parser.add_argument("--jobs", type=int, default=os.cpu_count(), help="targets that run side by side (default: one for each core)")
    parser.add_argument("--out", type=pathlib.Path, default=FUZZ, help="folder of the inputs: corpus/TARGET, and found/TARGET for those that fail (default: this folder)")
    options = parser.parse_args()
    unknown = set(options.target) - set(targets())
    if unknown:
        parser.error(f"there is no target {', '.join(sorted(unknown))}; there are {', '.join(targets())}")
    if shutil.which("cargo") is None:
        sys.exit("cargo is not in the path")
    chosen = options.target or targets()
    folder = build(chosen[0] if len(chosen) == 1 else None)
    results = []
    with concurrent.futures.ThreadPoolExecutor(max(options.jobs, 1)) as pool:
        asked = [pool.submit(run, folder / name, options.out, options.seconds, options.runs) for name in chosen]
        for number, future in enumerate(concurrent.futures.as_completed(asked), 1):
            result = future.result()
            results.append(result)
            state = f"FOUND {result.finding()}" if result.failed else "nothing found"
            print(f"{number}/{len(chosen)} {result.target}: {result.runs} runs, {state}", flush=True)
    found = [result for result in results if result.failed]
    total = sum(result.runs for result in results)
    print(f"{len(results)} targets, {total} runs, {len(found)} with findings")
    sys.exit(1 if found else 0)


if __name__ == "__main__":
    main()
