import math
import struct
import zipfile
import zlib

import h5py
import imageio.v3 as imageio
import numpy as np
import pytest
import rasterio
import tifffile
from affine import Affine
from PIL import Image

from hdsp.base.errors import InputError
from hdsp.terrain.height_map import HeightMap
from hdsp.terrain.map_formats import MapFields, MapFormat, ReadOptions, map_contents, registry
from hdsp.terrain.map_frame import MapFrame
from tests.terrain.rasters import HEIGHTS, NORTH_UP, PICTURE, equal, geotiff

RANDOM = np.random.default_rng(7)


def test_m7_a_geotiff_keeps_its_place_and_crs(tmp_path):
    terrain = HeightMap.load(geotiff(tmp_path / "a.tif", crs="EPSG:25832"))
    assert equal(terrain, HEIGHTS, (100, 199)) and terrain.frame.crs == "EPSG:25832" and terrain.frame.is_source
    assert terrain.height_at(101.2, 199.7) == 3


@pytest.mark.parametrize(
    ("transform", "heights", "origin"),
    [
        (Affine(0.5, 0, 0, 0, 0.5, 0), [[1, 4], [2, 5], [3, 6]], (0, 0)),
        (Affine(-0.5, 0, 0, 0, -0.5, 0), [[6, 3], [5, 2], [4, 1]], (-1.5, -1)),
        (Affine(-0.5, 0, 0, 0, 0.5, 0), [[3, 6], [2, 5], [1, 4]], (-1.5, 0)),
    ],
)
def test_m7_rasters_with_other_axes_are_flipped(tmp_path, transform, heights, origin):
    assert equal(HeightMap.load(geotiff(tmp_path / "a.tif", transform=transform)), heights, origin)


@pytest.mark.parametrize("degrees", [30, 90, -120])
def test_m7_a_rotated_raster_has_a_rotated_frame(tmp_path, degrees):
    transform = Affine.translation(10, 20) @ Affine.rotation(degrees) @ Affine.scale(0.5, -0.5)
    terrain = HeightMap.load(geotiff(tmp_path / "a.tif", transform=transform))
    for row in range(2):
        for column in range(3):
            x, y, _ = terrain.frame.points_from_source([*(transform @ (column + 0.5, row + 0.5)), 0.0])
            assert terrain.height_at(x, y) == PICTURE[row, column]
    assert f"axes rotated by {degrees:.2f} degrees" in terrain.frame.notes


def test_m7_no_data_masks_scale_offset_and_units_of_a_raster_count(tmp_path):
    unknown = [[4, math.nan], [5, 2], [6, 3]]
    assert equal(HeightMap.load(geotiff(tmp_path / "a.tif", nodata=1)), unknown, (100, 199))
    mask = np.array([[False, True, True], [True, True, True]])
    assert equal(HeightMap.load(geotiff(tmp_path / "b.tif", mask=mask)), unknown, (100, 199))
    whole = PICTURE.astype(np.int16)
    terrain = HeightMap.load(geotiff(tmp_path / "c.tif", whole, tags={"scales": (0.01,), "offsets": (2,)}))
    assert (
        equal(terrain, np.array(HEIGHTS) * 0.01 + 2, (100, 199))
        and "heights times 0.01 plus 2" in terrain.frame.notes[0]
    )
    whole[0, 0] = -32768
    terrain = HeightMap.load(geotiff(tmp_path / "f.tif", whole, tags={"scales": (0.01,)}), nodata=6)
    assert equal(terrain, np.array([[4, math.nan], [5, 2], [math.nan, 3]]) * 0.01, (100, 199))
    whole[0, 0] = 1
    terrain = HeightMap.load(geotiff(tmp_path / "d.tif", whole, tags={"units": ("ft",)}))
    assert equal(terrain, np.array(HEIGHTS) * 0.3048, (100, 199)) and "from ft to metres" in terrain.frame.notes[0]
    terrain = HeightMap.load(geotiff(tmp_path / "e.tif", whole, tags={"units": ("cubits",)}))
    assert "unknown vertical units 'cubits', taken as metres" in terrain.frame.notes


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ({"transform": Affine(0.5, 0, 0, 0, -0.25, 0)}, r"pixels are 0\.5 x 0\.25 m; need squares"),
        ({"transform": Affine(0.5, 0.2, 0, 0, -0.5, 0)}, "need squares"),
        ({"rows": np.stack([PICTURE, PICTURE])}, "it has 2 bands: 1, 2; name one with the option layer"),
        ({"rows": PICTURE.astype(complex)}, "band 1 has the type complex128; need numbers"),
    ],
)
def test_m7_rasters_without_a_right_reading_are_refused(tmp_path, more, words):
    with pytest.raises(InputError, match=words) as error:
        HeightMap.load(geotiff(tmp_path / "a.tif", **more))
    assert "\n" not in str(error.value)


