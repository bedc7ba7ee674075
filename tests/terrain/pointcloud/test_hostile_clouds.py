"""Point files that claim too much, abort their reader, or unpack without end."""

import bz2
import gzip
import io
import resource
import struct
import subprocess
import sys
import time

import laspy
import numpy as np
import pytest

from hdsp.base.errors import InputError
from hdsp.base.separate_process import array_from_process
from hdsp.terrain.pointcloud import read_points
from hdsp.terrain.pointcloud.depth import read_image
from tests import ROOT
from tests.terrain.pointcloud.test_cloud_files import octree_bytes


def refused(path, words, **options):
    """The one line of refusal, within seconds and without much memory."""
    began, before = time.process_time(), resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(InputError, match=words) as error:
        read_points(path, **options)
    assert "\n" not in str(error.value) and path.name in str(error.value)
    assert time.process_time() - began < 5
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 500_000  # kB
    return str(error.value)


def laz(points):
    header = laspy.LasHeader(point_format=3, version="1.2")
    header.scales, header.offsets = [1e-4] * 3, [0, 0, 0]
    file = laspy.LasData(header)
    file.xyz = points
    stream = io.BytesIO()
    file.write(stream, do_compress=True, laz_backend=laspy.LazBackend.Lazrs)
    return stream.getvalue()


CLOUD = np.random.default_rng(3).uniform(-5, 5, (3000, 3))


def test_h1_a_damaged_laz_file_under_a_limit_of_memory_leaves_the_process_alive(tmp_path):
    content, random = laz(CLOUD), np.random.default_rng(1)
    program = (
        "import resource, sys, hdsp\n"
        "from hdsp.terrain.pointcloud import read_points\n"
        "resource.setrlimit(resource.RLIMIT_AS, (4 << 30, 4 << 30))\n"
        "for path in sys.argv[1:]:\n"
        "    try:\n"
        "        print(len(read_points(path)))\n"
        "    except hdsp.InputError as error:\n"
        "        print(error)\n"
    )
    paths = [tmp_path / "whole.laz"]
    paths[0].write_bytes(content)
    header = struct.unpack_from("<I", content, 96)[0]
    for k in range(2):  # the table of chunks lies at the end, its place at the start of the points
        damaged = bytearray(content)
        for at in (header + k, header + 8 + 40 * k, len(content) - 1 - k):
            damaged[at] ^= int(random.integers(1, 256))
        paths.append(tmp_path / f"damaged_{k}.laz")
        paths[-1].write_bytes(damaged)
    done = subprocess.run(
        [sys.executable, "-c", program, *map(str, paths)], cwd=ROOT, capture_output=True, text=True, timeout=120
    )
    lines = done.stdout.splitlines()
    assert done.returncode == 0, done.stderr[-500:]
    assert len(lines) == 3 and lines[0] == "3000"
    assert all(line == "3000" or line.startswith("point cloud ") for line in lines[1:])


@pytest.mark.parametrize(
    ("body", "words"),
    [
        ("os.abort()", "its reader ended with SIGABRT"),
        ("raise SystemExit('damaged: said so')", "damaged: said so"),
        ("resource.setrlimit(resource.RLIMIT_CPU, (1, 2))\nwhile True: pass", "not read within 1 s of computing"),
        ("resource.setrlimit(resource.RLIMIT_AS, (1 << 28, 1 << 28))\nbytearray(1 << 30)", "MemoryError"),
    ],
)
def test_the_end_of_a_separate_process_is_one_line(tmp_path, body, words):
    (tmp_path / "program.py").write_text(f"import os, resource, sys\n{body}\n")
    with pytest.raises(ValueError, match=words) as error:
        array_from_process(tmp_path / "program.py", b"", 1 << 30, 1)
    assert "\n" not in str(error.value)


def test_h1_objects_from_a_separate_process_are_not_unpickled(tmp_path):
    (tmp_path / "program.py").write_text(
        "import sys, numpy as np\nnp.save(sys.argv[1], np.array([{}], dtype=object), allow_pickle=True)\n"
    )
    with pytest.raises(ValueError, match="allow_pickle"):
        array_from_process(tmp_path / "program.py", b"", 1 << 30, 5)


