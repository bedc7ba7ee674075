"""Faults at every write of the stages on the tiny profile; minutes.

python -m tests.faults [STAGE ...] [--most N] [--every KIND] [--page docs/reliability.md]
"""

import argparse
import json
import tempfile
from collections import Counter
from pathlib import Path

from benchmarks.page import table, write_block
from tests.faults.stages import STAGES, faults_of

#: Kinds of faults and the heads of their columns.
HEAD = {
    "kill": "killed", "torn": "killed, half a file", "ENOSPC": "disk full", "EIO": "failing disk",
    "clock": "clock back", "two": "two at once",
}  # fmt: skip


def main(argv: list[str] | None = None) -> dict:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("stages", nargs="*", metavar="STAGE", help=f"some of {', '.join(STAGES)}")
    parser.add_argument("--most", type=int, help="moments to try in each stage, for each kind of fault")
    parser.add_argument(
        "--every", action="append", default=[], choices=[kind for kind in HEAD if kind != "two"],
        help="a kind to try at all moments; may be repeated",
    )  # fmt: skip
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
            tried, bad, moments = Counter[str](), 0, [0]
            found = faults_of(name, inputs, work, arguments.most, moments.append, every=arguments.every)
            for kind, number, fault in found:
                tried[kind] += 1
                bad += bool(fault)
                if fault:
                    print(f"{name}, {kind} at {number}: {fault}", flush=True)
            print(f"{name}: {moments[-1]} moments, {dict(tried)}, {bad} wrong", flush=True)
            rows.append([name, moments[-1], *(tried[kind] for kind in HEAD), "all" if not bad else f"not {bad}"])
            wrong += bad
    if arguments.page:
        head = ["stage", "moments", *HEAD.values(), "ended with equal results"]
        write_block(arguments.page, "tests.faults", table(head, with_earlier(arguments.page.read_text(), rows)))
    result = {"stages": len(rows), "faults": sum(sum(row[2:-1]) for row in rows), "wrong": wrong}
    print(json.dumps(result))
    return result


def with_earlier(page: str, rows: list[list]) -> list[list]:
    """Rows of this run, and those on the page for stages that did not run now."""
    block = page.partition("<!-- written by tests.faults: begin -->")[2].partition("<!-- written by")[0]
    earlier = [line.strip("| ").split(" | ") for line in block.splitlines() if line.startswith("| ")]
    found = {row[0]: row for row in [*earlier, *rows]}
    return [found[name] for name in STAGES if name in found]


if __name__ == "__main__":
    main()
