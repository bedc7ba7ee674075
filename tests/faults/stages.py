"""Stages of the pipeline on the tiny profile, to be run with faults."""

from __future__ import annotations

import importlib
import os
import shutil
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

from tests.faults.injection import KINDS, Writes, contents, run_apart

#: Stages with their arguments, each after the ones that it needs.
STAGES: dict[str, tuple[str, ...]] = {
    "label": ("val",),
    "published": (),
}


def stage_in(name: str, folder: Path, arguments: tuple[str, ...]) -> Callable[[], object]:
    """Returns a call of a stage on the tiny profile, with inputs and outputs in one folder."""
    module = importlib.import_module(f"pipeline.{name}")
    tiny = ("profile=tiny", f"runtime.inputs={folder}", f"runtime.outputs={folder}", "runtime.workers=1")
    argv = [name, *(each for each in arguments if "=" not in each), *tiny, "runtime.progress=false"]
    argv += [each for each in arguments if "=" in each]

    def call() -> None:
        sys.argv = argv
        os.environ["MLFLOW_TRACKING_URI"] = f"sqlite:///{folder}/mlflow.db"
        positional = ["split"] if name == "label" else []
        from pipeline.stage import run_stage

        run_stage(getattr(module, name), name, positional)

    return call


def faults_of(name: str, inputs: Path, work: Path, most: int | None = None) -> Iterator[tuple[str, int, str]]:
    """Runs a stage with a fault at each moment of its writes, then again without.

    Args:
        name: the stage.
        inputs: folder with the results of earlier stages; gets the results of this one.
        work: empty folder.
        most: number of moments to try, spread over all; None: all.

    Yields:
        Kind of the fault, its moment, and what is wrong: nothing, if the second run ended with the same bytes.
    """
    before = work / "before"
    shutil.copytree(inputs, before)
    heard = work / "heard.txt"
    status, moments = run_apart(stage_in(name, inputs, STAGES[name]), Writes(), heard)
    assert status == 0, heard.read_text()
    expected = contents(inputs)
    for kind in KINDS:
        count = moments if kind == "kill" else moments // 3
        numbers = range(1, count + 1)
        if most is not None:
            numbers = sorted({1 + k * (count - 1) // max(most - 1, 1) for k in range(most)})
        for number in numbers:
            folder = work / f"{kind}{number}"
            shutil.copytree(before, folder)
            status, _ = run_apart(stage_in(name, folder, STAGES[name]), Writes(number, kind), heard)
            fault = _wrong_end(kind, status, heard.read_text())
            status, _ = run_apart(stage_in(name, folder, STAGES[name]), Writes(), heard)
            if status != 0:
                fault += f"; the next run failed: {heard.read_text()[-300:]}"
            found = contents(folder)
            different = [each for each in {*found, *expected} if found.get(each) != expected.get(each)]
            if different:
                fault += f"; other contents: {', '.join(sorted(different)[:4])}"
            yield kind, number, fault.removeprefix("; ")
            shutil.rmtree(folder)


def _wrong_end(kind: str, status: int, heard: str) -> str:
    if kind == "kill":
        return "" if status == -9 else f"ended with {status} instead of a signal"
    lines = heard.strip().splitlines() or [""]
    if status == 0:
        return "the fault was not noticed"
    return "" if lines[-1].startswith("error: ") and "Traceback" not in heard else f"no line for people: {lines[-1]}"
