"""Agreement between an abstraction and the detailed planner: the metrics in the paper's Table I.

An abstraction predicts feasibility and cost for each task. A *feasibility* prediction is correct if it equals the
label. *Costs* are compared only over tasks that are feasible according to both. The mean absolute difference is the
cost error; a smaller error means a larger cost similarity (paper, Sec. VI-A).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

import numpy as np

from hdsp.abstract.abstract_costs import TaskPredictor
from hdsp.base.errors import InputError

if TYPE_CHECKING:
    from hdsp.labels.tasks import TaskSet

#: Columns of the table, see `rows`.
COLUMNS = (
    "set", "category", "method", "maps", "tasks", "feasible", "judged_feasible", "both_feasible",
    "feasibility_accuracy", "detailed_cost_mean", "detailed_cost_std", "abstract_cost_mean", "cost_error",
    "planning_cost_error",
)  # fmt: skip


@runtime_checkable
class PlanningPredictor(TaskPredictor, Protocol):
    """Predictor that may know costs for planning (`hdsp.abstract.CostKind`), too.

    Attributes:
        predicts_planning_cost: whether `for_planning` is possible.
    """

    predicts_planning_cost: bool

    def for_planning(self) -> TaskPredictor:
        """Returns a predictor of costs for planning."""
        ...


def evaluate_set(predictors: Mapping[str, TaskPredictor], tasks: TaskSet) -> dict[str, Any]:
    """Computes all metrics for one set of tasks.

    Args:
        predictors: abstractions by method name.
        tasks: labelled tasks; at least one map.

    Returns:
        `maps`, `tasks`, `feasible`, `detailed_cost_mean`, `detailed_cost_std`; `methods`: for each method
        `feasibility_accuracy` in [0, 1] over all tasks; `cost_error` (mean absolute cost difference),
        `abstract_cost_mean` and `compared_cost_mean` (label costs) over the tasks feasible according to both;
        `planning_cost_error`, the same as `cost_error` for costs for planning, None if the tasks lack them or the
        abstraction does not predict them; the counts `judged_feasible` and `both_feasible`; and `categories`: the same
        entries for each category in the set. All values are plain numbers for JSON; a mean over no task is None.

    Raises:
        InputError: if the set is empty, or a prediction has the wrong shape.
    """
    if len(tasks.heights) == 0:
        raise InputError("evaluation: the set has no tasks, need at least one map")
    judged = {
        name: (*predict(predictor, tasks), _planning_costs(predictor, tasks)) for name, predictor in predictors.items()
    }
    everything = np.ones(len(tasks.heights), dtype=bool)
    names = np.array([str(name) for name in tasks.category])
    result = _figures(tasks, judged, everything)
    result["categories"] = {str(name): _figures(tasks, judged, names == name) for name in _in_order(names)}
    return result


def predict(predictor: TaskPredictor, tasks: TaskSet) -> tuple[np.ndarray, np.ndarray]:
    """Predictions `(feasible bool [n, 22], cost float [n, 22])`.

    Raises:
        InputError: if a prediction has the wrong shape, or a task predicted feasible has no finite cost.
    """
    feasible, cost = (np.asarray(answer) for answer in predictor.predict(tasks.heights, tasks.goals))
    expected = np.shape(tasks.feasible)
    if feasible.shape != expected or cost.shape != expected:
        raise InputError(f"predictions have shapes {feasible.shape} and {cost.shape}, expected twice {expected}")
    feasible = feasible.astype(bool)
    if not np.isfinite(cost[feasible]).all():
        raise InputError(f"prediction: {np.sum(~np.isfinite(cost[feasible]))} tasks judged feasible lack a finite cost")
    return feasible, cost


def _planning_costs(predictor: TaskPredictor, tasks: TaskSet) -> np.ndarray | None:
    """Predicted costs for planning, float [n, 22]; None if tasks or predictor have none."""
    if tasks.planning_cost is None or not (
        isinstance(predictor, PlanningPredictor) and predictor.predicts_planning_cost
    ):
        return None
    return predict(predictor.for_planning(), tasks)[1]


def rows(quality: Mapping[str, Mapping[str, Any]]) -> list[dict[str, Any]]:
    """Flat table of the metrics with the columns `COLUMNS`.

    Each set and method has one row for all categories together, then one row for each category.

    Args:
        quality: results of `evaluate_set` by set name; sets without `methods` are left out.
    """
    table = []
    for set_name, figures in quality.items():
        for category, part in {"all": figures, **figures.get("categories", {})}.items():
            for method, values in part.get("methods", {}).items():
                row = {"set": set_name, "category": category, "method": method, **part, **values}
                table.append({column: row[column] for column in COLUMNS})
    return table


def _figures(
    tasks: TaskSet, judged: Mapping[str, tuple[np.ndarray, np.ndarray, np.ndarray | None]], maps: np.ndarray
) -> dict[str, Any]:
    """Metrics for the maps selected by `maps` (bool [n])."""
    feasible, cost = np.asarray(tasks.feasible, bool)[maps], np.asarray(tasks.cost, float)[maps]

    def planning_error(answer: np.ndarray, planning: np.ndarray | None) -> float | None:
        if planning is None or tasks.planning_cost is None:
            return None
        both = feasible & answer[maps]
        return _number(np.abs(planning[maps][both] - tasks.planning_cost[maps][both]), np.mean)

    return {
        "maps": int(maps.sum()),
        "tasks": int(feasible.size),
        "feasible": int(feasible.sum()),
        "detailed_cost_mean": _number(cost[feasible], np.mean),
        "detailed_cost_std": _number(cost[feasible], np.std),
        "methods": {
            name: _agreement(feasible, cost, answer[maps], costs[maps])
            | {"planning_cost_error": planning_error(answer, planning)}
            for name, (answer, costs, planning) in judged.items()
        },
    }


def _agreement(feasible, cost, judged, abstract_cost) -> dict[str, Any]:
    both = feasible & judged
    return {
        "feasibility_accuracy": float(np.mean(judged == feasible)),
        "abstract_cost_mean": _number(abstract_cost[both], np.mean),
        "compared_cost_mean": _number(cost[both], np.mean),
        "cost_error": _number(np.abs(abstract_cost[both] - cost[both]), np.mean),
        "judged_feasible": int(judged.sum()),
        "both_feasible": int(both.sum()),
    }


def _number(values: np.ndarray, statistic) -> float | None:
    return float(statistic(values.astype(float))) if values.size else None


def _in_order(names: np.ndarray) -> list[str]:
    """Distinct names in the order of their first appearance."""
    return list(dict.fromkeys(names.tolist()))
