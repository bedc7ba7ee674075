"""Conditioned maps: exact maps stay, noise, spikes and holes go, edges and slopes keep their place."""

import math
import time

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.ndimage import (
    binary_closing,
    gaussian_filter,
    map_coordinates,
    maximum_filter,
    median_filter,
    minimum_filter,
    white_tophat,
)

from hdsp.base.errors import InputError
from hdsp.robot.lattice import RESOLUTION
from hdsp.terrain import ConditioningSettings, HeightMap, conditioned, conditioning, map_filters, random_map, read_arena
from hdsp.terrain.conditioning import Stages
from hdsp.terrain.fine_cells import joined
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


def heavy_tails(shape, rng):
    """Noise of 1 cm whose few large values are more than a normal distribution has."""
    mixed = np.where(rng.random(shape) < 0.1, 0.04, 0.005) * rng.standard_normal(shape)
    growing = np.linspace(0, 0.04, shape[0])[:, None] * rng.standard_normal(shape)
    return {"laplace": rng.laplace(0, 0.01, shape), "t": 0.01 * rng.standard_t(3, shape), "mixed": mixed,
            "exponential": rng.exponential(0.015, shape), "growing": growing}  # fmt: skip


@pytest.mark.parametrize("kind", ["laplace", "t", "mixed", "exponential", "growing"])
def test_outliers_of_noise_with_heavy_tails_go_beside_noisy_cells_too(kind):
    exact = scene(Block(1.0, 0.0, 0.0, 2.0, 9.0, 0.15))
    for seed in range(3):
        noise = heavy_tails(exact.shape, np.random.default_rng(seed))[kind]
        result, _ = HeightMap(exact.heights + noise).conditioned()
        error = (result.heights - exact.heights)[2:-2, 2:-2]  # at the border, an outlier may go on beyond the map
        assert (np.abs(error - np.median(error)) > 0.05).mean() < 2e-4


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


def closed_by_discs(known, radius):
    x, y = np.indices((2 * radius + 1,) * 2) - radius
    padded = np.pad(known, radius, mode="edge" if radius == 1 else "constant")
    return binary_closing(padded, x**2 + y**2 <= radius**2)[radius:-radius, radius:-radius]


def holes_filled_by_filters(heights, resolution, noise, settings):
    """``without_holes`` with medians and discs over the whole map."""
    known, radius = np.isfinite(heights), max(round(settings.hole / resolution), 1)
    if known.all() or not known.any():
        return heights
    window = 2 * radius + 3
    lowest = minimum_filter(np.where(known, heights, np.inf), window, mode="nearest")
    highest = maximum_filter(np.where(known, heights, -np.inf), window, mode="nearest")
    even = settings.edge + 10 * noise.deviation + math.tan(math.radians(20)) * window * resolution
    filled = closed_by_discs(known, 1) | (closed_by_discs(known, radius) & (highest - lowest <= even))
    around = median_filter(map_filters._everywhere(heights), 2 * radius + 1, mode="nearest")
    return np.where(filled & ~known, around, heights)


def sampled_from_filters(measured, places, scale, settings):
    """``sampled`` with a median over the whole map."""
    full, window = map_filters._everywhere(measured), 2 * round(0.5 / scale) + 1
    middle = median_filter(full, window, mode="nearest")
    thin = np.where(white_tophat(full, window, mode="nearest") > settings.edge, full, -np.inf)
    highest = maximum_filter(thin, window, mode="nearest")
    heights = np.where(highest > middle + settings.edge, highest, middle)
    return map_coordinates(heights, places, order=0, mode="nearest")


def ragged(cell, noise, gaps, seed, shape=(60, 47)):
    """A block with noise, spikes, and unknown cells in patches of some size."""
    rng = np.random.default_rng(seed)
    heights = np.zeros(shape, np.float32)
    heights[20:40, 10:35] = 0.3
    heights[50, :30] = 0.5
    heights += noise * rng.standard_normal(shape)
    heights[rng.random(shape) < 0.01] += 0.4
    heights[gaussian_filter(rng.standard_normal(shape), gaps) > 0.6 / (1 + 3 * gaps)] = np.nan
    return HeightMap(heights, (1.0, -2.0), cell)


@pytest.mark.parametrize("cell", [0.003, 0.005, 0.01, 0.0125, 0.025, 0.04])
@pytest.mark.parametrize("gaps", [0.01, 1.0, 3.0])
def test_medians_where_they_count_give_the_map_of_medians_everywhere(monkeypatch, cell, gaps):
    for noise in (0.0, 0.01):
        terrain = ragged(cell, noise, gaps, seed=round(100 * gaps))
        result, report = terrain.conditioned()
        with monkeypatch.context() as patch:
            patch.setattr(conditioning, "without_holes", holes_filled_by_filters)
            patch.setattr(conditioning, "sampled", sampled_from_filters)
            slow, expected = terrain.conditioned()
        assert result.heights.tobytes() == slow.heights.tobytes() and str(report) == str(expected)
        assert report.filled


