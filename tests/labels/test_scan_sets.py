"""User folders with scans: descriptions, shards, height maps and clouds."""

import hashlib
import os

import numpy as np
import pytest
import yaml

from hdsp import HeightMap, InputError, Robot
from hdsp.labels.rules import LabelSettings
from hdsp.labels.scan_patches import ScanPatchSettings
from hdsp.labels.scan_sets import NoTasksError, read_scan_folder
from hdsp.labels.shards import write_shard
from tests.learning.synthetic import synthetic_tasks
from tests.terrain.pointcloud.clouds import box, rectangle

PATCHES = ScanPatchSettings(count=1, flat=1.0, heading_residues=(0,))
ABOUT = {"what": "ground", "sensor": "none", "licence": "MIT", "source": "https://example.org"}


def read(folder, tmp_path):
    return read_scan_folder(folder, Robot.load("momaro"), PATCHES, LabelSettings(), tmp_path / "work")


@pytest.fixture
def folder(tmp_path):
    folder = tmp_path / "mine"
    (folder / "yard").mkdir(parents=True)
    cloud = np.concatenate([rectangle((-2, 2), (-2, 2), 0.4), box((1.2, 1.6), (-2, 2), 0.9)])
    np.savetxt(folder / "yard" / "a.xyz", cloud)
    checksum = hashlib.sha256((folder / "yard" / "a.xyz").read_bytes()).hexdigest()
    about = {**ABOUT, "place": "the yard", "address": "http://127.0.0.1:9/"}
    text = yaml.safe_dump({**about, "files": [{"path": "a.xyz", "sha256": checksum}]})
    (folder / "one.yaml").write_text("# @package scans.sources.yard\n" + text)
    write_shard(folder / "labelled.h5", synthetic_tasks(3), {"labels_hash": "0"})
    HeightMap.flat((100, 100)).save(folder / "hall.npz")
    (folder / "notes.txt").write_text("about these scans\n")
    return folder


def test_everything_in_a_folder_is_judged_and_the_rest_named(folder, tmp_path):
    found = read(folder, tmp_path)
    assert found.used == {"yard": 1, "hall.npz": 1, "labelled.h5": 3}
    assert list(found.skipped) == ["notes.txt"]
    assert list(found.tasks.category) == ["the yard", "hall", "block", "block", "block"]
    shards = sorted((tmp_path / "work").iterdir())
    assert len(shards) == 2
    before = [os.stat(path).st_mtime_ns for path in shards]
    read(folder, tmp_path)
    assert [os.stat(path).st_mtime_ns for path in shards] == before  # valid labels are kept


def test_a_scan_that_is_not_to_be_had_does_not_keep_the_others_from_being_judged(folder, tmp_path):
    (folder / "yard" / "a.xyz").unlink()
    found = read(folder, tmp_path)
    assert "scan yard" in found.skipped["yard"] and "hall.npz" in found.used


def test_a_file_that_is_not_the_described_one_is_refused_and_the_others_are_judged(folder, tmp_path):
    (folder / "yard" / "a.xyz").write_text("0 0 0\n")
    (folder / "damaged.h5").write_bytes((folder / "labelled.h5").read_bytes()[:-100])
    found = read(folder, tmp_path)
    assert "a.xyz is not the file it should be" in found.skipped["yard"]
    assert "damaged.h5 is damaged" in found.skipped["damaged.h5"]
    assert sorted(found.skipped) == ["damaged.h5", "notes.txt", "yard"] and sorted(found.used) == [
        "hall.npz",
        "labelled.h5",
    ]
    for name in ("hall.npz", "labelled.h5"):
        (folder / name).unlink()
    with pytest.raises(NoTasksError, match=r"a.xyz is not the file it should be"):
        read(folder, tmp_path)


def test_maps_with_other_cells_are_resampled_and_unusable_ones_named(folder, tmp_path):
    HeightMap(np.zeros((50, 50), np.float32), (0.0, 0.0), 0.05).save(folder / "coarse.npz")
    HeightMap(np.zeros((5, 5), np.float32), (0.0, 0.0), 5.0).save(folder / "country.npz")
    found = read(folder, tmp_path)
    assert found.used["coarse.npz"] == 1 and found.used["labelled.h5"] == 3
    assert "country.npz" not in found.used and "5" in found.skipped["country.npz"]


def test_folders_without_tasks_are_named(tmp_path):
    with pytest.raises(InputError, match="no such folder"):
        read(tmp_path / "none", tmp_path)
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match=r"gave no tasks .it holds none"):
        read(tmp_path / "empty", tmp_path)
    (tmp_path / "empty" / "x.yaml").write_text("- no mapping\n")
    with pytest.raises(InputError, match=r"x\.yaml, line 1: need a mapping, got \['no mapping'\]"):
        read(tmp_path / "empty", tmp_path)
