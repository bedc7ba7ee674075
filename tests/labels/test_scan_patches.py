import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hdsp.abstract.transform import feet_at
from hdsp.base.errors import InputError
from hdsp.detailed.world.world import build_world
from hdsp.labels.rules import LabelSettings
from hdsp.labels.scan_patches import FLAT, ScanPatchSettings, draw_starts, label_scan
from hdsp.labels.shards import read_shard
from hdsp.robot.robot import Robot
from hdsp.terrain.height_map import HeightMap

ROBOT = Robot.load("momaro")
ABOUT = {"place": "yard", "licence": "MIT", "scan": "one"}


def yard():
    """A floor of 5 x 4 m with a wall, low blocks and an unknown part."""
    heights = np.zeros((200, 160), np.float32)
    heights[:, 150:] = 1.0
    for x in range(10, 200, 40):
        heights[x : x + 8, 60:66] = 0.12
    heights[150:, :60] = np.nan
    return HeightMap(heights, (3.0, -1.0))


@settings(max_examples=5)
@given(st.integers(0, 1000), st.sampled_from([(0,), (0, 1, 2, 3), (2,)]), st.sampled_from([0.0, 0.3, 0.8]))
def test_starts_are_valid_apart_from_each_other_and_head_as_asked(seed, residues, spacing):
    terrain = yard()
    asked = ScanPatchSettings(seed, count=12, spacing=spacing, known=0.6, flat=0.25, heading_residues=residues)
    starts = draw_starts(terrain, ROBOT, asked)
    world = build_world(HeightMap(np.pad(terrain.heights, 60, constant_values=np.nan)), ROBOT)
    assert 0 < len(starts) <= 12
    flat = 0
    for k, (ix, iy, heading) in enumerate(starts.tolist()):
        assert heading % 4 == 0 and heading // 4 % 4 == residues[k % len(residues)]
        assert feet_at(world, (ix + 60, iy + 60, heading)) is not None
        patch = terrain.crop_cells(ix, iy, heading).heights
        assert np.isfinite(patch).mean() >= 0.6
        flat += np.nanmax(patch) - np.nanmin(patch) < FLAT
        others = np.delete(starts, k, axis=0)[:, :2] - (ix, iy)
        assert np.hypot(*others.T).min(initial=np.inf) * 0.025 >= spacing - 1e-9
    assert flat <= 3
    np.testing.assert_array_equal(starts, draw_starts(terrain, ROBOT, asked))


def test_a_map_without_room_gives_no_starts():
    assert draw_starts(HeightMap(np.full((90, 90), np.nan)), ROBOT, ScanPatchSettings()).shape == (0, 3)
    assert len(draw_starts(HeightMap.flat((20, 20)), ROBOT, ScanPatchSettings())) == 0


def test_the_map_needs_the_cells_of_the_planner():
    with pytest.raises(InputError, match=r"cells of 0\.05 m; need 0\.025 m"):
        draw_starts(HeightMap.flat((90, 90), resolution=0.05), ROBOT, ScanPatchSettings())


def test_patches_become_a_shard_that_says_where_they_are_from(tmp_path, monkeypatch):
    rules, patches = LabelSettings(max_expansions=500), ScanPatchSettings(seed=3, count=3)
    terrain = yard()
    tasks = label_scan(terrain, ROBOT, patches, rules, tmp_path / "one.h5", ABOUT)
    starts = draw_starts(terrain, ROBOT, patches)
    assert len(tasks) == 3
    assert set(tasks.category) == {"yard"}
    np.testing.assert_array_equal(tasks.heading, starts[:, 2])
    for heights, (ix, iy, heading) in zip(tasks.heights, starts.tolist(), strict=True):
        np.testing.assert_array_equal(heights, terrain.crop_cells(ix, iy, heading).heights)
    shard = read_shard(tmp_path / "one.h5")
    assert {name: shard.attributes[name] for name in ABOUT} == ABOUT

    made = (tmp_path / "one.h5").stat().st_mtime_ns
    label_scan(terrain, ROBOT, patches, rules, tmp_path / "one.h5", ABOUT)
    assert (tmp_path / "one.h5").stat().st_mtime_ns == made, "labels that hold were made again"
    monkeypatch.setattr("hdsp.labels.scan_patches.label_map", lambda *_: None)
    assert len(label_scan(terrain, ROBOT, patches, LabelSettings(), tmp_path / "one.h5", ABOUT)) == 0


@pytest.mark.parametrize(
    "values", [{"count": 0}, {"spacing": -1}, {"known": 1.1}, {"flat": -0.1}, {"heading_residues": (4,)}]
)
def test_settings_out_of_range_are_refused(values):
    with pytest.raises(InputError, match=r"PatchSettings.*need"):
        ScanPatchSettings(**values)
