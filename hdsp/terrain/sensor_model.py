"""Height maps such as a robot makes of a place: noisy, with rounded edges, and unknown where no sensor looked.

Random terrain is exact and wholly known, maps of real places are neither. Labels of a degraded map are those of the
planner on that map, which is what a network gets to see, so nothing of this makes a label wrong. What is done follows
how maps of scans come about (`hdsp.terrain.pointcloud.cloud_mapping`): points of a few sensor positions, small holes filled, heights
averaged; the strengths are set by the maps of simulated and real scans.

Convention: maps as in `hdsp.terrain.height_map`; the robot starts at the centre of cell (nx // 2, ny // 2).
"""

import math
from dataclasses import dataclass, fields

import numpy as np

from hdsp.base.errors import InputError
from hdsp.base.jit import njit
from hdsp.terrain.filling import filled, smoothed
from hdsp.terrain.height_map import HeightMap

_HIGHER = 0.03  # m by which the ground must be above a ray to end it
_JUMP = 0.05  # m; heights that differ by more make mixed cells


@dataclass(frozen=True)
class SensingSettings:
    """How far maps are degraded, at most. Of each amount a map has a share, drawn anew.

    Shares are uniform in [0, 1]; those of tilt and noise are squares of such numbers.

    Attributes:
        tilt: slope of the whole map in a random direction, rad.
        bumps: standard deviation of the ground's own waves, m, which are about ``bump_size`` m wide.
        jitter: standard deviation, in cells, of how far edges are displaced.
        mixed: share of the cells at an edge that take a height between those around.
        white, correlated: standard deviations of two noises, m, the second alike within a few cells.
        sensors: least and greatest number of positions from which the place was seen.
        sensor_distance, sensor_height: ranges of how far from the start and how high above its ground these are, m.
        borders: probability, twice, that all beyond a straight line is unknown.
        holes: mean number of unknown spots.
        around: m around the start that were always seen: the robot got there.
        fill, smooth: as of `hdsp.terrain.pointcloud.MapSettings`, cells and m.

    Raises:
        InputError: for a value out of range.
    """

    tilt: float = 0.087
    bumps: float = 0.01
    bump_size: float = 0.3
    jitter: float = 0.7
    mixed: float = 0.5
    white: float = 0.012
    correlated: float = 0.003
    sensors: tuple[int, int] = (1, 4)
    sensor_distance: tuple[float, float] = (0.0, 3.0)
    sensor_height: tuple[float, float] = (0.8, 1.8)
    borders: float = 0.4
    holes: float = 2.0
    around: float = 0.35
    fill: int = 3
    smooth: float = 0.03

    def __post_init__(self):
        for field in fields(self):
            value = getattr(self, field.name)
            if isinstance(field.default, tuple):
                if isinstance(value, str) or len(value) != 2 or not 0 <= value[0] <= value[1] < math.inf:
                    raise InputError(
                        f"sensing.{field.name} is {value!r}; need two numbers from 0, the smaller one first"
                    )
                object.__setattr__(self, field.name, tuple(value))
            elif not (isinstance(value, int | float) and 0 <= value < math.inf):
                raise InputError(f"sensing.{field.name} is {value!r}; need a number of at least 0")
        if self.sensors[0] < 1 or any(count != int(count) for count in self.sensors):
            raise InputError(f"sensing.sensors is {self.sensors}; need whole numbers of at least 1")
        if max(self.borders, self.mixed) > 1 or self.bump_size == 0:
            raise InputError(f"sensing: {self}; need borders and mixed of at most 1, and a positive bump_size")


