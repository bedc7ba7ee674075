"""Arrays in files: .npz and HDF5 with the entries heights, origin and resolution, and bare .npy arrays.

A map with a frame of its own also has the entry frame, a JSON text with the fields of `MapFrame`. The entry digest is
the SHA-256 of all others: HDF5 has no checksum for small entries, and an archive none for the names in its directory.
Files of other programs may have other entries: the option layer names the heights, and the options resolution and
origin (default: 0, 0) stand for missing entries.
"""

from __future__ import annotations

import hashlib
import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from hdsp.base.array_files import Entry, array_header, npz_entries
from hdsp.base.errors import InputError
from hdsp.terrain.map_formats.fields import (
    MapFields,
    MissingOption,
    ReadOptions,
    frame_of_text,
    frame_text,
)
from hdsp.terrain.map_formats.hdf5_entries import hdf5_entries

_HEIGHTS, _ORIGIN, _RESOLUTION, _FRAME, _DIGEST = "heights", "origin", "resolution", "frame", "digest"

#: Numbers in an entry.
_COUNTS = {_ORIGIN: 2, _RESOLUTION: 1}

#: Rows of three numbers, so many and more, are points rather than a map three cells wide.
_POINTS = 100

#: Largest number of elements in an entry beside the heights.
_SMALL = 1_000_000


def read_npz(path: Path, options: ReadOptions) -> MapFields:
    """Reads an .npz file."""
    with npz_entries(path) as entries:
        return _fields(entries, options)


def read_hdf5(path: Path, options: ReadOptions) -> MapFields:
    """Reads an HDF5 file."""
    with hdf5_entries(path, (_layer(options), _ORIGIN, _RESOLUTION, _FRAME, _DIGEST)) as entries:
        return _fields(entries, options)


def read_npy(path: Path, options: ReadOptions) -> MapFields:
    """Reads a bare array [nx, ny]; its cell size is an option."""
    resolution = options.cell_size("a bare array has no cell size")
    with path.open("rb") as file:
        shape, dtype = array_header(file, path.stat().st_size)
        _check_heights("the array", shape, dtype, options)
        file.seek(0)
        heights = np.lib.format.read_array(file, allow_pickle=False)
    return MapFields(heights, options.origin or (0.0, 0.0), resolution)


def npz_contents(path: Path) -> str:
    """Entries of an .npz file."""
    with npz_entries(path) as entries:
        return _listed(entries)


def hdf5_contents(path: Path) -> str:
    """Entries of an HDF5 file."""
    with hdf5_entries(path) as entries:
        return _listed(entries)


def npy_contents(path: Path) -> str:
    """Shape and type of a bare array."""
    with path.open("rb") as file:
        return "array " + _of_kind(*array_header(file, path.stat().st_size))


def npz_bytes(fields: MapFields) -> bytes:
    """File contents of a map in .npz."""
    buffer = io.BytesIO()
    arrays = _arrays(fields)
    # The digest comes first: damage to a directory may hide the entries behind the damaged one.
    np.savez_compressed(buffer, allow_pickle=False, **{_DIGEST: _digest(arrays)}, **arrays)
    return buffer.getvalue()


def hdf5_bytes(fields: MapFields) -> bytes:
    """File contents of a map in HDF5."""
    import h5py

    arrays = _arrays(fields)
    buffer = io.BytesIO()
    with h5py.File(buffer, "w", libver=("v110", "v110")) as file:  # metadata with checksums
        for name, array in {**arrays, _DIGEST: _digest(arrays)}.items():
            layout: dict[str, Any] = {"compression": "lzf", "fletcher32": True} if array.ndim == 2 else {}
            file.create_dataset(name, data=array, **layout)
    return buffer.getvalue()


def _arrays(fields: MapFields) -> dict[str, np.ndarray]:
    arrays = {
        _HEIGHTS: fields.heights,
        _ORIGIN: np.asarray(fields.origin, float),
        _RESOLUTION: np.asarray(fields.resolution, float),
    }
    if text := frame_text(fields.frame):
        arrays[_FRAME] = np.frombuffer(text.encode(), np.uint8)
    return arrays


def _digest(arrays: Mapping[str, np.ndarray]) -> np.ndarray:
    state = hashlib.sha256()
    for name in sorted(arrays):
        array = arrays[name]
        state.update(f"{name} {array.dtype.str} {array.shape}".encode() + array.tobytes())
    return np.frombuffer(state.digest(), np.uint8)