def test_m7_an_alpha_band_is_a_mask(tmp_path):
    path = tmp_path / "a.tif"
    shape = {"count": 2, "height": 2, "width": 3, "dtype": "uint8"}
    with rasterio.open(
        path, "w", driver="GTiff", transform=NORTH_UP, photometric="MINISBLACK", alpha="YES", **shape
    ) as file:
        file.write(np.stack([PICTURE, [[0, 255, 255], [255, 255, 255]]]).astype(np.uint8))
    assert equal(HeightMap.load(path), [[4, math.nan], [5, 2], [6, 3]], (100, 199))


def test_m7_a_geotiff_of_another_library_is_placed_by_its_tags(tmp_path):
    scale, tie = (33550, "d", 3, (0.5, 0.5, 0.0)), (33922, "d", 6, (0.0, 0.0, 0.0, 100.0, 200.0, 0.0))
    keys = (34735, "H", 12, (1, 1, 0, 2, 1024, 0, 1, 1, 1025, 0, 1, 1))  # projected, pixels are areas
    nodata = (42113, "s", 0, "6")
    tifffile.imwrite(
        tmp_path / "a.tif", PICTURE.astype(np.float32), extratags=[(*tag, True) for tag in (scale, tie, keys, nodata)]
    )
    assert equal(HeightMap.load(tmp_path / "a.tif"), [[4, 1], [5, 2], [math.nan, 3]], (100, 199))


def test_m7_a_band_is_chosen_by_number_or_name(tmp_path):
    path = geotiff(tmp_path / "a.tif", np.stack([-PICTURE, PICTURE]), tags={"descriptions": ("slope", "dem")})
    assert equal(HeightMap.load(path, layer="dem"), HEIGHTS, (100, 199))
    assert equal(HeightMap.load(path, layer=2), HEIGHTS, (100, 199))
    with pytest.raises(InputError, match=r"need a band: 1 \(slope\), 2 \(dem\)"):
        HeightMap.load(path, layer="height")
    assert "bands 1 (float64, slope), 2 (float64, dem)" in map_contents(path)


@pytest.mark.parametrize("dtype", [np.float32, np.uint16])
def test_m7_a_tiff_without_place_needs_its_cell_size(tmp_path, dtype):
    tifffile.imwrite(tmp_path / "a.tiff", PICTURE.astype(dtype))
    with pytest.raises(InputError, match="give the option resolution"):
        HeightMap.load(tmp_path / "a.tiff")
    assert equal(HeightMap.load(tmp_path / "a.tiff", resolution=0.5), HEIGHTS)
    assert equal(
        HeightMap.load(tmp_path / "a.tiff", resolution=0.5, origin=(1, 2), scale=0.1), np.array(HEIGHTS) / 10, (1, 2)
    )
    with pytest.raises(InputError, match="resolution does not apply: the file has its own transform"):
        HeightMap.load(geotiff(tmp_path / "b.tif"), resolution=0.5)


HEAD = "ncols 3\nnrows 2\nxllcorner 10\nyllcorner 20\ncellsize 0.5\n"
CENTRED = HEAD.replace("llcorner 10", "llcenter 10.25").replace("llcorner 20", "llcenter 20.25")


@pytest.mark.parametrize(
    "text",
    [
        (HEAD + "NODATA_value -9999\n1 -9999 3\n4 5 6\n").encode(),
        (HEAD + "1 -9999 3\n4 5 6\n").encode(),  # ESRI's default
        (HEAD.upper().replace("\n", "\r\n") + "NODATA_VALUE 99\r\n1 99 3\r\n4 5 6").encode(),
        (CENTRED + "1 nan 3\n4 5 6\n").encode(),
        (HEAD.replace(".", ",") + "NODATA_value -1\n1,0 -1 3,0\n4 5 6\n").encode(),
        ("\ufeff" + HEAD + "1 -9999 3\n4 5 6\n").encode("utf-8"),
        ("\ufeff" + HEAD + "1 -9999 3\n4 5 6\n").encode("utf-16-le"),
        b"north: 21\nsouth: 20\neast: 11.5\nwest: 10\nrows: 2\ncols: 3\nnull: 7\n1 7 3\n4 5 6\n",
    ],
    ids=["esri", "no nodata", "capitals", "centres", "commas", "utf-8 mark", "utf-16", "grass"],
)
def test_m7_ascii_grids_of_every_spelling_are_read(tmp_path, text):
    (tmp_path / "a.ASC").write_bytes(text)
    assert equal(HeightMap.load(tmp_path / "a.ASC"), [[4, 1], [5, math.nan], [6, 3]], (10, 20))


