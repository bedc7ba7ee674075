"""Task networks: their construction, one file per architecture, and shared parts."""

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

from hdsp.learning.architectures import ARCHITECTURES, network_class
from hdsp.learning.encoding import HeightEncoding
from hdsp.learning.network_settings import settings_from
from hdsp.learning.networks.base import TaskNetwork, count_parameters, initialise_he


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
        return settings_from(network_class(self.architecture).Options, self.options, "model.options")


def build_network(config: Mapping[str, Any] | ModelSettings) -> TaskNetwork:
    """Builds a freshly initialised network, in training mode, from a model configuration (``ModelSettings``).

    Raises:
        InputError: a key, the architecture or an option is unknown.
    """
    settings = settings_from(ModelSettings, config, "model")
    options = settings.checked_options()
    network = network_class(settings.architecture)(settings.encoding, options)  # type: ignore[call-arg]
    if settings.initialisation == "he":
        initialise_he(network)
    network.settings = settings
    return network


__all__ = ["ARCHITECTURES", "ModelSettings", "TaskNetwork", "build_network", "count_parameters"]
