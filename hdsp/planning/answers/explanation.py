"""Explanations for a robot operator: a plan, or the reason for its absence, in one line."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hdsp.detailed.actions.action import Action, ActionKind
from hdsp.detailed.base_pose import base_poses
from hdsp.detailed.search.outcome import Status
from hdsp.planning.answers.findings import Findings
from hdsp.planning.answers.plan_statistics import PlanStatistics
from hdsp.robot.lattice import HEADINGS
from hdsp.robot.robot import Robot
from hdsp.terrain.height_map import HeightMap

_TURNS = ActionKind.TURN_LEFT, ActionKind.TURN_RIGHT
_ARCS = ActionKind.ARC_LEFT, ActionKind.ARC_RIGHT
_DRIVES = ActionKind.DRIVE, *_ARCS
#: Groups of actions in the sum of costs, in their order in the explanation.
_GROUPS = {
    "driving": _DRIVES,
    "turning": _TURNS,
    "steps": (ActionKind.STEP,),
    "moving feet and base": (ActionKind.FOOT_MOVE, ActionKind.BASE_SHIFT),
}
_FLAT = 0.02  # m; footholds with smaller differences in height are level
_UPRIGHT = 5.0  # degrees; a base that leans by less is upright


def explain_plan(
    terrain: HeightMap, robot: Robot, states: np.ndarray, actions: Sequence[Action], costs: np.ndarray
) -> str:
    """Describes a plan: its way, inclination of the base, steps and costs.

    Args:
        terrain: the map under the plan.
        robot: the robot that follows the plan.
        states: float64 [n, 7], world coordinates.
        actions: the n - 1 actions between the states.
        costs: float64 [n - 1], costs of the actions.
    """
    way = _way(terrain, robot, states, actions)
    return f"solved: {way}; cost {costs.sum():.3f} ({_shares(actions, costs)})"


def explain_ending(
    status: Status,
    stats: PlanStatistics,
    problems: Sequence[object],
    findings: Findings,
    limits: str | None,
    refused: Sequence[str],
) -> str:
    """Describes the reason why a query ended without a plan.

    Args:
        status: end of the search.
        stats: effort of the search.
        problems: faults in start or goal.
        findings: further reasons.
        limits: the robot's limits to blame, in words.
        refused: steps in former plans that could not be carried out.
    """
    if status in (Status.INVALID_START, Status.INVALID_GOAL):
        which = "start" if status == Status.INVALID_START else "goal"
        return "; ".join([f"the robot cannot stand at the {which}: " + "; ".join(map(str, problems)), *findings.advice])
    proved = "there is no way"
    if findings.gap is None and not limits:
        proved += ": everything that can be reached from the start was searched"
    endings = {
        Status.INFEASIBLE: proved,
        Status.COST_LIMIT: "there is no plan within the cost limit",
        Status.EXPANSION_LIMIT: f"not decided: stopped after {counted(stats.expansions, 'expansion')}",
        Status.MEMORY_LIMIT: f"not decided: stopped at {stats.memory / 2**20:,.0f} MiB of states",
        Status.TIME_LIMIT: f"not decided: stopped after {stats.seconds:.1f} s",
        Status.CANCELLED: f"not decided: cancelled after {stats.seconds:.1f} s",
    }
    words = endings[status]
    reasons = [findings.gap.words(status == Status.INFEASIBLE)] if findings.gap is not None else []
    if limits:
        reasons.append(limits)
    reasons += [str(cause) for cause in findings.causes]
    if reasons:
        words += (": " if status == Status.INFEASIBLE else "; on the way to the goal ") + "; ".join(reasons)
    if findings.nearest is not None:
        words += f"; {findings.nearest}"
    words += "".join(f"; {advice}" for advice in findings.advice)
    if refused:
        words += f"; {counted(len(refused), 'step')} could not be carried out, first: {refused[0]}"
    return words


def _way(terrain: HeightMap, robot: Robot, states: np.ndarray, actions: Sequence[Action]) -> str:
    moved = np.hypot(*np.diff(states[:, :2], axis=0).T)
    driven = sum(length for length, action in zip(moved, actions, strict=True) if action.kind in _DRIVES)
    turned = sum(action.kind in (*_TURNS, *_ARCS) for action in actions) * 360 / HEADINGS
    parts = [f"drives {driven:.2f} m"]
    if turned:
        parts.append(f"turns by {turned:.0f} degrees")
    if (leaning := _most_leaning(terrain, robot, states)) >= _UPRIGHT:
        parts.append(f"leans by up to {leaning:.0f} degrees")
    if heights := _step_heights(terrain, robot, states, actions):
        rises = [after - before for before, after, _ in heights]
        up, down = sum(rise > _FLAT for rise in rises), sum(rise < -_FLAT for rise in rises)
        level = len(rises) - up - down
        ways = ", ".join(f"{n} {where}" for n, where in ((up, "up"), (down, "down"), (level, "across")) if n)
        tallest = max(top - min(before, after) for before, after, top in heights)
        parts.append(f"makes {counted(len(heights), 'step')} ({ways}) over up to {tallest:.2f} m")
    return ", ".join(parts)


def _most_leaning(terrain: HeightMap, robot: Robot, states: np.ndarray) -> float:
    """Largest angle (degrees) between the base and the horizontal, as steep as the ground on slopes."""
    feet = robot.foot_positions(states)
    roll, pitch = base_poses(robot, states[:, 3:], terrain.height_at(feet[..., 0], feet[..., 1]))[:, 1:].T
    return float(np.degrees(np.arccos(np.clip(np.cos(roll) * np.cos(pitch), -1, 1)).max()))


def _step_heights(
    terrain: HeightMap, robot: Robot, states: np.ndarray, actions: Sequence[Action]
) -> list[tuple[float, float, float]]:
    """Heights at foothold, at landing and at the highest point between, for each step."""
    feet = robot.foot_positions(states)
    found = []
    for k, action in enumerate(actions):
        foot = action.stepping_foot
        if foot is None:
            continue
        line = feet[k, foot] + np.linspace(0, 1, 64)[:, None] * (feet[k + 1, foot] - feet[k, foot])
        heights = np.asarray(terrain.height_at(line[:, 0], line[:, 1]))
        found.append((float(heights[0]), float(heights[-1]), float(np.nanmax(heights))))
    return found


def _shares(actions: Sequence[Action], costs: np.ndarray) -> str:
    sums = {
        name: float(costs[np.array([action.kind in kinds for action in actions], dtype=bool)].sum())
        for name, kinds in _GROUPS.items()
    }
    return ", ".join(f"{name} {cost / costs.sum():.0%}" for name, cost in sums.items() if cost > 0) or "nothing to do"


def counted(number: int, noun: str) -> str:
    """Returns a number with its noun: ``1 step``, ``1,234 steps``."""
    return f"{number} {noun}" if number == 1 else f"{number:,} {noun}s"
