"""Arrays in an HDF5 file, read only from this file and only after checks of their claimed sizes.

HDF5 follows links into other files, fetches data from external files and virtual data sets, and unpacks a chunk of any
size. A file of strangers may do all of that, so each is refused.
"""

from __future__ import annotations

import zlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from hdsp.base.array_files import MOST_ENTRIES, Entry
from hdsp.base.errors import InputError
from hdsp.terrain.map_formats.fields import check_cells

#: Numbers of filters in HDF5.
_GZIP, _SHUFFLE, _CHECKSUM = 1, 2, 3
#: Bytes that a packed chunk may take beyond its numbers.
_SLACK = 4096


@contextmanager
def hdf5_entries(path: Path, wanted: Sequence[str] = ()) -> Iterator[dict[str, Entry]]:
    """Yields the arrays in a file by name, without following links.

    Args:
        path: the file.
        wanted: names that must be no links.

    Raises:
        InputError: if a wanted entry is a link, or there are too many entries.
    """
    import h5py

    with h5py.File(path, "r") as file:
        for name in wanted:
            _refuse_links(file, name)
        entries: dict[str, Entry] = {}

        def collect(name: str, item: Any) -> bool | None:
            if isinstance(item, h5py.Dataset) and item.shape is not None:
                entries[name] = tuple(item.shape), item.dtype, lambda: _dataset(item)
            return True if len(entries) > MOST_ENTRIES else None

        if file.visititems(collect):  # follows no link
            raise InputError(f"it has more than {MOST_ENTRIES:,} arrays")
        yield entries


def _refuse_links(file: Any, name: str) -> None:
    import h5py

    parts = [part for part in name.split("/") if part]
    for k in range(1, len(parts) + 1):
        link = file.get("/".join(parts[:k]), getlink=True)
        if isinstance(link, h5py.SoftLink | h5py.ExternalLink):
            place = f"{getattr(link, 'filename', '')} {link.path}".strip()
            raise InputError(f"entry {'/'.join(parts[:k])} is a link to {place[:80]}; need the numbers in this file")


def _dataset(item: Any) -> np.ndarray:
    if item.external or item.is_virtual:
        raise InputError(f"entry {item.name} refers to other files; need the heights in this file")
    if item.chunks:
        check_cells(1, int(np.prod(item.chunks, dtype=float)))
        _check_chunks(item)
    return item[()]


def _check_chunks(item: Any) -> None:
    """Refuses chunks that take more space than their numbers, packed or unpacked."""
    plan = item.id.get_create_plist()
    filters = [plan.get_filter(k)[0] for k in range(plan.get_nfilters())]
    packers = [code for code in filters if code not in (_SHUFFLE, _CHECKSUM)]
    if len(set(filters)) < len(filters) or len(packers) > 1:
        raise InputError(f"entry {item.name} is packed several times, by the filters {filters}")
    size = int(np.prod(item.chunks)) * item.dtype.itemsize
    places: list[tuple[int, ...]] = []

    def check(chunk: Any) -> None:
        if chunk.size > size + size // 8 + _SLACK:
            raise InputError(f"entry {item.name} is damaged: {chunk.size:,} bytes for a chunk of {size:,}")
        places.append(chunk.chunk_offset)

    item.id.chunk_iter(check)
    if _GZIP in filters:
        for place in places:
            _check_gzip(item, place, size)


def _check_gzip(item: Any, place: tuple[int, ...], size: int) -> None:
    unpacker = zlib.decompressobj()
    if len(unpacker.decompress(item.id.read_direct_chunk(place)[1], size + 1)) > size:
        raise InputError(f"entry {item.name} is damaged: a chunk unpacks to more than its {size:,} bytes")
