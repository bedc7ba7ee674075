"""Faults at every write of the stages on the tiny profile; minutes.

python -m tests.faults [STAGE ...] [--most N] [--page docs/reliability.md]
"""

import argparse
import json
import tempfile
from collections import Counter
from pathlib import Path

from benchmarks.page import table, write_block
from tests.faults.stages import STAGES, faults_of


def main(argv: list[str] | None = None) -> dict:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("stages", nargs="*", metavar="STAGE", help=f"some of {', '.join(STAGES)}")
    parser.add_argument("--most", type=int, help="moments to try in each stage, for each kind of fault")
    parser.add_argument("--page", type=Path, help="docs page to update")
    arguments = parser.parse_args(argv)
    rows, wrong = [], 0
    with tempfile.TemporaryDirectory() as place:
        inputs = Path(place) / "inputs"
        inputs.mkdir()
        for name in STAGES:
            if arguments.stages and name not in arguments.stages:
                continue
            work = Path(place) / name
            work.mkdir()
            tried, bad = Counter[str](), 0
            for kind, number, fault in faults_of(name, inputs, work, arguments.most):
                tried[kind] += 1
                bad += bool(fault)
                if fault:
                    print(f"{name}, {kind} at {number}: {fault}", flush=True)
            print(f"{name}: {dict(tried)}, {bad} wrong", flush=True)
            rows.append(
                [name, *(tried[kind] for kind in ("kill", "ENOSPC", "EIO")), "all" if not bad else f"not {bad}"]
            )
            wrong += bad
    if arguments.page:
        head = ["stage", "killed", "disk full", "failing disk", "resumed with equal bytes"]
        write_block(arguments.page, "tests.faults", table(head, rows))
    result = {"stages": len(rows), "faults": sum(sum(row[1:4]) for row in rows), "wrong": wrong}
    print(json.dumps(result))
    return result


if __name__ == "__main__":
    main()
