"""Terrain and robot, compiled into arrays for the search kernels.

The maps are one-dimensional. No foot can stand on their border, so kernels need no bounds check.
"""

import itertools
import math
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from hdsp.base.errors import InputError
from hdsp.base.jit import njit
from hdsp.base.records import by_reference
from hdsp.detailed.states import MAX_CELLS, pack_steps
from hdsp.detailed.world.geometry import (
    MOVE_SAMPLES,
    ArcMoves,
    arc_moves,
    base_cells,
    base_shifts,
    contact_cells,
    foot_cells,
    outline_cells,
    rectangle_cells,
    step_line,
)
from hdsp.robot.lattice import DRIVE_MOVES, HEADINGS, cells, heading_angle, metres
from hdsp.robot.robot import Robot
from hdsp.terrain.cost_maps import EVERY_HEADING, CostMaps, cost_maps, disc_mask
from hdsp.terrain.height_map import HeightMap
from hdsp.terrain.rounding import height_tolerance

_CELL = metres(1.0)  # m, side of a cell


@by_reference
class Tables(NamedTuple):
    """Values for a robot and the size of the padded map, independent of the terrain."""

    feet: np.ndarray  # int32 [64 * 4 * offsets * samples], foot cell relative to base cell
    contacts: np.ndarray  # int32, the same, plus the start of the foot's layer in ``World.uneven``
    contact_offsets: np.ndarray  # int64 [layers, 2], for the layers in ``World.uneven``
    n_offsets: int
    n_samples: int
    lowest: int  # smallest foot offset, steps
    move_dx: np.ndarray  # int64 [20]
    move_dy: np.ndarray
    move_flat: np.ndarray  # int64 [20]
    move_key: np.ndarray  # int64 [20], change of a packed state by the move
    move_first: np.ndarray  # int64 [20]
    move_count: np.ndarray
    deviation: np.ndarray  # float64 [64, 20], factor on driving, inf if impossible
    # float64 [2, 64, 24], length times factor; [1] for feet not level: inf unless straight. The last four columns are
    # arcs, inf for a robot that turns on the spot.
    drive_price: np.ndarray
    base_sample: np.ndarray  # int64 [samples]
    # One array, because each one costs time at every call: int64 [64, 4, 5 + 5 * samples]. For each arc: displacement
    # dx, dy, flat, as a change of a packed state; number of samples; then for each sample the base and the contacts of
    # four neutral feet, as in ``base_sample`` and ``contacts``.
    arcs: np.ndarray
    shifts: np.ndarray  # int64 [64, 3]
    line: np.ndarray  # int64 [64, longest step + 1]
    box_cells: np.ndarray  # int64 [boxes, 64, n]
    box_count: np.ndarray  # int64 [boxes, 64]
    # int64 [boxes, 64, m, 3], box cells next to each other along y: the first one, its number in ``box_cells``, and how
    # many they are; 0 ends the rows.
    box_runs: np.ndarray
    box_above: np.ndarray  # float64 [boxes]
    box_dx: np.ndarray  # float32 [boxes, 64, n], the box cells in the map frame, cells
    box_dy: np.ndarray
    ahead: np.ndarray  # float64 [64, 2], direction of the heading in the map frame
    corner: np.ndarray  # float64 [2], farthest box cell ahead and to the side, cells
    outline: np.ndarray  # int64 [64, n], cells on the outline of the rectangle between neutral feet


@by_reference
class Constants(NamedTuple):
    """Scalars in the cost model, in metres and unitless costs."""

    unevenness: float
    turn: float
    turn_unevenness: float
    on_the_spot: bool  # whether the robot turns on the spot; otherwise it drives arcs
    level: float
    foot_move: float
    base_shift: float
    shift_backward: bool
    step_backward: bool
    step: float
    step_per_metre: float
    step_per_height: float
    step_max_height: float
    step_max_clearance: float
    support_margin: float
    neutral_x: float
    neutral_y: float
    min_separation: int
    neutral_penalty: float  # in units of S, per step off the neutral position
    steepest_ahead: float  # largest gradients, m per cell
    steepest_left: float


