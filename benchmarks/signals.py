"""Seconds from a signal to the end of a command, with all of its processes.

    python -m benchmarks.signals [NAME ...] [--signals INT TERM] [--page docs/reliability.md]

Each command starts anew, works until it has told or written something, and gets Ctrl-C (every process of its group, as
from a terminal) or SIGTERM (the command alone). Its end is the moment at which its output is closed, which its last
process does. Beside the clock stands CPU time of the command from the signal on, because other work on the machine
lengthens the former: the load is printed as well. Files that are left among the temporary ones, and processes that are
left, count as faults.

The last line is JSON: `slowest` by the clock, `slowest_cpu`, and `faults`.
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
    "hdsp plan": Command(
        ("hdsp", "plan", "{}/map.npz", "--start", "1.2", "1.2", "0", "--goal", "14", "14", "0", "--heuristic",
         "geometric", "--weight", "1"), "search",
    ),
    "hdsp plan --improve": Command(
        ("hdsp", "plan", "{}/map.npz", "--start", "1.2", "1.2", "0", "--goal", "14", "14", "0", "--improve", "100"),
        "search",
    ),
    "hdsp warmup": Command(("hdsp", "warmup"), "compil"),
    "label": _label(1),
    "label, 2 workers": _label(2),
    "train": _stage("train", *LONG, ready="epoch   3"),
    "evaluate": _stage("evaluate", ready="val, manual"),
    "plan": _stage("plan", ready="geometric, W"),
    "sweep": _stage("train", "-m", "hydra.sweep.dir={}/sweep", "trainer.seed=1,2", *LONG, ready="epoch   3"),
    "sweep, joblib": _stage(
        "train", "-m", "hydra/launcher=joblib", "hydra.sweep.dir={}/sweep", "trainer.seed=1,2", *LONG, ready="epoch   3"
    ),
    "search": _stage("search", "trainer.seed=choice(1,2)", "search.trials=2", *LONG, ready="epoch   3"),
}  # fmt: skip


def measured(command: Command, number: int, folder: Path) -> dict[str, float | str]:
    """Runs a command, signals it at work, and returns ``seconds``, ``cpu`` and ``fault``."""
    from tests import heed_interrupts

    temporary = folder / "tmp"
    temporary.mkdir()
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "TMPDIR": str(temporary), "DVC_ROOT": str(folder)}
    words = [word.format(folder) for word in command.words]
    with (folder / "heard.txt").open("w") as heard:
        running = subprocess.Popen(
            [sys.executable, "-u", "-m", *words], stdout=subprocess.PIPE, stderr=subprocess.STDOUT, cwd=ROOT,
            env=environment, process_group=0, preexec_fn=heed_interrupts,
        )  # fmt: skip
        assert running.stdout is not None
        os.set_blocking(running.stdout.fileno(), False)
        until = time.monotonic() + PATIENCE
        told = ""
        while not _works(command.ready, told, folder):
            told += (running.stdout.read() or b"").decode("utf-8", "replace")
            if running.poll() is not None or time.monotonic() > until:
                running.kill()
                return {"seconds": 0.0, "cpu": 0.0, "fault": f"did not begin: {told[-300:]}"}
            time.sleep(0.02)
        family = [running.pid, *(one.pid for one in psutil.Process(running.pid).children(recursive=True))]
        before = sum(map(_cpu, family))
        (os.killpg if number == signal.SIGINT else os.kill)(running.pid, number)
        began = time.monotonic()
        os.set_blocking(running.stdout.fileno(), True)
        told += running.stdout.read().decode("utf-8", "replace")
        seconds = time.monotonic() - began
        _, status, usage = os.wait4(running.pid, 0)
        running.returncode = os.waitstatus_to_exitcode(status)
        seconds = max(seconds, time.monotonic() - began)
        heard.write(told)
    cpu = usage.ru_utime + usage.ru_stime - before
    return {"seconds": seconds, "cpu": cpu, "fault": _fault(running.returncode, number, told, family, temporary)}


def _works(ready: str, told: str, folder: Path) -> bool:
    return any((folder / "out").rglob(ready)) if ready.startswith("*") else ready in told


def _cpu(pid: int) -> float:
    try:
        times = psutil.Process(pid).cpu_times()
    except psutil.NoSuchProcess:
        return 0.0
    return times.user + times.system + times.children_user + times.children_system


def _is_alive(pid: int) -> bool:
    try:
        return psutil.Process(pid).status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False


def _fault(status: int, number: int, told: str, family: list[int], temporary: Path) -> str:
    lines = told.strip().splitlines() or [""]
    words = {signal.SIGINT: "interrupted", signal.SIGTERM: "terminated"}[signal.Signals(number)]
    found = []
    if status != 128 + number:
        found.append(f"exit status {status}")
    if lines[-1] != words or "Traceback" in told:
        found.append(f"last line {lines[-1]!r}")
    if alive := [pid for pid in family if _is_alive(pid)]:
        found.append(f"processes left: {', '.join(' '.join(psutil.Process(pid).cmdline())[:80] for pid in alive)}")
    # The compiler of torch makes a folder for its cache, which stays.
    if left := sorted(path.name for path in temporary.iterdir() if not path.name.startswith("torchinductor_")):
        found.append(f"left among temporary files: {', '.join(left[:3])}")
    return "; ".join(found)


def prepare(folder: Path, run: Callable[..., object] = subprocess.run) -> None:
    """Makes a map, labels and a trained abstraction."""
    import hdsp

    heights = np.zeros((400, 400), np.float32)
    heights[::16, ::16] = 0.3
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
    rows, found, loads = [], [], []
    with tempfile.TemporaryDirectory(prefix="signals-") as place:
        inputs = Path(place) / "inputs"
        inputs.mkdir()
        prepare(inputs)
        for name in arguments.names or COMMANDS:
            row: list = [name]
            for kind in arguments.signals:
                folder = Path(place) / f"{len(found)}"
                subprocess.run(["cp", "-r", str(inputs), str(folder)], check=True)
                result = measured(COMMANDS[name], SIGNALS[kind], folder)
                found.append(result)
                row.append(f"{result['seconds']:.1f}")
                loads.append(os.getloadavg()[0])
                print(f"{name}, {kind}: {result} at load {loads[-1]:.1f}", flush=True)
            rows.append(row)
    if arguments.page:
        head = ["command", *(f"SIG{kind}, s" for kind in arguments.signals)]
        words = f"Load of {min(loads):.0f} - {max(loads):.0f} on {os.cpu_count()} cores:\n\n"
        write_block(arguments.page, "benchmarks.signals", words + table(head, rows))
    result = {
        "slowest": round(max(float(one["seconds"]) for one in found), 2),
        "slowest_cpu": round(max(float(one["cpu"]) for one in found), 2),
        "faults": sum(bool(one["fault"]) for one in found),
    }
    print(json.dumps(result))
    return result


if __name__ == "__main__":
    main()
