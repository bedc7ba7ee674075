"""Conditioning: from heights as measured to heights that a planner can trust.

Four stages run one after the other, each on the cells of the measured map until the last one:

1. **Spikes** become unknown: groups of few cells that stand out from all ground around them.
2. **Holes** whose rim agrees are filled: its heights differ by no more than an even slope and noise explain. Gaps no
   wider than two cells are filled in any case, since each height between their sides is as good as a measured one.
3. **Noise** is removed by two passes of a median filter, which keeps edges and slopes. Its window grows with the noise
   left in the result. Structures that the median would erase, e.g. a post or the corner of a wall, stay as measured.
4. Cells of another size are **resampled**: linearly where the ground is even; a rise within one or two cells is an
   edge, and falls into one line between two cells at half of its height.

A map without noise, spikes, and holes, in cells of the planner's size, stays the same to the last bit.

Convention: heights are float32 arrays [nx, ny] in m, NaN = unknown. A result depends on heights within a few cells only
(``reach``), and on the noise of the whole map, which is estimated once. A change of the map therefore needs only its
neighbourhood.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from hdsp.base.errors import InputError
from hdsp.base.settings import Natural, NotNegative, Positive, checked
from hdsp.robot.lattice import RESOLUTION, is_detailed

#: m, largest side of a cell; steps and footholds do not show in coarser maps.
COARSEST = 0.2
_MOST_CELLS = 100_000_000  # of a result
_LEAST_NOISE = 0.0005  # m; maps with less keep their heights
_LEAST_BEND = 0.00005  # m; the same for differences between neighbours
_NOISE_WINDOW = 9  # cells; the median over it is the ground in estimates of the noise
_WINDOWS = 3, 5, 7, 9, 11  # cells, of the median filter
_TILE, _TILES = 48, 5  # cells, tiles along each axis on which windows are tried
_SPIKE_AREA = 3 * RESOLUTION**2  # m2
_STEEPEST = math.tan(math.radians(20))  # of ground between the sides of a hole that count as even
_SIGMAS = 5.0  # noise beyond so many standard deviations is a structure or a spike
_NOTE = "conditioned: "
_MAD = 1.4826  # standard deviation of normal noise over its median absolute deviation
#: Slices along both axes.
Part = tuple[slice, slice]

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
    hole: NotNegative = 0.075
    edge: Positive = 0.05
    roughness: NotNegative = 0.0008


#: Settings under which a map of the planner's cells stays as it is.
UNCHANGED = ConditioningSettings(spike=0.0, hole=0.0, roughness=0.0)


@checked
class Noise:
    """Noise of a map, and the filter that removes it.

    Attributes:
        deviation: standard deviation, m.
        window: side of the median's window in cells; 0 = no filter.
    """

    deviation: NotNegative
    window: Natural


@dataclass(frozen=True)
class ConditioningReport:
    """Report on a conditioning.

    Attributes:
        measured: side of the measured cells, m.
        noise: noise of the measured map, and its filter.
        spikes: number of measured cells in spikes.
        filled: number of unknown measured cells that were filled, spikes included.
        unknown: share of unknown cells in the result.
    """

    measured: float
    noise: Noise
    spikes: int
    filled: int
    unknown: float

    @property
    def changed(self) -> bool:
        """Whether the result differs from the measured map."""
        return bool(self.noise.window or self.spikes or self.filled or not is_detailed(self.measured))

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes for the frame of a map; ``is_conditioned`` recognises them."""
        return (f"{_NOTE}{self}",) if self.changed else ()

    def __str__(self) -> str:
        done = []
        if not is_detailed(self.measured):
            done.append(f"cells of {self.measured:g} m resampled to {RESOLUTION:g} m")
        if self.noise.window:
            done.append(f"noise of {100 * self.noise.deviation:.1f} cm removed")
        if self.spikes:
            done.append(f"{_cells(self.spikes)} with spikes removed")
        if self.filled:
            done.append(f"{_cells(self.filled, 'unknown ')} filled")
        share = f"{100 * self.unknown:.0f}" if self.unknown >= 0.005 else "under 1"
        unknown = f"{share} % unknown" if self.unknown else ""
        return "; ".join(filter(None, (", ".join(done), unknown))) or "nothing to do"


def is_conditioned(notes: Iterable[str]) -> bool:
    """Whether the notes of a map come from a conditioning."""
    return any(note.startswith(_NOTE) for note in notes)