def _fields(entries: Mapping[str, Entry], options: ReadOptions) -> MapFields:
    layer = _layer(options)
    _check_complete(layer, entries, options)
    shape, dtype, read = entries[layer]
    _check_heights(f"entry {layer}", shape, dtype, options)
    small = {name: _small(name, entries) for name in (_ORIGIN, _RESOLUTION, _FRAME, _DIGEST) if name in entries}
    heights = read()
    if _DIGEST in small:
        others = {name: array for name, array in small.items() if name != _DIGEST}
        if layer == _HEIGHTS and _digest({_HEIGHTS: heights, **others}).tolist() != small[_DIGEST].tolist():
            raise InputError("it is damaged: its checksum differs")
    return MapFields(
        heights,
        _own(_ORIGIN, small, options.origin or (0.0, 0.0), options),
        _own(_RESOLUTION, small, options.resolution, options),
        frame_of_text(np.asarray(small[_FRAME], np.uint8).tobytes()) if _FRAME in small else frame_of_text(""),
    )


def _layer(options: ReadOptions) -> str:
    return _HEIGHTS if options.layer is None else str(options.layer)


def _check_complete(layer: str, entries: Mapping[str, Entry], options: ReadOptions) -> None:
    """Names everything at once that neither the entries nor the options have."""
    missing = []
    if layer not in entries:
        known = f"it has {_names(entries)}" if entries else "it has no array"
        missing.append(f"entry {layer} is missing, {known}; the option layer names another entry with heights")
    if _RESOLUTION not in entries and options.resolution is None:
        missing.append("entry resolution is missing; give the option resolution, the side of a cell in metres")
    # A map of ours has an origin; a missing one is damage.
    if missing or layer == _HEIGHTS:
        missing += _missing_origin(entries, options)
    if missing:
        raise MissingOption("; ".join(missing))


def _missing_origin(entries: Mapping[str, Entry], options: ReadOptions) -> list[str]:
    if _ORIGIN in entries or options.origin is not None:
        return []
    return ["entry origin is missing; give the option origin, in metres, unless it is (0, 0)"]


def _own(name: str, small: Mapping[str, np.ndarray], option: Any, options: ReadOptions) -> Any:
    """Value of an entry, or of the option with its name; an error for an entry with other numbers."""
    if name not in small:
        return option
    options.refuse([name], f"the file has its own {name}, {small[name].tolist()}")
    count, values = _COUNTS[name], small[name]
    if values.size != count or not np.isfinite(values).all():
        need = "one finite number" if count == 1 else f"{count} finite numbers"
        raise InputError(f"entry {name} is {values.tolist()!s:.80}; need {need} of metres")
    return values.item() if count == 1 else tuple(values.ravel().tolist())


def _small(name: str, entries: Mapping[str, Entry]) -> np.ndarray:
    shape, dtype, read = entries[name]
    if np.prod(shape, dtype=float) > _SMALL or dtype.kind not in "iuf":
        raise InputError(f"entry {name} is {_of_kind(shape, dtype)}; need a few numbers")
    return np.asarray(read())


def _check_heights(name: str, shape: tuple[int, ...], dtype: np.dtype, options: ReadOptions) -> None:
    if len(shape) != 2 or dtype.kind not in "iuf":
        raise InputError(f"{name} is {_of_kind(shape, dtype)}; need numbers in two axes [nx, ny]")
    if shape[1] == 3 and shape[0] >= _POINTS:
        raise InputError(
            f"{name} is {_of_kind(shape, dtype)}: points? load it with numpy; HeightMap.from_points maps it"
        )
    options.check_cells(*shape)


def _of_kind(shape: tuple[int, ...], dtype: np.dtype) -> str:
    return f"{dtype.name} [{', '.join(str(length) for length in shape)}]"


def _names(entries: Mapping[str, Entry]) -> str:
    names = sorted(entries)
    return ", ".join(names[:12]) + (f" and {len(names) - 12} more" if len(names) > 12 else "")


def _listed(entries: Mapping[str, Entry]) -> str:
    return "entries " + ", ".join(f"{name} {_of_kind(*entries[name][:2])}" for name in sorted(entries)[:20])
