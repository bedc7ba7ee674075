"""Mutation testing: one small change at a time in the planner's code, and tests that should notice it.

    python -m tests.mutants [TARGET ...] [--count 60] [--seed 0] [--again] [--page docs/reliability.md]

Results are kept in build/mutants.jsonl, so that a later run goes on. The last line is JSON: counts and survivors.
"""

import argparse
import json
import os
import sys
import time
from itertools import groupby
from pathlib import Path

# Before Numba and hypothesis are imported: plain Python, and the same examples each time.
os.environ |= {
    "NUMBA_DISABLE_JIT": "1",
    "HYPOTHESIS_PROFILE": "mutants",
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
}

from tests import ROOT
from tests.mutants.changes import Mutant
from tests.mutants.results import Results, equivalent, summary, write_page
from tests.mutants.targets import TARGETS
from tests.mutants.trials import SURVIVED, run_tests, tried

#: A mutant hangs if it takes this many times the CPU time of its tests without a change, and so many seconds more.
_LONGER, _MORE = 3, 2


def main(argv: list[str] | None = None) -> dict:
    parser = argparse.ArgumentParser(prog="python -m tests.mutants", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("targets", nargs="*", metavar="TARGET", help=f"some of {', '.join(TARGETS)}")
    parser.add_argument("--count", type=int, default=60, help="mutants of each target")
    parser.add_argument("--seed", type=int, default=0, help="of the sample")
    parser.add_argument("--so-far", action="store_true", help="try none; count the results so far")
    parser.add_argument("--again", action="store_true", help="try survivors without a judgement again")
    parser.add_argument("--only", default="", help="mutants with this text in their names; all of them, not a sample")
    parser.add_argument("--results", type=Path, default=ROOT / "build" / "mutants.jsonl", help="file with all results")
    parser.add_argument("--page", type=Path, help="docs page to update")
    chosen = parser.parse_args(argv)
    results, found = Results(chosen.results), {}
    for name, target in TARGETS.items():
        if chosen.targets and name not in chosen.targets:
            continue
        sample, total = target.sample(chosen.count, chosen.seed, chosen.only)
        if not chosen.so_far:
            waiting = [each for each in sample if _is_open(results, each, chosen.again)]
            waiting.sort(key=lambda each: target.tests_of(each.file))
            for tests, mutants in groupby(waiting, key=lambda each: target.tests_of(each.file)):
                _try(tests, list(mutants), results)
        found[name] = total, [(each, trial) for each in sample if (trial := results.of(each)) is not None]
    result = summary(found, chosen.seed)
    if chosen.page:
        write_page(chosen.page, result)
    print(json.dumps(result))
    return result


def _is_open(results: Results, mutant: Mutant, again: bool) -> bool:
    """Whether a mutant is still to be tried."""
    trial = results.of(mutant)
    return trial is None or (again and trial.result == SURVIVED and mutant.name not in equivalent())


def _try(tests: list[str], mutants: list[Mutant], results: Results) -> None:
    if not run_tests(tests):
        sys.exit(f"error: {', '.join(tests)} fail without any change")
    began = time.process_time()
    run_tests(tests)  # once more: now maps and textbook results are at hand
    seconds = time.process_time() - began
    for i, mutant in enumerate(mutants):
        trial = tried(mutant, tests, _LONGER * seconds + _MORE)
        results.add(mutant, trial)
        print(f"{i + 1}/{len(mutants)} {trial.result} ({trial.seconds:.1f} s): {mutant.name}", flush=True)


if __name__ == "__main__":
    main()
