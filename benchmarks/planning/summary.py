"""Figures of the planning benchmark, from the runs of all pairs.

- *solvable*: some search found a plan; *unsolvable*: some search proved that there is none; *undecided*: neither.
- *hard*: solvable, and the manual heuristic needs 10,000 expansions or more at W = 1.25; a search that ends at its
  limit is hard as well. *easy*: solvable and not hard.
- *best*: the least cost from any search for the pair, long searches for optima included.
- Ratios of expansions are geometric means over pairs. A search that ends without a plan counts with the expansions that
  it made, so its pair's ratio is a bound; ``capped`` counts these pairs, for numerator and denominator.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from benchmarks.planning.cases import Case
from benchmarks.planning.runs import PROOFS
from benchmarks.planning.statistics import geometric_mean_ratio

HARD = 10_000  # expansions
HARD_WEIGHT = 1.25
#: Separates a heuristic's name from the commit whose code ran.
AT = "@"


class Results(NamedTuple):
    """All runs, with all facts about the pairs that do not depend on one heuristic.

    Attributes:
        runs: (pair, heuristic, weight) -> run.
        maps: pair -> name of its map.
        kinds: pair -> kind of its map.
        levels: pairs between different pieces of drivable ground.
        best: pair -> least known cost.
        optima: pair -> proved optimum.
        unsolvable: pairs without a plan, proved.
    """

    runs: dict[tuple[str, str, float], dict]
    maps: dict[str, str]
    kinds: dict[str, str]
    levels: set[str]
    best: dict[str, float]
    optima: dict[str, float]
    unsolvable: set[str]

    @property
    def solvable(self) -> list[str]:
        return [pair for pair in self.maps if pair in self.best]

    def of(self, heuristic: str, weight: float, pairs: Sequence[str]) -> list[dict]:
        """Runs of these pairs, as far as there are any."""
        found = (self.runs.get((pair, heuristic, weight)) for pair in pairs)
        return [run for run in found if run is not None]

    def hard(self, heuristic: str = "manual") -> list[str]:
        """Solvable pairs that are hard for a heuristic."""
        runs = self.of(heuristic, HARD_WEIGHT, self.solvable)
        return [run["pair"] for run in runs if not run["cost"] or run["expansions"] >= HARD]


def gather(cases: Sequence[Case], runs: Sequence[dict], optima: Mapping[str, dict]) -> Results:
    """Sorts runs by pair.

    Args:
        cases: all maps with their pairs.
        runs: all runs.
        optima: entries of the file of optima, by pair.
    """
    maps = {pair.key: case.name for case in cases for pair in case.pairs}
    kinds = {pair.key: case.kind for case in cases for pair in case.pairs}
    levels = {pair.key for case in cases for pair in case.pairs if pair.levels}
    costs: dict[str, list[float]] = {}
    for run in runs:
        if run["polished_cost"] is not None:
            costs.setdefault(run["pair"], []).append(run["polished_cost"])
    for pair, entry in optima.items():
        if pair in maps and entry["cost"] is not None:
            costs.setdefault(pair, []).append(entry["cost"])
    proved = {pair: entry["cost"] for pair, entry in optima.items() if pair in maps and entry["proved"]}
    return Results(
        runs={(run["pair"], run["heuristic"], run["weight"]): run for run in runs},
        maps=maps, kinds=kinds, levels=levels,
        best={pair: min(found) for pair, found in costs.items()},
        optima={pair: cost for pair, cost in proved.items() if cost is not None},
        unsolvable={run["pair"] for run in runs if run["status"] in PROOFS},
    )  # fmt: skip


def counts(results: Results, earlier: str | None) -> dict:
    """Numbers of maps and pairs; contradictions are pairs with a plan and with a proof that there is none."""
    solvable = set(results.solvable)
    counted = {
        "maps": len(set(results.maps.values())),
        "pairs": len(results.maps),
        "solvable": len(solvable),
        "unsolvable_proved": len(results.unsolvable - solvable),
        "undecided": len(set(results.maps) - solvable - results.unsolvable),
        "contradictions": len(results.unsolvable & solvable),
        "between_levels": len(solvable & results.levels),
        "hard": len(results.hard()),
        "optimum_proved": len(solvable & set(results.optima)),
    }
    return counted | ({"hard_before": len(results.hard(f"manual{AT}{earlier}"))} if earlier else {})


def rows(results: Results) -> list[dict]:
    """Figures for each heuristic and weight, over all solvable pairs."""
    solvable, hard = results.solvable, set(results.hard())
    found = []
    for heuristic, weight in dict.fromkeys((heuristic, weight) for _, heuristic, weight in results.runs):
        runs = results.of(heuristic, weight, solvable)
        if not runs:
            continue
        all_runs = results.of(heuristic, weight, list(results.maps))
        row = {
            "heuristic": heuristic, "weight": weight, "pairs": len(runs),
            "solved": sum(run["cost"] is not None for run in runs),
            "unsolvable_proved": sum(run["status"] in PROOFS for run in all_runs),
            "expansions_easy": _typical([run["expansions"] for run in runs if run["pair"] not in hard]),
            "expansions_hard": _typical([run["expansions"] for run in runs if run["pair"] in hard]),
            "above_best": _above(runs, results.best)[0],
            "above_best_polished": _above(runs, results.best, "polished_cost")[0],
            **{part: round(float(np.mean([run[part] for run in runs])), 5) for part in PARTS},
        }  # fmt: skip
        row["above_optimum"], row["above_optimum_max"], row["optima"] = _above(runs, results.optima)
        row["polished"], row["polished_max"], _ = _above(runs, results.optima, "polished_cost")
        found.append(row)
    return found


#: Seconds of a run: processor time for all of it, and its parts by the clock.
PARTS = "cpu_s", "heuristic_s", "search_s", "proof_s", "polish_s"


def ratios(results: Results, heuristic: str, other: str, weight: float, pairs: Sequence[str]) -> dict:
    """Expansions and cost of a heuristic, relative to another one, over ``pairs`` with both runs."""
    both = [
        (results.runs[pair, heuristic, weight], results.runs[pair, other, weight])
        for pair in pairs
        if (pair, heuristic, weight) in results.runs and (pair, other, weight) in results.runs
    ]
    solved = [(a, b) for a, b in both if a["cost"] and b["cost"]]
    effort = geometric_mean_ratio(*_columns(both, "expansions"), [results.maps[a["pair"]] for a, _ in both])
    cost = geometric_mean_ratio(*_columns(solved, "cost"), [results.maps[a["pair"]] for a, _ in solved])
    return {
        "expansions": effort.mean, "expansions_interval": effort.ends, "pairs": effort.number,
        "capped": [sum(a["cost"] is None for a, _ in both), sum(b["cost"] is None for _, b in both)],
        "cost": cost.mean, "cost_interval": cost.ends,
    }  # fmt: skip


def comparisons(results: Results, earlier: str | None) -> list[dict]:
    """Ratios of each heuristic to the manual one, and to itself at an earlier commit."""
    hard, solvable = results.hard(), results.solvable
    groups = {"hard": hard, "easy": [pair for pair in solvable if pair not in set(hard)], "all": solvable}
    if earlier:
        groups["hard before"] = results.hard(f"manual{AT}{earlier}")
    found = []
    for heuristic, weight in dict.fromkeys((heuristic, weight) for _, heuristic, weight in results.runs):
        others = ["manual"] * (heuristic != "manual" and AT not in heuristic) + [f"{heuristic}{AT}{earlier}"]
        for other in others:
            for group, pairs in groups.items():
                ratio = ratios(results, heuristic, other, weight, pairs)
                if ratio["pairs"]:
                    found.append({"heuristic": heuristic, "to": other, "weight": weight, "group": group, **ratio})
    return found


def headline(results: Results, found: Sequence[dict], earlier: str | None) -> dict:
    """The figures by which the benchmark is judged, by name."""
    at = {(row["heuristic"], row["to"], row["weight"], row["group"]): row for row in found}
    learned = results.of("learned", HARD_WEIGHT, results.solvable)
    figures: dict = {}
    for name, key in (
        ("learned_manual_hard_1.25", ("learned", "manual", HARD_WEIGHT, "hard")),
        ("learned_manual_easy_1.25", ("learned", "manual", HARD_WEIGHT, "easy")),
        ("learned_before_hard", ("learned", f"learned{AT}{earlier}", HARD_WEIGHT, "hard")),
        ("learned_before_hard_before", ("learned", f"learned{AT}{earlier}", HARD_WEIGHT, "hard before")),
    ):
        if key in at:
            row = at[key]
            figures |= {
                name: row["expansions"],
                f"{name}_interval": row["expansions_interval"],
                f"{name}_cost": row["cost"],
            }
    for weight in (1.0, 1.25, 2.0):
        mean, largest, number = _above(results.of("learned", weight, results.solvable), results.optima, "polished_cost")
        if number:
            name = f"cost_over_optimum_{weight:g}_polished"
            figures |= {name: mean, f"{name}_max": largest, f"{name}_pairs": number}
    if learned:
        figures["solved_1.25"] = round(sum(run["cost"] is not None for run in learned) / len(learned), 4)
    return figures


def _typical(values: Sequence[int]) -> float | None:
    """Geometric mean."""
    return round(float(np.exp(np.mean(np.log(np.maximum(values, 1))))), 1) if len(values) else None


def _above(
    runs: Sequence[dict], least: Mapping[str, float], cost: str = "cost"
) -> tuple[float | None, float | None, int]:
    """Mean and largest cost over ``least`` (share), and the number of pairs with both."""
    found = [run[cost] / least[run["pair"]] - 1 for run in runs if run[cost] and run["pair"] in least]
    if not found:
        return None, None, 0
    return round(float(np.mean(found)), 5), round(max(found), 5), len(found)


def _columns(both: Sequence[tuple[dict, dict]], what: str) -> tuple[list[float], list[float]]:
    return [max(a[what], 1e-9) for a, _ in both], [max(b[what], 1e-9) for _, b in both]
