"""API reference: pages in docs/api/ with the public names of each package, written before each build.

A public name is a name in ``__all__``. The pages of ``hdsp`` show one name each. The page of each further package shows
all of its names, and links to the place of those that an earlier package already shows.
"""

from __future__ import annotations

import ast
import inspect
import re
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

from sphinx.application import Sphinx
from sphinx.pycode import ModuleAnalyzer

#: Packages in the order of the reference; the first one that has a name shows it.
PACKAGES = (
    "hdsp", "hdsp.planning", "hdsp.terrain", "hdsp.terrain.pointcloud", "hdsp.terrain.simulation", "hdsp.robot",
    "hdsp.detailed", "hdsp.abstract", "hdsp.labels", "hdsp.learning", "hdsp.viz", "hdsp.base",
)  # fmt: skip
#: A field for several names, as napoleon writes it.
_SHARED = re.compile(r"^:(?:ivar|param) \w+(?:, \w+)+:")
LONGEST_VALUE = 60  # characters of the value of a constant


class PublicName(NamedTuple):
    """A public name.

    Attributes:
        place: package and name, as a user imports it.
        home: the module that defines it.
        value: the object.
        shown: place at which the reference shows it; equal to ``place``, or in an earlier package.
    """

    place: str
    home: str
    value: Any
    shown: str

    @property
    def directive(self) -> str:
        if inspect.isclass(self.value):
            return "autoexception" if issubclass(self.value, BaseException) else "autoclass"
        return "autofunction" if callable(self.value) else "data"


def public_names() -> dict[str, list[PublicName]]:
    """Public names of each package."""
    first: dict[tuple[str, str], str] = {}
    found = {}
    for package in PACKAGES:
        module, homes = import_module(package), _homes(package)
        found[package] = []
        for name in module.__all__:
            value, place = getattr(module, name), f"{package}.{name}"
            home = homes.get(name, package)
            shown = first.setdefault((getattr(value, "__module__", home), name), place)
            found[package].append(PublicName(place, home, value, shown))
    return found


def _homes(package: str) -> dict[str, str]:
    """Module behind each name that a package imports, also for type checkers alone."""
    tree = ast.parse(inspect.getsource(import_module(package)))
    imports = [node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) and node.module]
    return {alias.asname or alias.name: node.module or "" for node in imports for alias in node.names}


def write_pages(folder: Path) -> None:
    """Writes the pages of all packages into a folder; equal pages stay as they are, other files go."""
    pages = {"index": _index()}
    for package, names in public_names().items():
        own = [name for name in names if name.shown == name.place]
        if package == "hdsp":
            pages |= {name.place: _single(name) for name in own}
        pages[package] = _page(package, names, own)
    folder.mkdir(parents=True, exist_ok=True)
    for old in set(folder.glob("*.rst")) - {folder / f"{page}.rst" for page in pages}:
        old.unlink()
    for page, lines in pages.items():
        path, text = folder / f"{page}.rst", "\n".join(lines)
        if not path.is_file() or path.read_text() != text:
            path.write_text(text)


def _single(name: PublicName) -> Iterator[str]:
    yield from _title(name.place)
    yield from _entry(name)


def _index() -> Iterator[str]:
    """Table of the packages, each with the first sentence of its docstring."""
    yield from _title("API reference")
    yield from ("The library is `import hdsp`. Each further package is below it, and lists its public names.", "")
    yield from (".. list-table::", "   :widths: 25 75", "")
    for package in PACKAGES:
        sentence = inspect.getdoc(import_module(package)).partition("\n\n")[0].replace("\n", " ")
        yield from (f"   * - :doc:`{package}`", f"     - {sentence}")
    yield from ("", ".. toctree::", "   :hidden:", "", *(f"   {package}" for package in PACKAGES), "")


def _page(package: str, names: list[PublicName], own: list[PublicName]) -> Iterator[str]:
    yield from _title(package)
    yield from (f".. automodule:: {package}", "   :no-members:", "")
    yield from (".. autosummary::", "   :nosignatures:", "")
    # Names of the page's own package stand without it: Sphinx adds it.
    yield from (f"   {name.shown.removeprefix(package + '.')}" for name in names if name.directive != "data")
    yield ""
    if package == "hdsp":
        yield from (".. toctree::", "   :hidden:", "", *(f"   {name.place}" for name in own))
        return
    for name in own:
        yield from _entry(name)


def _title(text: str) -> Iterator[str]:
    yield from (text, "=" * len(text), "")


def _entry(name: PublicName) -> Iterator[str]:
    if name.directive != "data":
        yield f".. {name.directive}:: {name.place}"
        bases = getattr(name.value, "__bases__", ())
        if any(base.__module__.startswith("hdsp") for base in bases):
            yield "   :show-inheritance:"
        yield ""
        return
    comments = ModuleAnalyzer.for_module(name.home).find_attr_docs().get(("", name.place.rpartition(".")[2]), [])
    value = repr(name.value)
    yield f".. py:data:: {name.place}"
    if len(value) <= LONGEST_VALUE:
        yield f"   :value: {value}"
    yield from ("", *(f"   {line}" for line in comments), "")


def skip_member(_app, _what: str, _name: str, value: Any, skip: bool, _options) -> bool | None:
    """Leaves out fields of named tuples, which the docstring of their class describes."""
    described = (getattr(value, "__doc__", None) or "").startswith("Alias for field number")
    return True if described else None


def shared_descriptions(_app, _what, _name, _value, _options, lines: list[str]) -> None:
    """Keeps names with one description together: Sphinx takes words before the last one for a type."""
    for number, line in enumerate(lines):
        lines[number] = _SHARED.sub(lambda found: found[0].replace(", ", ","), line)


def readable_signature(_app, _what, _name, _value, _options, signature: str | None, returned: str | None):
    """Leaves the checks of settings out of signatures: the type alone of ``Annotated[type, checks]``."""
    return tuple(text and _without_checks(text) for text in (signature, returned))


def _without_checks(text: str) -> str:
    """Text without the second and further arguments of each ``Annotated``."""
    before, found, rest = text.partition("Annotated[")
    if not found:
        return text
    depth, first = 0, None
    for place, letter in enumerate(rest):
        if letter == "," and depth == 0 and first is None:
            first = place
        if letter == "]" and depth == 0:
            return before.removesuffix("~typing.") + _without_checks(rest[:first]) + _without_checks(rest[place + 1 :])
        depth += (letter in "[({") - (letter in "])}")
    return text


def setup(app: Sphinx) -> dict[str, bool]:
    app.connect("builder-inited", lambda app: write_pages(Path(app.srcdir) / "api"))
    app.connect("autodoc-skip-member", skip_member)
    app.connect("autodoc-process-docstring", shared_descriptions, priority=900)  # after napoleon
    app.connect("autodoc-process-signature", readable_signature)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