@settings(max_examples=40, deadline=None)
@given(hnp.arrays(bool, hnp.array_shapes(min_dims=2, max_dims=2, max_side=12)), st.integers(1, 9))
def test_a_closing_by_distances_is_one_by_discs(known, radius):
    np.testing.assert_array_equal(map_filters._closed(known, radius), closed_by_discs(known, radius))


def joined_by_loops(heights, factor, edge, spike_cells):
    shape = [math.ceil(count / factor) for count in heights.shape]
    result = np.full(shape, np.nan, np.float32)
    for x, y in np.ndindex(*shape):
        block = heights[x * factor : (x + 1) * factor, y * factor : (y + 1) * factor]
        known = sorted(block[np.isfinite(block)].tolist())
        if known:
            middle = np.float32(known[len(known) // 2])
            high = [each for each in known if np.float32(each) > middle + np.float32(edge)]
            result[x, y] = known[-1] if len(high) > min(spike_cells, factor - 1) else middle
    return result


@settings(max_examples=40, deadline=None)
@given(
    hnp.arrays(
        np.float32,
        hnp.array_shapes(min_dims=2, max_dims=2, max_side=12),
        elements=st.sampled_from([0.0, 0.02, 0.25, 1.0, np.nan]),
    ),
    st.integers(1, 5),
    st.integers(0, 3),
)
def test_joined_cells_have_their_median_or_their_thin_structure(heights, factor, spike_cells):
    expected = joined_by_loops(heights, factor, 0.05, spike_cells)
    np.testing.assert_array_equal(joined(heights, factor, 0.05, spike_cells), expected)


@pytest.mark.parametrize("cell", [0.0005, 0.001, 0.002])
def test_much_finer_cells_give_the_map_of_fine_ones_and_take_no_longer(cell):
    """Level ground, a kerb, a wall 5 mm thick, noise, spikes, a hole and unknown ground."""
    count, rng = round(0.6 / cell), np.random.default_rng(0)
    x, y = (np.indices((count, count)) + 0.5) * cell
    heights = np.where(x > 0.4, 0.15, 0.0) + np.where(np.abs(y - 0.25) < 0.00251, 0.4, 0.0)
    heights += 0.005 * rng.standard_normal(heights.shape)
    heights[rng.random(heights.shape) < 2e-4] += 0.5
    heights[np.hypot(x - 0.2, y - 0.1) < 0.04] = np.nan
    heights[y > 0.5] = np.nan
    began = time.process_time()
    result, report = HeightMap(heights, resolution=cell).conditioned()
    assert time.process_time() - began < 2
    assert result.shape == (24, 24) and report.filled and f"cells of {cell:g} m resampled" in str(report)
    level, raised = result.heights[:15], result.heights[17:]
    wall = slice(9, 11)
    assert (level[:, wall].max(axis=1) > 0.38).all() and (raised[:, wall].max(axis=1) > 0.53).all()
    for part, height in ((level, 0.0), (raised, 0.15)):
        away = np.delete(part[:, :20], np.s_[8:12], axis=1)
        np.testing.assert_allclose(away, height, atol=0.006)
    assert np.isnan(result.heights[:, 20:]).all()


def test_cells_too_fine_are_refused():
    for cell in (1e-7, 9.9e-5):
        with pytest.raises(InputError, match=rf"cells of {cell:g} m; conditioning .* at least 0\.0001 m"):
            HeightMap.flat((60, 60), resolution=cell).conditioned()
    assert HeightMap.flat((600, 600), resolution=1e-4).conditioned().terrain.shape == (2, 2)


def test_a_hole_has_a_largest_size():
    with pytest.raises(InputError, match=r"hole is 11\.0; need at most 10"):
        ConditioningSettings(hole=11.0)


def test_cells_too_coarse_or_too_many_are_refused():
    with pytest.raises(InputError, match=r"0\.3 m.*0\.2 m"):
        HeightMap.flat((10, 10), resolution=0.3).conditioned()
    with pytest.raises(InputError, match="more than 100,000,000 cells"):
        HeightMap.flat((1500, 1500), resolution=0.2).conditioned()
    with pytest.raises(InputError, match="spike"):
        ConditioningSettings(spike=-1.0)


@pytest.mark.parametrize("cell", [0.0011, 0.0125, 0.025, 0.04, 0.05])
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
