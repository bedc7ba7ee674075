"""The detailed actions: one byte in the search, an ``Action`` everywhere else.

Every action can be undone. One byte per state is therefore enough to find the path to a state.
"""

from dataclasses import dataclass
from enum import StrEnum
from functools import cache

import numpy as np

from hdsp.base.jit import njit
from hdsp.detailed.states import foot_shift, pack, unpack
from hdsp.robot.lattice import DRIVE_MOVES, HEADINGS, metres
from hdsp.robot.robot import FEET

#: Codes below this number are drive moves, rows of ``DRIVE_MOVES``.
DRIVES = len(DRIVE_MOVES)
TURN_LEFT, TURN_RIGHT = DRIVES, DRIVES + 1
FOOT_MOVE = TURN_RIGHT + 1  # + 2 * foot + (0 forward, 1 backward)
BASE_FORWARD, BASE_BACKWARD = FOOT_MOVE + 8, FOOT_MOVE + 9
STEP = BASE_BACKWARD + 1  # + 32 * foot + 16 + length in cells
ARC = STEP + 128  # + 2 * (0 ahead, 1 back) + (0 left, 1 right)
START = 255  # marks the first state in a search

_LENGTHS = 32  # step codes per foot
_NO_LENGTH = 16

#: Number of actions between poses on neutral feet, i.e. driving and turning: codes 0 to 21.
POSE_ACTIONS = FOOT_MOVE
#: Number of arcs at a heading. A robot with arcs does not turn on the spot.
ARCS = 4


class ActionKind(StrEnum):
    """Kinds of detailed actions."""

    DRIVE = "drive"
    TURN_LEFT = "turn_left"
    TURN_RIGHT = "turn_right"
    ARC_LEFT = "arc_left"
    ARC_RIGHT = "arc_right"
    FOOT_MOVE = "foot_move"
    BASE_SHIFT = "base_shift"
    STEP = "step"


@dataclass(frozen=True, slots=True)
class Action:
    """One action in a plan; ``str`` gives it in words, e.g. ``drive`` or ``step front_left +0.250``.

    Attributes:
        kind: kind of action.
        foot: moving foot's name, one of ``hdsp.robot.robot.FEET``; None for other kinds.
        length: way of the foot, m, forward positive; None for driving and turning. For a base shift and an arc only the
            sign counts: the heading decides its length.
    """

    kind: ActionKind
    foot: str | None = None
    length: float | None = None

    @property
    def stepping_foot(self) -> int | None:
        """Number of the stepping foot; None for other kinds."""
        return FEET.index(self.foot) if self.foot is not None and self.kind is ActionKind.STEP else None

    def __str__(self) -> str:
        if self.length is None:
            return str(self.kind)
        if self.foot is None:
            return f"{self.kind} {'forward' if self.length > 0 else 'backward'}"
        return f"{self.kind} {self.foot} {self.length:+.3f}"


@cache
def action_of(code: int) -> Action:
    """Action for a code other than ``START``."""
    if code < DRIVES:
        return Action(ActionKind.DRIVE)
    if code < FOOT_MOVE:
        return Action(ActionKind.TURN_LEFT if code == TURN_LEFT else ActionKind.TURN_RIGHT)
    if code < BASE_FORWARD:
        foot, backward = divmod(code - FOOT_MOVE, 2)
        return Action(ActionKind.FOOT_MOVE, FEET[foot], metres(1 - 2 * backward))
    if code < STEP:
        return Action(ActionKind.BASE_SHIFT, None, metres(1 if code == BASE_FORWARD else -1))
    if code >= ARC:
        kind = ActionKind.ARC_RIGHT if (code - ARC) % 2 else ActionKind.ARC_LEFT
        return Action(kind, None, metres(1 if code < ARC + 2 else -1))
    foot, length = divmod(code - STEP, _LENGTHS)
    return Action(ActionKind.STEP, FEET[foot], metres(length - _NO_LENGTH))


@njit(inline="always")
def foot_move_code(foot, backward):
    """Code for a foot move by one cell; ``backward`` is 0 or 1."""
    return FOOT_MOVE + 2 * foot + backward


@njit(inline="always")
def step_code(foot, length):
    """Code for a step by ``length`` cells, negative backward."""
    return STEP + _LENGTHS * foot + _NO_LENGTH + length


@njit(inline="always")
def arc_turn(arc):
    """Heading steps of an arc 0 to 3, numbered as their codes after ``ARC``."""
    return 1 - 2 * (arc % 2)


@njit()
def undo(key, action, move_dx, move_dy, shifts, arcs):
    """Packed state before an action that led to ``key``."""
    ix, iy, heading, o0, o1, o2, o3 = unpack(key)
    if action < DRIVES:
        return pack(ix - move_dx[action], iy - move_dy[action], heading, o0, o1, o2, o3)
    if action < FOOT_MOVE:
        back = -1 if action == TURN_LEFT else 1
        return pack(ix, iy, (heading + back) % HEADINGS, o0, o1, o2, o3)
    if action < BASE_FORWARD:
        foot, change = (action - FOOT_MOVE) // 2, 1 - 2 * ((action - FOOT_MOVE) % 2)
        return key - (np.int64(change) << foot_shift(foot))
    if action < STEP:
        sign = 1 if action == BASE_FORWARD else -1
        n = sign * shifts[heading, 2]
        dx, dy = sign * shifts[heading, 0], sign * shifts[heading, 1]
        return pack(ix - dx, iy - dy, heading, o0 + n, o1 + n, o2 + n, o3 + n)
    if action >= ARC:
        before = (heading - arc_turn(action - ARC)) % HEADINGS
        dx, dy = arcs[before, action - ARC, 0], arcs[before, action - ARC, 1]
        return pack(ix - dx, iy - dy, before, o0, o1, o2, o3)
    foot, length = (action - STEP) // _LENGTHS, (action - STEP) % _LENGTHS - _NO_LENGTH
    return key - (np.int64(length) << foot_shift(foot))
