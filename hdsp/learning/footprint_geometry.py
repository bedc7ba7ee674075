"""Geometry of the footprint network: its options, and the cells at which it reads the ground.

The network (``hdsp.learning.networks.footprint``) and its evaluation without torch (``hdsp.learning.inference``) share
these values. Importing this module imports no torch.
"""

import math
from typing import Annotated, Self

import numpy as np
from pydantic import Field, model_validator

from hdsp.base.errors import InputError
from hdsp.base.settings import Count, NotNegative, Positive, checked, fault
from hdsp.learning.learning_settings import HeightEncoding, Width
from hdsp.robot.lattice import ABSTRACT_HEADINGS, PATCH_CELLS, cells
from hdsp.robot.shape import Box

#: Largest base displacement along an axis, in cells: the longest action at any heading residue.
REACH = 9
#: Side of the square with all judged base positions.
POSES = 2 * REACH + 1
#: Poses on the way to a goal, including start and goal.
SAMPLES = 5
#: Foot positions at the start for a network without stance, in cells from the base. The network reads a wide strip
#: around them, so the robot's feet may stand some cells away.
FOOT = (13, 10)
#: Signs (x, y) of the feet: front left, rear left, rear right, front right.
FEET = ((1, 1), (-1, 1), (-1, -1), (1, -1))
#: Offsets in cells, ahead of each foot and behind it, at which features (LINE) and heights (PROFILE) are read; they
#: cover the foot reach and the way to a goal.
LINE = tuple(range(-15, 16, 3))
PROFILE = tuple(range(-18, 19, 3))
LINE_RADIUS = 3
#: Radius in cells of the first convolution.
NEAR_RADIUS = 2
#: Window radius in cells around each tap; its highest and lowest points are compared with the ground at the base.
GROUND_RADIUS = 2
#: Step in cells between the footprints in the summary over all footprints around the start.
CONTEXT_STEP = 3
#: Features per goal, see ``hdsp.learning.networks.goals.goal_features``.
GOAL_FEATURES = 7
#: Range in metres of heights relative to the ground at the base.
RELATIVE = (-0.5, 0.8)
#: Widths, in shares, of the sigmoids that compare a share with 1.
SHARPNESS = (0.02, 0.2)
#: Shares are clipped at this value.
MOST = 3.0
#: Features per pose: three shares, each with its two sigmoids, and the drive cost.
POSE_FEATURES = 3 * (1 + len(SHARPNESS)) + 1
#: Additional features per foot: the height under it, and whether an edge is too close.
REQUIREMENT_FEATURES = POSE_FEATURES + 2 * len(FEET)
#: Features of each foot at a pose: its offset, its height, and whether it has a foothold; and of its way ahead: whether
#: a step is too long or too high (on a way back: whether something bars it), the number of steps, their cost, and
#: whether the way leads back.
FOOT_PLACE, FOOT_WAY = 3, 4
#: Features of all feet on the way to a goal: at the start, at the goal, between both, and whether the goal lies ahead.
WAY_FEATURES = len(FEET) * (2 * FOOT_PLACE + FOOT_WAY) + 1
#: Features of a manoeuvre (whether there is one, the number of steps, their cost, the length of base shifts), and of
#: the drive between two of them (share of poses without footholds, way along x and y).
MANOEUVRE, DRIVE_BETWEEN = 4, 3
#: Additional features with ``FootWayOptions.manoeuvres``: away from the start, on to the goal, and the drive between.
MANOEUVRE_FEATURES = 2 * MANOEUVRE + DRIVE_BETWEEN
#: Poses on the drive between two manoeuvres; a power of two and one more, so that their positions have no rounding.
DRIVE_SAMPLES = 9
#: Units of these features: cells for an offset, cost for a step.
OFFSET_UNIT, STEP_COST_UNIT = 12.0, 0.1
#: Goals lie ahead up to this distance from the robot's axis, in cells.
ASIDE = 2
#: Tolerances: of a share at its limit, of heights at a limit in metres, and of unevenness that decides between two
#: footholds in metres.
SHARE_TOLERANCE, HEIGHT_TOLERANCE, ROUGH_TOLERANCE = 1e-4, 1e-5, 1e-3
#: Unevenness (m) of footholds is at most the first value where it decides, and the second one where it is unknown.
MOST_ROUGH, UNKNOWN_ROUGH = 500.0, 1000.0
#: Length (cells) and height (m) of a step up to which they count in its cost.
COUNTED_LENGTH, COUNTED_HEIGHT = 20, 0.8


