"""Motions: what a robot does to follow a plan, configuration by configuration, and the check that it can.

A motion says nothing about time. The check shares no code with what makes motions (``refine``, ``stance``).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from hdsp.robot.robot import FEET, Robot
from hdsp.terrain.height_map import HeightMap

#: What a configuration is part of. ``roll``: all feet on the ground, driving, turning or moving under the base;
#: ``lean``: the base moves over resting feet; the others are those of a step.
PHASES = ("roll", "lean", "lift", "swing", "lower")

_EPS = 1e-6
_TOUCH = 1e-4  # m; how far a foot that carries may be off the ground by rounding
_BLOCK = 256  # configurations whose clearance is checked at a time
_DEEPEST = 1.0  # m; how far below their tops columns of ground are looked at


@dataclass(frozen=True, eq=False)
class Motion:
    """Configurations from the start of a plan to its goal.

    Convention: metres and radians in the world frame; ``Rz(heading) Ry(pitch) Rx(roll)`` takes the frame of the base to
    the world, so positive roll leans to the right and positive pitch lowers the nose. The origin of the base lies
    between its hips. Feet in the order of ``hdsp.robot.robot.FEET``, each the point where it touches the ground.

    Attributes:
        base: float64 [n, 6]: x, y, z, roll, pitch, heading.
        feet: float64 [n, 4, 3]: x, y, z.
        carries: bool [n, 4], which feet stand on the ground.
        action: int64 [n], the action of the plan that a configuration belongs to.
        phase: uint8 [n], index into ``PHASES``.
    """

    base: np.ndarray
    feet: np.ndarray
    carries: np.ndarray
    action: np.ndarray
    phase: np.ndarray
    terrain: HeightMap = field(repr=False)
    robot: Robot = field(repr=False)

    def __len__(self) -> int:
        return len(self.base)

    def rotations(self) -> np.ndarray:
        """Frame of the base to the world, float64 [n, 3, 3]."""
        roll, pitch, heading = self.base[:, 3:].T
        return _about(heading, 2) @ _about(pitch, 1) @ _about(roll, 0)

    def leg_lengths(self) -> np.ndarray:
        """From hip to foot, float64 [n, 4], m."""
        hips = self.base[:, None, :3] + np.einsum("nij,fj->nfi", self.rotations(), self.robot.hips())
        return np.linalg.norm(hips - self.feet, axis=2)

    def centers_of_mass(self) -> np.ndarray:
        """World positions, float64 [n, 3], m."""
        stance = self.robot.stance
        return self.base[:, :3] + self.rotations() @ np.array([stance.mass_x, 0.0, stance.mass_z])

    def margins(self) -> np.ndarray:
        """How far the centre of mass is inside the polygon of the feet that carry, seen from above, float64 [n], m;
        negative outside."""
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
        """Of the feet above the cell that each is over, float64 [n, 4], m."""
        return self.feet[..., 2] - self.terrain.height_at(self.feet[..., 0], self.feet[..., 1])

    def swing_clearances(self) -> np.ndarray:
        """Of feet in the air above the highest ground within ``feet.clearance`` around them, float64 [n, 4], m; inf for
        feet that carry. Feet that are lifted or lowered stay over their foothold, where no edge is that near."""
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

    def body_penetrations(self) -> np.ndarray:
        """How deep ground reaches into the body, float64 [n], m; 0 where they do not touch. Unknown ground does not
        count."""
        moved = np.concatenate([[True], (np.diff(self.base, axis=0) != 0).any(axis=1)])  # a step keeps the base still
        shown = np.flatnonzero(moved)
        deepest = [self._penetrations(shown[k : k + _BLOCK]) for k in range(0, len(shown), _BLOCK)]
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
        # Only ground above the plane of the lowest box matters; its columns are looked at from the top down.
        up = turned[:, :, 2]
        plane = (under.min() - (cells - base[:, None, :2]) @ up[:, :2, None])[..., 0] / up[:, 2:]
        row, near = np.nonzero(heights - base[:, 2:] > plane)
        top, floor = heights[row, near] - base[row, 2], plane[row, near]
        deepest = np.zeros(len(base))
        for share in np.linspace(0, 1, 8):
            height = top + share * np.maximum(floor - top, -_DEEPEST)
            points = np.concatenate([cells[row, near] - base[row, :2], height[:, None]], axis=1)
            inside = np.einsum("nij,ni->nj", turned[row], points)
            for box, lower in zip(boxes, under, strict=True):
                hit = (box.x_min < inside[:, 0]) & (inside[:, 0] < box.x_max) & (abs(inside[:, 1]) < box.half_width)
                np.maximum.at(deepest, row, np.where(hit, inside[:, 2] - lower, 0.0))
        return deepest

    def problems(self) -> list[tuple[int, str]]:
        """What is wrong, as (configuration, in words), in their order; empty for a motion that can be carried out.

        Every configuration is checked: centre of mass inside the support polygon by the margin, legs within their
        limits, feet that carry on the ground and none below it, a swinging foot and the body clear of the ground, roll
        and pitch within their limits.
        """
        s, legs = self.robot.stance, self.robot.legs
        found: list[tuple[int, str]] = []

        def report(wrong: np.ndarray, words) -> None:
            for place in np.argwhere(wrong):
                found.append((int(place[0]), words(*place)))

        margins, lengths, over = self.margins(), self.leg_lengths(), self.heights_over_ground()
        clearances, depths = self.swing_clearances(), self.body_penetrations()
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
        report(
            ~(clearances >= s.swing_clearance - _EPS),
            lambda n, i: f"the {FEET[i]} foot swings {clearances[n, i]:.3f} m above what lies on its way",
        )
        report(depths > _TOUCH, lambda n: f"the ground reaches {depths[n]:.3f} m into the body")
        leans = (abs(self.base[:, 3]) > s.max_roll + _EPS) | (abs(self.base[:, 4]) > s.max_pitch + _EPS)
        report(leans, lambda n: f"the base leans by {self.base[n, 3]:.2f} rad to the side, {self.base[n, 4]:.2f} ahead")
        return sorted(found, key=lambda item: item[0])

    def check(self) -> list[str]:
        """``problems`` as lines of text that name the action."""
        return [f"action {self.action[n]}, {PHASES[self.phase[n]]}: {words}" for n, words in self.problems()]


def _about(angles: np.ndarray, axis: int) -> np.ndarray:
    """Rotations about an axis, counter-clockwise seen from its end, float64 [n, 3, 3]."""
    one, other = (axis + 1) % 3, (axis + 2) % 3
    turned = np.zeros((len(angles), 3, 3))
    turned[:, axis, axis] = 1
    turned[:, one, one] = turned[:, other, other] = np.cos(angles)
    turned[:, one, other], turned[:, other, one] = -np.sin(angles), np.sin(angles)
    return turned
