"""ASCII grids by ESRI and GRASS: their header and their heights.

GDAL reads these files with little care: a missing corner is 0, a no-data value or a height that is no number is 0, too,
and so is "nan" amid whole numbers. Here the header is checked, and the heights are read.
"""

from __future__ import annotations

import math
import re
from pathlib import Path
from typing import NamedTuple

import numpy as np

from hdsp.base.errors import InputError

ESRI, GRASS = "AAIGrid", "GRASSASCIIGrid"
#: First words of a header, by GDAL's driver.
_FIRST_WORDS = {
    ESRI: ("ncols", "nrows", "xll", "yll", "cellsize", "dx", "dy"),
    GRASS: ("north", "south", "east", "west", "rows", "cols"),
}
#: Entries of which a header has one set each, by driver.
_ENTRIES: dict[str, tuple[tuple[tuple[str, ...], ...], ...]] = {
    ESRI: (
        (("ncols", "nrows"),),
        (("xllcorner", "yllcorner"), ("xllcenter", "yllcenter")),
        (("cellsize",), ("dx", "dy")),
    ),
    GRASS: ((("north", "south", "east", "west", "rows", "cols"),),),
}
_POSITIVE = "ncols", "nrows", "cellsize", "dx", "dy", "rows", "cols"
_NO_DATA = "nodata_value", "nodata", "null"

#: A line of numbers, not of the header.
_IS_BODY = re.compile(r"\s*([-+.,0-9*]|nan\b|inf\b)", re.IGNORECASE)
_ENTRY = re.compile(r"([A-Za-z_]+)(?:[ \t:=]+(\S*)|$)")
#: Words for an unknown height, also as C libraries of Windows print NaN.
_UNKNOWN = re.compile(r"\*|none|null|[-+]?nan|[-+]?1\.#(qnan|snan|ind)0*", re.IGNORECASE)
_HEADER, _LONGEST_WORD = 65536, 20  # characters, far more than any header and any word of it
_PLAIN = "latin-1"  # encoding of a text without a mark; words of a header and numbers are ASCII
_BYTE_ORDER_MARKS = {b"\xef\xbb\xbf": "utf-8-sig", b"\xff\xfe": "utf-16", b"\xfe\xff": "utf-16"}


class AsciiGrid(NamedTuple):
    """An ASCII grid in parts.

    Attributes:
        path: the file.
        driver: GDAL's driver.
        body: first line with heights, from 0.
        nodata: value for unknown heights; None = no number stands for them.
        multiplier: factor for all heights.
    """

    path: Path
    driver: str
    body: int
    nodata: float | None
    multiplier: float

    @property
    def text(self) -> str:
        """The text from the header on."""
        return _without_comments(self._whole())

    def _whole(self) -> str:
        return self.path.read_text(marked_encoding(self.path) or _PLAIN)

    def heights(self, rows: int, columns: int) -> np.ma.MaskedArray:
        """Heights float64 [rows, columns], times the multiplier; unknown ones are NaN or masked.

        Raises:
            InputError: a word is no number, or there are too few or too many.
        """
        lines = self._whole().splitlines()[self.body :]
        found = [np.empty(0), *(_numbers(line, number) for number, line in enumerate(lines, self.body + 1))]
        heights = np.concatenate(found)
        if heights.size != rows * columns:
            raise InputError(f"it has {heights.size} heights for {columns} x {rows} cells")
        heights = heights.reshape(rows, columns)
        unknown: np.ndarray | bool = False
        if self.nodata is not None:
            unknown = (heights == self.nodata) | (heights.astype(np.float32) == np.float32(self.nodata))
        return np.ma.masked_array(heights * self.multiplier, mask=unknown)


def read_ascii_grid(path: Path) -> AsciiGrid | None:
    """Reads an ASCII grid with a checked header; None for a text that begins with other words.

    Raises:
        InputError: an entry is missing, is there in two ways, or has an impossible value.
    """
    begin = _begin(path)
    driver = _driver(begin)
    if driver is None:
        return None
    lines, header = begin.splitlines(), _without_comments(begin).splitlines()
    before = len(lines) - len(header)
    body = next((k for k, line in enumerate(header) if _IS_BODY.match(line)), len(header))
    found = _ENTRY.findall("\n".join(header[:body]).replace("\n", " \n"))
    entries = {name.lower(): value for name, value in found}
    _check(entries, driver)
    word = next((entries[name] for name in _NO_DATA if name in entries), "")
    nodata = None if word == "" or _UNKNOWN.fullmatch(word) else _value("no-data value", word)
    multiplier = _value("multiplier", entries.get("multiplier", "1"))
    return AsciiGrid(path, driver, before + body, nodata, multiplier)


def is_ascii_grid(path: Path) -> bool:
    """Whether a text begins as a grid, perhaps behind comments."""
    return _driver(_begin(path)) is not None


def marked_encoding(path: Path) -> str | None:
    """Encoding that a file's byte-order mark tells; None without a mark."""
    with path.open("rb") as file:
        begin = file.read(3)
    return next((name for mark, name in _BYTE_ORDER_MARKS.items() if begin.startswith(mark)), None)


def _begin(path: Path) -> str:
    with path.open(encoding=marked_encoding(path) or _PLAIN, errors="replace") as file:
        return file.read(_HEADER)


def _driver(begin: str) -> str | None:
    first = _without_comments(begin)[:_LONGEST_WORD].lower()
    return next((name for name, words in _FIRST_WORDS.items() if first.startswith(words)), None)


def _without_comments(text: str) -> str:
    """The text without empty lines and comments before its first line of words."""
    text = text.lstrip()
    while text.startswith("#"):
        text = text.partition("\n")[2].lstrip()
    return text


def _check(entries: dict[str, str], driver: str) -> None:
    for sets in _ENTRIES[driver]:
        complete = [names for names in sets if all(name in entries for name in names)]
        given = [name for names in sets for name in names if name in entries]
        if len(complete) != 1 or len(given) != len(complete[0]):
            need = ", or ".join(" and ".join(names) for names in sets)
            raise InputError(f"its header has {', '.join(entries)[:120]}; need {need}")
        for name in given:
            value = _value(name, entries[name])
            if name in _POSITIVE and value <= 0:
                raise InputError(f"{name} is {entries[name]}; need a positive number")


def _value(name: str, word: str) -> float:
    number = _number(word.replace(",", "."))
    if number is None or not math.isfinite(number):
        raise InputError(f"{name} is {word[:40]!r} in its header; need a number")
    return number


def _numbers(line: str, number: int) -> np.ndarray:
    """Numbers in a line, float64 [n]."""
    words = line.replace(",", ".").split()
    if _plain(line):
        try:
            return np.array(words, float)
        except ValueError:
            pass  # below, each word alone
    values = [math.nan if _UNKNOWN.fullmatch(word) else _number(word) for word in words]
    if None in values:
        raise InputError(f"line {number} has {words[values.index(None)][:40]!r} amid heights; need numbers")
    return np.array(values, float)


def _number(word: str) -> float | None:
    try:
        return float(word) if _plain(word) else None
    except ValueError:
        return None


def _plain(text: str) -> bool:
    """Whether a text has neither of two signs in Python's numbers: digits of all scripts, and underscores."""
    return text.isascii() and "_" not in text
