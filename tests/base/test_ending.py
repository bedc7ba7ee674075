"""SIGTERM and Ctrl-C end real processes soon, with one line, the right exit status and nothing left behind."""

import contextlib
import errno
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest
import sqlalchemy
from distributed import KilledWorker

from hdsp.base.ending import LATEST, Ended, ended_by, status_of
from hdsp.base.errors import InputError
from hdsp.base.workers import ClusterSettings, connected
from pipeline.command_line import ends_in_one_line
from tests import ROOT, heed_interrupts

#: Seconds by which a busy machine may be late.
LATE = 6.0

SCRIPTS = {
    "search": """
import sys, numpy as np, hdsp
from hdsp.planning import cli
heights = np.zeros((400, 400), np.float32)
heights[::16, ::16] = 0.3
hdsp.HeightMap(heights).save("m.npz")
from hdsp.detailed.search import life_cycle
run = life_cycle.Search._run
def told(search, expansions):
    print("ready", flush=True)
    return run(search, expansions)
life_cycle.Search._run = told
sys.exit(cli.main(["plan", "m.npz", "--start", "1.2", "1.2", "0", "--goal", "9", "9", "0", "--heuristic", "geometric",
                   "--quiet", "--out", "p.csv", "--weight", "1"]))
""",
    "workers": """
import sys, time
from pipeline.stage import run_stage
from hdsp.base.workers import ClusterSettings, connected
def stage(config, folders):
    with connected(ClusterSettings(workers=2, dashboard=None), 2) as client:
        pids = list(client.run(__import__("os").getpid).values())
        waiting = client.map(time.sleep, [60, 61])
        time.sleep(0.3)
        print("ready", *pids, flush=True)
        client.gather(waiting)
sys.argv = ["stage", "profile=tiny", "runtime.outputs=out"]
run_stage(stage, "label")
""",
    "library": """
import atexit, subprocess, sys, time
from pipeline.command_line import ends_in_one_line
atexit.register(time.sleep, 60)  # as large libraries do
child = subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"])
with ends_in_one_line():
    try:
        print("ready", child.pid, flush=True)
        time.sleep(60)
    except BaseException:  # as Lightning does
        sys.exit(0)
""",
    "deaf": """
import signal, time
from hdsp.base.ending import ended_by
with ended_by(signal.SIGTERM):
    for turn in range(100):
        try:
            if turn == 0:
                print("ready", flush=True)
            time.sleep(0.9)
        except BaseException:  # code that takes no notice
            pass
""",
}


def alive(pid: int) -> bool:
    status = Path(f"/proc/{pid}/stat")
    return status.exists() and status.read_text().rpartition(")")[2].split()[0] != "Z"


@pytest.mark.parametrize(
    ("script", "number"),
    [
        ("search", signal.SIGTERM),
        ("workers", signal.SIGINT),
        ("library", signal.SIGTERM),
        ("deaf", signal.SIGTERM),
    ],
)
def test_a_signal_ends_work_with_one_line_and_leaves_nothing(script, number, tmp_path):
    with subprocess.Popen(
        [sys.executable, "-c", SCRIPTS[script]], cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
        text=True, env={**os.environ, "PYTHONPATH": str(ROOT)}, preexec_fn=heed_interrupts,
    ) as running:  # fmt: skip
        while not (told := running.stdout.readline()).startswith("ready"):
            assert told, running.stderr.read()
        files = sorted(path.name for path in tmp_path.rglob("*"))
        running.send_signal(number)
        began = time.monotonic()
        _, heard = running.communicate(timeout=60)
        seconds = time.monotonic() - began
    words = "interrupted" if number == signal.SIGINT else "terminated"
    assert running.returncode == 128 + number, heard
    assert heard.splitlines()[-1] == words and "Traceback" not in heard
    assert seconds < LATEST + LATE
    assert sorted(path.name for path in tmp_path.rglob("*")) == files
    until = time.monotonic() + LATE
    while any(alive(int(pid)) for pid in told.split()[1:]):
        assert time.monotonic() < until
        time.sleep(0.05)


def test_handlers_are_as_before_after_a_block():
    before = signal.getsignal(signal.SIGTERM), signal.getsignal(signal.SIGINT)
    with ended_by(signal.SIGTERM, signal.SIGINT):
        assert signal.getsignal(signal.SIGTERM) != before[0]
    assert (signal.getsignal(signal.SIGTERM), signal.getsignal(signal.SIGINT)) == before
    threads = threading.active_count()
    found = []

    def elsewhere():
        with ended_by(signal.SIGTERM):
            found.append(signal.getsignal(signal.SIGTERM))

    thread = threading.Thread(target=elsewhere)
    thread.start()
    thread.join()
    assert found == [before[0]] and threading.active_count() <= threads


def test_an_end_is_no_ordinary_exception():
    end = Ended(signal.SIGTERM)
    assert (status_of(end.number), str(end)) == (143, "terminated") and not isinstance(
        end, (Exception, KeyboardInterrupt)
    )


def test_a_full_disk_is_one_line_however_a_library_wraps_it(capsys):
    def wrapped(number):
        try:
            raise OSError(number, os.strerror(number), "a.txt")
        except OSError:
            raise RuntimeError("failed")  # noqa: B904, as some libraries do

    with pytest.raises(SystemExit, match=r"^error: cannot write a.txt: No space left on device$"), ends_in_one_line():
        wrapped(errno.ENOSPC)
    for number in (errno.ENOENT, errno.EACCES):  # such an error may have been handled, before another one
        with pytest.raises(RuntimeError, match="failed"), ends_in_one_line():
            wrapped(number)


@pytest.mark.parametrize("number", [errno.EACCES, errno.ENOTDIR, errno.ENAMETOOLONG])
def test_a_place_that_cannot_be_used_and_a_damaged_database_are_one_line(number):
    with pytest.raises(SystemExit, match=f"^error: cannot use a.txt: {os.strerror(number)}$"), ends_in_one_line():
        raise RuntimeError from OSError(number, os.strerror(number), "a.txt")
    damaged = sqlalchemy.exc.DatabaseError("SELECT 1", (), Exception("file is not a database"))
    with pytest.raises(SystemExit, match=r"^error: cannot use a database: file is not a database$"), ends_in_one_line():
        raise RuntimeError from damaged


def test_parts_of_the_work_that_end_their_workers_are_one_line(monkeypatch):
    monkeypatch.setattr("distributed.Client", lambda *_, **__: contextlib.nullcontext())
    with (
        pytest.raises(InputError, match=r"^worker processes end whenever .* Try again with fewer workers$"),
        connected(ClusterSettings(scheduler="inproc://x"), 2),
    ):
        raise KilledWorker("part", None, 3)
