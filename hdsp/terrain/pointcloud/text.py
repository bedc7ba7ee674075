"""Points in text files: a line for each point, in one of the many ways in which programs write such lines.

Accepted: UTF-8 and UTF-16 with or without a byte-order mark; spaces, tabs, commas, semicolons or bars between numbers;
decimal points and decimal commas; comments behind ``#``, ``//``, ``%`` or ``!``; a header that names columns in any
order; titles; lines with the number of points (.pts, .xyz of chemistry); a word in front of the numbers (``v``, ``C``).

Rules where a line can be read in two ways:

- Commas are decimal commas if another character separates the numbers.
- Commas separate numbers if nothing else does. An even number, at least six, of whole numbers separated by commas could
  as well be half as many decimal numbers, and whole numbers with leading zeros (``1,050,0,500``) are none: refused.
- Commas and points in one number: the last one is the decimal sign, the others group thousands.
"""

from __future__ import annotations

import codecs
import io
import re
from collections.abc import Iterable, Sequence

import numpy as np

from hdsp.terrain.pointcloud.cloud_limits import DEFAULT_LIMITS, CloudLimits

_MARKS = {codecs.BOM_UTF32_LE: "utf-32", codecs.BOM_UTF32_BE: "utf-32", codecs.BOM_UTF8: "utf-8-sig"} | dict.fromkeys(
    (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE), "utf-16"
)
_COMMENT = re.compile(r"#|//|%|!")
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eEdD][-+]?\d+)?$|[-+]?(nan|inf|infinity)$", re.IGNORECASE)
_MISSING = ("", "na", "n/a", "null", "none", "-", "--", "*")
_OF_NUMBERS = str.maketrans(dict.fromkeys("0123456789+-.eE \t\r\n"))
_LONGEST_LINE = 10_000
_SAMPLE = 1000  # lines that decide how all lines are read
_DEGREES = {"lat", "latitude", "lon", "long", "lng", "longitude"}
_AXIS = {"0": "x", "1": "y", "2": "z"} | {f"{head}{axis}": axis for head in ("", "p", "pos") for axis in "xyz"}
_OTHER_VECTORS = re.compile(r"normal|vel|speed|acc|rot|quat|dir|ang|gyro|colou?r")
#: Names of columns beside those with the words x, y and z.
_SURVEY = {
    **dict.fromkeys(("easting", "east", "e", "rechtswert"), "x"),
    **dict.fromkeys(("northing", "north", "n", "hochwert"), "y"),
    **dict.fromkeys(("height", "elevation", "elev", "altitude", "alt", "h", "up", "u", "hoehe", "höhe"), "z"),
}


def read_text(content: bytes, limits: CloudLimits = DEFAULT_LIMITS) -> np.ndarray:
    """Reads points float64 [n, 3], in the file's units, from a file's contents.

    Raises:
        ValueError: if lines differ in their number of columns, a line is too long, commas can be read in two ways, a
            coordinate is no number, or the number of points is not the stated one.
        InputError: if there are more lines than the limit.
    """
    text = _decoded(content)
    if (plain := _plain(text)) is not None:
        return plain
    lines = [line for line in map(_clean, re.split(r"\r\n|\n|\r", text)) if line]
    limits.check_rows(len(lines))
    if longest := next((line for line in lines if len(line) > _LONGEST_LINE), ""):
        raise ValueError(f"a line of {len(longest):,} characters; need at most {_LONGEST_LINE:,}")
    sample = [_without_comment(line) for line in lines[: _SAMPLE + 100]]
    split = _splitter([line for line in sample if line])
    titles, counts, rows = _sorted(lines, split)
    if not rows:
        if titles or any(len(split(_without_comment(line))) > 2 for line in lines):
            first = next((line for line in lines if _without_comment(line)), lines[0])
            raise ValueError(f"no line of numbers; the first line is {first[:60]!r}")
        if counts:
            raise ValueError(f"lines of {len(counts[0])} numbers; need at least x y z")
        return np.zeros((0, 3))
    _check_count(counts, len(rows))
    labelled = not _is_number(rows[0][0]) and rows[0][0].lower() not in _MISSING
    width = len(rows[0])
    start = int(labelled)
    columns = _columns(titles, split, width) or (start, start + 1, start + 2)
    if width <= max(columns):
        raise ValueError(f"lines of {width} numbers; need at least x y z")
    return _values(rows, columns)


