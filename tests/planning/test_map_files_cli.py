"""`hdsp info`, `hdsp map` and `hdsp plan` on height map files of every kind."""

import imageio.v3 as imageio
import numpy as np
import pytest
import rasterio
from affine import Affine

from hdsp.planning.cli import main
from hdsp.terrain.height_map import HeightMap
from tests.terrain.bags import message, write_bag

#: [ix, iy], whole centimetres.
GROUND = (np.add.outer(np.arange(60), 2 * np.arange(50)) % 7 + 10) / 100


def files(folder):
    """A file of each kind with the same ground: its path, options and the first words about it."""
    np.savez(folder / "ours.npz", heights=GROUND, origin=(0, 0), resolution=0.025)
    HeightMap(GROUND).save(folder / "ours.h5")
    np.save(folder / "array.npy", GROUND)
    with rasterio.open(
        folder / "grid.tif", "w", driver="GTiff", width=60, height=50, count=1, dtype="float32", crs="EPSG:25832",
        transform=Affine(0.025, 0, 0, 0, -0.025, 1.25),
    ) as file:  # fmt: skip
        file.write(GROUND.T[::-1].astype(np.float32), 1)
    head = "ncols 60\nnrows 50\nxllcorner 0\nyllcorner 0\ncellsize 0.025\nnodata_value -9999\n"
    (folder / "grid.asc").write_text(head + "\n".join(" ".join(f"{z:.2f}" for z in row) for row in GROUND.T[::-1]))
    grey = np.rint(GROUND.T[::-1] * 100).astype(np.uint8)
    imageio.imwrite(folder / "grey.png", grey)
    (folder / "grey.pgm").write_bytes(b"P5 60 50 255\n" + grey.tobytes())
    for kind in ("bag", "db3", "mcap"):
        flipped = GROUND[::-1, ::-1].astype(np.float32)
        item = message(
            1 if kind == "bag" else 2, {"elevation": flipped, "variance": 0 * flipped}, shape=GROUND.shape,
            resolution=0.025, center=(0.75, 0.625, 0.0),
        )  # fmt: skip
        yield write_bag(folder / kind, kind, {"/map": [item]}), [], "ROS bag, topic /map (grid_map_msgs/msg/GridMap, 1 "
    cells = ["--resolution", "0.025"]
    yield folder / "ours.npz", [], "NumPy archive, entries heights float64 [60, 50], origin int64 [2]"
    yield folder / "ours.h5", [], "HDF5, entries digest uint8 [32], heights float32 [60, 50]"
    yield folder / "array.npy", cells, "NumPy array, array float64 [60, 50]"
    yield folder / "grid.tif", [], "GeoTIFF, 60 x 50 pixels, bands 1 (float32), CRS EPSG:25832, no-data value none"
    yield folder / "grid.asc", [], "ASCII grid, 60 x 50 pixels, bands 1 (float32), CRS none, no-data value -9999"
    yield folder / "grey.png", [*cells, "--scale", "0.01"], "PNG, 60 x 50 pixels, mode L, grey values 10 to 16"
    yield folder / "grey.pgm", [*cells, "--scale", "0.01"], "PGM, 60 x 50 pixels, mode L, grey values 10 to 16"


def test_m7_each_kind_of_map_is_described_and_converted(tmp_path, capsys):
    for path, options, words in files(tmp_path):
        assert main(["info", str(path), *options]) == 0
        first, second, third, *_ = capsys.readouterr().out.splitlines()
        assert first.startswith(words), path
        assert second.startswith("height map of 60 x 50 cells of 0.025 m, 1.50 x 1.25 m from (0.00, 0.00), 100% known")
        assert third.startswith("frame ") and third.endswith("taken as metres")
        for out in ("out.npz", "out.TIF"):
            assert main(["map", str(path), *options, "--out", str(tmp_path / out)]) == 0
            terrain = HeightMap.load(tmp_path / out)
            np.testing.assert_allclose(terrain.heights, GROUND, atol=1e-6, err_msg=str(path))
            assert terrain.origin == pytest.approx((0, 0), abs=1e-9)
        assert "height map of 60 x 50 cells" in capsys.readouterr().out


def test_map_conditions_a_file_and_allows_the_cell_size_that_it_has_or_gets(tmp_path, capsys):
    HeightMap(GROUND[::2, ::2] / 100, resolution=0.05).save(tmp_path / "coarse.npz")
    assert main(["map", str(tmp_path / "coarse.npz"), "--out", str(tmp_path / "same.h5"), "--resolution", "0.05"]) == 0
    assert HeightMap.load(tmp_path / "same.h5").resolution == 0.05
    fine = ["--out", str(tmp_path / "fine.h5"), "--condition"]
    capsys.readouterr()
    assert main(["map", str(tmp_path / "coarse.npz"), *fine, "--resolution", "0.025"]) == 0
    _, line = capsys.readouterr().out.splitlines()
    assert line.startswith("conditioned: cells of 0.05 m resampled to 0.025 m")
    made, expected = HeightMap.load(tmp_path / "fine.h5"), HeightMap.load(tmp_path / "coarse.npz").conditioned().terrain
    assert made.resolution == 0.025 and made.frame.notes == expected.frame.notes
    np.testing.assert_array_equal(made.heights, expected.heights)
    assert main(["map", str(tmp_path / "coarse.npz"), *fine, "--resolution", "0.04"]) == 1
    assert "its own resolution, 0.05 m; --condition resamples to 0.025 m" in capsys.readouterr().err