class Stages:
    """The stages of a conditioning with their results, which follow changes of the measured map.

    Args:
        heights: float32 [nx, ny], m, NaN = unknown.
        resolution: side of a cell, m.
        settings: settings of the conditioning; None = defaults.

    Raises:
        InputError: if the cells are too coarse for planning, or too many result.

    Attributes:
        noise: noise of the first map; it stays over all changes.
        result: float32, heights in cells of the planner's size.
    """

    def __init__(self, heights: np.ndarray, resolution: float, settings: ConditioningSettings | None = None):
        if not resolution <= COARSEST:
            raise InputError(f"cells of {resolution:g} m; conditioning for planning needs at most {COARSEST:g} m")
        self.resolution, self.settings = float(resolution), settings or ConditioningSettings()
        self.scale = self.resolution / RESOLUTION
        if np.prod(self.result_shape(heights.shape)) > _MOST_CELLS:
            raise InputError(
                f"map of {heights.shape[0]} x {heights.shape[1]} cells of {resolution:g} m: more than {_MOST_CELLS:,} "
                f"cells of {RESOLUTION:g} m"
            )
        heights = np.asarray(heights, np.float32)
        self.noise = estimate_noise(heights, self.resolution, self.settings)
        self._steps = self._stages()  # before the resampling
        self._results = [heights]
        for _, apply in self._steps:
            self._results.append(apply(self._results[-1]))
        self.result = self._resampled(self._results[-1])

    @property
    def report(self) -> ConditioningReport:
        measured, without_spikes, filled = (np.isfinite(heights) for heights in self._results[:3])
        return ConditioningReport(
            measured=self.resolution,
            noise=self.noise,
            spikes=int((measured & ~without_spikes).sum()),
            filled=int((filled & ~without_spikes).sum()),
            unknown=float(np.isnan(self.result).mean()),
        )

    def result_shape(self, shape: Sequence[int]) -> tuple[int, int]:
        """Cells of a result for a measured map with ``shape`` cells."""
        nx, ny = (max(math.floor(count * self.scale + 1e-6), 1) for count in shape)
        return nx, ny

    def update(self, heights: np.ndarray, part: Part) -> Part:
        """Follows a change; the result is then the same as from the stages on the whole map with the same noise.

        Args:
            heights: float32 [nx, ny], the whole measured map after the change, of the same shape.
            part: slices that hold all changed cells.

        Returns:
            Slices that hold all changed cells of ``result``.
        """
        results = [np.asarray(heights, np.float32)]
        for (reach, apply), before in zip(self._steps, self._results[1:], strict=True):
            if part[0].start == part[0].stop:
                results.append(before)
                continue
            target, source = _widened(part, reach, before.shape), _widened(part, 2 * reach, before.shape)
            after = before.copy()
            after[target] = apply(results[-1][source])[_within(target, source)]
            part = _changed_part(before, after, target)
            results.append(after)
        self._results = results
        if is_detailed(self.resolution):
            self.result = results[-1]
        if is_detailed(self.resolution) or part[0].start == part[0].stop:
            return part
        reach = 2 * math.ceil(max(self.scale, 1 / self.scale)) + 2
        target, source = (_widened(part, n * reach, heights.shape) for n in (1, 2))
        cells, around = self._result_cells(target), self._result_cells(source)
        result = self.result.copy()
        result[cells] = self._resampled(results[-1], around)[_within(cells, around)]
        self.result = result
        return cells

    def _stages(self) -> list[tuple[int, Callable[[np.ndarray], np.ndarray]]]:
        """Reach in cells, and function, for each stage on the measured cells."""
        arguments = self.resolution, self.noise, self.settings
        hole = max(_radius(self.settings.hole, self.resolution), 1)
        spike = _spike_cells(self.resolution)
        return [
            (6 + spike, lambda heights: without_spikes(heights, *arguments)),
            (5 * hole + 2, lambda heights: without_holes(heights, *arguments)),
            (2 * self.noise.window + 1 + spike, lambda heights: without_noise(heights, *arguments)),
        ]

    def _result_cells(self, part: Part) -> Part:
        """Cells of the result with their centres in a part of the measured map."""
        shape = self._results[0].shape

        def span(cut: slice, count: int, end: int) -> slice:
            first, last = (math.ceil(cell * self.scale - 0.5 - 1e-6) for cell in (cut.start, cut.stop))
            return slice(max(first, 0), end if cut.stop == count else min(last, end))

        a, b = (span(*of) for of in zip(part, shape, self.result_shape(shape), strict=True))
        return a, b

    def _resampled(self, heights: np.ndarray, part: Part | None = None) -> np.ndarray:
        """Resamples measured heights to cells of the planner's size, or to a part of them."""
        if is_detailed(self.resolution):
            return heights
        from scipy.ndimage import map_coordinates

        whole = self.result_shape(heights.shape)
        cuts = part or (slice(0, whole[0]), slice(0, whole[1]))
        x, y = ((np.arange(cut.start, cut.stop) + 0.5) / self.scale - 0.5 for cut in cuts)
        # Only the measured cells around the part are read.
        first_x, first_y = (max(math.floor(at[0]) - 1, 0) for at in (x, y))
        measured = heights[first_x : math.ceil(x[-1]) + 2, first_y : math.ceil(y[-1]) + 2]
        grid = np.stack(np.meshgrid(x - first_x, y - first_y, indexing="ij"))
        full = _everywhere(measured)
        if self.scale < 1:  # a median over the measured cells in one result cell keeps edges
            full = _median(full, 2 * round(0.5 / self.scale) + 1)
            fine = map_coordinates(full, grid, order=0, mode="nearest")
        else:
            fine, nearest = (map_coordinates(full, grid, order=order, mode="nearest") for order in (1, 0))
            fine = _with_sharp_edges(fine, nearest, self.scale, self.settings)
        known = map_coordinates(np.isfinite(measured).astype(np.uint8), grid, order=0, mode="nearest") > 0
        return np.where(known, fine, np.float32(np.nan)).astype(np.float32)