@pytest.mark.parametrize(
    "body",
    [
        "1 x 3\n4 5 6",
        "1 2 3\n4 5",
        "1 2 3\n4 5 6 7",
        "1 2 3\n4 5.5.5 6",
        "1;2;3\n4;5;6",
        "",
        "1 2-3\n4 5 6",
        "1 2 3\n4 5_0 6",
    ],
)
def test_ascii_grids_with_words_amid_or_too_few_numbers_are_refused(tmp_path, body):
    (tmp_path / "a.asc").write_text(HEAD + body)
    with pytest.raises(InputError, match=r"a\.asc"):
        HeightMap.load(tmp_path / "a.asc")


def test_m7_the_crs_beside_an_ascii_grid_counts(tmp_path):
    (tmp_path / "a.asc").write_text(HEAD + "1 2 3\n4 5 6\n")
    (tmp_path / "a.prj").write_text(rasterio.CRS.from_epsg(25833).to_wkt(version="WKT1_ESRI"))
    assert (
        "25833" in HeightMap.load(tmp_path / "a.asc").frame.crs or "33N" in HeightMap.load(tmp_path / "a.asc").frame.crs
    )
    (tmp_path / "a.prj").write_text(rasterio.CRS.from_epsg(4326).to_wkt(version="WKT1_ESRI"))
    with pytest.raises(InputError, match="in degrees"):
        HeightMap.load(tmp_path / "a.asc")


def pgm(head, values, dtype=None):
    body = values.astype(dtype).tobytes() if dtype else "\n".join(" ".join(map(str, row)) for row in values).encode()
    return head.encode() + body


WHOLE = PICTURE.astype(int)


@pytest.mark.parametrize(
    "content",
    [
        pgm("P5\n# by hand\n3 2\n255\n", WHOLE, "u1"),
        pgm("P5\n3 2\n65535\n", WHOLE, ">u2"),
        pgm("P5\n3 2\n1000\n", WHOLE, ">u2"),
        pgm("P2\n3 2\n9\n", WHOLE),
        pgm("P2\n3 2\n4095\n", WHOLE),
    ],
    ids=["8 bit", "16 bit", "to 1000", "text to 9", "text to 4095"],
)
def test_m7_grey_values_of_a_pgm_are_heights(tmp_path, content):
    (tmp_path / "a.pgm").write_bytes(content)
    terrain = HeightMap.load(tmp_path / "a.pgm", resolution=0.5, scale=0.1, offset=-1, nodata=6, origin=(3, 4))
    assert equal(terrain, [[-0.6, -0.9], [-0.5, -0.8], [math.nan, -0.7]], (3, 4))


def test_grey_values_that_are_floats_are_refused(tmp_path):
    (tmp_path / "a.pgm").write_bytes(b"Pf\n3 2\n-1.0\n" + PICTURE.astype("<f4").tobytes())
    with pytest.raises(InputError, match=r"its grey values are floats \(Pf\); need whole numbers"):
        HeightMap.load(tmp_path / "a.pgm", resolution=0.5, scale=1)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_m7_grey_values_of_a_png_are_heights(tmp_path, dtype):
    values = PICTURE.astype(dtype) * (1 if dtype == np.uint8 else 1000)
    imageio.imwrite(tmp_path / "a.png", values)
    step = 0.1 if dtype == np.uint8 else 0.0001
    assert equal(HeightMap.load(tmp_path / "a.png", resolution=0.5, scale=step), np.array(HEIGHTS) / 10)
    colour = np.stack([values, values, values], axis=-1).astype(np.uint8)
    opaque = np.array([[0, 255, 255], [255, 255, 255]], np.uint8)
    imageio.imwrite(tmp_path / "b.png", np.dstack([colour, opaque]))
    terrain = HeightMap.load(tmp_path / "b.png", resolution=0.5, scale=1)
    assert math.isnan(terrain.heights[0, 1]) and np.isfinite(terrain.heights).sum() == 5
    imageio.imwrite(tmp_path / "c.png", colour * np.array([1, 2, 3], np.uint8))
    with pytest.raises(InputError, match="it is a colour image"):
        HeightMap.load(tmp_path / "c.png", resolution=0.5, scale=1)


