"""Filters of the conditioning: spikes, holes, noise, and cells of another size.

Convention: heights are float32 arrays [nx, ny] in m, NaN = unknown. Each filter looks at a few cells around a cell.
"""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np
from pydantic import Field

from hdsp.base.settings import Natural, NotNegative, Positive, checked
from hdsp.robot.lattice import cells
from hdsp.terrain.filling import closed
from hdsp.terrain.fine_cells import medians_at
from hdsp.terrain.map_parts import Part

_LEAST_NOISE = 0.0005  # m; maps with less keep their heights
_LEAST_BEND = 0.00005  # m; the same for differences between neighbours
_NOISE_WINDOW = 9  # cells; the median over it is the ground in estimates of the noise
_WINDOWS = 3, 5, 7, 9, 11  # cells, of the median filter
_TILE, _TILES = 48, 5  # cells, tiles along each axis on which windows are tried
#: Most cells in a spike. In larger cells than ``_SMALL``, one cell may hold a post.
SPIKE_CELLS = 3
_SMALL = 0.03  # m
#: Spikes in larger cells are errors of the sensor if they are so many: cells, and their share of all known cells.
_MANY, _MANY_SHARE = 10, 0.003
_STEEPEST = math.tan(math.radians(20))  # of ground between the sides of a hole that count as even
_SIGMAS = 5.0  # noise beyond so many standard deviations is a structure or a spike
_MAD = 1.4826  # standard deviation of normal noise over its median absolute deviation
#: Share of the rise over twice the distance that falls within one distance: 0.5 on a slope, 1 at an edge.
_SUDDEN = 0.75


@checked
class ConditioningSettings:
    """Settings of the conditioning.

    Attributes:
        spike: m; a spike stands out by more, and by more than noise does. 0 = spikes stay.
        hole: m; holes up to about twice as wide are filled. 0 = no hole is filled.
        edge: m; rises by more within one or two cells count as edges.
        roughness: m; the noise filter grows until neighbouring cells of 0.025 m bend by less. 0 = noise stays.
    """

    spike: NotNegative = 0.05
    hole: Annotated[float, Field(ge=0, le=10)] = 0.075
    edge: Positive = 0.05
    roughness: NotNegative = 0.0008


#: Settings under which a map of the planner's cells stays as it is.
UNCHANGED = ConditioningSettings(spike=0.0, hole=0.0, roughness=0.0)


@checked
class Noise:
    """Noise and spikes of a map, and the filters that remove them.

    Attributes:
        deviation: standard deviation of the noise, m.
        window: side of the median's window in cells; 0 = no filter.
        spike_cells: most cells in a spike; 0 = no group of cells is a spike.
    """

    deviation: NotNegative
    window: Natural
    spike_cells: Natural


def estimate_noise(heights: np.ndarray, resolution: float, settings: ConditioningSettings) -> Noise:
    """Estimates noise and spikes in measured heights, and chooses the filters for them.

    The deviation is the median absolute difference to the median over 9 x 9 cells, scaled to a standard deviation. It
    counts as noise only if most cells differ from the median of their neighbours, too: structures close to each other
    leave most 3 x 3 cells plane.

    A spike has up to three cells. A single cell of more than 0.03 m may be a post; it counts as a spike only in a map
    with many of them.

    Args:
        heights, resolution, settings: as in ``Stages``.
    """
    known = np.isfinite(heights)
    deviation, window = _noise(heights, known, resolution, settings) if known.any() else (0.0, 0)
    if settings.spike == 0:
        return Noise(deviation, window, 0)
    if resolution <= _SMALL:
        return Noise(deviation, window, SPIKE_CELLS)
    single = Noise(deviation, window, 1)
    many = max(_MANY, _MANY_SHARE * np.count_nonzero(known))
    spikes = known & np.isnan(without_spikes(heights, single, settings))
    return single if np.count_nonzero(spikes) >= many else Noise(deviation, window, 0)


def _noise(heights: np.ndarray, known: np.ndarray, resolution: float, settings: ConditioningSettings):
    """Standard deviation (m) of the noise, and side (cells) of the median's window."""
    if settings.roughness == 0:
        return 0.0, 0
    full = _everywhere(heights)
    deviation = _deviation(full, known, _NOISE_WINDOW)
    if deviation < _LEAST_NOISE or _deviation(full, known, 3) < _LEAST_BEND:
        return 0.0, 0
    # Noise that is alike in nearby cells shows in every second cell. So do stairs, hence the limit.
    deviation = max(deviation, min(_deviation(full[::2, ::2], known[::2, ::2], _NOISE_WINDOW), 2 * deviation))
    # Windows are tried on some tiles; trials on the whole map would take longer than the filter itself.
    tiles = _tiles(known)
    for window in _WINDOWS:
        bends = np.concatenate([_bends(_median(full[tile], window, passes=2), known[tile]) for tile in tiles])
        if len(bends) and np.median(bends) <= settings.roughness * cells(resolution):
            break
    return deviation, window


