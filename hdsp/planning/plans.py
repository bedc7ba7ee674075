"""What a planner returns: the plan, or why there is none."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from hdsp.base.errors import InputError
from hdsp.detailed.motion.motion import Motion
from hdsp.detailed.motion.refinement import refine
from hdsp.detailed.search.outcome import Status
from hdsp.planning.explanation import explain
from hdsp.robot.robot import Robot
from hdsp.terrain.height_map import HeightMap


@dataclass
class Plan:
    """The outcome of a planning query.

    Convention: metres and radians in the world frame; feet in the order of ``hdsp.robot.robot.FEET``.

    Attributes:
        status: how the search ended.
        cost: of the plan, unitless; inf if there is none.
        states: float64 [n, 7] from start to goal: base x, y (m), heading (rad), four foot offsets (m); [0, 7] if none.
        actions: the n - 1 actions between them, e.g. ``drive``, ``turn_left``, ``step front_left +0.250``.
        action_costs: float64 [n - 1]; they add up to ``cost``.
        stats: expansions, states seen, bytes of memory, seconds (heuristic included), weight, heuristic; below
            ``lower_bound`` no plan costs, 0 if nothing is known. With an anchor also ``anchor_weight``, and of the
            last search's expansions those for the anchor and those for the guide, ``expansions_by``.
        problems: what is wrong with start or goal, or what cuts them off from each other, in words.
        refused: steps of former plans that could not be carried out, in words, if a refinable plan was asked for.
        bound: proved: the plan costs at most so many times the least possible (of plans without the refused steps);
            1 if it is optimal, inf if nothing is proved.
    """

    status: Status
    cost: float
    states: np.ndarray
    actions: list[str]
    action_costs: np.ndarray
    stats: dict[str, Any]
    problems: list[str] = field(default_factory=list)
    refused: list[str] = field(default_factory=list)
    bound: float = np.inf
    terrain: HeightMap | None = field(default=None, repr=False)
    robot: Robot | None = field(default=None, repr=False)
    _motion: Motion | None = field(default=None, repr=False, init=False)

    @property
    def solved(self) -> bool:
        return self.status == Status.SOLVED

    def explain(self) -> str:
        """What came out and why, in words for an operator; one line."""
        return explain(self)

    def refine(self) -> Motion:
        """What the robot does to follow the plan: base and feet in each configuration, every one of them checked.

        Raises:
            InputError: if there is no plan.
            RefinementError: if an action cannot be carried out; it says which and why. ``Planner.plan(...,
                refinable=True)`` looks for a plan without such actions.
        """
        if not self.solved:
            raise InputError(f"there is no plan to refine: {self.explain()}")
        if self._motion is None:
            self._motion = refine(self.terrain, self.robot, self.states, self.actions)
        return self._motion

    def show(self, path: str | Path | None = None):
        """Draw the plan on its terrain: saved as PNG if a path is given, else returned as a matplotlib figure."""
        from hdsp.viz import planned_path_figure, save_planned_path

        if path is None:
            return planned_path_figure(self.terrain, self, self.robot)
        return save_planned_path(self.terrain, self, self.robot, path)
