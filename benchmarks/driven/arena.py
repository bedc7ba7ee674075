"""The arena's goals, driven in physics: one picture with a moment of each drive.

    python -m benchmarks.driven.arena [--out docs/figures/driven_arena.png] [--films FOLDER]

Each drive follows a plan with the manual abstraction on the arena's exact map. `--films` also writes an MP4 of each.
"""

import argparse
import json
from pathlib import Path

import numpy as np
import yaml

from benchmarks.driven.runs import WEIGHT
from hdsp.planning.driving.drive_film import pictures
from hdsp.planning.driving.driven_run import Run
from hdsp.planning.margin import DRIVEN_MARGIN
from hdsp.planning.planner import Planner
from hdsp.terrain.arenas import read_arena

_PAPER = Path(__file__).parents[2] / "conf/arena/paper.yaml"
_SIZE = 400, 280  # pixels of each moment
_COLUMNS = 4


def main(argv=None) -> dict:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("docs/figures/driven_arena.png"))
    parser.add_argument("--films", type=Path, help="folder for the films")
    arguments = parser.parse_args(argv)
    description = yaml.safe_load(_PAPER.read_text())
    arena = read_arena(description)
    planner = Planner(arena.height_map(), "momaro", "manual", margin=DRIVEN_MARGIN)
    runs = []
    for number, task in enumerate(description["tasks"]):
        plan = planner.plan(task["start"], task["goal"], weight=WEIGHT, refinable=True, polish=0)
        runs.append(plan.drive(arena))
        print(f"goal {number + 1}: {runs[-1].cause}", flush=True)
        if arguments.films:
            arguments.films.mkdir(parents=True, exist_ok=True)
            runs[-1].save(arguments.films / f"goal_{number + 1}.mp4")
    sheet(runs, arguments.out)
    found = {"goals": len(runs), "arrived": sum(run.success for run in runs)}
    print(json.dumps(found))
    return found


def sheet(runs: list[Run], path: Path) -> None:
    """Draws a moment of each drive: amid its steps, else its middle."""
    from PIL import Image

    rows = -(-len(runs) // _COLUMNS)
    whole = Image.new("RGB", (_COLUMNS * _SIZE[0], rows * _SIZE[1]), "white")
    for number, run in enumerate(runs):
        place = number % _COLUMNS * _SIZE[0], number // _COLUMNS * _SIZE[1]
        whole.paste(_moment(run), place)
    whole.quantize(128).save(path, optimize=True)


def _moment(run: Run):
    steps = np.flatnonzero(~run.motion.carries.all(axis=1))
    row = steps[len(steps) // 2] if len(steps) else len(run.motion) // 2
    return next(pictures(run, [int(row)], _SIZE))


if __name__ == "__main__":
    main()