def sensed(terrain: HeightMap, settings: SensingSettings, random: np.random.Generator) -> HeightMap:
    """A map of the same cells as ``terrain``, as sensors would have it; a function of its arguments alone.

    Args:
        terrain: wholly known ground.
        settings: how far it is degraded.
        random: what is drawn comes from here.
    """
    cell, shape = terrain.resolution, terrain.shape
    amount = {name: getattr(settings, name) * random.random() for name in ("bumps", "jitter", "mixed")}
    # Most maps are nearly level and have little noise, few are not or have much.
    amount |= {name: getattr(settings, name) * random.random() ** 2 for name in ("tilt", "white", "correlated")}
    x, y = (np.indices(shape) - np.reshape(shape, (2, 1, 1)) // 2) * cell
    slope, direction = math.tan(amount["tilt"]), random.uniform(-math.pi, math.pi)
    heights = _displaced(terrain.heights.astype(float), amount["jitter"], random)
    heights += slope * (math.cos(direction) * x + math.sin(direction) * y)
    heights += amount["bumps"] * _waves(shape, settings.bump_size / cell / 2, random)
    known = _seen(heights, settings, cell, random) & ~_unseen_parts(x, y, settings, random)
    known |= np.hypot(x, y) <= settings.around
    heights = _mixed(heights, amount["mixed"], random)
    heights += amount["white"] * random.standard_normal(shape) + amount["correlated"] * _waves(shape, 2.0, random)
    heights = smoothed(filled(np.where(known, heights, np.nan), settings.fill), settings.smooth)
    return HeightMap(heights, terrain.origin, cell)


def _waves(shape: tuple[int, int], width: float, random: np.random.Generator) -> np.ndarray:
    """Random values, float64 of a shape, of mean 0 and standard deviation 1, alike within ``width`` cells."""
    from scipy.ndimage import gaussian_filter

    values = gaussian_filter(random.standard_normal(shape), width, mode="wrap")
    return values / max(float(values.std()), 1e-12)


def _displaced(heights: np.ndarray, cells: float, random: np.random.Generator) -> np.ndarray:
    """Each cell takes the height of one about ``cells`` away, neighbours alike: edges get ragged."""
    index = np.indices(heights.shape)
    offsets = np.stack([np.rint(cells * _waves(heights.shape, 1.5, random)) for _ in range(2)]).astype(int)
    limits = np.reshape(heights.shape, (2, 1, 1)) - 1
    return heights[tuple(np.clip(index + offsets, 0, limits))]


def _mixed(heights: np.ndarray, share: float, random: np.random.Generator) -> np.ndarray:
    """A share of the cells at edges takes a height between the lowest and the highest beside them."""
    from scipy.ndimage import maximum_filter, minimum_filter

    low, high = minimum_filter(heights, 3, mode="nearest"), maximum_filter(heights, 3, mode="nearest")
    chosen = (high - low > _JUMP) & (random.random(heights.shape) < share)
    return np.where(chosen, low + (high - low) * random.random(heights.shape), heights)


def _seen(heights: np.ndarray, settings: SensingSettings, cell: float, random: np.random.Generator) -> np.ndarray:
    """Whether any of a few sensors sees a cell, bool."""
    middle = np.array(heights.shape) // 2
    seen = np.zeros(heights.shape, np.bool_)
    for _ in range(int(random.integers(*settings.sensors, endpoint=True))):
        distance, angle = random.uniform(*settings.sensor_distance) / cell, random.uniform(-math.pi, math.pi)
        x, y = middle + distance * np.array([math.cos(angle), math.sin(angle)])
        z = heights[tuple(middle)] + random.uniform(*settings.sensor_height)
        _look(heights, float(x), float(y), float(z), seen)
    return seen


@njit()
def _look(heights, x, y, z, seen):
    """Marks what is seen from (x, y) in cells and z in m: where no ground lies above the ray to a cell."""
    nx, ny = heights.shape
    for i in range(nx):
        for j in range(ny):
            n = math.ceil(max(abs(x - i), abs(y - j)))
            free = True
            for k in range(1, n):
                t = k / n
                u, v = round(i + (x - i) * t), round(j + (y - j) * t)
                inside = 0 <= u < nx and 0 <= v < ny
                if inside and heights[u, v] > heights[i, j] + (z - heights[i, j]) * t + _HIGHER:
                    free = False
                    break
            if free:
                seen[i, j] = True


def _unseen_parts(x: np.ndarray, y: np.ndarray, settings: SensingSettings, random: np.random.Generator) -> np.ndarray:
    """Cells beyond the borders of what was looked at, and in spots without a point; bool."""
    unseen = np.zeros(x.shape, np.bool_)
    for _ in range(2):
        angle, distance = random.uniform(-math.pi, math.pi), random.uniform(0.4, 1.0)
        if random.random() < settings.borders:
            ragged = 0.05 * _waves(x.shape, 3.0, random)
            unseen |= math.cos(angle) * x + math.sin(angle) * y + ragged > distance
    for _ in range(int(random.poisson(settings.holes))):
        at, radius = random.uniform(-1.0, 1.0, 2), random.uniform(0.02, 0.2) * random.random()
        unseen |= np.hypot(x - at[0], y - at[1]) < radius + 0.03 * _waves(x.shape, 2.0, random)
    return unseen
