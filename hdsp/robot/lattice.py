"""The two lattices, and all conversions between world, detailed and abstract coordinates.

No other module multiplies by a resolution.

Convention: x forward (axis 0), y left (axis 1), theta counter-clockwise from +x. Grid cell ``(ix, iy)`` covers ``origin
+ [ix, ix + 1) * RESOLUTION`` (the same in y). A detailed base position is a cell, and the base stands at its centre.
Abstract cell ``(a, b)`` is the block of detailed cells ``[4a, 4a + 4) x [4b, 4b + 4)``; its anchor is detailed cell
``(4a + 2, 4b + 2)``. Abstract heading ``k`` is detailed heading ``4k``.
"""

import math
from dataclasses import dataclass
from typing import Annotated, Any, TypeVar

import numpy as np
from numpy.typing import ArrayLike
from pydantic import Field

from hdsp.base.errors import InputError
from hdsp.base.messages import coordinates, spans

RESOLUTION = 0.025  # metres, side of a detailed cell
HEADINGS = 64

CELLS_PER_ABSTRACT = 4
ABSTRACT_RESOLUTION = RESOLUTION * CELLS_PER_ABSTRACT
ABSTRACT_HEADINGS = 16
HEADINGS_PER_ABSTRACT = HEADINGS // ABSTRACT_HEADINGS
ABSTRACT_ANCHOR = CELLS_PER_ABSTRACT // 2

