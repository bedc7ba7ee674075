"""The robot's limits that stop a foot between two footholds, in words for a robot operator.

A foot moves along the straight line between the footholds: it rolls over cells on which it can stand, and steps over
edges. Four limits of the robot restrict it. A limit is to blame if the foot passes without it, while the others hold;
if no single limit is to blame, a smallest set of limits is.
"""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from hdsp.detailed.relaxed.proofs import is_foot_stopped
from hdsp.detailed.world.world import World, build_world, cell_index
from hdsp.robot.action_limits import LONGEST_STEP
from hdsp.robot.lattice import cells, metres
from hdsp.robot.robot import Robot
from hdsp.terrain.height_map import HeightMap
from hdsp.terrain.rounding import height_tolerance

CLEARANCE, HEIGHT, LIFT, LENGTH = range(4)
#: A foot with less clearance could turn over an edge.
_FREE = {CLEARANCE: metres(1.2), HEIGHT: math.inf, LIFT: math.inf, LENGTH: math.inf}
_HIGH = 9.0  # m, more than any height that a leg could reach
_MOST_CELLS = 200  # on the line; a longer gap has no single step


class Line(NamedTuple):
    """Ground along the straight line between two footholds.

    Attributes:
        spacing: distance between neighbouring points, m.
        height: float64 [n], m; -inf where unknown.
        around: float64 [n, k], ground at ``reach`` from the points, m; inf where unknown.
        reach: float64 [k], m.
        edge: bool [n], a wheel does not pass.
        edge_away: float64 [n], distance to the nearest edge, m; inf beyond the robot's clearance.
        closed: bool [n], no foot stands there for another reason than an edge.
    """

    spacing: float
    height: np.ndarray
    around: np.ndarray
    reach: np.ndarray
    edge: np.ndarray
    edge_away: np.ndarray
    closed: np.ndarray


def stopping_limits(
    terrain: HeightMap, robot: Robot, start: np.ndarray, goal: np.ndarray, line_cells: np.ndarray
) -> str | None:
    """Returns the limits that stop a foot on its way along a line of cells, in words.

    Args:
        terrain: the map.
        robot: its limits.
        start, goal: int64 [7], valid states, lattice units; no steps lead a foot from one to the other.
        line_cells: int64 [n, 2], map cells on a straight line; a foot can stand on the first and on the last.

    Returns:
        Words; None if limits are not the cause, e.g. beside unknown ground.
    """
    if not 2 <= len(line_cells) <= _MOST_CELLS:
        return None
    line = _line(build_world(terrain, robot), robot, line_cells)
    limits = {
        CLEARANCE: robot.feet.clearance,
        HEIGHT: robot.step.max_height,
        LIFT: robot.step.max_clearance,
        LENGTH: robot.step.max_length,
    }
    on_line = blamed = _to_blame(line, limits, bool(_treads(line, robot)))
    for limit in on_line:
        # The foot may pass beside the line, where fewer limits stop it.
        fewer = [other for other in blamed if other != limit]
        if fewer and not is_foot_stopped(build_world(terrain, _robot_without(robot, fewer)), start, goal):
            blamed = fewer
    needs = {limit: _needed(line, _without(limits, on_line), limit) for limit in blamed}
    words = [
        _words(line, robot, limit, needed)
        for limit, needed in needs.items()
        if needed is not None and (needed < limits[limit] if limit == CLEARANCE else needed > limits[limit])
    ]
    return "; ".join(words) or None


def _robot_without(robot: Robot, free: list[int]) -> Robot:
    feet, step = robot.feet, robot.step
    return replace(
        robot,
        feet=replace(feet, clearance=_FREE[CLEARANCE] if CLEARANCE in free else feet.clearance),
        step=replace(
            step,
            max_height=_HIGH if HEIGHT in free else step.max_height,
            max_clearance=_HIGH if LIFT in free else step.max_clearance,
            max_length=metres(LONGEST_STEP) if LENGTH in free else step.max_length,
        ),
    )


def _without(limits: dict[int, float], free: list[int]) -> dict[int, float]:
    return {**limits, **{limit: _FREE[limit] for limit in free}}


def _line(world: World, robot: Robot, line_cells: np.ndarray) -> Line:
    flat = np.array([int(cell_index(world, *cell)) for cell in line_cells])
    reach = math.floor(cells(robot.feet.clearance) + 1e-9)
    dx, dy = np.mgrid[-reach : reach + 1, -reach : reach + 1].reshape(2, -1)
    away = np.hypot(dx, dy)
    near = away <= cells(robot.feet.clearance) + 1e-9
    around = flat[:, None] + (dx * world.stride + dy)[near]
    away = metres(away[near])
    edge_away = np.where(world.edge[around], away, np.inf).min(axis=1)
    heights = world.height[around].astype(float)
    return Line(
        spacing=metres(float(np.hypot(*(line_cells[-1] - line_cells[0])))) / (len(line_cells) - 1),
        height=world.height[flat].astype(float),
        around=np.where(np.isfinite(heights), heights, np.inf),
        reach=away,
        edge=world.edge[flat],
        edge_away=edge_away,
        closed=~world.standable[flat] & ~np.isfinite(edge_away),
    )


