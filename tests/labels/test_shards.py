import re
from dataclasses import replace

import h5py
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hdsp.base.errors import InputError
from hdsp.labels.counts import LabelCounts, add_up, counts_by_category
from hdsp.labels.shards import read_shard, read_tasks, shard_paths, write_shard
from hdsp.labels.tasks import TaskSet
from tests.labels.task_sets import assert_same_tasks, random_tasks

HASH = {"labels_hash": "abc"}


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 5), st.integers(0, 100))
def test_a_shard_gives_back_what_was_written(tmp_path_factory, maps, seed):
    path = tmp_path_factory.mktemp("shards") / "0.h5"
    tasks = random_tasks(maps, seed)
    attributes = {**HASH, "maps": 3, "share": 0.5}
    write_shard(path, tasks, attributes)
    shard = read_shard(path)
    assert_same_tasks(shard.tasks, tasks)
    assert shard.attributes == attributes
    assert [file.name for file in path.parent.iterdir()] == ["0.h5"]


def test_a_shard_is_plain_hdf5_with_a_map_for_a_chunk(tmp_path):
    tasks = random_tasks(4)
    with h5py.File(write_shard(tmp_path / "a.h5", tasks, HASH)) as file:
        assert file["heights"].chunks == (1, 72, 72)
        assert file["heights"].compression == "lzf"
        assert file.attrs["schema_version"] == 1
        assert file.attrs["labels_hash"] == "abc"
        names = file.attrs["category_names"]
        assert [names[code] for code in file["category"]] == tasks.category.tolist()


def test_any_flipped_byte_is_found(tmp_path):
    path = write_shard(tmp_path / "a.h5", random_tasks(2), HASH)
    content = path.read_bytes()
    places = np.random.default_rng(0).integers(0, len(content), 150)
    for place in [0, 20, 30, 100, 511, 512, 600, len(content) - 1, *places]:
        path.write_bytes(content[:place] + bytes([content[place] ^ 0x10]) + content[place + 1 :])
        with pytest.raises(InputError, match=r"a\.h5 is damaged"):
            read_shard(path)


@pytest.mark.parametrize("kept", [0, 10, 511, 512, 5000, -1])
def test_a_shard_that_was_cut_off_is_found(tmp_path, kept):
    path = write_shard(tmp_path / "a.h5", random_tasks(2), HASH)
    path.write_bytes(path.read_bytes()[:kept])
    with pytest.raises(InputError, match=r"a\.h5 is damaged") as error:
        read_shard(path)
    assert "\n" not in str(error.value)


def test_files_that_are_no_shards_or_of_another_version_are_named(tmp_path):
    with h5py.File(tmp_path / "foreign.h5", "w") as file:
        file["heights"] = np.zeros((2, 72, 72))
    with pytest.raises(InputError, match=r"foreign\.h5 is damaged or no shard"):
        read_shard(tmp_path / "foreign.h5")
    with pytest.raises(InputError, match="no such file"):
        read_shard(tmp_path / "none.h5")
    path = write_shard(tmp_path / "old.h5", random_tasks(1), HASH)
    path.write_bytes(path.read_bytes().replace(b"schema 1\n", b"schema 7\n"))
    with pytest.raises(InputError, match="schema version 7; need 1"):
        read_shard(path)


def test_a_failed_write_leaves_the_old_shard(tmp_path, monkeypatch):
    path = write_shard(tmp_path / "a.h5", random_tasks(2), HASH)
    before = path.read_bytes()

    def full(self, content):
        self.open("wb").write(content[:100])
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("pathlib.Path.write_bytes", full)
    with pytest.raises(InputError, match=r"cannot write .*a\.h5: No space left on device"):
        write_shard(path, random_tasks(3), HASH)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_attributes_are_checked(tmp_path):
    with pytest.raises(InputError, match="labels_hash is missing"):
        write_shard(tmp_path / "a.h5", random_tasks(1), {})
    with pytest.raises(InputError, match="attribute settings"):
        write_shard(tmp_path / "a.h5", random_tasks(1), {**HASH, "settings": {}})


def test_a_folder_is_read_in_the_order_of_names_and_without_leftovers(tmp_path):
    first, second = random_tasks(3, 1), random_tasks(2, 2)
    write_shard(tmp_path / "00001-x.h5", second, HASH)
    write_shard(tmp_path / "00000-x.h5", first, HASH)
    (tmp_path / ".00002-x.12-ab.tmp.h5").write_bytes(b"half a shard")
    (tmp_path / "absent.json").write_text("{}")
    assert_same_tasks(read_tasks(tmp_path), TaskSet.concatenate([first, second]))
    assert_same_tasks(read_tasks(tmp_path / "00000-x.h5"), first)
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="holds no shard"):
        read_tasks(tmp_path / "empty")


def test_a_subfolder_named_shards_is_read_like_any_other_unless_the_folder_is_an_unfinished_label_set(tmp_path):
    tasks = random_tasks(2)
    for place in ("mine/shards", "split/0123456789ab/shards", "odd/90-maps", "odd/shards"):
        write_shard(tmp_path / place / "0.h5", tasks, HASH)
    assert_same_tasks(read_tasks(tmp_path / "mine"), tasks)
    assert_same_tasks(read_tasks(f"{tmp_path}/mine/"), tasks)
    for unfinished in ("split", "split/0123456789ab", "odd"):
        assert shard_paths(tmp_path / unfinished) == []


def test_task_sets_check_shapes_and_costs():
    arrays = random_tasks(3).arrays()
    with pytest.raises(InputError, match=r"goals has shape \(3, 21, 3\); need \(3, 22, 3\)"):
        TaskSet(**{**arrays, "goals": arrays["goals"][:, 1:]})
    with pytest.raises(InputError, match="cost is not finite"):
        TaskSet(**{**arrays, "cost": np.full((3, 22), np.inf)})


