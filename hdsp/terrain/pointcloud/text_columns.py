"""Columns with x, y and z in a text, by the names in its header, and the units there."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from typing import NamedTuple

from hdsp.terrain.map_formats.raster_units import METRES

_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eEdD][-+]?\d+)?$|[-+]?(nan|inf|infinity)$", re.IGNORECASE)
_DEGREES = {"lat", "latitude", "lon", "long", "lng", "longitude"}
_AXIS = {"0": "x", "1": "y", "2": "z"} | {f"{head}{axis}": axis for head in ("", "p", "pos") for axis in "xyz"}
_OTHER_VECTORS = re.compile(r"normal|vel|speed|acc|rot|quat|dir|ang|gyro|colou?r")
#: Names of columns beside those with the words x, y and z.
_SURVEY = {
    **dict.fromkeys(("easting", "east", "e", "rechtswert"), "x"),
    **dict.fromkeys(("northing", "north", "n", "hochwert"), "y"),
    **dict.fromkeys(("height", "elevation", "elev", "altitude", "alt", "h", "up", "u", "hoehe", "höhe"), "z"),
}


class Columns(NamedTuple):
    """Columns with x, y and z.

    Attributes:
        places: their numbers, from 0.
        metres: metres per unit in each of them; 1 where the header names no unit.
    """

    places: tuple[int, int, int]
    metres: tuple[float, float, float]


def is_number(word: str) -> bool:
    """Whether a word is a number with a decimal point, NaN or infinity."""
    return _NUMBER.match(word) is not None


def named_columns(titles: Sequence[str], split: Callable[[str], list[str]], width: int) -> Columns | None:
    """Columns with x, y and z by their names; None if no header names the columns.

    Args:
        titles: lines that are no points.
        split: function that splits a line into its fields.
        width: columns in a line.

    Raises:
        ValueError: a header names other columns, another number of them, or degrees.
    """
    for title in titles:
        if title.strip() == "":
            continue
        for names in (_named(split(title)), _named(re.split(r"[,;\t|]|\s+", title))):
            if len(names) != width:
                if {"x", "y", "z"} <= set(names) and names[:3] != ["x", "y", "z"]:
                    raise ValueError(f"{len(names)} names of columns ({', '.join(names)[:80]}), but {width} columns")
                continue
            found = _axes(names)
            if found:
                x, y, z = (_metres(names, _units_below(titles, split, width), place) for place in found)
                return Columns(found, (x, y, z))
            if set(names) & _DEGREES:
                raise ValueError(f"columns {', '.join(names)[:80]}: latitudes and longitudes; need metres")
            if len(names) >= 3 and re.search(r"[,;\t|]", title) and not any(map(is_number, names)):
                raise ValueError(f"columns are {', '.join(names)[:80]}; need x, y and z")
    return None


def _named(words: Sequence[str]) -> list[str]:
    return [name for name in (word.strip(" \t'\"").lower() for word in words) if name]


def _axes(names: Sequence[str]) -> tuple[int, int, int] | None:
    """Columns of x, y and z: exact names first, then names with these words and the same rest, then survey names."""
    parts = [re.sub(r"[\[(].*?[\])]", "", name).strip() for name in names]
    if all(parts.count(axis) == 1 for axis in "xyz"):
        return parts.index("x"), parts.index("y"), parts.index("z")
    alike: dict[str, dict[str, int]] = {}
    for k, name in enumerate(parts):
        words = re.split(r"([^a-zäöü0-9]+|(?<=[a-z])(?=\d))", name)
        for at, word in enumerate(words):
            axis = _AXIS.get(word or "")
            if axis:
                rest = "".join([*(part or "" for part in words[:at]), "*", *(part or "" for part in words[at + 1 :])])
                alike.setdefault(rest, {}).setdefault(axis, k)
    for rest, found in alike.items():
        if len(found) == 3 and not _OTHER_VECTORS.search(rest):
            return found["x"], found["y"], found["z"]
    survey: dict[str, int] = {}
    for k, name in enumerate(parts):
        words = re.split(r"[^a-zäöü]+", name)
        axis = next((_SURVEY.get(word, word) for word in words if word in _SURVEY or word in ("x", "y", "z")), "")
        if axis:
            survey.setdefault(axis, k)
    return (survey["x"], survey["y"], survey["z"]) if len(survey) == 3 else None


def _units_below(titles: Sequence[str], split: Callable[[str], list[str]], width: int) -> list[str]:
    """Units in their own line below the names."""
    rows = [[word.strip(" \t'\"[]()").lower() for word in split(title)] for title in titles]
    return next((row for row in rows if len(row) == width and all(row) and set(row) <= set(METRES)), [""] * width)


def _metres(names: Sequence[str], below: Sequence[str], place: int) -> float:
    """Metres per unit in a column: X [mm], x_ft, or a line with units."""
    name = names[place]
    in_brackets = re.search(r"[\[(]\s*(.*?)\s*[\])]", name)
    last = re.split(r"[^a-z]+", name)[-1] if re.search(r"[^a-z]", name) else ""
    unit = in_brackets.group(1) if in_brackets else last if last and last in METRES else below[place]
    return METRES.get(unit, 1.0)
