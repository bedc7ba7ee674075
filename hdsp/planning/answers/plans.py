"""The answer to a planning query: a plan, or the reason for its absence."""

from __future__ import annotations

import webbrowser
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from hdsp.base.errors import InputError, RefinementError
from hdsp.base.gradual import Gradual, finished
from hdsp.base.notebook import html_of, png_of, register_view
from hdsp.base.short_repr import shortened
from hdsp.detailed.actions.action import Action
from hdsp.detailed.causes import Cause
from hdsp.detailed.motion.motion import Motion
from hdsp.detailed.motion.refinement import refine_steps
from hdsp.detailed.search.outcome import Status
from hdsp.planning.answers.explanation import counted, explain_ending, explain_plan
from hdsp.planning.answers.findings import Findings, Inquiry
from hdsp.planning.answers.invalid_end import InvalidEnd
from hdsp.planning.answers.nearest_pose import Nearest
from hdsp.planning.answers.plan_statistics import PlanStatistics
from hdsp.planning.answers.plan_table import SourcePoses, ground_poses, source_poses, write_table
from hdsp.planning.answers.plan_view import PLAN_VIEW
from hdsp.robot.robot import Robot
from hdsp.terrain.height_map import HeightMap
from hdsp.viz.recordings import recording_formats  # noqa: F401, registers formats of motions

if TYPE_CHECKING:
    from hdsp.planning.driving.driven_run import Run
    from hdsp.viz import Failure

#: Titles of pictures without a plan.
_TITLES = {
    Status.INFEASIBLE: "no way from start to goal",
    Status.COST_LIMIT: "no plan within the cost limit",
    Status.INVALID_START: "the robot cannot stand at the start",
    Status.INVALID_GOAL: "the robot cannot stand at the goal",
}


