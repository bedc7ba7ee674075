"""Checksum over all bytes of a file, in a line behind the end of its format.

Readers of GeoTIFF ignore bytes behind the last part. Another program that rewrites or extends a file drops the line or
hides it, and the file is then read as one without checksum.
"""

from __future__ import annotations

import hashlib
from pathlib import Path

from hdsp.base.errors import InputError

_MARK = b"\nhdsp sha256 "
_LENGTH = len(_MARK) + 64 + 1


def with_checksum(content: bytes) -> bytes:
    """Contents of a file with the line behind them."""
    return content + _MARK + hashlib.sha256(content).hexdigest().encode() + b"\n"


def check_file(path: Path) -> None:
    """Compares a file with the checksum at its end, if it has one.

    Raises:
        InputError: if the checksum differs.
    """
    size = path.stat().st_size
    with path.open("rb") as file:
        file.seek(max(0, size - _LENGTH))
        line = file.read()
        if not line.startswith(_MARK):
            return
        file.seek(0)
        state = hashlib.sha256()
        rest = size - _LENGTH
        while rest > 0 and (piece := file.read(min(rest, 1 << 20))):
            state.update(piece)
            rest -= len(piece)
    if line[len(_MARK) : -1] != state.hexdigest().encode():
        raise InputError(
            "its checksum differs: damaged, or changed in place by a program (gdal_translate IN OUT writes it anew)"
        )
