"""Tasks with labels from a rule that a network learns in seconds."""

import numpy as np

from hdsp.labels.tasks import REASON_UNKNOWN, TaskSet
from hdsp.robot.lattice import N_ABSTRACT_ACTIONS, PATCH_CELLS, PATCH_CENTER, robot_frame_goals


def synthetic_tasks(maps: int, seed: int = 0) -> TaskSet:
    """Flat maps with one block beside the robot.

    Goals towards the block are infeasible; all other costs are proportional to the distance.
    """
    random = np.random.default_rng(seed)
    heights = np.zeros((maps, PATCH_CELLS, PATCH_CELLS), np.float32)
    goals = np.stack([robot_frame_goals(int(random.integers(4))) for _ in range(maps)])
    directions = np.array([(1, 0), (0, 1), (-1, 0), (0, -1)])[random.integers(0, 4, maps)]
    for patch, direction in zip(heights, directions, strict=True):
        low = PATCH_CENTER + 20 * direction - 8
        patch[low[0] : low[0] + 16, low[1] : low[1] + 16] = random.uniform(0.2, 1.0)
    towards = np.einsum("ngd,nd->ng", goals[..., :2], directions)
    feasible = towards < 0.7
    distance = 0.1 * np.linalg.norm(goals[..., :2], axis=-1) + 0.04 * np.abs(goals[..., 2])
    actions = (maps, N_ABSTRACT_ACTIONS)
    return TaskSet(
        heights=heights,
        goals=goals,
        feasible=feasible,
        cost=np.where(feasible, distance, 0),
        reason=np.full(actions, REASON_UNKNOWN, np.uint8),
        category=np.full(maps, "block"),
        index=np.arange(maps),
        seed=np.full(maps, seed),
        heading=np.zeros(maps, np.uint8),
        start=np.zeros((maps, 7), np.float32),
        goal=np.zeros((*actions, 7), np.float32),
    )


#: A network that trains in a fraction of a second.
TINY_MODEL = {
    "architecture": "compact",
    "encoding": {"reference": "base", "channels": ["height", "edge"]},
    "options": {"widths": [8, 8], "blocks": [1, 0], "map_features": 4, "hidden": 32},
}


def tiny_config(**trainer) -> dict:
    """A configuration of ``train`` for one thread and float32, so that runs can be compared to the bit."""
    defaults = {
        "epochs": 3,
        "batch": {"by": "map", "size": 16},
        "optimizer": {"name": "adamw", "lr": 3e-3},
        "schedule": {"name": "onecycle"},
        "losses": {"rule": "constant"},
    }
    hardware = {"accelerator": "cpu", "precision": "32", "threads": 1}
    return {"model": TINY_MODEL, "trainer": defaults | trainer, "hardware": hardware}