def _deviation(heights: np.ndarray, known: np.ndarray, window: int) -> float:
    away = np.abs(heights - _median(heights, window))[known]
    return _MAD * float(np.median(away)) if len(away) else 0.0


def without_spikes(heights: np.ndarray, noise: Noise, settings: ConditioningSettings) -> np.ndarray:
    """Makes spikes unknown: small groups of cells that stand out from the median and from all cells around them."""
    if noise.spike_cells == 0 or not np.isfinite(heights).any():
        return heights
    away = heights - _median(_everywhere(heights), 5)
    lone = _lone(heights, away, _least_structure(noise, settings), noise.spike_cells)
    return np.where(lone, np.float32(np.nan), heights)


def without_holes(heights: np.ndarray, resolution: float, noise: Noise, settings: ConditioningSettings) -> np.ndarray:
    """Fills holes whose rim agrees, and gaps no wider than two cells, with the median around them."""
    from scipy.ndimage import maximum_filter, minimum_filter

    known = np.isfinite(heights)
    if settings.hole == 0 or known.all() or not known.any():
        return heights
    radius = closing_radius(settings.hole, resolution)
    window = 2 * radius + 3
    lowest = minimum_filter(np.where(known, heights, np.inf), window, mode="nearest")
    highest = maximum_filter(np.where(known, heights, -np.inf), window, mode="nearest")
    even = settings.edge + 2 * _SIGMAS * noise.deviation + _STEEPEST * window * resolution
    filled = _closed(known, 1) | (_closed(known, radius) & (highest - lowest <= even))
    holes = np.nonzero(filled & ~known)
    result = heights.copy()
    result[holes] = medians_at(_everywhere(heights), 2 * radius + 1, holes)
    return result


def without_noise(heights: np.ndarray, noise: Noise, settings: ConditioningSettings) -> np.ndarray:
    """Removes noise by two passes of a median; structures that it would erase stay as measured."""
    if noise.window == 0:
        return heights
    calm = _median(_everywhere(heights), noise.window, passes=2)
    away, least = heights - calm, _least_structure(noise, settings)
    structure = (np.abs(away) > least) & ~_lone(heights, away, least, noise.spike_cells)  # false for NaN
    return np.where(structure | np.isnan(heights), heights, calm)


def _least_structure(noise: Noise, settings: ConditioningSettings) -> float:
    """Least distance (m) from the ground around that is no noise."""
    return max(settings.spike, _SIGMAS * noise.deviation)


def _lone(heights: np.ndarray, away: np.ndarray, least: float, most_cells: int) -> np.ndarray:
    """Cells in spikes, bool [nx, ny]: small groups that stand alone.

    Args:
        heights: m, NaN = unknown.
        away: heights above the ground around them, m.
        least: smallest height of a spike above the ground, or depth below it, m.
        most_cells: most cells in a group.
    """
    from scipy.ndimage import label, maximum_filter

    result, border = np.zeros(heights.shape, bool), np.ones(heights.shape, bool)
    border[1:-1, 1:-1] = False
    for sign in (1, -1):
        groups, count = label(sign * away > least, np.ones((3, 3)))  # false for NaN
        if count == 0:
            continue
        raised = np.where(np.isfinite(heights), sign * heights, -np.inf)
        # Neighbours count with the ground around them: their own noise may be as large as half of a spike.
        ground = np.where((groups == 0) & np.isfinite(heights), sign * (heights - away), -np.inf)
        beside = maximum_filter(ground, 3, mode="nearest")
        # A group that goes on in ground of about its height is a corner of it.
        goes_on = np.zeros(count + 1, bool)
        goes_on[groups[(groups > 0) & (beside > raised - 0.5 * sign * away)]] = True
        goes_on[groups[border]] = True  # perhaps beyond the map
        small = np.bincount(groups.ravel(), minlength=count + 1) <= most_cells
        result |= (small & ~goes_on)[groups] & (groups > 0)
    return result


