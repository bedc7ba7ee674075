"""Task networks: their construction, one file per architecture, and shared parts."""

from collections.abc import Callable, Mapping
from typing import Any

from hdsp.base.errors import InputError
from hdsp.base.messages import one_line
from hdsp.base.settings import load_settings
from hdsp.learning.architectures import ARCHITECTURES, network_class
from hdsp.learning.learning_settings import ModelSettings
from hdsp.learning.networks.base import TaskNetwork, count_parameters, initialise_he
from hdsp.robot.lattice import PATCH_CELLS, robot_frame_goals


def build_network(config: Mapping[str, Any] | ModelSettings) -> TaskNetwork:
    """Builds a freshly initialised network, in training mode, from a model configuration (``ModelSettings``).

    Raises:
        InputError: a key, the architecture or an option is unknown, or another package's network breaks the
            contract.
    """
    settings = load_settings(ModelSettings, config, "model")
    options = settings.checked_options()
    architecture: type[Any] = network_class(settings.architecture)
    if not issubclass(architecture, TaskNetwork):
        raise InputError(f"model.architecture: {settings.architecture!r} is {architecture!r}, no TaskNetwork")
    made: Callable[..., TaskNetwork] = architecture
    if settings.architecture in ARCHITECTURES:
        return _initialised(made(settings.encoding, options), settings)
    try:
        network = _initialised(made(settings.encoding, options), settings)
        _check_judgements(network)
    except Exception as error:  # whatever the code of another package raises
        words = f"{type(error).__name__}: {one_line(error)}"
        raise InputError(
            f"model.architecture {settings.architecture!r} breaks the contract of TaskNetwork: {words}"
        ) from error
    return network


def _initialised(network: TaskNetwork, settings: ModelSettings) -> TaskNetwork:
    if settings.initialisation == "he":
        initialise_he(network)
    return network


def _check_judgements(network: TaskNetwork) -> None:
    """Evaluates two tasks on flat ground; a fault shows before hours of training."""
    import torch

    if not any(parameter.requires_grad for parameter in network.parameters()):
        raise ValueError("the network has no parameters to train")
    heights = torch.zeros(2, 1, PATCH_CELLS, PATCH_CELLS)
    goals = torch.from_numpy(robot_frame_goals(0).astype("float32")).expand(2, -1, -1)
    with torch.no_grad(), torch.random.fork_rng(devices=[]):
        found = network(heights, goals)
    wanted = 3 if network.predicts_planning_cost else 2
    shapes = [tuple(each.shape) for each in found]
    if shapes != [tuple(goals.shape[:2])] * wanted:
        raise ValueError(
            f"forward returns shapes {shapes}; need {wanted} of [batch, goals], here {tuple(goals.shape[:2])}"
        )


__all__ = ["ARCHITECTURES", "ModelSettings", "TaskNetwork", "build_network", "count_parameters"]
