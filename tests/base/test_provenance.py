"""Code fingerprints: for a small package, and for the labels' code in copies of this package."""

import ast
import re
import shutil
import sys
from pathlib import Path

import pytest

from hdsp.base.provenance import EXEMPT, code_fingerprint, is_exempt, reached_code
from hdsp.labels.course_patches import courses_code
from hdsp.labels.rules import LabelSettings
from hdsp.labels.run.splits import LabelRun, SplitSettings, labels_code
from hdsp.labels.scan_patches import ScanPatchSettings, labelled_patches, patches_code
from hdsp.robot.robot import Robot
from hdsp.terrain.scenes import TerrainSettings, random_map
from tests import ROOT

PACKAGE = {
    "hdsp/__init__.py": "from hdsp.ground.heights import steepest\n",
    "hdsp/ground/__init__.py": '''
"""A face."""

from hdsp.ground import other
from hdsp.ground.heights import steepest

__all__ = ["steepest"]
''',
    "hdsp/ground/heights.py": """
import numpy as np

_SIDE = 2.0
TABLE = {}
TABLE["rise"] = 1.0
COUNT = 3
np.seterr(all="ignore")


class Heights:
    scale: float = 1.5

    def highest(self, values):
        return max(values) * self.scale

    def lowest(self, values):
        return min(values)


def steepest(values):
    return Heights().highest(values) * TABLE["rise"] * _side()


def _side():
    return _SIDE


def nobody_asks(values):
    return sorted(values)
""",
    "hdsp/ground/other.py": "_SIDE = 4.0\n\n\ndef width():\n    return _side()\n\n\ndef _side():\n    return _SIDE\n",
    "hdsp/walk.py": '''
"""Walks."""

from __future__ import annotations

from typing import TYPE_CHECKING

from hdsp.ground import other, steepest
from hdsp.marks import marked

if TYPE_CHECKING:
    from hdsp.robots import Robot


@marked(2)
def walk(robot: Robot, values: list[float], share=0.5):
    """Walks over values."""
    if share > 1:
        raise ValueError(f"share is {share}, at most 1 is allowed")
    from hdsp.feet import Foot

    return Foot(share).put(steepest(values)) + other.width() + robot.speed() + getattr(robot, "turn")()
''',
    "hdsp/marks.py": "def marked(number):\n    return lambda function: function\n",
    "hdsp/robots.py": """
class Robot:
    def speed(self):
        return 3

    def turn(self):
        return 6

    def name(self):
        return 4

    def __repr__(self):
        return "a robot"
""",
    "hdsp/feet.py": """
from hdsp.joints import Joint


class Foot(Joint):
    def put(self, height):
        return self.bend(height)
""",
    "hdsp/joints.py": """
class Joint:
    def bend(self, height):
        return -height

    def swing(self):
        return 0
""",
    "hdsp/stranger.py": "VALUE = 1\n",
}
WALK = "hdsp.walk:walk"


@pytest.fixture
def package(tmp_path):
    for name, text in PACKAGE.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(text)
    return tmp_path


def edit(root: Path, old: str, new: str, times: int = 1) -> Path:
    """Replaces a text in the only file that contains it."""
    holding = [path for path in root.rglob("*.py") if old in path.read_text()]
    assert len(holding) == 1, f"{old!r} is in {holding}"
    text = holding[0].read_text()
    assert text.count(old) == times
    holding[0].write_text(text.replace(old, new))
    return holding[0]


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("share=0.5", "share=0.4"),
        ("share > 1", "share > 2"),
        ("@marked(2)", "@marked(3)"),
        ("lambda function: function", "lambda function: print"),
        ("+ other.width()", "- other.width()"),
        ("_SIDE = 2.0", "_SIDE = 2.5"),
        ("_SIDE = 4.0", "_SIDE = 4.5"),
        ('TABLE["rise"] = 1.0', 'TABLE["rise"] = 1.1'),
        ('np.seterr(all="ignore")', 'np.seterr(all="raise")'),
        ("scale: float = 1.5", "scale: float = 1.6"),
        ("max(values) * self.scale", "max(values)"),
        ("return 3", "return 5"),
        ("return 6", "return 5"),
        ("return self.bend(height)", "return self.bend(0)"),
        ("return -height", "return height"),
    ],
)
def test_it_changes_with_all_code_that_is_reached(package, old, new):
    before = code_fingerprint(WALK, root=package)
    edit(package, old, new)
    assert code_fingerprint(WALK, root=package) != before


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('"""Walks over values."""', '"""Says it in other words."""'),
        ('    """Walks over values."""\n', ""),
        ("_SIDE = 2.0", "# in metres\n_SIDE = (2.0)  # of a cell"),
        ("values: list[float], share=0.5", "values: tuple, share: float = 0.5"),
        ("share is {share}, at most 1 is allowed", "{share} is above the limit of 1"),
        ("scale: float", "scale: int"),
        ("return min(values)", "return None"),
        ("return sorted(values)", "return None"),
        ("COUNT = 3", "COUNT = 4"),
        ("return 4", "return 5"),
        ("a robot", "the robot"),
        ("return 0", "return 1"),
        ("VALUE = 1", "VALUE = 2"),
        ('__all__ = ["steepest"]', "__all__ = []"),
        ("import numpy as np\n", "import math\n\nimport numpy as np\n"),
    ],
)
def test_it_does_not_change_with_words_types_and_code_that_nobody_asks_for(package, old, new):
    before = code_fingerprint(WALK, root=package)
    edit(package, old, new)
    assert code_fingerprint(WALK, root=package) == before


