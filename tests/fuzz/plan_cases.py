"""Random robots, terrains, states, queries and labels, judged by the textbook planner in `tests.naive`.

Every plan is replayed: each action is legal from its state, reaches the next one, and costs what the map says.
"""

import math
from functools import cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from hdsp.abstract.oracle import CostKind, task_costs
from hdsp.abstract.transform import feet_at
from hdsp.base.errors import InputError
from hdsp.detailed.search.estimate import geometric_estimate
from hdsp.detailed.search.outcome import Status
from hdsp.detailed.search.weighted_astar import solve
from hdsp.detailed.world.world import World, build_world
from hdsp.labels.rules import LabelSettings
from hdsp.planning.planner import Planner
from hdsp.robot.lattice import Grid
from hdsp.robot.robot import Robot
from hdsp.terrain.height_map import HeightMap
from hdsp.terrain.scenes import CATEGORIES, random_map
from tests.detailed.instances import NIMBLE_CHANGES, blocky, near_edges, small_map, tilted, toy, valid_states
from tests.detailed.test_plan_invariants import assert_legal
from tests.naive import Naive, dijkstra

#: Kinds of cases with their shares.
PLANS = {"search": 1.0, "optimal": 0.4, "query": 0.6, "labels": 0.3}
_WEIGHTS = (1.0, 1.25, 2.0, 3.0)
_MOST = 6000  # states that the textbook search settles
_TRIES = 12  # random poses until one is valid


class PlanCases:
    """All cases of one kind."""

    def __init__(self, kind: str):
        self.kind, self.number = kind, sorted(PLANS).index(kind)

    def outcome(self, seed: int) -> str:
        """``solved``, ``no way``, ``compared``, ``limit`` (nothing to compare), or a fault with words behind it."""
        random = np.random.default_rng([self.number, seed])
        try:
            return getattr(self, f"_{self.kind}")(random)
        except AssertionError as error:
            return f"wrong {' '.join(str(error).split())[:200]}"
        except Exception as error:
            return f"traceback {type(error).__name__}: {' '.join(str(error).split())[:200]}"

    def _search(self, random: np.random.Generator) -> str:
        """A plan between states of a small robot keeps all rules; with any weight it costs at most so much more."""
        case = _toy_case(random, 16)
        if case is None:
            return "limit"
        robot, twin, world, start, goal = case
        estimate = geometric_estimate(world, np.array(goal))
        weight = float(random.choice(_WEIGHTS))
        found = solve(world, np.array(start), np.array(goal), estimate, weight=weight)
        best = solve(world, np.array(start), np.array(goal), estimate, weight=1.0)
        assert found.status == best.status, (found.status, best.status)
        if found.status != [Status.SOLVED]:
            assert found.status == [Status.INFEASIBLE], found.status
            return "no way"
        if robot.turn.on_the_spot:
            assert_legal(twin, start, goal, found)
        path = found.paths[0]
        _replay(twin, [tuple(state) for state in path.states.tolist()], found.cost[0])
        assert best.cost[0] <= found.cost[0] * (1 + 1e-6) <= weight * best.cost[0] * (1 + 2e-6)
        return "solved"

    def _optimal(self, random: np.random.Generator) -> str:
        """The cheapest plan costs as much as that of the textbook search, and there is none where that finds none."""
        case = _toy_case(random, 11)
        if case is None:
            return "limit"
        _, twin, world, start, goal = case
        gone = dijkstra(twin, start, (goal,), _MOST)
        found = solve(world, np.array(start), np.array(goal), geometric_estimate(world, np.array(goal)))
        if goal in gone.cost:
            assert found.status == [Status.SOLVED], found.status
            assert math.isclose(found.cost[0], gone.cost[goal], rel_tol=1e-6), (found.cost[0], gone.cost[goal])
            return "compared"
        if gone.exhausted:
            assert found.status == [Status.INFEASIBLE], found.status
            return "no way"
        return "limit"

    def _query(self, random: np.random.Generator) -> str:
        """A plan of `Planner` for a robot of the package, on a random map between random poses, is replayed."""
        robot = _preset(str(random.choice(Robot.presets())))
        heights = random_map(
            int(random.integers(1000)), str(random.choice(CATEGORIES)), int(random.integers(1000)), cells=104
        ).heights
        heights = tilted(heights, random, 0.2) if random.random() < 0.2 else heights
        heights = np.where(random.random(heights.shape) < random.choice([0, 0, 0.002]), np.nan, heights)
        terrain = HeightMap(heights.astype(np.float32), tuple(random.uniform(-5, 5, 2)))
        heuristic = str(random.choice(["geometric", "grid", "manual"]))
        planner = Planner(terrain, robot, heuristic=heuristic, conditioning=None)
        poses = [_pose_to_leave(planner, random) for _ in range(2)]
        weight = float(random.choice(_WEIGHTS))
        try:
            plan = planner.plan(*poses, weight, polish=0, start_free=False, expansions=20_000)
        except InputError as error:
            assert "\n" not in str(error)
            return "refused"
        if not plan.solved:
            return "limit" if plan.status == Status.EXPANSION_LIMIT else "no way"
        grid = Grid(terrain.origin, terrain.shape)
        states = [tuple(grid.to_lattice(row[:3], row[3:]).tolist()) for row in plan.states]
        _replay(Naive(terrain.heights, robot), states, plan.cost)
        return "solved"

    def _labels(self, random: np.random.Generator) -> str:
        """Costs of label tasks without rules are those of the textbook search."""
        robot, heights = random_robot(random), blocky(random, cells=14, blocks=2)
        world = build_world(HeightMap(heights), robot)
        bases = [[*random.integers(4, 10, 2), random.choice([0, 4, 24])] for _ in range(_TRIES)]
        start = next((state for base in bases if (state := feet_at(world, np.array(base))) is not None), None)
        if start is None:
            return "limit"
        least = dijkstra(Naive(heights, robot), tuple(start.tolist()), most=1500).cost
        limit = 2.0
        goals, costs, _ = task_costs(world, start, LabelSettings(), limit, kind=CostKind.PLANNING)
        compared = [
            (cost, least[goal]) for goal, cost in zip(map(tuple, goals.tolist()), costs, strict=True) if goal in least
        ]
        for cost, expected in compared:
            within = expected if expected <= limit else math.inf
            assert math.isclose(cost, within, rel_tol=1e-5), (cost, expected)
        return "compared" if compared else "limit"


