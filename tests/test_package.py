"""The package as it is installed."""

import ast
import tomllib

from tests import ROOT


def test_every_file_of_the_package_goes_into_the_wheel():
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["package-data"]["hdsp"]
    package = ROOT / "hdsp"
    files = {path for path in package.rglob("*") if path.is_file() and "__pycache__" not in path.parts}
    taken = {path for pattern in settings for path in package.glob(pattern)}
    assert {path for path in files if path.suffix != ".py"} == taken
    assert all((path.parent / "__init__.py").is_file() for path in files if path.suffix == ".py")


def test_the_pipeline_names_its_own_modules_relatively():
    """It is `pipeline` in a checkout and `hdsp_pipeline` where it is installed."""
    for path in (ROOT / "pipeline").glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            names = [node.module or ""] if isinstance(node, ast.ImportFrom) and not node.level else []
            names += [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            assert not [name for name in names if name.partition(".")[0] == "pipeline"], f"{path}:{node.lineno}"


def test_the_installed_pipeline_brings_its_configuration_and_data():
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["package-data"]
    for package, folder in (("hdsp_pipeline", ROOT / "pipeline"), ("hdsp_pipeline.conf", ROOT / "conf")):
        taken = {path for pattern in settings[package] for path in folder.glob(pattern)}
        files = {path for path in folder.rglob("*") if path.is_file() and path.suffix not in (".py", ".pyc")}
        assert {path for path in files if "__pycache__" not in path.parts} <= taken
        assert package != "hdsp_pipeline.conf" or folder / "robot/momaro.yaml" in taken  # behind a link
