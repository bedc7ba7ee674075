"""The evaluation of the footprint network without torch, against the network in torch."""

import pickle
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import torch
from safetensors.numpy import load_file

import hdsp
from hdsp.base.errors import InputError
from hdsp.learning import HardwareSettings, LearnedAbstraction, LearnedCosts
from hdsp.learning.inference import cell_layer
from hdsp.learning.inference.dense_layers import LARGEST_WEIGHT, Graph
from hdsp.learning.inference.footprint_engine import FootprintEngine, engine_options
from hdsp.learning.inference.footprint_layers import _shapes as shapes
from hdsp.learning.loading import shipped
from hdsp.robot.lattice import PATCH_CENTER, robot_frame_goals
from hdsp.terrain.height_map import HeightMap
from hdsp.terrain.scenes import random_map
from tests import ROOT
from tests.learning.test_zoo import model_file, rough_patches

#: How Momaro's feet move.
WAYS = model_file("footprint")["options"]["foot_ways"]

#: Plans with the shipped abstraction in a process without torch.
PROBE = """
import sys
sys.modules["torch"] = sys.modules["lightning"] = None
import hdsp
terrain = hdsp.HeightMap.flat((60, 60))
plan = hdsp.Planner(terrain, heuristic="learned").plan((0.7, 0.7, 0.0), (0.9, 0.8, 0.0), weight=1.5)
print(plan.solved, plan.stats["heuristic"])
try:
    hdsp.load_abstraction("momaro-klamt2019")
except hdsp.InputError as error:
    print(error)
"""


@pytest.fixture(scope="module")
def abstraction():
    """In float32."""
    return hdsp.load_abstraction("momaro", hardware=HardwareSettings(precision="32"))


@pytest.fixture(scope="module")
def with_codes():
    """The default: the largest layer computes with codes of 8 bits."""
    return hdsp.load_abstraction("momaro")


@pytest.fixture(scope="module")
def in_torch(abstraction):
    """The same network, evaluated by torch."""
    other = LearnedAbstraction(
        abstraction.network, abstraction.model, hardware=HardwareSettings("cpu"), calibration=abstraction.calibration
    )
    other.provenance = abstraction.provenance
    return other


def ground(category: str, seed: int) -> HeightMap:
    """A random map of 2.5 x 2.25 m with steps, slopes and unknown cells."""
    heights = random_map(seed, category, 0, cells=100).heights[:, :90].copy()
    heights += np.linspace(0, 0.3, 100, dtype=np.float32)[:, None] * (seed % 2)
    heights[np.random.default_rng(seed).random(heights.shape) < 0.0005] = np.nan
    heights[:9, 70:] = np.nan
    return HeightMap(heights)


def some_states(headings: list[int], share: float) -> np.ndarray:
    mask = np.zeros((16, 25, 22), bool)
    mask[headings] = np.random.default_rng(0).random((len(headings), 25, 22)) < share
    return mask


@pytest.mark.parametrize("category", ["staircase", "clutter", "ramp_mixed"])
def test_edges_are_those_of_the_network_in_torch(abstraction, in_torch, category):
    terrain = ground(category, 1000 + len(category))
    mask = some_states([4, 9], 1.0)
    found = LearnedCosts(abstraction).edges(terrain, mask=mask)
    expected = LearnedCosts(in_torch).edges(terrain, mask=mask)
    finite = np.isfinite(expected)
    assert finite.sum() > 200
    np.testing.assert_array_equal(np.isfinite(found), finite)
    np.testing.assert_allclose(found[finite], expected[finite], atol=1e-4)


def test_patches_are_judged_as_by_the_network_in_torch(abstraction, in_torch):
    patches = rough_patches(5)
    patches[1, 36, 36], patches[2, 40:44, 50:60] = np.nan, np.nan
    goals = np.stack([robot_frame_goals(k) for k in (0, 3, 3, 9, 0)])
    for found, expected in zip(
        abstraction.predict_probability(patches, goals), in_torch.predict_probability(patches, goals), strict=True
    ):
        np.testing.assert_allclose(found, expected, atol=1e-4)


