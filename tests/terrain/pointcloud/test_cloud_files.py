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


GRID = np.random.default_rng(1).uniform(-5, 5, (400, 3)).astype(np.float32)


@pytest.mark.parametrize("order", ["<", ">", "ascii"])
def test_m13_vertices_of_meshes_with_textures_stay_as_they_are(tmp_path, order):
    name = {"<": "binary_little_endian", ">": "binary_big_endian"}.get(order, order)
    head = f"ply\nformat {name} 1.0\nelement camera 2\nproperty list uchar int hits\nproperty short id\n"
    head += "element vertex 400\nproperty uchar red\nproperty float Z\nproperty float x\nproperty float y\n"
    head += "element face 300\nproperty list uchar int vertex_indices\nproperty list uchar float texcoord\nend_header\n"
    corners = np.random.default_rng(2).integers(0, 400, (300, 3))
    camera, texture = [[1, 2], [3]], [0.25, 0.5, 0.75, 0.5, 0.25, 1.0]
    if order == "ascii":
        lines = [f"{len(hits)} {' '.join(map(str, hits))} 7" for hits in camera]
        lines += [f"9 {z:.7f} {x:.7f} {y:.7f}" for x, y, z in GRID]
        lines += [f"3 {a} {b} {c} 6 {' '.join(map(str, texture))}" for a, b, c in corners]
        body = "\n".join(lines).encode() + b"\n"
    else:
        body = b"".join(struct.pack(f"{order}B{len(hits)}ih", len(hits), *hits, 7) for hits in camera)
        body += b"".join(struct.pack(f"{order}Bfff", 9, z, x, y) for x, y, z in GRID)
        body += b"".join(struct.pack(f"{order}B3iB6f", 3, *face, 6, *texture) for face in corners)
    (tmp_path / "mesh.PLY").write_bytes(head.encode() + body)
    np.testing.assert_allclose(read_points(tmp_path / "mesh.PLY"), GRID, atol=1e-6)


@pytest.mark.parametrize("suffix", ["ply", "obj"])
def test_m13_meshes_of_another_library_keep_their_vertices(tmp_path, suffix):
    trimesh = pytest.importorskip("trimesh")
    mesh = trimesh.Trimesh(GRID, np.random.default_rng(2).integers(0, 400, (300, 3)), process=False)
    mesh.visual = trimesh.visual.TextureVisuals(uv=np.random.default_rng(3).random((400, 2)))
    mesh.export(tmp_path / f"mesh.{suffix}")
    np.testing.assert_allclose(read_points(tmp_path / f"mesh.{suffix}"), GRID, atol=1e-5)


@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "latin-1"])
@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
def test_m13_vertices_of_a_wavefront_file_are_found_however_they_are_written(tmp_path, encoding, end):
    lines = [
        "v 1 2 3",
        " v 4 5 6 0.5 0.5 0.5",
        "\tv\t7\t8\t9",
        "v 1 \\",
        "  2 \\",
        "  4",
        "vt 0 0",
        "vn 1 0 0",
        "# öv 1 1 1",
    ]
    (tmp_path / "mesh.obj").write_bytes(end.join([*lines, "g v", "f 1 2 3", ""]).encode(encoding))
    np.testing.assert_allclose(read_points(tmp_path / "mesh.obj"), [[1, 2, 3], [4, 5, 6], [7, 8, 9], [1, 2, 4]])


def pcd(fields, sizes, types, counts, body, points, data="binary"):
    head = f"VERSION 0.7\nFIELDS {fields}\nSIZE {sizes}\nTYPE {types}\nCOUNT {counts}\nWIDTH {points}\nHEIGHT 1\n"
    return f"{head}VIEWPOINT 0 0 0 1 0 0 0\nPOINTS {points}\nDATA {data}\n".encode() + body


def test_m14_padded_pcd_files_are_read(tmp_path):
    padded = b"".join(struct.pack("<fff4xf12x", *point, 3) for point in GRID)
    content = pcd("x y z _ intensity _", "4 4 4 1 4 1", "F F F U F U", "1 1 1 4 1 12", padded, 400)
    ouster = b"".join(struct.pack("<fffH", *point, 3) for point in GRID)
    for text in (content, pcd("X Y Z _ T", "4 4 4 1 2", "F F F U U", "1 1 1 0 1", ouster, 400)):
        (tmp_path / "padded.pcd").write_bytes(text)
        np.testing.assert_array_equal(read_points(tmp_path / "padded.pcd"), GRID)


def test_m14_other_types_and_orders_of_fields(tmp_path):
    body = b"".join(struct.pack("<dhd", point[2], 7, point[0]) + struct.pack("<d", point[1]) for point in GRID)
    (tmp_path / "mixed.pcd").write_bytes(pcd("Z ring X Y", "8 2 8 8", "f I F F", "1 1 1 1", body, 400))
    np.testing.assert_array_equal(read_points(tmp_path / "mixed.pcd"), GRID)
    whole = np.rint(GRID * 100).astype(int)
    body = b"".join(struct.pack("<ihi", *point) for point in whole)
    (tmp_path / "whole.pcd").write_bytes(pcd("x y z", "4 2 4", "I I I", "1 1 1", body, 400))
    np.testing.assert_array_equal(read_points(tmp_path / "whole.pcd"), whole)


