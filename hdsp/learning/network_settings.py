"""Typed settings from plain mappings: every key checked, every fault named in one line."""

import dataclasses
import types
import typing
from collections.abc import Mapping
from typing import Any, Literal, TypeVar, Union

from hdsp.base.errors import InputError

T = TypeVar("T")


def settings_from(cls: type[T], mapping: Mapping[str, Any] | None, where: str) -> T:
    """Builds the settings dataclass ``cls`` from a mapping; missing keys keep their defaults.

    Args:
        cls: a dataclass whose fields are numbers, strings, booleans, ``Literal`` choices, tuples of numbers or strings,
            dicts, further such dataclasses, or any of these or None.
        mapping: keys as the fields of ``cls``; an OmegaConf node works too. None means all defaults.
        where: the name of this part of the configuration, for error messages.

    Raises:
        InputError: on an unknown key or a value of the wrong kind.
    """
    if isinstance(mapping, cls):
        return mapping
    if mapping is not None and not isinstance(mapping, Mapping):
        raise InputError(f"{where}: need a mapping, got {mapping!r}")
    known = typing.get_type_hints(cls)
    values = dict(mapping or {})
    unknown = sorted(str(key) for key in values if key not in known)
    if unknown:
        raise InputError(f"{where}: unknown key {unknown[0]!r}; allowed are {', '.join(known)}")
    return cls(**{key: _converted(value, known[key], f"{where}.{key}") for key, value in values.items()})


def _converted(value: Any, kind: Any, where: str) -> Any:
    origin, arguments = typing.get_origin(kind), typing.get_args(kind)
    if origin in (Union, types.UnionType):
        if value is None and type(None) in arguments:
            return None
        return _converted(value, next(a for a in arguments if a is not type(None)), where)
    if dataclasses.is_dataclass(kind):
        return settings_from(kind, value, where)
    if origin is Literal:
        if value not in arguments:
            raise InputError(f"{where}: {value!r} is not one of {', '.join(map(str, arguments))}")
        return value
    if origin is tuple:
        if isinstance(value, str) or not hasattr(value, "__iter__"):
            raise InputError(f"{where}: need a list, got {value!r}")
        items = list(value)
        if Ellipsis not in arguments and len(items) != len(arguments):
            raise InputError(f"{where}: need {len(arguments)} values, got {len(items)}")
        return tuple(_converted(item, arguments[0], where) for item in items)
    if kind is float and isinstance(value, (int, float)) and not isinstance(value, bool):
        return float(value)
    if isinstance(kind, type) and isinstance(value, kind) and not (kind is int and isinstance(value, bool)):
        return value
    if (origin or kind) is dict and isinstance(value, Mapping):
        return dict(value)
    raise InputError(f"{where}: need {getattr(kind, '__name__', kind)}, got {value!r}")