def test_codes_change_few_decisions_and_costs_little(abstraction, with_codes):
    different, errors = [], []
    for seed, category in enumerate(("staircase", "clutter", "ramp_mixed", "tiles_mixed", "wall_2"), 1000):
        terrain = ground(category, seed)
        found, expected = (
            LearnedCosts(which).edges(terrain, mask=some_states([2, 8, 11], 1.0))[[2, 8, 11]]
            for which in (with_codes, abstraction)
        )
        both = np.isfinite(found) & np.isfinite(expected)
        different.append(np.isfinite(found) != np.isfinite(expected))
        errors.append(abs(found[both] / expected[both] - 1))
    assert len(np.concatenate(errors)) > 10_000
    assert np.mean(different) < 1e-3
    assert 0 < np.concatenate(errors).mean() < 2e-3


def test_sums_of_products_with_codes_are_exact_at_their_extremes():
    """Processors without instructions for products of 8 bits add pairs in 16 bits: larger weights would exceed them."""
    random = np.random.default_rng(0)
    weight = random.integers(-LARGEST_WEIGHT, LARGEST_WEIGHT + 1, (2016, 96)).astype(np.float32)
    weight[:, :2] = LARGEST_WEIGHT, -LARGEST_WEIGHT
    weight[0] = LARGEST_WEIGHT
    rows = random.integers(0, 256, (7, 2016)).astype(np.uint8)
    rows[:2] = 255
    graph = Graph([], "result", ["rows"])
    graph.product("rows", "result", weight, code=1.0)
    (found,) = graph.session().run(None, {"rows": rows})
    np.testing.assert_array_equal(found, rows.astype(np.int64) @ weight.astype(np.int64))


@pytest.mark.parametrize("which", ["abstraction", "with_codes"])
def test_a_state_has_the_same_costs_in_any_window_to_the_last_bit(which, request):
    terrain, costs = ground("clutter", 1001), LearnedCosts(request.getfixturevalue(which))
    mask = some_states([0, 1, 7], 1.0)
    whole = costs.edges(terrain, mask=mask)
    assert np.isfinite(whole[mask]).mean() > 0.05
    few = mask & (np.random.default_rng(1).random(mask.shape) < 0.02)
    np.testing.assert_array_equal(costs.edges(terrain, mask=few)[few], whole[few])
    region = (4, 6, 13, 9)
    np.testing.assert_array_equal(costs.edges(terrain, region, mask[:, 4:13, 6:9]), whole[:, 4:13, 6:9])
    (one,) = np.argwhere(few)[:1]
    alone = costs.edges(terrain, (one[1], one[2], one[1] + 1, one[2] + 1))
    np.testing.assert_array_equal(alone[one[0], 0, 0], whole[tuple(one)])


def test_windows_of_a_map_are_judged_as_patches(with_codes):
    terrain, mask = ground("staircase", 1002), some_states(list(range(16)), 0.01)
    found = LearnedCosts(with_codes).edges(terrain, mask=mask)[mask]
    expected = LearnedCosts(with_codes, method="patches").edges(terrain, mask=mask)[mask]
    assert np.isfinite(expected).any()
    np.testing.assert_array_equal(found, expected)


