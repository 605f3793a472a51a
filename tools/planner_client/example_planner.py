"""A planner to start from: straight on at its speed, slower in the dark.

Run it with `--planner "exec:python3 tools/planner_client/example_planner.py"`.
"""

import decouplegs_planner

#: Below this mean brightness, 0 to 1, it is dark.
DARK = 0.25
#: How hard it brakes in the dark, m/s^2, and to what share of the cruising speed.
BRAKE_MPS2 = 2.0
DARK_SHARE = 0.4


def brightness(frame: decouplegs_planner.Frame) -> float:
    """Mean luma (Rec. 709) of an image, 0 to 1."""
    pixels = frame.width_px * frame.height_px
    red, green, blue = (sum(frame.rgba[channel::4]) for channel in range(3))
    return (0.2126 * red + 0.7152 * green + 0.0722 * blue) / (255.0 * pixels)


class SlowInTheDark(decouplegs_planner.Planner):
    """Looks at how bright the road is, and at nothing else."""

    name = "slow-in-the-dark"
    cameras = "front"

    def begin(self, briefing):
        self.is_dark = False

    def plan(self, observation):
        # A step without images looks as the one before did.
        for frame in observation.frames.values():
            self.is_dark = brightness(frame) < DARK
        speed_mps, x_m, points = observation.ego.speed_mps, 0.0, []
        slowest_mps = min(speed_mps, DARK_SHARE * observation.guidance.cruise_mps)
        for i in range(1, 17):
            next_mps = max(slowest_mps, speed_mps - 0.25 * BRAKE_MPS2) if self.is_dark else speed_mps
            x_m += 0.25 * 0.5 * (speed_mps + next_mps)
            speed_mps = next_mps
            points.append((0.25 * i, x_m, 0.0))
        return points


if __name__ == "__main__":
    decouplegs_planner.run(SlowInTheDark)
