"""The command `hdsp lab`: a package for own networks, terrain, heuristics, losses, metrics and callbacks."""

from __future__ import annotations

import argparse
import importlib.util
import keyword
import os
import sys
from importlib import resources
from pathlib import Path
from string import Template

from hdsp.base.errors import InputError
from hdsp.learning.architectures import ARCHITECTURES

#: Files of the package, by template.
FILES = {
    "pyproject.toml.tmpl": "pyproject.toml",
    "learning.py.tmpl": "{name}/learning.py",
    "planning.py.tmpl": "{name}/planning.py",
    "test.py.tmpl": "tests/test_{name}.py",
    "config.yaml.tmpl": "conf/{name}.yaml",
    "model.yaml.tmpl": "conf/model/{name}.yaml",
    "dvc.yaml.tmpl": "dvc.yaml",
    "dvc_config.tmpl": ".dvc/config",
    "dvcignore.tmpl": ".dvcignore",
    "gitignore.tmpl": ".gitignore",
    "Makefile.tmpl": "Makefile",
    "README.md.tmpl": "README.md",
}
#: Names that would hide a package.
_TAKEN = ("hdsp", "hdsp_pipeline", "pipeline", "torch", "numpy", "conf", "tests", "data", "models")

#: Names that the planner gives to its own heuristics.
_HEURISTICS = ("geometric", "grid", "manual", "learned", "oracle")


def add_lab(commands) -> None:
    """Adds the command `lab`."""
    parser = commands.add_parser("lab", help="write a package for own networks and terrain", description=_lab.__doc__)
    parser.add_argument("name", help="name of the package, a Python identifier in small letters")
    parser.add_argument("--folder", help="new folder for the package (default: the name)")
    parser.set_defaults(run=_lab)


def _lab(chosen: argparse.Namespace) -> None:
    """Writes a package outside this one: a network, terrain, a heuristic, a loss, a metric, a test, make repro."""
    folder = write_lab(chosen.name, Path(chosen.folder or chosen.name))
    print(f"{folder}: pip install -e {folder}; then make test, make repro there")


def write_lab(name: str, folder: Path) -> Path:
    """Writes the package; returns its folder.

    Args:
        name: its name.
        folder: a folder that is new or empty.

    Raises:
        InputError: a wrong name, a folder with files in it, or one that cannot be written.
    """
    if not name.isidentifier() or name != name.lower() or keyword.iskeyword(name) or name in _TAKEN:
        raise InputError(f"name {name!r}: need a Python identifier in small letters, none of {', '.join(_TAKEN)}")
    found = importlib.util.find_spec(name)
    if name in sys.stdlib_module_names or (found is not None and found.origin is not None):
        raise InputError(f"name {name!r}: there is a package of this name, which the new one would hide")
    if name in ARCHITECTURES or name in _HEURISTICS:
        raise InputError(f"name {name!r}: hdsp has a network or heuristic of this name, which would count instead")
    try:
        if os.path.exists(folder) and (not folder.is_dir() or any(folder.iterdir())):
            raise InputError(f"{folder}: it exists and is not empty")
        _write_files(name, folder)
    except OSError as error:
        raise InputError(f"cannot write {folder}: {error.strerror}") from error
    return folder


def _write_files(name: str, folder: Path) -> None:
    kind = "".join(part.capitalize() for part in name.split("_"))
    templates = resources.files(__package__).joinpath("lab_template")
    for template, place in FILES.items():
        path = folder / place.format(name=name)
        path.parent.mkdir(parents=True, exist_ok=True)
        text = Template(templates.joinpath(template).read_text(encoding="utf-8"))
        path.write_text(text.substitute(name=name, kind=kind), encoding="utf-8")
    folder.joinpath(name, "__init__.py").write_text("", encoding="utf-8")
