"""Plans driven in physics: shares of plans along which a simulated robot arrives, by kind of ground.

    python -m benchmarks.driven [--count 20] [--ways 44] [--seed 0] [--robot momaro] [--kinds flat,stairs,...]
                                [--slopes] [--jobs 1] [--folder outputs/driven] [--page docs/driving.md]

Kinds: `flat`, `stairs` (2 to 3 steps, up and down), `blocks` to step onto, `ramps` up to 2 degrees below the robot's
limit, `doors`, `clutter`, and `places`: scans of real places as height fields. Planning uses a map with 1 cm of noise
in each cell, conditioned as every measured map. The drive is on the true ground (`hdsp.planning.driving`). A task
depends on seed, kind and number alone; tasks without a plan do not count, and other tasks take their places. Each task
writes a file into the folder, so an interrupted run continues; results of other code need another folder.

One JSON line comes last. `driven` is the share of tasks, by kind, whose robot arrives within 10 cm and 10 degrees,
without a fall, without contact of the body, and without more than 5 cm slip of a standing foot; `all` is their mean
over all tasks. `causes` counts the ends of the other drives. `realtime` is simulated time over CPU time on one core.
`rank_correlation` compares cost and energy over `--ways` pairs of ways between the same poses
(`benchmarks.driven.ways`): concordant minus discordant pairs, over all pairs (`pairs`). With `--slopes`, `slope` is the
steepest ground, in degrees, that each preset plans and that it drives. `--page` writes tables into the page, and their
picture beside it.
"""

import argparse
import json
from pathlib import Path

from benchmarks.driven.runs import WAYS, run_all
from benchmarks.driven.slope_limits import slope_limits
from benchmarks.driven.summary import draw, summarise, text
from benchmarks.driven.tasks import KINDS
from benchmarks.page import write_block
from hdsp.base.errors import InputError
from hdsp.robot.robot import Robot


def main(argv=None) -> dict:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=20, help="tasks of each kind")
    parser.add_argument("--ways", type=int, default=0, help="tasks with two ways between the same poses")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--robot", default="momaro", help="preset or YAML file")
    parser.add_argument("--kinds", default=",".join(KINDS), help="kinds, separated by commas")
    parser.add_argument("--slopes", action="store_true", help="also the steepest ground that each preset drives")
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    parser.add_argument("--folder", type=Path, default=Path("outputs/driven"), help="folder for the results of tasks")
    parser.add_argument("--page", type=Path, help="docs page to update")
    arguments = parser.parse_args(argv)
    kinds = arguments.kinds.split(",") if arguments.kinds else []
    if unknown := [kind for kind in kinds if kind not in KINDS]:
        raise InputError(f"--kinds {unknown[0]}: need some of {', '.join(KINDS)}")
    arguments.folder.mkdir(parents=True, exist_ok=True)
    robot = Robot.load(arguments.robot)
    counts = dict.fromkeys(kinds, arguments.count) | ({WAYS: arguments.ways} if arguments.ways else {})
    results = run_all(counts, arguments.seed, robot, arguments.folder, arguments.jobs)
    summary = summarise(robot.name, arguments.seed, results)
    if arguments.slopes:
        summary["slope"] = {name: slope_limits(Robot.load(name)) for name in Robot.presets()}
    if arguments.page:
        picture = arguments.page.parent / "figures" / "driven_energy.png"
        draw(results, picture)
        write_block(arguments.page, "benchmarks.driven", text(summary, picture.name))
    print(json.dumps(summary))
    return summary


if __name__ == "__main__":
    main()
