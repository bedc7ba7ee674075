"""Sensor model: height maps with noise, rounded edges, and unknown cells outside the sensors' view.

Random terrain is exact and completely known; maps of real places are neither. The planner labels the degraded map
itself, so the labels agree with the network's input. The model imitates the conversion from scans to maps
(`hdsp.terrain.pointcloud.cloud_mapping`): points come from few sensor positions, small holes are filled, and heights
are averaged. Its strengths were chosen to match maps made from simulated and real scans.

Convention: maps as in `hdsp.terrain.height_map`; the robot starts at the centre of cell (nx // 2, ny // 2).
"""

import math

import numpy as np

from hdsp.base.jit import njit
from hdsp.base.settings import CountRange, Natural, NotNegative, Positive, RangeFromZero, Share, checked
from hdsp.terrain.filling import filled, smoothed
from hdsp.terrain.height_map import HeightMap

_HIGHER = 0.03  # m; ground this far above a ray ends the ray
_JUMP = 0.05  # m; a larger difference between heights gives mixed cells


@checked
class SensingSettings:
    """Upper limits of the degradation. Each map uses a random share of each limit.

    Shares are uniform in [0, 1]; for tilt and noise, the shares are squares of uniform numbers.

    Attributes:
        tilt: slope of the whole map in a random direction, rad.
        bumps: standard deviation of waves in the ground, m; the waves are about ``bump_size`` m wide.
        jitter: standard deviation of edge displacement, cells.
        mixed: share of edge cells with a height between the surrounding heights.
        white, correlated: standard deviations of two noises, m; correlated noise is similar within a few cells.
        sensors: smallest and largest number of sensor positions.
        sensor_distance, sensor_height: ranges for the horizontal distance from the start and the height above its
            ground, m.
        borders: probability that everything beyond a straight line is unknown; drawn for two lines.
        holes: mean number of unknown spots.
        around: radius around the start that is always known, m, because the robot has reached the start.
        fill, smooth: as in `hdsp.terrain.pointcloud.MapSettings`, cells and m.

    Raises:
        InputError: if a value is out of range.
    """

    tilt: NotNegative = 0.087
    bumps: NotNegative = 0.01
    bump_size: Positive = 0.3
    jitter: NotNegative = 0.7
    mixed: Share = 0.5
    white: NotNegative = 0.012
    correlated: NotNegative = 0.003
    sensors: CountRange = (1, 4)
    sensor_distance: RangeFromZero = (0.0, 3.0)
    sensor_height: RangeFromZero = (0.8, 1.8)
    borders: Share = 0.4
    holes: NotNegative = 2.0
    around: NotNegative = 0.35
    fill: Natural = 3
    smooth: NotNegative = 0.03


def sensed(terrain: HeightMap, settings: SensingSettings, random: np.random.Generator) -> HeightMap:
    """Degrades a terrain to a map as sensors measure it.

    The map has the same cells and depends on the arguments alone.

    Args:
        terrain: completely known terrain.
        settings: upper limits of the degradation.
        random: source of all random numbers.
    """
    cell, shape = terrain.resolution, terrain.shape
    amount = {name: getattr(settings, name) * random.random() for name in ("bumps", "jitter", "mixed")}
    # Squares: most maps are nearly level and have little noise.
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
    """Random values with mean 0 and standard deviation 1, similar within ``width`` cells; float64 [shape]."""
    from scipy.ndimage import gaussian_filter

    values = gaussian_filter(random.standard_normal(shape), width, mode="wrap")
    return values / max(float(values.std()), 1e-12)


def _displaced(heights: np.ndarray, cells: float, random: np.random.Generator) -> np.ndarray:
    """Makes edges ragged: each cell takes the height about ``cells`` cells away; neighbours have similar offsets."""
    index = np.indices(heights.shape)
    offsets = np.stack([np.rint(cells * _waves(heights.shape, 1.5, random)) for _ in range(2)]).astype(int)
    limits = np.reshape(heights.shape, (2, 1, 1)) - 1
    return heights[tuple(np.clip(index + offsets, 0, limits))]


def _mixed(heights: np.ndarray, share: float, random: np.random.Generator) -> np.ndarray:
    """Gives a share of edge cells a random height between the lowest and the highest height beside them."""
    from scipy.ndimage import maximum_filter, minimum_filter

    low, high = minimum_filter(heights, 3, mode="nearest"), maximum_filter(heights, 3, mode="nearest")
    chosen = (high - low > _JUMP) & (random.random(heights.shape) < share)
    return np.where(chosen, low + (high - low) * random.random(heights.shape), heights)


def _seen(heights: np.ndarray, settings: SensingSettings, cell: float, random: np.random.Generator) -> np.ndarray:
    """Whether at least one random sensor sees a cell, bool [nx, ny]."""
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
    """Marks the cells seen from (x, y) in cells and z in m: no ground lies above the ray to a seen cell."""
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
    """Cells beyond the borders of the measured area, and cells in spots without a point; bool."""
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
