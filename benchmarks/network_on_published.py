"""Agreement between a trained network and labels in the published format, task by task.

    python -m benchmarks.network_on_published FILE [--model momaro | FOLDER] [--maps]

FILE has the authors' text format, complete or in part. The benchmark prints one JSON line: for all maps and for flat,
driving and stairs maps, the number of maps and tasks, the feasibility accuracy, and the mean absolute cost error over
tasks that labels and network judge feasible; and the expected calibration error over all maps. With --maps it also
prints one line per map.

Map numbers in the authors' file decide the terrain kind, flat, driving or stairs (``hdsp.labels.published_tasks``).
"""

import argparse
import json
import sys

import numpy as np

from hdsp.base.errors import InputError
from hdsp.labels.published_tasks import read_published, terrain_kind
from hdsp.learning.calibration import reliability
from hdsp.learning.loading import load_abstraction

KINDS = ("flat", "driving", "stairs")


def main(argv: list[str] | None = None) -> dict:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("file")
    parser.add_argument("--model", default="momaro", help="shipped abstraction, or a folder")
    parser.add_argument("--maps", action="store_true", help="print a line for each map")
    arguments = parser.parse_args(argv)
    try:
        abstraction, tasks = load_abstraction(arguments.model), read_published(arguments.file)
    except InputError as error:
        sys.exit(f"error: {error}")
    probability, cost = abstraction.predict_probability(tasks.heights, tasks.goals)
    judged, _ = abstraction.predict(tasks.heights, tasks.goals)
    kinds = np.array([terrain_kind(int(number)) for number in tasks.index])
    everything = np.ones(len(tasks), bool)
    if arguments.maps:
        for row, number in enumerate(tasks.index):
            only = np.arange(len(tasks)) == row
            figures = scores(judged[only], cost[only], tasks.feasible[only], tasks.cost[only])
            print(f"map {number:3d} {kinds[row]:8s} {json.dumps(figures)}")
    groups = {"all": everything, **{kind: kinds == kind for kind in KINDS}}
    result: dict = {"model": arguments.model, "architecture": abstraction.model.architecture}
    for name, maps in groups.items():
        result[name] = scores(judged[maps], cost[maps], tasks.feasible[maps], tasks.cost[maps])
    result["ece"] = round(reliability(probability, tasks.feasible).error, 6)
    print(json.dumps(result))
    return result


def scores(judged: np.ndarray, cost: np.ndarray, feasible: np.ndarray, labelled_cost: np.ndarray) -> dict:
    """Figures for some maps; arrays [n, 22]. A mean without tasks is None."""
    both = judged & feasible
    return {
        "maps": len(judged),
        "tasks": int(judged.size),
        "feasibility_accuracy": round(float((judged == feasible).mean()), 6) if judged.size else None,
        "cost_error": round(float(np.abs(cost - labelled_cost)[both].mean()), 6) if both.any() else None,
    }


if __name__ == "__main__":
    main()