def test_two_constants_of_one_name_cannot_change_places(package):
    before = code_fingerprint(WALK, root=package)
    edit(package, "_SIDE = 2.0", "_SIDE = 0.0")
    edit(package, "_SIDE = 4.0", "_SIDE = 2.0")
    edit(package, "_SIDE = 0.0", "_SIDE = 4.0")
    assert code_fingerprint(WALK, root=package) != before


def test_moving_code_changes_nothing(package):
    before = code_fingerprint(WALK, root=package)
    # A class into a module with other code, which its users import instead; a constant with its users into a new one.
    edit(package, PACKAGE["hdsp/robots.py"], "")
    stranger = package / "hdsp/stranger.py"
    stranger.write_text(f"{stranger.read_text()}\n\n{PACKAGE['hdsp/robots.py']}")
    edit(package, "hdsp.robots", "hdsp.stranger")
    (package / "hdsp/far").mkdir()
    (package / "hdsp/far/__init__.py").touch()
    (package / "hdsp/ground/other.py").rename(package / "hdsp/far/away.py")
    edit(
        package,
        "from hdsp.ground import other, steepest",
        "from hdsp.far import away as other\nfrom hdsp import steepest",
    )
    assert code_fingerprint(WALK, root=package) == before


def test_a_module_imported_by_its_name_counts(package):
    edit(package, "robot.speed()", "importlib.import_module('hdsp.stranger').VALUE")
    before = code_fingerprint(WALK, root=package)
    edit(package, "VALUE = 1", "VALUE = 2")
    assert code_fingerprint(WALK, root=package) != before


def test_an_entry_has_to_be_there(package):
    with pytest.raises(LookupError, match=r"hdsp\.walk:run"):
        code_fingerprint("hdsp.walk:run", root=package)


# The code of this project


@pytest.fixture
def project(tmp_path):
    """A copy of the package."""
    shutil.copytree(ROOT / "hdsp", tmp_path / "hdsp", ignore=shutil.ignore_patterns("__pycache__", "shipped"))
    return tmp_path


def label_hashes(root: Path) -> list[str]:
    return [labels_code(root), patches_code(root), courses_code(root)]


@pytest.mark.parametrize(
    ("old", "new", "concerned"),
    [
        ('amount["white"] * random', 'amount["white"] * 10 * random', [True, False, False]),
        ("chosen = np.flatnonzero(least < limit)", "chosen = np.flatnonzero(least <= limit)", [True, True, True]),
        ("RESOLUTION = 0.025", "RESOLUTION = 0.05", [True, True, True]),
        ("ROTATED_MAP_CELLS = 104", "ROTATED_MAP_CELLS = 106", [True, True, True]),
        ("Status.INVALID_START))", "Status.INFEASIBLE))", [True, False, False]),
        ("index, category = divmod(number", "category, index = divmod(number", [True, False, False]),
        ("_ATTEMPTS = 20_000", "_ATTEMPTS = 20_001", [False, True, False]),
        ("_CLOSEST = 0.4", "_CLOSEST = 0.5", [False, False, True]),
    ],
)
def test_what_decides_labels_is_in_their_hash(project, old, new, concerned):
    edit(project, old, new)
    assert [a != b for a, b in zip(label_hashes(project), label_hashes(ROOT), strict=True)] == concerned


def test_what_decides_no_label_is_in_no_hash_of_labels(project):
    edit(project, "RESOLUTION = 0.025  #", "RESOLUTION = 0.025  # a comment;")
    edit(project, '".h5": _HDF5', '".hf5": _HDF5,\n    ".h5": _HDF5')
    for path in (project / "hdsp/viz").glob("*.py"):
        path.write_text("raise SystemExit\n")
    for path in (project / "hdsp/planning").glob("*.py"):
        path.write_text("raise SystemExit\n")
    moved = edit(project, "def sensed(", "def sensed(")
    moved.rename(moved.with_name("degrading.py"))
    for path in project.rglob("*.py"):
        path.write_text(re.sub(rf"\b{moved.stem}\b", "degrading", path.read_text()))
    assert label_hashes(project) == label_hashes(ROOT)


