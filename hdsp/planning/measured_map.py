"""The map of a planner as it was measured, and its conditioned form, through changes of the measured map."""

from __future__ import annotations

from copy import copy

import numpy as np

from hdsp.abstract.abstract_costs import Region
from hdsp.base.errors import InputError
from hdsp.base.messages import shown
from hdsp.planning.map_changes import changed_cells, region_of
from hdsp.robot.lattice import RESOLUTION, is_detailed
from hdsp.terrain.conditioning import ConditioningReport, Stages, is_conditioned
from hdsp.terrain.height_map import HeightMap
from hdsp.terrain.map_filters import ConditioningSettings

#: Growth of the known area after which the noise is estimated again.
_GROWTH = 2.0
#: Share of the known area; the same after a change of more.
_CHANGE = 0.5


class MeasuredMap:
    """A measured map and the map on which a planner plans. A change makes another object.

    Args:
        measured: the map as measured.
        conditioning: True: default settings; None or False: the map as it is.

    Attributes:
        measured: the map as measured.
        terrain: the map for planning, at the detailed resolution.

    Raises:
        InputError: cells that conditioning cannot bring to the detailed resolution; without conditioning, another
            resolution; or no setting.
    """

    def __init__(self, measured: HeightMap, conditioning: ConditioningSettings | bool | None):
        if not (conditioning is None or isinstance(conditioning, bool | ConditioningSettings)):
            raise InputError(f"conditioning is {shown(conditioning)}; need True, None, or ConditioningSettings")
        self._settings = ConditioningSettings() if conditioning is True else conditioning or None
        self.measured = self.terrain = measured
        self._stages: Stages | None = None
        self._take(measured)

    @property
    def exact(self) -> bool:
        """Whether the map for planning is the map as measured, without conditioning."""
        return self._stages is None

    @property
    def report(self) -> ConditioningReport | None:
        """Report on the conditioning; None without conditioning."""
        return self._stages.report if self._stages is not None else None

    def updated(self, measured: HeightMap, region: Region | None = None) -> tuple[MeasuredMap, Region | None]:
        """Returns the maps after a change, for which only the changed part is conditioned again.

        The noise stays as estimated, until twice as much ground is known, or half of the ground changes at once. A map
        that is conditioned already, after one that is not, or the reverse, is taken over as a whole.

        Args:
            measured: the whole map after the change.
            region: rectangle (first ix, first iy, end ix, end iy) in measured cells; outside, the map is unchanged.
                None: the change may be anywhere.

        Returns:
            The maps, and a rectangle in cells of ``terrain`` with all its changes; None: they may be anywhere.

        Raises:
            InputError: as at construction, or a region beyond the map.
        """
        result = copy(self)
        return result, result._follow(measured, region)

    def _follow(self, measured: HeightMap, region: Region | None) -> Region | None:
        region_of(measured, region)  # refuses a region beyond the map
        same = measured.resolution == self.measured.resolution
        changed = changed_cells(self.measured, measured, region) if same else None
        settled = is_conditioned(measured.frame.notes) == is_conditioned(self.measured.frame.notes)
        if changed is None or not settled or self._is_another(measured, changed):
            self._take(measured)
            return None
        if self._stages is None:
            self.measured = self.terrain = measured
            return None if region is None else region_of(measured, region)
        cells = np.argwhere(changed)
        if len(cells):
            low, high = cells.min(axis=0).tolist(), (cells.max(axis=0) + 1).tolist()
            self._stages = copy(self._stages)  # the maps before the change keep theirs
            x, y = self._stages.update(measured.heights, (slice(low[0], high[0]), slice(low[1], high[1])))
            found = x.start, y.start, x.stop, y.stop
        else:
            found = 0, 0, 0, 0
        self._show(measured)
        return found

    def _is_another(self, measured: HeightMap, changed: np.ndarray) -> bool:
        """Whether so much ground is new that its noise may be other noise."""
        if self._stages is None:
            return False
        known, new = (int(np.count_nonzero(cells)) for cells in (np.isfinite(measured.heights), changed))
        return bool(known > _GROWTH * self._known or new > _CHANGE * known)

    def _take(self, measured: HeightMap) -> None:
        if self._settings is not None:
            self._stages = measured.stages(self._settings)
            self._known = np.count_nonzero(np.isfinite(measured.heights))
            self._show(measured)
            return
        if not is_detailed(measured.resolution):
            raise InputError(
                f"terrain has cells of {measured.resolution:g} m; the planner needs {RESOLUTION:g} m, or conditioning"
            )
        self._stages, self.measured, self.terrain = None, measured, measured

    def _show(self, measured: HeightMap) -> None:
        assert self._stages is not None
        self.measured, report = measured, self._stages.report
        self.terrain = (
            measured.with_heights(self._stages.result, RESOLUTION, report.notes) if report.changed else measured
        )
