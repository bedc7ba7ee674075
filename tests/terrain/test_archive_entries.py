"""Arrays in .npz, .h5 and .npy files with other numbers than a map has."""

import math

import h5py
import numpy as np
import pytest

from hdsp.base.errors import InputError
from hdsp.terrain.height_map import HeightMap
from tests.terrain.rasters import HEIGHTS, equal


@pytest.mark.parametrize(
    ("entries", "words"),
    [
        ({"resolution": (0.05, 0.05)}, r"entry resolution is \[0\.05, 0\.05\]; need one finite number of metres"),
        ({"resolution": []}, r"entry resolution is \[\]; need one finite"),
        ({"resolution": math.nan}, "entry resolution is nan; need one finite"),
        ({"origin": 7.0}, r"entry origin is 7\.0; need 2 finite numbers of metres"),
        ({"origin": (1, 2, 3)}, r"entry origin is \[1, 2, 3\]; need 2"),
        ({"origin": (math.inf, 2)}, r"entry origin is \[inf, 2\.0\]; need 2 finite"),
        (
            {"heights": np.zeros((19200, 3))},
            r"entry heights is float64 \[19200, 3\]: points\? .* HeightMap\.from_points",
        ),
    ],
)
def test_entries_with_other_numbers_are_named(tmp_path, entries, words):
    arrays = {"heights": HEIGHTS, "resolution": 0.5, "origin": (1, 2), **entries}
    np.savez(tmp_path / "a.npz", **arrays)
    with h5py.File(tmp_path / "a.h5", "w") as file:
        for name, values in arrays.items():
            file[name] = values
    for name in ("a.npz", "a.h5"):
        with pytest.raises(InputError, match=words):
            HeightMap.load(tmp_path / name)
    np.savez(tmp_path / "b.npz", heights=HEIGHTS, resolution=[[0.5]], origin=[[1, 2]])
    assert equal(HeightMap.load(tmp_path / "b.npz"), HEIGHTS, (1, 2))


def test_points_in_a_bare_array_are_no_map(tmp_path):
    np.save(tmp_path / "a.npy", np.zeros((500, 3), np.float32))
    with pytest.raises(InputError, match=r"the array is float32 \[500, 3\]: points\?"):
        HeightMap.load(tmp_path / "a.npy", resolution=0.05)
