"""Conformance checker for heuristics: does an own ``Heuristic`` keep the contract?

from hdsp.planning import check_heuristic

check_heuristic(lambda world, terrain: MyHeuristic(world))
"""

from collections.abc import Callable

import numpy as np

from hdsp.abstract.abstract_costs import Region
from hdsp.abstract.transform import feet_at_all
from hdsp.base.conformance import Contract
from hdsp.base.errors import InputError
from hdsp.detailed.actions.successors import MAX_SUCCESSORS, Rules, successors
from hdsp.detailed.search.estimate import Estimate, estimate, geometric_estimate
from hdsp.detailed.search.outcome import Limits
from hdsp.detailed.search.weighted_astar import solve
from hdsp.detailed.states import pack_states, unpack_states
from hdsp.detailed.world.world import World, build_world
from hdsp.planning.heuristics.heuristic import Heuristic
from hdsp.robot.lattice import HEADINGS
from hdsp.robot.robot import Robot
from hdsp.terrain.height_map import HeightMap
from hdsp.terrain.scenes import random_map

#: The rules of the contract `Heuristic`.
RULES = {
    "claims": "name is a word, admissible and consistent are bool, and a consistent heuristic is admissible",
    "life": "without a goal (before set_goal, after clear and update) a call raises InputError",
    "values": "estimates are float64 [n], >= 0 and never NaN",
    "kernel": "set_goal returns an Estimate, and a call gives the values that kernels read from it",
    "determinism": "a state and a goal have one estimate, with other states, after other goals, clear and prepare",
    "input": "goal and states stay unchanged",
    "solvable": "the estimate is finite where a way to the goal exists",
    "goal": "an admissible heuristic is 0 at the goal",
    "admissible": "an admissible heuristic never exceeds the cost of the best way to the goal",
    "consistent": "no action lowers a consistent heuristic by more than its cost",
    "update": "after update, estimates are those of a new heuristic for the new terrain; other copies keep theirs",
}

#: Rounding of sums and of tables in float32, relative and absolute.
_ROUNDING = 1e-5

#: Searches that take longer prove nothing here.
_LIMITS = Limits(cost=1.0, expansions=100_000)


def check_heuristic(
    make: Callable[[World, HeightMap], Heuristic],
    robot: Robot | str = "momaro",
    terrain: HeightMap | None = None,
    *,
    states: int = 24,
) -> tuple[str, ...]:
    """Check whether a heuristic keeps its contract.

    Claims are compared with optimal searches from sampled states: success is evidence and no proof.

    Args:
        make: makes the heuristic for a compiled terrain and the same terrain.
        robot: robot, preset's name, or path of a YAML file.
        terrain: height map on which the robot can stand; None = random cuboids of 1.8 x 1.8 m.
        states: number of sampled states, and of actions on a random way to a goal.

    Returns:
        Names of the rules that were checked, keys of ``RULES``.

    Raises:
        ConformanceError: a rule is broken.
        InputError: the robot can hardly stand or move on the terrain.
    """
    contract = Contract("Heuristic", RULES)
    robot = Robot.load(robot)
    terrain = random_map(4, "cuboid_2", 3) if terrain is None else terrain
    world = build_world(terrain, robot)
    random = np.random.default_rng(0)
    sampled = _standing_states(world, random, states)
    walks = _walks(world, sampled, random)

    heuristic = make(world, terrain)
    _check_claims(contract, heuristic)
    contract.require_error("life", InputError, lambda: heuristic(sampled), "a call before set_goal")
    for walk in walks:
        known = np.concatenate([walk, sampled])
        values = _check_values(contract, heuristic, world, walk[-1], known)
        _check_searches(contract, heuristic, world, walk, values[: len(walk)])
        if heuristic.consistent:
            _check_consistent(contract, heuristic, world, known, values)
    _check_determinism(contract, heuristic, sampled, walks[0][-1], walks[1][-1])
    _check_update(contract, make, robot, terrain, random, states)
    return contract.checked


def _standing_states(world: World, random: np.random.Generator, count: int) -> np.ndarray:
    """Valid states, int64 [count, 7], at random bases with their best feet."""
    tries = 200 * count
    bases = np.column_stack([random.integers(0, high, tries) for high in (world.nx, world.ny, HEADINGS)])
    found, valid = feet_at_all(world, bases)
    found = found[valid][:count]
    if len(found) < count:
        raise InputError(f"terrain: the robot can stand at {len(found)} of {tries} random poses; need at least {count}")
    return found


