"""Conditioned maps: exact maps stay, noise, spikes and holes go, edges and slopes keep their place."""

import math

import numpy as np
import pytest
import yaml
from scipy.ndimage import gaussian_filter

from hdsp.base.errors import InputError
from hdsp.robot.lattice import RESOLUTION
from hdsp.terrain import ConditioningSettings, HeightMap, conditioned, random_map, read_arena
from hdsp.terrain.conditioning import Stages
from hdsp.terrain.obstacles import Block, Scene

SIDE = 120  # cells


def scene(*blocks: Block) -> HeightMap:
    """Blocks on level ground; the middle of the map is at (0, 0)."""
    return Scene(blocks).rasterise((SIDE, SIDE), (SIDE // 2, SIDE // 2))


def plane(degrees: float, direction: float, resolution: float, side: float = 3.0) -> HeightMap:
    count = round(side / resolution)
    x, y = (np.indices((count, count)) + 0.5) * resolution
    slope = math.tan(math.radians(degrees))
    return HeightMap(slope * (math.cos(direction) * x + math.sin(direction) * y), resolution=resolution)


def coarse(terrain: HeightMap, factor: int) -> HeightMap:
    """Mean heights over ``factor`` x ``factor`` cells."""
    nx, ny = (count // factor for count in terrain.shape)
    blocks = terrain.heights[: nx * factor, : ny * factor].reshape(nx, factor, ny, factor)
    return HeightMap(blocks.mean(axis=(1, 3)), terrain.origin, terrain.resolution * factor)


def white(shape, sigma, seed=0):
    return sigma * np.random.default_rng(seed).standard_normal(shape)


def smooth(shape, sigma, cells=2.0, seed=0):
    waves = gaussian_filter(np.random.default_rng(seed).standard_normal(shape), cells)
    return sigma * waves / waves.std()


def test_exact_maps_keep_their_heights_to_the_last_bit():
    with open("conf/arena/paper.yaml", encoding="utf-8") as file:
        arena = read_arena(yaml.safe_load(file)).height_map()
    wall = scene(Block(0.3, 0.1, 0.4, 2.0, 0.1, 1.0), Block(-0.6, 0.0, 0.2, 0.05, 0.05, 0.9))
    maps = [arena, wall, plane(15, 0.3, 0.025)]
    maps += [random_map(1, name, 0) for name in ("wall_2", "staircase", "ramp_mixed", "tiles_mixed")]
    for terrain in maps:
        result, report = terrain.conditioned()
        assert result.heights.tobytes() == terrain.heights.tobytes()
        assert not report.changed and str(report) == "nothing to do" and result.frame.notes == ()


@pytest.mark.parametrize(
    ("unknown", "words"),
    [
        (np.s_[40, 40], "1 unknown cell filled"),
        (np.s_[40:42, 40:42], "4 unknown cells filled"),
        (np.s_[:30], "25 % unknown"),
    ],
)
def test_a_report_counts_cells_and_keeps_to_the_unknown_share_without_work(unknown, words):
    heights = np.zeros((SIDE, SIDE), np.float32)
    heights[unknown] = np.nan
    assert str(HeightMap(heights).conditioned().report) == words


@pytest.mark.parametrize("sigma", [0.01, 0.02, 0.03])
@pytest.mark.parametrize("noise", [white, smooth])
def test_noise_is_measured_and_removed_while_edges_stay_in_place(sigma, noise):
    exact = scene(Block(1.0, 0.0, 0.0, 2.0, 9.0, 0.16))
    result, report = HeightMap(exact.heights + noise(exact.shape, sigma)).conditioned()
    assert report.noise.deviation == pytest.approx(sigma, rel=0.25)
    error, before = result.heights - exact.heights, noise(exact.shape, sigma)
    rise = np.flatnonzero(np.diff(exact.heights[:, 0]))[0]
    away = np.ones(SIDE, bool)
    away[rise - 1 : rise + 3] = False
    # Long waves of smooth noise are ground; short ones decide the cost of driving.
    assert error[away].std() < (0.35 if noise is white else 0.65) * sigma
    assert np.abs(np.diff(error[away], axis=1)).mean() < 0.4 * np.abs(np.diff(before, axis=1)).mean()
    # The largest rise of each row lies within one cell of the edge.
    at = np.abs(np.diff(result.heights, axis=0)).argmax(axis=0)
    assert np.mean(np.abs(at - rise) <= 1) > 0.95


def test_noise_is_removed_from_slopes_without_steps():
    exact = plane(12, 0.7, 0.025)
    result, _ = HeightMap(exact.heights + white(exact.shape, 0.01)).conditioned()
    inner = (slice(8, -8),) * 2
    assert np.abs((result.heights - exact.heights)[inner]).max() < 0.012
    assert np.abs(np.diff(result.heights, 2, axis=0)[inner]).mean() < 0.002


def test_structures_that_a_median_erases_stay():
    post, wall = Block(0.0, 0.0, 0.0, 0.05, 0.05, 0.8), Block(-0.9, 0.0, 0.0, 0.05, 2.0, 0.8)
    exact = scene(post, wall)
    result, report = HeightMap(exact.heights + white(exact.shape, 0.02)).conditioned()
    assert report.noise.window >= 5
    assert (result.heights[exact.heights > 0.5] > 0.6).all()
    assert (result.heights[exact.heights == 0] < 0.1).all()


@pytest.mark.parametrize("cell", [0.04, 0.05, 0.1])
def test_a_post_in_one_coarse_cell_stays_and_many_spikes_go(cell):
    heights = np.zeros((100, 100), np.float32)
    heights[30, 40] = heights[70, 20] = 0.5
    result, report = HeightMap(heights, resolution=cell).conditioned()
    assert report.spikes == 0
    for x, y in ((30, 40), (70, 20)):
        at = tuple(np.array([x + 0.5, y + 0.5]) * cell)
        assert result.height_at(*at) == 0.5
    spiky = heights + 0.3 * (np.random.default_rng(0).random(heights.shape) < 0.01)
    result, report = HeightMap(spiky, resolution=cell).conditioned()
    assert report.spikes > 80 and (result.heights > 0.2).mean() < 0.002


@pytest.mark.parametrize("cell", [0.005, 0.01, 0.0125])
@pytest.mark.parametrize("cells", [1, 2, 3])
def test_thin_walls_and_posts_in_fine_cells_stay(cell, cells):
    heights = np.zeros((240, 240), np.float32)
    heights[100 : 100 + cells] = 0.4
    heights[200:204, 30:34] = 0.6
    result, _ = HeightMap(heights, resolution=cell).conditioned()
    assert (result.heights.max(axis=0) >= 0.4).all() and result.heights.max() == pytest.approx(0.6)
    # The wall is at most one cell wider.
    assert (result.heights > 0.2).sum(axis=0).max() <= 2 + math.ceil(cells * cell / 0.025) + math.ceil(4 * cell / 0.025)


def test_spikes_go_and_corners_stay():
    exact = scene(Block(0.5, 0.5, math.pi / 4, 0.8, 0.8, 0.5))
    spiky = exact.heights.copy()
    for at, height in {(20, 20): 0.6, (40, 90): -0.7, (41, 91): -0.6, (100, 30): 0.08}.items():
        spiky[at] += height
    result, report = HeightMap(spiky).conditioned()
    assert (report.spikes, report.filled) == (4, 4)
    np.testing.assert_allclose(result.heights, exact.heights, atol=1e-6)
    kept, report = HeightMap(spiky).conditioned(ConditioningSettings(spike=0.0))
    assert not report.changed and kept.heights.tobytes() == spiky.tobytes()


def test_holes_are_filled_where_their_rim_agrees():
    slope = plane(10, 0.4, 0.025)
    heights = slope.heights.copy()
    heights[30:35, 40:45] = np.nan  # 0.125 m wide
    heights[60:80, 40:60] = np.nan  # 0.5 m wide
    result, report = HeightMap(heights).conditioned()
    assert np.isfinite(result.heights[20:50]).all() and 25 <= report.filled <= 60  # corners of the large one, too
    np.testing.assert_allclose(result.heights[30:35, 40:45], slope.heights[30:35, 40:45], atol=0.015)
    assert np.isnan(result.heights[62:78, 42:58]).all()


def test_holes_between_two_levels_stay_unknown():
    exact = scene(Block(1.0, 0.0, 0.0, 2.0, 9.0, 0.5))
    rise = int(np.flatnonzero(np.diff(exact.heights[:, 0]))[0])
    heights = exact.heights.copy()
    heights[rise - 2 : rise + 4, 50:56] = np.nan
    heights[20:26, 50:56] = np.nan
    result, report = HeightMap(heights).conditioned()
    assert np.isnan(result.heights[rise - 1 : rise + 3, 51:55]).all()
    assert (result.heights[20:26, 50:56] == 0).all() and 36 <= report.filled <= 40


@pytest.mark.parametrize("cell", [0.0125, 0.03, 0.04, 0.05, 0.1])
@pytest.mark.parametrize("degrees", [0.0, 7.0, 15.0, 25.0])
def test_m5_a_slope_in_cells_of_another_size_stays_a_slope(cell, degrees):
    terrain = plane(degrees, 0.5, cell)
    result, report = terrain.conditioned()
    assert result.resolution == 0.025 and result.origin == terrain.origin
    assert result.size == pytest.approx(terrain.size, abs=0.025)
    exact = plane(degrees, 0.5, 0.025, side=4.0).heights[: result.shape[0], : result.shape[1]]
    inner = (slice(6, -6),) * 2  # interpolation ends at the middle of the outermost cells
    np.testing.assert_allclose(result.heights[inner], exact[inner], atol=0.013 if cell < 0.025 else 1e-4)
    assert f"cells of {cell:g} m" in str(report) and is_noted(result)


def is_noted(terrain: HeightMap) -> bool:
    return any("conditioned" in note for note in terrain.frame.notes)


@pytest.mark.parametrize("factor", [2, 4])
@pytest.mark.parametrize("yaw", [0.0, 0.35])
@pytest.mark.parametrize("shift", [0.0, 0.02, 0.05])
def test_m5_a_kerb_in_coarse_cells_stays_an_edge_at_its_place(factor, yaw, shift):
    ahead = 3.0 + shift
    exact = scene(Block(ahead * math.cos(yaw), ahead * math.sin(yaw), yaw, 6.0, 12.0, 0.15))
    result, _ = coarse(exact, factor).conditioned()
    assert result.shape == exact.shape
    wrong = np.abs(result.heights - exact.heights) > 0.01
    beside = np.abs(math.cos(yaw) * centers()[0] + math.sin(yaw) * centers()[1] - shift) <= factor * 0.025
    assert not (wrong & ~beside).any()
    # No ground lies between the two levels but for few cells on a slanted edge.
    between = (result.heights > 0.04) & (result.heights < 0.11)
    assert between.sum() <= (0 if yaw == 0 else 0.25 * SIDE)


def centers() -> np.ndarray:
    return (np.indices((SIDE, SIDE)) - SIDE // 2) * 0.025


def test_a_conditioned_map_is_not_conditioned_twice(tmp_path):
    terrain = HeightMap(white((80, 80), 0.01))
    once = terrain.conditioned().terrain
    assert conditioned(once).terrain.heights.tobytes() == once.heights.tobytes()
    once.save(tmp_path / "map.npz")
    loaded = HeightMap.load(tmp_path / "map.npz")
    assert not loaded.conditioned().report.changed and is_noted(loaded)


@pytest.mark.parametrize("shape", [(1, 1), (1, 7), (3, 2), (30, 4)])
@pytest.mark.parametrize("cell", [0.01, 0.025, 0.06])
def test_small_and_unknown_maps_are_conditioned(shape, cell):
    for heights in (np.zeros(shape), np.full(shape, np.nan), white(shape, 0.02)):
        result, report = HeightMap(heights, resolution=cell).conditioned()
        assert np.isfinite(result.heights).any() == np.isfinite(heights).any()
        assert report.unknown == float(np.isnan(result.heights).mean())


def test_cells_too_coarse_or_too_many_are_refused():
    with pytest.raises(InputError, match=r"0\.3 m.*0\.2 m"):
        HeightMap.flat((10, 10), resolution=0.3).conditioned()
    with pytest.raises(InputError, match="more than 100,000,000 cells"):
        HeightMap.flat((1500, 1500), resolution=0.2).conditioned()
    with pytest.raises(InputError, match="spike"):
        ConditioningSettings(spike=-1.0)


@pytest.mark.parametrize("cell", [0.0125, 0.025, 0.04, 0.05])
@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_a_change_gives_the_result_of_the_whole_map(cell, noise):
    """Only the neighbourhood of a change is conditioned again, with the noise of the first map."""
    rng = np.random.default_rng(round(1e4 * cell))
    for _ in range(12):
        heights = scene(Block(0.4, 0.2, 0.3, 1.2, 0.8, 0.3)).heights + smooth((SIDE, SIDE), noise, seed=rng)
        heights = np.where(rng.random(heights.shape) < 0.03, np.nan, heights).astype(np.float32)
        heights[rng.random(heights.shape) < 0.01] += 0.3
        stages = Stages(heights, cell)
        before = stages.result.copy()
        x, y = rng.integers(0, SIDE - 20, 2)
        part = slice(x, x + int(rng.integers(1, 20))), slice(y, y + int(rng.integers(1, 20)))
        changed = heights.copy()
        changed[part] += rng.choice([0.0, 0.04, 0.2]) + white(changed[part].shape, noise, seed=rng)
        changed[part][rng.random(changed[part].shape) < 0.1] = np.nan
        cells = stages.update(changed, part)
        whole = Stages(heights, cell)
        whole.update(changed, (slice(0, SIDE), slice(0, SIDE)))
        np.testing.assert_array_equal(stages.result, whole.result)
        outside = np.ones(before.shape, bool)
        outside[cells] = False
        np.testing.assert_array_equal(stages.result[outside], before[outside])


@pytest.mark.parametrize("cell", [0.04, 0.05, 0.1])
def test_m5_a_wall_as_thin_as_one_coarse_cell_keeps_its_height(cell):
    heights = np.zeros((40, 40), np.float32)
    heights[20] = 0.36
    after = HeightMap(heights, resolution=cell).conditioned().terrain.heights
    assert set(np.unique(after)) == {0.0, np.float32(0.36)}
    assert (after > 0).sum(axis=0).min() >= math.floor(cell / RESOLUTION)
