"""Points in text files: a line for each point, in one of the many ways in which programs write such lines.

Accepted: UTF-8 and UTF-16 with or without a byte-order mark; spaces, tabs, commas, semicolons or bars between numbers;
decimal points and decimal commas; comments behind ``#``, ``//``, ``%`` or ``!``; a header that names columns in any
order; titles; lines with the number of points (.pts, .xyz of chemistry); a word in front of the numbers (``v``, ``C``).

Rules where a line can be read in two ways:

- Commas are decimal commas if another character separates the numbers.
- Commas separate numbers if nothing else does. An even number, at least six, of whole numbers separated by commas could
  as well be half as many decimal numbers, and whole numbers with leading zeros (``1,050,0,500``) are none: refused.
- Commas and points in one number: the last one is the decimal sign, the others group thousands. Between quotation
  marks, commas belong to a number.
- An empty last field is a missing number where other lines have one there, else the line's end.

Numbers without names that may mean something else are refused: many columns as in a grid, and a first column that
counts the points.
"""

from __future__ import annotations

import codecs
import csv
import io
import re
from collections import Counter
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np

from hdsp.terrain.pointcloud.cloud_limits import DEFAULT_LIMITS, CloudLimits
from hdsp.terrain.pointcloud.text_columns import is_number, named_columns

_MARKS = {codecs.BOM_UTF32_LE: "utf-32", codecs.BOM_UTF32_BE: "utf-32", codecs.BOM_UTF8: "utf-8-sig"} | dict.fromkeys(
    (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE), "utf-16"
)
_COMMENT = re.compile(r"#|//|%|!")
_MISSING = ("", "na", "n/a", "null", "none", "-", "--", "*")
#: NaN as C libraries of Windows print it; its # begins no comment.
_WINDOWS_NAN = re.compile(r"[-+]?1\.#(qnan|snan|ind)0*", re.IGNORECASE)
_OF_NUMBERS = str.maketrans(dict.fromkeys("0123456789+-.eE \t\r\n"))
_LONGEST_LINE = 10_000
_SAMPLE = 1000  # lines that decide how all lines are read
_MOST_COLUMNS = 20  # more columns without names are a grid of heights
_COUNTED = 3  # points; so many are needed to tell a count of points from coordinates


class TextPoints(NamedTuple):
    """Points in a text.

    Attributes:
        points: float64 [n, 3], in the file's units.
        metres: metres per unit for x, y and z by the header; ones for a text that names no units.
    """

    points: np.ndarray
    metres: tuple[float, float, float] = (1.0, 1.0, 1.0)


def read_text(content: bytes, limits: CloudLimits = DEFAULT_LIMITS) -> np.ndarray:
    """Reads points float64 [n, 3], in the file's units, from a file's contents; errors as in `text_points`."""
    return text_points(content, limits).points


def text_points(content: bytes, limits: CloudLimits = DEFAULT_LIMITS) -> TextPoints:
    """Reads points and their units from a file's contents.

    Raises:
        ValueError: if lines differ in their number of columns, a line is too long, commas can be read in two ways, a
            coordinate is no number, the number of points is not the stated one, or columns without names may be a grid
            or begin with numbers of points.
        InputError: if there are more lines than the limit.
    """
    text = decoded_text(content)
    if (plain := _plain(text)) is not None:
        return TextPoints(plain)
    lines = _lines(text)
    limits.check_rows(len(lines))
    if lines and lines[0].strip() == "OFF":
        raise ValueError("a mesh in the format OFF; write it as PLY or OBJ")
    if longest := next((line for line in lines if len(line) > _LONGEST_LINE), ""):
        raise ValueError(f"a line of {len(longest):,} characters; need at most {_LONGEST_LINE:,}")
    split = _splitter(lines)
    titles, counts, rows = _sorted(lines, split)
    if any(title.lower().startswith("ncols") for title in titles):
        raise ValueError("an ASCII grid of heights, no points; unpack it, and name it .asc")
    if not rows:
        if titles or any(len(split(_without_comment(line))) > 2 for line in lines):
            first = next((line for line in lines if _without_comment(line)), lines[0])
            raise ValueError(f"no line of numbers; the first line is {first[:60]!r}")
        if counts:
            raise ValueError(f"lines of {len(counts[0])} numbers; need at least x y z")
        return TextPoints(np.zeros((0, 3)))
    _check_count(counts, len(rows))
    labelled = not is_number(rows[0][0]) and rows[0][0].lower() not in _MISSING
    width = len(rows[0])
    start = int(labelled)
    named = named_columns(titles, split, width)
    columns = named.places if named else (start, start + 1, start + 2)
    if width <= max(columns):
        raise ValueError(f"lines of {width} numbers; need at least x y z")
    points = _values(rows, columns)
    if named is None and not labelled:
        _refuse_other_numbers(points, width)
    return TextPoints(points, named.metres) if named else TextPoints(points)


def decoded_text(content: bytes) -> str:
    """Decodes UTF-8, UTF-16 and UTF-32, with or without a byte-order mark, else Latin-1.

    Raises:
        ValueError: binary contents.
    """
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
        numbers = np.loadtxt(io.StringIO(text.replace(",", " ") if rest else text), comments=None, ndmin=2)
    except ValueError:
        return None  # the slow way names the line
    _refuse_other_numbers(numbers, numbers.shape[1])
    return numbers[:, :3]


