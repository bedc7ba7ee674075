"""What a heuristic brings: times and costs of searches against a reference search of the same pair (Table II)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from statistics import fmean
from typing import Any

Run = Mapping[str, Any]


def summarise(runs: Sequence[Run], reference: tuple[str, float] = ("geometric", 1.0)) -> dict[str, dict[str, Any]]:
    """Means over the pairs, for each heuristic and weight.

    Args:
        runs: searches with `pair`, `heuristic`, `weight`, `status`, `cost` (None if unsolved), `seconds`, `expansions`.
        reference: heuristic and weight that the others are compared with; the geometric heuristic is admissible, so at
            W = 1 its costs are optimal.

    Returns:
        heuristic -> weight -> `pairs`, `solved`, `seconds_mean`, `expansions_mean`, `memory_max` (bytes), and, over the
        pairs that this search solved, `speedup` (mean of the ratios of time, as in the paper), `speedup_least` and
        `speedup_is_lower_bound`: a reference search that its limit ended would have taken longer. `seconds_is_lower_
        bound`: a search of this kind was ended by its limit. `cost_increase` is the mean over the `cost_pairs` that
        both solved, `cost_above_best` that over all solved pairs against the least cost that any search found; None
        where there are none.
    """
    references = {run["pair"]: run for run in runs if (run["heuristic"], run["weight"]) == reference}
    best = best_known(runs)
    summary: dict[str, dict[str, Any]] = {}
    for heuristic, weight in dict.fromkeys((run["heuristic"], run["weight"]) for run in runs):
        group = [run for run in runs if (run["heuristic"], run["weight"]) == (heuristic, weight)]
        summary.setdefault(heuristic, {})[str(weight)] = _entry(group, references, best)
    return summary


def best_known(runs: Sequence[Run]) -> dict[Any, dict[str, Any]]:
    """Of each pair that any search solved, the least `cost` and which search found it: `heuristic`, `weight`."""
    best: dict[Any, dict[str, Any]] = {}
    for run in filter(_solved, runs):
        if run["pair"] not in best or run["cost"] < best[run["pair"]]["cost"]:
            best[run["pair"]] = {name: run[name] for name in ("cost", "heuristic", "weight")}
    return best


def is_bound(run: Run) -> bool:
    """Whether a limit ended the search: without one it would have taken longer."""
    return str(run["status"]).endswith("_limit") and run["status"] != "cost_limit"


def _entry(group: Sequence[Run], references: Mapping[Any, Run], best: Mapping[Any, Run]) -> dict[str, Any]:
    solved = [run for run in group if _solved(run)]
    compared = [(run, references[run["pair"]]) for run in solved if run["pair"] in references]
    both = [(run, other) for run, other in compared if _solved(other)]
    ratios = [other["seconds"] / run["seconds"] for run, other in compared]
    return {
        "pairs": len(group),
        "solved": len(solved),
        "seconds_mean": fmean(run["seconds"] for run in group),
        "seconds_is_lower_bound": any(map(is_bound, group)),
        "expansions_mean": fmean(run["expansions"] for run in group),
        "memory_max": max(run["stats"]["memory"] for run in group),
        "speedup": _mean(ratios),
        "speedup_least": min(ratios, default=None),
        "speedup_is_lower_bound": any(is_bound(other) for _, other in compared),
        "cost_increase": _mean(run["cost"] / other["cost"] - 1 for run, other in both),
        "cost_pairs": len(both),
        "cost_above_best": _mean(run["cost"] / best[run["pair"]]["cost"] - 1 for run in solved),
    }


def _solved(run: Run) -> bool:
    return run["status"] == "solved"


def _mean(values) -> float | None:
    values = list(values)
    return fmean(values) if values else None
