"""A plan, or why there is none, in words for a robot operator."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from hdsp.detailed.search.outcome import Status
from hdsp.robot.robot import FEET

if TYPE_CHECKING:
    from hdsp.planning.plans import Plan

#: How the kinds of action are summed up; in the order in which they are told.
_KINDS = {
    "driving": ("drive",),
    "turning": ("turn_left", "turn_right"),
    "steps": ("step",),
    "moving feet and base": ("foot_move", "base_shift"),
}
_FLAT = 0.02  # m; footholds whose heights differ by less are on one level


def explain(plan: Plan) -> str:
    """What came out of planning and why; one line."""
    if plan.solved:
        return f"solved: {_way(plan)}; cost {plan.cost:.3f} ({_costs(plan)})"
    if plan.status in (Status.INVALID_START, Status.INVALID_GOAL):
        which = "start" if plan.status == Status.INVALID_START else "goal"
        return f"the robot cannot stand at the {which}: " + "; ".join(plan.problems)
    if plan.status == Status.INFEASIBLE and plan.problems:
        return "there is no way: " + "; ".join(plan.problems)
    endings = {
        Status.INFEASIBLE: "there is no way: everything that can be reached from the start was searched",
        Status.COST_LIMIT: "there is no plan within the cost limit",
        Status.EXPANSION_LIMIT: f"not decided: stopped after {plan.stats['expansions']:,} expansions",
        Status.MEMORY_LIMIT: f"not decided: stopped at {plan.stats['memory'] / 2**20:,.0f} MiB of states",
        Status.TIME_LIMIT: f"not decided: stopped after {plan.stats['seconds']:.1f} s",
    }
    words = endings[plan.status]
    if plan.refused:
        words += f"; {_count(len(plan.refused), 'step')} could not be carried out, first: {plan.refused[0]}"
    return words


def _way(plan: Plan) -> str:
    moved = np.hypot(*np.diff(plan.states[:, :2], axis=0).T)
    driven = sum(length for length, action in zip(moved, plan.actions, strict=True) if action == "drive")
    turned = sum(action in _KINDS["turning"] for action in plan.actions) * 360 / 64
    parts = [f"drives {driven:.2f} m"]
    if turned:
        parts.append(f"turns by {turned:.0f} degrees")
    if heights := _step_heights(plan):
        rises = [after - before for before, after, _ in heights]
        up, down = sum(rise > _FLAT for rise in rises), sum(rise < -_FLAT for rise in rises)
        level = len(rises) - up - down
        ways = ", ".join(f"{n} {where}" for n, where in ((up, "up"), (down, "down"), (level, "across")) if n)
        tallest = max(top - min(before, after) for before, after, top in heights)
        parts.append(f"makes {_count(len(heights), 'step')} ({ways}) over up to {tallest:.2f} m")
    return ", ".join(parts)


def _step_heights(plan: Plan) -> list[tuple[float, float, float]]:
    """Heights of foothold, landing and the highest ground between, of each step."""
    assert plan.robot is not None and plan.terrain is not None
    feet = plan.robot.foot_positions(plan.states)
    found = []
    for k, action in enumerate(plan.actions):
        if not action.startswith("step "):
            continue
        foot = FEET.index(action.split()[1])
        line = feet[k, foot] + np.linspace(0, 1, 64)[:, None] * (feet[k + 1, foot] - feet[k, foot])
        heights = plan.terrain.height_at(line[:, 0], line[:, 1])
        found.append((float(heights[0]), float(heights[-1]), float(np.nanmax(heights))))
    return found


def _costs(plan: Plan) -> str:
    kinds = np.array([action.split()[0] for action in plan.actions])
    sums = {name: float(plan.action_costs[np.isin(kinds, members)].sum()) for name, members in _KINDS.items()}
    return ", ".join(f"{name} {cost / plan.cost:.0%}" for name, cost in sums.items() if cost > 0) or "nothing to do"


def _count(number: int, what: str) -> str:
    return f"{number} {what}" if number == 1 else f"{number} {what}s"
