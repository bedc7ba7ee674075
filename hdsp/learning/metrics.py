"""How good an abstraction is: the two numbers of the paper, with what stands behind them."""

import torch
from torch import Tensor

#: Lower bound on predicted costs, for use and for metrics. A network may predict zero or less; a search needs positive
#: edges.
MINIMUM_COST = 1e-3


class TaskMetrics:
    """Sums over batches; ``compute`` gives the metrics of all tasks seen since ``reset``.

    A task is judged feasible at a probability above one half. Costs are compared over the tasks that both the labels
    and the network judge feasible (paper, Sec. VI-A).
    """

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        self.tasks = self.correct = self.both_feasible = 0
        self.detailed_cost = self.abstract_cost = self.error = 0.0

    def update(self, cost: Tensor, logits: Tensor, feasible: Tensor, labelled_cost: Tensor) -> None:
        """Adds tasks; all arguments have one shape: predicted cost, feasibility logits, and their labels."""
        judged = logits > 0
        both = judged & feasible
        self.tasks += feasible.numel()
        self.correct += int((judged == feasible).sum())
        self.both_feasible += int(both.sum())
        ours, theirs = cost[both].double().clamp_min(MINIMUM_COST), labelled_cost[both].double()
        self.detailed_cost += float(theirs.sum())
        self.abstract_cost += float(ours.sum())
        self.error += float((ours - theirs).abs().sum())

    def compute(self) -> dict[str, float]:
        """``feasibility_accuracy`` in [0, 1]; ``cost_error``, ``detailed_cost``, ``abstract_cost``: means over the
        tasks both judge feasible, NaN if there are none; counts ``tasks`` and ``both_feasible``."""
        compared = self.both_feasible or float("nan")
        return {
            "feasibility_accuracy": self.correct / self.tasks if self.tasks else float("nan"),
            "cost_error": self.error / compared,
            "detailed_cost": self.detailed_cost / compared,
            "abstract_cost": self.abstract_cost / compared,
            "tasks": float(self.tasks),
            "both_feasible": float(self.both_feasible),
        }


def combined_score(feasibility_accuracy: float, cost_error: float) -> float:
    """Share of wrong feasibility plus mean cost error, lower is better; both are a few hundredths for a good network.

    A network that judges nothing feasible has no cost error (NaN) and scores infinitely bad.
    """
    score = (1 - feasibility_accuracy) + cost_error
    return score if score == score else float("inf")


def task_losses(cost: Tensor, logits: Tensor, feasible: Tensor, labelled_cost: Tensor) -> tuple[Tensor, Tensor]:
    """The two losses of the paper: BCE of feasibility over all tasks, L1 of cost over the feasible ones (0 without
    any)."""
    feasibility = torch.nn.functional.binary_cross_entropy_with_logits(logits, feasible.to(logits.dtype))
    error = (cost - labelled_cost).abs() * feasible
    return feasibility, error.sum() / feasible.sum().clamp_min(1)
