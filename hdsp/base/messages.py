"""Values and keys in messages: short, on one line."""

import difflib
import re
import reprlib
from collections.abc import Iterable
from typing import Any

_LONGEST = 100  # characters of a value in a message
_FAR = 1e9  # m, beyond all coordinates on Earth


def unknown_key(key: Any, allowed: Iterable[str]) -> str:
    """Message about an unknown key: the nearest existing key, and all allowed keys."""
    names = sorted(allowed)
    if not isinstance(key, str):
        return f"key {shown(key)} is no text; allowed are {', '.join(names)}"
    meant = did_you_mean(key, names)
    return f"unknown key {shown(key)}{meant or ';'} allowed are {', '.join(names) or 'none'}"


def shown(value: Any) -> str:
    """Formats a value for a message: Python syntax, lists for tuples, shortened, on one line."""
    text = one_line(_SHORT.repr(value))
    return text if len(text) <= _LONGEST else f"{text[: _LONGEST - 4]} ..."


class _Short(reprlib.Repr):
    def __init__(self) -> None:
        super().__init__()
        self.maxlevel, self.maxstring, self.maxother, self.maxlong = 3, 80, 80, 80
        self.maxdict = self.maxlist = self.maxtuple = 8

    def repr_tuple(self, x: tuple, level: int) -> str:
        return self.repr_list(list(x), level)

    def repr_int(self, x: int, level: int) -> str:
        try:
            return super().repr_int(x, level)
        except ValueError:  # Python prints no number with thousands of digits
            return hex(x)[:40] + "..."


_SHORT = _Short()


def coordinates(values: Iterable[float], decimals: int = 3) -> str:
    """Formats coordinates for a message, separated by commas: all digits of projected ones, no zeros at the end."""
    return ", ".join(_coordinate(float(value), decimals) for value in values)


def spans(low: Iterable[float], high: Iterable[float]) -> str:
    """Formats the extents of a box in x, y and further axes for a message."""
    ends = zip("xyz", low, high, strict=False)
    return ", ".join(f"{axis} {_coordinate(float(a), 3)} to {_coordinate(float(b), 3)}" for axis, a, b in ends)


def _coordinate(value: float, decimals: int) -> str:
    if abs(value) >= _FAR:
        return f"{value:g}"
    text = f"{value:z.{decimals}f}"
    return text.rstrip("0").rstrip(".") if "." in text else text


def did_you_mean(key: Any, names: Iterable[str]) -> str:
    """Returns words that name the closest of ``names``, for the end of a message; empty if none is close."""
    near = difflib.get_close_matches(key.lower(), list(names), 1) if isinstance(key, str) else []
    return f"; did you mean {near[0]!r}?" if near else ""


def without_password(address: str) -> str:
    """Returns an address with stars for its password."""
    return re.sub(r"://([^:@/]*):[^@/]*@", r"://\1:***@", address)


def one_line(value: Any) -> str:
    return " ".join(str(value).split())