def _walks(world: World, starts: np.ndarray, random: np.random.Generator) -> list[np.ndarray]:
    """Ways, int64 [n, 7], to two goals, their last states: one of random actions, and one of the least cost per
    distance, where an estimate that is too high shows."""
    wandering = [_walk(world, start, len(starts), random) for start in starts]
    straight = [_walk(world, start, 8, None) for start in starts]
    lengths = [len(walk) for walk, _ in wandering]
    rates = [np.hypot(*(walk[-1] - walk[0])[:2]) / cost if cost > 0 else 0.0 for walk, cost in straight]
    if max(lengths) == 1:
        raise InputError(f"terrain: the robot cannot move from {len(starts)} random states")
    return [wandering[int(np.argmax(lengths))][0], straight[int(np.argmax(rates))][0]]


def _walk(world: World, start: np.ndarray, steps: int, random: np.random.Generator | None) -> tuple[np.ndarray, float]:
    """States, int64 [n, 7], of a walk of at most so many actions, and its cost.

    The actions are random, or lead away from the start at the least cost per distance.
    """
    lowest = world.tables.lowest
    walk, cost = [start], 0.0
    for _ in range(steps):
        keys, costs = _successors(world, int(pack_states(walk[-1], lowest)[0]))
        if not len(keys):
            break
        reached = unpack_states(keys, lowest)
        gained = np.hypot(*(reached - start)[:, :2].T) - np.hypot(*(walk[-1] - start)[:2])
        chosen = int(np.argmax(gained / costs)) if random is None else int(random.integers(len(keys)))
        walk.append(reached[chosen])
        cost += float(costs[chosen])
    return np.array(walk), cost


def _successors(world: World, key: int) -> tuple[np.ndarray, np.ndarray]:
    """Packed successors of a packed state, int64 [n], and the costs of the actions that lead to them, float64 [n]."""
    keys, costs = np.empty(MAX_SUCCESSORS, np.int64), np.empty(MAX_SUCCESSORS)
    n = successors(world, Rules(), key, keys, costs, np.empty(MAX_SUCCESSORS, np.uint8))
    return keys[:n], costs[:n]


def _check_claims(contract: Contract, heuristic: Heuristic) -> None:
    contract.require("claims", isinstance(heuristic, Heuristic), f"{type(heuristic).__name__} is no Heuristic")
    name = getattr(heuristic, "name", None)
    contract.require("claims", isinstance(name, str) and name, f"name is {name!r}")
    for claim in ("admissible", "consistent"):
        value = getattr(heuristic, claim, None)
        contract.require("claims", isinstance(value, bool), f"{claim} is {value!r}")
    contract.require("claims", heuristic.admissible or not heuristic.consistent, "consistent, but not admissible")


def _check_values(
    contract: Contract, heuristic: Heuristic, world: World, goal: np.ndarray, states: np.ndarray
) -> np.ndarray:
    """Check the estimates of states for a goal; returns them, float64 [n]."""
    given = goal.copy(), states.copy()
    view = heuristic.set_goal(given[0])
    values = heuristic(given[1])
    contract.require_equal("input", given[0], goal, "goal after set_goal")
    contract.require_equal("input", given[1], states, "states after a call")
    contract.require("kernel", isinstance(view, Estimate), f"set_goal returns {type(view).__name__}")
    kind = isinstance(values, np.ndarray) and values.dtype == np.float64 and values.shape == (len(states),)
    contract.require("values", kind, f"{getattr(values, 'dtype', type(values).__name__)} {np.shape(values)}")
    wrong = np.flatnonzero(~(values >= 0))
    contract.require("values", not len(wrong), f"{values[wrong[:1]]} at state {states[wrong[:1]].tolist()}")
    read = np.array([estimate(world, view, int(key)) for key in pack_states(states, world.tables.lowest)])
    contract.require_equal("kernel", values, read, "estimates")
    if heuristic.admissible:
        at_goal = float(values[(states == goal).all(axis=1)].max())
        contract.require("goal", at_goal <= _ROUNDING, f"{at_goal} at goal {goal.tolist()}")
    return values


