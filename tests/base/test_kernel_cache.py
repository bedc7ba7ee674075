"""Kernels in the disk cache: compiled again after exactly the edits that change them."""

import ast
import os
import shutil
import subprocess
import sys
from typing import NamedTuple

import numpy as np
import pytest

from hdsp.base.jit import njit
from hdsp.base.kernel_cache import content_of
from tests import ROOT

#: A kernel that takes a constant by an attribute of a module, one by a name, and a third one through another kernel.
KERNELS = {
    "probe.py": """
from hdsp.base.jit import njit
from hdsp.robot import lattice
from hdsp.robot.lattice import CELLS_PER_ABSTRACT
from hdsp.more import headings


@njit()
def total(number):
    return number * lattice.RESOLUTION + CELLS_PER_ABSTRACT + headings()
""",
    "more.py": """
from hdsp.base.jit import njit
from hdsp.robot.lattice import HEADINGS


@njit()
def headings():
    return HEADINGS


@njit()
def other():
    return 1
""",
}
SCRIPT = """
from hdsp.probe import total
print(total(1000), sum(total.stats.cache_hits.values()))
"""


@pytest.fixture
def run(tmp_path):
    """Runs the kernel in a process of its own: its result, and whether it came from the disk."""
    for name in ("base", "robot"):
        shutil.copytree(ROOT / "hdsp" / name, tmp_path / "hdsp" / name, ignore=shutil.ignore_patterns("__pycache__"))
    (tmp_path / "hdsp/__init__.py").touch()
    for name, text in KERNELS.items():
        (tmp_path / "hdsp" / name).write_text(text)
    environment = {**os.environ, "PYTHONPATH": str(tmp_path), "NUMBA_CACHE_DIR": str(tmp_path / "cache")}

    def start() -> tuple[float, bool]:
        command = [sys.executable, "-c", SCRIPT]
        done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=True)
        value, hits = done.stdout.split()
        return float(value), bool(int(hits))

    return start


def edit(path, old, new):
    text = path.read_text()
    assert text.count(old) == 1
    path.write_text(text.replace(old, new))


def test_a_kernel_is_compiled_again_after_edits_of_what_it_freezes_and_after_no_others(run, tmp_path):
    package = tmp_path / "hdsp"
    assert run() == (93.0, False)
    edit(package / "more.py", "return 1", "return 2")
    edit(package / "probe.py", "@njit()", "# A comment that moves the kernel down.\n@njit()")
    edit(package / "base/files.py", "import os\n", "import os\n\nVALUE = 1\n")
    assert run() == (93.0, True)
    edit(package / "robot/lattice.py", "RESOLUTION = 0.025", "RESOLUTION = 0.05")
    assert run() == (118.0, False)
    edit(package / "robot/lattice.py", "HEADINGS = 64", "HEADINGS = 32")
    assert run() == (86.0, False)


def test_a_damaged_cache_is_compiled_again(run, tmp_path):
    run()
    for path in (tmp_path / "cache").rglob("*.nb?"):
        path.write_bytes(path.read_bytes()[:40])
    assert run() == (93.0, False)


class Sides(NamedTuple):
    length: float
    width: float


TABLE = np.arange(4)
SIDES = Sides(1.0, 2.0)


@njit()
def area(scale):
    """Doubles as a callee."""
    return scale * SIDES.length * SIDES.width


@njit()
def kernel(values):
    """Adds up."""
    return values[TABLE[1]] + area(2.0) + Sides(1.0, 3.0).width


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("TABLE", np.arange(5)),
        ("TABLE", np.array([0, 2, 2, 3])),
        ("TABLE", np.arange(4.0)),
        ("SIDES", Sides(1.0, 2.5)),
        ("Sides", NamedTuple("Sides", [("width", float), ("length", float)])),
        ("area", njit()(lambda scale: scale)),
        ("area", njit(fastmath=True)(area.py_func)),
    ],
)
def test_the_key_covers_values_functions_and_options(monkeypatch, name, value):
    before = content_of(kernel)
    monkeypatch.setitem(globals(), name, value)
    assert content_of(kernel) != before