@pytest.fixture
def called(monkeypatch):
    """Runs a function; returns the package functions that it called, as ``module:name``."""

    def trace(function):
        found: set[str] = set()

        def note(frame, event, _):
            code, module = frame.f_code, frame.f_globals.get("__name__", "")
            if event == "call" and module.startswith("hdsp.") and code.co_filename.startswith(str(ROOT)):
                found.add(f"{module}:{code.co_qualname.split('.<locals>')[0]}")

        sys.setprofile(note)
        try:
            function()
        finally:
            sys.setprofile(None)
        return {name for name in found if "<" not in name}

    return trace


@pytest.mark.parametrize("options", [{"sensing": True}, {"heading_residues": (1,)}, {"standable": False}])
def test_every_function_that_runs_for_a_label_is_in_its_hash(called, options):
    split = SplitSettings(seed=1, maps_per_category=1, categories=("clutter", "staircase", "tiles_mixed"), **options)
    run = LabelRun(split, Robot.load("momaro"), TerrainSettings(), LabelSettings())
    covered = reached_code(LabelRun.tasks_of, LabelRun.task_set)
    run.tasks_of(0)  # modules are loaded and kernels compiled
    ran = called(lambda: run.task_set([0, 1, 2], [run.tasks_of(number) for number in range(3)]))
    assert len(ran) > 30
    assert not missing(ran, covered)


def test_every_function_that_runs_for_a_patch_of_a_scan_is_in_its_hash(called):
    terrain = random_map(1, "cuboid_1", 0, TerrainSettings(), 160)
    arguments = terrain, Robot.load("momaro"), ScanPatchSettings(count=2), LabelSettings(), "a place"
    ran = called(lambda: labelled_patches(*arguments))
    assert not missing(ran, reached_code(labelled_patches))


def missing(ran: set[str], covered: dict[str, list[str]]) -> list[str]:
    """Called functions without a hash, except exempt ones."""
    own = [(name, *name.split(":")) for name in sorted(ran)]
    return [name for name, module, part in own if not is_exempt(module) and part not in covered.get(module, [])]


def test_packages_only_give_names_to_code_below_them():
    """An import of a module then runs no code of the surrounding packages, as fingerprints assume."""
    silent = (ast.Import, ast.ImportFrom, ast.Assign, ast.AnnAssign, ast.FunctionDef, ast.ClassDef)
    for path in [*(ROOT / "hdsp").rglob("__init__.py"), *(ROOT / "pipeline").rglob("__init__.py")]:
        for statement in ast.parse(path.read_text()).body:
            is_docstring = isinstance(statement, ast.Expr) and isinstance(statement.value, ast.Constant)
            is_for_types = isinstance(statement, ast.If) and ast.unparse(statement.test) == "TYPE_CHECKING"
            assert is_docstring or is_for_types or isinstance(statement, silent), f"{path}:{statement.lineno}"


def test_nothing_is_found_by_computed_names_except_networks():
    """Fingerprints follow names in the code; who looks up others has to give them as entries."""
    paths = [*(ROOT / "hdsp").rglob("*.py"), *(ROOT / "pipeline").rglob("*.py")]
    nodes = [(path, node) for path in paths for node in ast.walk(ast.parse(path.read_text()))]
    found = {path.relative_to(ROOT).as_posix() for path, node in nodes if looks_up(node)}
    # A package may import a public name when it is first used.
    lazy = {path for path in found if path.endswith("__init__.py")}
    assert found - lazy == {"hdsp/learning/architectures.py"}


def looks_up(node: ast.AST) -> bool:
    """Whether code finds a module or method by a name that is put together, or registers classes as they are made."""
    if isinstance(node, ast.FunctionDef):
        return node.name == "__init_subclass__"
    if not isinstance(node, ast.Call):
        return False
    called = ast.unparse(node.func).split(".")[-1]
    if called in ("import_module", "__import__", "resolve_name"):
        return not isinstance(node.args[0], ast.Constant)
    if called == "getattr":
        return isinstance(node.args[1], ast.JoinedStr | ast.BinOp | ast.Call)
    return isinstance(node.func, ast.Name) and called in ("globals", "exec", "eval")


def test_exempt_modules_are_there():
    for name in EXEMPT:
        place = ROOT.joinpath(*name.split("."))
        assert place.is_dir() or place.with_suffix(".py").is_file(), name
