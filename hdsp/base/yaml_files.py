"""Mappings from YAML and JSON files, with the lines of their keys."""

import json
import os
import re
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

import yaml

from hdsp.base.errors import InputError
from hdsp.base.files import existing_file
from hdsp.base.messages import one_line, shown

Path = Sequence[str | int]

TOO_DEEP = "nested too deeply, or a part of itself"
#: Largest number of values that aliases add to those in the text.
MOST_COPIES = 100_000


class Document(NamedTuple):
    """Contents of a YAML file.

    Attributes:
        values: the file's mapping, plain.
        name: file name in messages.
        text: file text.
        root: parsed nodes with their lines.
    """

    values: dict[Any, Any]
    name: str
    text: str
    root: yaml.Node

    def line(self, path: Path) -> int:
        """Returns the line, counted from 1, of the key at a path, or of the path's innermost existing part."""
        node, line = self.root, self.root.start_mark.line
        for part in path:
            if isinstance(node, yaml.MappingNode):
                found = [pair for pair in node.value if pair[0].value == str(part)]
                if not found:
                    break
                line, node = found[-1][0].start_mark.line, found[-1][1]
            elif isinstance(node, yaml.SequenceNode) and isinstance(part, int) and part < len(node.value):
                node = node.value[part]
                line = node.start_mark.line
            else:
                break
        return line + 1


def read_yaml(path: str | os.PathLike, what: str) -> Document:
    """Reads the mapping in a YAML file.

    Args:
        path: path of the file.
        what: the file's name in messages.

    Raises:
        InputError: the file does not exist, or holds no mapping; with the line of the fault.
    """
    return parse_yaml(_read_text(path, what), str(path))


def parse_yaml(text: str, name: str) -> Document:
    """Parses the mapping in a YAML text.

    A key may appear only once in a mapping; numbers like ``1e-3`` are numbers. Aliases may stand for `MOST_COPIES`
    values, because readers copy them.

    Args:
        text: file text.
        name: file name in messages.

    Raises:
        InputError: the text is not YAML, or no mapping; with the line.
    """
    loader = None
    try:
        loader = _Loader(text)
        root = loader.get_single_node()
        if root is not None:
            _check_copies(root)
        values = None if root is None else loader.construct_document(root)
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        line = mark.line + 1 if mark else 1
        raise InputError(f"{name}, line {line}: not YAML: {one_line(error.problem or error.context)}") from None
    except yaml.reader.ReaderError as error:
        line = text.count("\n", 0, error.position) + 1
        raise InputError(f"{name}, line {line}: not YAML: {error.reason}") from None
    except RecursionError:
        raise InputError(f"{name}: {TOO_DEEP}") from None
    finally:
        if loader is not None:
            loader.dispose()
    if root is None:
        raise InputError(f"{name}, line 1: the file is empty; need a mapping")
    if not isinstance(values, dict):
        raise InputError(f"{name}, line {root.start_mark.line + 1}: need a mapping, got {shown(values)}")
    return Document(values, name, text, root)


def _check_copies(root: yaml.Node) -> None:
    """Refuses a document that some lines of aliases of aliases make too large; a text without aliases has any size."""
    sizes: dict[int, int] = {}
    for node in _innermost_first(root):
        parts = _parts(node)
        sizes[id(node)] = 1 + sum(sizes.get(id(part), 0) for part in parts)  # 0: a mapping or list around itself
        if sizes[id(node)] > len(sizes) + MOST_COPIES:
            problem = f"aliases stand for more than {MOST_COPIES:,} values"
            raise yaml.composer.ComposerError(None, None, problem, node.start_mark)


def _innermost_first(root: yaml.Node) -> Iterator[yaml.Node]:
    """Each node once, after those in it."""
    waiting, seen = [(root, False)], set()
    while waiting:
        node, is_done = waiting.pop()
        if is_done:
            yield node
        elif id(node) not in seen:
            seen.add(id(node))
            waiting += [(node, True), *((part, False) for part in _parts(node))]


def _parts(node: yaml.Node) -> list[yaml.Node]:
    if isinstance(node, yaml.MappingNode):
        return [part for pair in node.value for part in pair]
    return node.value if isinstance(node, yaml.SequenceNode) else []


def read_json(path: str | os.PathLike, what: str) -> Any:
    """Reads the value in a JSON file; arguments as in `read_yaml`.

    Raises:
        InputError: the file does not exist, or is not JSON; with the line.
    """
    text = _read_text(path, what)
    try:
        return json.loads(text)
    except json.JSONDecodeError as error:
        raise InputError(f"{path}, line {error.lineno}: not JSON: {error.msg}") from None
    except (RecursionError, ValueError) as error:  # ValueError: a number with thousands of digits
        raise InputError(f"{path}: not JSON: {one_line(error)}") from None


class _Loader(yaml.SafeLoader):
    """PyYAML's safe loader; it also accepts exponents without a point, and rejects duplicate keys."""

    def construct_object(self, node: yaml.Node, deep: bool = False) -> Any:
        try:
            return super().construct_object(node, deep)
        except (ValueError, OverflowError) as error:  # invalid dates, numbers with thousands of digits
            raise yaml.constructor.ConstructorError(None, None, str(error), node.start_mark) from None
        except (AttributeError, LookupError, TypeError):  # PyYAML's own, for a tag that the value does not fit
            problem = f"{shown(node.value)} is no {node.tag.rpartition(':')[2]}"
            raise yaml.constructor.ConstructorError(None, None, problem, node.start_mark) from None

    def compose_mapping_node(self, anchor: Any) -> yaml.MappingNode:
        # Only here does a node hold the keys of the text; its construction adds those of merged mappings.
        node = super().compose_mapping_node(anchor)
        lines: dict[tuple[str, str], int] = {}
        for key, _ in node.value:
            if not isinstance(key, yaml.ScalarNode) or key.tag == "tag:yaml.org,2002:merge":
                continue
            if (key.tag, key.value) in lines:
                first = lines[key.tag, key.value] + 1
                problem = f"key {shown(key.value)} is there twice, first in line {first}"
                raise yaml.composer.ComposerError(None, None, problem, key.start_mark)
            lines[key.tag, key.value] = key.start_mark.line
        return node


_Loader.add_implicit_resolver(
    "tag:yaml.org,2002:float",
    re.compile(r"[-+]?(?:[0-9][0-9_]*\.?[0-9_]*|\.[0-9]+)[eE][-+]?[0-9]+$"),
    list("-+.0123456789"),
)


def _read_text(path: str | os.PathLike, what: str) -> str:
    try:
        data = existing_file(path, what).read_bytes()
    except OSError as error:
        raise InputError(f"{what} {path} cannot be read: {error.strerror or error}") from None
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise InputError(f"{path}, line {line}: no text in UTF-8") from None
