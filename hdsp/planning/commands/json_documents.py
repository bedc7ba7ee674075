"""JSON documents of the commands; docs/command-line.md describes their fields."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from hdsp.detailed.causes import Cause
from hdsp.planning.answers.plans import Plan
from hdsp.terrain.height_map import HeightMap
from hdsp.terrain.map_checks import suspicions


def map_fields(terrain: HeightMap) -> dict[str, Any]:
    """Returns size, heights, frame and signs of faults of a map."""
    known = terrain.heights[np.isfinite(terrain.heights)]
    frame = terrain.frame
    return {
        "shape": terrain.shape,
        "resolution": terrain.resolution,
        "origin": terrain.origin,
        "size": terrain.size,
        "known": known.size / terrain.heights.size,
        "lowest": float(known.min()) if known.size else None,
        "highest": float(known.max()) if known.size else None,
        "median": float(np.median(known)) if known.size else None,
        "frame": frame.name,
        "crs": frame.crs,
        "to_source": frame.to_source,
        "notes": frame.notes,
        "suspicions": suspicions(terrain),
    }


def plan_fields(plan: Plan) -> dict[str, Any]:
    """Returns a plan, or the reasons for its absence."""
    fields: dict[str, Any] = {
        "status": plan.status,
        "solved": plan.solved,
        "words": plan.explain(),
        "cost": plan.cost,
        "bound": plan.bound,
        "goal_index": plan.goal_index,
        "states": plan.states,
        "actions": [str(action) for action in plan.actions],
        "action_costs": plan.action_costs,
        "steps": plan.steps,
        "way_out": plan.way_out,
        "assumed": plan.assumed,
        "refused": plan.refused,
        "stats": dict(plan.stats),
    }
    return fields if plan.solved else fields | _absence(plan)


def _absence(plan: Plan) -> dict[str, Any]:
    nearest = plan.nearest
    return {
        "causes": [_cause(cause) for cause in plan.causes],
        "problems": [str(problem) for problem in plan.problems],
        "nearest": None
        if nearest is None
        else {"pose": nearest.pose, "distance": nearest.distance, "turn": nearest.turn, "words": str(nearest)},
        "limits": plan.limits,
        "advice": plan.findings.advice,
    }


def _cause(cause: Cause) -> dict[str, Any]:
    names: Sequence[str] = ("kind", "place", "amount", "limit", "foot", "foot_place", "pose")
    return {**{name: getattr(cause, name) for name in names}, "words": str(cause)}
