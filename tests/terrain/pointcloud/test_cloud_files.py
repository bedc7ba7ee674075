import bz2
import gzip
import struct
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import hdsp
from hdsp.base.errors import InputError
from hdsp.terrain.pointcloud import read_points
from hdsp.terrain.pointcloud.octree import read_octree
from tests.terrain.pointcloud.clouds import room

POINTS = np.random.default_rng(0).uniform(-5, 5, (50, 3)).astype(np.float32)


def write_pcd(path, points, encoding="binary_compressed"):
    pypcd4 = pytest.importorskip("pypcd4")
    kind = pypcd4.Encoding(encoding)
    pypcd4.PointCloud.from_xyz_points(np.asarray(points, np.float32)).save(path, encoding=kind)


def write_ply(path, points):
    header = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\n"
    header += "property float x\nproperty float y\nproperty float z\nproperty uchar red\nend_header\n"
    path.write_bytes(header.encode() + b"".join(struct.pack("<fffB", *point, 7) for point in points))


def write_obj(path, points):
    path.write_text("".join(f"v {x:.7f} {y:.7f} {z:.7f}\n" for x, y, z in points))


def write_las(path, points):
    laspy = pytest.importorskip("laspy")
    header = laspy.LasHeader(point_format=0, version="1.2")
    header.scales, header.offsets = [1e-6] * 3, [0.0] * 3
    las = laspy.LasData(header)
    las.x, las.y, las.z = np.asarray(points, float).T
    las.write(path)


def vtk_text(points, encoding="ASCII", kind="float"):
    head = f"# vtk DataFile Version 3.0\nscan\n{encoding}\nDATASET POLYDATA\nPOINTS {len(points)} {kind}\n".encode()
    if encoding == "BINARY":
        return head + np.asarray(points).astype(">f8" if kind == "double" else ">f4").tobytes() + b"\nVERTICES 1 2\n"
    return head + "\n".join(" ".join(f"{v:.7f}" for v in p) for p in points).encode() + b"\nVERTICES 1 2\n1 0\n"


def write_text(path, points):
    path.write_text("# x, y, z, strength\n" + "".join(f"{x:.7f}, {y:.7f}, {z:.7f}, 3\n" for x, y, z in points))


WRITERS = {
    "ascii.pcd": lambda path, points: write_pcd(path, points, "ascii"),
    "binary.pcd": lambda path, points: write_pcd(path, points, "binary"),
    "compressed.pcd": write_pcd,
    "cloud.ply": write_ply,
    "cloud.las": write_las,
    "cloud.laz": write_las,
    "ascii.vtk": lambda path, points: path.write_bytes(vtk_text(points)),
    "binary.vtk": lambda path, points: path.write_bytes(vtk_text(points, "BINARY")),
    "double.vtk": lambda path, points: path.write_bytes(vtk_text(points, "BINARY", "double")),
    "cloud.csv": write_text,
    "cloud.XYZ": write_text,
    "cloud.obj": write_obj,
}


@pytest.mark.parametrize("name", WRITERS)
def test_each_format_gives_the_points_that_were_written(tmp_path, name):
    WRITERS[name](tmp_path / name, POINTS)
    points = read_points(tmp_path / name)
    assert points.dtype == np.float64
    np.testing.assert_allclose(points, POINTS, atol=2e-6)


@pytest.mark.parametrize("name", [name for name in WRITERS if name not in ("cloud.csv", "cloud.XYZ", "cloud.obj")])
def test_files_that_are_cut_off_end_in_one_line_that_names_them(tmp_path, name):
    WRITERS[name](tmp_path / name, POINTS)
    whole = (tmp_path / name).read_bytes()
    for share in (0.0, 0.02, 0.3, 0.6):
        (tmp_path / name).write_bytes(whole[: int(share * len(whole))])
        with pytest.raises(InputError, match=name) as error:
            read_points(tmp_path / name)
        assert "\n" not in str(error.value)


def test_headers_without_a_viewpoint_and_of_the_old_version_are_read(tmp_path):
    head = "VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 2\nHEIGHT 1\nPOINTS 2\nDATA ascii\n"
    (tmp_path / "old.pcd").write_text("# .PCD v.7 - Point Cloud Data file format\n" + head + "1 2 3\nnan nan nan\n")
    np.testing.assert_allclose(read_points(tmp_path / "old.pcd"), [[1, 2, 3]])


@pytest.mark.parametrize(("suffix", "pack"), [(".gz", gzip.compress), (".bz2", bz2.compress)])
def test_packed_files_are_unpacked(tmp_path, suffix, pack):
    write_text(tmp_path / "scan.dat", POINTS)
    path = tmp_path / f"scan.dat{suffix}"
    path.write_bytes(pack((tmp_path / "scan.dat").read_bytes()))
    np.testing.assert_allclose(read_points(path), POINTS, atol=2e-6)
    path.write_bytes(b"no archive")
    with pytest.raises(InputError, match="cannot be read"):
        read_points(path)


def test_units_and_axes_are_changed_to_ours(tmp_path):
    (tmp_path / "mm.xyz").write_text("1000 2000 3000\n")
    read = read_points(tmp_path / "mm.xyz", units=0.001, axes=("z", "-x", "-y"))
    np.testing.assert_allclose(read, [[3, -1, -2]])


