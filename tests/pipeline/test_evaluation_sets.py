"""Entries in `evaluation.sets`: allowed values, source of the labels, and folders to read from."""

from pathlib import Path

import numpy as np
import pytest

from hdsp.base.errors import InputError
from hdsp.base.storage import open_folder
from hdsp.labels.shard_index import write_index
from hdsp.labels.shards import shard_sizes, write_shard
from hdsp.labels.tasks import TaskSet
from hdsp.learning.learning_settings import TrainerSettings
from pipeline.config import configure
from pipeline.config_types import EvaluationSet
from pipeline.label_places import shards_place
from pipeline.stage import Folders
from pipeline.task_sets import read_evaluation_set, read_set
from pipeline.train import folder_hash, hashes_of, part_of, read_sets
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


def test_sets_without_a_map_are_told_as_unavailable_with_their_reason(config, tmp_path):
    def read(**entry):
        tasks, reason = read_evaluation_set("mine", EvaluationSet(**entry), config, Folders(tmp_path, tmp_path))
        assert tasks is None
        return reason

    write_shard(tmp_path / "real/none.h5", TaskSet.empty(), {"labels_hash": "0"})
    (tmp_path / "notes").mkdir()
    assert read(tasks="real") == f"{tmp_path}/real holds no maps: its shards are empty"
    assert read(tasks="real/none.h5") == f"{tmp_path}/real/none.h5 holds no maps: its shards are empty"
    assert read(tasks="notes") == f"{tmp_path}/notes holds no shard (*.h5)"
    assert f"folder of scans {tmp_path}/real gave no tasks (none.h5: " in read(scans=f"{tmp_path}/real")
    assert read(scans=f"{tmp_path}/notes") == f"folder of scans {tmp_path}/notes gave no tasks (it holds none)"


def test_a_watched_set_without_a_map_does_not_stop_a_training(tmp_path, capsys):
    config = configure(["trainer.splits=[./mine]", "trainer.val_splits=[./more]", "evaluation.watched=[real,random]"])
    for place, tasks in {"mine": random_tasks(3), "more": random_tasks(2), "data/real": TaskSet.empty()}.items():
        write_shard(tmp_path / place / "0.h5", tasks, {"labels_hash": "0"})
    _, sets, _ = read_sets(config, Folders(tmp_path, tmp_path))
    assert list(sets) == ["val"]
    assert f"real: not watched, {tmp_path}/data/real holds no maps" in capsys.readouterr().out
    write_shard(tmp_path / "more/0.h5", TaskSet.empty(), {"labels_hash": "0"})
    with pytest.raises(InputError, match=r"cannot train: .*more holds no maps"):
        read_sets(config, Folders(tmp_path, tmp_path))


def test_one_shard_is_a_set_with_a_hash_of_its_own(tmp_path):
    places = [tmp_path / "a.h5", tmp_path / "b.h5"]
    for number, place in enumerate(places):
        write_shard(place, random_tasks(2 + number, number), {"labels_hash": "0"})
        assert len(read_set(place)[0]) == 2 + number
        assert len(part_of([place], TrainerSettings())) == 2 + number
    assert folder_hash(places[0]) != folder_hash(places[1])
    assert shard_sizes(places[0]) == [(places[0], 2)]


def test_the_hash_of_a_folder_covers_all_shards_that_are_read_from_it(tmp_path):
    folder, elsewhere = tmp_path / "mine", tmp_path / "elsewhere"
    write_shard(folder / "shards/0.h5", random_tasks(2), {"labels_hash": "0"})
    write_shard(elsewhere / "1.h5", random_tasks(3), {"labels_hash": "0"})
    alone = folder_hash(folder)
    (folder / "linked").symlink_to(elsewhere)
    (folder / "around").symlink_to(tmp_path)  # has the folder itself in it
    (elsewhere / "loop").symlink_to("loop")
    (folder / "nothing").symlink_to("none")
    (elsewhere / "back").symlink_to(folder)
    read, _ = read_set(folder)
    assert len(read) == 8  # the linked folder is there twice, by its link and within the link to all
    both = folder_hash(folder)
    assert both != alone
    write_shard(elsewhere / "1.h5", random_tasks(3, 9), {"labels_hash": "0"})
    assert folder_hash(folder) not in (alone, both)


def test_a_watched_folder_of_scans_with_several_label_sets_has_the_hash_of_its_tasks(tmp_path):
    folder = tmp_path / "scans"
    for name in ("abcdefabcdef", "123456123456"):
        write_shard(folder / name / "shards/00000/0.h5", random_tasks(2), {"labels_hash": name})
        write_index(open_folder(folder / name / "2-maps"), name + "0" * 52, {}, 2, 0)
    for name in ("mine", "more"):
        write_shard(tmp_path / name / "0.h5", random_tasks(3), {"labels_hash": "0"})
    words = ["trainer.splits=[./mine]", "trainer.val_splits=[./more]", "evaluation.watched=[here]"]
    config = configure([*words, f"evaluation.sets.here={{scans: {folder}}}"])

    def hashes():
        _, sets, places = read_sets(config, Folders(tmp_path, tmp_path))
        return len(sets["here"]), hashes_of(config, places, sets)

    maps, before = hashes()
    assert maps == 4 and hashes() == (4, before)
    assert {name: before[name] for name in ("./mine", "./more")} == {
        name: folder_hash(tmp_path / name) for name in ("./mine", "./more")
    }
    write_shard(folder / "beside.h5", random_tasks(2, 5), {"labels_hash": "0"})
    maps, after = hashes()
    assert maps == 6 and after["here"] != before["here"] and after["./more"] == before["./more"]


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