def _decoded(content: bytes) -> str:
    mark = next((mark for mark in _MARKS if content.startswith(mark)), None)
    if mark is not None:
        return content.decode(_MARKS[mark])
    zeros = np.frombuffer(content[:1000], np.uint8) == 0
    if zeros.sum() > 0.3 * len(zeros):  # every other byte of plain text in UTF-16
        return content.decode("utf-16-le" if zeros[1::2].sum() > zeros[::2].sum() else "utf-16-be")
    if zeros.any():
        raise ValueError("binary contents, no text")
    try:
        return content.decode("utf-8")
    except UnicodeDecodeError:
        return content.decode("latin-1")  # words in a header, numbers are ASCII


def _plain(text: str) -> np.ndarray | None:
    """Points of a text with nothing but numbers in columns of one width, the fast way; None for all other texts."""
    rest = text.translate(_OF_NUMBERS)
    first = text.lstrip().partition("\n")[0]
    separated = rest.strip(",") == "" and all("." in word for word in first.split(","))
    if not (rest == "" or separated) or len(first.replace(",", " ").split()) < 3:
        return None
    try:
        return np.loadtxt(io.StringIO(text.replace(",", " ") if rest else text), comments=None, ndmin=2)[:, :3]
    except ValueError:
        return None  # the slow way names the line


def _clean(line: str) -> str:
    return line.replace("\u2212", "-").replace("\xa0", " ").replace('"', "").strip("\ufeff \t\f\v")


def _without_comment(line: str) -> str:
    found = _COMMENT.search(line)
    return line[: found.start()].rstrip() if found else line


def _splitter(lines: Sequence[str]):
    """The function that splits a line into its fields with decimal points."""
    numeric = [line for line in lines if re.match(r"[-+.,]?\d", line)] or list(lines)
    inner = [re.sub(r"\s*([;|\t,])\s*", r"\1", line.strip(" ;|,")) for line in numeric]
    for sign in ";|\t":
        if sum(sign in line for line in inner) > len(inner) / 2:
            if sign == "\t" and any(" " in line for line in inner):
                break  # spaces and tabs in one line both separate numbers
            _refuse_two_signs(word for line in inner for word in line.split(sign))
            return lambda line: [_point(word.strip()) for word in _trimmed(line, sign).split(sign)]
    if sum(len(line.split()) >= 3 for line in inner) > len(inner) / 2:
        _refuse_two_signs(word for line in inner for word in line.split())
        return lambda line: [_point(word) for word in re.sub(r",(?=\s|$)", " ", line).split()]
    if any("," in line for line in inner):
        _refuse_two_readings(inner, lines)
        return lambda line: [word.strip() for word in _trimmed(line, ",").split(",")]
    return lambda line: line.split()


def _trimmed(line: str, sign: str) -> str:
    """The line without a separator at its end, or at both ends as in tables with bars."""
    return line.strip("| ") if sign == "|" else line[:-1] if line.endswith(sign) else line


def _refuse_two_signs(words: Iterable[str]) -> None:
    """Refuses numbers with decimal points beside numbers whose comma may be a decimal sign or group thousands."""
    commas = points = ""
    for word in words:
        if re.fullmatch(r"\s*[-+]?\d*,\d+\s*", word):
            commas = word.strip()
        elif re.fullmatch(r"\s*[-+]?\d*\.\d+\s*", word):
            points = word.strip()
    if commas and points:
        raise ValueError(f"numbers {commas!r} and {points!r}: is the comma a decimal sign? write one sign everywhere")


def _refuse_two_readings(numeric: Sequence[str], lines: Sequence[str]) -> None:
    """Refuses whole numbers between commas that may be decimal commas; a header tells the number of columns."""
    rows = [line.split(",") for line in numeric if "," in line]
    if any(not re.fullmatch(r"\s*[-+]?\d+\s*", word) for row in rows for word in row):
        return
    padded = any(re.match(r"[-+]?0\d", word) for row in rows for word in row)
    width = len(rows[0])
    named = any(len(line.split(",")) == width and not re.search(r"\d", line.split(",")[0]) for line in lines)
    signed = any(word.startswith("-") for row in rows for word in row[1::2])
    if padded or (width >= 6 and width % 2 == 0 and not named and not signed):
        raise ValueError(
            f"line {numeric[0][:60]!r}: are its commas decimal signs? write points, or semicolons between the numbers"
        )


