"""Seconds from a signal to the end of a command, with all of its processes.

    python -m benchmarks.signals [NAME ...] [--signals INT TERM] [--page docs/reliability.md]

Each command starts anew, works until it has told or written something, and gets Ctrl-C (every process of its group, as
from a terminal) or SIGTERM (the command alone). Its end is the moment at which its output is closed, which its last
process does. Other work on the machine lengthens it, so the load is printed as well. Temporary files that are left,
processes that are left after a second, and commands that did not begin count as faults; the page shows `-` for them.

The last line is JSON: `slowest` by the clock, and `faults`.
"""

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import psutil

from benchmarks.page import table, write_block

ROOT = Path(__file__).resolve().parents[1]
TINY = ("profile=tiny", "runtime.workers=1")
#: Options of the network `compact` that train in seconds.
NETWORK = ("model.options.widths=[4,4]", "model.options.blocks=[1,1]", "model.options.map_features=4")
LONG = ("trainer.epochs=100000", *NETWORK)
PLAN = ("hdsp", "plan", "{}/map.npz", "--start", "1.2", "1.2", "0", "--goal", "8.6", "1.2", "0")
#: Seconds to wait for a command to begin its work, and to end.
PATIENCE = 300.0
SIGNALS = {"INT": signal.SIGINT, "TERM": signal.SIGTERM}


@dataclass(frozen=True)
class Command:
    """A command that works for long.

    Attributes:
        words: what follows ``python -m``; ``{}`` is the folder of results.
        ready: text in its output, or a pattern of files, that tells that it works.
    """

    words: tuple[str, ...]
    ready: str


def _stage(name: str, *words: str, ready: str) -> Command:
    places = ("runtime.inputs={}", "runtime.outputs={}/out")
    return Command((f"pipeline.{name}", *TINY, *places, *words), ready)


def _label(workers: int) -> Command:
    words = ("labelling.splits.val.maps_per_category=1000", "labelling.splits.val.maps_per_shard=4")
    return _stage("label", "val", *words, f"runtime.workers={workers}", "runtime.dashboard=null", ready="*.h5")


COMMANDS: dict[str, Command] = {
    "hdsp plan": Command((*PLAN, "--heuristic", "geometric", "--weight", "1"), "planning:"),
    "hdsp plan --improve": Command((*PLAN, "--improve", "100"), "planning:"),
    "hdsp warmup": Command(("hdsp", "warmup"), "compil"),
    "label": _label(1),
    "label, 2 workers": _label(2),
    "train": _stage("train", *LONG, ready="epoch   3"),
    "evaluate": _stage("evaluate", ready="random, "),
    "plan": _stage("plan", ready="geometric, W"),
    "sweep": _stage("train", "-m", "hydra.sweep.dir={}/sweep", "trainer.seed=1,2", *LONG, ready="epoch   3"),
    "sweep, joblib": _stage(
        "train", "-m", "hydra/launcher=joblib", "hydra.sweep.dir={}/sweep", "trainer.seed=1,2", *LONG, ready="epoch   3"
    ),
    "search": _stage("search", "trainer.seed=choice(1,2)", "search.trials=2", *LONG, ready="epoch   3"),
}  # fmt: skip


def measured(command: Command, number: int, folder: Path) -> tuple[float | None, str]:
    """Runs a command, and signals it at work; returns the seconds, None if it did not begin, and its faults."""
    from tests import heed_interrupts

    temporary = folder / "tmp"
    temporary.mkdir()
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "TMPDIR": str(temporary), "DVC_ROOT": str(folder)}
    if "warmup" in command.words:
        environment["NUMBA_CACHE_DIR"] = str(folder / "kernels")
    words = [word.format(folder) for word in command.words]
    with subprocess.Popen(
        [sys.executable, "-u", "-m", *words], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, cwd=ROOT,
        env=environment, process_group=0, preexec_fn=heed_interrupts,
    ) as running:  # fmt: skip
        assert running.stdout is not None
        os.set_blocking(running.stdout.fileno(), False)
        until = time.monotonic() + PATIENCE
        told = ""
        while not _works(command.ready, told, folder):
            told += (running.stdout.read() or b"").decode("utf-8", "replace")
            if running.poll() is not None or time.monotonic() > until:
                running.kill()
                return None, f"did not begin: {told[-300:]}"
            time.sleep(0.02)
        family = psutil.Process(running.pid).children(recursive=True)
        (os.killpg if number == signal.SIGINT else os.kill)(running.pid, number)
        began = time.monotonic()
        os.set_blocking(running.stdout.fileno(), True)
        told += running.stdout.read().decode("utf-8", "replace")
        running.wait()
        seconds = time.monotonic() - began
    return seconds, _fault(running.returncode, number, told, family, temporary)


