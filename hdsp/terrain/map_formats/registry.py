"""Format of a height map file by its suffix, and the one place where a file is read or written.

Other packages add formats with the entry point group ``hdsp.map_formats``: the name of an entry point is the suffix
without its dot, its object a `MapFormat`.
"""

from __future__ import annotations

import importlib.util
import os
import re
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from importlib.metadata import entry_points
from pathlib import Path

import numpy as np

from hdsp.base.errors import InputError
from hdsp.base.files import existing_file, replacing
from hdsp.base.quiet import quiet_thread
from hdsp.terrain.map_formats.archives import (
    hdf5_bytes,
    hdf5_contents,
    npy_contents,
    npz_bytes,
    npz_contents,
    read_hdf5,
    read_npy,
    read_npz,
)
from hdsp.terrain.map_formats.ascii_grids import is_ascii_grid
from hdsp.terrain.map_formats.fields import MapFields, MissingOption, ReadOptions
from hdsp.terrain.map_formats.grid_map_bags import bag_contents, is_bag_folder, read_grid_map
from hdsp.terrain.map_formats.images import image_contents, read_image_map
from hdsp.terrain.map_formats.rasters import geotiff_bytes, raster_contents, read_raster
from hdsp.terrain.map_frame import MapFrame
from hdsp.terrain.no_data import coarse_steps, without_no_data

_HEIGHTS = ("scale", "offset", "nodata", "max_cells")
_PLACE = ("resolution", "origin")


@dataclass(frozen=True)
class MapFormat:
    """A format of height map files.

    Attributes:
        name: name for people.
        read: file and options -> contents; errors of any type are reported as one line.
        contents: file -> its parts in words.
        options: names of the options that apply, beside scale, offset, nodata and max_cells.
        write: contents -> bytes; None = the format is only read.
        library: module that must be installed, "" if none.
        self_contained: whether a file needs no option.
    """

    name: str
    read: Callable[[Path, ReadOptions], MapFields]
    contents: Callable[[Path], str]
    options: tuple[str, ...] = ()
    write: Callable[[MapFields], bytes] | None = None
    library: str = ""
    self_contained: bool = True


_NPZ = MapFormat("NumPy archive", read_npz, npz_contents, (*_PLACE, "layer"), npz_bytes)
_HDF5 = MapFormat("HDF5", read_hdf5, hdf5_contents, (*_PLACE, "layer"), hdf5_bytes)
_NPY = MapFormat("NumPy array", read_npy, npy_contents, _PLACE, self_contained=False)
_BAG = MapFormat("ROS bag", read_grid_map, bag_contents, ("topic", "layer", "message"), library="rosbags")


def _raster(name: str, write: Callable[[MapFields], bytes] | None = None) -> MapFormat:
    return MapFormat(name, read_raster, raster_contents, (*_PLACE, "layer"), write, "rasterio")


def _image(name: str) -> MapFormat:
    return MapFormat(name, read_image_map, image_contents, _PLACE, library="PIL", self_contained=False)


#: Format of each suffix. A folder with a ROS 2 bag has the format of its files.
_FORMATS: dict[str, MapFormat] = {
    ".npz": _NPZ,
    ".h5": _HDF5,
    ".hdf5": _HDF5,
    ".npy": _NPY,
    ".tif": _raster("GeoTIFF", geotiff_bytes),
    ".tiff": _raster("GeoTIFF", geotiff_bytes),
    ".asc": _raster("ASCII grid"),
    ".dem": _raster("USGS DEM"),
    ".img": _raster("Erdas Imagine"),
    ".png": _image("PNG"),
    ".pgm": _image("PGM"),
    ".bag": _BAG,
    ".db3": _BAG,
    ".mcap": _BAG,
}

#: Suffixes of the height map formats of this package.
MAP_SUFFIXES = tuple(_FORMATS)

_WRITABLE = tuple(suffix for suffix, form in _FORMATS.items() if form.write)

#: Cell sizes that a map in metres may have, m.
_SMALLEST, _LARGEST = 1e-4, 1e4
#: Largest coordinate of an origin, m; projected coordinates stay far below.
_FARTHEST = 1e9

