"""Learned abstraction as an MLflow model: `mlflow.pyfunc.load_model(uri).predict({"heights": ..., "goals": ...})`.

MLflow logs the model from code: it runs this file on loading, and says so; the network comes from its safetensors. No
pickle. A model from strangers is loaded by `hdsp.load_abstraction` from its folder ``artifacts/abstraction``, which
runs nothing of it.
"""

from __future__ import annotations

import warnings
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from hdsp.labels.shards import TaskSet

NAME = "abstraction"


def log(mlflow: Any, abstraction_dir: Path, tasks: TaskSet, register: str | None = None) -> str:
    """Logs the abstraction with its signature to the current run; returns the logged model's number.

    Args:
        mlflow: the module, inside a run.
        abstraction_dir: folder with `config.json` and `model.safetensors`.
        tasks: any labelled maps; one serves as the input example.
        register: name in MLflow's registry, NAME or NAME@ALIAS; None = it is not registered.
    """
    from hdsp.learning.abstraction import LearnedAbstraction

    example = {"heights": tasks.heights[:1], "goals": tasks.goals[:1]}
    abstraction = LearnedAbstraction.from_pretrained(abstraction_dir)
    predictions = predict(abstraction, example)
    name, _, alias = (register or "").partition("@")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # asks for an input example; the signature suffices
        info = mlflow.pyfunc.log_model(
            name=NAME,
            python_model=str(Path(__file__)),
            artifacts={NAME: str(abstraction_dir)},
            signature=mlflow.models.infer_signature(example, predictions),
            # Without a list, MLflow starts a process to find the requirements.
            pip_requirements=requirements(abstraction.model.architecture),
            registered_model_name=name or None,
        )
    if alias:
        mlflow.MlflowClient().set_registered_model_alias(name, alias, info.registered_model_version)
    return info.model_id


def requirements(architecture: str) -> list[str]:
    """Returns the packages behind a network: this one with its extra for networks, and the architecture's own."""
    from hdsp.base.extensions import distribution_of
    from hdsp.learning.architectures import architecture_place

    own = distribution_of(architecture_place(architecture))
    names = ["hdsp", *([own] if own not in (None, "hdsp") else [])]
    return [*(f"{name}=={found}" if (found := _version(name)) else name for name in names), "torch", "safetensors"]


def _version(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def predict(abstraction: Any, inputs: dict[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Predicts feasibility and cost.

    Args:
        abstraction: learned abstraction.
        inputs: `heights` float32 [n, 72, 72] (m, NaN = unknown) and `goals` float32 [n, 22, 3] (abstract steps, robot
            frame).

    Returns:
        `feasible` bool [n, 22] and `cost` float32 [n, 22].
    """
    feasible, cost = abstraction.predict(np.asarray(inputs["heights"]), np.asarray(inputs["goals"]))
    return {"feasible": feasible, "cost": cost}


class _Judge:
    """Methods for the served model.

    It is not itself a `PythonModel`, because MLflow wraps the methods of a `PythonModel` with type hint checks; here
    the signature checks inputs.
    """

    def load_context(self, context):
        from hdsp.learning import LearnedAbstraction

        self.abstraction = LearnedAbstraction.from_pretrained(context.artifacts[NAME])

    def predict(self, context, model_input, params=None):
        return predict(self.abstraction, model_input)


def _define() -> None:
    import mlflow

    warnings.warn(
        "this MLflow model runs code from its folder; hdsp.load_abstraction of its artifacts runs none", stacklevel=2
    )
    mlflow.models.set_model(type("Served", (_Judge, mlflow.pyfunc.PythonModel), {})())


if __name__.rpartition(".")[2] not in ("served_model", "__main__"):  # MLflow runs this file under its own name
    _define()
