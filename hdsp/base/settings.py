"""Typed settings: the only conversion from a file, a mapping or arguments to checked, frozen values.

A settings class is a frozen dataclass with the decorator ``checked``. Its annotations are the rules: types, ranges (the
shared types below), defaults. Rules between fields are pydantic model validators, which raise `fault`. Every fault
becomes an ``InputError`` in one line with the key's path (``robot.step.max_length``), its value, and the allowed
values.

Convention: values keep their type, with two exceptions: a float field accepts a whole number, a tuple field accepts a
list. Numbers are finite unless the field allows others.
"""

import functools
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Annotated, Any, TypeVar, dataclass_transform

import numpy as np
from pydantic import AfterValidator, ConfigDict, Field, PlainValidator, TypeAdapter, ValidationError, model_validator
from pydantic_core import ArgsKwargs, ErrorDetails, PydanticCustomError

from hdsp.base.errors import InputError
from hdsp.base.messages import did_you_mean, one_line, shown, unknown_key
from hdsp.base.short_repr import short_repr
from hdsp.base.yaml_files import TOO_DEEP, Document

T = TypeVar("T")

Positive = Annotated[float, Field(gt=0)]
NotNegative = Annotated[float, Field(ge=0)]
#: Share or probability, including 0 and 1.
Share = Annotated[float, Field(ge=0, le=1)]
#: Number of items, at least one.
Count = Annotated[int, Field(ge=1)]
#: Number of items, zero included.
Natural = Annotated[int, Field(ge=0)]
#: Seed, which also fits in an array of integers.
Seed = Annotated[int, Field(ge=0, le=2**63 - 1)]
#: Non-empty text.
Name = Annotated[str, Field(min_length=1)]


def _inside(text: str) -> str:
    parts = text.split("/")
    if text.startswith("/") or ".." in parts or "\\" in text or "\0" in text:
        raise fault("", text, "a path that stays in its folder")
    return text


def _file_name(text: str) -> str:
    if text in (".", "..") or "/" in text or "\\" in text or not text.isprintable():
        raise fault("", text, "a name without slashes and control characters")
    return text


#: Path of a file below some folder, which it never leaves; with slashes.
PathInside = Annotated[str, AfterValidator(_inside)]
#: Non-empty text that names a file or folder.
FileName = Annotated[str, Field(min_length=1), AfterValidator(_file_name)]

_CONFIG = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)


def unit(name: str) -> Any:
    """Annotation with a field's unit, for the class's JSON schema."""
    return Field(json_schema_extra={"unit": name})


def _distinct(values: tuple) -> tuple:
    for place, value in enumerate(values):
        if value in values[:place]:
            raise fault(f"[{place}]", value, "each value once")
    return values


#: Annotation for a tuple field in which no value may be there twice.
DISTINCT = AfterValidator(_distinct)


def one_of(names: Sequence[str]) -> AfterValidator:
    """Annotation for a text field with these allowed names."""

    def known(value: str) -> str:
        if value not in names:
            raise fault("", value, f"one of {', '.join(names)}{did_you_mean(value, names)}")
        return value

    return AfterValidator(known)


def chosen_by(key: str, kinds: Mapping[str, type]) -> PlainValidator:
    """Annotation for a union of settings classes: the value of ``key`` names the class."""

    def chosen(values: Any) -> Any:
        if isinstance(values, tuple(kinds.values())):
            return values
        name = values.get(key, next(iter(kinds))) if isinstance(values, Mapping) else next(iter(kinds))
        if not isinstance(name, str) or name not in kinds:
            raise fault(key, name, f"one of {', '.join(kinds)}")
        return _adapter(kinds[name]).validate_python(values)

    return PlainValidator(chosen)


def or_target(kind: type) -> PlainValidator:
    """Annotation for settings of class ``kind``, or a mapping with ``_target_``, the place of a function or class."""

    def chosen(values: Any) -> Any:
        if isinstance(values, Mapping) and TARGET in values:
            return _target(values)
        return values if isinstance(values, kind) else _adapter(kind).validate_python(values)

    return PlainValidator(chosen)