def _point(word: str) -> str:
    """The word with a decimal point if it is a number with a decimal comma or groups of thousands."""
    if " " in word and re.fullmatch(r"[-+]?\d{1,3}( \d{3})+([.,]\d*)?", word):
        word = word.replace(" ", "")
    if "," not in word:
        return word
    if "." in word:
        group = "." if word.rfind(",") > word.rfind(".") else ","
        if not re.fullmatch(rf"[-+]?\d{{1,3}}(\{group}\d{{3}})+[.,]\d*([eE][-+]?\d+)?", word):
            return word
        return word.replace(group, "").replace(",", ".")
    if re.fullmatch(r"[-+]?\d{1,3}(,\d{3}){2,}", word):
        return word.replace(",", "")
    return word.replace(",", ".") if word.count(",") == 1 else word


def _is_number(word: str) -> bool:
    return _NUMBER.match(word) is not None


def _sorted(lines: Sequence[str], split) -> tuple[list[str], list[list[str]], list[list[str]]]:
    """Titles and headers, lines of one or two whole numbers (number of points), and the fields of all other lines."""
    titles: list[str] = []
    counts: list[list[str]] = []
    rows: list[list[str]] = []
    for number, line in enumerate(lines, 1):
        bare = _without_comment(line)
        words = split(bare) if bare else []
        if rows and len(words) == len(rows[0]):
            rows.append(words)  # a word that is no number is found later
        elif not words:
            titles.append(re.sub(r"^[#/%!\s]+", "", line))
        elif len(words) < (2 if rows else 3) and all(word.isdecimal() for word in words):
            counts.append(words)
        elif len(words) >= 3 and _looks_like_a_point(words):
            if rows:
                raise ValueError(f"line {number} has {len(words)} columns; the lines before have {len(rows[0])}")
            rows.append(words)
        elif rows:
            raise ValueError(f"line {number} is no point: {line[:60]!r}")
        elif len(words) < 3 and all(map(_is_number, words)):
            raise ValueError(f"lines of {len(words)} numbers; need at least x y z")
        else:
            titles.append(line)
    return titles, counts, rows


def _looks_like_a_point(words: Sequence[str]) -> bool:
    """Whether most fields are numbers: labels and missing values may be among them."""
    numbers = sum(map(_is_number, words))
    missing = sum(word.lower() in _MISSING for word in words)
    return numbers >= 1 and numbers + missing >= min(3, len(words)) and 2 * (numbers + missing) >= len(words)


def _check_count(counts: Sequence[Sequence[str]], points: int) -> None:
    if not counts:
        return
    stated = [int(np.prod([int(word) for word in words])) for words in counts]
    if points != sum(stated) and [len(words) for words in counts] + [int(counts[0][0])] != [2, points]:
        kind = "cut off: " if points < sum(stated) else ""
        raise ValueError(f"{kind}{points} points; a line says {' '.join(counts[0])}")


def _columns(titles: Sequence[str], split, width: int) -> tuple[int, int, int] | None:
    """Columns of x, y and z by their names; None if no header names the columns."""
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
                return found
            if set(names) & _DEGREES:
                raise ValueError(f"columns {', '.join(names)[:80]}: latitudes and longitudes; need metres")
            if len(names) >= 3 and re.search(r"[,;\t|]", title) and not any(map(_is_number, names)):
                raise ValueError(f"columns are {', '.join(names)[:80]}; need x, y and z")
    return None


def _named(words: Sequence[str]) -> list[str]:
    return [name for name in (word.strip(" \t'").lower() for word in words) if name]


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


def _values(rows: list[list[str]], columns: tuple[int, int, int]) -> np.ndarray:
    """Numbers [n, 3] in the columns; missing ones are NaN."""
    points = np.empty((len(rows), 3))
    for place, column in enumerate(columns):
        words = [row[column] for row in rows]
        try:
            points[:, place] = np.array(words, dtype=float)
        except ValueError:
            points[:, place] = [_number(word, number) for number, word in enumerate(words, 1)]
    return points


def _number(word: str, number: int) -> float:
    if word.lower() in _MISSING:
        return np.nan
    if not _is_number(word):
        raise ValueError(f"point {number}: {word[:40]!r} is no number")
    return float(re.sub("[dD]", "e", word) if not word.lower().endswith("d") else word)
