"""Robots, terrains and states for the tests of the detailed planner."""

import heapq
import itertools
import math
from functools import cache
from typing import NamedTuple

import numpy as np
import pytest

from hdsp.detailed.actions.action import ARC, BASE_FORWARD, FOOT_MOVE, STEP, TURN_LEFT
from hdsp.detailed.actions.successors import MAX_SUCCESSORS, Rules, successors
from hdsp.detailed.states import pack_states, unpack_states
from hdsp.detailed.world.world import World, build_world
from hdsp.robot.lattice import DRIVE_MOVES, RESOLUTION
from hdsp.robot.robot import Robot
from hdsp.terrain.height_map import HeightMap
from hdsp.terrain.scenes import CATEGORIES, TerrainSettings, random_map
from tests.naive import Naive, dijkstra, way_back

#: All costs differ, so that tests notice if one rule is used instead of another. Few states suit a plain Python search.
TOY = {
    "name": "toy",
    "feet": {
        "neutral_x": 0.05, "neutral_y": 0.025, "offset_min": -0.05, "offset_max": 0.025, "clearance": 0.0,
        "min_separation": 0.05, "neutral_preference": 3.0, "contact_inward": 0.02, "contact_half_width": 0.025,
    },
    "body": {
        "boxes": [{"above": 0.16, "x_min": -0.05, "x_max": 0.075, "half_width": 0.025}],
    },
    "drive": {
        "max_height_difference": 0.05, "unevenness_radius": 0.05, "unevenness_cost": 0.31,
        "straight_deviation": 0.3, "level": 0.07,
        "deviation_cost": {
            "ahead": 1.1, "side": 3.0, "behind": 2.3, "side_from": math.pi / 4, "side_to": 3 * math.pi / 4,
        },
    },
    "slope": {"max_pitch": 0.3, "max_roll": 0.2},
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
    "physics": {"wheel_radius": 0.02},
}  # fmt: skip


def toy(**changes) -> Robot:
    """The toy robot with some values changed: ``toy(step={"max_height": 0.0})``."""
    values = {**TOY, "name": "toy"}
    for part, change in changes.items():
        values[part] = {**TOY[part], **change}
    return Robot.load(values)


#: Cheap steps, so that a short textbook search finds many.
NIMBLE_CHANGES = {
    "step": {"cost": 0.004, "cost_per_metre": 0.31, "cost_per_height": 0.05},
    "base_shift": {"cost_per_metre": 1.2},
}
NIMBLE = toy(**NIMBLE_CHANGES)

#: Robots whose wheels do not steer: they drive along their heading, the second one ahead only.
FIXED_WHEELS = toy(**{**NIMBLE_CHANGES, "drive": {"sideways": False}})
AHEAD_ONLY = toy(
    **{
        **NIMBLE_CHANGES,
        "drive": {"deviation_cost": {**TOY["drive"]["deviation_cost"], "side": math.inf, "behind": math.inf}},
    }
)

#: Robots that do not turn on the spot, but drive arcs of a cell or two, or of several cells.
ARC_CHANGES = {**NIMBLE_CHANGES, "drive": {"sideways": False}}
WIDE_ARCS = toy(**ARC_CHANGES, turn={"on_the_spot": False, "radius": 0.9})
SHORT_ARCS = toy(**NIMBLE_CHANGES, turn={"on_the_spot": False, "radius": 0.3})

#: The obstacles in the paper's categories, scaled to the toy robot; it can step on and over many of them.
SMALL_TERRAIN = TerrainSettings(
    area=0.3,
    cuboid_side=(0.05, 0.2),
    cuboid_height=(0.03, 0.14),
    wall_length=(0.1, 0.4),
    wall_thickness=(0.025, 0.075),
    wall_height=(0.1, 0.5),
    staircase_steps=(1, 2),
    staircase_rise=(0.06, 0.12),
    staircase_tread=(0.075, 0.125),
    staircase_width=(0.15, 0.4),
    staircase_depth=0.3,
    focused_width=(0.25, 0.4),
)


def small_map(category: str, index: int, cells: int = 14) -> np.ndarray:
    """A random map from a category for the toy robot: heights float32 [cells, cells]; every fourth lies on a slope."""
    heights = random_map(7, category, index, SMALL_TERRAIN, cells=cells).heights
    return tilted(heights, np.random.default_rng(index), 0.25) if index % 4 == 1 else heights


def blocky(rng, cells: int = 12, blocks: int = 2, height: float = 0.12) -> np.ndarray:
    """A floor with a few low blocks on which the toy robot can step: heights float32 [cells, cells]."""
    heights = np.zeros((cells, cells), dtype=np.float32)
    for _ in range(blocks):
        x, y = rng.integers(0, cells, 2)
        length, width = rng.integers(1, cells, 2)
        heights[x : x + length, y : y + width] = rng.uniform(0.06, height)
    return tilted(heights, rng, 0.25) if rng.random() < 0.25 else heights


def tilted(heights, rng, most: float = 0.35) -> np.ndarray:
    """Heights on a floor that is tilted in a random direction, by up to ``most`` rad."""
    ahead = rng.uniform(-np.pi, np.pi)
    x, y = np.indices(heights.shape) * RESOLUTION
    return (heights + np.tan(rng.uniform(0, most)) * (np.cos(ahead) * x + np.sin(ahead) * y)).astype(np.float32)