def _to_blame(line: Line, limits: dict[int, float], treads: bool) -> list[int]:
    """Smallest set of limits without which the foot passes; ``treads``: some treads have no foothold."""
    if not _passes(line, _FREE):
        return []
    alone = [limit for limit in limits if _passes(line, _without(limits, [limit]))]
    if CLEARANCE in alone and (treads or alone == [CLEARANCE]):
        return [CLEARANCE]  # a foothold on a tread is nearer than a step over the tread
    if alone:
        # A limit of 0, e.g. of a robot that does not step, is exceeded most.
        needed = {limit: _needed(line, limits, limit) or math.inf for limit in alone}
        excess = {limit: needed[limit] / limits[limit] if limits[limit] else math.inf for limit in alone}
        return [max(alone, key=lambda limit: (limit != CLEARANCE, -excess[limit]))]
    blamed = list(limits)
    for limit in (LENGTH, LIFT, HEIGHT, CLEARANCE):
        fewer = [other for other in blamed if other != limit]
        if _passes(line, _without(limits, fewer)):
            blamed = fewer
    return blamed


def _needed(line: Line, limits: dict[int, float], limit: int) -> float | None:
    """First value of a limit, from strict to loose, with which the foot passes; None without one."""
    if limit == CLEARANCE:
        finite = np.unique(line.edge_away[np.isfinite(line.edge_away)])[::-1]
        values = np.maximum(finite - 1e-6, 0.0)
    elif limit == LENGTH:
        values = line.spacing * np.arange(1, len(line.height))
    else:
        levels = np.unique(np.concatenate([line.height, line.around.ravel()]))
        levels = levels[np.isfinite(levels)]
        values = np.unique(abs(levels[:, None] - levels))
    return next((float(value) for value in values if _passes(line, {**limits, limit: float(value)})), None)


def _passes(line: Line, limits: dict[int, float]) -> bool:
    """Whether a foot gets from the first to the last point under some limits."""
    n = len(line.height)
    stands = ~line.closed & ~line.edge & (line.edge_away > limits[CLEARANCE] + 1e-9)
    stands[0] = stands[-1] = True
    lifted = line.around[:, line.reach <= limits[CLEARANCE] + 1e-9].max(axis=1)
    reached, waiting = np.zeros(n, bool), [0]
    reached[0] = True
    while waiting:
        i = waiting.pop()
        for way in (1, -1):
            crossed, highest, rolling = False, line.height[i], True
            for j in range(i + way, n if way == 1 else -1, way):
                if line.spacing * abs(j - i) > limits[LENGTH] + 1e-6:
                    break
                crossed, highest = crossed or bool(line.edge[j]), max(highest, lifted[j])
                rolling = rolling and bool(stands[j])
                lowest = min(line.height[i], line.height[j])
                rounding = height_tolerance(line.height[i])
                fits = abs(line.height[j] - line.height[i]) <= limits[HEIGHT] + rounding
                fits = fits and crossed and highest < math.inf and highest - lowest <= limits[LIFT] + rounding
                if stands[j] and not reached[j] and (rolling or fits):
                    reached[j] = True
                    waiting.append(j)
    return bool(reached[-1])


def _words(line: Line, robot: Robot, limit: int, needed: float) -> str:
    if limit == HEIGHT:
        most = robot.step.max_height
        return f"a step there rises or falls by {_above(needed, most)} m; the robot steps up to {most:g} m"
    if limit == LIFT:
        most = robot.step.max_clearance
        swing = f"a foot would swing {_above(needed, most)} m above its lower foothold"
        return f"{swing}; the robot lifts it up to {most:g} m"
    if limit == LENGTH:
        most = robot.step.max_length
        return f"a step there is {_above(needed, most)} m long; the robot steps up to {most:g} m"
    clearance, treads = robot.feet.clearance, _treads(line, robot)
    if not treads:
        return f"no foothold there is {clearance:g} m away from all edges, only {needed:.3f} m"
    shallow, deep = f"{min(treads):.2f}", f"{max(treads):.2f}"
    depth = shallow if shallow == deep else f"{shallow} to {deep}"
    return (
        f"the treads are {depth} m deep; a foot that keeps {clearance:g} m from edges needs {_least_tread(robot):g} m"
    )


def _above(value: float, limit: float) -> str:
    """A value in m with three decimals, or with so many that the words exceed the limit."""
    return next((text for n in range(3, 7) if float(text := f"{value:.{n}f}") > limit), f"{value:g}")


def _least_tread(robot: Robot) -> float:
    """Depth (m) of the shortest tread with a foothold; an edge takes the cells on both its sides."""
    return metres(2.0 * (math.floor(cells(robot.feet.clearance) + 1e-9) + 1) + 1)


def _treads(line: Line, robot: Robot) -> list[float]:
    """Depths (m) of the ground between edges that has no foothold."""
    known = np.where(np.isfinite(line.height), line.height, np.nan)
    rises = np.flatnonzero(abs(np.diff(known)) > robot.drive.highest_edge + height_tolerance(known[1:])) + 1
    found = []
    for first, end in pairwise(rises):
        edge_away = line.edge_away[first:end]
        if np.isfinite(edge_away).all() and not line.closed[first:end].any():
            # The line may cross the tread at an angle; the distance to the edges bounds the depth.
            found.append(min(line.spacing * (end - first), 2 * float(edge_away.max()) + metres(2.0)))
    return found
