"""The two lattices, and every conversion between world, detailed and abstract coordinates.

No other module multiplies by a resolution.

Convention: x forward (axis 0), y left (axis 1), theta counter-clockwise from +x. Cell ``(ix, iy)`` of a grid covers
``origin + [ix, ix + 1) * RESOLUTION`` (the same in y). A detailed base position is a cell, and the base stands at the
centre of that cell. The abstract cell ``(a, b)`` is the block of detailed cells ``[4a, 4a + 4) x [4b, 4b + 4)``; its
anchor is detailed cell ``(4a + 2, 4b + 2)``. Abstract heading ``k`` is detailed heading ``4k``.
"""

import math
from dataclasses import dataclass

import numpy as np

from hdsp.base.errors import InputError

RESOLUTION = 0.025  # metres, side of a detailed cell
HEADINGS = 64

CELLS_PER_ABSTRACT = 4
ABSTRACT_RESOLUTION = RESOLUTION * CELLS_PER_ABSTRACT
ABSTRACT_HEADINGS = 16
HEADINGS_PER_ABSTRACT = HEADINGS // ABSTRACT_HEADINGS
ABSTRACT_ANCHOR = CELLS_PER_ABSTRACT // 2

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

#: The 22 abstract actions (dx, dy, dtheta) in abstract steps of 10 cm and 22.5 degrees, in the frame of the lattice.
ABSTRACT_ACTIONS = np.array([(dx, dy, 0) for dx, dy in DRIVE_MOVES] + [(0, 0, 1), (0, 0, -1)], dtype=np.int64)

N_ABSTRACT_ACTIONS = len(ABSTRACT_ACTIONS)