def estimate_noise(heights: np.ndarray, resolution: float, settings: ConditioningSettings) -> Noise:
    """Estimates the noise of measured heights, and chooses the filter for it.

    The deviation is the median absolute difference to the median over 9 x 9 cells, scaled to a standard deviation. It
    counts as noise only if most cells differ from the median of their neighbours, too: structures close to each other
    leave most 3 x 3 cells plane.

    Args:
        heights, resolution, settings: as in ``Stages``.
    """
    known = np.isfinite(heights)
    if settings.roughness == 0 or not known.any():
        return Noise(0.0, 0)
    full = _everywhere(heights)
    deviation = _deviation(full, known, _NOISE_WINDOW)
    if deviation < _LEAST_NOISE or _deviation(full, known, 3) < _LEAST_BEND:
        return Noise(0.0, 0)
    # Noise that is alike in nearby cells shows in every second cell. So do stairs, hence the limit.
    deviation = max(deviation, min(_deviation(full[::2, ::2], known[::2, ::2], _NOISE_WINDOW), 2 * deviation))
    # Windows are tried on some tiles; trials on the whole map would take longer than the filter itself.
    tiles = _tiles(known)
    for window in _WINDOWS:
        bends = np.concatenate([_bends(_median(full[tile], window, passes=2), known[tile]) for tile in tiles])
        if len(bends) and np.median(bends) * RESOLUTION / resolution <= settings.roughness:
            break
    return Noise(deviation, window)


def _deviation(heights: np.ndarray, known: np.ndarray, window: int) -> float:
    away = np.abs(heights - _median(heights, window))[known]
    return _MAD * float(np.median(away)) if len(away) else 0.0


def without_spikes(heights: np.ndarray, resolution: float, noise: Noise, settings: ConditioningSettings) -> np.ndarray:
    """Makes spikes unknown: small groups of cells that stand out from the median and from all cells around them."""
    if settings.spike == 0 or not np.isfinite(heights).any():
        return heights
    away = heights - _median(_everywhere(heights), 5)
    lone = _lone(heights, away, _least_structure(noise, settings), resolution)
    return np.where(lone, np.float32(np.nan), heights)


def without_holes(heights: np.ndarray, resolution: float, noise: Noise, settings: ConditioningSettings) -> np.ndarray:
    """Fills holes whose rim agrees, and gaps no wider than two cells, with the median around them."""
    from scipy.ndimage import maximum_filter, minimum_filter

    known = np.isfinite(heights)
    if settings.hole == 0 or known.all() or not known.any():
        return heights
    radius = _radius(settings.hole, resolution)
    window = 2 * radius + 3
    lowest = minimum_filter(np.where(known, heights, np.inf), window, mode="nearest")
    highest = maximum_filter(np.where(known, heights, -np.inf), window, mode="nearest")
    even = settings.edge + 2 * _SIGMAS * noise.deviation + _STEEPEST * window * resolution
    filled = _closed(known, 1) | (_closed(known, radius) & (highest - lowest <= even))
    around = _median(_everywhere(heights), 2 * radius + 1)
    return np.where(filled & ~known, around, heights)


