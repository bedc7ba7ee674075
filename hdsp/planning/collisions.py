"""An independent check of plans: collisions with the true arena, without height map or planner.

The robot moves along the plan in small increments. At each pose, the check tests body boxes against the arena's blocks
by the separating axes of their outlines. It tests feet by their distance to higher ground and by the ground around
them. A swinging foot is tested at its landing only.

Convention: world coordinates, m, rad; feet in the order of `hdsp.robot.robot.FEET`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from hdsp.base.errors import InputError
from hdsp.detailed.actions.action import Action
from hdsp.robot.lattice import metres
from hdsp.robot.robot import FEET, Robot
from hdsp.terrain.arenas import Arena
from hdsp.terrain.obstacles import Block, Ramp

if TYPE_CHECKING:
    from hdsp.planning.plans import Plan

#: A foot is a disc of this radius, m.
FOOT_RADIUS = 0.05

#: Uncertainty of an edge on a map with cells, m: a cell is as high as its centre, so an obstacle may extend half a cell
#: further than on the map. The tolerance does not cover the planner's own tests at cell centres: its margin
#: (``hdsp.planning.margin.with_margin``) and the clearance of feet cover them.
CELL_TOLERANCE = metres(0.5)

_INCREMENT = 0.01  # m between two tested poses
_LONGEST_ACTION = 0.4  # m; a longer gap between two states is no motion
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

    @property
    def free(self) -> bool:
        return not self.collisions


def check_plan(arena: Arena, plan: Plan, robot: Robot, tolerance: float = CELL_TOLERANCE) -> PlanCheck:
    """Tests a plan against the blocks in an arena.

    The base is as high as the mean ground under its feet.

    Args:
        arena: the true arena.
        plan: with `states` [n, 7] in world coordinates and n - 1 `actions`.
        robot: its boxes, feet, and the largest edge for its wheels.
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
    body = [_body_gaps(poses, ground.mean(axis=1), box, blocks) for box in robot.body.boxes]
    found = _Findings(number, tolerance)
    for gaps in body:
        found.add(gaps, "body", blocks)
    lowest_foot_gap = np.inf
    limit = robot.drive.highest_edge
    for foot, name in enumerate(FEET):
        gaps = _foot_gaps(feet[:, foot], ground[:, foot], limit, blocks)
        lowest_foot_gap = min(lowest_foot_gap, gaps.min(initial=np.inf))
        found.add(gaps, f"{name} foot", blocks)
        drop = _drops(arena, feet[:, foot], ground[:, foot], limit, tolerance)
        if drop.any():
            state = int(number[drop.argmax()])
            found.collisions.append(Collision(state, f"{name} foot", "stands over the edge of a drop", 0.0))
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


def _body_gaps(poses: np.ndarray, ground: np.ndarray, box, blocks: list[Block]) -> np.ndarray:
    """Gaps between a body box and each block, [m, blocks], m; negative: overlap; inf: the box passes above."""
    half = np.array([(box.x_max - box.x_min) / 2, box.half_width])
    ahead = (box.x_max + box.x_min) / 2
    center = poses[:, :2] + ahead * np.stack([np.cos(poses[:, 2]), np.sin(poses[:, 2])], axis=-1)
    gaps = np.full((len(poses), len(blocks)), np.inf)
    for index, block in enumerate(blocks):
        gap = _rectangle_gap(center, poses[:, 2], half, block)
        high = _top_under(center, poses[:, 2], half, block) > ground + box.above
        gaps[high, index] = gap[high]
    return gaps


def _rectangle_gap(center: np.ndarray, yaw: np.ndarray, half: np.ndarray, block: Block) -> np.ndarray:
    """Largest gap between two rectangles along the axes of both, [m]; negative: depth of the overlap."""
    apart = np.array([block.x, block.y]) - center
    other = np.array([block.length / 2, block.width / 2])
    turn = block.yaw - yaw
    c, s = np.abs(np.cos(turn)), np.abs(np.sin(turn))
    gaps = []
    for angle, mine, theirs in ((yaw, half, other), (np.full_like(yaw, block.yaw), other, half)):
        along = np.cos(angle) * apart[:, 0] + np.sin(angle) * apart[:, 1]
        across = -np.sin(angle) * apart[:, 0] + np.cos(angle) * apart[:, 1]
        gaps.append(np.abs(along) - mine[0] - c * theirs[0] - s * theirs[1])
        gaps.append(np.abs(across) - mine[1] - s * theirs[0] - c * theirs[1])
    return np.max(gaps, axis=0)


def _top_under(center: np.ndarray, yaw: np.ndarray, half: np.ndarray, block: Block) -> np.ndarray:
    """Upper limit of a block's height under a rectangle, [m]."""
    if not isinstance(block, Ramp):
        return np.full(len(center), block.height)
    turn = np.abs(yaw - block.yaw)
    uphill = half[0] * np.abs(np.cos(turn)) + half[1] * np.abs(np.sin(turn))
    ahead = np.array([math.cos(block.yaw), math.sin(block.yaw)]) * uphill[:, None]
    return block.top(*(center + ahead).T)


def _foot_gaps(feet: np.ndarray, ground: np.ndarray, limit: float, blocks: list[Block]) -> np.ndarray:
    """Gaps between a foot's rim and each block too high for its wheel, [m, blocks]; inf for lower blocks."""
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
        top = block.top(block.x + c * along - s * across, block.y + s * along + c * across)
        high = np.broadcast_to(top > ground + limit, ground.shape)
        gaps[high, index] = distance[high] - FOOT_RADIUS
    return gaps


def _drops(arena: Arena, feet: np.ndarray, ground: np.ndarray, limit: float, tolerance: float) -> np.ndarray:
    """Whether the ground under a foot's rim lies too far below it, bool [m]."""
    radius = max(FOOT_RADIUS - tolerance, 0.0)
    x = feet[:, :1] + radius * np.cos(_RIM)
    y = feet[:, 1:] + radius * np.sin(_RIM)
    return arena.scene.heights_at(x, y).min(axis=1) < ground - limit - 1e-6
