"""Drives along a motion in the simulation, watches for faults, and records all states."""

from __future__ import annotations

from typing import Any

import numpy as np

from hdsp.detailed.motion.local_motion import local_place, relative
from hdsp.detailed.motion.motion import Motion
from hdsp.detailed.motion.phases import PHASES
from hdsp.planning.arguments import whole
from hdsp.planning.driving.driven_run import DrivenMotion, Ending, Run, checked_ground
from hdsp.planning.driving.follower import Follower
from hdsp.planning.driving.reference import Reference
from hdsp.planning.driving.simulated_robot import SimulatedRobot
from hdsp.robot.robot import FEET
from hdsp.terrain.height_map import HeightMap
from hdsp.terrain.obstacles import Scene

#: Largest distance and turn from the goal for a drive that arrived, m and rad.
ARRIVAL = 0.1, np.radians(10)
#: Largest slip of a standing foot, m.
SLIP = 0.05
_STEPS = 3  # of the simulation for each control
_RECORDED = 0.02  # s, between two recorded states
_DROP = 0.003  # m, above the ground at the start
_SETTLE, _REST = 0.3, 0.6  # s, before the motion begins and after its end
_TILT = 0.35  # rad, beyond the planned lean
_MISSED = 0.06  # m, below the planned ground
_OFF_PLAN = 0.25  # m
_SATURATED = 0.5  # s, of a motor at its limit
_LONGEST = 3.0, 15.0  # times the motion's duration, and s more


def drive(motion: Motion, terrain: Any = None, seed: int = 0) -> Run:
    """Drives along a motion.

    Args:
        motion: the motion.
        terrain: the true ground, a HeightMap, a Scene or an Arena; None: the motion's own map.
        seed: seed for the noise of the measured pose.

    Raises:
        InputError: MuJoCo or quadprog is missing, the terrain is something else, or the seed is no whole number >= 0.
    """
    ground = checked_ground(motion.terrain if terrain is None else terrain)
    return _Drive(motion, ground, whole("seed", seed)).run()


