"""Entries in `evaluation.sets`: allowed values, source of the labels, and folders to read from."""

from pathlib import Path

import numpy as np
import pytest

from hdsp.base.errors import InputError
from hdsp.labels.shards import write_shard
from pipeline.config import compose
from pipeline.label import shards_place
from pipeline.stage import Folders
from pipeline.task_sets import read_evaluation_set, read_set
from pipeline.train import folder_hash, part_of, train
from tests.labels.task_sets import random_tasks


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


def test_a_training_names_a_watched_set_that_is_none_before_it_reads_maps(tmp_path):
    with pytest.raises(InputError, match=r"evaluation.watched: unknown set 'nix'; evaluation.sets has random, "):
        train(compose(["evaluation.watched=[random,nix]"]), Folders(tmp_path, tmp_path))


def test_labels_are_read_at_their_destination_as_from_a_folder(tmp_path):
    elsewhere = compose(["labelling.destination=memory://elsewhere/labels/"])
    tasks = random_tasks(6)
    places = [shards_place(compose(), tmp_path, "train"), shards_place(elsewhere, tmp_path, "train")]
    assert places == [tmp_path / "data/labels/train", "memory://elsewhere/labels/train"]
    assert shards_place(elsewhere, tmp_path, "courses") == tmp_path / "data/labels/courses"  # scanned, not labelled
    assert read_set(places[1]) == (None, "memory://elsewhere/labels/train is not there yet")
    for place in places:
        for number in range(2):
            part = tasks[3 * number : 3 * number + 3]
            write_shard(f"{place}/{number}.h5", part, {"labels_hash": "0" * 64, "maps": 3})
        entry = {"tasks": place}
        read, _ = read_evaluation_set("random", entry, elsewhere, Folders(tmp_path, tmp_path))
        for found in (read, part_of([place], {}), part_of([place, place], {"share": 0.5})):
            assert len(found) == 6
        np.testing.assert_array_equal(read.heights, tasks.heights)
    assert folder_hash(places[0]) == folder_hash(places[1])
