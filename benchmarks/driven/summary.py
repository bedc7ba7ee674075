"""Shares of drives that arrive, rank correlation of cost and energy, and the page."""

from __future__ import annotations

import math
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.driven.runs import WAYS
from benchmarks.driven.ways import SORTS
from benchmarks.page import table

_DIFFERS = 1.03  # ratio of costs from which two ways are a pair
_DOTS = {"obstacle": "o", "rough": "s", "stairs": "^", "sideways": "D"}


def summarise(robot: str, seed: int, results: dict[str, list[dict[str, Any]]]) -> dict[str, Any]:
    """Returns the benchmark's JSON document.

    Args:
        robot: its name.
        seed: seed of the tasks.
        results: results of tasks by kind; `ways` has two drives for each task.
    """
    single = {kind: found for kind, found in results.items() if kind != WAYS}
    tasks = [result for found in single.values() for result in found]
    ways = results.get(WAYS, [])
    runs = tasks + [run for result in ways for run in result["ways"]]
    found = pairs(ways)
    return {
        "robot": robot,
        "seed": seed,
        "tasks": {kind: len(found) for kind, found in single.items()},
        # Tasks without a plan are replaced by further ones.
        "without_plan": {kind: found[-1]["number"] + 1 - len(found) for kind, found in single.items() if found},
        "driven": {kind: _share(found) for kind, found in single.items()},
        "all": _share(tasks),
        "causes": {
            kind: dict(Counter(result["ending"] for result in found if not result["success"]))
            for kind, found in single.items()
        },
        "realtime": round(sum(run["duration"] for run in runs) / sum(run["cpu"] for run in runs), 2) if runs else None,
        "pairs": len(found),
        "rank_correlation": _correlation(found),
        "rank_correlation_by_sort": {
            sort: _correlation([pair for pair in found if pair[0] == sort]) for sort in SORTS
        },
    }  # fmt: skip


def pairs(ways: list[dict[str, Any]]) -> list[tuple[str, float, float]]:
    """Pairs of ways whose costs differ and that were both driven to their end: sort, ratios of cost and of energy.

    The cheaper way is the denominator, so the ratio of costs is above 1.
    """
    found = []
    for result in ways:
        cheap, dear = sorted(result["ways"], key=lambda run: run["cost"])
        if cheap["success"] and dear["success"] and dear["cost"] > _DIFFERS * cheap["cost"]:
            found.append((result["sort"], dear["cost"] / cheap["cost"], dear["energy"] / cheap["energy"]))
    return found


def _correlation(found: list[tuple[str, float, float]]) -> float | None:
    """Concordant minus discordant pairs, over all pairs."""
    return round(float(np.mean([math.copysign(1, energy - 1) for _, _, energy in found])), 2) if found else None


def _share(results: list[dict[str, Any]]) -> float | None:
    return round(sum(result["success"] for result in results) / len(results), 4) if results else None


def text(summary: dict[str, Any], picture: str) -> str:
    """Formats the result for the page."""
    rows = [
        [
            kind,
            summary["tasks"][kind],
            share,
            ", ".join(f"{n} {end}" for end, n in summary["causes"][kind].items()),
            summary["without_plan"].get(kind),
        ]
        for kind, share in summary["driven"].items()
    ]
    rows.append(["all", sum(summary["tasks"].values()), summary["all"], "", sum(summary["without_plan"].values())])
    parts = [f"{summary['robot']}, tasks of seed {summary['seed']}:"]
    parts.append(table(["ground", "tasks", "arrived", "other ends", "further tasks without a plan"], rows))
    parts.append(f"Simulation: {summary['realtime']} times as fast as real time on one core.")
    if summary["pairs"]:
        by_sort = ", ".join(f"{sort} {value}" for sort, value in summary["rank_correlation_by_sort"].items())
        parts.append(
            f"Rank correlation of cost and energy over {summary['pairs']} pairs of ways between the same poses: "
            f"{summary['rank_correlation']} ({by_sort})."
        )
    parts.append(f"![Energy against cost; ratios of energy against ratios of cost](figures/{picture})")
    if summary.get("slope"):
        parts.append(_slope_table(summary["slope"]))
    return "\n\n".join(parts)


def _slope_table(slope: dict[str, Any]) -> str:
    rows = [
        [robot, way, f"{found['planned']:g}", f"{found['driven']:g}", ", ".join(sorted(set(found["ends"])))]
        for robot, ways in slope.items()
        for way, found in ways.items()
    ]
    return table(["robot", "ground", "planner's limit (degrees)", "drives up to", "steeper"], rows)


def draw(results: dict[str, list[dict[str, Any]]], path: Path) -> None:
    """Draws energy against cost by kind, and for pairs of ways the ratio of energies against the ratio of costs."""
    import matplotlib.pyplot as plt

    figure, (left, right) = plt.subplots(1, 2, figsize=(9.6, 4.2), layout="constrained")
    for kind, found in results.items():
        arrived = [result for result in found if kind != WAYS and result["success"]]
        if arrived:
            left.scatter([r["cost"] for r in arrived], [r["energy"] for r in arrived], s=18, label=kind)
    left.set(xlabel="planned cost", ylabel="energy (J)", yscale="log", title="plans")
    found = pairs(results.get(WAYS, []))
    for sort in SORTS:
        dots = [(cost, energy) for name, cost, energy in found if name == sort]
        if dots:
            right.scatter(*zip(*dots, strict=True), s=22, marker=_DOTS[sort], label=sort)
    right.axhline(1.0, color="0.4", lw=0.9)
    right.set(
        xlabel="cost of the dearer way / cost of the cheaper way", ylabel="energy, the same ratio", yscale="log",
        title="two ways between the same poses",
    )  # fmt: skip
    for axes in (left, right):
        if axes.collections:
            axes.legend(fontsize=8)
        axes.grid(alpha=0.3, which="both")
    left.yaxis.set_major_formatter("{x:g}")
    right.yaxis.set_major_formatter("{x:g}")
    right.yaxis.set_minor_formatter("{x:g}")
    figure.savefig(path, dpi=110)
    plt.close(figure)
