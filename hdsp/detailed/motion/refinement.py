"""From a plan to a motion: base over the feet, heights, swing of stepping feet.

As in the paper, refinement concerns the steps of a plan: stability and the way of the foot. While all feet roll, the
base stays over its planned position and leans with the ground (`hdsp.detailed.base_pose`), as far as its balance
allows. For a step, the base shifts, leans and rolls until its centre of mass is inside the triangle between the other
feet. The foot rises straight up, swings over the highest ground on its way, and sinks straight down.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from hdsp.base.errors import RefinementError
from hdsp.base.gradual import Steps, finished
from hdsp.detailed.actions.action import Action, ActionKind
from hdsp.detailed.actions.state_costs import foot_row
from hdsp.detailed.base_pose import base_poses
from hdsp.detailed.motion.motion import PHASES, Motion
from hdsp.detailed.motion.stance import (
    FOUND,
    OUT_OF_REACH,
    UNBALANCED,
    Ground,
    all_clear,
    find_stance,
    limits_of,
    resting_stances,
)
from hdsp.detailed.world.world import World, cell_index
from hdsp.robot.lattice import RESOLUTION, Grid, metres
from hdsp.robot.robot import FEET, Robot
from hdsp.terrain.height_map import HeightMap

_STRIDE = RESOLUTION  # m; largest movement of a foot or the base between two configurations
_LEAN = 0.05  # rad; largest rotation of the base meanwhile
_ABOVE = 0.002  # m; additional clearance for a swinging foot

ROLL, LEAN, LIFT, SWING, LOWER = range(len(PHASES))


def refine(terrain: HeightMap, robot: Robot, states: np.ndarray, actions: Sequence[Action]) -> Motion:
    """Returns the motion that carries out a plan; its check finds no problem.

    Args:
        terrain: the map under the plan.
        robot: the robot that follows the plan.
        states: float64 [n, 7], world coordinates.
        actions: the n - 1 actions between the states.

    Raises:
        RefinementError: the robot cannot carry out an action; the message names the action and the reason.
    """
    return finished(refine_steps(terrain, robot, states, actions))


def refine_steps(terrain: HeightMap, robot: Robot, states: np.ndarray, actions: Sequence[Action]) -> Steps[Motion]:
    """Like `refine`, in short steps."""
    return _Refinement(terrain, robot, np.asarray(states, float), actions).steps()


def last_step(actions: Sequence[Action], before: int) -> int | None:
    """Number of the last step among actions 0 to ``before``, inclusive; None without a step.

    This step is to blame for an impossible action.
    """
    return next((k for k in range(before, -1, -1) if actions[k].kind is ActionKind.STEP), None)


def ban(banned: np.ndarray, world: World, grid: Grid, state: np.ndarray, step: Action) -> np.ndarray:
    """Adds a step to ``World.banned``, the steps closed to a search.

    The ban covers the step with the present feet. If the same foot fails again at the same place, the ban covers feet
    within 1, then 2, 4, ... cells around the present ones. Otherwise, searches would try them one by one.

    Args:
        banned: int64 [n, 7], steps banned before.
        world: terrain and robot, compiled.
        grid: place of the terrain in the world.
        state: float64 [7], world coordinates, before the step.
        step: the step.
    """
    ix, iy, heading, *offsets = (int(v) for v in grid.to_lattice(state[:3], state[3:]))
    foot = step.stepping_foot
    assert foot is not None
    row = foot_row(world.tables, heading, foot, offsets[foot] - world.tables.lowest)
    cell = int(cell_index(world, ix, iy)) + int(world.tables.feet[row])
    again = int((banned[:, :3] == (foot, cell, heading)).all(axis=1).sum())
    ahead = [offsets[(foot + j) % 4] - offsets[foot] for j in (1, 2, 3)]
    return np.concatenate([banned, np.array([[foot, cell, heading, *ahead, 1 << again >> 1]], dtype=np.int64)])


class _Refinement:
    """One plan on its way to a motion; ``parts`` collects its configurations."""

    def __init__(self, terrain: HeightMap, robot: Robot, states: np.ndarray, actions: Sequence[Action]):
        self.terrain, self.robot, self.states, self.actions = terrain, robot, states, actions
        self.limits = limits_of(robot)
        self.ground = Ground(terrain.heights, *terrain.origin, terrain.resolution)
        self.feet = self._on_ground(robot.foot_positions(states))
        self.wanted = self._wanted()
        self.parts: list[tuple] = []

    def steps(self) -> Steps[Motion]:
        lacking, resting = resting_stances(self.limits, self.ground, self.states[:, :3].copy(), self.feet, self.wanted)
        stances = np.concatenate([resting, self.states[:, 2:3]], axis=1)
        stances[:, 5] = np.unwrap(stances[:, 5])
        if (lacking != FOUND).any():
            first = int(np.flatnonzero(lacking != FOUND)[0])
            raise self._refusal(first - 1, f"on four feet, {self._why(lacking[first], 'the feet')}")
        self._add(0, ROLL, stances[:1], self.feet[:1])
        for k, action in enumerate(self.actions):
            if (foot := action.stepping_foot) is not None:
                self._step(k, foot, stances[k], stances[k + 1])
            else:
                self._roll(k, stances[k], stances[k + 1])
            yield
        motion = self._joined()
        problems = yield from motion.problem_steps()
        for configuration, words in problems:
            raise self._refusal(int(motion.action[configuration]), words)
        return motion

    def _step(self, k: int, foot: int, before: np.ndarray, after: np.ndarray) -> None:
        feet, landed = self.feet[k], self.feet[k + 1]
        top = self._highest_between(feet[foot], landed[foot]) + self.robot.stance.swing_clearance + _ABOVE
        raised, over = np.array([*feet[foot, :2], top]), np.array([*landed[foot, :2], top])
        ways = [_line(feet[foot], raised), _line(raised, over), _line(over, landed[foot])]
        wanted = 0.5 * (self.wanted[k] + self.wanted[k + 1])
        x, y, heading = self.states[k, :3]
        found = find_stance(self.limits, self.ground, x, y, heading, feet, foot, np.concatenate(ways), wanted)
        if found[0] != FOUND:
            raise self._refusal(k, self._why(found[0], f"the {FEET[foot]} foot in the air"))
        stance = np.array([*found[1:], before[5]])
        self._lean(k, before, stance, feet)
        for phase, way in zip((LIFT, SWING, LOWER), ways, strict=True):
            placed = np.repeat(feet[None], len(way), axis=0)
            placed[:, foot] = way
            self._add(k, phase, np.repeat(stance[None], len(way), axis=0), placed, lifted=foot)
        self._add(k, LEAN, stance[None], landed[None])
        self._lean(k, stance, after, landed)

    def _lean(self, k: int, before: np.ndarray, after: np.ndarray, feet: np.ndarray) -> None:
        n = max(1, int(np.ceil(max(abs(after - before)[:3].max() / _STRIDE, abs(after - before)[3:].max() / _LEAN))))
        stances = before + np.linspace(0, 1, n + 1)[1:, None] * (after - before)
        self._add(k, LEAN, stances, np.repeat(feet[None], n, axis=0))

    def _roll(self, k: int, before: np.ndarray, after: np.ndarray) -> None:
        if self._rolled(k, before, after):
            return
        # The ground between two states reaches higher than at both: the base rises first and sinks last.
        above, over = before.copy(), after.copy()
        above[2] = over[2] = max(before[2], after[2])
        if above[2] > before[2]:
            self._lean(k, before, above, self.feet[k])
        self._rolled(k, above, over, always=True)
        if over[2] > after[2]:
            self._lean(k, over, after, self.feet[k + 1])

    def _rolled(self, k: int, before: np.ndarray, after: np.ndarray, always: bool = False) -> bool:
        """Adds the configurations between two stances if the base is clear in each of them, or always."""
        far = np.linalg.norm((self.feet[k + 1] - self.feet[k])[:, :2], axis=1).max()
        leaning = abs(after - before)
        n = max(1, int(np.ceil(max(far / _STRIDE, leaning[:3].max() / _STRIDE, leaning[3:].max() / _LEAN) - 1e-9)))
        t = np.linspace(0, 1, n + 1)[1:, None]
        stances = before + t * (after - before)
        if not always and not all_clear(self.limits.boxes, self.ground, stances):
            return False
        state = self.states[k] + t * (self.states[k + 1] - self.states[k])
        state[:, 2] = self.states[k, 2] + t[:, 0] * (after[5] - before[5])
        self._add(k, ROLL, stances, self._on_ground(self.robot.foot_positions(state)))
        return True

    def _add(self, k: int, phase: int, stances: np.ndarray, feet: np.ndarray, lifted: int | None = None) -> None:
        carries = np.ones((len(stances), 4), bool)
        if lifted is not None:
            carries[:, lifted] = False
        self.parts.append((stances, feet, carries, np.full(len(stances), k), np.full(len(stances), phase, np.uint8)))

    def _joined(self) -> Motion:
        base, feet, carries, action, phase = (np.concatenate(part) for part in zip(*self.parts, strict=True))
        return Motion(base, feet, carries, action, phase, self.terrain, self.robot)

    def _wanted(self) -> np.ndarray:
        """Most comfortable height (m), roll and pitch (rad) in each state, float64 [n, 3]: those of the base pose."""
        wanted = base_poses(self.robot, self.states[:, 3:], self.feet[..., 2])
        # The base height counts at right angles to the ground of the base.
        wanted[:, 0] += self.robot.stance.base_height / np.cos(wanted[:, 1]) / np.cos(wanted[:, 2])
        return wanted

    def _highest_between(self, start: np.ndarray, end: np.ndarray) -> float:
        """Highest known ground (m) within a foot's clearance around its way; plans never step over unknown ground."""
        reach = self.robot.feet.clearance
        n = int(np.ceil(np.linalg.norm((end - start)[:2]) / metres(0.5))) + 1
        line = start[:2] + np.linspace(0, 1, n)[:, None] * (end - start)[:2]
        steps = np.arange(-reach, reach + metres(0.5), metres(0.5))
        around = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
        around = around[np.linalg.norm(around, axis=1) <= reach + 1e-9]
        heights = self.terrain.height_at(line[:, None, 0] + around[:, 0], line[:, None, 1] + around[:, 1])
        return float(np.nanmax(heights))

    def _on_ground(self, xy: np.ndarray) -> np.ndarray:
        """Foot positions [..., 3] on the ground at (x, y) [..., 2]."""
        heights = np.asarray(self.terrain.height_at(xy[..., 0], xy[..., 1]), float)
        return np.concatenate([xy, heights[..., None]], axis=-1)

    def _why(self, lacking: int, with_what: str) -> str:
        stance, legs = self.robot.stance, self.robot.legs
        if lacking == UNBALANCED:
            return f"no position of the base keeps its centre of mass {stance.margin:g} m inside the support polygon"
        if lacking == OUT_OF_REACH:
            return (
                f"with {with_what}, no balanced position of the base is within reach of all legs "
                f"({legs.min_length:g} to {legs.max_length:g} m)"
            )
        return "wherever the base is balanced and the legs reach, the body touches the ground"

    def _refusal(self, k: int, why: str) -> RefinementError:
        x, y = self.states[max(k, 0), :2]
        what = str(self.actions[k]) if k >= 0 else "the start"
        return RefinementError(k, f"{what} at ({x:.2f}, {y:.2f}) m cannot be carried out: {why}")


def _line(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Points between ``start`` (exclusive) and ``end`` (inclusive), float64 [n, 3]."""
    n = max(1, int(np.ceil(np.linalg.norm(end - start) / _STRIDE - 1e-9)))
    return start + np.linspace(0, 1, n + 1)[1:, None] * (end - start)