def test_pcd_headers_that_contradict_themselves_or_their_data_are_refused(tmp_path):
    body = GRID.astype("<f4").tobytes()
    whole = pcd("x y z", "4 4 4", "F F F", "1 1 1", body, 400)
    for content, words in (
        (pcd("x y z", "4 4 4", "F F F", "1 1 1", body, 399), "data of 400 points; the header says 399"),
        (whole.replace(b"WIDTH 400", b"WIDTH 20"), "POINTS 400, but WIDTH 20 and HEIGHT 1"),
        (whole.replace(b"HEIGHT 1", b"HEIGHT 2"), "POINTS 400, but WIDTH 400 and HEIGHT 2"),
    ):
        (tmp_path / "a.pcd").write_bytes(content)
        with pytest.raises(InputError, match=words):
            read_points(tmp_path / "a.pcd")
    for content in (whole.replace(b"POINTS 400\n", b""), whole.replace(b"WIDTH 400\nHEIGHT 1\n", b""), whole + b"\n"):
        (tmp_path / "a.pcd").write_bytes(content)
        np.testing.assert_array_equal(read_points(tmp_path / "a.pcd"), GRID)


def test_m14_compressed_fields_lie_one_after_the_other(tmp_path):
    lzf = pytest.importorskip("lzf")
    fields = [np.zeros(400, "<u2"), *np.ascontiguousarray(GRID.T.astype("<f8"))]
    body = b"".join(field.tobytes() for field in fields)
    packed = lzf.compress(body, 2 * len(body)) or b""
    content = struct.pack("<II", len(packed), len(body)) + packed
    (tmp_path / "small.pcd").write_bytes(
        pcd("ring x y z", "2 8 8 8", "U F F F", "1 1 1 1", content, 400, "binary_compressed")
    )
    np.testing.assert_array_equal(read_points(tmp_path / "small.pcd"), GRID)


def test_m19_ascii_numbers_keep_all_digits_whatever_their_size(tmp_path):
    body = b"412345.678 5654321.123 59.254\n412346.001 5654322.002 59.255\n"
    (tmp_path / "utm.pcd").write_bytes(pcd("x y z", "4 4 4", "F F F", "1 1 1", body, 2, "ascii"))
    expected = [[412345.678, 5654321.123, 59.254], [412346.001, 5654322.002, 59.255]]
    np.testing.assert_allclose(read_points(tmp_path / "utm.pcd"), expected, rtol=0, atol=1e-9)


@pytest.mark.parametrize(
    ("fields", "words"), [("x y intensity", "need x, y and z once each"), ("x x y", "need x, y and z once each")]
)
def test_m14_pcd_files_without_coordinates_are_refused(tmp_path, fields, words):
    (tmp_path / "a.pcd").write_bytes(pcd(fields, "4 4 4", "F F F", "1 1 1", b"\0" * 12, 1))
    with pytest.raises(InputError, match=words):
        read_points(tmp_path / "a.pcd")


def mutations(content, count, seed):
    """Copies with bytes flipped, removed, doubled or exchanged, or with the end missing."""
    rng = np.random.default_rng(seed)
    for _ in range(count):
        data = bytearray(content)
        for _ in range(rng.integers(1, 4)):
            at, width = int(rng.integers(len(data))), int(rng.integers(1, 9))
            # Half of the changes are in the header, where they matter most.
            at = at % min(len(data), 300) if rng.random() < 0.5 else at
            match rng.integers(5):
                case 0:
                    data[at] ^= 1 << int(rng.integers(8))
                case 1:
                    del data[at : at + width]
                case 2:
                    data[at:at] = data[at : at + width]
                case 3:
                    data[at : at + width] = rng.bytes(width)
                case 4:
                    del data[max(1, at) :]
            data = data or bytearray(b"?")
        yield bytes(data)


MUTABLE = [name for name in WRITERS if not name.endswith("laz")]


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", MUTABLE)
def test_damaged_files_give_one_line_or_points(tmp_path, name):
    WRITERS[name](tmp_path / name, POINTS)
    whole = (tmp_path / name).read_bytes()
    refused = 0
    for content in mutations(whole, 200, seed=len(name)):
        (tmp_path / name).write_bytes(content)
        try:
            points = read_points(tmp_path / name)
        except InputError as error:
            assert "\n" not in str(error) and name in str(error)
            refused += 1
            continue
        assert points.dtype == np.float64 and points.shape[1] == 3 and np.isfinite(points).all()
        if len(content) == len(whole):  # no line or record came or went
            assert len(points) <= len(POINTS)
    assert refused > 20


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
        ("empty.xyz", "", {}, "the file is empty"),
        ("nan.xyz", "nan nan nan\n", {}, "none of its 1 points is finite"),
        ("two.xyz", "1 2\n", {}, "lines of 2 numbers"),
        ("words.xyz", "one two three\n", {}, "cannot be read"),
        ("a.vtk", "hello\n", {}, "not a legacy VTK file"),
        ("b.vtk", "# vtk DataFile Version 3.0\nt\nASCII\nPOINTS 1 int\n1 2 3\n", {}, "points of type int"),
        ("c.bt", "hello\n", {}, "not a binary octree"),
        ("good.xyz", "1 2 3\n", {"units": 0.0}, "units is 0.0"),
        ("good.xyz", "1 2 3\n", {"units": "mm"}, "units is 'mm'; need a positive number"),
        ("good.xyz", "1 2 3\n", {"axes": 3}, "axes are 3; need each of x, y, z once"),
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