#: First characters of a text of points.
_BEGINS = tuple(bytes([character]) for character in b"+-.#/0123456789")

#: Name on the package index of a library whose module has another name.
_DISTRIBUTION = {"PIL": "pillow"}


def is_map(path: str | os.PathLike) -> bool:
    """Whether a height map format has this file's suffix, or the path is the folder of a ROS 2 bag.

    An .asc file of points, without the header of a grid, is no map.
    """
    path = _path(path)
    if path.is_dir():
        return is_bag_folder(path)
    return _known(path) is not None and not _is_text_of_points(path)


def is_self_contained(path: str | os.PathLike) -> bool:
    """Whether a file is a map that needs no option, such as a cell size."""
    form = _known(_path(path))
    return form is not None and form.self_contained and is_map(path)


def read_map(path: str | os.PathLike, options: ReadOptions | None = None) -> MapFields:
    """Reads a height map file; the suffix selects the format.

    Obvious no-data values and infinite heights become unknown, with a note in the frame.

    Returns:
        contents with float heights in m, NaN = unknown.

    Raises:
        InputError: if the file is missing, damaged or too large, has another format, lacks a part or a library, or an
            option does not apply.
    """
    options = options or ReadOptions()
    path, form = _found(path)
    for name in options.given:
        if name not in (*form.options, *_HEIGHTS):
            allowed = ", ".join((*form.options, *_HEIGHTS))
            raise InputError(f"height map {path}: option {name} does not apply to {form.name}; need one of {allowed}")

    def read() -> MapFields:
        return _in_metres(form.read(path, options), options)

    return _guarded(path, form, read)


def map_contents(path: str | os.PathLike) -> str:
    """Format of a height map file and its parts (entries, bands, topics, layers), in words.

    Raises:
        InputError: as in `read_map`.
    """
    path, form = _found(path)
    return f"{form.name}, " + _guarded(path, form, lambda: form.contents(path))


def check_writable(path: str | os.PathLike) -> None:
    """Refuses a path whose suffix no writer has, or whose library is missing, before any work.

    Raises:
        InputError: with the suffixes that are written, or the command that installs the library.
    """
    _writer(path)


def write_map(path: str | os.PathLike, fields: MapFields) -> None:
    """Writes a height map file; the suffix selects the format.

    Raises:
        InputError: if no writer has the suffix, a library is missing, or the path is not writable.
    """
    write = _writer(path)
    # The bytes turn a full disk into an ordinary OSError; HDF5 itself reports a full disk in several ways.
    content = write(fields)
    with replacing(path) as temporary:
        temporary.write_bytes(content)


def _guarded(path: Path, form: MapFormat, work: Callable):
    """Result of a reader; its errors of any type as one line that names the file."""
    try:
        with quiet_thread():  # file libraries warn of their own affairs
            return work()
    except MissingOption as error:
        raise MissingOption(f"height map {path}: {error}") from None
    except InputError as error:
        raise InputError(f"height map {path}: {error}") from None
    except ImportError as error:
        raise InputError(f"height map {path}: {error}; pip install 'hdsp[maps]'") from error
    except MemoryError:
        raise InputError(f"height map {path}: it needs more memory than there is") from None
    except Exception as error:  # file libraries raise errors of many types for damaged files
        # rasterio hides the reason in the cause.
        cause = error.__cause__ if type(error).__module__.startswith("rasterio") and error.__cause__ else error
        reason = " ".join(str(cause).split())[:200] or type(cause).__name__
        raise InputError(f"height map {path} cannot be read: {reason}") from error


def _found(path: str | os.PathLike) -> tuple[Path, MapFormat]:
    """Existing file or folder and its format, with its library installed."""
    path = _path(path)
    if path.is_dir() and is_bag_folder(path):
        form = _BAG
    else:
        known = _known(path)
        if known is None:
            raise InputError(f"height map {path}: suffix {path.suffix!r}; need one of {', '.join(_FORMATS)}")
        form, path = known, existing_file(path, "height map")
        if path.stat().st_size == 0:
            raise InputError(f"height map {path}: the file is empty")
    _check_library(path, form)
    return path, form


