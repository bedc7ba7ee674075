"""Base poses in the relaxed problem and the robot's best options there; see ``relaxed_costs``."""

from typing import NamedTuple

import numpy as np

from hdsp.base.jit import njit
from hdsp.detailed.actions.action import ARC, ARCS, POSE_ACTIONS, TURN_LEFT, TURN_RIGHT
from hdsp.detailed.actions.any_feet import can_step_from_neutral, least_pose_cost
from hdsp.detailed.actions.successors import MAX_SUCCESSORS, Rules, pose_successors
from hdsp.detailed.states import pack
from hdsp.detailed.world.world import World
from hdsp.robot.lattice import HEADINGS


class Poses(NamedTuple):
    """Poses at some neighbouring headings; entries are computed at first use.

    A pose is ``(slot * nx + ix) * ny + iy``; slots are headings from ``first`` on.

    Attributes:
        first: heading in slot 0.
        slots: number of headings.
        edge: float32 [poses, 22]; costs for driving and turning on neutral feet, turns at their normal cost. The
            columns of a robot with arcs are 20 drives and 4 arcs.
        known: bool [poses]; whether ``edge`` and ``stepping`` are filled in.
        stepping: bool [poses]; whether a foot can step while all are neutral.
        some: float32 [poses]; least state cost over all feet, inf if impossible, 0 before the first use.
        successors: buffers for the successors of one state.
    """

    first: int
    slots: int
    edge: np.ndarray
    known: np.ndarray
    stepping: np.ndarray
    some: np.ndarray
    successors: tuple[np.ndarray, np.ndarray, np.ndarray]


def new_poses(world: World, center: int, window: int) -> Poses:
    """Poses at all headings within ``window`` steps from ``center``."""
    slots = min(2 * window + 1, HEADINGS)
    n = slots * world.nx * world.ny
    return Poses(
        first=(center - window) % HEADINGS if slots < HEADINGS else 0,
        slots=slots,
        edge=np.empty((n, POSE_ACTIONS if world.constants.on_the_spot else TURN_LEFT + ARCS), dtype=np.float32),
        known=np.zeros(n, dtype=np.bool_),
        stepping=np.zeros(n, dtype=np.bool_),
        some=np.zeros(n, dtype=np.float32),
        successors=(np.empty(MAX_SUCCESSORS, np.int64), np.empty(MAX_SUCCESSORS), np.empty(MAX_SUCCESSORS, np.uint8)),
    )


def nodes_of(world: World, poses: Poses, states: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Layer (0 on neutral feet, 1 on others) and pose for states int64 [n, 7]."""
    layer = np.any(states[:, 3:] != 0, axis=1)
    slot = (states[:, 2] - poses.first) % HEADINGS
    return layer.astype(np.int64), (slot * world.nx + states[:, 0]) * world.ny + states[:, 1]


@njit(inline="always")
def look_at_pose(world, poses, pose, x, y, heading):
    """Fills in ``edge`` and ``stepping`` for a pose."""
    out_key, out_cost, out_action = poses.successors
    zero = -world.tables.lowest
    poses.edge[pose] = np.inf
    key = pack(x, y, heading, zero, zero, zero, zero)
    for k in range(pose_successors(world, Rules(0, HEADINGS, 1.0, True), key, out_key, out_cost, out_action)):
        action = np.int64(out_action[k])
        poses.edge[pose, action if action <= TURN_RIGHT else action - ARC + TURN_LEFT] = out_cost[k]
    poses.stepping[pose] = can_step_from_neutral(world, x, y, heading)
    poses.known[pose] = True


@njit(inline="always")
def look_at_feet(world, poses, pose, x, y, heading):
    """Fills in ``some`` for a pose; returns it."""
    if poses.some[pose] == 0:
        poses.some[pose] = least_pose_cost(world, x, y, heading)
    return poses.some[pose]
