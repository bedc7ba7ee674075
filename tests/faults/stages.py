"""Stages of the pipeline on the tiny profile, to be run with faults."""

from __future__ import annotations

import importlib
import os
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from tests.faults.comparison import contents
from tests.faults.injection import KINDS, Writes, begun_apart, run_apart

#: Kinds of faults: those of `injection`; a kill after which the clock goes back by an hour; two runs at once.
ALL = (*KINDS, "clock", "two")
#: Options of the network `compact` that train in seconds, and a search that ends by its expansions.
NETWORK = ("model.options.widths=[4,4]", "model.options.blocks=[1,1]", "model.options.map_features=4")
SEARCH = (
    "planner.heuristics=[manual]", "planner.weights=[2.0]", "planner.repeats=1", "planner.random.arenas=1",
    "planner.random.tasks=1", "planner.random.expansions=2000", "planner.limits.expansions=20000",
    "planner.limits.time=100",
)  # fmt: skip
#: Modules that a process loads once, for all of its copies.
LOADED = (
    "hdsp.learning",
    "hdsp.viz",
    "mlflow.pyfunc",
    "mlflow.data.meta_dataset",
    "sqlalchemy",
    "pipeline.served_model",
)
#: Stages that need them.
LEARNING = ("train", "evaluate", "publish_model")
#: Seconds that a clock goes back.
BACK = 3600.0


@dataclass(frozen=True)
class FaultyStage:
    """A stage.

    Attributes:
        words: its arguments and overrides.
        needs: calls without faults before it: stages of the pipeline with their words.
    """

    words: tuple[str, ...] = ()
    needs: tuple[tuple[str, ...], ...] = ()


LABELS = tuple(("label", split) for split in ("train", "val", "random"))
TRAINED = (*LABELS, ("published",), ("train", *NETWORK))
#: Stages by name. `repro` is that of `make repro`, for one stage in a clone of the project.
STAGES = {
    "label": FaultyStage(("val",)),
    "published": FaultyStage(),
    "train": FaultyStage(NETWORK, TRAINED[:-1]),
    "evaluate": FaultyStage((), TRAINED),
    "plan": FaultyStage(SEARCH),
    "publish_model": FaultyStage(("models/abstraction",), TRAINED),
    "report": FaultyStage(SEARCH, (*TRAINED, ("evaluate",), ("plan", *SEARCH))),
    "repro": FaultyStage(),
}


def stage_in(name: str, folder: Path, words: tuple[str, ...]) -> Callable[[], object]:
    """Returns a call of a stage on the tiny profile, with inputs and outputs in one folder."""
    if name == "repro":
        return _repro_in(folder)
    module = importlib.import_module(f"pipeline.{name}")
    (folder / "tmp").mkdir(exist_ok=True)
    for each in LOADED if name in LEARNING else ():
        importlib.import_module(each)
    tiny = ("profile=tiny", f"runtime.inputs={folder}", f"runtime.outputs={folder}", "runtime.workers=1")
    names = tuple(each for each in words if "=" not in each)
    argv = [name, *names, *tiny, "runtime.progress=false", *(each for each in words if "=" in each)]

    def call() -> None:
        from pipeline.stage import run_stage

        _enter(folder)
        sys.argv = argv
        run_stage(getattr(module, name), name, ["word"] * len(names))

    return call


def _enter(folder: Path) -> None:
    os.chdir(folder)
    os.environ |= {"DVC_ROOT": str(folder), "TMPDIR": str(folder / "tmp")}
    tempfile.tempdir = None


def _repro_in(folder: Path) -> Callable[[], object]:
    importlib.import_module("dvc.commands.repro")

    def call() -> None:
        from dvc.cli import main

        from pipeline.rwlock import mend

        os.chdir(folder)
        os.environ["DVC_NO_ANALYTICS"] = "1"
        os.environ["PYTHONPATH"] = str(folder)
        mend()
        sys.exit(main(["repro", "--single-item", "published"]))

    return call


