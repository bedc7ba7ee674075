"""An independent check of named causes: plain and slow, from the heights of the map and the robot's file alone."""

import math

import numpy as np

from hdsp.detailed.causes import Kind
from hdsp.robot.robot import FEET

CELL = 0.025
ROUNDING = 0.75 * CELL  # m, between a point and the centre of its cell, diagonally


def complaints(cause, terrain, robot):
    """Returns the statements of a cause that the map does not bear out, in words; the map has cells of 2.5 cm."""
    checks = {
        Kind.UNKNOWN: _unknown, Kind.BORDER: _border, Kind.EDGE: _edge, Kind.SLOPE: _slope, Kind.BODY: _body,
        Kind.REACH: _reach, Kind.SEPARATION: _separation, Kind.HEADING: _heading,
    }  # fmt: skip
    found = [*checks[cause.kind](cause, terrain, robot), *_place_of_foot(cause, robot)]
    return [f"{cause}: {words}" for words in found]


def gap_complaints(gap):
    """A gap never has equal ends."""
    same = len(gap.near) == len(gap.far) and np.allclose(gap.near, gap.far, atol=1e-9)
    return [f"{gap}: from a pose to itself"] if same else []


def _cell(terrain, place):
    return tuple(math.floor((value - low) / CELL + 1e-6) for value, low in zip(place, terrain.origin, strict=True))


def _on_map(terrain, cell):
    return 0 <= cell[0] < terrain.shape[0] and 0 <= cell[1] < terrain.shape[1]


def _height(terrain, cell):
    return float(terrain.heights[cell]) if _on_map(terrain, cell) else math.nan


def _height_difference(terrain, cell):
    """Largest difference to a known neighbour; inf for an unknown cell."""
    here = _height(terrain, cell)
    if math.isnan(here):
        return math.inf
    around = [_height(terrain, (cell[0] + i, cell[1] + j)) for i in (-1, 0, 1) for j in (-1, 0, 1)]
    return max(abs(height - here) for height in around if not math.isnan(height))


def _unknown(cause, terrain, robot):
    cell = _cell(terrain, cause.place)
    if not _on_map(terrain, cell):
        return ["off the map"]
    return [] if math.isnan(_height(terrain, cell)) else ["the ground is known"]


def _border(cause, terrain, robot):
    return ["on the map"] if _on_map(terrain, _cell(terrain, cause.place)) else []


def _edge(cause, terrain, robot):
    difference = _height_difference(terrain, _cell(terrain, cause.place))
    found = [] if abs(difference - cause.amount) < 1e-5 else [f"the height difference is {difference}"]
    return found + ([] if difference > robot.drive.highest_edge else ["a wheel passes it"])


def _slope(cause, terrain, robot):
    """Some line through the cell, between known cells without edges, is as steep as said, and steeper than a limit."""
    x, y = _cell(terrain, cause.place)
    steepest, highest = 0.0, robot.drive.highest_edge
    for i in range(-8, 9):
        for j in range(-8, 9):
            ends = (x + i, y + j), (x - i, y - j)
            if (i, j) == (0, 0) or any(_height_difference(terrain, end) > highest for end in ends):
                continue
            rise = abs(_height(terrain, ends[0]) - _height(terrain, ends[1]))
            if rise > highest:
                steepest = max(steepest, math.atan(rise / (2 * CELL * math.hypot(i, j))))
    limit = min(robot.slope.max_pitch, robot.slope.max_roll)
    found = [] if steepest >= cause.amount - 1e-5 else [f"the ground is {math.degrees(steepest):.1f} degrees steep"]
    return found + ([] if cause.amount > limit else ["within the limit"])


def _body(cause, terrain, robot):
    """A box of the body at the pose lies over the place, and its lower side below the ground there."""
    height = _height(terrain, _cell(terrain, cause.place))
    if not abs(height - cause.amount) < 1e-5:
        return [f"the ground is {height}"]
    x, y, theta, *offsets = cause.pose
    feet = [(fx + offset, fy) for (fx, fy), offset in zip(robot.neutral_feet().tolist(), offsets, strict=True)]
    on_map = [
        (x + math.cos(theta) * fx - math.sin(theta) * fy, y + math.sin(theta) * fx + math.cos(theta) * fy)
        for fx, fy in feet
    ]
    known = [[h for h in _around(terrain, at) if not math.isnan(h)] for at in on_map]
    # The lowest ground near each foot bounds the body's height from below, the highest from above.
    if any(not heights for heights in known):
        return []
    lean = max(max(h) for h in known) - min(min(h) for h in known)
    highest = max(max(h) for h in known) + lean
    dx, dy = cause.place[0] - x, cause.place[1] - y
    ahead, left = math.cos(theta) * dx + math.sin(theta) * dy, math.cos(theta) * dy - math.sin(theta) * dx
    boxes = [
        box for box in robot.body.boxes
        if box.x_min - ROUNDING <= ahead <= box.x_max + ROUNDING and abs(left) <= box.half_width + ROUNDING
    ]  # fmt: skip
    if not boxes:
        return ["no part of the body is there"]
    lowest = min(min(h) for h in known) - lean
    return [] if any(height > lowest + box.above for box in boxes) else [f"the body is higher, {lowest} to {highest}"]


def _around(terrain, place):
    cell = _cell(terrain, place)
    return [_height(terrain, (cell[0] + i, cell[1] + j)) for i in (-1, 0, 1) for j in (-1, 0, 1)]


def _reach(cause, terrain, robot):
    offset = cause.pose[3 + FEET.index(cause.foot)]
    inside = robot.feet.offset_min - 1e-9 <= offset <= robot.feet.offset_max + 1e-9
    return ["within its reach"] if inside or offset != cause.amount else []


def _separation(cause, terrain, robot):
    return [] if cause.amount < robot.feet.min_separation else ["far enough"]


def _heading(cause, terrain, robot):
    return [] if _on_map(terrain, _cell(terrain, cause.place)) else ["off the map"]


def _place_of_foot(cause, robot):
    """The foot is where its pose puts it, and the place of the cause is within its clearance."""
    if cause.foot is None or cause.foot_place is None:
        return []
    found = []
    if cause.pose is not None:
        at = robot.foot_positions(np.array(cause.pose))[FEET.index(cause.foot)]
        if math.dist(at, cause.foot_place) > ROUNDING:
            found.append(f"the foot is at {at}")
    if math.dist(cause.place, cause.foot_place) > robot.feet.clearance + 1e-6:
        found.append("farther away than the clearance")
    return found
