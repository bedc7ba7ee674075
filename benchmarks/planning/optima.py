"""Proved optima of the pairs, from long searches, in a file that is committed.

A key is the hash of map, robot, cost model, start and goal (`benchmarks.planning.pairs.pair_key`), so an entry of
another map or cost model matches no pair and has no effect.
"""

from __future__ import annotations

import json
import time
from collections.abc import Mapping, Sequence
from pathlib import Path

from benchmarks.planning.cases import Case
from benchmarks.planning.runs import planner_for
from hdsp.base.errors import InputError
from hdsp.base.files import replacing
from hdsp.detailed.search.outcome import Status

FILE = Path(__file__).with_name("optima.json")
MEMORY = 12_000_000_000  # bytes
_SLACK = 1e-6  # relative to a known cost, for rounding


def read_optima(path: Path = FILE) -> dict[str, dict]:
    """Returns entries by pair: ``cost`` (None: no plan found), ``proved``, ``lower`` bound, ``expansions`` spent."""
    return json.loads(path.read_text()) if path.is_file() else {}


def prove(
    cases: Sequence[Case], best: Mapping[str, float], unsolvable: set[str], seconds: float, expansions: int,
    path: Path = FILE,
) -> dict[str, dict]:  # fmt: skip
    """Searches for optima until ``seconds`` have passed; returns all entries.

    Pairs with low known cost come first, pairs without a plan last. A pair is left out if it has an optimum, or was
    searched with as many expansions before. The file is written after each search.

    Args:
        cases: maps and pairs.
        best: least known cost by pair.
        unsolvable: pairs proved to have no plan.
        seconds: after this time, no further search begins.
        expansions: limit of one search.
        path: file of optima.
    """
    ends, entries = time.monotonic() + seconds, read_optima(path)
    tasks = [
        (best.get(pair.key, float("inf")), case, pair)
        for case in cases
        for pair in case.pairs
        if pair.key not in unsolvable and not _done(entries.get(pair.key), expansions)
    ]
    planners: dict[str, object] = {}
    for known, case, pair in sorted(tasks, key=lambda task: task[0]):
        if time.monotonic() >= ends:
            break
        if case.name not in planners:
            planners[case.name] = _planner(case)
        planner = planners[case.name]
        plan = planner.plan(
            pair.start, pair.goal, cost=known * (1 + _SLACK), expansions=expansions, memory=MEMORY, time=3600.0,
        )  # fmt: skip
        found = round(plan.cost, 6) if plan.solved else known if known < float("inf") else None
        lower = plan.cost if plan.solved else plan.stats.lower_bound
        entries[pair.key] = {
            "map": case.name, "start": list(pair.start), "goal": list(pair.goal), "cost": found,
            "proved": plan.status == Status.SOLVED and plan.bound <= 1 + _SLACK,
            "lower": round(lower, 6) if lower < float("inf") else None,
            "expansions": expansions if plan.status == Status.EXPANSION_LIMIT else plan.stats.expansions,
        }  # fmt: skip
        with replacing(path) as temporary:
            lines = (f"{json.dumps(key)}: {json.dumps(entry)}" for key, entry in sorted(entries.items()))
            temporary.write_text("{\n" + ",\n".join(lines) + "\n}\n")
        print(f"{case.name}: {plan.status}, cost {plan.cost:.3f} ({known:.3f} known), "
              f"{plan.stats.expansions:,} expansions", flush=True)  # fmt: skip
    return entries


def _planner(case: Case):
    """A planner with the best admissible heuristic that exists."""
    try:
        return planner_for(case, "grid")
    except InputError:
        return planner_for(case, "geometric")


def _done(entry: dict | None, expansions: int) -> bool:
    return entry is not None and (entry["proved"] or entry["expansions"] >= expansions)