def without_noise(heights: np.ndarray, resolution: float, noise: Noise, settings: ConditioningSettings) -> np.ndarray:
    """Removes noise by two passes of a median; structures that it would erase stay as measured."""
    if noise.window == 0:
        return heights
    calm = _median(_everywhere(heights), noise.window, passes=2)
    away, least = heights - calm, _least_structure(noise, settings)
    structure = (np.abs(away) > least) & ~_lone(heights, away, least, resolution)  # false for NaN
    return np.where(structure | np.isnan(heights), heights, calm)


def _least_structure(noise: Noise, settings: ConditioningSettings) -> float:
    """Least distance (m) from the ground around that is no noise."""
    return max(settings.spike, _SIGMAS * noise.deviation)


def _lone(heights: np.ndarray, away: np.ndarray, least: float, resolution: float) -> np.ndarray:
    """Cells in spikes, bool [nx, ny]: small groups that stand alone.

    Args:
        heights: m, NaN = unknown.
        away: heights above the ground around them, m.
        least: smallest height of a spike above the ground, or depth below it, m.
        resolution: side of a cell, m.
    """
    from scipy.ndimage import label, maximum_filter

    result, border = np.zeros(heights.shape, bool), np.ones(heights.shape, bool)
    border[1:-1, 1:-1] = False
    for sign in (1, -1):
        groups, count = label(sign * away > least, np.ones((3, 3)))  # false for NaN
        if count == 0:
            continue
        raised = np.where(np.isfinite(heights), sign * heights, -np.inf)
        beside = maximum_filter(np.where(groups == 0, raised, -np.inf), 3, mode="nearest")
        # A group that goes on in ground of about its height is a corner of it.
        goes_on = np.zeros(count + 1, bool)
        goes_on[groups[(groups > 0) & (beside > raised - 0.5 * sign * away)]] = True
        goes_on[groups[border]] = True  # perhaps beyond the map
        small = np.bincount(groups.ravel(), minlength=count + 1) <= _spike_cells(resolution)
        result |= (small & ~goes_on)[groups] & (groups > 0)
    return result


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
    """Gives each unknown cell the height of the nearest known cell; 0 without any."""
    from scipy.ndimage import distance_transform_edt

    unknown = np.isnan(heights)
    if not unknown.any():
        return heights
    if unknown.all():
        return np.zeros_like(heights)
    nearest = distance_transform_edt(unknown, return_distances=False, return_indices=True)
    return heights[tuple(nearest)]


def _closed(known: np.ndarray, radius: int) -> np.ndarray:
    """Known cells and the holes that a disc closes, bool [nx, ny]."""
    from scipy.ndimage import binary_closing

    x, y = np.indices((2 * radius + 1,) * 2) - radius
    # A gap of one cell at the border of the map is closed, too.
    padded = np.pad(known, radius, mode="edge" if radius == 1 else "constant")
    return binary_closing(padded, x**2 + y**2 <= radius**2)[radius:-radius, radius:-radius]


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


def _cells(count: int, kind: str = "") -> str:
    return f"{count:,} {kind}cell{'' if count == 1 else 's'}"


def _radius(length: float, resolution: float) -> int:
    """Radius in cells of the disc that closes holes; one cell at least."""
    return max(round(length / resolution), 1)


def _spike_cells(resolution: float) -> int:
    """Most cells in a spike; one at least."""
    return max(round(_SPIKE_AREA / resolution**2), 1)


def _widened(part: Part, reach: int, shape: tuple[int, ...]) -> Part:
    a, b = (slice(max(cut.start - reach, 0), min(cut.stop + reach, n)) for cut, n in zip(part, shape, strict=True))
    return a, b


def _within(inner: Part, outer: Part) -> Part:
    """Slices of a part in an array that holds a larger part."""
    a, b = (slice(i.start - o.start, i.stop - o.start) for i, o in zip(inner, outer, strict=True))
    return a, b


def _changed_part(before: np.ndarray, after: np.ndarray, part: Part) -> Part:
    """Smallest part that holds all cells in a part in which two arrays differ."""
    old, new = before[part], after[part]
    changed = np.argwhere((old != new) & ~(np.isnan(old) & np.isnan(new)))
    if len(changed) == 0:
        return slice(part[0].start, part[0].start), slice(part[1].start, part[1].start)
    (x0, y0), (x1, y1) = changed.min(axis=0).tolist(), changed.max(axis=0).tolist()
    return (
        slice(part[0].start + x0, part[0].start + x1 + 1),
        slice(part[1].start + y0, part[1].start + y1 + 1),
    )
