"""Why a query ended without a plan: causes at their places, the nearest pose in reach, and advice.

The findings take from a tenth of a second to some seconds, limits of the robot up to half a minute, and both together
at most the query's ``time``. They are therefore computed when a plan is first asked for them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from hdsp.base.gradual import Gradual, Steps, now
from hdsp.base.short_repr import short_repr
from hdsp.detailed.actions.successors import Rules
from hdsp.detailed.causes import Cause, Gap, Kind, Obstacle, obstacle_steps
from hdsp.detailed.causes.gap import obstacle_of_base, obstacle_of_foot
from hdsp.detailed.relaxed.heading_masks import PoseFlood
from hdsp.detailed.relaxed.proofs import FOOT, POSE, Unreachable
from hdsp.detailed.search.estimate import geometric_estimate
from hdsp.detailed.search.outcome import Limits, Status
from hdsp.detailed.search.reached import METRES_PER_RADIAN, Reached
from hdsp.detailed.search.weighted_astar import solve
from hdsp.detailed.world.world import World, build_world
from hdsp.planning.answers.advice import advice_for
from hdsp.planning.answers.decisive_limits import decisive_limits
from hdsp.planning.answers.foot_limits import stopping_limits
from hdsp.planning.answers.nearest_pose import Aim, Nearest
from hdsp.robot.lattice import HEADINGS, Grid, cells, heading_angle, metres
from hdsp.robot.robot import Robot
from hdsp.terrain.height_map import HeightMap

#: Time for limits of the robot, s: after a failure that shows no obstacle, and beside causes.
REASON_SECONDS, BESIDE_CAUSES = 30.0, 15.0
_EXPANSIONS = 50_000  # of the search for a pose in reach that is nearer to the goal
_NEARER = 0.05  # m; less is not worth this search
_LATE = "the reasons take longer than the time limit"


@dataclass(frozen=True, eq=False)
class Findings:
    """Reasons for the absence of a plan.

    Attributes:
        causes: ground that keeps the robot from the goal, the first obstacle on the way of least resistance.
        gap: the gap between the poses in reach and the goal; None without one.
        nearest: the pose in reach that is nearest to the goal; None without a search.
        reached: bool [nx, ny], cells of the base that the search or a proof found in reach; None without a search.
        advice: changes that would or may help, in words.
        seconds: time that they took.
    """

    causes: tuple[Cause, ...] = ()
    gap: Gap | None = None
    nearest: Nearest | None = None
    reached: np.ndarray | None = None
    advice: tuple[str, ...] = ()
    seconds: float = 0.0

    def __repr__(self) -> str:
        return short_repr(self)


@dataclass(frozen=True, eq=False)
class Inquiry:
    """A query that ended without a plan.

    Attributes:
        terrain: the map.
        robot: whose plan it would be.
        wider: the same robot with its margin.
        start: int64 [7], lattice units.
        goal: int64 [7], lattice units; of several goal states, the one that stands for all.
        aim: what the query asks of its end.
        status: end of the search.
        reached: states that the search reached.
        proof: proof of infeasibility; None without one.
        measured: the planner's map, without changes under the start; None if it is conditioned.
        seconds: time for all reasons together, the query's limit.
    """

    terrain: HeightMap
    robot: Robot
    wider: Robot
    start: np.ndarray
    goal: np.ndarray
    aim: Aim
    status: Status
    reached: Reached | None
    proof: Unreachable | None = None
    measured: HeightMap | None = None
    seconds: float = np.inf

    def __call__(self) -> Findings:
        """Finds the reasons, or as much as the time allows."""
        began = now()
        ends = began + self.seconds
        looking = Gradual(self._obstacle_steps())
        if not looking.run(ends):
            known = Obstacle((), None)
            if self.proof is not None and self.proof.proof == POSE:
                known = obstacle_of_base(self.proof, self.terrain, Grid(self.terrain.origin, self.terrain.shape))
            return Findings(known.causes, known.gap, advice=(_LATE,), seconds=now() - began)
        world, reached, obstacle = looking.result
        nearest = None if self.reached is None else self._nearest(world, reached, ends)
        return Findings(
            causes=obstacle.causes,
            gap=obstacle.gap,
            nearest=nearest,
            reached=reached != 0,
            advice=advice_for(
                self.terrain, self.measured, self.robot, self.wider, obstacle.causes, nearest, self.aim.feet_given
            ),
            seconds=now() - began,
        )

    def _obstacle_steps(self) -> Steps[tuple[World, np.ndarray, Obstacle]]:
        """Finds the obstacle, in short steps; also returns the headings in reach at each cell, as bits."""
        world, grid = build_world(self.terrain, self.wider), Grid(self.terrain.origin, self.terrain.shape)
        yield
        reached = yield from self._reached_steps(world)
        if self.proof is not None and self.proof.proof == FOOT:
            return world, reached, obstacle_of_foot(self.proof, world, grid, self.wider)
        found = yield from obstacle_steps(world, grid, self.wider, self.start, self.goal, reached)
        return world, reached, found

    def _reached_steps(self, world: World) -> Steps[np.ndarray]:
        """Headings in reach at each cell, as bits: those searched; for a proof also those of a relaxed problem."""
        if self.reached is None:
            reached = np.zeros((world.nx, world.ny), np.uint64)
            reached[self.start[0], self.start[1]] = np.uint64(1) << np.uint64(self.start[2])
        else:
            reached = self.reached.headings
        if self.proof is not None:
            # After a proof for one foot, the relaxed problem of poses may reach the goal. Driving alone does not.
            drive_only = self.proof.proof == FOOT
            flood = yield from PoseFlood(world, Rules()).steps_from(self.start, drive_only)
            reached = reached | np.bitwise_or.reduce(flood)
        return reached

    def limits(self, findings: Findings) -> str | None:
        """Returns the limits of the robot that keep it from the goal, in words.

        Args:
            findings: the reasons found. Limits are sought where the causes are edges, over which other robots step.

        Returns:
            The words; None where the ground alone is the cause, nothing is proved, or the time does not suffice.
        """
        causes = findings.causes
        ground_alone = bool(causes) and all(cause.kind != Kind.EDGE for cause in causes)
        only_feet = self.aim.feet_given and findings.nearest is not None and findings.nearest.at_goal
        if self.status != Status.INFEASIBLE or ground_alone or only_feet:
            return None
        if self.proof is not None and self.proof.proof == FOOT:
            line = np.concatenate([[self.proof.from_start], self.proof.blocked, [self.proof.from_goal]])
            return stopping_limits(self.terrain, self.wider, self.start, self.goal, line)
        seconds = min(BESIDE_CAUSES if causes else REASON_SECONDS, self.seconds - findings.seconds)
        return decisive_limits(self.terrain, self.wider, self.start, self.goal, seconds)

    def _nearest(self, world: World, reached: np.ndarray, ends: float) -> Nearest:
        assert self.reached is not None
        state = self.reached.nearest
        nearer = _nearest_pose(reached, self.goal)
        if self.aim.feet_given and (state[:2] == self.aim.state[:2]).all() and state[3:].any():
            nearer = np.array([*state[:3], 0, 0, 0, 0])  # does the robot get there on other feet?
        elif _distance(nearer, self.goal) >= _distance(state, self.goal) - cells(_NEARER):
            nearer = state
        if nearer is not state:
            # A relaxed problem may reach more than the robot.
            found = solve(
                world, self.start, nearer, geometric_estimate(world, nearer), weight=3.0, admissible=False,
                reopen=False, limits=Limits(expansions=_EXPANSIONS, time=max(ends - now(), 0.0)), paths=False,
            )  # fmt: skip
            if found.status == [Status.SOLVED]:
                state = nearer
        away = metres(float(np.hypot(*(state[:2] - self.aim.state[:2]))))
        turn = 0.0 if self.aim.heading_free else abs(float(heading_angle(state[2] - self.aim.state[2])))
        grid = Grid(self.terrain.origin, self.terrain.shape)
        pose = tuple(float(value) for value in grid.to_world(state))
        return Nearest(pose, away, turn)


def _nearest_pose(headings: np.ndarray, goal: np.ndarray) -> np.ndarray:
    """The pose in reach that is nearest to a goal, on neutral feet, int64 [7]."""
    x, y = np.nonzero(headings)
    bits = headings[x, y][:, None] >> np.arange(HEADINGS, dtype=np.uint64) & np.uint64(1)
    k, h = np.nonzero(bits)
    states = np.column_stack([x[k], y[k], h])
    state = states[np.argmin(_distance(states, goal))]
    return np.array([*state, 0, 0, 0, 0])


def _distance(states: np.ndarray, goal: np.ndarray):
    """Distance (cells) between poses [..., >= 3], a turn as a way."""
    turn = abs(heading_angle(states[..., 2] - goal[2]))
    return np.hypot(states[..., 0] - goal[0], states[..., 1] - goal[1]) + cells(METRES_PER_RADIAN) * turn