def _path(path: str | os.PathLike) -> Path:
    """Path that the operating system can look up."""
    try:
        found = Path(path)
        found.is_dir()
    except TypeError:
        raise InputError(f"path of a map is a {type(path).__name__}; need a text or a Path") from None
    except OSError as error:  # e.g. a name that is too long
        raise InputError(f"path of a map {str(path)[:60]}...: {error.strerror}") from None
    return found


def _known(path: Path) -> MapFormat | None:
    suffix = path.suffix.lower()
    return _FORMATS.get(suffix) or _added().get(suffix)


@cache
def _added() -> dict[str, MapFormat]:
    """Formats of other packages."""
    return {f".{point.name.lower()}": point.load() for point in entry_points(group="hdsp.map_formats")}


def _writer(path: str | os.PathLike) -> Callable[[MapFields], bytes]:
    path = _path(path)
    form = _known(path)
    if form is None or form.write is None:
        raise InputError(f"height map {path}: suffix {path.suffix!r}; need one of {', '.join(_WRITABLE)} to write")
    _check_library(path, form)
    return form.write


def _check_library(path: Path, form: MapFormat) -> None:
    if form.library and importlib.util.find_spec(form.library) is None:
        name = _DISTRIBUTION.get(form.library, form.library)
        raise InputError(f"height map {path}: {form.name} needs {name}: pip install 'hdsp[maps]'")


def _is_text_of_points(path: Path) -> bool:
    """Whether an .asc file begins as a point cloud does: with numbers, a comment, or the names x, y and z."""
    if path.suffix.lower() != ".asc" or not path.is_file():
        return False
    try:
        if is_ascii_grid(path):
            return False
        with path.open("rb") as file:
            begin = file.read(400).replace(b"\0", b"").lstrip(b"\xef\xbb\xbf\xff\xfe \t\r\n")
    except OSError:
        return False
    names = set(re.findall(rb"\w+", begin.partition(b"\n")[0].lower()))
    return begin[:1] in _BEGINS or {b"x", b"y", b"z"} <= names


def _in_metres(fields: MapFields, options: ReadOptions) -> MapFields:
    """Contents with float heights in m, NaN = unknown, and notes on the changes."""
    if np.ndim(fields.heights) != 2:
        raise InputError(f"its heights have shape {np.shape(fields.heights)}; need two axes")
    options.check_cells(*np.shape(fields.heights))
    if not _SMALLEST <= float(fields.resolution) <= _LARGEST:
        raise InputError(f"its cells of {float(fields.resolution):g} m are none; need {_SMALLEST:g} to {_LARGEST:g} m")
    if not (np.abs(np.asarray(fields.origin, float)) <= _FARTHEST).all():
        raise InputError(f"its origin {tuple(fields.origin)} is no place on Earth in metres")
    values, coarse = np.ma.getdata(fields.heights), coarse_steps(fields.heights)
    heights = np.array(values, dtype=np.float32 if values.dtype.itemsize < 4 else None)
    heights = heights.astype(float) if heights.dtype.kind != "f" else heights
    heights[np.ma.getmaskarray(fields.heights)] = np.nan
    if options.nodata is not None:
        # A no-data value is a decimal text, the heights are float32 or float64.
        heights[(heights == options.nodata) | (heights == np.float32(options.nodata))] = np.nan
    heights, notes = without_no_data(heights)
    notes = (*notes, coarse) if coarse else notes
    if (fields.scale, fields.offset) != (1.0, 0.0):
        heights = heights * fields.scale + fields.offset
    if options.scale is not None:
        heights = heights * options.scale
        notes = (*notes, f"heights times {options.scale:g}")
    if options.offset is not None:
        heights = heights + options.offset
        notes = (*notes, f"heights plus {options.offset:g} m")
    frame: MapFrame = fields.frame
    if notes:
        frame = replace(frame, notes=(*frame.notes, *notes))
    return fields._replace(heights=heights, frame=frame)
