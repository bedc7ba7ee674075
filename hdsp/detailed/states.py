"""Detailed states as single integers, and the codes of the detailed actions.

A state (ix, iy, heading, f0, f1, f2, f3) in lattice units is packed into one int64: 16 bits each for x and y, 6 for the
heading, 5 for each foot offset counted from its lowest value. An action is one byte, and every action can be undone, so
a search needs to remember one byte per state to find the way back.
"""

import numpy as np

from hdsp.base.jit import njit
from hdsp.robot.lattice import HEADINGS, metres
from hdsp.robot.robot import FEET

TURN_LEFT, TURN_RIGHT = 20, 21  # 0..19 are the drive moves
FOOT_MOVE = 22  # + 2 * foot + (0 forward, 1 backward)
BASE_FORWARD, BASE_BACKWARD = 30, 31
STEP = 32  # + 32 * foot + 16 + length in cells
START = 255

_HEADING_BITS = 20
_Y_BITS = 26
_X_BITS = 42
MAX_CELLS = 1 << 16
FEET_MASK = (1 << 20) - 1  # the feet bits of a packed state


@njit(inline="always")
def pack(ix, iy, heading, o0, o1, o2, o3):
    """State as int64; ``o`` are foot offsets counted from the lowest."""
    return (
        (np.int64(ix) << 42) | (np.int64(iy) << 26) | (np.int64(heading) << 20)
        | (np.int64(o0) << 15) | (np.int64(o1) << 10) | (np.int64(o2) << 5) | np.int64(o3)
    )  # fmt: skip


@njit(inline="always")
def neutral_feet(lowest):
    """The feet bits of a packed state on neutral feet."""
    return -lowest * (1 << 15 | 1 << 10 | 1 << 5 | 1)


@njit(inline="always")
def unpack(key):
    """(ix, iy, heading, o0, o1, o2, o3) of a packed state."""
    return (
        key >> 42, (key >> 26) & 0xFFFF, (key >> 20) & 0x3F,
        (key >> 15) & 0x1F, (key >> 10) & 0x1F, (key >> 5) & 0x1F, key & 0x1F,
    )  # fmt: skip


def pack_steps(steps: np.ndarray) -> np.ndarray:
    """What steps (dx, dy), int64 [n, 2], add to a packed state, int64 [n]."""
    return (steps[:, 0] << _X_BITS) + (steps[:, 1] << _Y_BITS)


def pack_states(states, lowest: int) -> np.ndarray:
    """Packed states, int64 [n], of detailed states [n, 7] in lattice units; ``lowest`` is the smallest foot offset."""
    s = np.atleast_2d(np.asarray(states, dtype=np.int64))
    o = s[:, 3:] - lowest
    return (s[:, 0] << _X_BITS | s[:, 1] << _Y_BITS | s[:, 2] << _HEADING_BITS
            | o[:, 0] << 15 | o[:, 1] << 10 | o[:, 2] << 5 | o[:, 3])  # fmt: skip


def unpack_states(keys, lowest: int) -> np.ndarray:
    """Detailed states, int64 [n, 7] in lattice units, of packed states [n]."""
    k = np.asarray(keys, dtype=np.int64)
    offsets = [((k >> shift) & 0x1F) + lowest for shift in (15, 10, 5, 0)]
    return np.stack([k >> _X_BITS, (k >> _Y_BITS) & 0xFFFF, (k >> _HEADING_BITS) & 0x3F, *offsets], axis=-1)


@njit()
def undo(key, action, move_dx, move_dy, shifts):
    """The state from which ``action`` led to ``key``."""
    ix, iy, heading, o0, o1, o2, o3 = unpack(key)
    if action < TURN_LEFT:
        return pack(ix - move_dx[action], iy - move_dy[action], heading, o0, o1, o2, o3)
    if action < FOOT_MOVE:
        back = -1 if action == TURN_LEFT else 1
        return pack(ix, iy, (heading + back) % HEADINGS, o0, o1, o2, o3)
    if action < BASE_FORWARD:
        foot, change = (action - FOOT_MOVE) // 2, 1 - 2 * ((action - FOOT_MOVE) % 2)
        return key - (np.int64(change) << (15 - 5 * foot))
    if action < STEP:
        sign = 1 if action == BASE_FORWARD else -1
        n = sign * shifts[heading, 2]
        dx, dy = sign * shifts[heading, 0], sign * shifts[heading, 1]
        return pack(ix - dx, iy - dy, heading, o0 + n, o1 + n, o2 + n, o3 + n)
    foot, length = (action - STEP) // 32, (action - STEP) % 32 - 16
    return key - (np.int64(length) << (15 - 5 * foot))


def action_name(action: int) -> str:
    """An action code in words, e.g. ``drive``, ``turn_left``, ``step front_left +0.250``."""
    if action < TURN_LEFT:
        return "drive"
    if action < FOOT_MOVE:
        return "turn_left" if action == TURN_LEFT else "turn_right"
    if action < BASE_FORWARD:
        change = metres(1 - 2 * ((action - FOOT_MOVE) % 2))
        return f"foot_move {FEET[(action - FOOT_MOVE) // 2]} {change:+.3f}"
    if action < STEP:
        return "base_shift " + ("forward" if action == BASE_FORWARD else "backward")
    if action == START:
        return "start"
    return f"step {FEET[(action - STEP) // 32]} {metres((action - STEP) % 32 - 16):+.3f}"
