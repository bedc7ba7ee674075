"""Locks in a folder: work on one file, one after the other."""

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
