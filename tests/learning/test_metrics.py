"""The paper's two metrics, and the two losses."""

import math

import numpy as np
import pytest
import torch

from hdsp.learning.metrics import TaskMetrics, combined_score, task_losses


@pytest.fixture
def judged():
    random = np.random.default_rng(0)
    cost, labelled = random.random((2, 30, 22))
    return {
        "cost": torch.tensor(cost),
        "logits": torch.tensor(random.normal(size=(30, 22))),
        "feasible": torch.tensor(random.random((30, 22)) < 0.6),
        "labelled_cost": torch.tensor(labelled),
    }


def test_metrics_equal_a_loop_over_tasks(judged):
    metrics = TaskMetrics()
    for part in (slice(0, 7), slice(7, 30)):
        metrics.update(**{name: values[part] for name, values in judged.items()})
    correct, errors = 0, []
    for cost, logit, feasible, labelled in zip(*(values.flatten().tolist() for values in judged.values()), strict=True):
        says_feasible = 1 / (1 + math.exp(-logit)) > 0.5
        correct += says_feasible == feasible
        if says_feasible and feasible:
            errors.append(abs(cost - labelled))
    found = metrics.compute()
    assert found["feasibility_accuracy"] == correct / 660
    assert found["cost_error"] == pytest.approx(np.mean(errors))
    assert found["both_feasible"] == len(errors)


def test_reset_forgets(judged):
    metrics = TaskMetrics()
    metrics.update(**judged)
    metrics.reset()
    assert metrics.compute()["tasks"] == 0


def test_a_network_that_finds_nothing_feasible_never_wins():
    assert combined_score(0.9, math.nan) == math.inf
    assert combined_score(0.95, 0.03) == pytest.approx(0.08)


def test_cost_loss_ignores_infeasible_tasks(judged):
    _, loss = task_losses(**judged)
    wrong = judged | {"labelled_cost": judged["labelled_cost"] + 100 * ~judged["feasible"]}
    assert task_losses(**wrong)[1] == loss
    feasible = judged["feasible"]
    assert float(loss) == pytest.approx(float((judged["cost"] - judged["labelled_cost"])[feasible].abs().mean()))


def test_cost_loss_without_feasible_tasks_is_zero(judged):
    assert task_losses(**judged | {"feasible": torch.zeros(30, 22, dtype=torch.bool)})[1] == 0
