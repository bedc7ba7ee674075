"""View of MLflow's run table with the results of trainings: metrics as columns, the best run first.

The table has no metrics unless a view asks for them. A view is a tag of the experiment; MLflow's page lists it under
"Views" and opens it by its address.
"""

from __future__ import annotations

import base64
import json
import time
import zlib
from typing import Any

VIEW = "results"
VIEW_TAG = f"mlflow.sharedViewState.{VIEW}"
#: Place of the view on MLflow's page, for the first experiment of a database.
ADDRESS = f"#/experiments/1/runs?viewStateShareKey={VIEW}&workflowType=machine_learning"
#: Widths of the columns in pixels; the first ones are MLflow's own.
_OWN = {"attributes.`Run Name`": 260, "runDateAndNestInfo": 150, "duration": 80}
_METRICS = {
    "best/score": 105,
    "best/feasibility_accuracy/val": 205,
    "best/cost_error/val": 145,
    "best_epoch": 100,
    "parameters": 105,
    "seconds": 95,
}


def show_results(mlflow: Any, experiment: Any) -> None:
    """Adds the view to an experiment without one; a view that users changed stays."""
    if VIEW_TAG not in experiment.tags:
        client = mlflow.MlflowClient()
        client.set_experiment_tag(experiment.experiment_id, VIEW_TAG, _view())
        # Some versions of MLflow open the page of an experiment by its kind, and else as one of language models.
        client.set_experiment_tag(experiment.experiment_id, "mlflow.experimentKind", "custom_model_development")


def _view() -> str:
    """The view as MLflow's page saves it."""
    metrics = {f"metrics.`{name}`": width for name, width in _METRICS.items()}
    widths = _OWN | metrics
    state = {
        "orderByKey": next(iter(metrics)),
        "orderByAsc": True,
        "selectedColumns": list(metrics),
        "columnOrder": list(widths),
        "columnWidths": widths,
    }
    packed = base64.b64encode(zlib.compress(json.dumps(state).encode())).decode()
    now = round(1000 * time.time())
    return json.dumps({"name": VIEW, "createdAt": now, "updatedAt": now, "state": f"deflate;{packed}"})
