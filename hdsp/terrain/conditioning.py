"""Conditioning: from heights as measured to heights that a planner can trust.

Four stages run one after the other, each on the cells of the measured map until the last one:

1. **Spikes** become unknown: groups of few cells that stand out from all ground around them.
2. **Holes** whose rim agrees are filled: its heights differ by no more than an even slope and noise explain. Gaps no
   wider than two cells are filled in any case, since each height between their sides is as good as a measured one.
3. **Noise** is removed by two passes of a median filter, which keeps edges and slopes. Its window grows with the noise
   left in the result. Structures that the median would erase, e.g. a post or the corner of a wall, stay as measured.
4. Cells of another size are **resampled**: linearly where the ground is even; a rise within one or two cells is an
   edge, and falls into one line between two cells at half of its height. Smaller cells count with their median, thin
   structures with their highest cell.

`hdsp.terrain.map_filters` has the filters. Cells of 2.5 mm and less join to cells of up to 5 mm before the first stage
(`hdsp.terrain.fine_cells`).

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
from hdsp.base.short_repr import short_repr
from hdsp.robot.lattice import RESOLUTION, cells, is_detailed
from hdsp.terrain.fine_cells import joined, joins
from hdsp.terrain.map_filters import (
    SPIKE_CELLS,
    ConditioningSettings,
    Noise,
    closing_radius,
    estimate_noise,
    interpolated,
    sampled,
    without_holes,
    without_noise,
    without_spikes,
)
from hdsp.terrain.map_parts import Part, changed_part, widened, within

#: m, largest side of a cell; steps and footholds do not show in coarser maps.
COARSEST = 0.2
#: m, smallest side of a cell.
FINEST = 1e-4
_MOST_CELLS = 100_000_000  # of a result
_NOTE = "conditioned: "


@dataclass(frozen=True)
class ConditioningReport:
    """Report on a conditioning.

    Attributes:
        measured: side of the measured cells, m. Where they join, numbers of cells are those of joined ones.
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

    def __repr__(self) -> str:
        return short_repr(self)

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
        resolution: cell size, m.
        settings: settings of the conditioning; None = defaults.

    Raises:
        InputError: if the cells are too coarse or too fine for planning, or too many result.

    Attributes:
        noise: noise of the first map; it stays over all changes.
        result: float32, heights in cells of the planner's size.
    """

    def __init__(self, heights: np.ndarray, resolution: float, settings: ConditioningSettings | None = None):
        if not resolution <= COARSEST:
            raise InputError(f"cells of {resolution:g} m; conditioning for planning needs at most {COARSEST:g} m")
        if resolution < FINEST:
            raise InputError(f"cells of {resolution:g} m; conditioning for planning needs at least {FINEST:g} m")
        self.resolution, self.settings = float(resolution), settings or ConditioningSettings()
        self._joins = joins(self.resolution)
        self._cell = self._joins * self.resolution
        self._scale = cells(self._cell)
        self._shape = _result_shape(heights.shape, cells(self.resolution))
        if np.prod(self._shape) > _MOST_CELLS:
            raise InputError(
                f"map of {heights.shape[0]} x {heights.shape[1]} cells of {resolution:g} m: more than {_MOST_CELLS:,} "
                f"cells of {RESOLUTION:g} m"
            )
        heights = self._joined(np.asarray(heights, np.float32))
        self.noise = estimate_noise(heights, self._cell, self.settings)
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

    def update(self, heights: np.ndarray, part: Part) -> Part:
        """Follows a change; the result is then the same as from the stages on the whole map with the same noise.

        Args:
            heights: float32 [nx, ny], the whole measured map after the change, of the same shape.
            part: slices that hold all changed cells.

        Returns:
            Slices that hold all changed cells of ``result``.
        """
        heights, part = self._after(np.asarray(heights, np.float32), part)
        results = [heights]
        for (reach, apply), before in zip(self._steps, self._results[1:], strict=True):
            if part[0].start == part[0].stop:
                results.append(before)
                continue
            target, source = widened(part, reach, before.shape), widened(part, 2 * reach, before.shape)
            after = before.copy()
            after[target] = apply(results[-1][source])[within(target, source)]
            part = changed_part(before, after, target)
            results.append(after)
        result = self.result
        if is_detailed(self.resolution):
            result = results[-1]
        elif part[0].start != part[0].stop:
            reach = 2 * math.ceil(max(self._scale, 1 / self._scale)) + 2
            target, source = (widened(part, n * reach, heights.shape) for n in (1, 2))
            part, around = self._result_cells(target), self._result_cells(source)
            result = self.result.copy()
            result[part] = self._resampled(results[-1], around)[within(part, around)]
        self._results, self.result = results, result
        return part

    def _joined(self, heights: np.ndarray) -> np.ndarray:
        spike_cells = SPIKE_CELLS if self.settings.spike else 0
        return joined(heights, self._joins, self.settings.edge, spike_cells)

    def _after(self, heights: np.ndarray, part: Part) -> tuple[np.ndarray, Part]:
        """A changed measured map in cells of the stages, and the part with all changes in these cells."""
        if self._joins == 1:
            return heights, part
        before, n = self._results[0], self._joins
        x, y = (slice(cut.start // n, -(-cut.stop // n)) for cut in part)
        after = before.copy()
        after[x, y] = self._joined(heights[n * x.start : n * x.stop, n * y.start : n * y.stop])
        return after, changed_part(before, after, (x, y))

    def _stages(self) -> list[tuple[int, Callable[[np.ndarray], np.ndarray]]]:
        """Reach in cells, and function, for each stage on the measured cells."""
        # The functions hold no stages, since copies share them.
        noise, settings, cell = self.noise, self.settings, self._cell
        hole = closing_radius(settings.hole, cell)
        return [
            (6 + noise.spike_cells, lambda heights: without_spikes(heights, noise, settings)),
            (5 * hole + 2, lambda heights: without_holes(heights, cell, noise, settings)),
            (2 * noise.window + 1 + noise.spike_cells, lambda heights: without_noise(heights, noise, settings)),
        ]

    def _result_cells(self, part: Part) -> Part:
        """Cells of the result with their centres in a part of the measured map."""
        shape = self._results[0].shape

        def span(cut: slice, count: int, end: int) -> slice:
            first, last = (math.ceil(cell * self._scale - 0.5 - 1e-6) for cell in (cut.start, cut.stop))
            return slice(max(first, 0), end if cut.stop == count else min(last, end))

        a, b = (span(*of) for of in zip(part, shape, self._shape, strict=True))
        return a, b

    def _resampled(self, heights: np.ndarray, part: Part | None = None) -> np.ndarray:
        """Resamples measured heights to cells of the planner's size, or to a part of them."""
        if is_detailed(self.resolution):
            return heights
        from scipy.ndimage import map_coordinates

        cuts = part or (slice(0, self._shape[0]), slice(0, self._shape[1]))
        x, y = ((np.arange(cut.start, cut.stop) + 0.5) / self._scale - 0.5 for cut in cuts)
        # Only the measured cells around the part are read.
        first_x, first_y = (max(math.floor(at[0]) - 1, 0) for at in (x, y))
        measured = heights[first_x : math.ceil(x[-1]) + 2, first_y : math.ceil(y[-1]) + 2]
        grid = np.stack(np.meshgrid(x - first_x, y - first_y, indexing="ij"))
        if self._scale < 1:
            fine = sampled(measured, grid, self._scale, self.settings)
        else:
            fine = interpolated(measured, grid, self._scale, self.settings)
        known = map_coordinates(np.isfinite(measured).astype(np.uint8), grid, order=0, mode="nearest") > 0
        return np.where(known, fine, np.float32(np.nan)).astype(np.float32)


def _result_shape(shape: Sequence[int], scale: float) -> tuple[int, int]:
    """Cells of a result for a map with ``shape`` cells, each ``scale`` cells of the result wide."""
    nx, ny = (max(math.floor(count * scale + 1e-6), 1) for count in shape)
    return nx, ny


def _cells(count: int, kind: str = "") -> str:
    return f"{count:,} {kind}cell{'' if count == 1 else 's'}"