@checked
class PoseRequirementOptions:
    """Robot limits from ``hdsp.robot.robot.Robot``; all lengths in metres.

    Attributes:
        neutral: neutral foot position, along x and along y.
        level: largest height difference among the feet for driving in all directions.
        clearance: distance that feet keep from edges no wheel passes.
        contact_inward: offset, from each foot toward the body, to the ground whose unevenness costs.
        unevenness_cost: drive cost per metre of unevenness.
        boxes: volumes that have to stay free.
        edge: highest edge that a wheel passes; None = from the wheel.
        wheel_radius, rolled_share: as in ``Drive``.
    """

    neutral: tuple[Positive, Positive]
    level: Positive
    clearance: Positive
    contact_inward: NotNegative
    unevenness_cost: NotNegative
    boxes: tuple[Box, ...]
    edge: Positive | None = None
    wheel_radius: Positive | None = None
    rolled_share: Positive | None = None

    @property
    def highest_edge(self) -> float:
        """Highest edge that a wheel passes, m.

        Raises:
            InputError: neither the edge nor the wheel is given.
        """
        if self.edge is not None:
            return self.edge
        if self.wheel_radius is None or self.rolled_share is None:
            raise InputError("model.options.stance.edge is None; need a number, or wheel_radius and rolled_share")
        return self.wheel_radius * self.rolled_share

    @property
    def clearance_cells(self) -> int:
        """Whole cells within the foot clearance."""
        return math.floor(cells(self.clearance) + 1e-9)


@checked
class FootWayOptions:
    """How feet move, from ``hdsp.robot.robot.Robot``; all lengths in metres.

    Attributes:
        reach: least and greatest offset of a foot from its neutral position, along x.
        max_length, max_height, max_clearance, cost, cost_per_metre, cost_per_height: as in ``Step``.
        manoeuvres: whether the manoeuvres from the start to the first pose on neutral feet, and from the last such pose
            to the goal, are features too.
    """

    reach: tuple[float, float]
    max_length: NotNegative
    max_height: NotNegative
    max_clearance: NotNegative
    cost: NotNegative
    cost_per_metre: NotNegative
    cost_per_height: NotNegative
    manoeuvres: bool = False

    @model_validator(mode="after")
    def _check(self) -> Self:
        if not self.reach[0] <= 0 <= self.reach[1]:
            raise fault("reach", self.reach, "a least offset up to 0 and a greatest one from 0")
        return self

    @property
    def offsets(self) -> tuple[int, int]:
        """Least and greatest offset of a foot, in cells."""
        return math.ceil(cells(self.reach[0]) - 1e-9), math.floor(cells(self.reach[1]) + 1e-9)

    @property
    def longest(self) -> int:
        """Longest step, in cells."""
        return math.floor(cells(self.max_length) + 1e-9)

    @property
    def cost_per_cell(self) -> float:
        """Cost of a step's length, per cell."""
        return self.cost_per_metre / cells(1.0)