@by_reference
class World(NamedTuple):
    """Terrain with nx x ny cells inside a border of ``pad`` cells.

    Flat index: ``(ix + pad) * stride + iy + pad``.
    """

    nx: int
    ny: int
    pad: int
    stride: int
    standable: np.ndarray  # bool flat: whether a foot can stand
    uneven: np.ndarray  # float32 [layers * cells]: S under a foot in a cell, inf without a foothold; one layer per
    # offset between a foot's cell and the middle of its contact (``Tables.contact_offsets``)
    height: np.ndarray  # float32 flat; -inf where unknown
    swing: np.ndarray  # float32 flat: highest cell within a foot's clearance, inf next to unknown cells
    window_height: np.ndarray  # float32 flat: highest cell within the body's reach
    edge: np.ndarray  # bool flat: no wheel passes at any heading, because of an edge or a steep slope
    steep: np.ndarray  # uint64 flat: bit h set if the ground is too steep at heading h; empty if slopes have one limit
    steps: np.ndarray  # uint64 flat: bit h set if a foot here can step toward heading h
    banned: np.ndarray  # int64 [n, 7]: steps closed to the search (``manoeuvres.is_banned``)
    base: np.ndarray  # uint8 [64 * cells]: the base on neutral feet, ``body.FREE`` or ``BLOCKED``; 0 = not yet computed
    level_ground: np.ndarray  # float32 [64 * cells]: lowest ground (m) with a free level body, 0 = not yet computed
    tables: Tables
    constants: Constants


@njit(inline="always")
def cell_index(world, ix, iy):
    """Flat index of a map cell."""
    return (ix + world.pad) * world.stride + iy + world.pad


def build_world(terrain: HeightMap, robot: Robot, maps: CostMaps | None = None) -> World:
    """Compiles a terrain for a robot.

    Args:
        terrain: height map.
        robot: robot.
        maps: its cost maps, if they exist already.

    Raises:
        InputError: the map has more cells than packed states and tables can address.
    """
    from scipy.ndimage import maximum_filter  # half a second to import, and ``import hdsp`` shall be quick

    nx, ny = terrain.heights.shape
    if max(nx, ny) > MAX_CELLS:
        raise InputError(f"height map of {nx} x {ny} cells: a side may have at most {MAX_CELLS} cells")
    maps = maps or cost_maps(terrain, robot)
    pad = math.ceil(cells(robot.reach())) + 2 + max(2, int(abs(arc_moves(robot).displacement).max()))
    stride = ny + 2 * pad
    heights = np.where(np.isnan(terrain.heights), -np.inf, terrain.heights).astype(np.float32)
    window = 2 * math.ceil(_body_reach(robot)) + 1

    def padded(values, border):
        return np.pad(values, pad, constant_values=border).astype(np.float32).ravel()

    tables = robot_tables(robot, stride, (nx + 2 * pad) * stride)
    constants = _constants(robot)
    height, standable = padded(heights, -np.inf), np.pad(maps.standable, pad).ravel()
    longest = 2 * tables.line.shape[1] - 1
    every = maps.steep == EVERY_HEADING
    barrier = maps.edge | every
    near_edge = np.pad(maximum_filter(barrier, longest, mode="constant", cval=False), pad).ravel()
    edge = np.pad(barrier, pad).ravel()
    one_limit = robot.slope.max_pitch == robot.slope.max_roll
    limits = constants.step_max_height, constants.step_max_clearance
    lifted = np.where(np.isnan(terrain.heights), np.inf, terrain.heights).astype(np.float32)
    disc = disc_mask(cells(robot.feet.clearance))
    swing = padded(maximum_filter(lifted, footprint=disc, mode="constant", cval=-np.inf), np.inf)
    steps = _possible_steps(standable, height, swing, edge, near_edge, tables.line, *limits)
    return World(
        nx=nx,
        ny=ny,
        pad=pad,
        stride=stride,
        standable=standable,
        uneven=_uneven_under_feet(np.pad(maps.unevenness, pad), standable, robot, tables.contact_offsets),
        height=height,
        swing=swing,
        edge=edge,
        steep=np.empty(0, np.uint64) if one_limit else np.pad(maps.steep, pad).ravel(),
        window_height=padded(maximum_filter(heights, window, mode="constant", cval=-np.inf), -np.inf),
        steps=steps,
        banned=np.empty((0, 7), dtype=np.int64),
        base=np.zeros(HEADINGS * len(standable), dtype=np.uint8),
        level_ground=np.zeros(HEADINGS * len(standable), dtype=np.float32),
        tables=tables,
        constants=constants,
    )


def _body_reach(robot: Robot) -> float:
    corners = [math.hypot(max(abs(r.x_min), abs(r.x_max)), r.half_width) for r in robot.body.boxes]
    return cells(max(corners, default=0.0))


