"""Tells what it got of its localization, as places of a plan."""

import os
import sys

sys.path.insert(0, os.path.join(os.path.dirname(__file__), "../../tools/planner_client"))
import decouplegs_planner  # noqa: E402


class Route(decouplegs_planner.Planner):
    name, localization = "route", True

    def plan(self, observation):
        assert observation.privileged is None
        known = observation.localization
        now = known.path[-1]
        told = [len(known.path), now.time_s, *now.position_m, *now.rotation_wxyz, now.yaw_rad, now.speed_mps,
                now.acceleration_mps2, now.yaw_rate_radps, len(known.route_m), *known.route_m[-1]]
        return [(1.0 + i, 0.0, value) for i, value in enumerate(told)]


if __name__ == "__main__":
    decouplegs_planner.run(Route)