def successor_arrays(world, state, rules: Rules | None = None):
    """Kernel output for a state: packed states, costs and action codes."""
    keys, costs = np.empty(MAX_SUCCESSORS, np.int64), np.empty(MAX_SUCCESSORS)
    actions = np.empty(MAX_SUCCESSORS, np.uint8)
    key = int(pack_states(state, world.tables.lowest)[0])
    n = successors(world, rules or Rules(), key, keys, costs, actions)
    return keys[:n], costs[:n], actions[:n]


def kernel_successors(world, state, rules: Rules | None = None) -> dict:
    """Kernel output as {(action, state): cost}, in the notation of `tests.naive`."""
    keys, costs, actions = successor_arrays(world, state, rules)
    states = unpack_states(keys, world.tables.lowest)
    found = {
        (action_tuple(int(action)), tuple(reached.tolist())): float(cost)
        for action, reached, cost in zip(actions, states, costs, strict=True)
    }
    assert len(found) == len(keys), "an action occurs twice"
    return found


def action_tuple(code: int) -> tuple:
    """An action code in the notation of `tests.naive`."""
    if code < TURN_LEFT:
        return "drive", *DRIVE_MOVES[code].tolist()
    if code < FOOT_MOVE:
        return "turn", 1 if code == TURN_LEFT else -1
    if code < BASE_FORWARD:
        return "foot", (code - FOOT_MOVE) // 2, 1 - 2 * ((code - FOOT_MOVE) % 2)
    if code < STEP:
        return "shift", 1 if code == BASE_FORWARD else -1
    if code >= ARC:
        return "arc", 1 - 2 * ((code - ARC) // 2), 1 - 2 * ((code - ARC) % 2)
    return "step", (code - STEP) // 32, (code - STEP) % 32 - 16


def valid_states(twin, rng, count: int, neutral: bool = True, headings=range(64)) -> list[tuple]:
    """Random valid states, with neutral or arbitrary feet; fewer than ``count`` if the terrain has few valid states."""
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
    """States in which at least one foot can step."""
    return [state for state in states if twin.any_foot_can_step(state)]


#: All tests of one category run in one process and share its tasks.
by_category = pytest.mark.parametrize(
    "category", [pytest.param(name, marks=pytest.mark.xdist_group(f"search {name}")) for name in CATEGORIES]
)


class Task(NamedTuple):
    """A search task with the solution found by plain Dijkstra."""

    world: World
    twin: Naive
    start: tuple
    goal: tuple
    cost: float  # the least
    way: list  # cheapest actions

    @property
    def stepping(self) -> bool:
        return any(action[0] == "step" for action in self.way)

    @property
    def off_neutral(self) -> bool:
        """Whether any foot is off its neutral position at the start or the goal."""
        return any(self.start[3:] + self.goal[3:])


TASKS_PER_CATEGORY = 70  # at least


@cache
def search_tasks(category: str, robots: tuple[Robot, ...] = (NIMBLE, NIMBLE, NIMBLE, toy())) -> tuple[Task, ...]:
    """Random tasks on small maps of a category; tasks with one start share a Dijkstra run, a world and a twin."""
    found, stepping = [], 0
    for index in itertools.count():
        if len(found) >= TASKS_PER_CATEGORY and stepping >= 20:
            return tuple(found)
        rng = np.random.default_rng([CATEGORIES.index(category), index])
        robot = robots[index % len(robots)]
        heights = small_map(category, index)
        twin = Naive(heights, robot)
        states = valid_states(twin, rng, 40, neutral=index % 3 > 0)
        if not states:
            continue
        start = (near_edges(twin, states) + states)[0]
        gone = dijkstra(twin, start, most=450)
        ways = {goal: way_back(gone, goal) for goal in gone.cost}
        pools = (
            ([goal for goal, way in ways.items() if any(action[0] == "step" for action in way)], 5),
            ([goal for goal in ways if any(goal[3:])], 3),
            (list(ways)[-60:], 4),
        )
        picked = {pool[i] for pool, most in pools for i in rng.permutation(len(pool))[:most]}
        world = build_world(HeightMap(heights), robot)
        tasks = [Task(world, twin, start, goal, gone.cost[goal], ways[goal]) for goal in sorted(picked)]
        found += tasks
        stepping += sum(task.stepping for task in tasks)


def whole_graph(twin: Naive, start: tuple) -> dict:
    """All states reachable from a state: {state: [(reached state, cost)]}."""
    graph, missing = {}, [start]
    while missing:
        state = missing.pop()
        if state not in graph:
            graph[state] = [(reached, cost) for _, reached, cost in twin.successors(state)]
            missing += [reached for reached, _ in graph[state]]
    return graph


def costs_to_go(graph: dict, goal: tuple) -> dict:
    """Least cost to the goal from each state in a graph with a path to it: backward Dijkstra."""
    back = {}
    for state, edges in graph.items():
        for reached, cost in edges:
            back.setdefault(reached, []).append((state, cost))
    settled, queue = {}, [(0.0, goal)]
    while queue:
        cost, state = heapq.heappop(queue)
        if state in settled:
            continue
        settled[state] = cost
        for before, price in back.get(state, []):
            if before not in settled:
                heapq.heappush(queue, (cost + price, before))
    return settled