def prepare(name: str, folder: Path, heard: Path) -> None:
    """Makes what a stage needs in a folder; results that are there already stay."""
    if name == "repro":
        from tests.pipeline.conftest import clone_project, run_python

        clone_project(folder)
        run_python("pipeline.code", cwd=folder)
        return
    from pipeline.stage import write_json
    from pipeline.task_sets import ABSENT

    if not (folder / "data/arena").is_dir():
        write_json(folder / "data/arena" / ABSENT, {"reason": "none"})
    for need, *words in STAGES[name].needs:
        done = folder / "tmp" / f"{need} {words[:1]}"
        if not done.is_file():
            status = run_apart(stage_in(need, folder, tuple(words)), Writes(folder), heard)
            assert status == 0, heard.read_text()
            done.touch()


def faults_of(
    name: str,
    inputs: Path,
    work: Path,
    most: int | None = None,
    told: Callable[[int], object] = lambda moments: None,
    kinds: Sequence[str] = ALL,
    every: Sequence[str] = (),
) -> Iterator[tuple[str, int, str]]:
    """Runs a stage with a fault at each moment of its writes, then again without.

    Args:
        name: the stage.
        inputs: folder with results of earlier stages; gets what this stage needs.
        work: empty folder.
        most: number of moments to try for each kind of fault, spread over all; None: all.
        told: gets the number of moments.
        kinds: some of ``ALL``.
        every: kinds that are tried at all moments.

    Yields:
        Kind of the fault, its moment, and what is wrong: nothing, if the second run ended with the same bytes.
    """
    heard, words = work / "heard.txt", STAGES[name].words
    inputs = inputs / "project" if name == "repro" else inputs
    inputs.mkdir(exist_ok=True)
    prepare(name, inputs, heard)
    # The same folder as that of all other runs, since reports name what lies in none.
    whole = _copy(inputs, work / "run")
    writes = Writes(whole)
    status = run_apart(stage_in(name, whole, words), writes, heard)
    assert status == 0, heard.read_text()
    told(len(writes.events))
    expected = contents(whole)
    for kind in [each for each in kinds if each != "two"]:
        numbers = writes.numbers("kill" if kind == "clock" else kind)
        wanted = most if kind != "clock" else min(most or 3, 3)
        if kind not in every and wanted is not None and wanted < len(numbers):
            numbers = [numbers[(2 * k + 1) * len(numbers) // (2 * wanted)] for k in range(wanted)]
        for number in numbers:
            folder = _copy(inputs, work / "run")
            broken = Writes(folder, number, "kill" if kind == "clock" else kind)
            status = run_apart(stage_in(name, folder, words), broken, heard)
            fault = _wrong_end(name, broken.kind, status, heard.read_text())
            if kind == "clock":
                _from_the_future(folder)
            yield kind, number, _joined(fault, _again(name, folder, heard, expected))
    if "two" not in kinds:
        return
    folder = _copy(inputs, work / "run")
    ends = [begun_apart(stage_in(name, folder, words), Writes(folder), work / f"heard{k}.txt") for k in range(2)]
    faults = [_wrong_end(name, "two", end(), (work / f"heard{k}.txt").read_text()) for k, end in enumerate(ends)]
    yield "two", 0, _joined(*faults, _again(name, folder, heard, expected))


def _copy(inputs: Path, folder: Path) -> Path:
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(inputs, folder, symlinks=True)
    return folder


def _from_the_future(folder: Path) -> None:
    for path in folder.rglob("*"):
        if path.is_file() and ".git" not in path.parts:
            times = path.stat()
            os.utime(path, (times.st_atime + BACK, times.st_mtime + BACK))


def _again(name: str, folder: Path, heard: Path, expected: dict[str, object]) -> str:
    status = run_apart(stage_in(name, folder, STAGES[name].words), Writes(folder), heard)
    fault = "" if status == 0 else f"the next run failed: {heard.read_text()[-300:]}"
    found = contents(folder)
    different = [each for each in {*found, *expected} if found.get(each) != expected.get(each)]
    return _joined(fault, f"other contents: {', '.join(sorted(different)[:4])}" if different else "")


def _joined(*faults: str) -> str:
    return "; ".join(filter(None, faults))


def _wrong_end(name: str, kind: str, status: int, heard: str) -> str:
    if kind in ("kill", "torn"):
        return "" if status == -9 else f"ended with {status} instead of a signal"
    if status == 0:
        return ""  # the write did not matter, or nothing went wrong
    line = (heard.strip().splitlines() or [""])[-1]
    if name == "repro":  # lines of DVC
        return "Traceback" if "Traceback" in heard else ""
    return "" if line.startswith("error: ") and "Traceback" not in heard else f"no line for people: {line}"