def test_a_network_with_other_widths_and_channels(tmp_path):
    settings = model_file("footprint")
    settings["encoding"] |= {"channels": ["edge", "height", "unknown", "unevenness"], "unevenness_contact": 2}
    settings["encoding"] |= {"scale": 0.9, "clip": [-0.2, 0.4]}
    settings["options"] |= {
        "planning": True,
        "width": 12,
        "dilations": [2, 1],
        "hidden": 24,
        "features": 17,
        "head": 12,
    }
    torch.manual_seed(1)
    network = hdsp.learning.build_network(settings)
    with torch.no_grad():
        network.goal_cost[-1].bias += 2  # no cost is at its lower bound
    in_torch = LearnedAbstraction(network, _model(settings))
    folder = in_torch.save_pretrained(tmp_path / "model", picture=False)
    patches, goals = rough_patches(3), robot_frame_goals(5)
    patches[0, 30:33, 20:50] = np.nan
    for precision, tolerance in (("32", 1e-4), ("auto", 1e-2)):
        found = LearnedAbstraction.from_pretrained(folder, hardware=HardwareSettings(precision=precision))
        assert found.engine is not None and in_torch.engine is None
        for ours, theirs in zip(found._predict(patches, goals), in_torch._predict(patches, goals), strict=True):
            assert np.std(theirs) > 1e-3
            np.testing.assert_allclose(ours, theirs, atol=tolerance)


@pytest.mark.parametrize(
    ("ways", "stance", "encoding"),
    [
        ({}, {}, {}),
        ({"reach": [-0.1, 0.25], "max_height": 0.1}, {"edge": 0.1}, {"unevenness_contact": 0}),
        (
            {"max_length": 0.0},
            {"neutral": [0.19, 0.15], "contact_inward": 0.03},
            {"unevenness_contact": 3, "unevenness_radius": 9},
        ),
    ],
)
def test_the_feets_ways_as_in_torch(ways, stance, encoding, tmp_path):
    settings = model_file("footprint")
    settings["encoding"] |= encoding
    options = settings["options"]
    options |= {
        "foot_ways": WAYS | ways,
        "stance": options["stance"] | stance,
        "hidden": 16,
        "head": 16,
        "steps": 16,
        "planning": True,
    }
    torch.manual_seed(2)
    network = hdsp.learning.build_network(settings)
    with torch.no_grad():  # the ways decide
        network.heads.weight[:, :8] = 0
        network.heads.weight[:, 8:] *= 20
        network.goal_cost[-1].bias += 2
    in_torch = LearnedAbstraction(network, _model(settings))
    folder = in_torch.save_pretrained(tmp_path / "model", picture=False)
    found = LearnedAbstraction.from_pretrained(folder, hardware=HardwareSettings(precision="32"))
    assert found.engine is not None
    random = np.random.default_rng(3)
    patches = rough_patches(12)
    for patch in patches[4:]:  # bars and steps across the way
        for _ in range(3):
            first, last = np.sort(random.integers(0, 72, 2))
            patch[first : min(last, first + 12)] += random.choice([0.1, 0.2, 0.3])
        patch[random.random(patch.shape) < 0.002] = np.nan
    for heading in (0, 1, 6):
        goals = np.tile(robot_frame_goals(heading), (len(patches), 1, 1))
        for ours, theirs in zip(found._predict(patches, goals), in_torch._predict(patches, goals), strict=True):
            assert np.std(theirs) > 1e-3
            np.testing.assert_allclose(ours, theirs, atol=1e-4)


