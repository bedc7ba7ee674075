"""Robot file as a JSON schema and as a documentation page, both generated from the classes in `hdsp.robot`.

    python -m hdsp.robot.schema          # prints the schema
    python -m hdsp.robot.schema docs     # writes docs/robot.schema.json and docs/robot-file.md

Units and ranges come from annotations, meanings from docstrings (section "Attributes").
"""

import inspect
import json
import re
import sys
from collections.abc import Iterator, Sequence
from dataclasses import is_dataclass
from pathlib import Path
from typing import Any, NamedTuple

from pydantic import TypeAdapter

from hdsp.base.files import replacing
from hdsp.robot import action_limits, motion_limits, physics, robot, shape
from hdsp.robot.robot import Robot

SCHEMA_FILE, PAGE_FILE = "robot.schema.json", "robot-file.md"
_MODULES = robot, shape, action_limits, motion_limits, physics
_DIALECT = "https://json-schema.org/draft/2020-12/schema"

_PAGE = """# Robot file

This page documents every key of a robot file. `python -m hdsp.robot.schema docs` writes the page from
`hdsp/robot/`; do not edit it.

A robot is one YAML file: `hdsp.Planner(terrain, robot="my_robot.yaml")`. Every key without a default is required. The
presets [momaro.yaml](../hdsp/robot/presets/momaro.yaml),
[anymal_wheels.yaml](../hdsp/robot/presets/anymal_wheels.yaml) and [go2w.yaml](../hdsp/robot/presets/go2w.yaml) are
templates. [Another robot](own-robot.md) shows the steps from a file to an abstraction for this robot.

The loader names each fault in one line:

```
my_robot.yaml, line 47: robot.step: unknown key 'max_lenght'; did you mean 'max_length'? allowed are backward, cost, ...
my_robot.yaml, line 9: robot.feet.clearance is '0.075'; need a finite number
```

An editor with a YAML language server completes and checks the file with [{schema}]({schema}). The first line
of the file names the schema:

```yaml
# yaml-language-server: $schema=PATH/TO/{schema}
```

Convention: metres and radians in the robot frame, x forward, y left. Costs are unitless. Symmetric parts are given
once, for the front left leg. `.inf` is infinity. The editor checks keys and ranges; the loader also checks the rules
between keys:

- `feet`: the offsets include 0 and span less than 0.8 m; `contact_inward` is at most `neutral_x` and `neutral_y`;
  `min_separation` is at most twice `neutral_x`.
- `body.boxes`: at least one box; `x_min` is less than `x_max`.
- `feet.clearance`: more than 0, or `physics.wheel_radius` or `drive.wheel_radius` is given.
- `drive`: either `max_height_difference`, or `wheel_radius` and `rolled_share`.
- `turn`: `radius` for a robot that does not turn on the spot, and no other.
- `drive.deviation_cost`: `side_from` is at most `side_to`.
- `stance.base_height`: between `legs.min_length` and `legs.max_length`.

"""


class Key(NamedTuple):
    """Robot file key with a value.

    Attributes:
        path: dotted key path; ``[]`` for each list entry.
        schema: JSON schema for its value.
    """

    path: str
    schema: dict[str, Any]


def robot_schema() -> dict[str, Any]:
    """Returns the robot file's JSON schema; each key has a ``description``, and a ``unit`` if it has one."""
    schema = TypeAdapter(Robot).json_schema()
    for name, part in {"Robot": schema, **schema["$defs"]}.items():
        kind = next(getattr(module, name) for module in _MODULES if hasattr(module, name))
        meanings = _meanings(kind)
        part["description"] = _summary(kind)
        for key, value in part["properties"].items():
            value.pop("title", None)
            if "anyOf" in value:  # a number, or null as the default
                inner = value.pop("anyOf")[0]
                value |= {**inner, "type": [inner["type"], "null"]}
            value["description"] = meanings[key] + (f" [{value['unit']}]" if "unit" in value else "")
    return {"$schema": _DIALECT, **schema, "title": "Robot file of hdsp"}


def keys(schema: dict[str, Any], part: dict[str, Any] | None = None, path: str = "") -> Iterator[Key]:
    """Yields all keys with a value, in class order."""
    for name, value in (part or schema)["properties"].items():
        inner, own = value, f"{path}{name}"
        if value.get("type") == "array":
            inner, own = value["items"], f"{own}[]"
        if "$ref" in inner:
            yield from keys(schema, schema["$defs"][inner["$ref"].rpartition("/")[2]], f"{own}.")
        else:
            yield Key(own, value)


def page(schema: dict[str, Any]) -> str:
    """Returns the documentation page: a table with all keys."""
    rows = [("key", "unit", "range", "meaning")]
    for key in keys(schema):
        unit = key.schema.get("unit", "")
        meaning = key.schema["description"].removesuffix(f" [{unit}]")
        rows.append((f"`{key.path}`", unit, _range(key.schema), meaning))
    widths = [max(len(row[column]) for row in rows) for column in range(3)]
    lines = [
        "| " + " | ".join([*(c.ljust(w) for c, w in zip(row, widths, strict=False)), row[3]]) + " |" for row in rows
    ]
    lines.insert(1, "|" + "|".join("-" * (width + 2) for width in widths) + "|---|")
    return _PAGE.replace("{schema}", SCHEMA_FILE) + "\n".join(lines) + "\n"


def schema_text(schema: dict[str, Any]) -> str:
    """Formats the schema for its file."""
    return json.dumps(schema, indent=2) + "\n"


def main(arguments: Sequence[str]) -> None:
    """Prints the schema, or writes schema and page into the given folder."""
    schema = robot_schema()
    if not arguments:
        print(schema_text(schema), end="")
        return
    for name, text in ((SCHEMA_FILE, schema_text(schema)), (PAGE_FILE, page(schema))):
        with replacing(Path(arguments[0]) / name) as temporary:
            temporary.write_text(text, encoding="utf-8")


def _range(schema: dict[str, Any]) -> str:
    default = f"; default {json.dumps(schema['default'])}" if "default" in schema else ""
    if schema["type"] in ("boolean", "string"):
        return {"boolean": "true, false", "string": "text"}[schema["type"]] + default
    signs = {"exclusiveMinimum": "> ", "minimum": "≥ ", "exclusiveMaximum": "< ", "maximum": "≤ "}
    limits = ", ".join(f"{sign}{schema[name]:.6g}" for name, sign in signs.items() if name in schema)
    return (limits or "any") + default


def _summary(kind: type) -> str:
    return " ".join(inspect.cleandoc(kind.__doc__ or "").partition("\n\n")[0].split())


def _meanings(kind: type) -> dict[str, str]:
    """Meanings by key, for a class and its parents."""
    found: dict[str, str] = {}
    for owner in reversed([owner for owner in kind.__mro__ if is_dataclass(owner)]):
        _, _, listed = inspect.cleandoc(owner.__doc__ or "").partition("Attributes:\n")
        entries = re.findall(r"^    (\w+): (.*(?:\n {8}.*)*)", listed, re.MULTILINE)
        found |= {name: " ".join(text.split()) for name, text in entries}
    return found


if __name__ == "__main__":
    main(sys.argv[1:])
