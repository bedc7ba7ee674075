"""Height map files that lie about their size, refer to other files, or were changed by one bit."""

import io
import struct
import time
import zipfile
import zlib

import h5py
import numpy as np
import pytest

from hdsp.base import array_files
from hdsp.base.errors import InputError
from hdsp.terrain.height_map import HeightMap
from hdsp.terrain.map_frame import MapFrame

HEIGHTS = np.random.default_rng(0).normal(size=(10, 8)).astype(np.float32)
FRAME = MapFrame("odom", "EPSG:25832", notes=("a note",))
MAP = HeightMap(HEIGHTS, (1.25, 2.5), 0.05, FRAME)


def refused(path, words, **options):
    began = time.process_time()
    with pytest.raises(InputError, match=words) as error:
        HeightMap.load(path, **options)
    assert "\n" not in str(error.value) and path.name in str(error.value)
    assert time.process_time() - began < 2
    return str(error.value)


def same(one, other):
    frames = [(t.frame.name, t.frame.crs, t.frame.notes, t.frame.to_source.tolist()) for t in (one, other)]
    assert frames[0] == frames[1] and one.resolution == other.resolution
    assert tuple(one.origin) == tuple(other.origin)
    np.testing.assert_array_equal(one.heights, other.heights)


@pytest.mark.parametrize("suffix", [".npz", ".h5", ".tif"])
def test_h9_each_changed_bit_is_found_or_changes_nothing(tmp_path, suffix):
    path = MAP.save(tmp_path / f"map{suffix}")
    content, found = path.read_bytes(), 0
    for at in range(0, len(content), 11):
        damaged = bytearray(content)
        damaged[at] ^= 1 << (at // 11 % 8)
        path.write_bytes(damaged)
        try:
            same(HeightMap.load(path), MAP)
        except InputError:
            found += 1
    assert found > 0.3 * len(content) / 11


@pytest.mark.parametrize("suffix", [".npz", ".h5"])
def test_h9_files_of_earlier_versions_have_no_checksum_and_are_read(tmp_path, suffix, monkeypatch):
    arrays = {"heights": HEIGHTS, "origin": np.array([1.25, 2.5]), "resolution": np.array(0.05)}
    if suffix == ".npz":
        np.savez_compressed(tmp_path / "old.npz", **arrays)
    else:
        with h5py.File(tmp_path / "old.h5", "w") as file:
            for name, array in arrays.items():
                file[name] = array
    terrain = HeightMap.load(tmp_path / f"old{suffix}")
    np.testing.assert_array_equal(terrain.heights, HEIGHTS)
    assert tuple(terrain.origin) == (1.25, 2.5) and terrain.resolution == 0.05


def test_h9_a_geotiff_that_another_program_rewrote_is_read(tmp_path):
    import rasterio

    path = MAP.save(tmp_path / "map.tif")
    with rasterio.open(path, "r+") as raster:
        raster.update_tags(PROJECT="a note of another program")
    same(HeightMap.load(path), MAP)


def npz_with(name, array_bytes, **arrays):
    """An archive whose member claims to be larger than it is."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(f"{name}.npy", array_bytes)
        for other, array in arrays.items():
            part = io.BytesIO()
            np.save(part, array)
            archive.writestr(f"{other}.npy", part.getvalue())
    return buffer.getvalue()


def npy_header(shape, dtype="<f8"):
    buffer = io.BytesIO()
    np.lib.format.write_array_header_1_0(buffer, {"descr": dtype, "fortran_order": False, "shape": shape})
    return buffer.getvalue()


@pytest.mark.parametrize("shape", [(40_000, 20_000), (2**40, 2**40), (20_000, 20_000)])
def test_h7_an_archive_that_claims_gigabytes_is_refused_from_its_header(tmp_path, shape):
    content = npz_with("heights", npy_header(shape) + bytes(6_000_000), origin=np.zeros(2), resolution=np.array(0.05))
    (tmp_path / "map.npz").write_bytes(content)
    refused(tmp_path / "map.npz", "claims|damaged: an array")
    (tmp_path / "map.npy").write_bytes(npy_header(shape) + bytes(6_000))
    refused(tmp_path / "map.npy", "claims|damaged: an array", resolution=0.05)


def test_h7_the_limit_of_cells_can_be_lowered_and_raised(tmp_path):
    for suffix in (".npz", ".h5", ".tif"):
        path = MAP.save(tmp_path / f"map{suffix}")
        refused(path, r"claims 10 x 8 cells; at most 79 are read \(max_cells\)", max_cells=79)
        assert HeightMap.load(path, max_cells=80).shape == (10, 8)
    with pytest.raises(InputError, match="option max_cells is 0; need a positive whole number"):
        HeightMap.load(path, max_cells=0)


def test_an_archive_of_objects_is_not_unpickled(tmp_path):
    np.savez(tmp_path / "map.npz", heights=np.array([[{}]], object), origin=np.zeros(2), resolution=0.05)
    refused(tmp_path / "map.npz", "object")


def links(folder, how):
    """A map whose heights lie elsewhere."""
    with h5py.File(folder / "other.h5", "w") as file:
        file["secret"] = HEIGHTS
    with h5py.File(folder / "map.h5", "w") as file:
        file["origin"], file["resolution"] = (0.0, 0.0), 0.05
        if how == "external link":
            file["heights"] = h5py.ExternalLink("other.h5", "secret")
        elif how == "soft link":
            file["heights"] = h5py.SoftLink("/secret")
        elif how == "link of a group":
            file["grid"] = h5py.ExternalLink("other.h5", "/")
        elif how == "external storage":
            (folder / "raw.bin").write_bytes(HEIGHTS.tobytes())
            file.create_dataset("heights", HEIGHTS.shape, HEIGHTS.dtype, external=[("raw.bin", 0, HEIGHTS.nbytes)])
        else:
            layout = h5py.VirtualLayout(HEIGHTS.shape, HEIGHTS.dtype)
            layout[:] = h5py.VirtualSource("other.h5", "secret", HEIGHTS.shape)
            file.create_virtual_dataset("heights", layout)
    return folder / "map.h5"


@pytest.mark.parametrize("how", ["external link", "soft link", "link of a group", "external storage", "virtual"])
def test_hdf5_is_read_from_this_file_only(tmp_path, how):
    options = {"layer": "grid/secret"} if how == "link of a group" else {}
    refused(links(tmp_path, how), "is a link to|refers to other files", **options)


def hdf5_chunk(folder, raw, **options):
    """A map of one packed chunk with these bytes."""
    with h5py.File(folder / "map.h5", "w") as file:
        file["origin"], file["resolution"] = (0.0, 0.0), 0.05
        heights = file.create_dataset("heights", HEIGHTS.shape, HEIGHTS.dtype, chunks=HEIGHTS.shape, **options)
        heights.id.write_direct_chunk((0, 0), raw)
    return folder / "map.h5"


def test_chunks_of_hdf5_unpack_to_their_size(tmp_path):
    options = {"compression": "gzip"}
    path = hdf5_chunk(tmp_path, zlib.compress(HEIGHTS.tobytes()), **options)
    np.testing.assert_array_equal(HeightMap.load(path).heights, HEIGHTS)
    refused(hdf5_chunk(tmp_path, zlib.compress(bytes(3_000_000)), **options), "unpacks to more than its 320 bytes")
    refused(hdf5_chunk(tmp_path, bytes(9_000), **options), "9,000 bytes for a chunk of 320")
    whole = {"compression": "gzip", "shuffle": True, "fletcher32": True}
    with h5py.File(tmp_path / "whole.h5", "w") as file:
        file["origin"], file["resolution"] = (0.0, 0.0), 0.05
        file.create_dataset("heights", data=HEIGHTS, chunks=(5, 4), **whole)
    np.testing.assert_array_equal(HeightMap.load(tmp_path / "whole.h5").heights, HEIGHTS)


def test_files_with_thousands_of_entries_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(array_files, "MOST_ENTRIES", 3)
    np.savez(tmp_path / "map.npz", **{f"entry_{k}": np.zeros(1) for k in range(4)})
    refused(tmp_path / "map.npz", "more than 3 entries")


def test_pictures_that_claim_gigabytes_are_refused(tmp_path):
    header = struct.pack(">IIBBBBB", 60_000, 60_000, 8, 0, 0, 0, 0)

    def chunk(kind, body):
        return struct.pack(">I", len(body)) + kind + body + struct.pack(">I", zlib.crc32(kind + body))

    png = b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(bytes(9))) + chunk(b"IEND", b"")
    (tmp_path / "map.png").write_bytes(png)
    (tmp_path / "map.pgm").write_bytes(b"P5\n60000 60000\n255\n" + bytes(9))
    for name in ("map.png", "map.pgm"):
        refused(tmp_path / name, "claims|exceeds limit", resolution=0.05, scale=0.01)


def test_a_picture_of_few_bytes_with_many_pixels_is_refused_before_they_take_memory(tmp_path):
    (tmp_path / "map.pgm").write_bytes(b"P5\n9000 9000\n255\n" + bytes(900))
    refused(tmp_path / "map.pgm", "9000 x 9000 pixels in so short a file", resolution=0.05, scale=0.01)


def test_a_raster_that_claims_gigabytes_is_refused(tmp_path):
    (tmp_path / "map.asc").write_text("ncols 60000\nnrows 60000\nxllcorner 0\nyllcorner 0\ncellsize 1\n1 2 3\n")
    refused(tmp_path / "map.asc", "claims 60000 x 60000 cells")


def test_a_raster_with_parts_in_another_folder_is_refused(tmp_path, monkeypatch):
    import rasterio

    (tmp_path / "maps").mkdir()
    path = MAP.save(tmp_path / "maps" / "map.tif")
    files = property(lambda raster: [str(path), str(tmp_path / "elsewhere.ige")])
    monkeypatch.setattr(rasterio.io.DatasetReader, "files", files, raising=False)
    refused(path, "refers to .*elsewhere.ige, outside its folder")


def test_a_geotiff_whose_heights_another_program_changed_says_so(tmp_path):
    import rasterio

    path = MAP.save(tmp_path / "map.tif")
    with rasterio.open(path) as raster:
        profile, tags = raster.profile, raster.tags()
    with rasterio.open(path, "w", **profile) as raster:
        raster.write(HEIGHTS.T[::-1] + 1, 1)
        raster.update_tags(**tags)
    terrain = HeightMap.load(path)
    np.testing.assert_allclose(terrain.heights, HEIGHTS + 1, rtol=1e-6)
    assert any("differs from its checksum" in note for note in terrain.frame.notes)


@pytest.mark.parametrize("unknown", [False, True])
def test_a_geotiff_as_it_was_written_has_no_note(tmp_path, unknown):
    heights = np.where((np.arange(80).reshape(10, 8) == 7) & unknown, np.nan, HEIGHTS)
    path = HeightMap(heights, (412345.678, 5654321.123), 0.025).save(tmp_path / "map.tif")
    path.write_bytes(path.read_bytes()[:-78])  # without its last line
    assert HeightMap.load(path).frame.notes == ()


@pytest.mark.parametrize("option", ["resolution", "origin", "scale", "offset"])
def test_options_beyond_all_floats_are_refused(tmp_path, option):
    np.save(tmp_path / "map.npy", HEIGHTS)
    huge = 10**400
    with pytest.raises(InputError, match=f"option {option} is .*; need"):
        HeightMap.load(tmp_path / "map.npy", **{"resolution": 0.05, option: (huge, 0) if option == "origin" else huge})
    assert HeightMap.load(tmp_path / "map.npy", resolution=0.05, nodata=huge).shape == HEIGHTS.shape
