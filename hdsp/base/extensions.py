"""Networks, heuristics and terrain categories of other packages: found by entry points, or by ``module:name``.

A package announces them in its ``pyproject.toml``. Every process with this package then finds them by name::

    [project.entry-points."hdsp.networks"]
    mine = "my_package.network:MyNetwork"
"""

import importlib.metadata
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from hdsp.base.errors import InputError
from hdsp.base.messages import one_line

#: Groups of entry points.
NETWORKS, HEURISTICS, TERRAIN = "hdsp.networks", "hdsp.heuristics", "hdsp.terrain"


@cache
def extensions(group: str) -> dict[str, str]:
    """Returns ``module:name`` of all entry points in a group, by their names."""
    return {point.name: point.value for point in entry_points(group=group)}


def extension_place(group: str, name: str) -> str | None:
    """Returns ``module:name`` behind a name; None if no package announces it.

    ``module:name`` itself is also a name.
    """
    if name in (found := extensions(group)):
        return found[name]
    module, _, attribute = name.partition(":")
    parts = [*module.split("."), *attribute.split(".")]
    return name if attribute and all(part.isidentifier() for part in parts) else None


def load_extension(group: str, name: str) -> Any:
    """Imports the object behind a name.

    Raises:
        InputError: no package announces the name, or its import fails.
    """
    place = extension_place(group, name)
    if place is None:
        known = ", ".join(extensions(group)) or "none"
        raise InputError(f"{group} {name!r}: not announced by any installed package ({known}), and no module:name")
    try:
        return EntryPoint(name, place, group).load()
    except Exception as error:  # whatever the code of another package raises
        kind = "" if isinstance(error, ImportError | AttributeError) else f"{type(error).__name__}: "
        raise InputError(f"{group} {name!r}: cannot load {place}: {kind}{one_line(error)}") from error


def distribution_of(place: str) -> str | None:
    """Returns the installed distribution that contains the module of ``module:name``; None if there is none."""
    top = place.partition(":")[0].partition(".")[0]
    found = importlib.metadata.packages_distributions().get(top)
    return found[0] if found else None
