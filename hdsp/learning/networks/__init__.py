"""Task networks: their construction, one file per architecture, and shared parts."""

from collections.abc import Mapping
from typing import Any

from hdsp.base.errors import InputError
from hdsp.base.settings import load_settings
from hdsp.learning.architectures import ARCHITECTURES, network_class
from hdsp.learning.learning_settings import ModelSettings
from hdsp.learning.networks.base import TaskNetwork, count_parameters, initialise_he


def build_network(config: Mapping[str, Any] | ModelSettings) -> TaskNetwork:
    """Builds a freshly initialised network, in training mode, from a model configuration (``ModelSettings``).

    Raises:
        InputError: a key, the architecture or an option is unknown.
    """
    settings = load_settings(ModelSettings, config, "model")
    options = settings.checked_options()
    architecture: type[Any] = network_class(settings.architecture)
    if not issubclass(architecture, TaskNetwork):
        raise InputError(f"model.architecture: {settings.architecture!r} is {architecture!r}, no TaskNetwork")
    network: TaskNetwork = network_class(settings.architecture)(settings.encoding, options)
    if settings.initialisation == "he":
        initialise_he(network)
    return network


__all__ = ["ARCHITECTURES", "ModelSettings", "TaskNetwork", "build_network", "count_parameters"]
