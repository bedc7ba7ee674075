"""Rasters of geographic information systems by rasterio: GeoTIFF, ASCII grids, USGS DEM, Erdas Imagine.

The transform of a raster places it: a raster with north up has its first row at the upper edge (largest y). A rotated
raster keeps its axes, and the frame has the rotation. Masks, no-data values, and scale and offset of a band count.
"""

from __future__ import annotations

import hashlib
import math
import uuid
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from hdsp.base.errors import InputError
from hdsp.base.quiet import quiet_thread
from hdsp.terrain.map_formats.ascii_grids import AsciiGrid, read_ascii_grid
from hdsp.terrain.map_formats.fields import (
    MapFields,
    MissingOption,
    ReadOptions,
    frame_of_text,
    frame_text,
)
from hdsp.terrain.map_formats.file_checksum import check_file, with_checksum
from hdsp.terrain.map_formats.raster_units import check_crs, height_units
from hdsp.terrain.map_frame import MapFrame

#: Drivers by suffix. Drivers whose files refer to other files or addresses are left out.
_DRIVERS = {".tif": "GTiff", ".tiff": "GTiff", ".asc": "AAIGrid", ".dem": "USGSDEM", ".img": "HFA"}
_OF_TEXTS = ".asc", ".dem"
#: Tag with the frame of a map that this package wrote.
_TAG = "HDSP_FRAME"
#: Tag with a checksum over heights and transform, for files whose last line (`file_checksum`) is lost.
_DIGEST = "HDSP_SHA256"
_CHANGED = "it differs from its checksum: changed by another program, or damaged"


def read_raster(path: Path, options: ReadOptions) -> MapFields:
    """Reads one band of a raster."""
    check_file(path)
    with _opened(path) as (raster, grid):
        options.check_cells(raster.width, raster.height)
        band = _band(raster, options.layer)
        kind = np.dtype(raster.dtypes[band - 1]).kind
        if kind not in "iuf":
            raise InputError(f"band {band} has the type {raster.dtypes[band - 1]}; need numbers")
        check_crs(raster.crs)
        rows = grid.heights(raster.height, raster.width) if grid else raster.read(band, masked=True)
        scale, offset, notes = height_units(raster, band)
        notes += [f"heights times {grid.multiplier:g}, as the header says"] if grid and grid.multiplier != 1 else []
        written = raster.tags().get(_TAG, "")
        changed = raster.tags().get(_DIGEST, "") not in ("", _digest(rows, raster.transform, written))
        notes += [_CHANGED] if changed else []
        if raster.count > 1:
            notes.append(f"band {band} of {raster.count}")
        crs = raster.crs.to_string() if raster.crs else ""
        if raster.transform.is_identity and raster.gcps[0]:
            raise InputError("it has ground control points and no transform; make one, e.g. gdalwarp IN OUT")
        if raster.transform.is_identity:
            resolution = options.cell_size("it has no transform, so no cell size")
            frame = MapFrame(crs=crs, notes=tuple(notes))
            return MapFields(rows.T[:, ::-1], options.origin or (0.0, 0.0), resolution, frame, scale, offset)
        options.refuse(("resolution", "origin"), "the file has its own transform")
        fields = _placed(rows, raster.transform, crs, tuple(notes))._replace(scale=scale, offset=offset)
    if not written:
        return fields
    frame = frame_of_text(written)  # another program may have changed the CRS, but left the tag
    more = (_CHANGED,) if changed or (crs and frame.crs and crs != frame.crs) else ()
    return fields._replace(frame=replace(frame, crs=crs or frame.crs, notes=(*frame.notes, *more)))


def raster_contents(path: Path) -> str:
    """Size, bands, CRS, transform and no-data value of a raster."""
    with _opened(path) as (raster, grid):
        bands = ", ".join(
            f"{number} ({kind}{f', {name}' if name else ''})"
            for number, kind, name in zip(raster.indexes, raster.dtypes, raster.descriptions, strict=True)
        )
        nodata = grid.nodata if grid else raster.nodata
        units = " / ".join(sorted({str(unit) for unit in raster.units if unit})) or "not named"
        return (
            f"{raster.width} x {raster.height} pixels, bands {bands}, CRS {raster.crs or 'none'}, "
            f"no-data value {'none' if nodata is None else f'{nodata:g}'}, vertical units {units}"
        )


def geotiff_bytes(fields: MapFields) -> bytes:
    """File contents of a map in GeoTIFF: float32, NaN = unknown, in the map frame; a tag keeps the frame."""
    from affine import Affine
    from rasterio.io import MemoryFile

    heights = np.asarray(fields.heights, np.float32)
    rows = heights.T[::-1]
    (nx, ny), (x, y) = heights.shape, fields.origin
    transform = Affine(fields.resolution, 0.0, x, 0.0, -fields.resolution, y + ny * fields.resolution)
    with MemoryFile(ext=".tif") as memory:
        with memory.open(
            driver="GTiff", width=nx, height=ny, count=1, dtype="float32", nodata=math.nan, transform=transform,
            crs=_known_crs(fields.frame), compress="deflate",
        ) as raster:  # fmt: skip
            raster.write(rows, 1)
            text = frame_text(fields.frame)
            raster.update_tags(**{_DIGEST: _digest(rows, transform, text), **({_TAG: text} if text else {})})
            raster.set_band_description(1, "elevation")
        return with_checksum(memory.read())


