"""Entries of `evaluation.sets`: what they may say, and whose labels they are."""

from pathlib import Path

import pytest

from hdsp.errors import InputError
from pipeline.config import compose
from pipeline.data import read_evaluation_set
from pipeline.stage import Folders


@pytest.fixture(scope="module")
def config():
    return compose(["robot=anymal_wheels"])


def test_labels_of_another_robot_are_left_out(config, tmp_path):
    entry = dict(config.evaluation.sets.published)
    tasks, reason = read_evaluation_set("published", entry, config, Folders(tmp_path, tmp_path))
    assert tasks is None and reason == "its labels are of robot momaro"


def test_sets_that_are_not_there_yet_are_named(config, tmp_path):
    tasks, reason = read_evaluation_set("x", {"tasks": "data/x"}, config, Folders(Path(tmp_path), tmp_path))
    assert tasks is None and "data/x is not there yet" in reason


@pytest.mark.parametrize(
    ("entry", "says"),
    [
        ({"scan": "x"}, "unknown key 'scan'; allowed are tasks, scans, paper, robot"),
        ({"paper": None}, "need either tasks"),
        ({"tasks": "x", "scans": "x"}, "need either tasks"),
        ({"scans": "nowhere"}, "folder of scans nowhere: no such folder"),
    ],
)
def test_wrong_entries_are_named(config, tmp_path, entry, says):
    with pytest.raises(InputError, match=says):
        read_evaluation_set("mine", entry, config, Folders(tmp_path, tmp_path))