@cache
def _preset(name: str) -> Robot:
    return Robot.load(name)


def _replay(twin: Naive, states: list[tuple], cost: float) -> None:
    """Each state is valid, and an action leads to the next one; the actions cost ``cost`` together."""
    total = 0.0
    for state, reached in pairwise(states):
        assert twin.valid(state), f"invalid state {state}"
        ways = [price for _, other, price in twin.successors(state) if other == reached]
        assert ways, f"no action from {state} to {reached}"
        total += min(ways)
    assert twin.valid(states[-1]), f"invalid state {states[-1]}"
    assert math.isclose(total, cost, rel_tol=1e-5, abs_tol=1e-6), (total, cost)


def random_robot(random: np.random.Generator) -> Robot:
    """A toy robot with other costs, limits and abilities."""
    base = {name: dict(values) for name, values in NIMBLE_CHANGES.items()} if random.random() < 0.7 else {}
    changes = {
        "feet": {"clearance": float(random.choice([0.0, 0.025]))},
        "drive": {"level": float(random.choice([0.07, 0.17])), "straight_deviation": float(random.uniform(0.1, 0.6))},
        "base_shift": {**base.get("base_shift", {}), "backward": bool(random.random() < 0.5)},
        "step": {
            **base.get("step", {}), "backward": bool(random.random() < 0.5),
            "max_height": float(random.choice([0.0, 0.08, 0.14])),
        },
        "turn": {"cost": float(random.uniform(0.01, 0.3))},
    }  # fmt: skip
    kind = random.random()
    if kind < 0.15:
        changes["drive"]["sideways"] = False
    elif kind < 0.3:
        changes["turn"] |= {"on_the_spot": False, "radius": float(random.choice([0.3, 0.9]))}
    return toy(**changes)


def random_heights(random: np.random.Generator, cells: int) -> np.ndarray:
    """Heights float32 [cells, cells] with obstacles, slopes and unknown cells."""
    kind = random.random()
    if kind < 0.5:
        heights = small_map(str(random.choice(CATEGORIES)), int(random.integers(1_000_000)), cells)
    elif kind < 0.85:
        heights = blocky(random, cells, int(random.integers(1, 4)))
    else:
        heights = tilted(np.zeros((cells, cells), np.float32), random, 0.4)
    if random.random() < 0.3:
        heights = np.where(random.random(heights.shape) < 0.03, np.nan, heights)
    return np.ascontiguousarray(heights, np.float32)


class _ToyCase(NamedTuple):
    """A small robot on a small map, its textbook twin, and two valid states."""

    robot: Robot
    twin: Naive
    world: World
    start: tuple
    goal: tuple


def _toy_case(random: np.random.Generator, cells: int) -> _ToyCase | None:
    robot, heights = random_robot(random), random_heights(random, cells)
    twin = Naive(heights, robot)
    ends = _ends(twin, random)
    return ends and _ToyCase(robot, twin, build_world(HeightMap(heights), robot), *ends)


def _ends(twin: Naive, random: np.random.Generator):
    states = valid_states(twin, random, 25, neutral=bool(random.random() < 0.5))
    if len(states) < 2:
        return None
    start = (near_edges(twin, states) + states)[0]
    others = [state for state in states if state != start]
    return (start, others[random.integers(len(others))]) if others else None


def _pose_to_leave(planner: Planner, random: np.random.Generator) -> tuple[float, float, float]:
    """A random pose; mostly one from which the robot gets away, where some tries find it."""
    poses = [_pose(planner.terrain, random) for _ in range(_TRIES)]
    return (
        next((pose for pose in poses[1:] if planner.can_leave(pose)), poses[0]) if random.random() < 0.8 else poses[0]
    )


def _pose(terrain: HeightMap, random: np.random.Generator) -> tuple[float, float, float]:
    x, y = (low + random.uniform(0.25, 0.75) * side for low, side in zip(terrain.origin, terrain.size, strict=True))
    return float(x), float(y), float(random.uniform(-np.pi, np.pi))
