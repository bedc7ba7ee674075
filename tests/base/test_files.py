import errno

import pytest

from hdsp.base.errors import InputError
from hdsp.base.files import existing_file, replacing


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