def heading_angle(index, headings: int = HEADINGS):
    """Angle in radians, in [-pi, pi), of heading ``index`` (scalar or array) of a circle of ``headings``."""
    turned = np.mod(np.asarray(index) + headings // 2, headings) - headings // 2
    return turned * (2 * math.pi / headings)


def heading_index(theta, headings: int = HEADINGS):
    """Nearest heading index in ``[0, headings)`` of an angle in radians (scalar or array)."""
    index = np.floor(np.asarray(theta, dtype=float) * (headings / (2 * math.pi)) + 0.5)
    return np.mod(index, headings).astype(np.int64)


def rotation(theta: float) -> np.ndarray:
    """The 2 x 2 matrix that turns a vector counter-clockwise by ``theta`` radians; exact at multiples of 90 degrees."""
    quarter = theta / (math.pi / 2)
    if abs(quarter - round(quarter)) < 1e-12:
        c, s = ((1, 0), (0, 1), (-1, 0), (0, -1))[round(quarter) % 4]
    else:
        c, s = math.cos(theta), math.sin(theta)
    return np.array([[c, -s], [s, c]], dtype=float)


def robot_frame_goals(abstract_heading: int) -> np.ndarray:
    """Goals of the 22 abstract actions as the network sees them.

    Args:
        abstract_heading: heading of the start state, index in [0, 16).

    Returns:
        float32 [22, 3]: (dx, dy, dtheta) in abstract steps, in the robot frame of the start state. At headings that are
        not multiples of 90 degrees the positions are fractional.
    """
    goals = ABSTRACT_ACTIONS.astype(float)
    goals[:, :2] = goals[:, :2] @ rotation(float(heading_angle(-abstract_heading, ABSTRACT_HEADINGS))).T
    return goals.astype(np.float32)


def abstract_shape(shape: tuple[int, int]) -> tuple[int, int]:
    """Number of whole abstract cells (a, b) of a grid of ``shape`` detailed cells."""
    return shape[0] // CELLS_PER_ABSTRACT, shape[1] // CELLS_PER_ABSTRACT


def abstract_anchor(abstract: np.ndarray) -> np.ndarray:
    """Detailed base state (ix, iy, heading), int64 [..., 3], at which an abstract state (a, b, k) [..., 3] is
    anchored."""
    abstract = np.asarray(abstract, dtype=np.int64)
    scale = np.array([CELLS_PER_ABSTRACT, CELLS_PER_ABSTRACT, HEADINGS_PER_ABSTRACT])
    return abstract * scale + np.array([ABSTRACT_ANCHOR, ABSTRACT_ANCHOR, 0])


def detailed_to_abstract(states: np.ndarray) -> np.ndarray:
    """T_d->a (paper, Sec. V-B): abstract states, int64 [..., 3], of detailed states [..., >=3] given in lattice units.

    Foot offsets are dropped, the position falls into its abstract cell, the heading goes to the nearest abstract
    heading.
    """
    states = np.asarray(states, dtype=np.int64)
    heading = (states[..., 2] + HEADINGS_PER_ABSTRACT // 2) // HEADINGS_PER_ABSTRACT % ABSTRACT_HEADINGS
    position = states[..., :2] // CELLS_PER_ABSTRACT
    return np.concatenate([position, heading[..., None]], axis=-1)


def abstract_steps(displacement: np.ndarray) -> np.ndarray:
    """Displacements (dx, dy, dtheta) [..., 3] in metres and radians, in abstract steps of 10 cm and 22.5 degrees."""
    return np.asarray(displacement, dtype=float) / _ABSTRACT_STEP


def abstract_steps_to_world(steps: np.ndarray) -> np.ndarray:
    """Displacements [..., 3] in metres and radians of (dx, dy, dtheta) in abstract steps; undoes `abstract_steps`."""
    return np.asarray(steps, dtype=float) * _ABSTRACT_STEP


_ABSTRACT_STEP = np.array([ABSTRACT_RESOLUTION, ABSTRACT_RESOLUTION, 2 * math.pi / ABSTRACT_HEADINGS])


@dataclass(frozen=True)
class Grid:
    """Placement of a detailed grid in the world.

    Attributes:
        origin: world (x, y) in metres of the lower corner of cell (0, 0).
        shape: number of cells (nx, ny).
    """

    origin: tuple[float, float]
    shape: tuple[int, int]

    def cell(self, xy) -> np.ndarray:
        """Cells, int64 [..., 2], that contain the world positions ``xy`` [..., 2] in metres (may lie outside the
        grid)."""
        # The small shift keeps a coordinate that was computed as "edge of a cell" from falling below it by rounding
        # error.
        scaled = (np.asarray(xy, dtype=float) - np.asarray(self.origin)) / RESOLUTION
        return np.floor(scaled + 1e-6).astype(np.int64)

    def center(self, cells) -> np.ndarray:
        """World positions [..., 2] in metres of the centres of ``cells`` [..., 2]."""
        return (np.asarray(cells, dtype=float) + 0.5) * RESOLUTION + np.asarray(self.origin)

    def contains(self, cells) -> np.ndarray:
        """Whether each of ``cells`` [..., 2] lies in the grid; bool [...]."""
        cells = np.asarray(cells)
        return ((cells >= 0) & (cells < np.asarray(self.shape))).all(axis=-1)

    def to_lattice(self, pose, feet=(0.0, 0.0, 0.0, 0.0)) -> np.ndarray:
        """Detailed state, int64 [7], of a world pose (x, y, theta) and foot offsets in metres.

        Raises:
            InputError: if a value is not finite or the position lies outside the grid.
        """
        values = np.asarray([*pose, *feet], dtype=float)
        if values.shape != (7,) or not np.isfinite(values).all():
            raise InputError(
                f"state {tuple(pose)} with feet {tuple(feet)}: need x, y, theta and 4 foot offsets, all finite"
            )
        cell = self.cell(values[:2])
        if not self.contains(cell):
            low, high = self.center((0, 0)), self.center(np.asarray(self.shape) - 1)
            raise InputError(
                f"position ({values[0]:g}, {values[1]:g}) m is outside the map, which spans "
                f"x {low[0]:.3f} to {high[0]:.3f} m and y {low[1]:.3f} to {high[1]:.3f} m"
            )
        return np.array([*cell, heading_index(values[2]), *offset_steps(values[3:])], dtype=np.int64)

    def to_world(self, states) -> np.ndarray:
        """World states, float64 [..., 7] (m, m, rad, 4 x m), of detailed states [..., 7] in lattice units."""
        states = np.asarray(states)
        pose = [self.center(states[..., :2]), heading_angle(states[..., 2])[..., None]]
        return np.concatenate([*pose, states[..., 3:] * RESOLUTION], axis=-1)


def offset_steps(metres) -> np.ndarray:
    """Foot offsets or other lengths in metres as whole lattice steps, int64."""
    return np.rint(np.asarray(metres, dtype=float) / RESOLUTION).astype(np.int64)


def cells(metres: float) -> float:
    """A length in metres, in (fractional) detailed cells."""
    return metres / RESOLUTION