@pytest.mark.parametrize(
    ("name", "text", "options", "words"),
    [
        ("none.pcd", None, {}, "no such file"),
        ("scan.e57", "x", {}, "suffix '.e57'; need one of .pcd, .ply"),
        ("scan", "x", {}, "suffix ''"),
        ("scan.gz", "x", {}, "suffix ''"),
        ("empty.xyz", "", {}, "none of its 0 points is finite"),
        ("nan.xyz", "nan nan nan\n", {}, "none of its 1 points is finite"),
        ("two.xyz", "1 2\n", {}, "lines of 2 numbers"),
        ("words.xyz", "one two three\n", {}, "cannot be read"),
        ("a.vtk", "hello\n", {}, "not a legacy VTK file"),
        ("b.vtk", "# vtk DataFile Version 3.0\nt\nASCII\nPOINTS 1 int\n1 2 3\n", {}, "points of type int"),
        ("c.bt", "hello\n", {}, "not a binary octree"),
        ("good.xyz", "1 2 3\n", {"units": 0.0}, "units is 0.0"),
        ("good.xyz", "1 2 3\n", {"axes": ("x", "x", "z")}, "need each of x, y, z once"),
        ("good.xyz", "1 2 3\n", {"axes": ("x", "y", "up")}, "need each of x, y, z once"),
        ("good.xyz", "1 2 3\n", {"axes": ("y", "x", "z")}, "mirror the scan"),
    ],
)
def test_bad_input_is_named(tmp_path, name, text, options, words):
    if text is not None:
        (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match=words) as error:
        read_points(tmp_path / name, **options)
    assert "\n" not in str(error.value)


def test_a_height_map_is_loaded_from_a_file_of_points(tmp_path):
    write_ply(tmp_path / "room.ply", room() + (0, 0, 1.5))
    terrain = hdsp.HeightMap.load(tmp_path / "room.ply")
    assert abs(np.nanmedian(terrain.heights)) < 0.01
    assert np.nanmax(terrain.heights) == pytest.approx(0.3, abs=0.03)


def test_importing_the_package_brings_no_reader_along():
    heavy = ["lzf", "laspy", "PIL", "pooch", "scipy.spatial", "scipy.ndimage"]
    code = f"import sys, hdsp, hdsp.terrain.pointcloud; print([name for name in {heavy} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


# The format of an octree: two bits per child, depth first.


def octree_bytes(cells, free=(), resolution=0.1):
    """A .bt file with the given occupied and free smallest cells (x, y, z in [0, 65536))."""
    nodes = bytearray()

    def write(occupied, empty, size):
        half, bits, inner = size // 2, 0, []
        for child in range(8):
            low = np.array([child & 1, child >> 1 & 1, child >> 2]) * half
            parts = [
                part[((part >= low) & (part < low + half)).all(axis=1)] - low if len(part) else part
                for part in (occupied, empty)
            ]
            if half == 1:
                bits |= (2 if len(parts[0]) else 1 if len(parts[1]) else 0) << 2 * child
            elif len(parts[0]) or len(parts[1]):
                bits |= 3 << 2 * child
                inner.append(parts)
        nodes.extend(struct.pack("<H", bits))
        for parts in inner:
            write(*parts, half)

    write(np.array(cells, int).reshape(-1, 3), np.array(free, int).reshape(-1, 3), 65536)
    header = f"# Octomap OcTree binary file\n# a comment\nid OcTree\nsize {len(nodes) // 2}\nres {resolution}\ndata\n"
    return header.encode() + bytes(nodes)


cells_near_the_middle = st.tuples(*[st.integers(32760, 32775)] * 3)


@given(st.sets(cells_near_the_middle, min_size=1, max_size=12), st.sets(cells_near_the_middle, max_size=6))
def test_the_occupied_cells_of_an_octree_are_read_and_the_free_ones_are_not(occupied, free):
    points = read_octree(octree_bytes(sorted(occupied), sorted(free - occupied), resolution=0.05))
    expected = (np.array(sorted(occupied)) - 32768 + 0.5) * 0.05
    np.testing.assert_allclose(points[np.lexsort(points.T[::-1])], expected, atol=1e-9)


def test_an_octree_of_one_cell_byte_by_byte():
    # Cell (32768, 32768, 32768) is the root's highest octant, then fifteen times the lowest octant; 2 means occupied.
    nodes = struct.pack("<H", 3 << 14) + struct.pack("<H", 3) * 14 + struct.pack("<H", 2)
    content = b"# Octomap OcTree binary file\nid OcTree\nsize 17\nres 0.1\ndata\n" + nodes
    np.testing.assert_allclose(read_octree(content), [[0.05, 0.05, 0.05]])


def test_a_pruned_cell_counts_as_the_cells_on_its_surface(tmp_path):
    nodes = struct.pack("<H", 3 << 14) + struct.pack("<H", 3) * 12 + struct.pack("<H", 2)  # a leaf of 4 x 4 x 4
    (tmp_path / "map.bt").write_bytes(b"# Octomap OcTree binary file\nid OcTree\nsize 15\nres 0.1\ndata\n" + nodes)
    points = read_points(tmp_path / "map.bt")
    assert len(points) == 4**3 - 2**3
    np.testing.assert_allclose([points.min(), points.max()], [0.05, 0.35])


def test_octrees_that_are_cut_off_are_refused():
    whole = octree_bytes([(32768, 32768, 32768), (32770, 32768, 32769)])
    for length in (len(whole) - 1, len(whole) - 2, len(whole) - 9, 40):
        with pytest.raises(ValueError, match=r"cut off|no line 'data'"):
            read_octree(whole[:length])
    with pytest.raises(ValueError, match="no positive resolution"):
        read_octree(whole.replace(b"res 0.1", b"res 0.0"))
