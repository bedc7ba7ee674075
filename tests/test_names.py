"""One name for one thing: no two modules, and no two classes, are called the same."""

import ast
from collections import defaultdict

from tests import ROOT

SOURCES = sorted(path for folder in ("hdsp", "pipeline") for path in (ROOT / folder).rglob("*.py"))


def test_each_file_name_stands_for_one_module():
    named = defaultdict(list)
    for path in SOURCES:
        if path.stem != "__init__":
            named[path.name].append(path.relative_to(ROOT).as_posix())
    assert [paths for paths in named.values() if len(paths) > 1] == []


def test_each_class_name_stands_for_one_class():
    named = defaultdict(list)
    for path in SOURCES:
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ClassDef):
                named[node.name].append(f"{path.relative_to(ROOT)}:{node.lineno}")
    assert [places for places in named.values() if len(places) > 1] == []
