"""Learned abstractions: task data, networks, training, pretrained models, costs of whole maps.

Importing this package imports torch; ``hdsp`` itself does not. Lightning is imported with what trains: to use a trained
abstraction it need not be there.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from hdsp.learning.costs import LearnedCosts
from hdsp.learning.data import TaskStream, task_loader
from hdsp.learning.encoding import HeightEncoding
from hdsp.learning.hardware import HardwareSettings
from hdsp.learning.networks import ARCHITECTURES, ModelSettings, TaskNetwork, build_network, count_parameters
from hdsp.learning.pretrained import LearnedAbstraction, Provenance, example_input

if TYPE_CHECKING:
    from hdsp.learning.callbacks import PlateauLossWeights, PublishedLossWeights
    from hdsp.learning.module import AbstractionModule
    from hdsp.learning.training import TrainingConfig, TrainResult, train

__all__ = [
    "ARCHITECTURES",
    "AbstractionModule",
    "HardwareSettings",
    "HeightEncoding",
    "LearnedAbstraction",
    "LearnedCosts",
    "ModelSettings",
    "PlateauLossWeights",
    "Provenance",
    "PublishedLossWeights",
    "TaskNetwork",
    "TaskStream",
    "TrainResult",
    "TrainingConfig",
    "build_network",
    "count_parameters",
    "example_input",
    "task_loader",
    "train",
]

#: What needs Lightning, and the module that it is in.
_TRAINING = {
    "AbstractionModule": "module",
    "PlateauLossWeights": "callbacks",
    "PublishedLossWeights": "callbacks",
    "TrainResult": "training",
    "TrainingConfig": "training",
    "train": "training",
}


def __getattr__(name: str) -> Any:
    if name not in _TRAINING:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_TRAINING[name]}"), name)
