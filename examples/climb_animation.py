"""The animation in the README: Momaro climbs a staircase.

    python -m examples.climb_animation [--out docs/figures/climb.gif] [--width 640]

The command plans, refines and animates the climb, and prints one line of JSON.
"""

import argparse
import json
from pathlib import Path

from examples.climbing import DOCS, Task, platform
from hdsp import Planner

#: Stairs up to a platform.
CLIMB = Task(
    "up a staircase of 3 x 0.2 m", (3.8, 1.8), platform(1.35, 0.9, steps=3, rise=0.2, tread=0.3, top=6.0, width=1.4),
    (0.75, 0.9, 0.0), (2.75, 0.9, 0.0),
)  # fmt: skip
SHOWN = 11.0  # s


def main(argv=None) -> dict:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=DOCS / "figures" / "climb.gif", help=".gif or .mp4")
    parser.add_argument("--width", type=int, default=640, help="pixels")
    arguments = parser.parse_args(argv)
    plan = Planner(CLIMB.terrain(), heuristic="manual").plan(
        CLIMB.start, CLIMB.goal, weight=1.25, refinable=True, polish=0
    )
    motion = plan.refine()
    path = motion.animate(arguments.out, speed=round(motion.duration / SHOWN), width=arguments.width)
    result = {
        "file": path.name,
        "bytes": path.stat().st_size,
        "steps": plan.steps,
        "duration_s": round(motion.duration, 1),
        "words": plan.explain(),
    }
    print(json.dumps(result))
    return result


if __name__ == "__main__":
    main()