def test_a_map_of_points_is_conditioned_as_well(tmp_path, capsys):
    points = np.random.default_rng(0).random((8000, 3)) * (3, 3, 0.01)
    np.savetxt(tmp_path / "room.xyz", points)
    assert main(["map", str(tmp_path / "room.xyz"), "--out", str(tmp_path / "o.npz"), "--condition"]) == 0
    assert "\nconditioned: noise of " in capsys.readouterr().out


def test_info_tells_what_a_file_needs_and_what_looks_wrong(tmp_path, capsys):
    paths = {path.name: path for path, _, _ in files(tmp_path)}
    assert main(["info", str(paths["grey.png"])]) == 0
    assert "no map yet: " in (told := capsys.readouterr().out) and "give the option resolution" in told
    heights = GROUND * 1000
    heights[3, 4] = -9999
    np.save(tmp_path / "mm.npy", heights)
    assert main(["info", str(tmp_path / "mm.npy"), "--resolution", "0.025"]) == 0
    told = capsys.readouterr().out
    assert "note: taken as unknown: the no-data value -9999 of 1 cell" in told
    assert "suspicious: heights from 100 to 160 m in cells of 0.025 m: millimetres or centimetres?" in told
    assert main(["info", str(tmp_path / "mm.npy"), "--resolution", "0.025", "--scale", "0.001"]) == 0
    assert "suspicious" not in capsys.readouterr().out


def test_a_plan_on_a_map_file_says_what_was_assumed(tmp_path, capsys):
    np.save(tmp_path / "mm.npy", np.full((100, 100), 20))
    ends = ["--start", "0.9", "0.9", "0", "--goal", "1.6", "1.1", "0", "--heuristic", "geometric", "--weight", "1.5"]
    options = ["--resolution", "0.025", "--scale", "0.001"]
    assert main(["plan", str(tmp_path / "mm.npy"), *options, *ends]) == 0
    told = capsys.readouterr().out
    assert told.startswith("map: heights times 0.001\n") and "solved" in told


def test_m18_a_plan_on_millimetres_is_warned_of_in_one_line(tmp_path, capsys):
    HeightMap(np.repeat([0.0, 150.0], 50)[:, None] * np.ones(100)).save(tmp_path / "mm.npz")
    main(["plan", str(tmp_path / "mm.npz"), "--start", "0.6", "1.2", "0", "--goal", "0.6", "1.2", "0", "--quiet"])
    (line,) = capsys.readouterr().err.splitlines()
    assert line == "warning: terrain: heights from 0 to 150 m in cells of 0.025 m: millimetres or centimetres?"


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["map", "{}/ours.npz", "--out", "{}/o.npz", "--units", "0.001"], "ours.npz; see --scale"),
        (["info", "{}/ours.npz", "--units", "0.001"], "option --units does not apply to the height map"),
        (["map", "{}/ours.npz", "--out", "{}/o.npz", "--no-level"], "option --no-level does not apply"),
        (["map", "{}/ours.npz", "{}/ours.h5", "--out", "{}/o.npz"], "2 files; need one height map"),
        (["map", "{}/ours.npz", "--out", "{}/o.npz", "--resolution", "0.05"], "the file has its own resolution"),
        (["map", "{}/grid.tif", "--out", "{}/o.npz", "--topic", "/a"], "option topic does not apply to GeoTIFF"),
        (
            ["map", "{}/grid.tif", "--out", "{}/o.asc"],
            "need one of .npz, .h5, .hdf5, .tif, .tiff to write",
        ),
        (["map", "{}/array.npy", "--out", "{}/o.npz"], "give the option resolution"),
        (["map", "{}/room.xyz", "--out", "{}/o.npz", "--layer", "x"], "option --layer does not apply to point clouds"),
        (["info", "{}/room.xyz", "--scale", "2"], "option --scale does not apply to point clouds"),
        (["info", "{}/ours.npz", "--axes", "z,x,y"], "option --axes does not apply to the height map"),
        (["info", "{}/bag.bag", "--layer", "x"], "need one of elevation, variance"),
        (["plan", "{}/array.npy", "--start", "0", "0", "0", "--goal", "1", "1", "0"], "give the option resolution"),
    ],
)
def test_options_that_do_not_apply_end_in_one_line(tmp_path, capsys, arguments, words):
    list(files(tmp_path))
    np.savetxt(tmp_path / "room.xyz", np.random.default_rng(0).random((500, 3)) * (4, 4, 0.01))
    assert main([argument.format(tmp_path) for argument in arguments]) == 1
    error = capsys.readouterr().err
    assert error.startswith("error: ") and error.count("\n") == 1 and words in error
