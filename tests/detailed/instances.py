"""Robots, terrains and states that the tests of the detailed planner share."""

import math

import numpy as np

from hdsp.detailed.actions import MAX_SUCCESSORS, Rules, successors
from hdsp.detailed.states import BASE_FORWARD, FOOT_MOVE, STEP, TURN_LEFT, pack_states, unpack_states
from hdsp.lattice import DRIVE_MOVES
from hdsp.robot import Robot

#: No two costs alike, so that no rule can stand in for another; few states, so that plain Python can search them.
TOY = {
    "name": "toy",
    "feet": {
        "neutral_x": 0.05, "neutral_y": 0.025, "offset_min": -0.05, "offset_max": 0.025, "clearance": 0.0,
        "min_separation": 0.05, "neutral_preference": 3.0,
    },
    "body": {
        "boxes": [{"above": 0.16, "x_min": -0.05, "x_max": 0.075, "half_width": 0.025}],
        "unevenness": {"x_min": -0.05, "x_max": 0.05, "half_width": 0.0},
    },
    "drive": {
        "max_height_difference": 0.05, "unevenness_radius": 0.05, "unevenness_cost": 0.31,
        "straight_deviation": 0.3, "level": 0.07,
        "deviation_cost": {
            "ahead": 1.1, "side": 3.0, "behind": 2.3, "side_from": math.pi / 4, "side_to": 3 * math.pi / 4,
        },
    },
    "turn": {"cost": 0.083, "unevenness_cost": 0.21},
    "foot_move": {"cost_per_metre": 1.37},
    "base_shift": {"cost_per_metre": 1.71, "backward": True},
    "step": {
        "backward": True, "max_length": 0.1, "max_height": 0.14, "max_clearance": 0.15, "cost": 0.019,
        "cost_per_metre": 0.57, "cost_per_height": 0.23, "support_margin": 0.0,
    },
    "legs": {"hip_x": 0.05, "hip_y": 0.025, "min_length": 0.05, "max_length": 0.3},
    "stance": {
        "base_height": 0.16, "max_roll": 0.2, "max_pitch": 0.3, "reach_x": 0.04, "reach_y": 0.02, "mass_x": 0.0,
        "mass_z": 0.01, "margin": 0.003, "swing_clearance": 0.01,
    },
}  # fmt: skip


def toy(**changes) -> Robot:
    """The toy robot, with some values changed: ``toy(step={"max_height": 0.0})``."""
    values = {**TOY, "name": "toy"}
    for part, change in changes.items():
        values[part] = {**TOY[part], **change}
    return Robot.load(values)


def blocky(rng, cells: int = 12, blocks: int = 2, height: float = 0.12) -> np.ndarray:
    """Heights float32 [cells, cells] of a floor with a few low blocks that the toy robot can step on."""
    heights = np.zeros((cells, cells), dtype=np.float32)
    for _ in range(blocks):
        x, y = rng.integers(0, cells, 2)
        length, width = rng.integers(1, cells, 2)
        heights[x : x + length, y : y + width] = rng.uniform(0.06, height)
    return heights


def successor_arrays(world, state, rules: Rules | None = None):
    """What the kernel writes for a state: packed states, costs and action codes."""
    keys, costs = np.empty(MAX_SUCCESSORS, np.int64), np.empty(MAX_SUCCESSORS)
    actions = np.empty(MAX_SUCCESSORS, np.uint8)
    key = int(pack_states(state, world.tables.lowest)[0])
    n = successors(world, rules or Rules(), key, keys, costs, actions)
    return keys[:n], costs[:n], actions[:n]


def kernel_successors(world, state, rules: Rules | None = None) -> dict:
    """{(action, state): cost} as the kernel sees it, in the words of `tests.naive`."""
    keys, costs, actions = successor_arrays(world, state, rules)
    states = unpack_states(keys, world.tables.lowest)
    found = {
        (action_tuple(int(action)), tuple(reached.tolist())): float(cost)
        for action, reached, cost in zip(actions, states, costs, strict=True)
    }
    assert len(found) == len(keys), "an action occurs twice"
    return found


def action_tuple(code: int) -> tuple:
    """An action code in the words of `tests.naive`."""
    if code < TURN_LEFT:
        return "drive", *DRIVE_MOVES[code].tolist()
    if code < FOOT_MOVE:
        return "turn", 1 if code == TURN_LEFT else -1
    if code < BASE_FORWARD:
        return "foot", (code - FOOT_MOVE) // 2, 1 - 2 * ((code - FOOT_MOVE) % 2)
    if code < STEP:
        return "shift", 1 if code == BASE_FORWARD else -1
    return "step", (code - STEP) // 32, (code - STEP) % 32 - 16


def valid_states(twin, rng, count: int, neutral: bool = True, headings=range(64)) -> list[tuple]:
    """Random valid states, with neutral feet or any; fewer if the terrain has hardly any."""
    low, high = twin.robot.offset_range()
    found = []
    for _ in range(60 * count):
        feet = (0, 0, 0, 0) if neutral else tuple(int(v) for v in rng.integers(low, high + 1, 4))
        base = (int(v) for v in rng.integers((0, 0), twin.shape))
        state = (*base, int(rng.choice(headings)), *feet)
        if twin.valid(state) and twin.separated(state):
            found.append(state)
        if len(found) == count:
            break
    return found


def near_edges(twin, states: list[tuple]) -> list[tuple]:
    """Those of the states in which some foot can step."""
    return [state for state in states if twin.any_foot_can_step(state)]
