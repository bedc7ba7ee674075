"""The headline numbers of the README: shipped and manually tuned abstraction beside the paper's, in one short table."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from .paper import ABSTRACTION_QUALITY, HEURISTIC_PERFORMANCE
from .tables import EMPTY, markdown, percent, shown_cost, shown_increase, shown_seconds, shown_speedup

#: Weight of the planning rows.
WEIGHT = "1.25"
#: Sets of the quality rows, in words.
SETS = {"random": "random maps", "real": "scans of real places"}
METHODS = ("shipped", "manual")


def headline_table(quality: Mapping[str, Any], planning: Mapping[str, Any]) -> str:
    """Feasibility, cost error, and benefit in the paper's arena.

    Args:
        quality: contents of `reports/abstraction_quality.json`.
        planning: contents of `reports/planning.json`.
    """
    rows = []
    for name, words in SETS.items():
        entry = quality["sets"].get(name, {})
        ours = entry.get("methods", {})
        paper = ABSTRACTION_QUALITY.get(entry.get("paper"), {}).get("learned", {})
        for key, title, show in (
            ("feasibility_accuracy", "feasibility correct", percent),
            ("cost_error", "mean cost error", shown_cost),
        ):
            cells = [show(ours.get(method, {}).get(key)) for method in METHODS]
            rows.append([f"{title}, {words}", *cells, show(paper.get(key))])
    runs = [planning["summary"].get(method, {}).get(WEIGHT) for method in METHODS]
    theirs = HEURISTIC_PERFORMANCE["learned"][float(WEIGHT)]
    times = [f"{shown_seconds(run['seconds_mean'])} s" if run else EMPTY for run in runs]
    increases = [shown_increase(entry and entry["cost_increase"]) for entry in (*runs, theirs)]
    arena = f"in the arena, W = {WEIGHT}"
    rows += [
        [f"mean planning time {arena}", *times, EMPTY],
        [f"speed-up {arena}", *map(shown_speedup, (*runs, theirs))],
        [f"cost above the optimum {arena}", *increases],
    ]
    note = (
        "Speed-up: search time of the geometric heuristic at W = 1 over the search time, mean over the tasks. "
        "≥ marks a lower bound: a search with the geometric heuristic ended at its limit. Planning times leave out the "
        "costs of abstract actions, which a map needs once."
    )
    return f"{markdown(['', 'shipped', 'manually tuned', 'paper, learned'], rows)}\n\n{note}"
