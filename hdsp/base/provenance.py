"""A hash of the code a result depends on, so that results made by other code are not taken for valid."""

import ast
import hashlib
from collections.abc import Iterable
from pathlib import Path

_PACKAGE = __name__.split(".")[0]
_ROOT = Path(__file__).resolve().parents[2]


def code_fingerprint(modules: Iterable[str]) -> str:
    """Hex digest of the code of ``modules`` (dotted names) and of every module of this package that they import.

    Comments, docstrings and layout do not count.
    """
    found: dict[str, str] = {}
    waiting = list(modules)
    while waiting:
        name = waiting.pop()
        if name in found or (path := _source(name)) is None:
            continue
        tree = ast.parse(path.read_text(encoding="utf-8"))
        _drop_docstrings(tree)
        found[name] = ast.unparse(tree)
        waiting += _imports(tree)
    text = "\n".join(f"# {name}\n{found[name]}" for name in sorted(found))
    return hashlib.sha256(text.encode()).hexdigest()


def _source(name: str) -> Path | None:
    """The file of a module or package; None if the name is neither (a function, say)."""
    path = _ROOT.joinpath(*name.split("."))
    places = (path.with_suffix(".py"), path / "__init__.py")
    return next((place for place in places if place.is_file()), None)


def _imports(tree: ast.Module) -> list[str]:
    names: list[str] = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            # What is imported may be a module or something in one.
            names += [node.module, *(f"{node.module}.{alias.name}" for alias in node.names)]
    # The root package only gives names to what lies below it.
    return [name for name in names if name.startswith(f"{_PACKAGE}.")]


def _drop_docstrings(tree: ast.Module) -> None:
    for node in ast.walk(tree):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef) and ast.get_docstring(node) is not None:
            node.body[:1] = [] if len(node.body) > 1 else [ast.Pass()]
