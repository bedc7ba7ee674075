"""Damaged files of every format: one line, or a map."""

import h5py
import numpy as np
import pytest
import rasterio
from affine import Affine
from PIL import Image

from hdsp.base.errors import InputError
from hdsp.terrain.height_map import HeightMap
from tests.terrain.bags import message, reading_here, write_bag

SHAPE = 10, 8
MUTATIONS = 200
HEIGHTS = np.random.default_rng(0).normal(size=SHAPE).astype(np.float32)
GREY = (np.abs(HEIGHTS) * 60).astype(np.uint8)
IMAGE = {"resolution": 0.05, "scale": 0.01}


def own(suffix):
    def write(folder):
        HeightMap(HEIGHTS, (1, 2), 0.05).save(folder / f"map{suffix}")
        return folder / f"map{suffix}"

    return write


def foreign_hdf5(folder):
    with h5py.File(folder / "map.h5", "w") as file:
        file["heights"], file["origin"], file["resolution"] = HEIGHTS, (1.0, 2.0), 0.05
    return folder / "map.h5"


def bare(folder):
    np.save(folder / "map.npy", HEIGHTS)
    return folder / "map.npy"


def foreign_geotiff(folder):
    transform = Affine(0.05, 0, 1, 0, -0.05, 2)
    with rasterio.open(
        folder / "map.tif", "w", driver="GTiff", width=SHAPE[0], height=SHAPE[1], count=1, dtype="float32",
        transform=transform, crs="EPSG:25832", nodata=-9999, compress="lzw",
    ) as file:  # fmt: skip
        file.write(HEIGHTS.T, 1)
    return folder / "map.tif"


def ascii_grid(folder):
    head = f"ncols {SHAPE[0]}\nnrows {SHAPE[1]}\nxllcorner 1\nyllcorner 2\ncellsize 0.05\nNODATA_value -9999\n"
    (folder / "map.asc").write_text(head + "\n".join(" ".join(f"{z:.3f}" for z in row) for row in HEIGHTS.T))
    return folder / "map.asc"


def image(suffix):
    def write(folder):
        Image.fromarray(GREY.T).save(folder / f"map{suffix}")
        return folder / f"map{suffix}"

    return write


def text_image(folder):
    head = f"P2\n{SHAPE[0]} {SHAPE[1]}\n255\n"
    (folder / "map.pgm").write_text(head + "\n".join(" ".join(map(str, row)) for row in GREY.T))
    return folder / "map.pgm"


def bag(kind):
    def write(folder):
        items = [message(1 if kind == "bag" else 2, {"elevation": HEIGHTS}, shape=SHAPE)] * 2
        written = write_bag(folder / "run", kind, {"/map": items})
        return written if written.is_file() else next(written.glob(f"*.{kind}"))

    return write


def description_of_bag(folder):
    return (
        write_bag(folder / "run", "mcap", {"/map": [message(2, {"elevation": HEIGHTS}, shape=SHAPE)]}) / "metadata.yaml"
    )


KINDS = {
    "npz": (own(".npz"), {}),
    "h5": (own(".h5"), {}),
    "h5 of others": (foreign_hdf5, {}),
    "npy": (bare, {"resolution": 0.05}),
    "tif": (own(".tif"), {}),
    "tif of others": (foreign_geotiff, {}),
    "asc": (ascii_grid, {}),
    "png": (image(".png"), IMAGE),
    "pgm": (image(".pgm"), IMAGE),
    "pgm as text": (text_image, IMAGE),
    "bag": (bag("bag"), {}),
    "db3": (bag("db3"), {}),
    "mcap": (bag("mcap"), {}),
    "db3 without definitions": (bag("old"), {}),
    "metadata of a bag": (description_of_bag, {}),
}


def mutated(content, random):
    """Bytes after one damage: cut off, up to three bytes changed, bytes inserted or removed."""
    kind, place = random.integers(4), int(random.integers(len(content)))
    if kind == 0:
        return content[:place]
    if kind == 1:
        changed = bytearray(content)
        for at in random.integers(0, len(content), int(random.integers(1, 4))):
            changed[at] ^= int(random.integers(1, 256))
        return bytes(changed)
    length = int(random.integers(1, 9))
    if kind == 2:
        return content[:place] + bytes(random.integers(0, 256, length).astype(np.uint8)) + content[place:]
    return content[:place] + content[place + length :]


@pytest.mark.parametrize("kind", KINDS)
def test_a_damaged_file_gives_one_line_or_a_map(tmp_path, capfd, kind):
    write, options = KINDS[kind]
    path = write(tmp_path)
    place = path.parent if path.name == "metadata.yaml" else path
    content, random = path.read_bytes(), np.random.default_rng(15)
    assert HeightMap.load(place, **options).shape == SHAPE
    refused = 0
    for damage in [b"", *(mutated(content, random) for _ in range(MUTATIONS))]:
        path.write_bytes(damage)
        try:
            with reading_here():
                terrain = HeightMap.load(place, **options)
        except InputError as error:
            assert place.name in str(error) and "\n" not in str(error)
            refused += 1
        else:
            assert terrain.heights.dtype == np.float32 and terrain.heights.ndim == 2
    assert refused >= MUTATIONS / 5  # the damage reached the reader
    assert capfd.readouterr().err == ""
