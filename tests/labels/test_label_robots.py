"""Labels of another robot are told from those of this one, wherever shards and indices record the robot."""

import json

import pytest

from hdsp.base.errors import InputError
from hdsp.base.storage import open_folder
from hdsp.labels.label_robots import is_of_other_robot, other_robot
from hdsp.labels.rules import LabelSettings
from hdsp.labels.scan_patches import ScanPatchSettings
from hdsp.labels.scan_sets import read_scan_folder
from hdsp.labels.shard_index import write_index
from hdsp.labels.shards import write_shard
from hdsp.robot.robot import Robot
from pipeline.config import configure
from pipeline.stage import Folders
from pipeline.task_sets import read_set
from pipeline.train import read_sets
from tests.labels.task_sets import random_tasks


@pytest.fixture(scope="module")
def robots():
    return Robot.load("momaro"), Robot.load("anymal_wheels")


def attributes(robot):
    return {"labels_hash": "x", "labels_inputs": json.dumps({"robot": robot.hash(), "code": "c"})}


def test_a_shard_records_its_robot_in_any_of_its_ways(robots):
    mine, theirs = robots
    for found in (
        attributes(theirs), {"robot_hash": theirs.hash()}, {"labels_inputs": json.dumps({"robot": theirs.to_dict()})},
    ):  # fmt: skip
        assert is_of_other_robot(found, mine) and not is_of_other_robot(found, theirs)
    for unknown in ({}, {"labels_inputs": "no JSON"}, {"labels_inputs": "[]"}, {"labels_inputs": "{}"}):
        assert not is_of_other_robot(unknown, mine)


def test_a_robot_of_the_same_name_with_other_limits_is_another_one(robots, tmp_path):
    mine, other = robots
    values = json.loads(json.dumps(mine.to_dict()))
    weaker = {**values, "step": {**values["step"], "max_length": values["step"]["max_length"] / 2}}
    older = {name: value for name, value in values.items() if name != "step"}
    for found, is_other in ((values, False), (weaker, True), (older, False), ({**older, "name": other.name}, True)):
        assert is_of_other_robot({"robot_hash": found}, mine) == is_other
        place = tmp_path / str(len(list(tmp_path.iterdir()))) / "abcdefabcdef/4-maps"
        write_index(open_folder(place), "abcdefabcdef" + "0" * 52, {"robot": found}, 4, 0)
        assert bool(other_robot(place.parent.parent, mine)) == is_other
    for name in Robot.presets():
        robot = Robot.load(name)
        assert not is_of_other_robot({"robot_hash": json.loads(json.dumps(robot.to_dict()))}, robot)


@pytest.mark.parametrize("indexed", [False, True])
def test_folders_with_labels_of_another_robot_are_named(robots, tmp_path, indexed):
    mine, theirs = robots
    for name, robot in (("mine", mine), ("theirs", theirs)):
        place = tmp_path / name / ("abcdefabcdef/shards/00000" if indexed else "")
        write_shard(place / "0.h5", random_tasks(2), attributes(mine if name == "theirs" and not indexed else robot))
        write_shard(place / "1.h5", random_tasks(2), attributes(robot))
        if indexed:
            index = open_folder(tmp_path / name / "abcdefabcdef/4-maps")
            shards = [{"name": f"00000/{number}.h5", "kept": 2} for number in range(2)]
            index.write("00000.json", json.dumps({"shards": shards}).encode())
            write_index(index, "abcdefabcdef" + "0" * 52, {"robot": robot.hash()}, 4, 1)
    assert other_robot(tmp_path / "mine", mine) == ""
    said = other_robot(tmp_path / "theirs", mine)
    where = "theirs" if indexed else "theirs/1.h5"
    assert said == f"the labels in {tmp_path / where} are of another robot than momaro as it is now"
    assert read_set(tmp_path / "theirs", mine) == (None, said) and len(read_set(tmp_path / "theirs")[0]) == 4

    config = configure([f"trainer.splits=[{tmp_path}/mine]", f"trainer.val_splits=[{tmp_path}/theirs]"])
    with pytest.raises(InputError, match=f"cannot train: the labels in {tmp_path / where} are of another robot"):
        read_sets(config, Folders(tmp_path, tmp_path))


def test_shards_of_another_robot_in_a_folder_of_scans_are_skipped(robots, tmp_path):
    mine, theirs = robots
    write_shard(tmp_path / "scans/a.h5", random_tasks(3), attributes(mine))
    write_shard(tmp_path / "scans/b.h5", random_tasks(3), attributes(theirs))
    found = read_scan_folder(tmp_path / "scans", mine, ScanPatchSettings(), LabelSettings(), tmp_path / "work")
    assert found.used == {"a.h5": 3}
    assert found.skipped == {"b.h5": "its labels are of another robot than momaro as it is now"}


@pytest.mark.parametrize(
    ("word", "shards"),
    [
        ("trainer.share=1", 5),
        ("trainer.share=0.5", 3),
        ("trainer.limits.overfit=2", 4),
        ("trainer.stream=true", 5),
    ],
)
def test_each_shard_is_read_once_on_the_way_into_a_training(robots, tmp_path, monkeypatch, word, shards):
    for name, robot in zip(("mine", "theirs"), robots, strict=True):
        for number in range(4):
            write_shard(tmp_path / f"{name}/{number}.h5", random_tasks(2, number), attributes(robot))
    write_shard(tmp_path / "val/0.h5", random_tasks(2, 9), attributes(robots[0]))
    kind, seen = type(open_folder(tmp_path)), []
    read = kind.read
    monkeypatch.setattr(kind, "read", lambda self, name: seen.append(f"{self.path}/{name}") or read(self, name))

    def sets(folder):
        places = [f"trainer.splits=[{tmp_path}/{folder}]", f"trainer.val_splits=[{tmp_path}/val]"]
        return read_sets(configure(["evaluation.watched=[]", *places, word]), Folders(tmp_path, tmp_path))

    sets("mine")
    assert len(seen) == len(set(seen)) == shards
    with pytest.raises(InputError, match=r"^cannot train: the labels in .*theirs/\d\.h5 are of another robot than mom"):
        sets("theirs")
