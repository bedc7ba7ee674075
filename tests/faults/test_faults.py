"""A part of `python -m tests.faults`: a stage that is killed, or has no disk, and the harness itself."""

import os

from tests.faults.comparison import contents
from tests.faults.injection import Writes, counted, run_apart
from tests.faults.stages import faults_of


def test_a_stage_that_was_killed_or_had_no_disk_ends_with_the_same_bytes_later(tmp_path):
    inputs, work = tmp_path / "inputs", tmp_path / "work"
    inputs.mkdir()
    work.mkdir()
    kinds = ["kill", "torn", "ENOSPC", "clock", "two"]
    found = list(faults_of("published", inputs, work, most=1, kinds=kinds))
    assert [kind for kind, _, _ in found] == kinds
    assert [each for each in found if each[2]] == []


def test_the_harness_sees_a_write_that_is_not_whole(tmp_path):
    from hdsp.base import files

    folder = tmp_path / "run"
    folder.mkdir()

    def half_written():
        with files.replacing(folder / "a.txt") as temporary:
            temporary.write_text("half")

    writes, heard = Writes(folder), tmp_path / "heard.txt"
    assert run_apart(half_written, writes, heard) == 0 and (folder / "a.txt").read_text() == "half"
    order = [each for each in writes.events if each not in ("os.mkdir", "os.remove")]
    assert order == ["open", "fsync", "os.rename", "fsync", "end"]
    written = writes.events.index("fsync") + 1
    before = contents(folder)
    for kind, left in (("kill", b"half"), ("torn", b"ha")):
        (folder / "a.txt").unlink()
        assert run_apart(half_written, Writes(folder, written, kind), heard) == -9 and contents(folder) != before
        (found,) = os.listdir(folder)
        assert found.startswith(".a.") and (folder / found).read_bytes() == left
        assert run_apart(half_written, Writes(folder), heard) == 0 and contents(folder) == before
    assert run_apart(half_written, Writes(folder, written, "ENOSPC"), heard) == 1
    assert "No space left" in heard.read_text()
    with counted(Writes(folder)):
        half_written()
    assert contents(folder)["a.txt"] == b"half"


def test_a_folder_is_the_former_or_the_new_one_after_a_fault_at_any_moment(tmp_path):
    from hdsp.base import files

    place, heard = tmp_path / "run", tmp_path / "heard.txt"
    former, new = ({"a.txt": text, "b.txt": text} for text in (b"former", b"new"))

    def written(content):
        return lambda: files.replace_folder(place / "model", content)

    place.mkdir()
    written(former)()
    moments = Writes(place)
    assert run_apart(written(new), moments, heard) == 0
    renamings = [n + 1 for n, event in enumerate(moments.events) if event == "os.rename"]
    assert len(renamings) == 2
    for kind in ("kill", "ENOSPC"):
        for number in (1, *renamings, renamings[1] + 1):
            written(former)()
            ended = run_apart(written(new), Writes(place, number, kind), heard)
            found = {path.name: path.read_bytes() for path in (place / "model").glob("*")}
            # Between two renamings, the former folder lies beside its place.
            assert found in (former, new) or (kind != "ENOSPC" and not found and len(os.listdir(place)) == 2), kind
            assert ended == -9 or (ended == 1 and found == former) or found == new
            assert run_apart(written(new), Writes(place), heard) == 0
            assert os.listdir(place) == ["model"] and len(contents(place)) == 2


def test_what_differs_by_nature_is_left_out(tmp_path):
    (tmp_path / "a.json").write_text('{"seconds": 1, "cost": [{"search_seconds": 2, "time": 2, "value": 3}]}')
    (tmp_path / "a.csv").write_text("epoch,seconds\n1,2\n")
    (tmp_path / "tmp").mkdir()
    (tmp_path / "tmp/b").write_text("")
    assert contents(tmp_path) == {"a.json": {"cost": [{"value": 3}]}, "a.csv": [{"epoch": "1"}]}
