"""The robot's limits without which there would be a plan, in words for a robot operator.

A search that ends without a plan shows no obstacle. Here, the query is planned again for robots that lack one limit.
The first plan names the limit: it alone keeps the robot from the goal. If no single limit is decisive, the robot lacks
all of them, and gets back each limit under which a plan remains.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import reduce

import numpy as np

from hdsp.abstract.manual import ManualCosts
from hdsp.base.gradual import Gradual, now
from hdsp.detailed.search.outcome import Limits, Status
from hdsp.detailed.search.weighted_astar import solve
from hdsp.detailed.world.world import World, build_world
from hdsp.planning.heuristics import AbstractHeuristic
from hdsp.robot.action_limits import LONGEST_STEP
from hdsp.robot.lattice import metres
from hdsp.robot.robot import Robot
from hdsp.robot.shape import OFFSETS
from hdsp.terrain.height_map import HeightMap

_EXPANSIONS = 200_000  # of one search; a plan usually takes a tenth
_WEIGHT = 3.0
_FAR = 9.0  # m, more than any height that a leg could reach

#: Removes a limit from a robot.
Removal = Callable[[Robot], Robot]


def decisive_limits(
    terrain: HeightMap, robot: Robot, start: np.ndarray, goal: np.ndarray, seconds: float
) -> str | None:
    """Returns the limits of a robot without which a plan exists, in words.

    Args:
        terrain: the map.
        robot: the robot, which has no plan.
        start, goal: int64 [7], valid states, lattice units.
        seconds: time for all searches together.

    Returns:
        A phrase; None if the plan fails for another reason, or if the time does not suffice.
    """
    ends, longest = now() + seconds, 0.0

    def passes(removals: Sequence[Removal]) -> bool:
        nonlocal longest
        began = now()
        if began + longest >= ends:
            return False
        bot = reduce(lambda bot, remove: remove(bot), removals, robot)
        world, costs = build_world(terrain, bot), ManualCosts(bot)
        longest = max(longest, now() - began)
        return _has_plan(world, AbstractHeuristic(world, terrain, costs), start, goal, ends)

    limits = _limits_of(robot)
    for words, remove in limits.items():
        if passes([remove]):
            return f"{words}; without this limit there is a way"
    if not passes(list(limits.values())):
        return None
    removed = dict(limits)
    for words in limits:
        fewer = {other: remove for other, remove in removed.items() if other != words}
        if passes(list(fewer.values())):
            removed = fewer
    return f"{', and '.join(removed)}; without these limits there is a way"


def _has_plan(world: World, heuristic: AbstractHeuristic, start: np.ndarray, goal: np.ndarray, ends: float) -> bool:
    preparation = Gradual(heuristic.steps_to(goal[None]))
    if not preparation.run(ends):
        return False
    found = solve(
        world,
        start,
        goal,
        preparation.result,
        weight=_WEIGHT,
        admissible=False,
        reopen=False,
        limits=Limits(expansions=_EXPANSIONS, time=max(ends - now(), 0.0)),
        paths=False,
    )
    return found.status == [Status.SOLVED]


def _limits_of(robot: Robot) -> dict[str, Removal]:
    """Removals of a robot's limits, by the limit in words; the most probable ones first."""
    feet, step, drive = robot.feet, robot.step, robot.drive
    low, high = robot.offset_range()
    low = min(low, 1 - OFFSETS // 2)
    reach = {"offset_min": metres(low), "offset_max": metres(max(high, low + OFFSETS - 2))}

    def with_feet(**values) -> Removal:
        return lambda bot: replace(bot, feet=replace(bot.feet, **values))

    def with_step(**values) -> Removal:
        return lambda bot: replace(bot, step=replace(bot.step, **values))

    def both_ways(bot: Robot) -> Robot:
        shift = replace(bot.base_shift, backward=True)
        return replace(bot, step=replace(bot.step, backward=True), base_shift=shift)

    def lifted(bot: Robot) -> Robot:
        return replace(bot, body=replace(bot.body, boxes=tuple(replace(box, above=_FAR) for box in bot.body.boxes)))

    limits = {
        f"the feet reach {feet.offset_min:g} to {feet.offset_max:g} m from neutral": with_feet(**reach),
        f"a foot steps over heights up to {step.max_height:g} m": with_step(max_height=_FAR, max_clearance=_FAR),
        "the body would hit the ground": lifted,
        f"a step is up to {step.max_length:g} m long": with_step(max_length=metres(LONGEST_STEP)),
        f"a foot keeps {feet.clearance:g} m from edges": with_feet(clearance=0.0),
        f"the feet of a side stay {feet.min_separation:g} m apart": with_feet(min_separation=0.0),
        f"the base stays {step.support_margin:g} m inside the triangle of three feet": with_step(support_margin=0.0),
        f"feet that differ by more than {drive.level:g} m in height only drive straight": lambda bot: replace(
            bot, drive=replace(bot.drive, level=_FAR)
        ),
    }
    if not (step.backward and robot.base_shift.backward):
        limits["feet step and the base shifts forward only"] = both_ways
    return limits
