"""Things of other packages, found by entry point or by `module:name`."""

import sys
from importlib.metadata import EntryPoint

import numpy as np
import pytest

from hdsp.base import extensions
from hdsp.base.errors import InputError
from hdsp.base.provenance import code_fingerprint
from hdsp.labels.rules import LabelSettings
from hdsp.labels.run.splits import LabelRun, SplitSettings
from hdsp.learning.learning_settings import ModelSettings
from hdsp.learning.networks import build_network
from hdsp.planning.planner import Planner
from hdsp.robot.robot import Robot
from hdsp.terrain.height_map import HeightMap
from hdsp.terrain.scenes import TerrainSettings, categories, random_map

SOURCE = """
from hdsp.learning.networks.table import Table
from hdsp.planning.heuristics import GeometricHeuristic
from hdsp.terrain.obstacles import Block

HEIGHT = 0.3

class OwnTable(Table):
    pass

class Nothing:
    pass

def draw(random, settings):
    return [Block(1.0, random.uniform(-0.1, 0.1), 0.0, 0.4, 0.4, HEIGHT)]

def make(world, terrain):
    return GeometricHeuristic(world)

def make_nothing(world, terrain):
    return None
"""


@pytest.fixture
def own(tmp_path, monkeypatch):
    """The path of a module `own_lab`; an entry point announces its category as `post`."""
    path = tmp_path / "own_lab.py"
    path.write_text(SOURCE)
    monkeypatch.syspath_prepend(tmp_path)
    points = [EntryPoint("post", "own_lab:draw", "hdsp.terrain")]
    monkeypatch.setattr(extensions, "entry_points", lambda group: [p for p in points if p.group == group])
    extensions.extensions.cache_clear()
    yield path
    sys.modules.pop("own_lab", None)
    extensions.extensions.cache_clear()


def test_a_category_is_a_function_of_seed_and_index(own):
    assert categories()[-1] == "post"
    first, again, other = random_map(1, "post", 0), random_map(1, "post", 0), random_map(1, "post", 1)
    np.testing.assert_array_equal(first.heights, again.heights)
    assert first.heights.max() == np.float32(0.3) and (first.heights != other.heights).any()
    with pytest.raises(InputError, match=r"terrain category 'pots'; need one of cuboid_1, .*, post$"):
        random_map(1, "pots", 0)


def test_labels_depend_on_the_code_of_their_category(own):
    def run(*names):
        split = SplitSettings(seed=1, maps_per_category=1, categories=names)
        return LabelRun(split, Robot.load("momaro"), TerrainSettings(), LabelSettings()).inputs()

    assert "category_code" not in run("cuboid_1")
    assert run("post", "cuboid_1")["category_code"] == {"post": code_fingerprint("own_lab:draw")}
    before = code_fingerprint("own_lab:draw", "own_lab:make")
    own.write_text(SOURCE.replace("HEIGHT = 0.3", "HEIGHT = 0.4"))
    assert code_fingerprint("own_lab:make", "own_lab:draw") != before
    with pytest.raises(InputError, match=r"categories\[0\] is 'pots'; need one of .*, post, or module:function"):
        SplitSettings(seed=1, maps_per_category=1, categories=("pots",))


def test_a_network_of_another_package_is_built_and_written_out(own):
    model = ModelSettings(architecture="own_lab:OwnTable", options={"hidden": 16})
    assert type(build_network(model)).__name__ == "OwnTable"
    assert model.to_dict()["options"]["hidden"] == 16
    with pytest.raises(InputError, match=r"architecture is 'nix'; need one of klamt2019, .*, or module:class"):
        ModelSettings(architecture="nix")
    for place, says in (("own_lab:nix", "cannot load own_lab:nix"), ("own_lab:Nothing", "need a TaskNetwork")):
        with pytest.raises(InputError, match=says):
            build_network(ModelSettings(architecture=place))


def test_a_heuristic_of_another_package_plans(own):
    terrain = HeightMap.flat((120, 120))
    plans = [
        Planner(terrain, heuristic=name).plan((1.0, 1.5, 0.0), (2.0, 1.5, 0.0))
        for name in ("own_lab:make", "geometric")
    ]
    assert plans[0].cost == plans[1].cost
    for name, says in (("own_lab:make_nothing", "NoneType is neither"), ("gird", "need 'geometric', 'grid'")):
        with pytest.raises(InputError, match=says):
            Planner(terrain, heuristic=name)
