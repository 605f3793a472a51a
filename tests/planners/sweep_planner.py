"""Planner that returns its input, points of a sweep and numbers of its LiDAR, as waypoints."""

import os
import struct
import sys

sys.path.insert(0, os.path.join(os.path.dirname(__file__), "../../tools/planner_client"))
import decouplegs_planner  # noqa: E402


class Points(decouplegs_planner.Planner):
    name, cameras, lidars = "points", "front", "all"

    def begin(self, briefing):
        self.lidar = briefing.lidars[0]

    def plan(self, observation):
        sweep = observation.sweeps[self.lidar["name"]]
        assert len(sweep.points) == sweep.count * sweep.POINT_BYTES
        points = [struct.unpack_from("<4fI2H", sweep.points, 24 * index) for index in range(sweep.count)]
        values = [(self.lidar["rings"], self.lidar["sweep_s"]), (sum(observation.frames["front"].rgba) % 1000, sweep.count)]
        for x, y, z, intensity, offset_ns, ring, laser in points:
            values += [(x, y), (z, intensity), (1e-6 * offset_ns, 10 * ring + laser)]
        return [(1.0 + index, *place) for index, place in enumerate(values)]


if __name__ == "__main__":
    decouplegs_planner.run(Points)