@pytest.mark.parametrize(
    ("name", "value", "said"),
    [
        ("heading", -4, "heading holds -4; need whole numbers from 0 to 63"),
        ("heading", 64, "heading holds 64; need whole numbers from 0 to 63"),
        ("heading", 3.5, "heading holds 3.5; need whole numbers from 0 to 63"),
        ("reason", 300, "reason holds 300; need whole numbers from 0 to 255"),
        ("seed", 2**63, "seed holds 9223372036854775808; need whole numbers of 64 bits"),
        ("seed", 2**64, "seed has values of type object; need whole numbers of 64 bits"),
        ("index", np.nan, "index holds nan; need whole numbers of 64 bits"),
        ("feasible", np.nan, "feasible holds nan; need True or False, or 1 or 0"),
        ("feasible", 2, "feasible holds 2; need True or False, or 1 or 0"),
        ("feasible", "yes", "feasible has values of type <U3; need True or False, or 1 or 0"),
        ("cost", "cheap", "cost has values of type <U5; need numbers"),
        ("cost", 1e300, "cost is not finite somewhere"),
        ("goals", np.nan, "goals is not finite somewhere"),
        ("goal", np.inf, "goal is not finite somewhere"),
        ("start", np.nan, "start is not finite somewhere"),
        ("heights", np.inf, "heights are infinite somewhere; unknown ground is NaN"),
        ("heights", -np.inf, "heights are infinite somewhere; unknown ground is NaN"),
    ],
)
def test_values_that_do_not_fit_are_named_instead_of_wrapped(name, value, said):
    arrays = random_tasks(2).arrays()
    with pytest.raises(InputError, match=re.escape(f"task set: {said}")):
        TaskSet(**{**arrays, name: np.full(arrays[name].shape, value)})


def test_other_types_with_the_same_values_are_the_same_tasks():
    tasks = random_tasks(3)
    arrays = tasks.arrays()
    others = {
        "heading": arrays["heading"].astype(float), "feasible": arrays["feasible"].astype(int),
        "seed": arrays["seed"].astype(np.uint64), "cost": arrays["cost"].astype(float),
        "goals": arrays["goals"].tolist(),
    }  # fmt: skip
    assert_same_tasks(TaskSet(**{**arrays, **others}), tasks)
    with pytest.raises(InputError, match=r"task set: index: .*inhomogeneous"):
        TaskSet(**{**arrays, "index": [[1], [2, 3], [4]]})


def test_maps_are_picked_like_elements_of_an_array():
    tasks = random_tasks(5)
    assert_same_tasks(TaskSet.concatenate([tasks[:2], tasks[[2, 3]], tasks[tasks.index == 4]]), tasks)
    assert len(TaskSet.concatenate([])) == 0


def test_selected_and_joined_maps_are_not_checked_again(monkeypatch):
    tasks = random_tasks(6)
    first, others = TaskSet.concatenate([tasks[:2], TaskSet.empty()]), tasks[np.arange(6) > 1]
    monkeypatch.setattr(TaskSet, "__post_init__", lambda _: pytest.fail("values are checked again"))
    joined = TaskSet.concatenate([first, others[:0], others])
    monkeypatch.undo()
    assert_same_tasks(joined, tasks)
    assert_same_tasks(TaskSet(**joined[::2].arrays()), joined[::2])  # shapes and types are those of a checked set
    assert np.shares_memory(tasks[1:3].heights, tasks.heights)
    for wrong, shape in ((2, "()"), ([[0, 1]], "(1, 2)")):
        with pytest.raises(InputError, match=re.escape(f"selected maps have shape {shape}")):
            tasks[wrong]


def test_planning_costs_are_stored_beside_labels_and_may_be_missing(tmp_path):
    tasks = random_tasks(4)
    planned = replace(tasks, planning_cost=0.9 * tasks.cost)
    for name, each in (("a.h5", planned), ("b.h5", tasks)):
        write_shard(tmp_path / name, each, {"labels_hash": name})
    assert read_shard(tmp_path / "b.h5").tasks.planning_cost is None
    read = read_shard(tmp_path / "a.h5").tasks
    assert read.planning_cost.dtype == np.float32
    assert_same_tasks(read, planned)
    assert_same_tasks(planned[1:3], TaskSet.concatenate([planned[1:2], TaskSet.empty(), planned[2:3]]))
    assert read_tasks(tmp_path).planning_cost is None and len(read_tasks(tmp_path)) == 8
    with pytest.raises(InputError, match="planning_cost is not finite"):
        replace(tasks, planning_cost=tasks.cost + np.inf)
    with pytest.raises(InputError, match=r"planning_cost has shape \(4, 21\)"):
        replace(tasks, planning_cost=tasks.cost[:, 1:])
    # Two headings and a task that only the planner's rules make cheaper.
    compared = replace(planned, heading=np.array([0, 0, 4, 4]))
    found = add_up([counts_by_category(compared)], set(tasks.category.tolist()))
    ratio = sum(found.values(), LabelCounts()).summary()["label_over_planning"]
    assert ratio["mean"] == pytest.approx(1 / 0.9, rel=1e-5) and set(ratio["by_heading"]) == {"0", "1"}
    assert len(ratio["by_action"]) == 22 and ratio["by_heading"]["1"] == pytest.approx(1 / 0.9, rel=1e-5)
    assert "label_over_planning" not in sum(counts_by_category(tasks).values(), LabelCounts()).summary()
