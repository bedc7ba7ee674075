"""Examples in docstrings run; the most used names have one."""

import doctest
from importlib import import_module

import pytest

from tests import ROOT

MODULES = sorted(
    ".".join(path.relative_to(ROOT).with_suffix("").parts)
    for path in (ROOT / "hdsp").rglob("*.py")
    if ">>> " in path.read_text()
)


@pytest.mark.parametrize("name", MODULES)
def test_examples_print_their_results(name):
    tried = doctest.testmod(import_module(name), optionflags=doctest.ELLIPSIS)
    assert tried.failed == 0 and tried.attempted > 0


def test_what_users_call_first_has_an_example():
    import hdsp
    from hdsp.terrain import random_arena

    for value in (hdsp.HeightMap, hdsp.Planner, hdsp.Planner.improve, hdsp.Plan.refine, hdsp.Robot.load, random_arena):
        assert ">>> " in value.__doc__, value
