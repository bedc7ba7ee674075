"""Files of height maps: .npz, and HDF5 (.h5, .hdf5), each with the entries heights, origin and resolution."""

import io
import os
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hdsp.base.errors import InputError
from hdsp.base.files import existing_file, replacing


class MapFields(NamedTuple):
    """What a file holds; not yet checked to be a valid map."""

    heights: np.ndarray
    origin: np.ndarray
    resolution: float


def is_map(path: str | os.PathLike) -> bool:
    """Whether the suffix of a file is that of a kind of map."""
    return Path(path).suffix in _FORMATS


def read_map(path: str | os.PathLike) -> MapFields:
    """Reads a file of a kind that its suffix names.

    Raises:
        InputError: if the file is missing, damaged, of another kind, or lacks an entry.
    """
    read, _ = _format(path)
    path = existing_file(path, "height map")
    try:
        return MapFields(**read(path))
    except KeyError as error:
        missing = [name for name in MapFields._fields if name in str(error)] or MapFields._fields
        raise InputError(f"height map {path}: entry {missing[0]} is missing") from None
    except (OSError, EOFError, ValueError, TypeError, RuntimeError, zipfile.BadZipFile, zlib.error) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(f"height map {path} cannot be read: {reason}") from error


def write_map(path: str | os.PathLike, heights: np.ndarray, origin: tuple[float, float], resolution: float) -> None:
    """Writes a file of the kind that its suffix names.

    Raises:
        InputError: if the suffix is another one, or the place cannot be written to.
    """
    _, write = _format(path)
    # Through memory: a full disk is then an ordinary OSError, which HDF5 reports in ways of its own.
    buffer = io.BytesIO()
    write(buffer, heights=heights, origin=np.asarray(origin, float), resolution=np.asarray(resolution, float))
    with replacing(path) as temporary:
        temporary.write_bytes(buffer.getvalue())


def _read_npz(path: Path) -> dict[str, np.ndarray]:
    with np.load(path, allow_pickle=False) as file:
        return {name: file[name] for name in MapFields._fields}


def _read_hdf5(path: Path) -> dict[str, np.ndarray]:
    import h5py

    with h5py.File(path) as file:
        return {name: file[name][()] for name in MapFields._fields}


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
