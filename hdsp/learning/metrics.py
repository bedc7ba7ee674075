"""Abstraction metrics: the paper's two figures, and the sums behind them."""

import torch
from torch import Tensor

from hdsp.learning.calibration import MINIMUM_COST as MINIMUM_COST
from hdsp.learning.processes import summed


class TaskMetrics:
    """Sums over batches; ``compute`` returns the metrics for all tasks since ``reset``.

    The network judges a task feasible at a probability above one half. Costs are compared over tasks that labels and
    network judge feasible (paper, Sec. VI-A).
    """

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        self.tasks = self.correct = self.both_feasible = 0
        self.detailed_cost = self.abstract_cost = self.error = 0.0
        self.planning_error: float | None = None

    def update(
        self,
        cost: Tensor,
        logits: Tensor,
        feasible: Tensor,
        labelled_cost: Tensor,
        planning: tuple[Tensor, Tensor] | None = None,
    ) -> None:
        """Adds tasks: predicted costs, feasibility logits, and their labels; all tensors have one shape.

        ``planning`` holds predicted and true costs for planning; all tasks since ``reset`` have them, or none.
        """
        judged = logits > 0
        both = judged & feasible
        if planning is not None:
            # A cost for planning never exceeds the label cost.
            found = torch.minimum(planning[0], cost)[both].double().clamp_min(MINIMUM_COST)
            true = planning[1][both].double()
            self.planning_error = (self.planning_error or 0.0) + float((found - true).abs().sum())
        self.tasks += feasible.numel()
        self.correct += int((judged == feasible).sum())
        self.both_feasible += int(both.sum())
        ours, theirs = cost[both].double().clamp_min(MINIMUM_COST), labelled_cost[both].double()
        self.detailed_cost += float(theirs.sum())
        self.abstract_cost += float(ours.sum())
        self.error += float((ours - theirs).abs().sum())

    def compute(self) -> dict[str, float]:
        """Returns the metrics.

        Keys are ``feasibility_accuracy`` in [0, 1]; ``cost_error``, ``detailed_cost`` and ``abstract_cost``, which are
        means over tasks that labels and network judge feasible (NaN without any); the counts ``tasks`` and
        ``both_feasible``; and ``planning_cost_error``, the same mean as ``cost_error`` for costs for planning, if the
        tasks have them.
        """
        own = [self.tasks, self.correct, self.both_feasible, self.detailed_cost, self.abstract_cost, self.error]
        sums = summed(torch.tensor([*own, self.planning_error or 0.0], dtype=torch.float64)).tolist()
        tasks, correct, both_feasible, detailed_cost, abstract_cost, error, planning_error = sums
        compared = both_feasible or float("nan")
        planning = {} if self.planning_error is None else {"planning_cost_error": planning_error / compared}
        return {
            "feasibility_accuracy": correct / tasks if tasks else float("nan"),
            "cost_error": error / compared,
            "detailed_cost": detailed_cost / compared,
            "abstract_cost": abstract_cost / compared,
            "tasks": tasks,
            "both_feasible": both_feasible,
            **planning,
        }


def combined_score(feasibility_accuracy: float, cost_error: float) -> float:
    """Share of wrong feasibility plus mean cost error; lower is better.

    Both terms are a few hundredths for a good network. A network that judges nothing feasible has no cost error (NaN),
    and its score is infinite.
    """
    score = (1 - feasibility_accuracy) + cost_error
    return score if score == score else float("inf")


def task_losses(cost: Tensor, logits: Tensor, feasible: Tensor, labelled_cost: Tensor) -> tuple[Tensor, Tensor]:
    """Returns the paper's losses: feasibility BCE over all tasks, cost L1 over feasible tasks (0 without any)."""
    feasibility = torch.nn.functional.binary_cross_entropy_with_logits(logits, feasible.to(logits.dtype))
    return feasibility, cost_loss(cost, labelled_cost, feasible)


def cost_loss(cost: Tensor, labelled_cost: Tensor, feasible: Tensor) -> Tensor:
    """Returns the mean absolute error over feasible tasks, 0 without any; all arguments have one shape."""
    error = (cost - labelled_cost).abs() * feasible
    return error.sum() / feasible.sum().clamp_min(1)
