"""Tasks and disturbances of the benchmark on real ground."""

import numpy as np
import pytest

from benchmarks import real_ground
from hdsp.base.errors import InputError


def test_disturbed_kerbs_and_stairs_are_planned_free_and_with_steps():
    result = real_ground.main(["--count", "4", "--seed", "3", "--only", "white_2cm,together"])
    for name in ("white_2cm", "together"):
        assert result[name]["solved"] == 1.0 and result[name]["stepped"] == 1.0
        assert 0.8 < result[name]["cost"] <= 1.15
    assert result["false"] == 0 and result["conditioning_10x10"] > result["conditioning_1m2"] > 0


def test_tasks_differ_and_disturbances_disturb():
    kinds = [real_ground.random_task(0, number).kind for number in range(5)]
    assert tuple(kinds) == real_ground.KINDS
    terrain = real_ground.random_task(0, 3).arena.height_map()
    for name, disturb in real_ground.DISTURBANCES.items():
        changed = disturb(terrain, np.random.default_rng(0))
        assert changed.shape != terrain.shape or (changed.heights != terrain.heights).any(), name
    with pytest.raises(InputError, match="--only rain"):
        real_ground.main(["--only", "rain"])