def test_m7_an_image_needs_its_cell_size_and_its_step(tmp_path):
    Image.fromarray(PICTURE.astype(np.uint8)).save(tmp_path / "a.png")
    for options, name in (({}, "resolution"), ({"resolution": 0.5}, "scale"), ({"scale": 1}, "resolution")):
        with pytest.raises(InputError, match=f"give the option {name}"):
            HeightMap.load(tmp_path / "a.png", **options)
    with pytest.raises(InputError, match="option layer does not apply to PNG; need one of resolution, origin, scale"):
        HeightMap.load(tmp_path / "a.png", layer=1)


@pytest.mark.parametrize("dtype", ["f4", "f8", ">f8", "f2", "i2", "u1"])
@pytest.mark.parametrize("order", ["C", "F"])
def test_m7_a_bare_array_is_read_with_its_cell_size(tmp_path, dtype, order):
    np.save(tmp_path / "a.npy", np.asarray(HEIGHTS, dtype, order=order))
    with pytest.raises(InputError, match="a bare array has no cell size; give the option resolution"):
        HeightMap.load(tmp_path / "a.npy")
    assert equal(HeightMap.load(tmp_path / "a.npy", resolution=0.5, origin=(1, 2)), HEIGHTS, (1, 2))


def test_arrays_that_are_no_heights_are_refused(tmp_path):
    others = np.zeros(3), np.zeros((2, 2, 2)), np.zeros((2, 2), bool), np.zeros((2, 2), "O"), np.zeros((0, 2))
    for k, array in enumerate(others):
        np.save(tmp_path / f"{k}.npy", array, allow_pickle=True)
        with pytest.raises(InputError, match=f"{k}.npy: "):
            HeightMap.load(tmp_path / f"{k}.npy", resolution=1)


def test_archives_of_other_programs_are_read_with_options(tmp_path):
    np.savez(tmp_path / "a.npz", dem=HEIGHTS, mask=np.zeros((3, 2), bool))
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["group/dem"] = HEIGHTS
        file["mask"] = np.zeros((3, 2), bool)
    for name, layer, known in (("a.npz", "dem", "dem, mask"), ("a.h5", "group/dem", "group/dem, mask")):
        path = tmp_path / name
        with pytest.raises(InputError, match=f"entry heights is missing, it has {known}; the option layer names"):
            HeightMap.load(path)
        with pytest.raises(InputError, match=r"option layer .*option resolution, .*option origin, "):
            HeightMap.load(path)
        with pytest.raises(InputError, match=r"(npz|h5): entry resolution is missing; give .*unless it is \(0, 0\)"):
            HeightMap.load(path, layer=layer)
        assert equal(HeightMap.load(path, layer=layer, resolution=0.5), HEIGHTS, (0, 0))
        with pytest.raises(InputError, match="entry mask is bool"):
            HeightMap.load(path, layer="mask", resolution=0.5, origin=(1, 2))
        assert equal(HeightMap.load(path, layer=layer, resolution=0.5, origin=(1, 2)), HEIGHTS, (1, 2))
        assert f"{layer} int64 [3, 2]" in map_contents(path)
    HeightMap(HEIGHTS).save(tmp_path / "own.h5")
    with pytest.raises(InputError, match=r"resolution does not apply: the file has its own resolution, 0\.025"):
        HeightMap.load(tmp_path / "own.h5", resolution=0.05)


@pytest.mark.parametrize("suffix", [".npz", ".h5", ".tif", ".TIFF", ".NPZ", ".Hdf5"])
def test_m19_maps_come_back_from_each_format_with_their_frame(tmp_path, suffix):
    motion = np.eye(4)
    motion[:2, :2], motion[:3, 3] = [[0, -1], [1, 0]], (1, 2, 3)
    heights = np.array(HEIGHTS, np.float32)
    heights[1, 1] = math.nan
    levelled = MapFrame("odom", "EPSG:25832", motion, ("tilt of 2 degrees removed",))
    for frame in (MapFrame(), levelled, MapFrame(crs="EPSG:25832")):
        HeightMap(heights, (1.5, -2.25), 0.05, frame).save(tmp_path / f"map{suffix}")
        terrain = HeightMap.load(tmp_path / f"map{suffix}")
        assert equal(terrain, heights, (1.5, -2.25), 0.05)
        assert (terrain.frame.name, terrain.frame.crs, terrain.frame.notes) == (frame.name, frame.crs, frame.notes)
        np.testing.assert_array_equal(terrain.frame.to_source, frame.to_source)