def _uneven_under_feet(unevenness: np.ndarray, standable: np.ndarray, robot: Robot, offsets: np.ndarray) -> np.ndarray:
    """``World.uneven`` for S on the padded map, float32 [nx, ny]."""
    under = unevenness.ravel()
    footholds = np.flatnonzero(standable)
    layers = np.full((len(offsets), len(standable)), np.inf, dtype=np.float32)
    # No foothold is so near the border that its contact would lie beyond it.
    for layer, (dx, dy) in zip(layers, offsets, strict=True):
        layer[footholds] = under[footholds + (dx * unevenness.shape[1] + dy)]
    return layers.ravel()


def _constants(robot: Robot) -> Constants:
    step, (ahead, left) = robot.step, robot.slope.steepest()
    return Constants(
        unevenness=robot.drive.unevenness_cost,
        turn=robot.turn.cost,
        turn_unevenness=robot.turn.unevenness_cost,
        on_the_spot=robot.turn.on_the_spot,
        level=robot.drive.level,
        foot_move=robot.foot_move.cost_per_metre * _CELL,
        base_shift=robot.base_shift.cost_per_metre * _CELL,
        shift_backward=robot.base_shift.backward,
        step_backward=step.backward,
        step=step.cost,
        step_per_metre=step.cost_per_metre,
        step_per_height=step.cost_per_height,
        step_max_height=step.max_height,
        step_max_clearance=step.max_clearance,
        support_margin=cells(step.support_margin),
        neutral_x=round(cells(robot.feet.neutral_x), 9),  # without it, 0.3 m is less than 12 cells
        neutral_y=round(cells(robot.feet.neutral_y), 9),
        neutral_penalty=robot.feet.neutral_preference * _CELL / robot.drive.unevenness_cost,
        min_separation=math.ceil(cells(robot.feet.min_separation) - 1e-9),
        steepest_ahead=ahead * _CELL,
        steepest_left=left * _CELL,
    )


@lru_cache(maxsize=16)
def robot_tables(robot: Robot, stride: int, size: int) -> Tables:
    """Tables for padded maps with ``size`` cells, ``stride`` of them along y."""

    def flat(offsets):
        return offsets[..., 0] * stride + offsets[..., 1]

    feet, arcs = flat(foot_cells(robot)), arc_moves(robot)
    between = contact_cells(robot) - foot_cells(robot)
    offsets = np.concatenate([between.reshape(-1, 2), (arcs.contacts - arcs.feet).reshape(-1, 2)])
    contact_offsets, layer = np.unique(offsets, axis=0, return_inverse=True)
    layer = layer.ravel()
    arc_feet = flat(arcs.feet)
    if len(contact_offsets) * size > np.iinfo(np.int32).max:
        most = np.iinfo(np.int32).max // len(contact_offsets)
        raise InputError(f"height map of {size} cells, border included: at most {most} cells fit for this robot")
    contacts = feet + layer[: feet.size].reshape(feet.shape) * size
    arc_contacts = arc_feet + layer[feet.size :].reshape(arc_feet.shape) * size
    boxes = [[rectangle_cells(box, h) for h in range(HEADINGS)] for box in robot.body.boxes]
    widest = max(len(c) for box in boxes for c in box)
    box_offsets = np.zeros((len(boxes), HEADINGS, widest, 2), dtype=np.int64)
    for i, box in enumerate(boxes):
        for h, offsets in enumerate(box):
            box_offsets[i, h, : len(offsets)] = offsets
    travel = np.arctan2(DRIVE_MOVES[:, 1], DRIVE_MOVES[:, 0])
    turned = travel[None, :] - heading_angle(np.arange(HEADINGS))[:, None]
    deviation = abs(np.mod(turned + math.pi, 2 * math.pi) - math.pi)
    factor = np.vectorize(robot.drive.factor, otypes=[float])(np.round(deviation, 12))
    length = metres(np.hypot(DRIVE_MOVES[:, 0], DRIVE_MOVES[:, 1]))
    straight = np.minimum(deviation, math.pi - deviation) <= robot.drive.straight_deviation + 1e-9
    drive_price = np.stack([length * factor, np.where(straight, length * factor, np.inf)])
    # No arc has no length.
    arc_price = np.maximum(metres(np.hypot(arcs.displacement[..., 0], arcs.displacement[..., 1])), 1e-9) * arcs.factor
    return Tables(
        feet=np.ascontiguousarray(feet.astype(np.int32).ravel()),
        contacts=np.ascontiguousarray(contacts.astype(np.int32).ravel()),
        contact_offsets=contact_offsets,
        n_offsets=feet.shape[2],
        n_samples=feet.shape[3],
        lowest=robot.offset_range()[0],
        move_dx=DRIVE_MOVES[:, 0].copy(),
        move_dy=DRIVE_MOVES[:, 1].copy(),
        move_flat=flat(DRIVE_MOVES),
        move_key=pack_steps(DRIVE_MOVES),
        move_first=MOVE_SAMPLES.first,
        move_count=MOVE_SAMPLES.counts,
        deviation=factor,
        drive_price=np.concatenate([drive_price, np.stack([arc_price, np.full_like(arc_price, np.inf)])], axis=2),
        base_sample=flat(base_cells()),
        arcs=_arc_table(arcs, flat, arc_contacts),
        shifts=base_shifts(),
        line=flat(step_line(robot)),
        box_cells=flat(box_offsets),
        box_count=np.array([[len(c) for c in box] for box in boxes], dtype=np.int64).reshape(len(boxes), HEADINGS),
        box_runs=_runs([[flat(offsets) for offsets in box] for box in boxes]),
        box_above=np.array([box.above for box in robot.body.boxes], dtype=np.float64),
        box_dx=np.ascontiguousarray(box_offsets[..., 0], dtype=np.float32),
        box_dy=np.ascontiguousarray(box_offsets[..., 1], dtype=np.float32),
        ahead=np.stack([np.cos(heading_angle(np.arange(HEADINGS))), np.sin(heading_angle(np.arange(HEADINGS)))], 1),
        corner=cells(
            np.array(
                [
                    max(max(abs(box.x_min), abs(box.x_max)) for box in robot.body.boxes),
                    max(box.half_width for box in robot.body.boxes),
                ]
            )
        ),
        outline=flat(outline_cells(robot)),
    )