def _refuse_other_numbers(numbers: np.ndarray, width: int) -> None:
    """Refuses numbers without names that seem to be no coordinates: a grid, or points with their numbers."""
    if width > _MOST_COLUMNS:
        raise ValueError(
            f"{len(numbers)} lines of {width} numbers: a grid of heights? load it with numpy and give it to HeightMap; "
            "points need a line with the names of the columns"
        )
    first = numbers[:, 0]
    if width == 3 or len(first) < _COUNTED or not (np.isfinite(first) & (np.floor(first) == first)).all():
        return
    steps = np.diff(first)
    if (steps >= 1).all() and np.median(steps) == 1:
        raise ValueError(
            f"the first column counts {first[0]:g}, {first[1]:g}, {first[2]:g}: numbers of points? name the columns in "
            "a first line, e.g. id x y z"
        )


def _lines(text: str) -> list[str]:
    """Lines that are not empty; quotation marks stay only where they hold a number with a comma."""
    if "1.#" in text:
        text = _WINDOWS_NAN.sub("nan", text)
    lines = [_clean(line) for line in re.split(r"\r\n|\n|\r", text)]
    if '"' in text and not any(map(_has_quoted_comma, lines[: _SAMPLE + 100])):
        lines = [line.replace('"', "") for line in lines]
    return [line for line in lines if line.strip()]


def _clean(line: str) -> str:
    return line.replace("\u2212", "-").replace("\xa0", " ").strip("\ufeff \f\v")


def _has_quoted_comma(line: str) -> bool:
    """Whether commas separate fields, and a number in quotation marks has one, too."""
    outside = re.sub(r'"[^"]*"', "", line)
    if "," not in outside or re.search(r"[;|\t]", outside):
        return False
    return any("," in word and re.fullmatch(r"[-+]?[\d., ]*\d", word) for word in _quoted_words(line))


def _quoted_words(line: str) -> list[str]:
    return [word.strip() for word in next(csv.reader([line], skipinitialspace=True), [])]


def _without_comment(line: str) -> str:
    found = _COMMENT.search(line)
    return line[: found.start()].rstrip() if found else line


def _splitter(lines: Sequence[str]):
    """The function that splits a line into its fields with decimal points, by the first lines."""
    lines = [line for line in map(_without_comment, lines[: _SAMPLE + 100]) if line]
    numeric = [line for line in lines if re.match(r'\s*"?[-+.,]?\d', line)] or list(lines)
    if any(map(_has_quoted_comma, numeric)):
        _refuse_two_signs(word for line in numeric for word in _quoted_words(line))
        return lambda line: [_point(word) for word in _quoted_words(line)]
    inner = [re.sub(r"\s*([;|\t,])\s*", r"\1", line.strip(" ;|,\t")) for line in numeric]
    for sign in ";|\t":
        if sum(sign in line for line in inner) > len(inner) / 2:
            if sign == "\t" and any(" " in line for line in inner):
                break  # spaces and tabs in one line both separate numbers
            _refuse_two_signs(word for line in inner for word in line.split(sign))
            width = _width(numeric, lines, sign)
            return lambda line: [_point(word) for word in _fields(line, sign, width)]
    if sum(len(line.split()) >= 3 for line in inner) > len(inner) / 2:
        _refuse_two_signs(word for line in inner for word in line.split())
        return lambda line: [_point(word) for word in re.sub(r",(?=\s|$)", " ", line).split()]
    if any("," in line for line in inner):
        _refuse_two_readings(inner, lines)
        width = _width(numeric, lines, ",")
        return lambda line: _fields(line, ",", width)
    return lambda line: line.split()


def _fields(line: str, sign: str, width: int) -> list[str]:
    """Fields in a line. A separator at its end, or at both as in tables with bars, makes no field beyond the width."""
    words = [word.strip() for word in (line.strip("| ") if sign == "|" else line).split(sign)]
    if len(words) != width and words[-1] == "":
        words.pop()
    if len(words) != width and words and words[0] == "" and sign == "\t":  # indented
        words.pop(0)
    return words


def _width(numeric: Sequence[str], lines: Sequence[str], sign: str) -> int:
    """Most frequent number of fields among lines without a separator at an end; 0 without such a line."""
    for some in (numeric, lines):
        bare = [line.strip("| " if sign == "|" else " ") for line in some]
        counts = Counter(line.count(sign) + 1 for line in bare if line == line.strip(sign) and sign in line)
        if counts:
            return counts.most_common(1)[0][0]
    return 0


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
        elif len(words) < 3 and all(map(is_number, words)):
            raise ValueError(f"lines of {len(words)} numbers; need at least x y z")
        else:
            titles.append(line)
    return titles, counts, rows


def _looks_like_a_point(words: Sequence[str]) -> bool:
    """Whether most fields are numbers: labels and missing values may be among them."""
    numbers = sum(map(is_number, words))
    missing = sum(word.lower() in _MISSING for word in words)
    return numbers >= 1 and numbers + missing >= min(3, len(words)) and 2 * (numbers + missing) >= len(words)


def _check_count(counts: Sequence[Sequence[str]], points: int) -> None:
    if not counts:
        return
    stated = [int(np.prod([int(word) for word in words])) for words in counts]
    if points != sum(stated) and [len(words) for words in counts] + [int(counts[0][0])] != [2, points]:
        kind = "cut off: " if points < sum(stated) else ""
        raise ValueError(f"{kind}{points} points; a line says {' '.join(counts[0])}")


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
    if not is_number(word):
        raise ValueError(f"point {number}: {word[:40]!r} is no number")
    return float(re.sub("[dD]", "e", word) if not word.lower().endswith("d") else word)