@dataclass(frozen=True, eq=False)
class Plan:
    """The outcome of a planning query.

    Convention: metres and radians in the world frame; feet in the order of ``hdsp.robot.robot.FEET``.

    Attributes:
        status: end of the search.
        cost: cost of the plan, unitless; inf without a plan.
        states: float64 [n, 7] from start to goal: base x, y (m), heading (rad), four foot offsets (m); [0, 7] without a
            plan.
        actions: the n - 1 actions between the states.
        action_costs: float64 [n - 1]; their sum is ``cost``.
        stats: effort and proofs.
        terrain: the map under the plan.
        robot: the robot that follows the plan.
        problems: the causes for which the robot cannot stand at the start or at the goal, and further words about them.
        refused: steps in former plans that could not be carried out, in words; empty unless ``refinable`` was set.
        bound: proved: the plan costs at most so many times the optimum (among plans without the refused steps). 1 for
            an optimal plan, inf without a plan.
        goal_index: number of the goal at which the plan ends, from 0; None without a plan.
        assumed: changes to the map under the robot at the start, in words: unknown ground that was filled in, the
            robot's own body that was removed. ``terrain`` contains them.
        ends: start and goal of the query, world poses with 3 or 7 values; empty if unknown.
        way_out: number of first actions that lead the robot out of the clearance of obstacles; 0 for a valid start. The
            bound then holds among the plans that begin so.
        inquiry: finds the reasons for the absence of a plan, at the first use of ``findings``.
    """

    status: Status
    cost: float
    states: np.ndarray
    actions: tuple[Action, ...]
    action_costs: np.ndarray
    stats: PlanStatistics
    terrain: HeightMap = field(repr=False)
    robot: Robot = field(repr=False)
    problems: tuple[Cause | str, ...] = ()
    refused: tuple[str, ...] = ()
    bound: float = np.inf
    goal_index: int | None = None
    assumed: tuple[str, ...] = ()
    way_out: int = 0
    ends: tuple[np.ndarray, ...] = field(default=(), repr=False)
    inquiry: Inquiry | InvalidEnd | None = field(default=None, repr=False)

    def __repr__(self) -> str:
        effort = f"{counted(self.stats.expansions, 'expansion')}, {self.stats.seconds:.3g} s"
        if not self.solved:
            faults = "; ".join(str(problem) for problem in self.problems[:1])
            return shortened(f"Plan({self.status}{faults and ': '}{faults}, {effort})")
        steps = f", {self.steps} of them steps" if self.steps else ""
        proved = f", at most {self.bound:.3g} times the optimum" if np.isfinite(self.bound) else ""
        return f"Plan(solved: {len(self.actions)} actions{steps}, cost {self.cost:.3f}{proved}, {effort})"

    def _repr_html_(self) -> str | None:
        return html_of(self)

    def _repr_png_(self) -> bytes | None:
        return png_of(self)

    @property
    def solved(self) -> bool:
        return self.status == Status.SOLVED

    @property
    def steps(self) -> int:
        """Number of steps."""
        return sum(action.stepping_foot is not None for action in self.actions)

    def explain(self) -> str:
        """Describes the plan, or the reason for its absence, in one line for an operator.

        Without a plan, the line names the causes at their places, the nearest pose that the search reached, and changes
        that would help. The first call computes them (``findings``, ``limits``) within half a minute,
        and within the query's ``time``.
        """
        if self.solved:
            words = explain_plan(self.terrain, self.robot, self.states, self.actions, self.action_costs)
        else:
            words = explain_ending(self.status, self.stats, self.problems, self.findings, self.limits, self.refused)
        return "; ".join([words, *self.assumed])

    @property
    def causes(self) -> tuple[Cause, ...]:
        """Why there is no plan, each cause at its place; empty for a plan."""
        at_ends = tuple(problem for problem in self.problems if isinstance(problem, Cause))
        return at_ends or self.findings.causes

    @property
    def nearest(self) -> Nearest | None:
        """The pose nearest to the goal that a search without a plan reached."""
        return self.findings.nearest

    @cached_property
    def findings(self) -> Findings:
        """Reasons for the absence of a plan, computed at the first use within some seconds."""
        return self.inquiry() if self.inquiry is not None else Findings()

    @cached_property
    def limits(self) -> str | None:
        """The robot's limits without which there would be a plan, in words; None if none are known.

        The first use may need searches, at most half a minute, and with ``findings`` at most the query's ``time``.
        """
        return self.inquiry.limits(self.findings) if self.inquiry is not None else None

    def refine(self) -> Motion:
        """Returns the motion that follows the plan: base and feet in each configuration, all checked.

        Raises:
            InputError: without a plan.
            RefinementError: the robot cannot carry out an action; the message names the action and the reason.
                ``Planner.plan(..., refinable=True)`` looks for a plan without it.

        Example:
            >>> import hdsp
            >>> plan = hdsp.Planner(hdsp.HeightMap.flat((120, 120))).plan((1.0, 1.5, 0.0), (1.5, 1.5, 0.0))
            >>> motion = plan.refine()
            >>> motion.check(), motion.base[-1, :3].round(2).tolist()  # no faults; x, y, z of the base at the end
            ([], [1.51, 1.51, 0.65])
        """
        if not self.solved:
            raise InputError(f"there is no plan to refine: {self.explain()}")
        return self._motion

    def save(self, path: str | Path, rate: float = 50.0) -> Path:
        """Refines the plan and writes its motion; the suffix names the format, as in ``Motion.save``.

        Args:
            path: file, or folder for a ROS 2 bag.
            rate: states per second; an animation has its own.

        Raises:
            InputError: without a plan, or as in ``Motion.save``.
            RefinementError: as in ``refine``.
        """
        return self.refine().save(path, rate)

    def drive(self, terrain: Any = None, seed: int = 0) -> Run:
        """Refines the plan, and lets a simulated robot drive along it in MuJoCo.

        Args:
            terrain: the true ground, a HeightMap, a Scene (`hdsp.terrain.obstacles`) or an Arena; None: the map under
                the plan.
            seed: seed for the noise of the robot's measured pose.

        Returns:
            the verdict with all states; ``run.save("run.mcap")`` or ``run.save("run.mp4")`` records them.

        Raises:
            InputError: without a plan, or MuJoCo or quadprog is missing (``pip install 'hdsp[simulation]'``).
            RefinementError: as in ``refine``.
        """
        from hdsp.planning.driving.drive import drive

        return drive(self.refine(), terrain, seed)

    def refine_until(self, ends: float) -> bool:
        """Refines the plan, at the latest until a moment on the clock `hdsp.base.gradual.now`; another call continues.

        Returns:
            whether the motion is complete; ``refine`` then returns it at once.

        Raises:
            RefinementError: as in ``refine``.
        """
        if "_motion" not in self.__dict__:
            steps = self._refinement
            try:
                if not steps.run(ends):
                    return False
            except RefinementError:
                del self.__dict__["_refinement"]  # another call fails in the same way
                raise
            self.__dict__["_motion"] = steps.result
        return True

    @cached_property
    def _refinement(self) -> Gradual[Motion]:
        return Gradual(refine_steps(self.terrain, self.robot, self.states, self.actions))

    @cached_property
    def _motion(self) -> Motion:
        return finished(refine_steps(self.terrain, self.robot, self.states, self.actions))

    def show(self, path: str | Path | None = None):
        """Draws the plan on its terrain: a PNG with ``path``, else a matplotlib figure.

        Without a plan, the picture shows start and goal, the area in reach, the causes, and the nearest pose reached.

        Raises:
            InputError: the path is not writable.
        """
        from hdsp.viz import planned_path_figure, save_planned_path

        drawn: dict[str, Any] = {}
        if not self.solved:
            start, *goals = self.ends or (None,)
            title = _TITLES.get(self.status, f"not decided: {str(self.status).replace('_', ' ')}")
            drawn = {"title": title, "start": start, "goal": next(iter(goals), None), "failure": self.failure()}
        if path is None:
            return planned_path_figure(self.terrain, self.states, self.actions, self.robot, **drawn)
        return save_planned_path(self.terrain, self.states, self.actions, self.robot, path, **drawn)

    def view(self, path: str | Path | None = None) -> Path:
        """Writes the plan as an HTML page in three dimensions, on which the robot moves; opens it without ``path``.

        Without a plan, the page shows start and goal, the area in reach, the causes, and the nearest pose reached.

        Args:
            path: the page, .html; None: a file in the folder for temporary files, shown by the browser.

        Returns:
            the path of the page.

        Raises:
            InputError: viser is not installed, or the path is not writable.
        """
        from hdsp.viz.viewer import save_page, temporary_page

        motion: Motion | None = None
        with suppress(RefinementError):  # the robot then stands in each state
            motion = self.refine() if self.solved else None
        failure = None if self.solved else self.failure()
        written = save_page(
            temporary_page() if path is None else path, self.terrain, self.robot, self.states, self.actions, motion,
            self.ends, failure,
        )  # fmt: skip
        if path is None:
            webbrowser.open(written.as_uri())
        return written

    def failure(self) -> Failure:
        """Returns the absence of a plan for `hdsp.viz`, which knows no plans."""
        from hdsp.viz import Failure, Mark

        marks = tuple(
            Mark(cause.place, cause.label + (f", {cause.foot} foot," if cause.foot else ""), cause.pose)
            for cause in self.causes
        )
        nearest = self.nearest
        if nearest is None:
            return Failure(marks, self.findings.reached)
        return Failure(marks, self.findings.reached, nearest.pose, nearest.distance)

    def ground_poses(self) -> np.ndarray:
        """Returns the base poses over the ground, map frame, float64 [n, 6]: x, y, z, roll, pitch, heading.

        Convention: m and rad; z is the ground height under the base, between the feet. ``Rz(heading) Ry(pitch)
        Rx(roll)`` rotates the base frame to the map frame.
        """
        return ground_poses(self.terrain, self.robot, self.states)

    def in_source(self) -> SourcePoses:
        """Returns the poses of `ground_poses` in the frame of the file or cloud from which the map was made."""
        return source_poses(self.terrain, self.ground_poses())

    def write(self, path: str | Path) -> Path:
        """Writes the plan as a CSV table, whole or not at all: one row for each state.

        Columns: ``action`` (it leads to the state), ``x``, ``y``, ``z`` (ground under the base, m), ``heading`` (rad),
        the four foot offsets (m). If the map's frame is not its source's, the poses of `in_source` follow:
        ``source_x``, ``source_y``, ``source_z`` (m), ``source_qx`` to ``source_qw``.

        Raises:
            InputError: the file cannot be written.
        """
        return write_table(path, self.terrain, self.robot, self.states, self.actions)

    def renewed(self, stats: dict[str, Any] | None = None, **changes) -> Plan:
        """Returns a copy with other statistics, status, bound, problems or refused steps."""
        copy = replace(self, stats=replace(self.stats, **(stats or {})), **changes)
        if "_motion" in self.__dict__:
            copy.__dict__["_motion"] = self._motion
        return copy


register_view(Plan, PLAN_VIEW)
