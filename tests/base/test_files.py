import errno
import os
import subprocess
import sys
from pathlib import Path

import pytest

from hdsp.base import files
from hdsp.base.errors import InputError
from hdsp.base.files import existing_file, replace_folder, replacing, writable_file
from hdsp.base.storage import open_folder


def test_a_file_appears_whole_with_its_folder(tmp_path):
    path = tmp_path / "new" / "file.txt"
    with replacing(path) as temporary:
        temporary.write_text("half")
        assert not path.exists() and temporary.suffix == ".txt" and temporary.parent == path.parent
    assert path.read_text() == "half"
    assert list(path.parent.iterdir()) == [path]


def test_a_failure_leaves_what_was_there_and_nothing_else(tmp_path):
    path = tmp_path / "file.txt"
    path.write_text("old")
    with pytest.raises(KeyError), replacing(path) as temporary:
        temporary.write_text("new")
        raise KeyError
    with pytest.raises(InputError, match=r"cannot write .*file\.txt: No space left on device"), replacing(path):
        raise OSError(errno.ENOSPC, "No space left on device")
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_existing_file_says_what_is_missing(tmp_path):
    with pytest.raises(InputError, match=r"robot .*none\.yaml: no such file"):
        existing_file(tmp_path / "none.yaml", "robot")
    with pytest.raises(InputError, match="is a folder, not a file"):
        existing_file(tmp_path, "robot")


def test_names_that_the_system_refuses_are_told_in_one_line(tmp_path, monkeypatch):
    long = tmp_path / ("x" * 300)
    for check, says in (
        (existing_file, "robot .*: File name too long"),
        (writable_file, "cannot write .*: File name too long"),
        (lambda path, _: replace_folder(path, {"a": b""}), "cannot write .*: File name too long"),
    ):
        with pytest.raises(InputError, match=says):
            check(long, "robot")
    with pytest.raises(InputError, match="File name too long"):  # that of the temporary file alone
        writable_file(tmp_path / ("x" * 250), "map")
    for wrong in (5, None):
        with pytest.raises(InputError, match=f"path of robot is {wrong}; need a text or a Path"):
            existing_file(wrong, "robot")
    with pytest.raises(InputError, match="no such file"):
        existing_file("a\0b", "robot")
    monkeypatch.setattr(files.os, "stat", refusing)
    with pytest.raises(InputError, match=r"^robot closed/a\.yaml: Permission denied$"):
        existing_file("closed/a.yaml", "robot")


def test_a_folder_behind_a_link_is_replaced_and_the_link_stays(tmp_path):
    disk, link = tmp_path / "disk/model", tmp_path / "model"
    link.symlink_to(disk)
    for content in (b"first", b"second"):  # the first one makes the folder to which the link leads
        assert replace_folder(link, {"a": content}) == link
        assert link.is_symlink() and (disk / "a").read_bytes() == content
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["a", "disk", "model", "model"]


def test_the_working_folder_is_not_taken_away(tmp_path, monkeypatch):
    (tmp_path / "here/below").mkdir(parents=True)
    monkeypatch.chdir(tmp_path / "here/below")
    for place in (".", "..", tmp_path / "here", "/"):
        with pytest.raises(InputError, match=r"^cannot write .*: the working folder lies in it"):
            replace_folder(Path(place), {"a": b""})
    assert replace_folder(Path("../other"), {"a": b"b"}) == Path("../other")
    assert (tmp_path / "here/other/a").read_bytes() == b"b"


def refusing(*_, **__):
    raise PermissionError(errno.EACCES, "Permission denied")


def test_contents_and_name_are_on_the_disk_before_and_after_the_replacement(tmp_path, monkeypatch):
    path, synced = tmp_path / "file.txt", []

    def noted(opened):
        synced.append((os.path.realpath(f"/proc/self/fd/{opened}"), path.exists()))

    monkeypatch.setattr(files.os, "fsync", noted)
    with replacing(path) as temporary:
        temporary.write_text("whole")
    assert synced == [(str(temporary), False), (str(tmp_path), True)]


def test_h6_a_write_survives_a_run_that_removes_its_temporary_file(tmp_path, monkeypatch):
    folder, sync = open_folder(tmp_path), files._sync
    removals = iter([True, True])

    def removed_by_another_run(path):
        if next(removals, False):
            path.unlink()
        sync(path)

    monkeypatch.setattr(files, "_sync", removed_by_another_run)
    folder.write("shard.h5", b"labels")
    assert folder.names() == ["shard.h5"] and folder.read("shard.h5") == b"labels"
    removals = iter([True] * 100)
    with pytest.raises(InputError, match="No such file"):
        folder.write("shard.h5", b"others")
    assert folder.read("shard.h5") == b"labels"


def test_the_next_write_removes_what_a_killed_process_left_and_nothing_of_others(tmp_path):
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    dead, alive = tmp_path / f".a.{ended.pid}-0123abcd.tmp.txt", tmp_path / f".a.{os.getppid()}-0123abcd.tmp.txt"
    other = tmp_path / f".b.{ended.pid}-0123abcd.tmp.txt"
    for leftover in (dead, alive, other):
        leftover.touch()
    with replacing(tmp_path / "a.txt") as temporary:
        temporary.write_text("whole")
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(["a.txt", alive.name, other.name])
