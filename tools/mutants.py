"""Mutation testing of kernels: one small change at a time, and tests that should notice it.

    python tools/mutants.py [--count 20] [--seed 0] [MODULE ...]

Each mutant exchanges a comparison, an arithmetic operator or a number in one module, within a copy of the package, so
that compiled kernels of other modules are read from the disk. The last line is JSON: mutants, killed, survivors.
"""

import argparse
import ast
import copy
import json
import os
import random
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
#: Tests that run each module's kernels against their textbook twins; the first failure ends them.
TESTS = {
    "hdsp/abstract/dijkstra.py": ["tests/abstract/test_prepared_graph.py"],
    "hdsp/detailed/search/store.py": ["tests/detailed/test_store.py", "tests/detailed/test_search.py"],
    "hdsp/detailed/search/open_list.py": ["tests/detailed/test_store.py", "tests/detailed/test_search.py"],
    "hdsp/detailed/search/kernel.py": ["tests/detailed/test_search.py", "tests/detailed/test_anytime.py"],
    "hdsp/detailed/search/backward.py": ["tests/detailed/test_backward.py"],
    "hdsp/detailed/actions/successors.py": ["tests/detailed/test_successors.py", "tests/detailed/test_search.py"],
    "hdsp/detailed/actions/state_costs.py": ["tests/detailed/test_successors.py", "tests/detailed/test_search.py"],
}
#: Seconds after which a mutant counts as killed: it does not end.
LONGEST = 600
_COMPARISONS = {
    ast.Lt: ast.LtE,
    ast.LtE: ast.Lt,
    ast.Gt: ast.GtE,
    ast.GtE: ast.Gt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
}
_OPERATORS = {ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Add, ast.FloorDiv: ast.Mult, ast.Mod: ast.Mult}


def mutants(source: str) -> Iterator[tuple[str, str]]:
    """Yields a description and the changed source of each mutant; annotations and docstrings stay as they are."""
    tree = ast.parse(source)
    kernels = [node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef) and node.decorator_list]
    for kernel in kernels:
        for number, node in enumerate(ast.walk(kernel)):
            if (changed := _changed(node)) is None:
                continue
            other = copy.deepcopy(tree)
            place = next(n for n in ast.walk(other) if isinstance(n, ast.FunctionDef) and n.name == kernel.name)
            target = list(ast.walk(place))[number]
            target.__dict__.update(changed.__dict__)
            told = f"{kernel.name}, line {node.lineno}: {ast.unparse(node)} -> {ast.unparse(changed)}"
            yield told, ast.unparse(other)


def _changed(node: ast.AST) -> ast.expr | None:
    other = copy.deepcopy(node)
    if isinstance(other, ast.Compare) and type(other.ops[0]) in _COMPARISONS:
        other.ops[0] = _COMPARISONS[type(other.ops[0])]()
    elif isinstance(other, ast.BinOp) and type(other.op) in _OPERATORS:
        other.op = _OPERATORS[type(other.op)]()
    elif isinstance(other, ast.Constant) and type(other.value) in (int, float):
        other.value += 1
    else:
        return None
    return other


def survives(module: str, source: str, place: Path) -> bool:
    """Whether all tests of a module pass with another source."""
    (place / module).write_text(source, encoding="utf-8")
    environment = {**os.environ, "PYTHONPATH": str(place)}
    command = [sys.executable, "-m", "pytest", "-q", "-x", "-n0", "--rootdir", str(place), *TESTS[module]]
    try:
        done = subprocess.run(command, cwd=place, env=environment, capture_output=True, timeout=LONGEST)
    except subprocess.TimeoutExpired:
        return False
    return done.returncode == 0


def main(argv: list[str] | None = None) -> dict:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("modules", nargs="*", metavar="MODULE", help=f"some of {', '.join(TESTS)}")
    parser.add_argument("--count", type=int, default=20, help="mutants of each module")
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args(argv)
    survivors, count = [], 0
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        shutil.copytree(ROOT / "hdsp", place / "hdsp")
        for name in ("tests", "benchmarks", "pipeline", "examples", "conf", "pyproject.toml"):
            (place / name).symlink_to(ROOT / name)
        for module in arguments.modules or TESTS:
            source = (ROOT / module).read_text(encoding="utf-8")
            found = list(mutants(source))
            if not survives(module, source, place):
                sys.exit(f"error: the tests of {module} fail without any change")
            for told, changed in random.Random(arguments.seed).sample(found, min(arguments.count, len(found))):
                count += 1
                if survives(module, changed, place):
                    survivors.append(f"{module}: {told}")
                    print(f"survived: {survivors[-1]}", flush=True)
            (place / module).write_text(source, encoding="utf-8")
    result = {"mutants": count, "killed": count - len(survivors), "survivors": survivors}
    print(json.dumps(result))
    return result


if __name__ == "__main__":
    main()
