"""Network architectures by name.

A new architecture needs a file beside this one with a ``TaskNetwork`` and its options dataclass, one line in
``ARCHITECTURES``, and ``conf/model/NAME.yaml``.
"""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

from hdsp.base.errors import InputError
from hdsp.learning.encoding import HeightEncoding
from hdsp.learning.network_settings import settings_from
from hdsp.learning.networks.base import TaskNetwork, count_parameters, initialise_he
from hdsp.learning.networks.compact import Compact, CompactOptions
from hdsp.learning.networks.dilated import Dilated, DilatedOptions
from hdsp.learning.networks.footprint import Footprint, FootprintOptions
from hdsp.learning.networks.goalmap import GoalMap, GoalMapOptions
from hdsp.learning.networks.klamt2019 import Klamt2019, Klamt2019Options
from hdsp.learning.networks.swept import Swept, SweptOptions
from hdsp.learning.networks.table import Table, TableOptions

#: name -> (network class, dataclass of its options)
ARCHITECTURES: dict[str, tuple[type[TaskNetwork], type]] = {
    "klamt2019": (Klamt2019, Klamt2019Options),
    "compact": (Compact, CompactOptions),
    "swept": (Swept, SweptOptions),
    "dilated": (Dilated, DilatedOptions),
    "goalmap": (GoalMap, GoalMapOptions),
    "table": (Table, TableOptions),
    "footprint": (Footprint, FootprintOptions),
}


@dataclass(frozen=True)
class ModelSettings:
    """Model settings, as in ``conf/model/*.yaml``.

    Attributes:
        architecture: key in ``ARCHITECTURES``.
        initialisation: ``he``, or ``default`` for PyTorch's.
        encoding: height encoding.
        options: architecture options; missing keys keep their defaults.
    """

    architecture: str = "klamt2019"
    initialisation: Literal["he", "default"] = "he"
    encoding: HeightEncoding = field(default_factory=HeightEncoding)
    options: dict[str, Any] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        """Returns a plain mapping for ``build_network``, with all defaults written out."""
        options = asdict(self.checked_options())
        return {
            "architecture": self.architecture,
            "initialisation": self.initialisation,
            "encoding": self.encoding.to_dict(),
            "options": {key: list(value) if isinstance(value, tuple) else value for key, value in options.items()},
        }

    def checked_options(self):
        """Returns the options as the architecture's dataclass.

        Raises:
            InputError: the architecture or an option is unknown.
        """
        if self.architecture not in ARCHITECTURES:
            raise InputError(f"model.architecture: {self.architecture!r} is not one of {', '.join(ARCHITECTURES)}")
        return settings_from(ARCHITECTURES[self.architecture][1], self.options, "model.options")


def build_network(config: Mapping[str, Any] | ModelSettings) -> TaskNetwork:
    """Builds a freshly initialised network, in training mode, from a model configuration (``ModelSettings``).

    Raises:
        InputError: a key, the architecture or an option is unknown.
    """
    settings = settings_from(ModelSettings, config, "model")
    options = settings.checked_options()
    network = ARCHITECTURES[settings.architecture][0](settings.encoding, options)
    if settings.initialisation == "he":
        initialise_he(network)
    network.settings = settings
    return network


__all__ = ["ARCHITECTURES", "ModelSettings", "TaskNetwork", "build_network", "count_parameters"]