class _Drive:
    """One drive: simulation, follower, watch and record."""

    def __init__(self, motion: Motion, ground: HeightMap | Scene, seed: int):
        self._planned, self._ground, self._origin = motion, ground, local_place(motion.terrain)
        self._motion = motion = relative(motion, self._origin)
        self._sim = sim = SimulatedRobot(motion.robot, ground, self._origin)
        self._reference = Reference(motion, sim.size.radius)
        self._place()
        self._follower = Follower(sim, self._reference, np.random.default_rng(seed))
        self._period = _STEPS * sim.time_step
        self._time, self._energy, self._margin = 0.0, 0.0, np.inf
        self._anchors = np.full((4, 3), np.nan)
        self._slip, self._full = np.zeros(4), 0.0
        self._rows: list[tuple[Any, ...]] = []

    def _place(self) -> None:
        """Places the robot so that no wheel is in the ground."""
        base, feet, lowest = self._motion.base[0].copy(), self._reference.feet[0].copy(), self._motion.feet[0]
        highest, (x, y) = _DROP, (feet[:, :2] + self._origin).T
        if isinstance(self._ground, HeightMap):
            true = np.asarray(self._ground.height_at(x, y), float)
        else:
            true = self._ground.heights_at(x, y).astype(float)
        highest += float(np.nan_to_num(true - lowest[:, 2]).max())
        base[2] += highest
        feet[:, 2] += highest
        self._sim.place(base, feet)

    def run(self) -> Run:
        """Drives until the end or a fault."""
        longest = _LONGEST[0] * self._motion.duration + _LONGEST[1]
        settled, rested, ending, cause = 0.0, 0.0, None, ""
        while ending is None:
            self._follower.control(self._period, hold=settled < _SETTLE)
            settled += self._period
            for _ in range(_STEPS):
                self._sim.step()
                self._energy += self._sim.motor_power() * self._sim.time_step
            self._time += self._period
            ending, cause = self._watch()
            if ending is None and self._time > longest:
                ending, cause = Ending.OUT_OF_TIME, f"not at the goal after {longest:.0f} s"
            if self._follower.done:
                rested += self._period
                if rested > _REST and ending is None:
                    ending, cause = self._arrival()
        return self._run(ending, cause)

    def _watch(self) -> tuple[Ending | None, str]:
        """Looks for faults, and records."""
        sim, follower = self._sim, self._follower
        forces, touched = sim.contacts()
        feet = sim.feet()
        if self._time >= len(self._rows) * _RECORDED - 1e-9:
            self._record(forces, feet)
        if touched:
            return Ending.BODY_TOUCHED, f"the body touched the ground {self._where()}"
        planned, rotation = follower.wanted, sim.rotation()
        lean = np.arccos(np.clip(rotation[2, 2], -1, 1))
        if lean > np.hypot(*planned.base[3:5]) + _TILT:
            return Ending.TIPPED_OVER, f"the robot tipped over {self._where()}"
        self._watch_slip(feet)
        if self._slip.max() > SLIP:
            foot = FEET[int(self._slip.argmax())].replace("_", " ")
            return Ending.SLIPPED, f"the {foot} foot slipped by more than {SLIP:g} m {self._where()}"
        if follower.feeling.max() > _MISSED:
            foot = FEET[int(follower.feeling.argmax())].replace("_", " ")
            return Ending.FOOT_MISSED, f"the {foot} foot found no ground {self._where()}"
        off = float(np.linalg.norm(planned.base[:2] - sim.base_place()[:2]))
        if off > _OFF_PLAN:
            return Ending.LEFT_PLAN, f"the robot was {off:.2f} m away from the motion {self._where()}"
        full = sim.saturated()
        self._full = self._full + self._period if full else 0.0
        if self._full > _SATURATED:
            return Ending.FORCE_LIMIT, f"a motor was at its limit for {_SATURATED:g} s {self._where()}"
        return None, ""

    def _watch_slip(self, feet: np.ndarray) -> None:
        standing = self._follower.standing
        begins = standing & np.isnan(self._anchors[:, 0])
        self._anchors[begins] = feet[begins]
        self._anchors[~standing] = np.nan
        moved = np.linalg.norm((feet - self._anchors)[:, :2], axis=1)
        self._slip = np.fmax(self._slip, moved)

    def _record(self, forces: np.ndarray, feet: np.ndarray) -> None:
        sim, follower = self._sim, self._follower
        base = np.concatenate([sim.base_place(), _angles(sim.rotation())])
        carries = follower.load > 0.5
        self._rows.append(
            (self._time, base, feet.copy(), carries, *follower.labels, follower.time, forces, sim.data.qpos.copy())
        )
        center = sim.center_of_mass()[:2]
        self._margin = min(self._margin, _inside(feet[carries, :2], center))

    def _arrival(self) -> tuple[Ending, str]:
        distance, turn = self._from_goal()
        words = f"{100 * distance:.1f} cm and {np.degrees(turn):.1f} degrees from the goal"
        if distance <= ARRIVAL[0] and turn <= ARRIVAL[1]:
            return Ending.ARRIVED, f"arrived {words}"
        return Ending.LEFT_PLAN, f"ended {words}"

    def _from_goal(self) -> tuple[float, float]:
        goal, rotation = self._motion.base[-1], self._sim.rotation()
        heading = np.arctan2(rotation[1, 0], rotation[0, 0])
        turn = abs((goal[5] - heading + np.pi) % (2 * np.pi) - np.pi)
        return float(np.linalg.norm(goal[:2] - self._sim.base_place()[:2])), float(turn)

    def _where(self) -> str:
        phase, action = self._follower.labels
        x, y = self._sim.base_place()[:2] + self._origin
        return f"at ({x:.2f}, {y:.2f}) m, in action {action} ({PHASES[phase]})"

    def _run(self, ending: Ending, cause: str) -> Run:
        moments, base, feet, carries, phase, action, progress, forces, positions = (
            np.array(values) for values in zip(*self._rows, strict=True)
        )
        base[:, 3:] = np.unwrap(base[:, 3:], axis=0)
        base[:, :2] += self._origin
        feet[..., :2] += self._origin
        plan = self._planned
        driven = DrivenMotion(
            base, feet, carries, action, phase.astype(np.uint8), plan.terrain, plan.robot, moments - moments[0]
        )
        distance, turn = self._from_goal()
        return Run(
            ending, cause, driven, plan, progress, forces, self._slip, self._margin, self._energy, distance, turn,
            self._ground, positions.astype(np.float32), self._origin,
        )  # fmt: skip


def _angles(rotation: np.ndarray) -> np.ndarray:
    """Roll, pitch and heading."""
    return np.array([
        np.arctan2(rotation[2, 1], rotation[2, 2]), -np.arcsin(np.clip(rotation[2, 0], -1, 1)),
        np.arctan2(rotation[1, 0], rotation[0, 0]),
    ])  # fmt: skip


def _inside(feet: np.ndarray, point: np.ndarray) -> float:
    """Distance from a point to the nearest edge of a polygon in counter-clockwise order, m; negative outside."""
    edges = np.roll(feet, -1, axis=0) - feet
    left = edges[:, 0] * (point - feet)[:, 1] - edges[:, 1] * (point - feet)[:, 0]
    return float((left / np.linalg.norm(edges, axis=1)).min())