def _works(ready: str, told: str, folder: Path) -> bool:
    return any((folder / "out").rglob(ready)) if ready.startswith("*") else ready in told


def _fault(status: int, number: int, told: str, family: list[psutil.Process], temporary: Path) -> str:
    lines = told.strip().splitlines() or [""]
    words = {signal.SIGINT: "interrupted", signal.SIGTERM: "terminated"}[signal.Signals(number)]
    found = []
    if status != 128 + number:
        found.append(f"exit status {status}")
    if lines[-1] != words or "Traceback" in told:
        found.append(f"last line {lines[-1]!r}")
    left_over = psutil.wait_procs(family, timeout=1)[1]
    if alive := [process for process in left_over if not _is_zombie(process)]:
        found.append(f"processes left: {', '.join(process.name() for process in alive)}")
    # The compiler of torch makes a folder for its cache, which stays.
    if left := sorted(path.name for path in temporary.iterdir() if not path.name.startswith("torchinductor_")):
        found.append(f"left among temporary files: {', '.join(left[:3])}")
    return "; ".join(found)


def _is_zombie(process: psutil.Process) -> bool:
    """Whether a process has ended, and nobody has asked for its status."""
    try:
        return process.status() == psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return True


def prepare(folder: Path, run: Callable[..., object] = subprocess.run) -> None:
    """Makes a map, labels and a trained abstraction."""
    import hdsp

    heights = np.zeros((400, 400), np.float32)
    heights[196:204, :360] = 0.3
    hdsp.HeightMap(heights).save(folder / "map.npz")
    places = (f"runtime.inputs={folder}", f"runtime.outputs={folder}")
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "DVC_ROOT": str(folder)}
    steps = [["pipeline.label", split] for split in ("train", "val", "random")]
    for step in [*steps, ["pipeline.published"], ["pipeline.train", *NETWORK]]:
        command = [sys.executable, "-m", *step, *TINY, *places]
        run(command, cwd=ROOT, env=environment, check=True, capture_output=True)
    (folder / "data/arena").mkdir(parents=True)
    (folder / "data/arena/absent.json").write_text('{"reason": "none"}')


def main(argv: list[str] | None = None) -> dict:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"some of {', '.join(COMMANDS)}")
    parser.add_argument("--signals", nargs="+", choices=SIGNALS, default=list(SIGNALS))
    parser.add_argument("--page", type=Path, help="docs page to update")
    arguments = parser.parse_args(argv)
    rows, loads = [], []
    found: list[tuple[float | None, str]] = []
    with tempfile.TemporaryDirectory(prefix="signals-") as place:
        inputs = Path(place) / "inputs"
        inputs.mkdir()
        prepare(inputs)
        for name in arguments.names or COMMANDS:
            row: list = [name]
            for kind in arguments.signals:
                folder = Path(place) / f"{len(found)}"
                subprocess.run(["cp", "-r", str(inputs), str(folder)], check=True)
                seconds, fault = measured(COMMANDS[name], SIGNALS[kind], folder)
                found.append((seconds, fault))
                row.append("-" if seconds is None else f"{seconds:.1f}")
                loads.append(os.getloadavg()[0])
                print(f"{name}, {kind}: {row[-1]} s at load {loads[-1]:.1f} {fault}", flush=True)
            rows.append(row)
    if arguments.page:
        head = ["command", *(f"SIG{kind}, s" for kind in arguments.signals)]
        words = f"Load of at most {max(loads):.1f} on {os.cpu_count()} cores:\n\n"
        write_block(arguments.page, "benchmarks.signals", words + table(head, rows))
    result = {
        "slowest": round(max((seconds for seconds, _ in found if seconds is not None), default=0.0), 2),
        "faults": sum(bool(fault) for _, fault in found),
    }
    print(json.dumps(result))
    return result


if __name__ == "__main__":
    main()
