"""Locks in a folder: work on one file, one after the other."""

import multiprocessing
import os
import subprocess
import time
from concurrent.futures import ThreadPoolExecutor

import pytest

from hdsp.base.errors import InputError
from pipeline import rwlock
from pipeline.folders import Folders, alone


def test_additions_at_once_lose_no_line(tmp_path):
    file = tmp_path / "lines.txt"

    def add(number):
        with alone(tmp_path, ".lock"):
            before = file.read_text() if file.exists() else ""
            file.write_text(f"{before}{number}\n")

    with ThreadPoolExecutor(8) as pool:
        list(pool.map(add, range(200)))
    assert sorted(map(int, file.read_text().split())) == list(range(200))


def _hold(folder, holds):
    with alone(folder, ".lock"):
        holds.set()
        time.sleep(600)


def test_a_killed_process_leaves_no_stale_lock(tmp_path, capsys):
    processes = multiprocessing.get_context("fork")
    holds = processes.Event()
    holder = processes.Process(target=_hold, args=(tmp_path, holds))
    holder.start()
    assert holds.wait(60)
    holder.kill()
    holder.join()
    assert (tmp_path / ".lock").is_file()  # it stays, and holds nobody up
    with alone(tmp_path, ".lock"):
        assert "waiting" not in capsys.readouterr().err


def test_outputs_below_a_file_are_named(tmp_path):
    (tmp_path / "file").touch()
    below = tmp_path / "file" / "out"
    for act in (lambda: Folders(tmp_path, below).write("reports", "a.json"), lambda: alone(below, ".lock").__enter__()):
        with pytest.raises(InputError, match=r"^cannot write .*file/out.*: Not a directory$"):
            act()
    (tmp_path / ".lock").mkdir()
    with pytest.raises(InputError, match=r"^cannot write .*\.lock: Is a directory$"), alone(tmp_path, ".lock"):
        pass


def test_half_a_lock_file_of_dvc_is_moved_aside(tmp_path):
    note = tmp_path / "rwlock"
    assert rwlock.mend(note) is None
    whole = '{"read": {"a": [{"pid": %d, "cmd": "dvc"}]}, "write": {}}'
    gone = subprocess.Popen(["true"])
    gone.wait()
    for text in (whole % os.getpid(), whole % gone.pid, (whole % os.getpid())[:-9]):
        note.write_text(text)
        assert rwlock.mend(note) is None and note.read_text() == text
    for half in ((whole % gone.pid)[:-9], '{"read": {}, "wri', ""):
        note.write_text(half)
        assert rwlock.mend(note).read_text() == half
        assert not note.exists()
