"""Network architectures by name. The first use of an architecture imports its module.

A new architecture needs a ``TaskNetwork`` with its options class, and ``conf/model/NAME.yaml``. In this package, a line
in ``ARCHITECTURES`` gives it a name; in another package, an entry point ``hdsp.networks`` does. Without one, its name
is ``module:class``.
"""

from dataclasses import is_dataclass
from pkgutil import resolve_name
from typing import Any

from hdsp.base.errors import InputError
from hdsp.base.extensions import NETWORKS, extension_place, extensions, load_extension
from hdsp.base.settings import fault

#: name -> ``module:class`` of the network
ARCHITECTURES = {
    "klamt2019": "hdsp.learning.networks.klamt2019:Klamt2019",
    "compact": "hdsp.learning.networks.compact:Compact",
    "swept": "hdsp.learning.networks.swept:Swept",
    "dilated": "hdsp.learning.networks.dilated:Dilated",
    "goalmap": "hdsp.learning.networks.goalmap:GoalMap",
    "table": "hdsp.learning.networks.table:Table",
    "footprint": "hdsp.learning.networks.footprint:Footprint",
}


def architecture_place(name: str) -> str:
    """Returns ``module:class`` for an architecture's network.

    Raises:
        InputError: the architecture is unknown.
    """
    place = ARCHITECTURES.get(name) or extension_place(NETWORKS, name)
    if place is None:
        raise InputError(f"model.architecture: {name!r} is not one of {', '.join(architectures())}")
    return place


def architectures() -> tuple[str, ...]:
    """Returns the names of all architectures, also those of other packages."""
    return (*ARCHITECTURES, *sorted(extensions(NETWORKS).keys() - ARCHITECTURES.keys()))


def known_architecture(name: str) -> str:
    """Validator for settings: a name in ``architectures``, or ``module:class``."""
    if name not in ARCHITECTURES and extension_place(NETWORKS, name) is None:
        raise fault("", name, f"one of {', '.join(architectures())}, or module:class")
    return name


def network_class(name: str) -> type[Any]:
    """Returns an architecture's network class, a ``TaskNetwork``, made from an encoding and options.

    Raises:
        InputError: the architecture is unknown, or no class with options.
    """
    if name in ARCHITECTURES:
        return resolve_name(architecture_place(name))
    found = load_extension(NETWORKS, name)
    if not (isinstance(found, type) and is_dataclass(getattr(found, "Options", None))):
        raise InputError(
            f"model.architecture: {name!r} is {found!r}; need a TaskNetwork with its class Options, a dataclass"
        )
    return found