def test_plans_need_no_torch_and_other_networks_say_that_they_do():
    done = subprocess.run([sys.executable, "-c", PROBE], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    planned, refused = done.stdout.splitlines()
    assert planned == "True learned"
    assert "klamt2019 needs torch: pip install 'hdsp[learning]'" in refused


def test_a_copy_for_another_process(with_codes):
    copied = pickle.loads(pickle.dumps(with_codes))
    patches, goals = rough_patches(2), robot_frame_goals(6)
    for found, expected in zip(copied._predict(patches, goals), with_codes._predict(patches, goals), strict=True):
        np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize(
    ("options", "stance", "encoding"),
    [
        ({}, {}, {}),
        ({"taps": [3, 9], "spacing": 2}, {}, {"unevenness_radius": 2, "unevenness_contact": 0}),
        ({"dilations": [1], "taps": [1, 7]}, {"clearance": 0.1}, {"unevenness_radius": 1}),
        ({}, {"neutral": [0.15, 0.35], "contact_inward": 0.0}, {"unevenness_radius": 4}),
        ({}, {"boxes": [{"x_min": -0.55, "x_max": 0.2, "half_width": 0.1, "above": 0.2}]}, {"unevenness_radius": 3}),
        ({"foot_ways": None}, {}, {}),
        ({"foot_ways": WAYS}, {}, {"unevenness_contact": 0}),
        ({"foot_ways": WAYS | {"reach": [-0.1, 0.25]}, "steps": 8}, {"edge": 0.2}, {"unevenness_radius": 10}),
        (
            {"foot_ways": WAYS | {"max_length": 0.0}},
            {"neutral": [0.19, 0.15]},
            {"unevenness_contact": 3, "unevenness_radius": 9},
        ),
    ],
)
def test_no_ground_beyond_the_reach_has_an_effect(abstraction, options, stance, encoding):
    model = abstraction.model
    model = replace(
        model,
        options=model.options | options | {"stance": model.options["stance"] | stance},
        encoding=replace(model.encoding, **encoding),
    )
    random, base = np.random.default_rng(0), PATCH_CENTER + 4
    tensors = {
        name: random.normal(0.0, 0.2, shape).astype(np.float32)
        for name, shape in shapes(engine_options(model), 4).items()
    }
    engine = FootprintEngine(model, tensors, codes=False)
    heights = random.normal(0.0, 0.05, (2 * base + 1, 2 * base + 1)).astype(np.float32)
    inside = tuple(slice(base - reach, base + reach + 1) for reach in engine.reach)
    for goals in (robot_frame_goals(0), robot_frame_goals(3)):
        judged = []
        for height in (0.0, 0.3, np.nan):
            other = np.full_like(heights, height)
            other[inside] = heights[inside]
            (found,) = [each for each in engine.evaluate(other, np.array([[base, base]]), goals) if each is not None]
            judged.append(np.stack([found[1].cost, found[1].logits]))
        assert np.isfinite(judged).all() and np.std(judged[0]) > 0
        np.testing.assert_array_equal(judged[1], judged[0])
        np.testing.assert_array_equal(judged[2], judged[0])


def test_weights_of_another_network_are_refused(abstraction):
    tensors = load_file(str(shipped() / "momaro" / "model.safetensors"))
    with pytest.raises(InputError, match=r"does not fit footprint: heads\.bias is missing"):
        FootprintEngine(abstraction.model, {key: value for key, value in tensors.items() if key != "heads.bias"})
    with pytest.raises(InputError, match=r"does not fit footprint: feet\.bias is \(3,\)"):
        FootprintEngine(abstraction.model, tensors | {"feet.bias": np.zeros(3, np.float32)})


def test_torch_evaluates_where_settings_or_the_network_ask_for_it(abstraction):
    place = str(shipped() / "momaro")
    assert abstraction.engine is not None
    assert LearnedAbstraction.from_pretrained(place, hardware=HardwareSettings("cpu", "bf16")).engine is None
    assert engine_options(_model(model_file("compact"))) is None
    near = model_file("footprint")
    near["encoding"]["unevenness_radius"] = 30  # reads beyond the patch
    assert engine_options(_model(near)) is None


def _model(settings):
    from hdsp.base.settings import load_settings

    return load_settings(hdsp.learning.ModelSettings, settings, "model")


def test_a_layer_pauses_every_few_products(monkeypatch):
    monkeypatch.setattr(cell_layer, "VALUES", 20)
    monkeypatch.setattr(cell_layer, "PRODUCTS", 2)
    values, result = np.arange(100, dtype=np.float32).reshape(100, 1), np.zeros((100, 1), np.float32)
    layer = cell_layer.Layer(np.ones((2, 1), np.float32), np.zeros(1, np.float32))
    # Ten cells in a product: the first pause comes behind twenty.
    steps = layer.convolve(values, np.arange(99), np.array([0, 1]), 1, result)
    next(steps)
    assert (result[:20, 0] == 2 * np.arange(20) + 1).all() and not result[20:].any()
    assert len(list(steps)) == 4 and (result[:99, 0] == 2 * np.arange(99) + 1).all()
