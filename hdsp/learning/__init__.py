"""Learned abstractions: task data, networks, training, saved models, costs for whole maps.

- `architectures`, `networks`: table of the networks, and the networks; `network_conformance`: a checker for own ones
- `learning_settings`: settings of models, training and hardware; `hardware`: devices and precision
- `encoding`: heights as network input; `task_data`, `task_stream`: batches from memory, from shards
- `training`, `module`, `callbacks`, `history`, `metrics`: a training with Lightning, weights of its losses, its record
- `abstraction`, `saved_abstraction`, `calibration`: a trained network that judges tasks, its folder, its corrections
- `inference`, `torch_evaluation`: evaluation without torch, with torch; `footprint_geometry`: values for both
- `learned_costs`, `rotated_maps`: abstract costs of a whole map
- `loading`, `shipped`: the abstractions that come with the package; `hub`, `hub_card`: others on the Hugging Face hub
- `onnx_export`: an abstraction as an ONNX model

Importing this package loads neither torch nor Lightning; the first use of a name loads its module.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hdsp.learning.abstraction import LearnedAbstraction
    from hdsp.learning.architectures import ARCHITECTURES
    from hdsp.learning.callbacks import PlateauLossWeights, PublishedLossWeights
    from hdsp.learning.learned_costs import LearnedCosts
    from hdsp.learning.learning_settings import HardwareSettings, HeightEncoding, ModelSettings, TrainingConfig
    from hdsp.learning.module import AbstractionModule
    from hdsp.learning.network_conformance import check_network
    from hdsp.learning.networks import TaskNetwork, build_network, count_parameters
    from hdsp.learning.onnx_export import export_onnx
    from hdsp.learning.saved_abstraction import Provenance
    from hdsp.learning.task_data import task_loader
    from hdsp.learning.task_stream import TaskStream
    from hdsp.learning.training import TrainResult, train

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
    "check_network",
    "count_parameters",
    "export_onnx",
    "task_loader",
    "train",
]

#: The module of each public name.
_MODULES = {
    "ARCHITECTURES": "architectures",
    "AbstractionModule": "module",
    "HardwareSettings": "learning_settings",
    "HeightEncoding": "learning_settings",
    "LearnedAbstraction": "abstraction",
    "LearnedCosts": "learned_costs",
    "ModelSettings": "learning_settings",
    "PlateauLossWeights": "callbacks",
    "Provenance": "saved_abstraction",
    "PublishedLossWeights": "callbacks",
    "TaskNetwork": "networks",
    "TaskStream": "task_stream",
    "TrainResult": "training",
    "TrainingConfig": "learning_settings",
    "build_network": "networks",
    "check_network": "network_conformance",
    "count_parameters": "networks",
    "export_onnx": "onnx_export",
    "task_loader": "task_data",
    "train": "training",
}


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
