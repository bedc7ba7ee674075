"""Locks in a folder: work on one file, one after the other."""

import multiprocessing
import time
from concurrent.futures import ThreadPoolExecutor

from pipeline.folders import alone


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
