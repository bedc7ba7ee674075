"""The package as it is installed."""

import tomllib

from tests import ROOT


def test_every_file_of_the_package_goes_into_the_wheel():
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["package-data"]["hdsp"]
    package = ROOT / "hdsp"
    files = {path for path in package.rglob("*") if path.is_file() and "__pycache__" not in path.parts}
    taken = {path for pattern in settings for path in package.glob(pattern)}
    assert {path for path in files if path.suffix != ".py"} == taken
    assert all((path.parent / "__init__.py").is_file() for path in files if path.suffix == ".py")
