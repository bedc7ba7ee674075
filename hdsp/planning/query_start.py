"""Start of a query, before its search: poses, goals and heuristic, within time and memory limits."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from hdsp.base.gradual import Gradual, Steps, now
from hdsp.detailed.actions.successors import Rules
from hdsp.detailed.causes import Cause
from hdsp.detailed.relaxed.foothold_regions import efforts_to, foothold_region_steps
from hdsp.detailed.search.estimate import Estimate, least_foot_cost, with_step_efforts
from hdsp.detailed.search.life_cycle import Progress
from hdsp.detailed.search.outcome import Limits, Status
from hdsp.detailed.world.world import World
from hdsp.planning.answers.invalid_end import InvalidEnd
from hdsp.planning.answers.nearest_pose import Aim
from hdsp.planning.answers.plan_statistics import PlanStatistics
from hdsp.planning.answers.plans import Plan
from hdsp.planning.arguments import lattice_state, pose_values
from hdsp.planning.ends.arrival import STATE_BYTES, Arrival, Tolerance, arrival_steps, poses_of, several, with_heading
from hdsp.planning.ends.departure import Departure, departure_steps
from hdsp.planning.heuristics import GridHeuristic, Heuristic
from hdsp.planning.memory import least_memory, own_memory
from hdsp.planning.query import Query
from hdsp.planning.shared_ground import SharedGround


class Asked(NamedTuple):
    """Checked arguments for one query; see ``Planner.plan``."""

    start: Any
    goal: Any
    tolerance: Tolerance | None
    start_free: bool
    way_out: bool
    weight: float
    limits: Limits
    progress: Progress | None


def begin_query(ground: SharedGround, asked: Asked) -> Query | Plan:
    """Returns the query, with the heuristic prepared for its goals, or a plan that ends before the search."""
    began, poses = now(), (asked.start, asked.goal)
    limits, heuristic = asked.limits, ground.heuristic
    ended = partial(without_search, ground, weight=asked.weight, began=began, ends=poses)
    free = limits.memory - heuristic.needed_memory() - least_memory(ground.world)
    looking = Gradual(_ends(ground, asked, free))
    if not looking.run(began + limits.time):
        return ended(Status.TIME_LIMIT)
    begin, ends = looking.result
    if begin.faults or ends.faults:
        return _invalid(ground, asked, begin, ends, began)
    exact = ends.exact and len(ends.states) == 1
    groups = None if exact else np.unique(ends.goal, return_inverse=True)[1].ravel()
    same = begin.world is ground.world
    other = 0 if same else own_memory(begin.world, ground.world)
    aside = other + STATE_BYTES * len(ends.states) + least_memory(begin.world)
    heuristic.keep_within(limits.memory - aside - heuristic.needed_memory())

    def on_ground(steps: Steps[Estimate]) -> Steps[tuple[Estimate, Estimate]]:
        found = yield from steps
        return found, (found if same else (yield from _on_ground(begin.world, found, ends)))

    preparation = Gradual(on_ground(heuristic.steps_from(begin.state, ends.states, groups)))
    if not preparation.run(began + limits.time):
        return ended(Status.TIME_LIMIT)
    held = aside - least_memory(begin.world) + heuristic.needed_memory() + heuristic.kept()
    if limits.memory < held + least_memory(begin.world):
        return ended(Status.MEMORY_LIMIT).renewed({"total_memory": held})
    spent = 0.0 if begin.way is None else float(begin.way.costs.sum())
    found, estimate = preparation.result

    def estimate_of(heuristic: Heuristic, until: float) -> Estimate | None:
        steps = Gradual(on_ground(heuristic.steps_to(ends.states, groups)))
        return steps.result[1] if steps.run(until) else None

    return Query(
        terrain=begin.terrain,
        robot=ground.robot,
        wider=ground.wider,
        grid=ground.grid,
        world=begin.world,
        heuristic=heuristic,
        estimate=estimate,
        start=begin.state,
        goals=ends.states,
        goal_numbers=ends.goal,
        # On other ground under the start, costs-to-go in the map may be too high.
        admissible=heuristic.admissible and (same or len(estimate.table) == 0),
        consistent=heuristic.consistent and (same or len(estimate.table) == 0),
        limits=replace(limits, cost=limits.cost - spent, memory=limits.memory - held),
        held=held,
        ends=began + limits.time,
        progress=asked.progress,
        assumed=begin.assumed,
        way=begin.way,
        aims=tuple(_aim(ground, goal) for goal in several(asked.goal) or [asked.goal]),
        measured=ground.terrain if ground.exact else None,
        whole=None if heuristic.covers_map(found) else partial(estimate_of, heuristic),
        others=tuple(partial(estimate_of, other) for other in heuristic.others()),
    )


def without_search(
    ground: SharedGround, status: Status, weight: float, began: float, ends: tuple, faults: Sequence[Cause | str] = ()
) -> Plan:
    """Returns the answer to a query that ends before its search.

    Args:
        ground: shared by all queries.
        status: the query's end.
        weight: the weight asked for.
        began: moment on the clock ``now``.
        ends: start and goal as they were given.
        faults: causes why the start or goal is invalid.
    """
    spent = now() - began
    prepared = spent if status == Status.TIME_LIMIT else 0.0
    stats = PlanStatistics(ground.heuristic.name, float(weight), heuristic_seconds=prepared, seconds=spent)
    nothing = np.empty((0, 7)), (), np.empty(0)
    return Plan(
        status, np.inf, *nothing, stats, ground.terrain, ground.robot, problems=tuple(faults), ends=poses_of(*ends)
    )


def _ends(ground: SharedGround, asked: Asked, memory: int) -> Steps[tuple[Departure, Arrival]]:
    """Finds start and goals in steps; ``memory`` is left for the states at the goals, in bytes."""
    world, grid, wider = ground.world, ground.grid, ground.wider
    begin = yield from departure_steps(
        ground.terrain, world, grid, ground.robot, wider, asked.start, asked.start_free, asked.way_out
    )
    goals = several(asked.goal) or [asked.goal]
    return begin, (yield from arrival_steps(begin.world, grid, wider, goals, asked.tolerance, memory))


def _invalid(ground: SharedGround, asked: Asked, begin: Departure, ends: Arrival, began: float) -> Plan:
    """Returns the answer to a query with an invalid start, else an invalid goal."""
    first = (several(asked.goal) or [asked.goal])[0]
    status, pose = (Status.INVALID_START, asked.start) if begin.faults else (Status.INVALID_GOAL, first)
    values, heading_free = with_heading(pose)
    near = pose_values(values, "pose", ground.wider)[:3]
    inquiry = InvalidEnd(begin.world, ground.grid, ground.wider, near, heading_free)
    faults = begin.faults or ends.faults
    plan = without_search(ground, status, asked.weight, began, (asked.start, asked.goal), faults)
    return plan.renewed(inquiry=inquiry, terrain=begin.terrain)


def _aim(ground: SharedGround, goal: Any) -> Aim:
    """What a goal asks for, without its tolerance."""
    pose, free = with_heading(goal)
    values = pose_values(pose, "goal", ground.wider)
    return Aim(lattice_state(ground.grid, values, "goal"), free, len(values) == 7)


def _on_ground(world: World, estimate: Estimate, ends: Arrival) -> Steps[Estimate]:
    """Makes an estimate for a world with other ground under the start, where the map has no foothold regions."""
    if len(estimate.back.place) > 0:
        groups = np.unique(ends.goal, return_inverse=True)[1].ravel()
        return (yield from GridHeuristic(world).steps_to(ends.states, groups))
    if len(estimate.effort) == 0:
        return estimate
    regions = yield from foothold_region_steps(world, Rules(), least_foot_cost(world))
    return with_step_efforts(estimate, regions.region, efforts_to(regions, world, ends.states))