def _digest(rows: Any, transform: Any, frame: str) -> str:
    """Checksum over heights float32 [rows, columns], masked or NaN = unknown, their transform, and a frame as text."""
    heights = np.ma.filled(np.ma.asarray(rows).astype(np.float32), np.nan)
    heights = np.where(np.isnan(heights), np.float32("nan"), heights)
    place = np.array(tuple(transform)[:6], float)
    return hashlib.sha256(
        f"{heights.shape}".encode() + heights.tobytes() + place.tobytes() + frame.encode()
    ).hexdigest()


@contextmanager
def _opened(path: Path) -> Iterator[tuple[Any, AsciiGrid | None]]:
    """The opened raster, and its text if it is an ASCII grid."""
    import rasterio

    with ExitStack() as stack:
        stack.enter_context(rasterio.Env())
        stack.enter_context(quiet_thread())  # a message of GDAL that cites damaged bytes has a traceback printed
        suffix = path.suffix.lower()
        grid = read_ascii_grid(path) if suffix in _OF_TEXTS else None
        if grid and not _as_gdal_expects(path):
            raster = _opened_in_memory(path, grid, stack)
        else:
            raster = stack.enter_context(rasterio.open(path, driver=grid.driver if grid else _DRIVERS[suffix]))
            _check_files(path, raster)
        yield raster, grid


def _as_gdal_expects(path: Path) -> bool:
    """Whether a text begins with a word of its header; GDAL knows neither byte-order marks nor comments before it."""
    with path.open("rb") as file:
        return file.read(1).isalpha()


def _opened_in_memory(path: Path, grid: AsciiGrid, stack: ExitStack) -> Any:
    """Raster of a text, with the CRS in the .prj file beside it."""
    from rasterio.io import MemoryFile

    folder = uuid.uuid4().hex
    for crs in (path.with_suffix(".prj"), path.with_suffix(".PRJ")):
        if crs.is_file():
            stack.enter_context(MemoryFile(crs.read_bytes(), dirname=folder, filename="grid.prj"))
            break
    file = stack.enter_context(MemoryFile(grid.text.encode(), dirname=folder, filename="grid.asc"))
    return stack.enter_context(file.open(driver=grid.driver))


def _check_files(path: Path, raster: Any) -> None:
    """Refuses a raster with parts in other folders; a file beside it with its own name, such as .prj, is welcome."""
    folder = path.resolve().parent
    for name in raster.files:
        if Path(name).resolve().parent != folder:
            raise InputError(f"it refers to {name}, outside its folder")


def _band(raster: Any, layer: str | int | None) -> int:
    names = [name or "" for name in raster.descriptions]
    bands = [k + 1 for k, kind in enumerate(raster.colorinterp) if kind.name != "alpha"]
    if layer is None and len(bands) == 1:
        return bands[0]
    if layer is None and names.count("elevation") == 1:
        return names.index("elevation") + 1
    if layer is not None and str(layer) in names:
        return names.index(str(layer)) + 1
    if layer is not None and str(layer).isdecimal() and 1 <= int(layer) <= raster.count:
        return int(layer)
    listed = ", ".join(f"{k + 1}{f' ({name})' if name else ''}" for k, name in enumerate(names[:20]))
    if layer is None:
        raise MissingOption(f"it has {raster.count} bands: {listed}; name one with the option layer")
    raise InputError(f"option layer is {layer!r}; need a band: {listed}")


def _placed(heights: np.ndarray, transform: Any, crs: str, notes: tuple[str, ...]) -> MapFields:
    """Map with its lower left corner first, from rows and columns and their transform to world positions."""
    rows, columns = heights.shape
    along, down = np.array((transform.a, transform.d)), np.array((transform.b, transform.e))
    sides = np.hypot(*along), np.hypot(*down)
    if not (np.isfinite(transform).all() and min(sides) > 0):
        raise InputError(f"its transform {tuple(transform)[:6]} is none")
    resolution = math.sqrt(sides[0] * sides[1])
    if abs(sides[0] - sides[1]) * max(rows, columns) > resolution / 2:
        side = f"{min(sides):g}"
        raise InputError(
            f"its pixels are {sides[0]:g} x {sides[1]:g} m; need squares, e.g. gdalwarp -tr {side} {side} IN OUT"
        )
    if abs(along @ down) > 1e-6 * resolution**2:
        raise InputError("its pixels are sheared; need squares, e.g. from gdalwarp IN OUT")
    grid = heights.T
    if along[0] * down[1] - along[1] * down[0] < 0:  # rows run against y
        corner = np.array((transform.c, transform.f)) + rows * down
        grid, down = grid[:, ::-1], -down
    else:
        corner = np.array((transform.c, transform.f))
    if along[0] < 0 and abs(along[1]) < 1e-9 * resolution:  # half a turn needs no rotated frame
        corner = corner + columns * along + rows * down
        grid, along = grid[::-1, ::-1], -along
    frame = MapFrame(crs=crs, notes=notes)
    if abs(along[1]) < 1e-9 * resolution:
        return MapFields(grid, (float(corner[0]), float(corner[1])), resolution, frame)
    yaw = math.atan2(along[1], along[0])
    motion = np.eye(4)
    motion[:2, :2] = [[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]]
    motion[:2, 3] = corner
    turned = replace(frame, to_source=motion, notes=(*notes, f"axes rotated by {math.degrees(yaw):.2f} degrees"))
    return MapFields(grid, (0.0, 0.0), resolution, turned)


def _known_crs(frame: MapFrame) -> Any:
    from rasterio.crs import CRS
    from rasterio.errors import CRSError

    if not frame.crs or not frame.is_source:
        return None
    try:
        return CRS.from_string(frame.crs)
    except CRSError:
        return None  # the tag keeps the text