def test_the_key_is_the_same_without_a_docstring():
    before = content_of(kernel)
    documented = area.py_func.__doc__
    code = area.py_func.__code__
    try:
        area.py_func.__doc__ = "Other words."
        area.py_func.__code__ = code.replace(co_consts=("Other words.", *code.co_consts[1:]), co_firstlineno=1)
        assert content_of(kernel) == before
    finally:
        area.py_func.__doc__, area.py_func.__code__ = documented, code


def test_constants_and_variables_share_a_version_of_a_kernel():
    @njit()
    def more(number, twice):
        return number + (2 if twice else 1)

    @njit()
    def summed(number):
        return more(number, number > 1) + more(3, True) + more(number, twice=False)

    assert summed(10) == 12 + 5 + 11
    assert len(more.overloads) == 1


def test_a_value_without_a_text_of_its_own_is_refused(monkeypatch):
    monkeypatch.setitem(globals(), "TABLE", object())
    with pytest.raises(TypeError, match="no key can hold"):
        content_of(kernel)


def test_all_kernels_of_the_package_have_this_key():
    """Decorators of Numba itself would keep machine code by the time stamp of one file."""
    for path in sorted((ROOT / "hdsp").rglob("*.py")):
        nodes = list(ast.walk(ast.parse(path.read_text())))
        modules = {alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names}
        parts = [node for node in nodes if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("numba")]
        taken = {alias.name for node in parts for alias in node.names}
        if path.name not in ("jit.py", "kernel_cache.py"):
            assert "numba" not in modules, f"{path}: use hdsp.base.jit.njit"
        assert not taken & {"njit", "jit", "vectorize", "guvectorize", "cfunc", "stencil"}, f"{path}: use njit of hdsp"


@pytest.fixture
def read_only(run, tmp_path, monkeypatch):
    """The package of `run` in folders in which nobody keeps machine code, for a user without a home."""
    for folder in {path.parent for path in (tmp_path / "hdsp").rglob("*.py")}:
        (folder / "__pycache__").touch()  # no folder has this name any more; even root cannot write into it
    (tmp_path / "spare").mkdir()
    places = {"HOME": os.devnull, "NUMBA_CACHE_DIR": os.devnull, "TMPDIR": str(tmp_path / "spare")}
    environment = {**os.environ, "PYTHONPATH": str(tmp_path), **places}
    environment.pop("XDG_CACHE_HOME", None)

    def start(script=SCRIPT) -> subprocess.CompletedProcess:
        command = [sys.executable, "-c", script]
        return subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True)

    return start


def test_q5_kernels_of_a_read_only_installation_are_kept_among_the_temporary_files(read_only, tmp_path):
    first, second = read_only(), read_only()
    assert first.stdout.split() == ["93.0", "0"] and second.stdout.split() == ["93.0", "1"]
    (folder,) = (tmp_path / "spare").iterdir()
    assert folder.stat().st_mode & 0o077 == 0
    for done in (first, second):
        warned = [line for line in done.stderr.splitlines() if not line.startswith("compiling the planner")]
        assert done.returncode == 0 and len(warned) == 1 and str(folder) in warned[0]


def test_q5_a_folder_that_others_may_write_is_not_trusted(read_only, tmp_path):
    open_to_all = tmp_path / "spare" / f"hdsp-kernels-{os.getuid()}"
    open_to_all.mkdir(mode=0o777)
    open_to_all.chmod(0o777)
    assert read_only().stdout.split() == ["93.0", "0"]
    assert not list(open_to_all.iterdir())


def test_q5_without_any_folder_each_process_compiles(read_only, tmp_path):
    shutil.rmtree(tmp_path / "spare")
    script = SCRIPT.replace("\nfrom", "\nimport tempfile; tempfile.tempdir = '/dev/null'\nfrom", 1)
    done = read_only(script)
    assert done.stdout.split() == ["93.0", "0"]
    assert [line.partition(";")[0] for line in done.stderr.splitlines()] == [
        "no folder for compiled kernels can be written", "compiling the planner for this machine, once"
    ]  # fmt: skip
