"""Synthetic labels, and stand-ins for the label function."""

import os
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hdsp.labels.tasks import FIELDS, TaskSet
from hdsp.robot.lattice import ABSTRACT_ACTIONS, abstract_steps_to_world
from hdsp.terrain.scenes import CATEGORIES


def random_tasks(maps: int, seed: int = 0) -> TaskSet:
    """Random arrays with valid shapes and dtypes, and the goals for heading 0."""
    random = np.random.default_rng(seed)
    arrays = {name: random.random((maps, *shape)).astype(dtype) for name, (dtype, shape) in FIELDS.items()}
    arrays["heights"][random.random(arrays["heights"].shape) < 0.1] = np.nan
    feasible = random.random((maps, 22)) < 0.7
    poses = np.concatenate([abstract_steps_to_world(ABSTRACT_ACTIONS), np.zeros((22, 4))], axis=1)
    arrays |= {
        "goals": np.broadcast_to(ABSTRACT_ACTIONS, (maps, 22, 3)),
        "goal": np.broadcast_to(poses, (maps, 22, 7)),
        "feasible": feasible,
        "cost": np.where(feasible, random.random((maps, 22)), 0),
        "reason": np.where(feasible, 0, random.integers(1, 8, (maps, 22))),
        "index": np.arange(maps),
        "seed": random.integers(0, 2**40, maps),
        "heading": random.integers(0, 64, maps),
    }
    return TaskSet(category=random.choice(CATEGORIES, maps), **arrays)


def assert_same_tasks(one: TaskSet, other: TaskSet) -> None:
    """Asserts equality to the bit, including dtypes."""
    for name, array in one.arrays().items():
        np.testing.assert_array_equal(array, other.arrays()[name], err_msg=name)
        if name != "category":
            assert array.dtype == other.arrays()[name].dtype, name


class FakeLabels(NamedTuple):
    heights: np.ndarray
    goals: np.ndarray
    feasible: np.ndarray
    cost: np.ndarray
    reason: np.ndarray
    start: np.ndarray
    goal: np.ndarray


def fake_label(terrain, robot, settings, start_heading) -> FakeLabels | None:
    """Labels a map quickly from its terrain; None if the start is not on the ground."""
    cell = terrain.shape[0] // 2
    heights = terrain.crop_cells(cell, cell, start_heading).heights
    if heights[36, 36] > 0:
        return None
    feasible = np.arange(22) < 22 * (1 - np.mean(heights > 0))
    cost = np.where(feasible, 0.1 + heights.mean() + np.arange(22) / 100, 0)
    goals = np.full((22, 3), start_heading)
    return FakeLabels(heights, goals, feasible, cost, np.where(feasible, 0, 1), np.zeros(7), np.zeros((22, 7)))


def slow_fake_label(*arguments) -> FakeLabels | None:
    time.sleep(0.03)
    return fake_label(*arguments)


def failing_label(*arguments) -> None:
    raise ZeroDivisionError("a fault in the search")


def suicidal_label(*arguments) -> None:
    os._exit(9)


def unlucky_label(terrain, robot, settings, start_heading) -> FakeLabels | None:
    """Ends its process in the first calls, until ``settings.folder`` has four files: Dask then gives up."""
    if len(list(Path(settings.folder).iterdir())) < 4:
        Path(settings.folder, str(os.getpid())).touch()
        os._exit(9)
    return fake_label(terrain, robot, settings, start_heading)


def modules_label(terrain, robot, settings, start_heading) -> FakeLabels | None:
    """Writes the modules that the worker has imported to a file in ``settings.folder``."""
    import sys

    Path(settings.folder, f"{os.getpid()}.modules").write_text("\n".join(sys.modules))
    return slow_fake_label(terrain, robot, settings, start_heading)
