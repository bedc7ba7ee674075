"""Entries in `evaluation.sets`: allowed values, source of the labels, and folders to read from."""

from pathlib import Path

import numpy as np
import pytest

from hdsp.base.errors import InputError
from hdsp.labels.shards import write_shard
from hdsp.learning.learning_settings import TrainerSettings
from pipeline.config import configure
from pipeline.config_types import EvaluationSet
from pipeline.label_places import shards_place
from pipeline.stage import Folders
from pipeline.task_sets import read_evaluation_set, read_set
from pipeline.train import folder_hash, part_of
from tests.labels.task_sets import random_tasks


@pytest.fixture(scope="module")
def config():
    return configure(["robot=anymal_wheels"])


def test_labels_of_another_robot_are_left_out(config, tmp_path):
    entry = config.evaluation.sets["published"]
    tasks, reason = read_evaluation_set("published", entry, config, Folders(tmp_path, tmp_path))
    assert tasks is None and reason == "its labels are of robot momaro"


def test_sets_that_are_not_there_yet_are_named(config, tmp_path):
    tasks, reason = read_evaluation_set("x", EvaluationSet("data/x"), config, Folders(Path(tmp_path), tmp_path))
    assert tasks is None and "data/x is not there yet" in reason


@pytest.mark.parametrize(
    ("entry", "says"),
    [
        (
            "{scan: x}",
            r"evaluation\.sets\.mine: unknown key 'scan'; did you mean 'scans'\? allowed are paper, robot",
        ),
        ("{paper: random}", r"evaluation\.sets\.mine is .*; need either tasks"),
        ("{tasks: x, scans: x}", r"evaluation\.sets\.mine is .*; need either tasks"),
        ("{tasks: x, split: val}", r"evaluation\.sets\.mine is .*; need either tasks"),
        ("{split: vla}", r"evaluation\.sets\.mine\.split is 'vla'; need one of train, val, random"),
    ],
)
def test_wrong_entries_are_named(entry, says):
    with pytest.raises(InputError, match=says):
        configure([f"evaluation.sets.mine={entry}"])


def test_a_folder_of_scans_that_is_not_there_is_named(config, tmp_path):
    with pytest.raises(InputError, match="folder of scans nowhere: no such folder"):
        read_evaluation_set("mine", EvaluationSet(scans="nowhere"), config, Folders(tmp_path, tmp_path))


def test_a_watched_set_that_is_none_is_named():
    with pytest.raises(InputError, match=r"evaluation\.watched\[1\] is 'nix'; need one of evaluation\.sets: random, "):
        configure(["evaluation.watched=[random,nix]"])


def test_labels_are_read_at_their_destination_as_from_a_folder(tmp_path):
    elsewhere = configure(["labelling.destination=memory://elsewhere/labels/"])
    tasks = random_tasks(6)
    places = [shards_place(configure(), tmp_path, "train"), shards_place(elsewhere, tmp_path, "train")]
    kind = str(places[0].relative_to(tmp_path / "data/labels/train"))
    assert places[1] == f"memory://elsewhere/labels/train/{kind}"
    courses = shards_place(configure(["profile=beyond", "labelling.destination=memory://x"]), tmp_path, "courses")
    assert courses.is_relative_to(tmp_path / "data/labels/courses")  # scanned, not labelled
    missing = "memory://elsewhere/labels/train holds no finished labels of this configuration and code; "
    found, reason = read_set(places[1])
    assert found is None and reason.startswith(f"{missing}`python -m pipeline.label train` or")
    for place in places:
        for number in range(2):
            part = tasks[3 * number : 3 * number + 3]
            write_shard(f"{place}/{number}.h5", part, {"labels_hash": "0" * 64, "maps": 3})
        config = elsewhere if place == places[1] else configure()
        read, _ = read_evaluation_set("random", EvaluationSet(split="train"), config, Folders(tmp_path, tmp_path))
        for found in (read, part_of([place], TrainerSettings()), part_of([place, place], TrainerSettings(share=0.5))):
            assert len(found) == 6
        np.testing.assert_array_equal(read.heights, tasks.heights)
    assert folder_hash(places[0]) == folder_hash(places[1])
