"""Arrays in NumPy's files: claims in headers are compared with sizes before memory is taken; objects are refused."""

from __future__ import annotations

import sys
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

import numpy as np

from hdsp.base.errors import InputError

#: Access to an array in a file: its shape and type, and a function that reads it.
Entry = tuple[tuple[int, ...], np.dtype, Callable[[], np.ndarray]]

#: Largest number of arrays in a file.
MOST_ENTRIES = 10_000


@contextmanager
def npz_entries(path: Path) -> Iterator[dict[str, Entry]]:
    """Yields the arrays in an archive by name.

    Raises:
        InputError: if a header claims another size than its member has, or there are too many members.
        Exception: errors of several types from zipfile and NumPy for damaged archives.
    """
    with zipfile.ZipFile(path) as archive:
        entries: dict[str, Entry] = {}
        if len(archive.infolist()) > MOST_ENTRIES:
            raise InputError(f"it has more than {MOST_ENTRIES:,} entries")
        for info in archive.infolist():
            if info.filename.endswith(".npy"):
                with archive.open(info) as file:
                    shape, dtype = array_header(file, info.file_size)
                entries[info.filename.removesuffix(".npy")] = shape, dtype, _reader(archive, info)
        yield entries


def npz_arrays(path: Path, most_bytes: int) -> dict[str, np.ndarray]:
    """Reads all arrays in an archive, if together they take no more than ``most_bytes``.

    Raises:
        InputError: if the archive is damaged or too large.
    """
    try:
        with npz_entries(path) as entries:
            claimed = sum(np.prod(shape, dtype=float) * dtype.itemsize for shape, dtype, _ in entries.values())
            if claimed > most_bytes:
                raise InputError(f"{path} claims {claimed:,.0f} bytes; at most {most_bytes:,} are read")
            return {name: read() for name, (_, _, read) in entries.items()}
    except InputError:
        raise
    except Exception as error:  # zipfile, zlib and NumPy raise errors of many types for damaged files
        raise InputError(f"{path} cannot be read: {' '.join(str(error).split())[:200]}") from None


def array_header(file: IO[bytes], size: int) -> tuple[tuple[int, ...], np.dtype]:
    """Shape and type of an array in .npy format.

    Raises:
        InputError: if the claim does not fit ``size``, the bytes of the file.
    """
    version = np.lib.format.read_magic(file)
    read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, _, dtype = read(file)
    claimed = int(np.prod([float(length) for length in shape])) * dtype.itemsize
    if not dtype.hasobject and claimed != size - file.tell():
        raise InputError(f"it is damaged: an array of {claimed:,} bytes in {max(size - file.tell(), 0):,} bytes")
    return shape, dtype


def _reader(archive: zipfile.ZipFile, info: zipfile.ZipInfo) -> Callable[[], np.ndarray]:
    def read() -> np.ndarray:
        with archive.open(info) as file:
            array = np.lib.format.read_array(file, allow_pickle=False)
            file.read()  # the checksum is compared at the end
        _check_text(array)
        return array

    return read


def _check_text(array: np.ndarray) -> None:
    """Refuses text with numbers beyond Unicode, which Python's text functions do not expect."""
    if array.dtype.kind == "U" and array.size:
        numbers = np.frombuffer(array.tobytes(), np.dtype(np.uint32).newbyteorder(array.dtype.byteorder))
        if numbers.max(initial=0) > sys.maxunicode:
            raise InputError(f"it is damaged: text with the character number {numbers.max():,}")