def test_a_saved_geotiff_is_one_for_other_programs(tmp_path):
    HeightMap(HEIGHTS, (100, 199), 0.5, MapFrame(crs="EPSG:25832")).save(tmp_path / "map.tif")
    with rasterio.open(tmp_path / "map.tif") as file:
        np.testing.assert_array_equal(file.read(1), PICTURE)
        assert file.transform.almost_equals(NORTH_UP) and file.crs.to_epsg() == 25832 and math.isnan(file.nodata)


def test_a_map_that_another_program_reprojected_has_the_new_crs(tmp_path):
    HeightMap(HEIGHTS, (100, 199), 0.5, MapFrame("odom", "EPSG:25832")).save(tmp_path / "map.tif")
    with rasterio.open(tmp_path / "map.tif", "r+") as file:
        file.crs = "EPSG:25833"
    frame = HeightMap.load(tmp_path / "map.tif").frame
    assert (frame.name, frame.crs) == ("odom", "EPSG:25833")


def test_an_empty_file_is_called_so(tmp_path):
    for suffix in registry.MAP_SUFFIXES:
        (tmp_path / f"map{suffix}").touch()
        with pytest.raises(InputError, match="the file is empty"):
            HeightMap.load(tmp_path / f"map{suffix}")


@pytest.mark.parametrize("value", [-9999, -32768, -3.4028234663852886e38, 1e20, math.inf, -math.inf])
def test_obvious_no_data_values_become_unknown_and_are_named(tmp_path, value):
    heights = np.full((4, 5), 412.25)
    heights[1, 2], heights[3, 4] = value, 413
    np.savez(tmp_path / "a.npz", heights=heights, origin=(0, 0), resolution=0.1)
    terrain = HeightMap.load(tmp_path / "a.npz")
    assert np.argwhere(np.isnan(terrain.heights)).tolist() == [[1, 2]]
    assert terrain.frame.notes == (f"taken as unknown: the no-data value {value:g} of 1 cell",)


def test_a_no_data_value_amid_heights_is_a_height(tmp_path):
    heights = np.linspace(-1200, 300, 400).reshape(20, 20).round()
    heights[3, 3] = -999
    np.save(tmp_path / "mm.npy", heights)
    terrain = HeightMap.load(tmp_path / "mm.npy", resolution=0.1, scale=0.001)
    assert terrain.heights[3, 3] == pytest.approx(-0.999) and terrain.frame.notes == ("heights times 0.001",)


@pytest.mark.parametrize(
    ("option", "words"),
    [
        ({"resolution": 0}, "option resolution is 0; need a positive number"),
        ({"scale": 0}, "option scale is 0; need a non-zero number"),
        ({"scale": "mm"}, "option scale is 'mm'"),
        ({"origin": (1, math.nan)}, "option origin"),
        ({"origin": 3}, "option origin is 3; need two numbers"),
        ({"origin": "12"}, "option origin is '12'; need two finite numbers"),
        ({"origin": (True, 2)}, r"option origin is \[True, 2\]"),
        ({"message": 1.5}, "option message is 1.5"),
        ({"message": True}, "option message is True"),
        ({"max_cells": np.True_}, "option max_cells is "),
        ({"nodata": "none"}, "option nodata is 'none'"),
        ({"nodata": True}, "option nodata is True"),
        ({"offset": math.inf}, "option offset is inf"),
        (
            {"units": 1},
            "option units: unknown; need one of resolution, origin, scale, offset, nodata, layer,",
        ),
    ],
)
def test_wrong_options_are_named(tmp_path, option, words):
    with pytest.raises(InputError, match=words):
        HeightMap.load(tmp_path / "any.npy", **option)


def test_options_are_numbers_of_any_type():
    options = ReadOptions(np.float32(0.5), np.array([1, 2]), np.int8(2), message=np.int64(-1), max_cells=1e6)
    assert options == ReadOptions(0.5, (1.0, 2.0), 2.0, message=-1, max_cells=1_000_000)
    assert {type(value) for value in (options.message, options.max_cells)} == {int}
    assert math.isnan(ReadOptions(nodata=math.nan).nodata)


@pytest.mark.parametrize("path", [3, ("map.npz",), b"map.npz", "a" * 5000 + ".npz"])
def test_paths_that_are_none_are_refused(path):
    with pytest.raises(InputError, match="path of a map"):
        HeightMap.load(path)