@checked
class FootprintOptions:
    """Layer widths.

    Attributes:
        width: local feature channels.
        dilations: dilations of the 3 x 3 convolutions after the 5 x 5 one. Their sum is at most 7, so features reach 9
            cells far.
        taps: footprint points (along x, along y) at which local features are read; odd numbers.
        spacing: cells between taps. 9 x 7 taps with spacing 3 place one tap within 1 cell of each neutral foot.
        hidden: width of the first layer that sees a whole footprint.
        features: features kept per footprint.
        context: width of the summary over all footprints around the start; detours need it.
        feet: width of the ground summary ahead of and behind each foot at the start; steps need it.
        head: width of the layers that judge a way.
        planning: whether the network predicts costs for planning, too, as a second cost.
        stance: the robot's requirements on the ground at a pose, as input features. None: the network has to learn
            them.
        foot_ways: how feet move. The footholds of the feet at start and goal, and the steps between them, are then
            input features; needs ``stance``. None: the network has to learn them.
        steps: width of the layers that judge these features.
    """

    width: Width = 32
    dilations: tuple[Count, ...] = (1, 2, 4)
    taps: tuple[Count, Count] = (9, 7)
    spacing: Count = 3
    hidden: Width = 96
    features: Width = 48
    context: Width = 64
    feet: Width = 128
    head: Annotated[Width, Field(ge=2)] = 128
    planning: bool = False
    stance: PoseRequirementOptions | None = None
    foot_ways: FootWayOptions | None = None
    steps: Width = 64

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.foot_ways and not self.stance:
            raise fault("foot_ways", self.foot_ways, "None without stance")
        if sum(self.dilations) > 7:
            raise fault("dilations", self.dilations, "numbers that add up to at most 7")
        if any(n % 2 == 0 for n in self.taps) or max(self.taps) * self.spacing > 27:
            raise fault("taps", self.taps, f"odd numbers, and with spacing {self.spacing} within 27 cells")
        return self

    @property
    def costs(self) -> int:
        """Costs per goal: the label's, and with ``planning`` the one for planning."""
        return 2 if self.planning else 1

    @property
    def foot(self) -> tuple[int, int]:
        """Front left foot at the start, in cells from the base."""
        if self.stance is None:
            return FOOT
        x, y = self.stance.neutral
        return round(cells(x)), round(cells(y))

    @property
    def way_features(self) -> int:
        """Features of all feet on the way to a goal."""
        if self.foot_ways is None:
            return 0
        return WAY_FEATURES + (MANOEUVRE_FEATURES if self.foot_ways.manoeuvres else 0)

    @property
    def foot_region(self) -> tuple[int, int]:
        """Distances from the start, along x and along y in cells, up to which feet find footholds."""
        return self.foot[0] + PROFILE[-1], self.foot[1] + REACH

    @property
    def rough_reach(self) -> int:
        """Distance from the start along x, in cells, up to which the unevenness of footholds is known."""
        return self.foot[0] + REACH


