import ast
import importlib
import json
import subprocess
import sys

import pytest

from tests import ROOT

HEAVY = ["torch", "lightning", "mlflow", "mujoco", "matplotlib", "dask", "distributed", "h5py", "viser", "trimesh"]

#: Packages that list public names. The networks are PyTorch modules and load it.
FACES = sorted(
    ".".join(path.parent.relative_to(ROOT).parts)
    for path in (ROOT / "hdsp").rglob("__init__.py")
    if "__all__" in path.read_text()
)
LIGHT = [face for face in FACES if face != "hdsp.learning.networks"]

#: Prints the heavy packages that imports load, and the CPU seconds of `import hdsp`.
PROBE = """
import importlib, json, sys, time
before = time.process_time()
import hdsp
seconds = time.process_time() - before
for name in {others}:
    importlib.import_module(name)
print(json.dumps([[name for name in {heavy} if name in sys.modules], seconds]))
"""


def probe(others=()):
    code = PROBE.format(others=list(others), heavy=HEAVY)
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=120)
    return json.loads(answer.stdout)


def test_importing_the_package_is_quick_and_brings_nothing_heavy():
    runs = [probe() for _ in range(4)]
    assert [loaded for loaded, _ in runs] == [[]] * 4
    assert min(seconds for _, seconds in runs) < 1.0  # CPU time does not depend on other processes


def test_importing_all_packages_brings_nothing_heavy():
    assert probe(LIGHT)[0] == []


def test_the_public_names_are_there():
    import hdsp

    assert {"HeightMap", "Planner", "Plan", "Robot", "InputError", "Status"} <= set(hdsp.__all__)
    assert {"hdsp.base", "hdsp.robot", "hdsp.terrain", "hdsp.abstract", "hdsp.labels", "hdsp.learning", "hdsp.viz"} <= {
        *FACES
    }


@pytest.mark.parametrize("name", FACES)
def test_each_package_has_the_names_that_it_lists(name):
    face = importlib.import_module(name)
    assert [public for public in face.__all__ if not hasattr(face, public)] == []
    assert len(set(face.__all__)) == len(face.__all__)
    assert set(getattr(face, "_MODULES", face.__all__)) == set(face.__all__)
    with pytest.raises(AttributeError):
        face.no_such_name  # noqa: B018
    # A name that a module of the package has too would be the one or the other, depending on what was imported before.
    modules = {path.stem for path in (ROOT / name.replace(".", "/")).glob("*.py")}
    assert modules & set(face.__all__) == set()


@pytest.mark.parametrize("name", [name for name in LIGHT if name != "hdsp"])
def test_a_package_takes_its_names_from_its_own_modules(name):
    path = ROOT / name.replace(".", "/") / "__init__.py"
    nodes = [node for node in ast.walk(ast.parse(path.read_text())) if isinstance(node, ast.ImportFrom)]
    own = [node.module for node in nodes if node.module.startswith("hdsp")]
    assert own and all(module.startswith(f"{name}.") for module in own)
