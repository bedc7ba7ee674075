"""The same searches with the code of an earlier commit, in a process of its own."""

from __future__ import annotations

import io
import os
import subprocess
import sys
import tarfile
from collections.abc import Sequence
from pathlib import Path

from benchmarks.planning.cases import Case
from benchmarks.planning.edge_cache import cache_folder
from benchmarks.planning.runs import read_runs
from benchmarks.planning.summary import AT
from hdsp.base.errors import InputError

ROOT = Path(__file__).parents[2]


def run_earlier(
    commit: str, cases: Sequence[Case], heuristics: Sequence[str], weights: Sequence[float], expansions: int
) -> tuple[str, list[dict]]:
    """Runs the searches of all cases with the package of ``commit``.

    Returns:
        The commit's short name, and the runs; ``@`` and this name follow their heuristics' names.

    Raises:
        InputError: git does not know the commit, or the process failed.
    """
    full = _git("rev-parse", "--verify", f"{commit}^{{commit}}").decode().strip()
    label, package = full[:7], cache_folder() / "commits" / full
    if not (package / "hdsp" / "__init__.py").is_file():
        with tarfile.open(fileobj=io.BytesIO(_git("archive", full, "hdsp"))) as archive:
            archive.extractall(package, filter="data")
    folders = [str(case.folder.resolve()) for case in cases]
    command = [
        sys.executable, "-m", "benchmarks.planning.runs", *folders, "--heuristics", *heuristics,
        "--weights", *map(str, weights), "--expansions", str(expansions), "--label", label,
    ]  # fmt: skip
    path = os.pathsep.join([str(package), str(ROOT)])
    done = subprocess.run(command, cwd=package, env=os.environ | {"PYTHONPATH": path})
    if done.returncode:
        raise InputError(f"--before {commit}: the searches with this commit failed")
    return label, [
        run | {"heuristic": f"{name}{AT}{label}"}
        for case in cases
        for name in heuristics
        for run in read_runs(case, name, weights, expansions, label)
    ]


def _git(*arguments: str) -> bytes:
    done = subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True)
    if done.returncode:
        raise InputError(f"git {' '.join(arguments)}: {done.stderr.decode().strip().splitlines()[-1]}")
    return done.stdout