def interpolated(measured: np.ndarray, places: np.ndarray, scale: float, settings: ConditioningSettings) -> np.ndarray:
    """Interpolates measured heights at places between them; edges stay edges.

    Args:
        measured: float32 [nx, ny], m, NaN = unknown.
        places: [2, kx, ky], in cells of ``measured``.
        scale: distance between two cells in places, at least 1.
        settings: as in ``Stages``.
    """
    from scipy.ndimage import map_coordinates

    full = _everywhere(measured)
    linear, nearest = (map_coordinates(full, places, order=order, mode="nearest") for order in (1, 0))
    return _with_sharp_edges(linear, nearest, scale, settings)


def sampled(measured: np.ndarray, places: np.ndarray, scale: float, settings: ConditioningSettings) -> np.ndarray:
    """Samples measured heights at places farther apart than they are, by a median; thin structures keep their height.

    Args:
        measured, places, settings: as in ``interpolated``.
        scale: distance between two cells in places, less than 1.
    """
    from scipy.ndimage import map_coordinates, maximum_filter, white_tophat

    full = _everywhere(measured)
    window = 2 * round(0.5 / scale) + 1
    # A median would erase structures that are thinner than half of its window.
    thin = np.where(white_tophat(full, window, mode="nearest") > settings.edge, full, -np.inf)
    highest = maximum_filter(thin, window, mode="nearest")
    numbers = np.arange(full.size).reshape(full.shape)
    nearest = np.unravel_index(map_coordinates(numbers, places, order=0, mode="nearest"), full.shape)
    middle = medians_at(full, window, tuple(axis.ravel() for axis in nearest)).reshape(places.shape[1:])
    return np.where(highest[nearest] > middle + settings.edge, highest[nearest], middle)


def _with_sharp_edges(
    heights: np.ndarray, measured: np.ndarray, scale: float, settings: ConditioningSettings
) -> np.ndarray:
    """Moves rises that interpolation spread over a measured cell into one line between two cells.

    Args:
        heights: interpolated heights, m.
        measured: height of the nearest measured cell, m. Interpolation lowers walls as thin as one measured cell.
        scale: side of a measured cell in cells.
        settings: as in ``Stages``.
    """
    from scipy.ndimage import maximum_filter, minimum_filter

    wide = math.ceil(scale)
    low, high = (of(heights, 2 * wide + 1, mode="nearest") for of in (minimum_filter, maximum_filter))
    lower, higher = (of(heights, 4 * wide + 1, mode="nearest") for of in (minimum_filter, maximum_filter))
    edge = (high - low > settings.edge) & (high - low > _SUDDEN * (higher - lower))
    low = np.minimum(low, minimum_filter(measured, 2 * wide + 1, mode="nearest"))
    high = np.maximum(high, maximum_filter(measured, 2 * wide + 1, mode="nearest"))
    return np.where(edge, np.where(heights - low < high - heights, low, high), heights)


def _median(heights: np.ndarray, window: int, passes: int = 1) -> np.ndarray:
    from scipy.ndimage import median_filter

    for _ in range(passes):
        heights = median_filter(heights, window, mode="nearest")
    return heights


def _everywhere(heights: np.ndarray) -> np.ndarray:
    """Gives each unknown cell the nearest known cell's height; 0 without any."""
    from scipy.ndimage import distance_transform_edt

    unknown = np.isnan(heights)
    if not unknown.any():
        return heights
    if unknown.all():
        return np.zeros_like(heights)
    nearest = distance_transform_edt(unknown, return_distances=False, return_indices=True)
    return heights[tuple(nearest)]


def _closed(known: np.ndarray, radius: int) -> np.ndarray:
    """Known cells and the holes that a disc closes, bool [nx, ny]; a gap of one cell at the border is closed, too."""
    return closed(known, radius, "edge" if radius == 1 else "constant")


def _bends(heights: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Second differences of known heights along both axes, absolute, [n]; 0 on slopes."""
    found = []
    for axis in (0, 1):
        if heights.shape[axis] >= 3:
            three = np.lib.stride_tricks.sliding_window_view(known, 3, axis=axis).all(axis=-1)
            found.append(np.abs(np.diff(heights, 2, axis=axis))[three])
    return np.concatenate(found) if found else np.empty(0)


def _tiles(known: np.ndarray) -> list[Part]:
    """Tiles with the most known cells, spread over the map."""
    spans = []
    for count in known.shape:
        first = np.unique(np.linspace(0, max(count - _TILE, 0), _TILES).astype(int))
        spans.append([slice(int(a), int(a) + _TILE) for a in first])
    tiles = [(a, b) for a in spans[0] for b in spans[1]]
    tiles.sort(key=lambda tile: -int(known[tile].sum()))
    return tiles[:_TILES]


def closing_radius(length: float, resolution: float) -> int:
    """Radius in cells of the disc that closes holes; one cell at least."""
    return max(round(length / resolution), 1)