def _target(values: Any) -> dict[str, Any]:
    place = values.get(TARGET) if isinstance(values, Mapping) else None
    if not isinstance(place, str) or "." not in place:
        raise fault("", values, f"a mapping with {TARGET}: package.module.name")
    return dict(values)


#: Key of the place of a function or class.
TARGET = "_target_"
#: A function or class with its arguments: its place under ``_target_``, package.module.name, and keyword arguments.
Target = Annotated[dict[str, Any], PlainValidator(_target)]


def fault(key: str, value: Any, need: str) -> PydanticCustomError:
    """Returns the error for a validator to raise about a key in its class.

    Args:
        key: field name, or a path below it (``boxes[0].above``); empty = the whole class.
        value: the key's value.
        need: allowed values; the message is "KEY is VALUE; need NEED".
    """
    return PydanticCustomError("fault", "{text}", {"key": key, "text": f"is {shown(value)}; need {need}"})


def _rising(values: tuple) -> tuple:
    if not values[0] <= values[1]:
        raise fault("", values, "the smaller number first")
    return values


#: Ends of a range, the smaller number first.
Range = Annotated[tuple[Positive, Positive], AfterValidator(_rising)]
RangeFromZero = Annotated[tuple[NotNegative, NotNegative], AfterValidator(_rising)]
CountRange = Annotated[tuple[Count, Count], AfterValidator(_rising)]


@dataclass_transform(frozen_default=True, field_specifiers=(field, Field))
def checked(cls: type[T]) -> type[T]:
    """Turns a class into a settings class: a frozen dataclass that checks its values on every construction.

    Constructor arguments and mappings (`load_settings`) follow the same rules. Lists become tuples, numpy numbers
    become Python numbers. ``dataclasses.replace``, ``asdict`` and ``fields`` work as for any dataclass.
    """

    def prepared(own: type, values: Any) -> Any:
        given = values.kwargs if isinstance(values, ArgsKwargs) else values
        if not isinstance(given, Mapping):
            return values
        _check_keys(own, given)
        frozen = {key: _frozen(value) for key, value in given.items()}
        return ArgsKwargs((), frozen) if isinstance(values, ArgsKwargs) else frozen

    def schema(own: type, source: Any, handler: Callable[[Any], Any]) -> Any:
        whole = part = handler(source)
        while part["type"] != "dataclass":  # validators wrap the dataclass schema
            part = part["schema"]
        part["strict"] = False  # fields stay strict, but a mapping is accepted as dataclass
        return whole

    def init(self: Any, *args: Any, **kwargs: Any) -> None:
        names = [entry.name for entry in fields(self)][: len(args)]
        if len(names) < len(args) or not kwargs.keys().isdisjoint(names):
            raise TypeError(f"{type(self).__name__} takes each of {', '.join(e.name for e in fields(self))} once")
        given = ArgsKwargs((), {**dict(zip(names, args, strict=True)), **kwargs})
        try:
            _adapter(type(self)).validator.validate_python(given, self_instance=self)
        except ValidationError as error:
            raise InputError(_first_fault(error, type(self).__name__)) from None

    # One name in all settings classes, so that a subclass's validator replaces its parent's.
    before: Any = model_validator(mode="before")
    added = {"_prepared": before(classmethod(prepared)), "__get_pydantic_core_schema__": classmethod(schema)}
    for name, value in {**added, "__pydantic_config__": _CONFIG}.items():
        setattr(cls, name, value)
    if cls.__repr__ is object.__repr__:
        setattr(cls, "__repr__", lambda self: short_repr(self))  # noqa: B010, mypy allows no other way
    made = dataclass(frozen=True)(cls)
    made.__init__ = functools.wraps(made.__init__)(init)  # type: ignore[method-assign]
    return made


