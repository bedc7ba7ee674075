"""Calibration: against textbook code, on data with known truth, and as part of an abstraction."""

import math
from itertools import pairwise

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from hdsp.base.errors import InputError
from hdsp.base.settings import load_settings
from hdsp.learning import HardwareSettings, LearnedAbstraction, LearnedCosts, ModelSettings, build_network
from hdsp.learning.calibration import (
    Calibration,
    calibration_figures,
    conformal_quantile,
    fit_calibration,
    fit_temperature,
    reliability,
)
from tests.learning.synthetic import TINY_MODEL, synthetic_tasks

EXACT = HardwareSettings(accelerator="cpu", precision="32")
TASKS = st.lists(st.tuples(st.floats(0, 1), st.booleans()), min_size=1, max_size=60)


def naive_error(tasks, bins):
    """The expected calibration error by its definition, bin by bin."""
    error = 0.0
    for k in range(bins):
        inside = [(p, y) for p, y in tasks if k <= p * bins < k + 1 or (k == bins - 1 and p == 1)]
        if inside:
            confidence = sum(p for p, _ in inside) / len(inside)
            accuracy = sum(y for _, y in inside) / len(inside)
            error += len(inside) / len(tasks) * abs(accuracy - confidence)
    return error


def naive_quantile(residuals, level):
    """The order statistic by counting."""
    n = len(residuals)
    for bound in sorted(residuals):
        below = sum(r <= bound for r in residuals)
        if level <= 0.5 and (below + 1) / (n + 1) > level + 1e-12 and below / (n + 1) <= level + 1e-12:
            return bound
        if level > 0.5 and below / (n + 1) >= level - 1e-12:
            return bound
    return -math.inf if level <= 0.5 else math.inf


@given(TASKS, st.integers(1, 20))
def test_the_calibration_error_is_that_of_the_textbook(tasks, bins):
    probability, feasible = (np.array(column) for column in zip(*tasks, strict=True))
    found = reliability(probability, feasible, bins)
    assert found.error == pytest.approx(naive_error(tasks, bins), abs=1e-9)
    assert found.tasks.sum() == len(tasks)


@given(TASKS, st.integers(1, 20))
def test_adaptive_bins_hold_equally_many_tasks_in_the_order_of_probability(tasks, bins):
    probability, feasible = (np.array(column) for column in zip(*tasks, strict=True))
    found = reliability(probability, feasible, bins, adaptive=True)
    assert found.tasks.max() - found.tasks.min() <= 1
    assert (np.diff(found.predicted) >= -1e-12).all()
    assert found.tasks @ found.observed == pytest.approx(feasible.sum())


def test_who_always_tells_the_truth_has_no_error_and_who_is_too_sure_has():
    rng = np.random.default_rng(0)
    probability = rng.uniform(size=200_000)
    feasible = rng.uniform(size=probability.size) < probability
    assert reliability(probability, feasible).error < 0.005
    assert reliability(probability, feasible, adaptive=True).error < 0.005
    assert reliability(np.where(probability > 0.5, 1.0, 0.0), feasible).error == pytest.approx(0.25, abs=0.01)
    assert math.isnan(reliability([], []).error)


@pytest.mark.parametrize("temperature", [0.4, 1.0, 3.0])
def test_the_temperature_of_logits_is_found(temperature):
    rng = np.random.default_rng(1)
    true_logits = rng.normal(0, 2, 50_000)
    feasible = rng.uniform(size=true_logits.size) < 1 / (1 + np.exp(-true_logits))
    found = fit_temperature(true_logits * temperature, feasible)
    assert found == pytest.approx(temperature, rel=0.05)


@given(
    st.lists(st.floats(-1, 1), min_size=0, max_size=40, unique=True),
    st.sampled_from([0.01, 0.05, 0.1, 0.25, 0.5, 0.75, 0.9, 0.95, 0.99]),
)
def test_the_conformal_quantile_is_the_order_statistic_of_the_textbook(residuals, level):
    assert conformal_quantile(np.array(residuals), level) == naive_quantile(residuals, level)


@settings(deadline=None, max_examples=10)
@given(st.sampled_from([0.05, 0.1, 0.9, 0.95]), st.integers(0, 1000))
def test_conformal_bounds_cover_as_they_promise(level, seed):
    rng = np.random.default_rng(seed)
    covered = []
    for _ in range(400):  # the guarantee is a mean over random calibration sets
        residuals = rng.exponential(size=60) - 0.5
        covered.append((rng.exponential(size=200) - 0.5 <= conformal_quantile(residuals, level)).mean())
    promised = math.floor(level * 61 + 1e-9) / 61 if level < 0.5 else math.ceil(level * 61 - 1e-9) / 61
    assert np.mean(covered) == pytest.approx(promised, abs=0.01)


def noisy_costs(seed, n=20_000):
    """Tasks with errors that grow with the cost relative to flat ground."""
    rng = np.random.default_rng(seed)
    flat = rng.uniform(0.1, 0.6, n)
    cost = flat * rng.choice([1.0, 1.2, 1.6, 2.5], n) * rng.uniform(0.98, 1.02, n)
    labelled = cost * (1 + rng.normal(0, 0.005 + 0.1 * (cost / flat - 0.9)))
    feasible = rng.uniform(size=n) < 0.8
    return np.where(feasible, 4.0, -4.0), cost, flat, feasible, np.where(feasible, labelled, 0.0)


