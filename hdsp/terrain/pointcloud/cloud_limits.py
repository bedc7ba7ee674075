"""Limits of size for point files, checked before memory is taken: a damaged header may claim any size."""

from __future__ import annotations

import bz2
import gzip
from collections.abc import Callable
from pathlib import Path
from typing import IO, Any, NamedTuple

from hdsp.base.errors import InputError
from hdsp.base.messages import shown
from hdsp.base.scalars import integer

_UNPACKED: dict[str, Callable[[Path], Any]] = {".gz": gzip.open, ".bz2": bz2.open}
_PIECE = 1 << 22


class CloudLimits(NamedTuple):
    """Largest sizes of a point file.

    Attributes:
        points: number of points in a binary format.
        rows: number of lines in a text format, or of records that are read one by one.
        content: bytes, unpacked.
    """

    points: int = 50_000_000
    rows: int = 10_000_000
    content: int = 1 << 30

    @classmethod
    def of(cls, max_points: int | None = None, max_bytes: int | None = None) -> CloudLimits:
        """Limits with other values than the defaults; ``max_points`` holds for binary and text formats.

        Raises:
            InputError: if a value is no positive whole number.
        """
        for name, value in (("max_points", max_points), ("max_bytes", max_bytes)):
            if value is not None and (integer(value) or 0) < 1:
                raise InputError(f"{name} is {shown(value)}; need a positive whole number")
        default, most = cls(), integer(max_points)
        return cls(most or default.points, most or default.rows, integer(max_bytes) or default.content)

    def check_points(self, claimed: int) -> None:
        """Refuses a claimed number of points."""
        if claimed > self.points:
            raise InputError(f"it claims {claimed:,} points; at most {self.points:,} are read (max_points)")

    def check_rows(self, claimed: int, what: str = "lines") -> None:
        """Refuses a number of lines or records."""
        if claimed > self.rows:
            raise InputError(f"it has {claimed:,} {what}; at most {self.rows:,} are read (max_points)")

    def read(self, path: Path, is_text: bool) -> bytes:
        """Reads a file's contents, unpacked if the suffix is .gz or .bz2; stops at the first byte that is too many.

        Raises:
            InputError: if the contents are too large.
        """
        unpacked = _UNPACKED.get(path.suffix.lower())
        if unpacked is None:
            self._check_content(path.stat().st_size, "it has")
            with path.open("rb") as file:
                return self._pieces(file, is_text)
        with unpacked(path) as packed:
            return self._pieces(packed, is_text)

    def _pieces(self, file: IO[bytes], is_text: bool) -> bytes:
        pieces, size, lines = [], 0, 0
        while piece := file.read(_PIECE):
            size += len(piece)
            self._check_content(size, "it unpacks to more than")
            lines += piece.count(b"\n") if is_text else 0
            self.check_rows(lines)
            pieces.append(piece)
        return b"".join(pieces)

    def _check_content(self, size: int, words: str) -> None:
        if size > self.content:
            shown = size if words == "it has" else self.content
            raise InputError(f"{words} {shown:,} bytes; at most {self.content:,} are read (max_bytes)")


#: Limits without further choice.
DEFAULT_LIMITS = CloudLimits()
