"""Learned abstractions: task data, networks, training, pretrained models, costs of whole maps.

Importing this package imports torch; ``hdsp`` itself does not.
"""

from hdsp.learning.callbacks import PlateauLossWeights, PublishedLossWeights
from hdsp.learning.costs import LearnedCosts
from hdsp.learning.data import TaskStream, task_loader
from hdsp.learning.encoding import HeightEncoding
from hdsp.learning.hardware import HardwareSettings
from hdsp.learning.module import AbstractionModule
from hdsp.learning.networks import ARCHITECTURES, ModelSettings, TaskNetwork, build_network, count_parameters
from hdsp.learning.pretrained import LearnedAbstraction, Provenance, example_input
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