def test_cost_quantiles_cover_each_kind_of_task_on_data_that_was_not_fitted_to():
    calibration = fit_calibration(*noisy_costs(0))
    logits, cost, flat, feasible, labelled = noisy_costs(1)
    for level in (0.05, 0.5, 0.95):
        below = labelled <= calibration.at_level(level, cost, flat)
        for kind in (cost / flat < 1.1, (cost / flat > 1.5) & (cost / flat < 1.7), cost / flat > 2):
            assert below[feasible & kind].mean() == pytest.approx(level, abs=0.025)
    lower, upper = (calibration.at_level(level, cost, flat) for level in (0.05, 0.95))
    width = (upper - lower) / cost
    assert np.median(width[cost / flat > 2]) > 5 * np.median(width[cost / flat < 1.1])
    figures = calibration_figures(1 / (1 + np.exp(-logits)), feasible, {0.05: lower}, labelled, logits > 0)
    assert figures["cost_coverage"]["0.05"] == pytest.approx(0.05, abs=0.01)
    assert figures["ece"] == pytest.approx(1 - 1 / (1 + math.exp(-4)), abs=1e-6)


def test_levels_that_there_are_too_few_tasks_for_are_left_out_and_asking_for_one_names_the_rest():
    calibration = fit_calibration(*(array[:40] for array in noisy_costs(0)))
    assert 0.01 not in calibration.cost_quantiles and 0.5 in calibration.cost_quantiles
    with pytest.raises(InputError, match=r"quantile 0.01 is not known of this model; known are .*0.5"):
        calibration.at_level(0.01, np.ones(1), np.ones(1))
    with pytest.raises(InputError, match="none: the model is not calibrated"):
        Calibration().factors(0.05)


def test_a_calibration_survives_json_and_a_damaged_one_is_named():
    calibration = fit_calibration(*noisy_costs(0))
    assert Calibration.from_dict(calibration.to_dict()) == calibration
    for damage in ({"temperature": 0.0}, {"excess": [1.0]}, {"cost_quantiles": {"0.5": [math.nan]}}, {"tasks": None}):
        with pytest.raises(InputError, match="calibration"):
            Calibration.from_dict({**calibration.to_dict(), **damage})


@pytest.mark.parametrize(
    ("probability", "feasible", "reason"),
    [([0.5], [True, False], "1 probabilities for 2 labels"), ([1.5], [True], "outside"), ([math.nan], [True], "outsi")],
)
def test_what_is_no_probability_is_named(probability, feasible, reason):
    with pytest.raises(InputError, match=reason):
        reliability(np.array(probability), np.array(feasible))


@pytest.fixture(scope="module")
def abstraction():
    torch.manual_seed(0)
    model = load_settings(ModelSettings, TINY_MODEL, "model")
    network = build_network(model)
    with torch.no_grad():
        network.heads.bias.copy_(torch.tensor([0.4, 0.0]))
    return LearnedAbstraction(network, model, hardware=EXACT)


def test_calibrating_changes_probabilities_but_no_judgement_and_no_cost(abstraction):
    tasks = synthetic_tasks(60)
    calibrated = abstraction.calibrated(tasks)
    assert calibrated.calibration.temperature != 1.0
    before, after = (a.predict(tasks.heights, tasks.goals) for a in (abstraction, calibrated))
    assert np.array_equal(before[0], after[0]) and np.array_equal(before[1], after[1])
    probability, _ = calibrated.predict_probability(tasks.heights, tasks.goals)
    assert np.array_equal(probability > 0.5, before[0])
    assert not np.allclose(probability, abstraction.predict_probability(tasks.heights, tasks.goals)[0])
    loss = [
        -np.log(np.where(tasks.feasible, p, 1 - p)).mean()
        for p in (abstraction.predict_probability(tasks.heights, tasks.goals)[0], probability)
    ]
    assert loss[1] < loss[0]


def test_costs_at_quantiles_rise_with_the_level_and_reach_the_edges_of_maps(abstraction):
    from hdsp import HeightMap

    tasks = synthetic_tasks(60)
    calibrated = abstraction.calibrated(tasks)
    terrain = HeightMap.flat((24, 24))
    edges = [LearnedCosts(calibrated, quantile=level).edges(terrain) for level in (0.05, 0.5, 0.95)]
    open_edges = np.isfinite(edges[0])
    assert open_edges.any()
    for low, high in pairwise(edges):
        assert np.array_equal(np.isfinite(low), np.isfinite(high))
        assert (low[open_edges] <= high[open_edges]).all()
    plain = LearnedCosts(calibrated).edges(terrain)[open_edges]
    goals = np.broadcast_to(tasks.goals[:1], (1, 22, 3))
    np.testing.assert_allclose(
        calibrated.flat_costs(goals)[0], calibrated.predict(np.zeros((1, 72, 72), np.float32), goals)[1][0], rtol=1e-5
    )
    assert (edges[0][open_edges] != plain).any()
    with pytest.raises(InputError, match=r"quantile 0\.05 is not known"):
        LearnedCosts(abstraction, quantile=0.05)


def test_the_calibration_is_saved_with_the_model_and_older_models_go_without(abstraction, tmp_path):
    import json

    tasks = synthetic_tasks(60)
    calibrated = abstraction.calibrated(tasks)
    folder = calibrated.save_pretrained(tmp_path / "model", picture=False)
    read = LearnedAbstraction.from_pretrained(folder, hardware=EXACT)
    assert read.calibration == calibrated.calibration
    config = json.loads((folder / "config.json").read_text())
    del config["calibration"], config["precision"], config["config_sha256"]  # older ones have no checksum
    (folder / "config.json").write_text(json.dumps(config))
    assert LearnedAbstraction.from_pretrained(folder).calibration == Calibration()
