"""Values and keys in messages: short, on one line."""

import difflib
import reprlib
from collections.abc import Iterable
from typing import Any

_LONGEST = 100  # characters of a value in a message


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


def did_you_mean(key: Any, names: Iterable[str]) -> str:
    """Returns words that name the closest of ``names``, for the end of a message; empty if none is close."""
    near = difflib.get_close_matches(key.lower(), list(names), 1) if isinstance(key, str) else []
    return f"; did you mean {near[0]!r}?" if near else ""


def one_line(value: Any) -> str:
    return " ".join(str(value).split())
