"""Motions: the robot configurations along a plan, their times, and the check that a robot can carry them out.

The check shares no code with the modules that create motions (``refinement``, ``stance``).
"""

from __future__ import annotations

import os
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from hdsp.base.errors import InputError
from hdsp.base.gradual import Steps, finished
from hdsp.base.messages import shown
from hdsp.base.notebook import html_of, png_of
from hdsp.detailed.motion.motion_files import animate_motion, read_motion, save_motion_file
from hdsp.detailed.motion.motion_state import MotionState
from hdsp.detailed.motion.phases import PHASES
from hdsp.detailed.motion.timing import Timing
from hdsp.robot.robot import FEET, Robot
from hdsp.terrain.height_map import HeightMap
from hdsp.terrain.inclination import Inclination, inclination

_EPS = 1e-6
_TOUCH = 1e-4  # m; largest distance between the ground and a carrying foot, from rounding
_BLOCK = 64  # configurations per pass of the clearance check
_DEEPEST = 1.0  # m; depth to which ground columns are sampled, from their tops


@dataclass(frozen=True, eq=False)
class Motion:
    """Configurations from the start of a plan to its goal.

    Convention: metres and radians in the world frame. ``Rz(heading) Ry(pitch) Rx(roll)`` rotates the base frame to the
    world frame: positive roll leans to the right, positive pitch lowers the nose. The base origin lies between the
    hips. Feet are in the order of ``hdsp.robot.robot.FEET``, each as the point where it touches the ground.

    Attributes:
        base: float64 [n, 6]: x, y, z, roll, pitch, heading.
        feet: float64 [n, 4, 3]: x, y, z.
        carries: bool [n, 4], whether a foot stands on the ground.
        action: int64 [n], index of the configuration's action in the plan.
        phase: uint8 [n], index into ``PHASES``.
        terrain, robot: map and robot for the check.
    """

    base: np.ndarray
    feet: np.ndarray
    carries: np.ndarray
    action: np.ndarray
    phase: np.ndarray
    terrain: HeightMap = field(repr=False)
    robot: Robot = field(repr=False)

    def __repr__(self) -> str:
        steps = int((np.diff(self.phase == PHASES.index("lift"), prepend=0) == 1).sum())
        counts = f"{len(self)} configurations, {len(np.unique(self.action))} actions, {steps} of them steps"
        return f"{type(self).__name__}({self.robot.name}: {counts})"

    def _repr_html_(self) -> str | None:
        return html_of(self)

    def _repr_png_(self) -> bytes | None:
        return png_of(self)

    def __len__(self) -> int:
        return len(self.base)

    @cached_property
    def _timing(self) -> Timing:
        return Timing(self.base, self.feet, self.carries, self.robot)

    @property
    def times(self) -> np.ndarray:
        """Times at which the robot passes the configurations, float64 [n], s from the start; they never fall.

        The robot keeps its ``speeds`` and ``accelerations`` (`hdsp.detailed.motion.timing`). The first use computes the
        times.
        """
        return self._timing.times

    @property
    def duration(self) -> float:
        """Time from start to goal, s."""
        return float(self.times[-1])

    def at(self, time: ArrayLike) -> MotionState:
        """Returns the state at one time or at several times.

        Between configurations, the robot moves along straight lines with rounded corners; it passes each configuration
        within 1.5 mm and 3 mrad. While a foot rolls over an edge, its height changes linearly over a map cell.

        Args:
            time: s from the start, any shape, [0, ``duration``].

        Raises:
            InputError: a time before the start or after the end (``numpy.clip(time, 0, motion.duration)`` rests there),
                or no number.
        """
        given = self._numbers(time)
        moments = given.ravel()
        outside = ~((moments >= 0) & (moments <= self.duration))
        if outside.any():
            raise InputError(f"time {moments[outside][0]:g} s: the motion lasts from 0 to {self.duration:.6g} s")
        passed = np.searchsorted(self.times, moments, side="right")
        row = np.where(self.times[passed - 1] == moments, passed - 1, np.minimum(passed, len(self) - 1))
        points, velocities = self._timing(moments)
        base, feet = points[:, :6], points[:, 6:].reshape(-1, 4, 3)
        reached = replace(
            self, base=base, feet=feet, carries=self.carries[row], action=self.action[row], phase=self.phase[row]
        )
        values = (
            moments, base, feet, reached.carries, reached.phase, reached.action, reached.margins(), velocities[:, :6],
            velocities[:, 6:].reshape(-1, 4, 3), row,
        )  # fmt: skip
        return MotionState(*(value.reshape(given.shape + value.shape[1:]) for value in values))

    def _numbers(self, time: ArrayLike) -> np.ndarray:
        """Times as a user gives them, float64 of any shape."""
        try:
            found = np.asarray(time)
            if found.dtype.kind in "iuf":
                return found.astype(float)
        except (TypeError, ValueError, OverflowError):
            pass
        raise InputError(f"time {shown(time)}: need numbers from 0 to {self.duration:.6g} s")

    def save(self, path: str | os.PathLike, rate: float = 50.0) -> Path:
        """Writes the motion, whole or not at all; the suffix names the format (docs/motions.md).

        ``.csv``, ``.json`` and ``.npz`` hold states at regular times, and the last two the configurations, too.
        ``.mcap`` is a recording for Foxglove and other viewers, a path without a suffix a ROS 2 bag, and ``.gif`` or
        ``.mp4`` an animation.

        Args:
            path: file, or folder for a ROS 2 bag.
            rate: states per second; an animation has its own.

        Returns:
            the path.

        Raises:
            InputError: another suffix, a rate out of range, more than 5 million states, a path that cannot be written,
                or a missing extra.
        """
        return save_motion_file(self, path, rate)

    def animate(self, path: str | os.PathLike, speed: float | None = None, fps: float = 12.5, width: int = 720) -> Path:
        """Writes an animation in three dimensions, whole or not at all.

        Args:
            path: ``.gif`` or ``.mp4``.
            speed: motion seconds per animation second; None: at least 1, at most 12 s in all.
            fps: pictures per second, 0.1 to 100.
            width: width in pixels, 64 to 3840; the height follows from the motion.

        Returns:
            the path.

        Raises:
            InputError: another suffix, a value out of range, more than 10,000 pictures, a GIF with more than 1,000
                million pixels, a path that cannot be written, or a missing extra.
        """
        return animate_motion(self, path, speed=speed, fps=fps, width=width)

    @classmethod
    def load(
        cls,
        path: str | os.PathLike,
        terrain: HeightMap | str | os.PathLike | None = None,
        robot: Any = None,
    ) -> Motion:
        """Reads a motion's configurations from ``.npz`` or ``.json``.

        Args:
            path: file from `save`.
            terrain: the map for a JSON file, which holds none: a height map, or the path of one.
            robot: the robot for a JSON file, if it is no preset.

        Raises:
            InputError: no such file, another format, or a JSON file without ``terrain`` or with one that the motion
                leaves.
        """
        return cls(**read_motion(path, terrain, robot))

    def rotations(self) -> np.ndarray:
        """Rotations from the base frame to the world frame, float64 [n, 3, 3]."""
        roll, pitch, heading = self.base[:, 3:].T
        return _about(heading, 2) @ _about(pitch, 1) @ _about(roll, 0)

    def leg_lengths(self) -> np.ndarray:
        """Distances from hip to foot, float64 [n, 4], m."""
        hips = self.base[:, None, :3] + np.einsum("nij,fj->nfi", self.rotations(), self.robot.hips())
        return np.linalg.norm(hips - self.feet, axis=2)

    def centers_of_mass(self) -> np.ndarray:
        """Centres of mass in the world frame, float64 [n, 3], m."""
        stance = self.robot.stance
        return self.base[:, :3] + self.rotations() @ np.array([stance.mass_x, 0.0, stance.mass_z])

    def margins(self) -> np.ndarray:
        """Distances from the centre of mass to the border of the support polygon, seen from above, float64 [n], m.

        The value is positive inside, negative outside, and -inf with fewer than three feet on the ground.
        """
        mass = self.centers_of_mass()[:, :2]
        least = np.full(len(self), np.inf)
        for lifted in (None, 0, 1, 2, 3):
            standing = [i for i in range(4) if i != lifted]
            rows = self.carries[:, standing].all(axis=1)
            if lifted is not None:
                rows &= ~self.carries[:, lifted]
            for a, b in zip(standing, standing[1:] + standing[:1], strict=True):
                edge = self.feet[rows, b, :2] - self.feet[rows, a, :2]
                to_mass = mass[rows] - self.feet[rows, a, :2]
                left = edge[:, 0] * to_mass[:, 1] - edge[:, 1] * to_mass[:, 0]
                least[rows] = np.minimum(least[rows], left / np.linalg.norm(edge, axis=1))
        least[self.carries.sum(axis=1) < 3] = -np.inf
        return least

    def heights_over_ground(self) -> np.ndarray:
        """Heights of the feet above the cells below them, float64 [n, 4], m."""
        return self.feet[..., 2] - self.terrain.height_at(self.feet[..., 0], self.feet[..., 1])

    def swing_clearances(self) -> np.ndarray:
        """Clearances of swinging feet above the highest ground within ``feet.clearance``, float64 [n, 4], m.

        The value is inf for feet that carry, lift or lower. A foot lifts and lowers over its foothold, where no edge is
        within this distance.
        """
        result = np.full(self.carries.shape, np.inf)
        swinging = ~self.carries & (self.phase == PHASES.index("swing"))[:, None]
        reach, cell = self.robot.feet.clearance, self.terrain.resolution
        steps = np.arange(-np.floor(reach / cell), np.floor(reach / cell) + 1) * cell
        around = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
        around = around[np.linalg.norm(around, axis=1) <= reach]
        at = self.feet[swinging]
        heights = self.terrain.height_at(at[:, None, 0] + around[:, 0], at[:, None, 1] + around[:, 1])
        result[swinging] = at[:, 2] - np.where(np.isnan(heights), np.inf, heights).max(axis=1)
        return result

    def inclinations(self) -> Inclination:
        """Ground under the feet in its steepest direction, arrays [4 n] in configuration order, then feet."""
        origin, cell = np.array(self.terrain.origin), self.terrain.resolution
        centers = origin + (np.floor((self.feet[..., :2] - origin) / cell) + 0.5) * cell
        headings = np.repeat(self.base[:, 5], 4)
        return inclination(self.terrain.height_at, centers.reshape(-1, 2), headings, self.robot, cell)

    def body_penetrations(self) -> np.ndarray:
        """Depths by which the ground reaches into the body, float64 [n], m; 0 without contact.

        Unknown ground does not count.
        """
        return finished(self._penetration_steps())

    def _penetration_steps(self) -> Steps[np.ndarray]:
        moved = np.concatenate([[True], (np.diff(self.base, axis=0) != 0).any(axis=1)])  # the base rests during a step
        shown = np.flatnonzero(moved)
        deepest = []
        for k in range(0, len(shown), _BLOCK):
            deepest.append(self._penetrations(shown[k : k + _BLOCK]))
            yield
        return np.concatenate(deepest)[np.cumsum(moved) - 1]

    def _penetrations(self, rows: np.ndarray) -> np.ndarray:
        boxes, cell, stance = self.robot.body.boxes, self.terrain.resolution, self.robot.stance
        under = np.array([box.above for box in boxes]) - stance.base_height
        leaning = abs(under).max() * (stance.max_roll + stance.max_pitch)
        reach = int(np.ceil((max(np.hypot(max(-b.x_min, b.x_max), b.half_width) for b in boxes) + leaning) / cell))
        base, turned = self.base[rows, :3], self.rotations()[rows]
        near = np.stack(np.meshgrid(*2 * [np.arange(-reach, reach + 1)]), axis=-1).reshape(-1, 2)
        place = np.floor((base[:, :2] - self.terrain.origin) / cell).astype(int)[:, None] + near
        cells = (place + 0.5) * cell + self.terrain.origin
        inside = ((place >= 0) & (place < self.terrain.shape)).all(axis=2)
        place[~inside] = 0
        heights = self.terrain.heights[place[..., 0], place[..., 1]]
        heights = np.where(inside & ~np.isnan(heights), heights, -np.inf)
        # Only ground above the plane of the lowest box matters; its columns are sampled from the top down.
        up = turned[:, :, 2]
        plane = (under.min() - (cells - base[:, None, :2]) @ up[:, :2, None])[..., 0] / up[:, 2:]
        row, column = np.nonzero(heights - base[:, 2:] > plane)
        top, floor = heights[row, column] - base[row, 2], plane[row, column]
        deepest = np.zeros(len(base))
        for share in np.linspace(0, 1, 8):
            height = top + share * np.maximum(floor - top, -_DEEPEST)
            points = np.concatenate([cells[row, column] - base[row, :2], height[:, None]], axis=1)
            inside = np.einsum("nij,ni->nj", turned[row], points)
            for box, lower in zip(boxes, under, strict=True):
                hit = (box.x_min < inside[:, 0]) & (inside[:, 0] < box.x_max) & (abs(inside[:, 1]) < box.half_width)
                np.maximum.at(deepest, row, np.where(hit, inside[:, 2] - lower, 0.0))
        return deepest

    def problems(self) -> list[tuple[int, str]]:
        """Returns all violations as (configuration, text), in motion order; empty for a feasible motion.

        The check covers every configuration: the centre of mass lies inside the support polygon by the margin; leg
        lengths, roll and pitch are within their limits; carrying feet are on the ground, which is no steeper than the
        robot's limit, and no foot is below it; swinging feet and the body are clear of the ground.
        """
        return finished(self.problem_steps())

    def problem_steps(self) -> Steps[list[tuple[int, str]]]:
        """Like `problems`, in short steps."""
        s, legs = self.robot.stance, self.robot.legs
        found: list[tuple[int, str]] = []

        def report(wrong: np.ndarray, words) -> None:
            for place in np.argwhere(wrong):
                found.append((int(place[0]), words(*place)))

        margins, lengths, over = self.margins(), self.leg_lengths(), self.heights_over_ground()
        clearances = self.swing_clearances()
        depths = yield from self._penetration_steps()
        report(
            ~(margins >= s.margin - _EPS),
            lambda n: f"the centre of mass is {margins[n]:.3f} m inside the support polygon; {s.margin:g} m are needed",
        )
        report(
            ~((lengths >= legs.min_length - _EPS) & (lengths <= legs.max_length + _EPS)),
            lambda n, i: (
                f"the {FEET[i]} leg would be {lengths[n, i]:.3f} m long; "
                f"{legs.min_length:g} to {legs.max_length:g} m are possible"
            ),
        )
        report(~(over >= -_TOUCH), lambda n, i: f"the {FEET[i]} foot is {-over[n, i]:.3f} m below the ground")
        report(
            self.carries & (over > _TOUCH),
            lambda n, i: f"the {FEET[i]} foot carries, but is {over[n, i]:.3f} m above the ground",
        )
        under = self.inclinations()
        degrees, limits = (np.degrees(angles).reshape(-1, 4) for angles in (under.angle, under.limit))
        report(
            self.carries & under.too_steep.reshape(-1, 4),
            lambda n, i: (
                f"the ground under the {FEET[i]} foot is steeper than {limits[n, i]:.1f} degrees: {degrees[n, i]:.1f}"
            ),
        )
        report(
            ~(clearances >= s.swing_clearance - _EPS),
            lambda n, i: f"the {FEET[i]} foot swings {clearances[n, i]:.3f} m above what lies on its way",
        )
        report(depths > _TOUCH, lambda n: f"the ground reaches {depths[n]:.3f} m into the body")
        leans = (abs(self.base[:, 3]) > s.max_roll + _EPS) | (abs(self.base[:, 4]) > s.max_pitch + _EPS)
        report(leans, lambda n: f"the base leans by {self.base[n, 3]:.2f} rad to the side, {self.base[n, 4]:.2f} ahead")
        return sorted(found, key=lambda item: item[0])

    def check(self) -> list[str]:
        """Returns ``problems`` as text lines, each with the action."""
        return [f"action {self.action[n]}, {PHASES[self.phase[n]]}: {words}" for n, words in self.problems()]


def _about(angles: np.ndarray, axis: int) -> np.ndarray:
    """Rotations about an axis, counter-clockwise seen from the axis tip, float64 [n, 3, 3]."""
    one, other = (axis + 1) % 3, (axis + 2) % 3
    turned = np.zeros((len(angles), 3, 3))
    turned[:, axis, axis] = 1
    turned[:, one, one] = turned[:, other, other] = np.cos(angles)
    turned[:, one, other], turned[:, other, one] = -np.sin(angles), np.sin(angles)
    return turned
