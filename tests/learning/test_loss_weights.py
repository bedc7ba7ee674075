"""Rules for loss weights against slow, simple simulations."""

from itertools import pairwise

import numpy as np
import pytest

from hdsp.base.errors import InputError
from hdsp.learning.callbacks import LOSSES, PlateauLossWeights, PublishedLossWeights


def plateau_cuts(losses, patience):
    """Epochs at which the paper's rule cuts.

    The rule cuts if no value of the last ``patience`` epochs is below all earlier values. It counts epochs from the
    previous cut.
    """
    cuts, since = [], 0
    for now in range(len(losses)):
        window = range(max(since, now - patience + 1), now + 1)
        improved = [t for t in window if t == 0 or losses[t] < min(losses[:t])]
        if len(window) == patience and not improved:
            cuts.append(now)
            since = now + 1
    return cuts


def published_cuts(feasibility, cost, patience):
    """Epochs at which the published script's rule cuts each weight.

    Histories are plain lists, which the rule clears like the script.
    """
    histories, cuts = {"feasibility": [], "cost": []}, {"feasibility": [], "cost": []}
    for now, values in enumerate(zip(feasibility, cost, strict=True)):
        to_cut = []
        for name, value in zip(LOSSES, values, strict=True):
            histories[name].append(value)
            recent = histories[name][-(patience + 1) :]
            if len(recent) == patience + 1 and all(a < b for a, b in pairwise(recent)):
                to_cut.append(name)
                cuts[name].append(now)
        for name in to_cut:
            histories[name] = []
        if "feasibility" in to_cut:
            histories["cost"] = []
    return cuts


def run(rule, feasibility, cost):
    cuts = {name: [] for name in LOSSES}
    for now, values in enumerate(zip(feasibility, cost, strict=True)):
        for name in rule.losses_to_cut(dict(zip(LOSSES, values, strict=True))):
            cuts[name].append(now)
    return cuts


def random_losses(seed):
    random = np.random.default_rng(seed)
    # Few distinct values give ties.
    return (np.round(20 * (random.random((2, 120)) + 1 / np.arange(1, 121))) / 20).tolist()


def test_plateau_cuts_after_three_epochs_without_improvement():
    losses = [1.0, 0.9, 0.95, 0.92, 0.91, 0.8, 0.9, 0.9]
    assert run(PlateauLossWeights(patience=3), losses, losses[::-1])["feasibility"] == [4]


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("patience", [1, 2, 3])
def test_plateau_equals_its_simulation(seed, patience):
    feasibility, cost = random_losses(seed)
    cuts = run(PlateauLossWeights(patience=patience), feasibility, cost)
    assert cuts == {"feasibility": plateau_cuts(feasibility, patience), "cost": plateau_cuts(cost, patience)}
    assert cuts["cost"]


def test_published_rule_cuts_after_two_rises():
    assert run(PublishedLossWeights(), [1, 2, 3, 4, 5, 6], [6, 5, 4, 3, 2, 1])["feasibility"] == [2, 5]


def test_published_rule_forgets_the_cost_history_with_a_cut_of_feasibility():
    # The cost would have risen twice at epoch 3, but the feasibility cut at epoch 2 clears its history.
    cuts = run(PublishedLossWeights(), [1, 2, 3, 1, 1, 1], [5, 4, 5, 6, 7, 8])
    assert cuts == {"feasibility": [2], "cost": [5]}


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("patience", [1, 2, 3])
def test_published_rule_equals_its_simulation(seed, patience):
    feasibility, cost = random_losses(seed)
    cuts = run(PublishedLossWeights(patience=patience), feasibility, cost)
    assert cuts == published_cuts(feasibility, cost, patience)
    assert patience > 2 or (cuts["feasibility"] and cuts["cost"])  # four rising values are too rare to count on


@pytest.mark.parametrize("rule", [PlateauLossWeights, PublishedLossWeights])
def test_the_history_survives_a_resume(rule):
    feasibility, cost = random_losses(7)
    first, second = rule(patience=2), rule(patience=2)
    before = run(first, feasibility[:31], cost[:31])
    second.load_state_dict(first.state_dict())
    after = run(second, feasibility[31:], cost[31:])
    whole = run(rule(patience=2), feasibility, cost)
    assert {name: before[name] + [t + 31 for t in after[name]] for name in LOSSES} == whole


@pytest.mark.parametrize("faulty", [{"factor": 1.0}, {"patience": 0}])
def test_rules_without_effect_are_refused(faulty):
    with pytest.raises(InputError, match=next(iter(faulty))):
        PlateauLossWeights(**faulty)
