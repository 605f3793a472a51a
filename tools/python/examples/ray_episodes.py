"""A campaign on a Ray cluster: actors that hold a device each, by its UUID, drive episodes or draw images.

    pip install './tools/python[gym]' ray
    python ray_episodes.py --out runs --episodes 200 --level hard --actors 8       # or --devices uuid:...,uuid:...
    python ray_episodes.py --out runs --episodes 10000 --devices assigned --actors 8 --address auto    # a cluster: Ray gives each a GPU
    python ray_episodes.py --out runs --images 10 --actors 4                       # images a second against the number of actors

Each actor drives one episode at a time and writes its result itself, under a name that only the episode decides. An actor that
dies (its device was lost, its machine went away) costs the episode that it was driving: another actor takes its place, and the
episode is driven again, at most --retries times. A device whose actors died as often in a row is left out. campaign.json says which
device drove how many episodes, and each result which device it was. Start the same command again to go on where it stopped.
"""

import argparse
import collections
import json
import os
import pathlib
import time

import ray

from episodes import Driver, add_arguments, assigned, devices_of, drill, result_path, write_result


@ray.remote(max_restarts=0)
class Actor:
    """A process with a device of its own."""

    def __init__(self, options: argparse.Namespace, device: str) -> None:
        self.options = options
        self.driver = Driver(options, assigned()[0] if device == "assigned" else device)

    def drive(self, seed: int) -> str:
        """Drives an episode unless its result is there; where the result is."""
        path = result_path(self.options, seed)
        if not path.exists():
            write_result(path, self.driver.drive(seed, lambda step: drill(self.options, seed, step)))
        return str(path)

    def draw(self, seconds: float) -> tuple[int, float]:
        """How many images of the episode 0 it drew in so many seconds."""
        env, images = self.driver.env, 0
        env.reset(seed=0)
        view = [env.drive.view()]
        since = time.perf_counter()
        while time.perf_counter() - since < seconds:
            env.course.renderer.draw(view)
            images += 1
        return images, time.perf_counter() - since

    def ready(self) -> str:
        """The device, once everything is on it."""
        return self.driver.session.device.uuid


def actor_on(options: argparse.Namespace, device: str):
    """An actor on the device; on one that Ray assigns where it is `assigned`."""
    return Actor.options(num_gpus=1 if device == "assigned" else 0).remote(options, device)


def campaign(options: argparse.Namespace, devices: list[str]) -> dict:
    """Drives all episodes whose results are missing; what happened."""
    waiting = collections.deque(seed for seed in range(options.episodes) if not result_path(options, seed).exists())
    there, tries = options.episodes - len(waiting), collections.Counter()
    lost, given_up, running = [], {}, {}
    # Devices by their place in the list, as one may be named for several actors; how often each failed in a row.
    idle = [(actor_on(options, device), place) for place, device in enumerate(devices[: len(waiting)])]
    failed, left_out, drove = collections.Counter(), [], collections.Counter()
    while waiting or running:
        while waiting and idle:
            actor, place = idle.pop()
            seed = waiting.popleft()
            tries[seed] += 1
            running[actor.drive.remote(seed)] = (actor, place, seed)
        if not running:
            given_up.update({seed: "no device is left" for seed in waiting})
            break
        [done], _ = ray.wait(list(running), num_returns=1)
        actor, place, seed = running.pop(done)
        try:
            path = ray.get(done)
            print(path)
            drove[json.loads(pathlib.Path(path).read_text())["device"]] += 1
            failed[place] = 0
            idle.append((actor, place))
        except ray.exceptions.RayError as error:
            print(f"episode {seed}, try {tries[seed]}: {type(error).__name__}: {str(error).splitlines()[0]}")
            lost.append(seed)
            ray.kill(actor)
            failed[place] += 1
            if failed[place] <= options.retries:
                idle.append((actor_on(options, devices[place]), place))
            else:
                left_out.append(devices[place])
                # The fault was the device's: the episode has its tries on others.
                tries[seed] = 0
            if tries[seed] <= options.retries:
                waiting.append(seed)
            else:
                given_up[seed] = str(error).splitlines()[-1]
    return {"episodes": options.episodes, "there_before": there, "lost": lost, "given_up": given_up, "by_device": dict(drove), "left_out": left_out}


def images(options: argparse.Namespace, devices: list[str]) -> list[dict]:
    """Images a second of 1, 2, 4, ... actors at once."""
    table, count = [], 1
    actors = [actor_on(options, device) for device in devices]
    ray.get([actor.ready.remote() for actor in actors])
    while count <= len(actors):
        drawn = ray.get([actor.draw.remote(options.images) for actor in actors[:count]])
        rate = sum(images / seconds for images, seconds in drawn)
        table.append({"actors": count, "images_per_s": round(rate, 1), "size": options.size})
        print(f"{count:3} actors: {rate:8.1f} images/s of {options.size}")
        count *= 2
    return table


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    add_arguments(parser)
    parser.add_argument("--actors", type=int, help="how many actors (default: one a device)")
    parser.add_argument("--devices", default="all", help="UUIDs, separated by commas; assigned: Ray gives each actor a GPU (default: all of this machine but software ones, if there are others)")
    parser.add_argument("--address", help="of a Ray cluster (default: one on this machine, for this run)")
    parser.add_argument("--retries", type=int, default=2, help="how often an episode is driven again when its actor died (default 2)")
    parser.add_argument("--images", type=float, metavar="SECONDS", help="draw for so long instead, and count")
    parser.add_argument("--drill", type=int, metavar="SEED", help="let the actor that drives this episode die in the middle of it, once")
    options = parser.parse_args()
    options.out = options.out.absolute()
    options.out.mkdir(parents=True, exist_ok=True)

    found = ["assigned"] if options.devices == "assigned" else devices_of(options.devices)
    if not found:
        parser.error("no Vulkan device was found on this machine: install a driver, or name devices of the cluster with --devices")
    count = options.actors or len(found)
    devices = [found[index % len(found)] for index in range(count)]

    ray.init(address=options.address, num_cpus=None if options.address else max(count, os.cpu_count() or 1), include_dashboard=False, log_to_driver=False)
    try:
        done = images(options, devices) if options.images else campaign(options, devices)
    finally:
        ray.shutdown()
    summary = options.out / ("images.json" if options.images else "campaign.json")
    write_result(summary, done)
    print(json.dumps(done))
    if not options.images and done["given_up"]:
        raise SystemExit(1)


if __name__ == "__main__":
    main()
