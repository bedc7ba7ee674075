"""Runs the fuzz suite: ``python -m tests.fuzz --seconds 1800 --processes 2 --seed 0`` (`make fuzz`).

Each case runs in a worker with limits of memory and time. A worker that dies or hangs is replaced, and its case is a
fault. The last line is a JSON object with the counts; the status is 1 if there was a fault. ``--page`` writes the
counts into docs/reliability.md. One case again: ``--again GROUP KIND SEED``.
"""

import argparse
import json
import sys
from pathlib import Path

from tests import ROOT
from tests.fuzz.groups import GROUPS, cases_of, kinds_of
from tests.fuzz.report import write_page
from tests.fuzz.supervisor import Supervisor

#: Share of the time for each group.
_TIME = {"files": 0.16, "plans": 0.37, "updates": 0.47}


def main(arguments: list[str] | None = None) -> dict:
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seconds", type=float, default=600.0, help="time for all groups together")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--seed", type=int, default=0, help="number of the first case of each kind")
    parser.add_argument("--groups", nargs="+", choices=GROUPS, default=list(GROUPS))
    parser.add_argument("--kinds", nargs="+", help="only these kinds")
    parser.add_argument("--json", type=Path, help="file for the counts and faults")
    parser.add_argument("--page", action="store_true", help="write the counts into docs/reliability.md")
    parser.add_argument("--again", nargs=3, metavar=("GROUP", "KIND", "SEED"), help="one case in this process")
    chosen = parser.parse_args(arguments)
    if chosen.again:
        group, kind, seed = chosen.again
        print(cases_of(group, kind).outcome(int(seed)))
        return {}
    shares = sum(_TIME[group] for group in chosen.groups)
    result: dict = {"seed": chosen.seed, "processes": chosen.processes, "groups": {}}
    for group in chosen.groups:
        kinds = {name: share for name, share in kinds_of(group).items() if not chosen.kinds or name in chosen.kinds}
        supervisor = Supervisor(group, kinds, chosen.seed, chosen.processes)
        result["groups"][group] = supervisor.run(chosen.seconds * _TIME[group] / shares)
    if chosen.json:
        chosen.json.write_text(json.dumps(result, indent=2) + "\n")
    if chosen.page:
        write_page(ROOT / "docs" / "reliability.md", result)
    print(json.dumps(result))
    return result


if __name__ == "__main__":
    sys.exit(any(group["faults"] for group in main().get("groups", {}).values()))
