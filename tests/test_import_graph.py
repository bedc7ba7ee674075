"""The graph of imports of ``hdsp``, with those inside functions and by name. `lint-imports` holds the layers."""

import ast
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

from tests import ROOT

PACKAGE = ROOT / "hdsp"


def module_name(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


MODULES = {module_name(path): path for path in sorted(PACKAGE.rglob("*.py"))}


def imported(name: str) -> set[str]:
    """Modules of the package that a module imports anywhere in its text."""
    tree = ast.parse(MODULES[name].read_text(encoding="utf-8"))
    found: set[str] = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{name}: imports are absolute"
            submodules = {f"{node.module}.{alias.name}" for alias in node.names} & set(MODULES)
            # A package whose submodules are imported by their names has no part in it.
            found |= submodules if len(submodules) == len(node.names) else submodules | {str(node.module)}
        elif isinstance(node, ast.Call) and ast.unparse(node.func).endswith("import_module"):
            found |= by_name(name, node.args[0], tree)
    return found & set(MODULES)


def by_name(name: str, argument: ast.expr, tree: ast.Module) -> set[str]:
    """Modules that `import_module` may be asked for: a constant, or the values of a package's table of lazy names."""
    if isinstance(argument, ast.Constant):
        return {str(argument.value)}
    tables = [
        node.value for node in tree.body if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "_MODULES"
    ]
    assert tables, f"{name}: import_module({ast.unparse(argument)}) hides which modules it loads; name them in _MODULES"
    return {f"{name}.{module}" for module in ast.literal_eval(tables[0]).values()}


def test_no_module_imports_itself_by_way_of_others():
    graph = {name: imported(name) for name in MODULES}
    assert len(graph) > 100 and sum(map(len, graph.values())) > 500
    try:
        tuple(TopologicalSorter(graph).static_order())
    except CycleError as error:
        pytest.fail(" <- ".join(error.args[1]))


def test_the_package_has_nine_rooms():
    entries = {path.name for path in PACKAGE.iterdir() if path.name != "__pycache__"}
    rooms = {"base", "robot", "terrain", "detailed", "abstract", "labels", "learning", "viz", "planning"}
    assert entries == {"__init__.py", "__main__.py", "py.typed", *rooms}


def test_every_file_name_stands_for_one_thing():
    names = [path.name for path in MODULES.values() if path.name != "__init__.py"]
    twice = sorted({name for name in names if names.count(name) > 1})
    assert not twice