def _check_searches(
    contract: Contract, heuristic: Heuristic, world: World, walk: np.ndarray, values: np.ndarray
) -> None:
    """Compare estimates on a walk to the goal with the costs of optimal searches without a heuristic."""
    goal = walk[-1]
    zero = geometric_estimate(world, goal)._replace(distance=0.0, turn=0.0, foot=0.0)
    for start, value in zip(walk, values, strict=True):
        way = f"{value} at state {start.tolist()} with a way to goal {goal.tolist()}"
        contract.require("solvable", np.isfinite(value), way)
        if heuristic.admissible:
            result = solve(world, start, goal[None], zero, limits=_LIMITS, paths=False)
            cost = float(result.cost[0])  # inf where the search ended at a limit
            contract.require("admissible", value <= cost * (1 + _ROUNDING) + _ROUNDING, f"{way} of cost {cost}")


def _check_consistent(
    contract: Contract, heuristic: Heuristic, world: World, states: np.ndarray, values: np.ndarray
) -> None:
    for state, value, key in zip(states, values, pack_states(states, world.tables.lowest), strict=True):
        keys, costs = _successors(world, int(key))
        if not len(keys):
            continue
        reached = unpack_states(keys, world.tables.lowest)
        after = heuristic(reached)
        worst = int(np.argmin(after + costs))
        bound = float(after[worst] + costs[worst])
        found = f"{value} at state {state.tolist()}, {after[worst]} at {reached[worst].tolist()}, cost {costs[worst]}"
        contract.require("consistent", value <= bound * (1 + _ROUNDING) + _ROUNDING, found)


def _check_determinism(
    contract: Contract, heuristic: Heuristic, states: np.ndarray, first: np.ndarray, second: np.ndarray
) -> None:
    heuristic.set_goal(first)
    values = heuristic(states)
    contract.require_equal("determinism", heuristic(states[::-1])[::-1], values, "estimates in reverse")
    contract.require_equal("determinism", heuristic(states[:1]), values[:1], "estimate of a state alone")
    heuristic.set_goal(second)
    heuristic.set_goal(first)
    contract.require_equal("determinism", heuristic(states), values, "estimates after another goal")
    heuristic.clear()
    contract.require_error("life", InputError, lambda: heuristic(states), "a call after clear")
    heuristic.prepare()
    heuristic.set_goal(first)
    contract.require_equal("determinism", heuristic(states), values, "estimates after clear and prepare")


def _check_update(
    contract: Contract,
    make: Callable[[World, HeightMap], Heuristic],
    robot: Robot,
    terrain: HeightMap,
    random: np.random.Generator,
    states: int,
) -> None:
    nx, ny = terrain.shape
    heights = terrain.heights.copy()
    region = nx // 2, ny // 2, nx, ny
    heights[nx // 2 :, ny // 2 + 4 :] += np.float32(0.01)  # a wheel rolls over this edge
    heights[nx - 12 : nx - 10, ny // 2 :] = np.float32(0.9)
    heights[nx // 2 + 14, ny // 2 + 14] = np.nan
    changed = HeightMap(heights, terrain.origin, terrain.resolution)
    smaller = HeightMap(heights[:-8], terrain.origin, terrain.resolution)
    updates: tuple[tuple[HeightMap, Region | None], ...] = ((changed, region), (changed, None), (smaller, None))
    old_world = build_world(terrain, robot)
    for after, where in updates:
        world = build_world(after, robot)
        sampled = _standing_states(world, random, states)
        heuristic, new = make(old_world, terrain), make(world, after)
        former, known = heuristic, _standing_states(old_world, random, states)
        former.set_goal(known[0])
        values = former(known)
        heuristic = former.updated(world, after, where)
        contract.require_equal("update", former(known), values, "estimates of a heuristic after an update of its copy")
        contract.require_error("life", InputError, lambda h=heuristic, s=sampled: h(s), "a call after update")
        for goal in sampled[:2]:
            heuristic.set_goal(goal)
            new.set_goal(goal)
            words = f"estimates after an update of {'all' if where is None else f'region {where}'}"
            contract.require_equal("update", heuristic(sampled), new(sampled), words)
