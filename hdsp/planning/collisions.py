"""An independent check of plans: collisions with the true arena, without height map or planner.

The robot moves along the plan in small increments. At each pose, the check tests body boxes against the arena's faces
by the separating axes of their outlines. It tests feet by their distance to higher ground, by the ground around them,
and by its inclination. A swinging foot is tested at its landing only.

The base leans with the plane through the ground under its feet, up to the robot's steepest slope
(`hdsp.detailed.base_pose` defines the pose, and this check computes it again).

Convention: world coordinates, m, rad; feet in the order of `hdsp.robot.robot.FEET`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hdsp.base.errors import InputError
from hdsp.base.short_repr import short_repr
from hdsp.detailed.actions.action import Action
from hdsp.robot.lattice import metres
from hdsp.robot.robot import FEET, Robot
from hdsp.robot.shape import Box
from hdsp.terrain.arenas import Arena
from hdsp.terrain.inclination import inclination
from hdsp.terrain.obstacles import Block, Face, TiltedGround
from hdsp.terrain.rounding import height_tolerance

if TYPE_CHECKING:
    from hdsp.planning.answers.plans import Plan

#: A foot is a disc of this radius, m.
FOOT_RADIUS = 0.05

#: Uncertainty of an edge on a map with cells, m: a cell is as high as its centre, so an obstacle may extend half a cell
#: further than on the map. The tolerance does not cover the planner's own tests at cell centres: its margin
#: (``hdsp.planning.margin.with_margin``) and the clearance of feet cover them.
CELL_TOLERANCE = metres(0.5)

_INCREMENT = 0.01  # m between two tested poses
_LONGEST_ACTION = 0.4  # m; a longer gap between two states is no motion
_BESIDE = 0.001  # m; a point this far outside a block lies on the ground before it
_RIM = np.linspace(0, 2 * math.pi, 32, endpoint=False)


class Collision(NamedTuple):
    """A collision: number of the state before it, robot part, reason, and depth (m)."""

    state: int
    part: str
    why: str
    depth: float


@dataclass(frozen=True)
class PlanCheck:
    """Result of the check.

    Attributes:
        collisions: deepest collision for each pair of robot part and obstacle.
        body_clearance: least horizontal distance between the body and obstacles at its height, m; negative in a
            collision.
        foot_clearance: the same for the rims of the feet.
        poses: number of tested poses.
    """

    collisions: list[Collision]
    body_clearance: float
    foot_clearance: float
    poses: int

    def __repr__(self) -> str:
        return short_repr(self)

    @property
    def free(self) -> bool:
        return not self.collisions


def check_plan(arena: Arena, plan: Plan, robot: Robot, tolerance: float = CELL_TOLERANCE) -> PlanCheck:
    """Tests a plan against the blocks in an arena.

    Args:
        arena: the true arena.
        plan: with `states` [n, 7] in world coordinates and n - 1 `actions`.
        robot: its boxes, feet, steepest slope, and the largest edge for its wheels.
        tolerance: ignored depth, m. A planner knows the place of an edge to half a cell at best.

    Raises:
        InputError: the plan has no states, or jumps.
    """
    states = np.asarray(plan.states, float).reshape(-1, 7)
    if len(states) == 0:
        raise InputError("check of a plan: it has no states")
    number, poses = _poses(states, plan.actions)
    blocks = arena.blocks()
    feet = _feet(poses, robot)
    ground = arena.scene.heights_at(feet[..., 0], feet[..., 1]).astype(float)
    planes = _planes(poses, ground, robot)
    body = [_body_gaps(poses, planes, box, arena, blocks) for box in robot.body.boxes]
    found = _Findings(number, tolerance)
    for gaps in body:
        found.add(gaps, "body", blocks)
    lowest_foot_gap = np.inf
    limit = robot.drive.highest_edge
    for foot, name in enumerate(FEET):
        gaps = _foot_gaps(arena, feet[:, foot], ground[:, foot], robot, blocks)
        lowest_foot_gap = min(lowest_foot_gap, gaps.min(initial=np.inf))
        found.add(gaps, f"{name} foot", blocks)
        drop = _drops(arena, feet[:, foot], ground[:, foot], limit, tolerance)
        if drop.any():
            state = int(number[drop.argmax()])
            found.collisions.append(Collision(state, f"{name} foot", "stands over the edge of a drop", 0.0))
        under = inclination(arena.scene.heights_at, feet[:, foot], poses[:, 2], robot)
        if under.too_steep.any():
            pose = int(np.argmax(np.where(under.too_steep, under.angle, 0.0)))
            angle, most = np.degrees([under.angle[pose], under.limit[pose]])
            why = f"stands on ground steeper than {most:.1f} degrees: {angle:.1f}"
            found.collisions.append(Collision(int(number[pose]), f"{name} foot", why, 0.0))
    lowest_body_gap = min((gaps.min(initial=np.inf) for gaps in body), default=np.inf)
    return PlanCheck(found.collisions, float(lowest_body_gap), float(lowest_foot_gap), len(poses))


class _Findings:
    def __init__(self, number: np.ndarray, tolerance: float):
        self.number, self.tolerance = number, tolerance
        self.collisions: list[Collision] = []

    def add(self, gaps: np.ndarray, part: str, blocks: list[Block]) -> None:
        """Adds the deepest collision with each block in gaps [poses, blocks]."""
        for index in np.flatnonzero(gaps.min(axis=0, initial=np.inf) < -self.tolerance - 1e-9):
            pose, block = int(gaps[:, index].argmin()), blocks[index]
            why = f"hits what stands at ({block.x:.2f}, {block.y:.2f}), {block.height:.2f} m high"
            self.collisions.append(Collision(int(self.number[pose]), part, why, float(-gaps[pose, index])))


def _poses(states: np.ndarray, actions: Sequence[Action]) -> tuple[np.ndarray, np.ndarray]:
    """Poses to test: number of the state before each pose [m], and the poses [m, 7]; a step adds only its end."""
    change = np.diff(states, axis=0)
    change[:, 2] = np.angle(np.exp(1j * change[:, 2]))
    reach = np.hypot(*change[:, :2].T) + np.abs(change[:, 2]) * 0.5 + np.abs(change[:, 3:]).max(axis=1, initial=0)
    if (reach > _LONGEST_ACTION).any():
        index = int(reach.argmax())
        raise InputError(f"check of a plan: it jumps by {reach[index]:.2f} m after state {index}")
    number, poses = [0], [states[0]]
    for index, (step, way, action) in enumerate(zip(change, reach, actions, strict=True)):
        n = 1 if action.stepping_foot is not None else max(math.ceil(way / _INCREMENT), 1)
        for part in range(1, n + 1):
            number.append(index)
            poses.append(states[index] + step * (part / n))
    return np.array(number), np.array(poses)


def _feet(poses: np.ndarray, robot: Robot) -> np.ndarray:
    """World positions of the feet, [m, 4, 2]."""
    local = np.broadcast_to(robot.neutral_feet(), (len(poses), 4, 2)).copy()
    local[..., 0] += poses[:, 3:]
    c, s = np.cos(poses[:, 2, None]), np.sin(poses[:, 2, None])
    turned = np.stack([c * local[..., 0] - s * local[..., 1], s * local[..., 0] + c * local[..., 1]], axis=-1)
    return poses[:, None, :2] + turned


def _planes(poses: np.ndarray, ground: np.ndarray, robot: Robot) -> np.ndarray:
    """Ground under the base centre, gradient ahead and gradient to the left, [m, 3]; see `hdsp.detailed.base_pose`."""
    x = robot.neutral_feet()[:, 0] + poses[:, 3:]
    front_left, rear_left, rear_right, front_right = ground.T
    front_x, rear_x = (x[:, 0] + x[:, 3]) / 2, (x[:, 1] + x[:, 2]) / 2
    steepest_ahead, steepest_left = robot.slope.steepest()
    ahead = (front_left + front_right - rear_left - rear_right) / 2 / (front_x - rear_x)
    sideways = (front_left + rear_left - front_right - rear_right) / 2
    sideways -= ahead * (x[:, 0] + x[:, 1] - x[:, 2] - x[:, 3]) / 2
    left = sideways / (2 * robot.feet.neutral_y)
    ahead = np.clip(ahead, -steepest_ahead, steepest_ahead)
    left = np.clip(left, -steepest_left, steepest_left)
    return np.stack([ground.mean(axis=1) - ahead * x.mean(axis=1), ahead, left], axis=1)


def _body_gaps(poses: np.ndarray, planes: np.ndarray, box: Box, arena: Arena, blocks: list[Block]) -> np.ndarray:
    """Gaps between a body box and each block, [m, blocks], m; negative: overlap; inf: the box passes above."""
    gaps = np.full((len(poses), len(blocks)), np.inf)
    for index, block in enumerate(blocks):
        for face in block.faces():
            gap = _gap(poses, planes, box, _above_ground(face, arena.scene.ground))
            np.minimum(gaps[:, index], gap, out=gaps[:, index])
    return gaps


def _above_ground(face: Face, ground: TiltedGround | None) -> Face:
    """The face with absolute height and slopes on tilted ground."""
    if ground is None:
        return face
    c, s = math.cos(face.yaw), math.sin(face.yaw)
    return face._replace(
        height=face.height + ground.height(face.x, face.y),
        slope_along=face.slope_along + c * ground.slope_x + s * ground.slope_y,
        slope_across=face.slope_across - s * ground.slope_x + c * ground.slope_y,
    )


def _gap(poses: np.ndarray, planes: np.ndarray, box: Box, face: Face) -> np.ndarray:
    """Gap between a face and the part of a box below the plane of the face, seen from above, [m].

    Both the face and the lower side of the box are planes, so this part is a rectangle, cut by a straight line. The gap
    is the largest one along the axes of both rectangles and at right angles to the cut. Negative: depth of the overlap;
    inf: no part of the box is that low.
    """
    # In the frame of the face: corners of the box, and the height of the face over them, if it went on as far.
    turn = poses[:, 2] - face.yaw
    middle = _turned(poses[:, :2] - (face.x, face.y), -face.yaw)
    ahead, aside = np.array([(box.x_max, box.half_width), (box.x_min, box.half_width),
                             (box.x_min, -box.half_width), (box.x_max, -box.half_width)]).T  # fmt: skip
    corners = middle[:, None] + _turned(np.stack([ahead, aside], axis=-1), turn[:, None])
    lower = planes[:, :1] + planes[:, 1:2] * ahead + planes[:, 2:] * aside + box.above
    over = face.height + corners @ (face.slope_along, face.slope_across) - lower
    part = _cut(corners, over)
    empty = np.isnan(part).all(axis=(1, 2))
    part[empty] = 0.0
    rise = (face.slope_along, face.slope_across) - _turned(planes[:, 1:], turn)
    half = np.array([face.length / 2, face.width / 2])
    gap = np.full(len(poses), -np.inf)
    for along in (0.0, math.pi / 2, turn, turn + math.pi / 2, np.arctan2(rise[:, 1], rise[:, 0])):
        axis = np.stack(np.broadcast_arrays(np.cos(along), np.sin(along), turn)[:2], axis=-1)
        reach, at = np.abs(axis) @ half, np.einsum("mki,mi->mk", part, axis)
        gap = np.max([gap, np.nanmin(at, axis=1) - reach, -np.nanmax(at, axis=1) - reach], axis=0)
    return np.where(empty, np.inf, gap)


def _cut(corners: np.ndarray, over: np.ndarray) -> np.ndarray:
    """Corners [m, 8, 2] of the part of rectangles [m, 4, 2] on which a linear function is positive; NaN: no corner.

    The function has the values ``over`` [m, 4] at the corners.
    """
    following = np.roll(over, -1, axis=1)
    crossing = (over > 0) != (following > 0)
    share = np.divide(over, over - following, out=np.zeros_like(over), where=crossing)
    cut = corners + share[..., None] * (np.roll(corners, -1, axis=1) - corners)
    return np.concatenate(
        [np.where((over > 0)[..., None], corners, np.nan), np.where(crossing[..., None], cut, np.nan)], axis=1
    )


def _turned(points: np.ndarray, angle: np.ndarray | float) -> np.ndarray:
    """Points [..., 2], rotated counter-clockwise."""
    c, s = np.cos(angle), np.sin(angle)
    x, y = points[..., 0], points[..., 1]
    return np.stack([c * x - s * y, s * x + c * y], axis=-1)


def _foot_gaps(arena: Arena, feet: np.ndarray, ground: np.ndarray, robot: Robot, blocks: list[Block]) -> np.ndarray:
    """Gaps between a foot's rim and each block too high for its wheel, [m, blocks]; inf for lower blocks."""
    limit, steepest = robot.drive.highest_edge, max(robot.slope.steepest())
    gaps = np.full((len(feet), len(blocks)), np.inf)
    for index, block in enumerate(blocks):
        apart = feet - (block.x, block.y)
        c, s = math.cos(block.yaw), math.sin(block.yaw)
        beyond = np.stack([np.abs(c * apart[:, 0] + s * apart[:, 1]) - block.length / 2,
                           np.abs(-s * apart[:, 0] + c * apart[:, 1]) - block.width / 2])  # fmt: skip
        distance = np.hypot(*np.maximum(beyond, 0)) + np.minimum(beyond.max(axis=0), 0)
        # At the nearest point of the block; on a ramp that is where the foot would roll onto it.
        along = np.clip(c * apart[:, 0] + s * apart[:, 1], -block.length / 2, block.length / 2)
        across = np.clip(-s * apart[:, 0] + c * apart[:, 1], -block.width / 2, block.width / 2)
        nearest = np.stack([block.x + c * along - s * across, block.y + s * along + c * across])
        top = block.top(*nearest)
        if arena.scene.ground is not None:
            top = top + arena.scene.ground.height(*nearest)
        # The ground goes on to the block, but no steeper than a slope.
        outside = nearest.T + np.minimum(_BESIDE / np.maximum(distance, _BESIDE), 1.0)[:, None] * (feet - nearest.T)
        rise = arena.scene.heights_at(*outside.T) - ground
        furthest = steepest * np.maximum(distance, 0.0)
        most = ground + np.clip(rise, -furthest, furthest) + limit + height_tolerance(ground)
        high = np.broadcast_to(top > most, ground.shape)
        gaps[high, index] = distance[high] - FOOT_RADIUS
    return gaps


def _drops(arena: Arena, feet: np.ndarray, ground: np.ndarray, limit: float, tolerance: float) -> np.ndarray:
    """Whether the ground under a foot's rim lies too far below it, bool [m]."""
    radius = max(FOOT_RADIUS - tolerance, 0.0)
    x = feet[:, :1] + radius * np.cos(_RIM)
    y = feet[:, 1:] + radius * np.sin(_RIM)
    return arena.scene.heights_at(x, y).min(axis=1) < ground - limit - height_tolerance(ground)