#: An abstract heading in settings, and an abstract heading modulo a quarter turn.
AbstractHeading = Annotated[int, Field(ge=0, lt=ABSTRACT_HEADINGS)]
Residue = Annotated[int, Field(ge=0, lt=ABSTRACT_HEADINGS // 4)]

PATCH_CELLS = 72
PATCH_CENTER = PATCH_CELLS // 2

#: Offsets (dx, dy) of the 20-neighbourhood, in lattice steps; the abstract actions begin with the same twenty.
DRIVE_MOVES = np.array(
    [
        (1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1),
        (2, 0), (2, 1), (1, 2), (0, 2), (-1, 2), (-2, 1), (-2, 0), (-2, -1), (-1, -2), (0, -2), (1, -2), (2, -1),
    ],
    dtype=np.int64,
)  # fmt: skip

#: The 22 abstract actions (dx, dy, dtheta) in abstract steps of 10 cm and 22.5 degrees, in the lattice frame.
ABSTRACT_ACTIONS = np.array([(dx, dy, 0) for dx, dy in DRIVE_MOVES] + [(0, 0, 1), (0, 0, -1)], dtype=np.int64)

N_ABSTRACT_ACTIONS = len(ABSTRACT_ACTIONS)

#: A number, an array or a tensor.
Lengths = TypeVar("Lengths", bound=Any)


def heading_angle(index, headings: int = HEADINGS):
    """Returns the angle in radians, in [-pi, pi), for heading ``index`` (scalar or array) out of ``headings``."""
    # Signed: an unsigned index would wrap round where the angle is negative.
    turned = np.mod(np.asarray(index).astype(np.int64) + headings // 2, headings) - headings // 2
    return turned * (2 * math.pi / headings)


def heading_index(theta, headings: int = HEADINGS):
    """Returns the nearest heading index in ``[0, headings)`` for an angle in radians (scalar or array).

    Example:
        >>> int(heading_index(math.pi / 2))
        16
    """
    index = np.floor(np.asarray(theta, dtype=float) * (headings / (2 * math.pi)) + 0.5)
    return np.mod(index, headings).astype(np.int64)


def rotation(theta: float) -> np.ndarray:
    """Returns the 2 x 2 counter-clockwise rotation by ``theta`` radians; exact at multiples of 90 degrees."""
    quarter = theta / (math.pi / 2)
    if abs(quarter - round(quarter)) < 1e-12:
        c, s = ((1.0, 0.0), (0.0, 1.0), (-1.0, 0.0), (0.0, -1.0))[round(quarter) % 4]
    else:
        c, s = math.cos(theta), math.sin(theta)
    return np.array([[c, -s], [s, c]], dtype=float)


def robot_frame_goals(abstract_heading: int) -> np.ndarray:
    """Returns the 22 abstract actions' goals in the robot frame, as networks take them.

    Args:
        abstract_heading: start heading, index in [0, 16).

    Returns:
        float32 [22, 3]: (dx, dy, dtheta) in abstract steps, in the start state's robot frame. Positions are fractional
            except at multiples of 90 degrees.

    Example:
        >>> robot_frame_goals(0)[0].tolist()
        [1.0, 0.0, 0.0]
    """
    goals = ABSTRACT_ACTIONS.astype(float)
    goals[:, :2] = goals[:, :2] @ rotation(float(heading_angle(-int(abstract_heading), ABSTRACT_HEADINGS))).T
    return goals.astype(np.float32)


def abstract_shape(shape: tuple[int, int]) -> tuple[int, int]:
    """Returns the number of whole abstract cells (a, b) in a grid with ``shape`` detailed cells."""
    return shape[0] // CELLS_PER_ABSTRACT, shape[1] // CELLS_PER_ABSTRACT


def abstract_anchor(abstract: np.ndarray) -> np.ndarray:
    """Returns anchors, int64 [..., 3] (ix, iy, heading), for abstract states [..., 3] (a, b, k)."""
    abstract = np.asarray(abstract, dtype=np.int64)
    scale = np.array([CELLS_PER_ABSTRACT, CELLS_PER_ABSTRACT, HEADINGS_PER_ABSTRACT])
    return abstract * scale + np.array([ABSTRACT_ANCHOR, ABSTRACT_ANCHOR, 0])


def detailed_to_abstract(states: np.ndarray) -> np.ndarray:
    """T_d->a (paper, Sec. V-B): abstract states, int64 [..., 3], for detailed states [..., >=3] in lattice units.

    The position maps to its abstract cell and the heading to the nearest abstract heading; foot offsets are dropped.
    """
    states = np.asarray(states, dtype=np.int64)
    heading = (states[..., 2] + HEADINGS_PER_ABSTRACT // 2) // HEADINGS_PER_ABSTRACT % ABSTRACT_HEADINGS
    position = states[..., :2] // CELLS_PER_ABSTRACT
    return np.concatenate([position, heading[..., None]], axis=-1)


def surrounding_abstract(states: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Abstract states whose anchors surround detailed states, for interpolation.

    Args:
        states: int64 [n, >=3], lattice units.

    Returns:
        States int64 [n, 8, 3], (ix, iy, heading), possibly off the map, and their shares float64 [n, 8] with sum 1.
    """
    states = np.asarray(states, dtype=np.int64)[:, :3]
    scale = np.array([CELLS_PER_ABSTRACT, CELLS_PER_ABSTRACT, HEADINGS_PER_ABSTRACT])
    below, beyond = np.divmod(states - (ABSTRACT_ANCHOR, ABSTRACT_ANCHOR, 0), scale)
    upper = np.array([[n >> 2 & 1, n >> 1 & 1, n & 1] for n in range(8)])
    around = below[:, None] + upper
    around[..., 2] %= ABSTRACT_HEADINGS
    part = beyond[:, None] / scale
    return around, np.where(upper, part, 1 - part).prod(axis=2)


def abstract_steps(displacement: ArrayLike) -> np.ndarray:
    """Converts displacements (dx, dy, dtheta) [..., 3] from metres and radians to steps of 10 cm and 22.5 degrees."""
    return np.asarray(displacement, dtype=float) / _ABSTRACT_STEP


def abstract_steps_to_world(steps: ArrayLike) -> np.ndarray:
    """Converts displacements [..., 3] from abstract steps to metres and radians; inverse of `abstract_steps`."""
    return np.asarray(steps, dtype=float) * _ABSTRACT_STEP


_ABSTRACT_STEP = np.array([ABSTRACT_RESOLUTION, ABSTRACT_RESOLUTION, 2 * math.pi / ABSTRACT_HEADINGS])


@dataclass(frozen=True)
class Grid:
    """Placement of a detailed grid in the world.

    Attributes:
        origin: world (x, y) in metres of the lower corner of cell (0, 0).
        shape: cell count (nx, ny).
    """

    origin: tuple[float, float]
    shape: tuple[int, int]

    def cell(self, xy) -> np.ndarray:
        """Returns the cells, int64 [..., 2], under world positions ``xy`` [..., 2] in metres; also outside the grid."""
        # The small shift keeps coordinates on a cell's edge from falling below it by rounding.
        scaled = (np.asarray(xy, dtype=float) - np.asarray(self.origin)) / RESOLUTION
        return np.floor(scaled + 1e-6).astype(np.int64)

    def center(self, cells) -> np.ndarray:
        """Returns world positions [..., 2] in metres for the centres of ``cells`` [..., 2]."""
        return (np.asarray(cells, dtype=float) + 0.5) * RESOLUTION + np.asarray(self.origin)

    def contains(self, cells) -> np.ndarray:
        """Returns whether each cell in ``cells`` [..., 2] lies in the grid; bool [...]."""
        cells = np.asarray(cells)
        return ((cells >= 0) & (cells < np.asarray(self.shape))).all(axis=-1)

    def to_lattice(self, pose, feet=(0.0, 0.0, 0.0, 0.0)) -> np.ndarray:
        """Returns the detailed state, int64 [7], for a world pose (x, y, theta) and foot offsets in metres.

        Raises:
            InputError: a value is not finite, or the position lies outside the grid.
        """
        values = np.asarray([*pose, *feet], dtype=float)
        if values.shape != (7,) or not np.isfinite(values).all():
            raise InputError(
                f"state {tuple(pose)} with feet {tuple(feet)}: need x, y, theta and 4 foot offsets, all finite"
            )
        cell = self.cell(values[:2])
        if not self.contains(cell):
            high = np.asarray(self.origin) + metres(np.asarray(self.shape, float))
            raise InputError(
                f"position ({coordinates(values[:2])}) m is outside the map, which spans "
                f"{spans(self.origin, high)} m, upper ends excluded"
            )
        return np.array([*cell, heading_index(values[2]), *offset_steps(values[3:])], dtype=np.int64)

    def to_world(self, states) -> np.ndarray:
        """Returns world states, float64 [..., 7] (m, m, rad, 4 x m), for detailed states [..., 7] in lattice units."""
        states = np.asarray(states)
        pose = [self.center(states[..., :2]), heading_angle(states[..., 2])[..., None]]
        return np.concatenate([*pose, states[..., 3:] * RESOLUTION], axis=-1)


def offset_steps(metres) -> np.ndarray:
    """Converts foot offsets or other lengths from metres to whole lattice steps, int64."""
    return np.rint(np.asarray(metres, dtype=float) / RESOLUTION).astype(np.int64)


def cells(metres: Lengths) -> Lengths:
    """Converts lengths from metres to (fractional) detailed cells."""
    return metres / RESOLUTION


def metres(cells: Lengths) -> Lengths:
    """Converts lengths from detailed cells to metres."""
    return cells * RESOLUTION


def is_detailed(resolution: float) -> bool:
    """Returns whether a cell size in metres equals the detailed lattice's."""
    return abs(resolution - RESOLUTION) <= 1e-9
