"""A part of `python -m tests.faults`: a stage that is killed, or has no disk, and the harness itself."""

import os

from tests.faults.injection import Writes, contents, counted, run_apart
from tests.faults.stages import faults_of


def test_a_stage_that_was_killed_or_had_no_disk_ends_with_the_same_bytes_later(tmp_path):
    inputs, work = tmp_path / "inputs", tmp_path / "work"
    inputs.mkdir()
    work.mkdir()
    found = list(faults_of("published", inputs, work, most=1))
    assert {kind for kind, _, _ in found} == {"kill", "ENOSPC", "EIO"}
    assert [each for each in found if each[2]] == []


def test_the_harness_sees_a_write_that_is_not_whole(tmp_path):
    from hdsp.base import files

    def half_written():
        with files.replacing(tmp_path / "a.txt") as temporary:
            temporary.write_text("half")

    status, moments = run_apart(half_written, Writes(), tmp_path / "heard.txt")
    assert (status, moments) == (0, 3) and (tmp_path / "a.txt").read_text() == "half"
    before = contents(tmp_path)
    (tmp_path / "a.txt").unlink()
    status, _ = run_apart(half_written, Writes(2, "kill"), tmp_path / "heard.txt")
    assert status == -9 and contents(tmp_path) != before
    assert any(name.startswith(".a.") for name in os.listdir(tmp_path))
    status, _ = run_apart(half_written, Writes(1, "ENOSPC"), tmp_path / "heard.txt")
    assert status == 1 and "No space left" in (tmp_path / "heard.txt").read_text()
    with counted(Writes()):
        half_written()
    assert contents(tmp_path)["a.txt"] == b"half"
