from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import example, given, settings
from hypothesis import strategies as st

from hdsp.base.errors import InputError
from hdsp.labels.shards import write_shard
from hdsp.labels.tasks import TaskSet
from hdsp.learning.learning_settings import BatchSettings
from hdsp.learning.task_data import task_loader
from hdsp.learning.task_stream import ResumableBatches, TaskStream
from tests.learning.synthetic import synthetic_tasks


@pytest.fixture(scope="module")
def tasks():
    return synthetic_tasks(10)


@pytest.fixture(scope="module")
def shards(tasks, tmp_path_factory):
    """The ten maps in five shards; one shard is empty."""
    folder = tmp_path_factory.mktemp("shards")
    for number, part in enumerate([tasks[:3], tasks[3:4], tasks[:0], tasks[4:8], tasks[8:]]):
        write_shard(folder / f"{number}.h5", part, {"labels_hash": "x"})
    return folder


def test_a_stream_gives_every_map_once_in_a_new_order_each_epoch(tasks, shards):
    stream = TaskStream(shards, BatchSettings("map", 2), shuffle=True, mirror=False, seed=1, shards_in_memory=2)

    def maps(number):
        stream.set_epoch(number)
        return torch.cat([batch.heights[:, 0] for batch in stream])

    first, second = maps(0), maps(1)
    assert torch.equal(first, maps(0)) and not torch.equal(first, second)
    for found in (first, second):
        assert {one.numpy().tobytes() for one in found} == {one.tobytes() for one in tasks.heights}
        assert len(found) == len(tasks)


def test_a_stream_in_order_is_the_split_in_order(tasks, shards):
    batches = list(TaskStream(shards, BatchSettings("map", 4), shards_in_memory=1))
    assert [len(batch.heights) for batch in batches] == [4, 4, 2]
    for name in ("goals", "feasible", "cost"):
        found = torch.cat([getattr(batch, name) for batch in batches]).numpy()
        np.testing.assert_array_equal(found, tasks.arrays()[name])


@pytest.mark.parametrize("in_memory", [1, 2, 3])
def test_a_shard_without_maps_takes_no_costs_for_planning_from_the_others(tasks, tmp_path, in_memory):
    planned = replace(tasks, planning_cost=tasks.cost / 2)
    for number, part in enumerate([planned[:4], TaskSet.empty(), planned[4:]]):
        write_shard(tmp_path / f"{number}.h5", part, {"labels_hash": "x"})
    stream = TaskStream(
        tmp_path, BatchSettings("map", 4), shards_in_memory=in_memory, targets=("cost", "planning_cost")
    )
    found = torch.cat([batch.planning_cost for batch in stream])
    np.testing.assert_array_equal(found, planned.planning_cost)


@pytest.mark.parametrize("by", ["map", "task"])
def test_a_stream_has_as_many_batches_as_it_says(tasks, shards, by):
    stream = TaskStream([shards, shards], BatchSettings(by, 3), shuffle=True, shards_in_memory=2)
    sizes = [len(batch.heights) for batch in stream]
    assert len(sizes) == len(stream) and set(sizes[:-1]) == {3}
    assert sum(sizes) == 2 * len(tasks) * (1 if by == "map" else 22)


@pytest.mark.parametrize("streamed", [False, True])
@pytest.mark.parametrize("by", ["map", "task"])
def test_batches_go_on_after_those_of_before_an_interruption(tasks, shards, streamed, by):
    chosen, order = BatchSettings(by, 4), {"shuffle": True, "mirror": True, "seed": 3}

    def batches(taken=0):
        source = TaskStream(shards, chosen, **order) if streamed else task_loader(tasks, chosen, **order)
        resumable = ResumableBatches(source)
        resumable.load_state_dict({"given": taken})
        resumable.sampler.set_epoch(2)
        return resumable

    whole = list(batches())
    assert len(whole) == len(batches())
    for taken in (1, len(whole) - 1, len(whole)):
        resumable = batches(taken)
        rest = list(resumable)
        expected = whole[taken:] or whole  # after the last batch, the next epoch follows
        assert len(rest) == len(expected)
        assert all(
            torch.equal(a, b)
            for one, other in zip(rest, expected, strict=True)
            for a, b in zip(one, other, strict=True)
        )
        assert resumable.state_dict() == {"given": len(whole)}
        assert len(list(resumable)) == len(whole)


@pytest.fixture
def read(monkeypatch):
    """Paths of the shards that were read."""
    import hdsp.labels.shards

    paths, real = [], hdsp.labels.shards.read_arrays
    monkeypatch.setattr(hdsp.labels.shards, "read_arrays", lambda path, names: paths.append(path) or real(path, names))
    return paths


def test_a_stream_holds_no_more_shards_than_it_may(shards, read):
    next(iter(TaskStream(shards, BatchSettings("map", 1), shards_in_memory=2)))
    assert len(read) == 2
    with pytest.raises(InputError, match="holds no shard"):
        TaskStream(shards / "nothing", BatchSettings())


def test_shards_with_skipped_batches_alone_are_not_read(shards, read):
    stream = TaskStream(shards, BatchSettings("map", 2), shards_in_memory=1)
    stream.skip = 4  # eight maps: all but the last shard
    assert [len(batch.heights) for batch in stream] == [2]
    assert [path.name for path in read] == ["4.h5"]


@settings(max_examples=6, deadline=None)
@example(size=5, group=2, by="map", seed=0, skip=0, ranks=3)  # fewer batches than processes
@given(
    size=st.integers(1, 9), group=st.integers(1, 5), by=st.sampled_from(["map", "task"]),
    seed=st.sampled_from([0, 3, 2**63 - 1]),
    skip=st.integers(0, 9), ranks=st.integers(1, 3),
)  # fmt: skip
def test_processes_take_the_batches_of_one_in_turn(shards, size, group, by, seed, skip, ranks):
    def batches(**attributes):
        stream = TaskStream(shards, BatchSettings(by, size), True, True, seed, group)
        for name, value in attributes.items():
            setattr(stream, name, value)
        return list(stream)

    whole = batches(epoch=1)
    parts = [batches(epoch=1, rank=rank, ranks=ranks) for rank in range(ranks)]
    assert {len(part) for part in parts} == {len(whole) // ranks}
    for number, batch in enumerate(whole[: len(whole) // ranks * ranks]):
        assert same(batch, parts[number % ranks][number // ranks])
    rest = batches(epoch=1, skip=skip)
    assert len(rest) == max(0, len(whole) - skip)
    assert all(map(same, rest, whole[skip:]))


def same(one, other) -> bool:
    return all(torch.equal(a, b) for a, b in zip(one, other, strict=True))


def test_readers_give_the_batches_of_a_stream_without_them(shards):
    def batches(readers):
        return list(TaskStream(shards, BatchSettings("map", 3), True, True, 1, 1, readers=readers))

    assert all(map(same, batches(2), batches(0)))


def test_a_damaged_shard_is_named_in_one_line_also_by_a_reader(tasks, tmp_path):
    for number in range(3):
        write_shard(tmp_path / f"{number}.h5", tasks[:2], {"labels_hash": "x"})
    for readers in (0, 1):
        stream = TaskStream(tmp_path, BatchSettings("map", 2), shards_in_memory=1, readers=readers)
        content = (tmp_path / "1.h5").read_bytes()
        (tmp_path / "1.h5").write_bytes(content[:-5])
        with pytest.raises(InputError, match=r"^shard [^\n]*1\.h5 is damaged[^\n]*$"):
            list(stream)
        (tmp_path / "1.h5").write_bytes(content)
