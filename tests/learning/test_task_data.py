"""Batches of tasks."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from hdsp.base.errors import InputError
from hdsp.labels.shards import write_shard
from hdsp.labels.tasks import TaskSet
from hdsp.learning.learning_settings import BatchSettings
from hdsp.learning.task_data import Batch, TaskDataset, mirror_goals, mirror_heights, task_loader
from hdsp.learning.task_stream import TaskStream
from hdsp.terrain.height_map import HeightMap
from tests.learning.synthetic import synthetic_tasks


@pytest.fixture(scope="module")
def tasks():
    return synthetic_tasks(10)


def epoch(loader, number):
    loader.sampler.set_epoch(number)
    return list(loader)


def test_batches_by_map_hold_every_map_once_with_all_its_goals(tasks):
    batches = epoch(task_loader(tasks, BatchSettings("map", 4), shuffle=True), 0)
    assert [len(batch.heights) for batch in batches] == [4, 4, 2]
    goals = torch.cat([batch.goals for batch in batches])
    assert goals.shape == (10, 22, 3)
    seen = sorted(batch_map.sum().item() for batch in batches for batch_map in batch.heights)
    np.testing.assert_allclose(seen, sorted(tasks.heights.sum((1, 2))), rtol=1e-5)


def test_single_tasks_hold_every_task_once_with_its_own_map_and_label(tasks):
    batches = epoch(task_loader(tasks, BatchSettings("task", 7), shuffle=True), 0)
    assert sum(len(batch.heights) for batch in batches) == 220
    expected = {
        (tasks.heights[i].tobytes(), tasks.goals[i, j].tobytes(), bool(tasks.feasible[i, j]), float(tasks.cost[i, j]))
        for i in range(10)
        for j in range(22)
    }
    found = set()
    for heights, goals, feasible, cost in batches:
        assert goals.shape[1:] == (1, 3)
        for k in range(len(heights)):
            label = bool(feasible[k, 0]), float(cost[k, 0])
            found.add((heights[k, 0].numpy().tobytes(), goals[k, 0].numpy().tobytes(), *label))
    assert found == expected


def test_order_depends_on_seed_and_epoch_alone(tasks):
    def order(seed, number):
        loader = task_loader(tasks, BatchSettings("map", 4), shuffle=True, mirror=True, seed=seed)
        return torch.cat([batch.heights for batch in epoch(loader, number)])

    assert torch.equal(order(1, 3), order(1, 3))
    assert not torch.equal(order(1, 3), order(1, 4))
    assert not torch.equal(order(1, 3), order(2, 3))


def test_tensors_share_the_memory_of_the_task_set(tasks):
    dataset = TaskDataset(tasks)
    assert dataset.heights.numpy().base is tasks.heights or np.shares_memory(dataset.heights.numpy(), tasks.heights)


def test_mirrored_heights_are_those_on_the_other_side_of_the_robot():
    heights = torch.rand(1, 1, 72, 72)
    mirrored = mirror_heights(heights)
    for offset in range(36):
        assert torch.equal(mirrored[..., 36 + offset], heights[..., 36 - offset])
        assert torch.equal(mirrored[..., 36 - offset], heights[..., 36 + offset])


def test_mirroring_a_patch_equals_cropping_the_mirrored_map():
    terrain = np.random.default_rng(0).random((121, 121), np.float32)
    left = HeightMap(terrain).crop_cells(60, 60, 8).heights  # 45 degrees to the left ...
    right = HeightMap(terrain[:, ::-1]).crop_cells(60, 60, 64 - 8).heights  # ... is 45 to the right in the mirror
    mirrored = mirror_heights(torch.from_numpy(left.copy()))
    assert np.array_equal(mirrored.numpy()[:, 1:], right[:, 1:])


def test_mirrored_goals_turn_the_other_way():
    goals = torch.tensor([[1.0, 2.0, 0.0], [0.0, 0.0, 1.0]])
    assert mirror_goals(goals).tolist() == [[1.0, -2.0, 0.0], [0.0, 0.0, -1.0]]


def test_mirroring_concerns_map_and_goals_together(tasks):
    plain = epoch(task_loader(tasks, BatchSettings("map", 10)), 0)[0]
    mixed = epoch(task_loader(tasks, BatchSettings("map", 10), mirror=True), 0)[0]
    turned = (mixed.goals != plain.goals).any(-1).any(-1)
    assert 0 < turned.sum() < 10
    for i in range(10):
        expected = mirror_heights(plain.heights[i]) if turned[i] else plain.heights[i]
        assert torch.equal(mixed.heights[i], expected)
    assert torch.equal(mixed.cost, plain.cost)


def test_empty_task_sets_are_refused():
    with pytest.raises(InputError, match="holds no maps"):
        task_loader(TaskSet.empty(), BatchSettings())


@pytest.mark.parametrize("by", ["map", "task"])
def test_planning_costs_are_a_target_on_request(tasks, tmp_path, by):
    planned = replace(tasks, planning_cost=0.8 * tasks.cost)
    for number in range(2):
        write_shard(tmp_path / f"{number}.h5", planned[5 * number : 5 * number + 5], {"labels_hash": "x"})
    chosen, targets = BatchSettings(by, 4), ("cost", "planning_cost")
    loaders = (
        task_loader(planned, chosen, shuffle=True, targets=targets),
        TaskStream(tmp_path, chosen, shards_in_memory=1, targets=targets),
    )
    for loader in loaders:
        batches = list(loader)
        assert sum(batch.cost.numel() for batch in batches) == tasks.cost.size
        for batch in batches:
            torch.testing.assert_close(batch.planning_cost, 0.8 * batch.cost)
    assert type(next(iter(task_loader(planned, chosen)))) is Batch
    with pytest.raises(InputError, match="no planning_cost; label with settings"):
        task_loader(tasks, chosen, targets=targets)
