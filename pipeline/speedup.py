"""Benefit of a heuristic: search times and costs against a reference search for the same pair (Table II)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from statistics import fmean
from typing import Any

Run = Mapping[str, Any]


def summarise(runs: Sequence[Run], reference: tuple[str, float] = ("geometric", 1.0)) -> dict[str, dict[str, Any]]:
    """Returns means over the pairs, for each heuristic and weight.

    Args:
        runs: searches with `pair`, `heuristic`, `weight`, `status`, `cost` (None if unsolved), `seconds`, `expansions`.
        reference: reference heuristic and weight. The geometric heuristic is admissible, so its costs at W = 1 are
            optimal.

    Returns:
        heuristic -> weight -> values. Over all pairs: `pairs`, `solved`, `seconds_mean`, `expansions_mean`,
        `memory_max` (bytes) and `seconds_is_lower_bound` (a limit ended a search in this group). Over solved pairs:
        `speedup` (mean time ratio, as in the paper), `speedup_least` and `speedup_is_lower_bound` (a limit ended a
        reference search, which would have taken longer). `cost_increase` is the mean over the `cost_pairs` solved by
        both searches. `cost_above_best` is the mean over all solved pairs, against the least cost from any search.
        `polished_seconds_mean` and `polished_above_best` are the time and the cost with polish, if the runs have them;
        the best known cost stays the least without polish. Values without pairs are None.
    """
    references = {run["pair"]: run for run in runs if (run["heuristic"], run["weight"]) == reference}
    best = best_known(runs)
    summary: dict[str, dict[str, Any]] = {}
    for heuristic, weight in dict.fromkeys((run["heuristic"], run["weight"]) for run in runs):
        group = [run for run in runs if (run["heuristic"], run["weight"]) == (heuristic, weight)]
        summary.setdefault(heuristic, {})[str(weight)] = _entry(group, references, best)
    return summary


def best_known(runs: Sequence[Run]) -> dict[Any, dict[str, Any]]:
    """For each pair solved by any search: least `cost`, and the `heuristic` and `weight` that found it."""
    best: dict[Any, dict[str, Any]] = {}
    for run in filter(_solved, runs):
        if run["pair"] not in best or run["cost"] < best[run["pair"]]["cost"]:
            best[run["pair"]] = {name: run[name] for name in ("cost", "heuristic", "weight")}
    return best


def is_bound(run: Run) -> bool:
    """Whether a limit ended the search, so that its time is a lower bound."""
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
        **_polished(group, best),
    }


def _polished(group: Sequence[Run], best: Mapping[Any, Run]) -> dict[str, float | None]:
    """Mean query time with polish, and mean cost above the best known cost without; empty for runs without polish."""
    if "polished_seconds" not in group[0]:
        return {}
    costs = [run["polished_cost"] / best[run["pair"]]["cost"] for run in group if run["polished_cost"] is not None]
    return {
        "polished_seconds_mean": fmean(run["polished_seconds"] for run in group),
        "polished_above_best": _mean(cost - 1 for cost in costs),
    }


def _solved(run: Run) -> bool:
    return run["status"] == "solved"


def _mean(values) -> float | None:
    values = list(values)
    return fmean(values) if values else None
