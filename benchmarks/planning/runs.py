"""Searches of the planning benchmark: all pairs of a case with one heuristic, kept in its folder.

    python -m benchmarks.planning.runs FOLDER... --heuristics manual learned --weights 1.25 --label before

As a command, it serves other commits: it needs nothing but `Planner.plan` as it was before polishing.
"""

from __future__ import annotations

import argparse
import hashlib
import inspect
import json
import time
from collections.abc import Sequence
from pathlib import Path

from benchmarks.planning.cases import Case, read_case, write_json
from benchmarks.planning.edge_cache import KeptCosts, keep_edges
from hdsp.base.errors import InputError
from hdsp.base.provenance import code_fingerprint
from hdsp.planning.planner import Planner

#: Name in results -> heuristic, as the planner takes it.
HEURISTICS = {
    "geometric": "geometric",
    "grid": "grid",
    "manual": "manual",
    "trained": "learned:models/abstraction",
    "learned": "learned",
    "paper": "learned:momaro-klamt2019",
    "oracle": "oracle",
}
ORACLE_AREA = 40.0  # m2; the oracle takes minutes for 6 x 6 m
EXPANSIONS = 500_000
FIRST_WEIGHT = 1.25
POLISH = 0.3  # s, for each plan whose cost nothing bounds
_POLISHES = "polish" in inspect.signature(Planner.plan).parameters
#: Ends of a search that prove that there is no plan.
PROOFS = "infeasible", "invalid_start", "invalid_goal"


class TooLarge(InputError):
    """The map is too large for a heuristic."""


def run_case(
    case: Case, name: str, weights: Sequence[float], expansions: int = EXPANSIONS, label: str = ""
) -> list[dict]:
    """Runs the searches for all pairs of a case with one heuristic; results of the same code are taken from its folder.

    Raises:
        InputError: the heuristic does not exist here.
    """
    path = _path(case, name, label)
    planner = planner_for(case, name)
    version = version_of(planner)
    kept = _kept(path, version)
    # Pairs proved unsolvable at one weight are so at all weights: 1.25, by which the bars count, comes first.
    order = sorted(weights, key=lambda weight: (weight != FIRST_WEIGHT, weight))
    wanted = [(pair, weight) for weight in order for pair in case.pairs]
    unsolvable = {run["pair"] for run in kept.values() if run["status"] in PROOFS}
    if any(pair.key not in unsolvable and _name(pair.key, weight, expansions) not in kept for pair, weight in wanted):
        began = time.process_time()
        planner.prepare()
        prepared = time.process_time() - began
        first = case.pairs[0]
        planner.plan(first.start, first.goal, expansions=1)  # loads kernels before any measurement
        for pair, weight in wanted:
            key = _name(pair.key, weight, expansions)
            if key not in kept and pair.key not in unsolvable:
                found = search(planner, pair, weight, expansions)
                kept[key] = {"pair": pair.key, "heuristic": name, "weight": weight, **found}
                if found["status"] in PROOFS:
                    unsolvable.add(pair.key)
        write_json(path, {"version": version, "prepare_seconds": prepared, "runs": kept})
    names = [_name(pair.key, weight, expansions) for pair, weight in wanted]
    return [kept[name] for name in names if name in kept]


def planner_for(case: Case, name: str) -> Planner:
    """Returns a planner with one of ``HEURISTICS``.

    Raises:
        InputError: the heuristic does not exist here, or takes too long on this map.
    """
    heuristic = HEURISTICS[name]
    if name == "oracle":
        if case.size[0] * case.size[1] > ORACLE_AREA:
            raise TooLarge(f"oracle: only for maps of up to {ORACLE_AREA:g} m2")
        from hdsp.abstract.oracle_costs import OracleCosts

        heuristic = OracleCosts(case.robot)
    return keep_edges(Planner(case.terrain(), case.robot, heuristic, conditioning=None))


def read_runs(case: Case, name: str, weights: Sequence[float], expansions: int, label: str) -> list[dict]:
    """Returns runs that `run_case` has kept, as far as there are any."""
    path = _path(case, name, label)
    kept = json.loads(path.read_text())["runs"] if path.is_file() else {}
    names = [_name(pair.key, weight, expansions) for weight in weights for pair in case.pairs]
    return [kept[name] for name in names if name in kept]


def search(planner: Planner, pair, weight: float, expansions: int) -> dict:
    """Runs one query, as the first on its map; ``cpu_s`` excludes the polish."""
    planner.clear()
    # By default, a plan at W = 1 has no polish.
    polish = {"polish": POLISH} if _POLISHES and not planner.heuristic.admissible else {}
    began = time.process_time()
    plan = planner.plan(pair.start, pair.goal, weight, expansions=expansions, **polish)
    seconds = time.process_time() - began
    stats = plan.stats
    # Commits before the polish have plans without it.
    polishing, before = getattr(stats, "polish_seconds", 0.0), getattr(stats, "unpolished_cost", None)
    return {
        "status": str(plan.status),
        "cost": round(plan.cost if before is None else before, 6) if plan.solved else None,
        "polished_cost": round(plan.cost, 6) if plan.solved else None,
        "bound": round(plan.bound, 6) if plan.solved and plan.bound < float("inf") else None,
        "expansions": stats.expansions,
        "cpu_s": round(max(seconds - polishing, 0.0), 5),
        "polish_s": round(polishing, 5),
        "heuristic_s": round(stats.heuristic_seconds, 5),
        "search_s": round(stats.search_seconds, 5),
        "proof_s": round(stats.proof_seconds, 5),
    }


def version_of(planner: Planner) -> str:
    """Hash of the code behind a planner's answers, and of its abstraction."""
    costs = getattr(planner.heuristic, "costs", None)
    key = costs.key if isinstance(costs, KeptCosts) else ""
    return hashlib.sha256(f"{code_fingerprint(Planner.__module__)} {key}".encode()).hexdigest()[:16]


def _path(case: Case, name: str, label: str) -> Path:
    return case.folder / f"{name}{'-' + label if label else ''}.json"


def _kept(path: Path, version: str) -> dict[str, dict]:
    if not path.is_file():
        return {}
    values = json.loads(path.read_text())
    return values["runs"] if values["version"] == version else {}


def _name(pair: str, weight: float, expansions: int) -> str:
    return f"{pair} {weight:g} {expansions}"


def main(argv=None) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folders", type=Path, nargs="+", help="folders of cases")
    parser.add_argument("--heuristics", nargs="+", default=["manual"], choices=list(HEURISTICS))
    parser.add_argument("--weights", type=float, nargs="+", default=[1.25])
    parser.add_argument("--expansions", type=int, default=EXPANSIONS)
    parser.add_argument("--label", default="", help="part of the names of the files with results")
    arguments = parser.parse_args(argv)
    for folder in arguments.folders:
        case = read_case(folder)
        for name in arguments.heuristics:
            try:
                run_case(case, name, arguments.weights, arguments.expansions, arguments.label)
            except InputError as error:
                print(f"{name}: left out, {error}", flush=True)
            else:
                print(f"{case.name}, {name}: done", flush=True)


if __name__ == "__main__":
    main()
