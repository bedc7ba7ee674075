"""ROS bags whose chunks, messages or files unpack without end."""

import bz2
import resource
from unittest import mock

import lz4.frame
import numpy as np
import pytest
from backports import zstd
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionMode

from hdsp.base.errors import InputError
from hdsp.terrain.height_map import HeightMap
from hdsp.terrain.map_formats import map_contents
from tests.terrain.bags import KINDS, fill, message, write_bag

HEIGHTS = np.random.default_rng(0).normal(size=(10, 8)).astype(np.float32)
#: Bytes of zeros that each bomb adds.
ZEROS = 3 << 28


def grid(version):
    return message(version, {"elevation": HEIGHTS}, shape=HEIGHTS.shape)


def refused(path, words, **options):
    """The one line of refusal, without much memory in this process or on the disk."""
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(InputError, match=words) as error:
        HeightMap.load(path, **options)
    assert "\n" not in str(error.value) and path.name in str(error.value)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 200_000  # kB


@pytest.mark.parametrize("kind", KINDS)
def test_a_process_of_its_own_reads_a_bag(tmp_path, kind):
    version = 1 if kind == "bag" else 2
    path = write_bag(tmp_path / "run", kind, {"/talk": ["hello"], "/map": [grid(version)] * 2})
    terrain = HeightMap.load(path)
    assert np.isin(terrain.heights, HEIGHTS).all() and terrain.shape == HEIGHTS.shape
    assert "/map (grid_map_msgs/msg/GridMap, 2 messages) with layers elevation" in map_contents(path)
    refused(path, "need an index from -2 to 1", message=2)


def lz4_bomb(data):
    size = {"block_size": lz4.frame.BLOCKSIZE_MAX4MB, "block_linked": False}
    packer = lz4.frame.LZ4FrameCompressor(auto_flush=True, **size)
    begin, whole, zeros = packer.begin(), packer.compress(data), packer.compress(bytes(1 << 22))
    return begin + whole + zeros * (ZEROS >> 22) + packer.flush()


def bz2_bomb(data):
    return bz2.compress(data) + bz2.compress(bytes(1 << 26)) * (ZEROS >> 26)


def zstd_bomb(data, pack=zstd.compress):
    return pack(data) + pack(bytes(1 << 28)) * (ZEROS >> 28)


def in_chunk(pack, name):
    def write(path):
        writer = Writer1(path.with_suffix(".bag"))
        writer.set_compression(Writer1.CompressionFormat[name])
        writer.compressor = pack
        with writer:
            fill(writer, {"/map": [grid(1)]}, 1)
        return path.with_suffix(".bag")

    return write


def in_message(path):
    with mock.patch.object(zstd, "compress", zstd_bomb):
        return write_bag(path, "db3", {"/map": [grid(2)]}, CompressionMode.MESSAGE)


def in_file(path):
    folder = write_bag(path, "mcap", {"/map": [grid(2)]}, CompressionMode.FILE)
    packed = next(folder.glob("*.zstd"))
    packed.write_bytes(zstd_bomb(zstd.decompress(packed.read_bytes())))
    return folder


@pytest.mark.parametrize(
    "write",
    [
        pytest.param(in_chunk(bz2_bomb, "BZ2"), id="bz2", marks=pytest.mark.nightly),
        pytest.param(in_chunk(lz4_bomb, "LZ4"), id="lz4"),
        pytest.param(in_message, id="message", marks=pytest.mark.nightly),
        pytest.param(in_file, id="file"),
    ],
)
def test_a_bag_that_unpacks_without_end_is_refused(tmp_path, write):
    path = write(tmp_path / "run")
    refused(path, "unpacks to more than 67,[0-9]{3},[0-9]{3} bytes, or claims to", max_cells=1000)
