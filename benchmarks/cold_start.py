"""CPU time of the first plan with an empty cache of kernels, of this commit and of an earlier one in the same run.

    python -m benchmarks.cold_start [--before HEAD~1] [--heuristic manual]

Each commit gets an empty cache folder, and a process that plans a way up a kerb. The last line is JSON: `cpu_s` of this
checkout, `previous_cpu_s` of the earlier commit (a git worktree), `share`, the quotient of both, `again_s`, the time
of a second process, which loads the kernels.
"""

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).parents[1]
SCRIPT = """
import sys, time
import numpy as np
import hdsp
heights = np.zeros((200, 120), np.float32)
heights[100:] = 0.15
planner = hdsp.Planner(hdsp.HeightMap(heights), heuristic=sys.argv[1])
plan = planner.plan((1.2, 1.5, 0.0), (3.6, 1.5, 0.0), 1.25)
assert plan.solved
print(time.process_time())
"""


def main(argv=None) -> dict:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--before", default="HEAD~1", help="the earlier commit")
    parser.add_argument("--heuristic", default="manual")
    arguments = parser.parse_args(argv)
    with tempfile.TemporaryDirectory() as folder:
        earlier = Path(folder) / "earlier"
        _git("worktree", "add", "--detach", str(earlier), arguments.before)
        try:
            previous = _cpu_seconds(earlier, Path(folder) / "kernels-before", arguments.heuristic)
        finally:
            _git("worktree", "remove", "--force", str(earlier))
        kernels = Path(folder) / "kernels"
        now = _cpu_seconds(ROOT, kernels, arguments.heuristic)
        began = time.perf_counter()
        _cpu_seconds(ROOT, kernels, arguments.heuristic)
        result = {
            "cpu_s": round(now, 1),
            "previous_cpu_s": round(previous, 1),
            "share": round(now / previous, 2),
            "again_s": round(time.perf_counter() - began, 1),
        }
    print(json.dumps(result))
    return result


def _git(*arguments: str) -> None:
    subprocess.run(["git", *arguments], cwd=ROOT, check=True, capture_output=True)


def _cpu_seconds(checkout: Path, kernels: Path, heuristic: str) -> float:
    """CPU seconds of a process that plans once."""
    environment = {**os.environ, "PYTHONPATH": str(checkout), "NUMBA_CACHE_DIR": str(kernels)}
    command = [sys.executable, "-c", SCRIPT, heuristic]
    done = subprocess.run(command, cwd=checkout, env=environment, stdout=subprocess.PIPE, text=True, check=True)
    return float(done.stdout.split()[-1])


if __name__ == "__main__":
    main()