def load_settings(kind: type[T], values: Any, where: str = "", source: Document | str | None = None) -> T:
    """Builds settings of class ``kind`` from a mapping; returns an instance of ``kind`` unchanged.

    Args:
        kind: settings class (`checked`).
        values: plain nested values.
        where: name of this configuration part, the first part of all paths in messages.
        source: file with the values, or its name; messages then begin with it, and with the line if it is known.

    Raises:
        InputError: a key is unknown, missing or wrong; the message names the first one.
    """
    if isinstance(values, kind):
        return values
    try:
        return _adapter(kind).validate_python(values)
    except ValidationError as error:
        raise InputError(_first_fault(error, where, source)) from None
    except RecursionError:
        raise InputError(_joined(where, f": {TOO_DEEP}")) from None


def _adapter(kind: type) -> TypeAdapter[Any]:
    """Validator for a class, built at its first use because this takes a millisecond."""
    if kind not in _ADAPTERS:
        _ADAPTERS[kind] = TypeAdapter(kind)
    return _ADAPTERS[kind]


_ADAPTERS: dict[type, TypeAdapter[Any]] = {}


def _frozen(value: Any) -> Any:
    if isinstance(value, np.generic | np.ndarray):
        value = value.tolist()
    return tuple(map(_frozen, value)) if isinstance(value, list | tuple) else value


def _check_keys(kind: type, values: Mapping[Any, Any]) -> None:
    allowed = [entry.name for entry in fields(kind)]  # type: ignore[arg-type]
    for key in values:
        if key not in allowed:
            raise PydanticCustomError("unknown_key", "{text}", {"key": key, "text": unknown_key(key, allowed)})


def _first_fault(error: ValidationError, where: str, source: Document | str | None = None) -> str:
    found = error.errors(include_url=False)[0]
    kind, path, context = found["type"], list(found["loc"]), found.get("ctx", {})
    inner = path
    if kind == "fault":
        inner = [*path, *(int(part) if part.isdigit() else part for part in re.findall(r"\w+", context["key"]))]
        path, words = inner, f" {context['text']}"
    elif kind == "unknown_key":
        inner, words = [*path, context["key"]], f": {context['text']}"
    elif kind == "missing" and isinstance(path[-1], str):
        path, words = path[:-1], f": key {shown(path[-1])} is missing"
    elif kind == "missing":
        words = " is missing"
    elif kind == "value_error":  # raised by a function inside a validator
        words = f": {one_line(context['error'])}"
    elif path[-1:] == ["[key]"]:
        path, words = path[:-2], f": key {shown(path[-2])}; need {_need(found)}"
    else:
        words = f" is {shown(found['input'])}; need {_need(found)}"
    steps = "".join(map(_step, path))
    text = _joined(where + steps if where else steps.lstrip("."), words)
    if isinstance(source, Document):
        return f"{source.name}, line {source.line(inner)}: {text}"
    return text if source is None else f"{source}: {text}"


def _need(found: ErrorDetails) -> str:
    """Allowed values, according to pydantic's error."""
    kind, context = found["type"], found.get("ctx", {})
    if kind == "greater_than" and context["gt"] == 0:
        return "a positive number"
    if kind == "literal_error":
        allowed = context["expected"]
        return allowed + did_you_mean(found["input"], re.findall("'([^']*)'", allowed))
    context = {key: f"{value:g}" if isinstance(value, float) else value for key, value in context.items()}
    return _NEEDS[kind].format_map(context) if kind in _NEEDS else found["msg"].removeprefix("Input should be ")


_NEEDS = {
    "float_type": "a finite number",
    "finite_number": "a finite number",
    "int_type": "a whole number",
    "bool_type": "true or false",
    "string_type": "a text",
    "string_too_short": "a text that is not empty",
    "dataclass_type": "a mapping",
    "dict_type": "a mapping",
    "tuple_type": "a list",
    "too_short": "a list of at least {min_length}",
    "too_long": "a list of at most {max_length}",
    "greater_than": "more than {gt}",
    "greater_than_equal": "at least {ge}",
    "less_than": "less than {lt}",
    "less_than_equal": "at most {le}",
}


def _step(part: str | int) -> str:
    if isinstance(part, int):
        return f"[{part}]"
    return f".{part}" if re.fullmatch(r"[\w.\[\]-]+", part) else f"[{shown(part)}]"


def _joined(where: str, words: str) -> str:
    return f"{where}{words}" if where else words.lstrip(": ")