def claiming(kind, path):
    """A small file with a claim of about 10^11 cells."""
    side = 300_000
    if kind == "npy" or kind == "npz":
        head = f"{{'descr': '<f4', 'fortran_order': False, 'shape': ({side}, {side}), }}".ljust(117) + "\n"
        array = b"\x93NUMPY\x01\x00" + struct.pack("<H", len(head)) + head.encode() + bytes(64)
        if kind == "npy":
            path.write_bytes(array)
            return
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("heights.npy", array)
    elif kind == "h5":
        with h5py.File(path, "w") as file:
            file.create_dataset("heights", (side, side), "f4", chunks=(100, 100))
            file["origin"], file["resolution"] = (0.0, 0.0), 0.1
    elif kind == "tif":
        sparse = {"width": side, "height": side, "count": 1, "dtype": "float32", "tiled": True, "sparse_ok": True}
        with rasterio.open(path, "w", driver="GTiff", transform=NORTH_UP, BIGTIFF="YES", **sparse):
            pass
    elif kind == "asc":
        path.write_text(HEAD.replace(" 3\n", f" {side}\n").replace(" 2\n", f" {side}\n") + "1 2 3\n")
    elif kind == "pgm":
        path.write_bytes(f"P5\n{side} {side}\n255\n".encode() + bytes(64))
    else:
        Image.fromarray(np.zeros((2, 2), np.uint8)).save(path)
        content = path.read_bytes()
        head = content[12:16] + struct.pack(">II", side, side) + content[24:29]
        path.write_bytes(content[:12] + head + struct.pack(">I", zlib.crc32(head)) + content[33:])


@pytest.mark.parametrize("kind", ["npy", "npz", "h5", "tif", "asc", "pgm", "png"])
def test_h7_a_claim_of_absurd_size_is_refused_before_memory_is_taken(tmp_path, kind):
    path = tmp_path / f"a.{kind}"
    claiming(kind, path)
    options = {"resolution": 0.1} if kind in ("npy", "pgm", "png") else {}
    options |= {"scale": 1.0} if kind in ("pgm", "png") else {}
    with pytest.raises(InputError, match=r"at most 100,000,000 are read|it is damaged|cannot be read"):
        HeightMap.load(path, **options)


def test_a_missing_library_is_named_before_any_work(tmp_path, monkeypatch):
    geotiff(tmp_path / "a.tif")
    monkeypatch.setattr(registry.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"a\.tif: GeoTIFF needs rasterio: pip install 'hdsp\[maps\]'"):
        HeightMap.load(tmp_path / "a.tif")
    with pytest.raises(InputError, match=r"b\.tif: GeoTIFF needs rasterio: pip install 'hdsp\[maps\]'"):
        HeightMap.flat((2, 2)).save(tmp_path / "b.tif")


def test_formats_of_other_packages_are_found_by_entry_point(tmp_path, monkeypatch):
    def read(path, options):
        return MapFields(np.full((2, 2), float(path.read_text())), (0.0, 0.0), 0.1)

    class Point:
        name = "height"

        def load(self):
            return MapFormat("one height", read, lambda path: "a number")

    monkeypatch.setattr(registry, "entry_points", lambda group: [Point()] if group == "hdsp.map_formats" else [])
    registry._added.cache_clear()
    try:
        (tmp_path / "a.height").write_text("1.5")
        assert (HeightMap.load(tmp_path / "a.height").heights == 1.5).all()
        assert map_contents(tmp_path / "a.height") == "one height, a number"
    finally:
        registry._added.cache_clear()


@pytest.mark.parametrize("head", ["", "x y z\n", "# from a scanner\n", "\ufeffX;Y;Z;I\n"])
def test_m7_an_asc_file_of_points_is_a_cloud(tmp_path, head):
    x, y = np.meshgrid(np.arange(0, 2, 0.02), np.arange(0, 1, 0.02), indexing="ij")
    z = 0.001 * RANDOM.normal(size=x.shape)
    lines = [f"{a:.3f};{b:.3f};{c:.4f};7" for a, b, c in zip(x.ravel(), y.ravel(), z.ravel(), strict=True)]
    (tmp_path / "cloud.asc").write_text(head + "\n".join(lines), encoding="utf-8")
    terrain = HeightMap.load(tmp_path / "cloud.asc")
    assert terrain.size == pytest.approx((2, 1), abs=0.06) and np.nanmax(np.abs(terrain.heights)) < 0.01
