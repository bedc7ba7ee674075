"""Network architectures by name. The first use of an architecture imports its module.

A new architecture needs a file in ``hdsp/learning/networks`` with a ``TaskNetwork`` and its options dataclass, one line
in ``ARCHITECTURES``, and ``conf/model/NAME.yaml``.
"""

from pkgutil import resolve_name
from typing import Any

from hdsp.base.errors import InputError

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
    if name not in ARCHITECTURES:
        raise InputError(f"model.architecture: {name!r} is not one of {', '.join(ARCHITECTURES)}")
    return ARCHITECTURES[name]


def network_class(name: str) -> type[Any]:
    """Returns an architecture's network class, a ``TaskNetwork``, made from an encoding and options.

    Raises:
        InputError: the architecture is unknown.
    """
    return resolve_name(architecture_place(name))
