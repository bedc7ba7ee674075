"""Short representations of values: one line without the contents of arrays, for prompts, notebooks and messages."""

from __future__ import annotations

import reprlib
from dataclasses import MISSING, fields, is_dataclass
from typing import Any

import numpy as np

from hdsp.base.messages import coordinates

#: Longest representation, characters.
LONGEST = 280


class _Brief(reprlib.Repr):
    """Shortens containers, texts and numbers; an array is its dtype and its shape."""

    def __init__(self) -> None:
        super().__init__()
        self.maxlevel, self.maxstring, self.maxother, self.maxlong = 3, 60, 120, 40
        self.maxdict = self.maxlist = self.maxtuple = 3

    def repr_ndarray(self, value: np.ndarray, level: int) -> str:
        return f"{value.dtype} {list(value.shape)}"

    def repr_float(self, value: float, level: int) -> str:
        text = repr(float(value))
        if len(text) <= 8:
            return text
        # A length of a whole number of metres has six digits; a coordinate of a projected map keeps its decimals.
        return f"{value:.6g}" if abs(value) < 1000 else coordinates([value])

    repr_float32 = repr_float64 = repr_float


_BRIEF = _Brief()


def short_repr(value: Any) -> str:
    """Returns the class and the fields of a dataclass or named tuple, at most `LONGEST` characters.

    If all fields are too long together, the ones with their default values are left out. An array is its dtype and
    shape. Of a long container, only the first entries are there. Fields with ``repr=False`` are never there.
    """
    if is_dataclass(value):
        named = {entry.name: getattr(value, entry.name) for entry in fields(value) if entry.repr}
        defaults = {entry.name: entry.default for entry in fields(value) if entry.default is not MISSING}
        defaults |= {e.name: e.default_factory() for e in fields(value) if e.default_factory is not MISSING}
    else:
        named, defaults = value._asdict(), value._field_defaults
    parts = {name: f"{name}={_BRIEF.repr(own)}" for name, own in named.items()}
    whole = f"{type(value).__qualname__}({', '.join(parts.values())})"
    if len(whole) <= LONGEST:
        return whole
    changed = [parts[name] for name, own in named.items() if not _is_default(own, defaults, name)]
    return shortened(f"{type(value).__qualname__}({', '.join(changed)})")


def shortened(text: str) -> str:
    """Returns a representation with at most `LONGEST` characters; a longer one ends in ``...)``."""
    return text if len(text) <= LONGEST else f"{text[: LONGEST - 4]}...)"


def _is_default(value: Any, defaults: dict[str, Any], name: str) -> bool:
    if name not in defaults or isinstance(value, np.ndarray):
        return False
    return type(value) is type(defaults[name]) and value == defaults[name]
