import numpy as np
import pytest
import torch

from hdsp.base.errors import InputError
from hdsp.labels.shards import write_shard
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
        return torch.cat([batch.heights[:, 0] for batch in torch.utils.data.DataLoader(stream, batch_size=None)])

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


@pytest.mark.parametrize("by", ["map", "task"])
def test_a_stream_has_as_many_batches_as_it_says(tasks, shards, by):
    stream = TaskStream([shards, shards], BatchSettings(by, 3), shuffle=True, shards_in_memory=2)
    sizes = [len(batch.heights) for batch in stream]
    assert len(sizes) == len(stream) and set(sizes[:-1]) == {3}
    assert sum(sizes) == 2 * len(tasks) * (1 if by == "map" else 22)


@pytest.mark.parametrize("streamed", [False, True])
@pytest.mark.parametrize("by", ["map", "task"])
def test_batches_go_on_after_those_of_before_an_interruption(tasks, shards, streamed, by):
    settings, order = BatchSettings(by, 4), {"shuffle": True, "mirror": True, "seed": 3}

    def batches(taken=0):
        source = TaskStream(shards, settings, **order) if streamed else task_loader(tasks, settings, **order)
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


def test_a_stream_holds_no_more_shards_than_it_may(shards, monkeypatch):
    import hdsp.labels.shards

    alive = []
    real = hdsp.labels.shards.read_shard
    monkeypatch.setattr(hdsp.labels.shards, "read_shard", lambda path: alive.append(path) or real(path))
    stream = iter(TaskStream(shards, BatchSettings("map", 1), shards_in_memory=2))
    next(stream)
    assert len(alive) == 2
    with pytest.raises(InputError, match="holds no shard"):
        TaskStream(shards / "nothing", BatchSettings())


def test_processes_of_a_loader_share_the_shards(tasks, shards):
    stream = TaskStream(shards, BatchSettings("map", 4), shards_in_memory=1)
    loader = torch.utils.data.DataLoader(stream, batch_size=None, num_workers=2)
    assert sum(len(batch.heights) for batch in loader) == len(tasks)
