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
        heuristic -> weight -> `pairs`, `solved`, `seconds_mean`, `expansions_mean`, and, over the pairs that this
        search solved, `speedup` (mean of the ratios of time, as in the paper) and `speedup_is_lower_bound`: a reference
        search that its limit ended would have taken longer. `cost_increase` is the mean over the `cost_pairs` that both
        solved; None where there are none.
    """
    references = {run["pair"]: run for run in runs if (run["heuristic"], run["weight"]) == reference}
    summary: dict[str, dict[str, Any]] = {}
    for heuristic, weight in dict.fromkeys((run["heuristic"], run["weight"]) for run in runs):
        group = [run for run in runs if (run["heuristic"], run["weight"]) == (heuristic, weight)]
        summary.setdefault(heuristic, {})[str(weight)] = _entry(group, references)
    return summary


def _entry(group: Sequence[Run], references: Mapping[Any, Run]) -> dict[str, Any]:
    compared = [(run, references[run["pair"]]) for run in group if _solved(run) and run["pair"] in references]
    both = [(run, other) for run, other in compared if _solved(other)]
    return {
        "pairs": len(group),
        "solved": sum(map(_solved, group)),
        "seconds_mean": fmean(run["seconds"] for run in group),
        "expansions_mean": fmean(run["expansions"] for run in group),
        "speedup": _mean(other["seconds"] / run["seconds"] for run, other in compared),
        "speedup_is_lower_bound": len(both) < len(compared),
        "cost_increase": _mean(run["cost"] / other["cost"] - 1 for run, other in both),
        "cost_pairs": len(both),
    }


def _solved(run: Run) -> bool:
    return run["status"] == "solved"


def _mean(values) -> float | None:
    values = list(values)
    return fmean(values) if values else None