def test_h7_an_octree_of_thousands_of_large_leaves_is_counted_first(tmp_path):
    nodes = bytearray()

    def write(size):  # all eight children at each level, leaves of 64 smallest cells
        half = size // 2
        nodes.extend(struct.pack("<H", 0xAAAA if half == 64 else 0xFFFF))
        if half > 64:
            for _ in range(8):
                write(half)

    def deep(size):
        if size > 64 * 2**4:
            nodes.extend(struct.pack("<H", 3))
            deep(size // 2)
        else:
            write(size)

    deep(65536)
    head = octree_bytes([])[: octree_bytes([]).index(b"data\n") + 5]
    (tmp_path / "wide.bt").write_bytes(head + bytes(nodes))
    assert len(nodes) < 1300
    assert "97,550,336 occupied cells; at most 10,000,000" in refused(tmp_path / "wide.bt", "max_points")


@pytest.mark.parametrize("name", ["bomb.xyz.gz", "bomb.pcd.gz", "bomb.xyz.bz2"])
def test_h7_packed_files_stop_at_the_limit(tmp_path, name):
    pack = gzip.compress if name.endswith("gz") else bz2.compress
    lines = b"1.5 2.5 3.5\n" * 400_000
    (tmp_path / name).write_bytes(pack(lines))
    wanted = "lines; at most 100,000" if ".xyz" in name else "unpacks to more than 1,000,000 bytes"
    refused(tmp_path / name, wanted, max_points=100_000, max_bytes=10**9 if ".xyz" in name else 10**6)


def test_h7_limits_can_be_raised(tmp_path):
    (tmp_path / "a.xyz").write_bytes(b"1 2 3\n" * 50)
    refused(tmp_path / "a.xyz", "it has 50 lines; at most 49 are read", max_points=49)
    refused(tmp_path / "a.xyz", "it has 300 bytes; at most 299 are read", max_bytes=299)
    assert read_points(tmp_path / "a.xyz", max_points=50, max_bytes=300).shape == (50, 3)
    assert read_points(tmp_path / "a.xyz", max_points=50.0, max_bytes=np.int64(300)).shape == (50, 3)
    for value in (0, True, 1.5, "9"):
        with pytest.raises(InputError, match=f"max_points is {value!r}; need a positive whole number"):
            read_points(tmp_path / "a.xyz", max_points=value)


MANY = b"999999999999"
PCD = b"FIELDS x y z w\nSIZE 4 4 4 4\nTYPE F F F F\nCOUNT 1 1 1 %s\nWIDTH %s\nHEIGHT 1\nDATA binary\n"
PLY = (
    b"ply\nformat binary_little_endian 1.0\nelement face %s\nproperty list uchar int i\nelement vertex %s\n"
    b"property float x\nproperty float y\nproperty float z\nend_header\n"
)
VTK = b"# vtk DataFile Version 3.0\nt\nBINARY\nDATASET POLYDATA\nPOINTS %s float\n"
SCALES_AND_OFFSETS = struct.pack("<6d", 1, 1, 1, 0, 0, 0)
NUMBERS_OF_LAS = struct.pack("<HIIBHI", 227, 227, 0, 3, 34, 2**32 - 1) + bytes(20) + SCALES_AND_OFFSETS


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("width.pcd", PCD % (b"1", MANY)),
        ("count.pcd", PCD % (MANY, b"9")),
        ("vertices.ply", PLY % (b"0", MANY)),
        ("faces.ply", PLY % (MANY, b"1")),
        ("points.vtk", VTK % MANY),
        ("points.las", b"LASF" + bytes(90) + NUMBERS_OF_LAS + bytes(300)),
        ("line.xyz", b"[" * 200_000 + b"\n1 2 3\n"),
    ],
)
def test_h7_claims_in_headers_are_refused(tmp_path, name, content):
    (tmp_path / name).write_bytes(content)
    refused(tmp_path / name, "claims|cut off|rows|characters|cannot be read")


def test_a_picture_of_another_format_starts_no_program(tmp_path):
    (tmp_path / "depth.png").write_bytes(b"%!PS-Adobe-3.0 EPSF-3.0\n%%BoundingBox: 0 0 9 9\nshowpage\n")
    with pytest.raises(InputError, match="cannot be read"):
        read_image(tmp_path / "depth.png")


def test_a_picture_has_a_limit_of_pixels(tmp_path):
    from PIL import Image

    Image.fromarray(np.zeros((20, 30), np.uint8)).save(tmp_path / "depth.png")
    with pytest.raises(InputError, match="30 x 20 pixels; at most 599 are read"):
        read_image(tmp_path / "depth.png", max_pixels=599)
    assert read_image(tmp_path / "depth.png", max_pixels=600).shape == (20, 30)
