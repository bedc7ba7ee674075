"""Height map files: .npz and HDF5 (.h5, .hdf5), both with the entries heights, origin and resolution.

A map with a frame of its own also has the entry frame, a JSON text with the fields of `MapFrame`.
"""

import io
import json
import os
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hdsp.base.errors import InputError
from hdsp.base.files import existing_file, replacing
from hdsp.terrain.map_frame import MapFrame

_ENTRIES = "heights", "origin", "resolution"
_FRAME = "frame"


class MapFields(NamedTuple):
    """Entries in a height map file, before validation."""

    heights: np.ndarray
    origin: tuple[float, float]
    resolution: float
    frame: MapFrame = MapFrame()


def is_map(path: str | os.PathLike) -> bool:
    """Whether a height map format has this file's suffix."""
    return Path(path).suffix in _FORMATS


def read_map(path: str | os.PathLike) -> MapFields:
    """Reads a height map file; the suffix selects the format.

    Raises:
        InputError: if the file is missing or damaged, has another format, or lacks an entry.
    """
    read, _ = _format(path)
    path = existing_file(path, "height map")
    try:
        entries = read(path)
        frame = _frame_of(entries.pop(_FRAME, None))
        return MapFields(**entries, frame=frame)
    except KeyError as error:
        missing = [name for name in _ENTRIES if name in str(error)] or _ENTRIES
        raise InputError(f"height map {path}: entry {missing[0]} is missing") from None
    except (OSError, EOFError, ValueError, TypeError, RuntimeError, zipfile.BadZipFile, zlib.error) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(f"height map {path} cannot be read: {reason}") from error


def write_map(
    path: str | os.PathLike,
    heights: np.ndarray,
    origin: tuple[float, float],
    resolution: float,
    frame: MapFrame | None = None,
) -> None:
    """Writes a height map file; the suffix selects the format.

    Raises:
        InputError: if no format has the suffix, or the path is not writable.
    """
    _, write = _format(path)
    # The buffer turns a full disk into an ordinary OSError; HDF5 itself reports a full disk in several ways.
    buffer = io.BytesIO()
    entries = {"heights": heights, "origin": np.asarray(origin, float), "resolution": np.asarray(resolution, float)}
    if frame is not None and (frame.name or frame.crs or frame.notes or not frame.is_source):
        entries[_FRAME] = np.frombuffer(_text_of(frame).encode(), np.uint8)
    write(buffer, **entries)
    with replacing(path) as temporary:
        temporary.write_bytes(buffer.getvalue())


def _text_of(frame: MapFrame) -> str:
    return json.dumps({**vars(frame), "to_source": frame.to_source.tolist()})


def _frame_of(text: np.ndarray | None) -> MapFrame:
    if text is None:
        return MapFrame()
    try:
        values = json.loads(np.asarray(text, np.uint8).tobytes())
        return MapFrame(**{name: values[name] for name in MapFrame.__dataclass_fields__})
    except (KeyError, TypeError, InputError) as error:
        raise ValueError(f"entry {_FRAME} is damaged: {error}") from None


def _read_npz(path: Path) -> dict[str, np.ndarray]:
    with np.load(path, allow_pickle=False) as file:
        return {name: file[name] for name in (*_ENTRIES, *({_FRAME} & set(file.files)))}


def _read_hdf5(path: Path) -> dict[str, np.ndarray]:
    import h5py

    with h5py.File(path) as file:
        return {name: file[name][()] for name in (*_ENTRIES, *({_FRAME} & set(file)))}


def _write_hdf5(buffer: io.BytesIO, **entries: np.ndarray) -> None:
    import h5py

    with h5py.File(buffer, "w", libver=("v110", "v110")) as file:  # metadata with checksums
        for name, array in entries.items():
            layout = {"compression": "lzf", "fletcher32": True} if array.ndim == 2 else {}
            file.create_dataset(name, data=array, **layout)


_FORMATS: dict[str, tuple[Callable, Callable]] = {
    ".npz": (_read_npz, np.savez_compressed),
    ".h5": (_read_hdf5, _write_hdf5),
    ".hdf5": (_read_hdf5, _write_hdf5),
}


def _format(path: str | os.PathLike) -> tuple[Callable, Callable]:
    suffix = Path(path).suffix
    if suffix not in _FORMATS:
        raise InputError(f"height map {path}: suffix {suffix!r}; need one of {', '.join(_FORMATS)}")
    return _FORMATS[suffix]
