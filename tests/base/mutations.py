"""Seeded damage to settings: edits of nested values, and of file bytes."""

import copy
from collections.abc import Iterator
from typing import Any

import numpy as np
import yaml

#: Replacements for a value.
WRONG: list[Any] = [
    None, True, False, 0, -1, 3, 2.5, -0.001, 1e-3, 1e12, 10**30, float("nan"), float("inf"), "", "fast", "0.3", "3",
    "a\nb", [], [1], [1.5, "x"], [[1, 2], [3]], {}, {"x": 1}, {1: 2, "b": 3}, {None: [True]}, [{"above": 1}],
]  # fmt: skip
#: Insertions into a text.
PIECES = [
    b"[", b"]", b"{", b"}", b":", b": ", b"- ", b"\t", b"&a ", b"*a", b"!!python/object:os.system ", b"!!int ", b"|",
    b">", b"%", b"@", b"`", b"'", b'"', b"#", b"---\n", b"...\n", b"\0", b"\xff\xfe", b"\xc3", b"<<: ", b"? ", b"\n",
    b"1e400", b"0x", b"2024-13-45", b"\xef\xbb\xbf", b"\xe2\x80\xa8",
]  # fmt: skip


def places(values: Any, path: tuple = ()) -> Iterator[tuple]:
    """Paths to all values in nested mappings and lists; the empty path to the whole comes first."""
    yield path
    entries = values.items() if isinstance(values, dict) else enumerate(values) if isinstance(values, list) else ()
    for key, value in entries:
        yield from places(value, (*path, key))


def at(values: Any, path: tuple) -> Any:
    for key in path:
        values = values[key]
    return values


def put(values: Any, path: tuple, value: Any) -> Any:
    """Copies nested values with another value at a path."""
    if not path:
        return value
    values = copy.deepcopy(values)
    at(values, path[:-1])[path[-1]] = value
    return values


def edited(values: Any, random: np.random.Generator) -> Any:
    """Applies one edit to nested values: replaces, removes or moves a value, or misspells, adds or retypes a key."""
    paths = list(places(values))
    path = paths[random.integers(len(paths))]
    kind = random.integers(6)
    if not path or kind < 3:
        return put(values, path, WRONG[random.integers(len(WRONG))])
    values = copy.deepcopy(values)
    parent, key = at(values, path[:-1]), path[-1]
    if kind == 3:  # removed
        del parent[key]
    elif isinstance(parent, list):  # twice
        parent.insert(key, copy.deepcopy(parent[key]))
    elif kind == 4:  # misspelt, or no text
        text = str(key)
        cut = int(random.integers(len(text)))
        names = [text[:cut] + text[cut + 1 :], text + "_", text.upper(), 3, None, True, 2.5, f"{text}.{text}"]
        parent[names[random.integers(len(names))]] = parent.pop(key)
    else:  # at another place
        other = paths[random.integers(1, len(paths))]
        parent[key] = copy.deepcopy(at(values, other)) if other[: len(path)] != path else {key: parent[key]}
    return values


def damaged(text: bytes, random: np.random.Generator) -> bytes:
    """Applies one edit to file bytes: cut off, a piece inserted or removed, a line duplicated or moved."""
    kind, place = random.integers(6), int(random.integers(len(text) + 1))
    if kind == 0:
        return text[:place]
    if kind == 1:
        return text[:place] + PIECES[random.integers(len(PIECES))] + text[place:]
    if kind == 2:
        return text[:place] + text[place + int(random.integers(1, 12)) :]
    if kind == 3:
        return text[:place] + bytes(random.integers(0, 256, 3).astype(np.uint8)) + text[place + 3 :]
    lines = text.splitlines(keepends=True)
    line = int(random.integers(len(lines)))
    if kind == 4:
        return b"".join([*lines[: line + 1], *lines[line:]])
    return b"".join([*lines[:line], b"  " + lines[line], *lines[line + 1 :]])


def mutated_file(values: Any, text: bytes, random: np.random.Generator) -> bytes:
    """YAML file bytes after one edit of values or text."""
    if random.random() < 0.6:
        return yaml.safe_dump(edited(values, random), sort_keys=False, allow_unicode=True).encode()
    return damaged(text, random)