def _runs(boxes: Sequence[Sequence[np.ndarray]]) -> np.ndarray:
    """``Tables.box_runs`` for the flat cells of each box at each heading, in ascending order."""
    rows = []
    for box in itertools.chain(*boxes):
        first = np.flatnonzero(np.diff(box, prepend=box[:1] - 2) != 1)
        rows.append(np.stack([box[first], first, np.diff(first, append=len(box))], axis=1))
    result = np.zeros((len(rows), 1 + max(map(len, rows)), 3), np.int64)
    for target, row in zip(result, rows, strict=True):
        target[: len(row)] = row
    return result.reshape(len(boxes), HEADINGS, -1, 3)


def _arc_table(arcs: ArcMoves, flat: Callable[[np.ndarray], np.ndarray], contacts: np.ndarray) -> np.ndarray:
    """``Tables.arcs``."""
    moved = arcs.displacement
    keys = pack_steps(moved.reshape(-1, 2)).reshape(moved.shape[:2])
    samples = np.concatenate([flat(arcs.base)[..., None], contacts], axis=3).reshape(*moved.shape[:2], -1)
    own = np.stack([moved[..., 0], moved[..., 1], flat(moved), keys, arcs.counts], axis=2)
    return np.ascontiguousarray(np.concatenate([own, samples], axis=2))


@njit(nogil=True)
def _possible_steps(standable, height, swing, edge, near_edge, line, max_height, max_clearance):
    """Headings toward which a foot in a cell can step over an edge, as bits; uint64 flat."""
    n_headings, reach = line.shape
    result = np.zeros(len(standable), dtype=np.uint64)
    longest = np.max(np.abs(line))
    for p in range(longest, len(standable) - longest):
        if not (near_edge[p] and standable[p]):
            continue
        for h in range(n_headings):
            if standable[p + line[h, 1]]:
                continue
            crossed = False
            highest = height[p]
            for n in range(1, reach):
                q = p + line[h, n]
                highest = max(highest, swing[q])
                crossed = crossed or edge[q]
                if crossed and standable[q] and step_fits(height[p], height[q], highest, max_height, max_clearance):
                    result[p] |= np.uint64(1) << np.uint64(h)
                    break
    return result


@njit(inline="always")
def step_fits(before, after, highest, max_height, max_clearance):
    """Whether a foot can step from height ``before`` over ``highest`` to ``after`` (all m)."""
    rounding = height_tolerance(before)
    return abs(after - before) <= max_height + rounding and highest - min(before, after) <= max_clearance + rounding


@njit(inline="always")
def step_effort(fixed, per_metre, per_height, length, before, after):
    """Cost factor for a step: ``length`` in cells, from height ``before`` to ``after`` (m)."""
    return fixed + per_metre * length * _CELL + per_height * abs(after - before)