def footprint_taps(options: FootprintOptions) -> np.ndarray:
    """Returns the footprint points in cells from the base, float32 [taps, 2]; y changes fastest."""
    x, y = ((np.arange(n) - n // 2) * options.spacing for n in options.taps)
    return _product(x, y)


def turn_angles() -> np.ndarray:
    """Returns the headings of a turn's poses after the start, float32 [8] radians: four to the left, four right."""
    shares = np.linspace(0, 1, SAMPLES, dtype=np.float32)[1:] * np.float32(2 * math.pi / ABSTRACT_HEADINGS)
    return np.concatenate([shares, -shares])


def rotated(points: np.ndarray, angles: np.ndarray) -> np.ndarray:
    """Rotates points [n, 2] by each angle; returns float32 [angles, n, 2]."""
    x, y = np.asarray(points, np.float32).T
    cos, sin = np.cos(angles)[:, None], np.sin(angles)[:, None]
    return np.stack([cos * x - sin * y, sin * x + cos * y], axis=-1)


def requirement_points(options: PoseRequirementOptions) -> list[np.ndarray]:
    """Returns the points that the requirements read, in cells from the base, groups of float32 [n, 2].

    Groups are: the base, the four feet, their four contacts, and each box; squares around a box's points, with radius
    ``GROUND_RADIUS``, cover the box.
    """
    signs, neutral = np.array(FEET), np.array(options.neutral)
    feet, contacts = cells(signs * neutral), cells(signs * (neutral - options.contact_inward))
    groups = [np.zeros((1, 2)), feet, contacts, *(_covering(box) for box in options.boxes)]
    return [np.asarray(group, np.float32) for group in groups]


def foot_cells(options: FootprintOptions) -> np.ndarray:
    """Returns the cells of the feet at a base, at the start heading and turned to the left and to the right.

    Returns:
        int64 [3, 4, 2, distances, 2]: for each heading and foot, cells behind the neutral position and ahead of it, by
        distance from it; distances beyond the foot's reach are far outside the region of the feet.
    """
    rules = options.foot_ways
    assert rules is not None
    low, high = rules.offsets
    distance = np.arange(max(-low, high) + 1)
    turns = np.array([0.0, 1.0, -1.0]) * (2 * math.pi / ABSTRACT_HEADINGS)
    assert options.stance is not None
    neutral = cells(np.array(options.stance.neutral))
    result = np.empty((len(turns), len(FEET), 2, len(distance), 2), np.int64)
    for foot, signs in enumerate(FEET):
        x, y = np.multiply(signs, neutral)
        for side, (offsets, limit) in enumerate(((-distance, -low), (distance, high))):
            at = np.stack([x + offsets, np.full(offsets.shape, y)], axis=-1)
            result[:, foot, side] = np.rint(rotated(at, turns)).astype(np.int64)
            result[:, foot, side, distance > limit] = 10 * PATCH_CELLS
    return result


def requirement_reach(options: PoseRequirementOptions) -> dict[str, np.ndarray]:
    """Returns, for each encoded channel, the distance within which requirements read it.

    Distances are int64 [2], along x and along y, in cells from the start.
    """
    points = requirement_points(options)
    straight = [np.abs(group.round()).max(axis=0) + REACH for group in points]
    turned = [np.abs(rotated(group, turn_angles()).round()).max(axis=(0, 1)) for group in points]
    _, feet, contacts, *bodies = np.maximum(straight, turned).astype(np.int64)
    highest = np.max([feet, *bodies], axis=0)
    return {"height": highest, "unevenness": contacts, "edge": feet + options.clearance_cells}


def read_reach(encoding: HeightEncoding, options: FootprintOptions) -> np.ndarray:
    """Returns the distances from the start beyond which the network reads no height, in cells.

    Returns:
        int64 [2], along x and along y.
    """
    taps = footprint_taps(options)
    turned = np.abs(rotated(taps, turn_angles())).max(axis=(0, 1))
    footprint = np.maximum(taps.max(axis=0) + REACH, np.ceil(turned) + 1).astype(np.int64)
    local = sum(options.dilations) + NEAR_RADIUS
    of_line = np.array((LINE[-1], 0)) + LINE_RADIUS + NEAR_RADIUS
    along = np.array(options.foot) + np.maximum(of_line, np.array((PROFILE[-1], 0)) + GROUND_RADIUS)
    within = dict.fromkeys(encoding.channels, np.maximum(footprint + max(local, GROUND_RADIUS), along))
    within["unevenness"] = footprint
    if options.stance:
        for name, reach in requirement_reach(options.stance).items():
            within[name] = np.maximum(within[name], reach + (GROUND_RADIUS if name == "height" else 0))
        profile = np.array(options.foot) + (PROFILE[-1], 0) + options.stance.clearance_cells
        within["edge"] = np.maximum(within["edge"], profile)
        if options.foot_ways:
            region = np.array(options.foot_region)
            within["edge"] = np.maximum(within["edge"], region + options.stance.clearance_cells)
            within["height"] = np.maximum(within["height"], region + encoding.unevenness_contact)
            rough = np.array((options.rough_reach, region[1]))
            within["unevenness"] = np.maximum(within["unevenness"], rough)
    return np.max([reach + encoding.radius(name) for name, reach in within.items()], axis=0)


def farthest_read(encoding: HeightEncoding, options: FootprintOptions) -> int:
    """Returns the larger distance of ``read_reach``."""
    return int(read_reach(encoding, options).max())


def _covering(box: Box) -> np.ndarray:
    spans = ((box.x_min, box.x_max), (-box.half_width, box.half_width))
    axes, radius = [], GROUND_RADIUS
    for low, high in spans:
        low, high = math.ceil(cells(low)), math.floor(cells(high))  # cells with their centre inside
        low, high = min(low + radius, (low + high) // 2), max(high - radius, (low + high) // 2)
        axes.append(np.linspace(low, high, math.ceil((high - low) / (2 * radius + 1)) + 1))
    return _product(*axes)


def _product(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    return np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2).astype(np.float32)
