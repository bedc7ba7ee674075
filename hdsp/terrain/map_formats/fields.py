"""Contents of a height map file before validation, and the options for reading a file."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from numbers import Real
from typing import Any, NamedTuple

import numpy as np

from hdsp.base.errors import InputError
from hdsp.base.messages import shown
from hdsp.base.scalars import integer, real, scalar
from hdsp.terrain.map_frame import MapFrame

#: Largest number of cells in a file unless the option max_cells is another. A damaged header may claim any size.
MAX_CELLS = 100_000_000


class MissingOption(InputError):
    """Raised where a file needs an option, such as a cell size or the choice of a layer."""


class MapFields(NamedTuple):
    """Contents of a height map file.

    Attributes:
        heights: [nx, ny] numbers, heights[ix, iy], in the file's units; masked or NaN = unknown.
        origin: position (x, y) of the lower corner of cell (0, 0), m.
        resolution: cell size, m.
        frame: frame of the map, with notes on the file.
        scale: m per unit of the heights.
        offset: m, height of their zero.
    """

    heights: np.ndarray
    origin: tuple[float, float]
    resolution: float
    frame: MapFrame = MapFrame()
    scale: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True)
class ReadOptions:
    """Facts that a file lacks, and choices between its parts. None: the file has them, or needs none.

    Attributes:
        resolution: cell size, m, for files without one.
        origin: position (x, y) of the lower corner of cell (0, 0), m, for files without one (default there: 0, 0).
        scale: m per unit of the file's heights, e.g. 0.001 for millimetres, or m per grey step; negative where the file
            counts downwards.
        offset: height of the file's zero, m.
        nodata: value of unknown cells, in the file's units.
        layer: name or number of a layer, band or entry.
        topic: topic of a bag.
        message: index of a message in its topic; -1 is the last.
        max_cells: largest number of cells; None = 100 million.

    Raises:
        InputError: an unknown option, or a value of another kind.
    """

    resolution: float | None = None
    origin: tuple[float, float] | None = None
    scale: float | None = None
    offset: float | None = None
    nodata: float | None = None
    layer: str | int | None = None
    topic: str | None = None
    message: int | None = None
    max_cells: int | None = None

    def __post_init__(self):
        for name, need in (("resolution", "positive"), ("scale", "non-zero"), ("offset", "finite")):
            given = getattr(self, name)
            if given is None:
                continue
            value = real(given)
            if not math.isfinite(value) or (need == "positive" and value <= 0) or (need == "non-zero" and value == 0):
                raise InputError(f"option {name} is {shown(given)}; need a {need} number of metres")
            object.__setattr__(self, name, value)
        if self.nodata is not None:
            if not isinstance(scalar(self.nodata), Real):  # NaN is a number here
                raise InputError(f"option nodata is {shown(self.nodata)}; need a number")
            object.__setattr__(self, "nodata", real(self.nodata))
        for name, need in (("message", "whole"), ("max_cells", "positive whole")):
            given = getattr(self, name)
            if given is None:
                continue
            count = integer(given)
            if count is None or (need != "whole" and count < 1):
                raise InputError(f"option {name} is {shown(given)}; need a {need} number")
            object.__setattr__(self, name, count)
        if self.origin is not None:
            object.__setattr__(self, "origin", _point(self.origin))

    @classmethod
    def of(cls, options: Mapping[str, Any]) -> ReadOptions:
        """Makes options from keywords; an unknown keyword is an error that lists all."""
        names = [option.name for option in fields(cls)]
        unknown = sorted(set(options) - set(names))
        if unknown:
            raise InputError(f"option {unknown[0]}: unknown; need one of {', '.join(names)}")
        return cls(**options)

    @property
    def given(self) -> tuple[str, ...]:
        """Names of the options that have a value."""
        return tuple(option.name for option in fields(self) if getattr(self, option.name) is not None)

    def cell_size(self, why: str, further: str = "") -> float:
        """Cell size for a file without one, m; an error with the reason, and further words, without the option."""
        if self.resolution is None:
            raise MissingOption(f"{why}; give the option resolution, the side of a cell in metres{further}")
        return self.resolution

    def check_cells(self, nx: int, ny: int) -> None:
        """Refuses a claimed size before memory is taken for it."""
        check_cells(nx, ny, self.max_cells or MAX_CELLS)

    def refuse(self, names: Sequence[str], why: str) -> None:
        """Refuses options by name, with the reason."""
        for name in names:
            if getattr(self, name) is not None:
                raise InputError(f"option {name} does not apply: {why}")


def check_cells(nx: int, ny: int, most: int = MAX_CELLS) -> None:
    """Refuses a claimed size, of more than ``most`` cells, before memory is taken for it."""
    if nx < 1 or ny < 1:
        raise InputError(f"the file has {nx} x {ny} cells; need at least one")
    if nx * ny > most:
        raise InputError(f"the file claims {nx} x {ny} cells; at most {most:,} are read (max_cells), so cut a part out")


def frame_text(frame: MapFrame | None) -> str:
    """JSON text with the fields of a frame; "" for a map without a frame of its own."""
    if frame is None or not (frame.name or frame.crs or frame.notes or not frame.is_source):
        return ""
    return json.dumps({**vars(frame), "to_source": frame.to_source.tolist()})


def frame_of_text(text: str | bytes) -> MapFrame:
    """Frame from the text of `frame_text`.

    Raises:
        ValueError: the text is damaged.
    """
    if not text:
        return MapFrame()
    try:
        values = json.loads(text)
        frame = MapFrame(**{name: values[name] for name in MapFrame.__dataclass_fields__})
        return replace(frame, name=str(frame.name), crs=str(frame.crs))
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError(f"entry frame is damaged: {error}") from None


def _point(value: Any) -> tuple[float, float]:
    try:
        x, y = (real(part) for part in value)
    except (TypeError, ValueError):
        raise InputError(f"option origin is {shown(value)}; need two numbers (x, y) in metres") from None
    if not (math.isfinite(x) and math.isfinite(y)):
        raise InputError(f"option origin is {shown(value)}; need two finite numbers (x, y) in metres")
    return x, y
