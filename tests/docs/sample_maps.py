"""Small files of all kinds for the page docs/your-map.md, written by other libraries: ground with a kerb of 0.15 m.

Each map shows 4 x 4 m with the kerb at x = 2 m, counted from its lower left corner.
"""

import h5py
import laspy
import numpy as np
import rasterio
from PIL import Image

from tests.terrain.bags import message, write_bag

KERB, SIDE = 0.15, 4.0
EAST, NORTH = 412345.0, 5654321.0  # m, lower left corner of the survey


def write_all(folder):
    """Writes all sample files."""
    for write in (_bags, _survey, _images, _arrays, _clouds, _depth, _unsuitable):
        write(folder)


def kerb(x):
    """Height at x (m from the lower left corner)."""
    return np.where(np.asarray(x) > SIDE / 2, KERB, 0.0)


def rows(cell, noise=0.0):
    """Heights float [rows, columns] with the upper edge (largest y) first, as in images and rasters."""
    count = round(SIDE / cell)
    x = (np.arange(count) + 0.5) * cell
    heights = np.tile(kerb(x), (count, 1))
    return heights + noise * np.random.default_rng(0).standard_normal(heights.shape)


def _bags(folder):
    layers = {"elevation": lambda x, y: float(kerb(x + SIDE / 2)), "variance": lambda x, y: 0.01}
    for kind, name in (("bag", "run.bag"), ("mcap", "run2")):
        grid = message(1 if kind == "bag" else 2, layers, resolution=0.05, shape=(80, 80), start=(7, 30), frame="odom")
        write_bag(folder / name, kind, {"/elevation_map": [grid]})


def _survey(folder):
    heights = np.round(rows(0.05, noise=0.003) + 312.4, 3).astype(np.float32)
    heights[:8, :8] = -9999
    place = rasterio.transform.from_origin(EAST, NORTH + SIDE, 0.05, 0.05)
    with rasterio.open(
        folder / "survey.tif", "w", driver="GTiff", width=80, height=80, count=1, dtype="float32", nodata=-9999,
        crs="EPSG:25832", transform=place,
    ) as raster:  # fmt: skip
        raster.write(heights, 1)
    head = f"ncols 80\nnrows 80\nxllcorner {EAST}\nyllcorner {NORTH}\ncellsize 0.05\nNODATA_value -9999\n"
    lines = "\n".join(" ".join(f"{value:.3f}" for value in row) for row in heights)
    (folder / "survey.asc").write_text(head + lines + "\n")


def _images(folder):
    grey = np.rint(rows(0.04) / 0.005).astype(np.uint8) + 10
    grey[:5, :5] = 0
    Image.fromarray(grey).save(folder / "ground.png")
    Image.fromarray(grey).save(folder / "ground.pgm")


def _arrays(folder):
    heights = rows(0.025).T[:, ::-1]
    np.save(folder / "ground.npy", (1000 * heights).astype(np.int32))
    np.savez(folder / "ground.npz", z=heights.astype(np.float32))
    with h5py.File(folder / "ground.h5", "w") as file:
        file["grid/elevation"] = heights.astype(np.float32)


def _points(lower=(0.0, 0.0, 0.0)):
    """Points on the ground every 2 cm, float [n, 3], m."""
    x, y = np.meshgrid(np.arange(0.01, SIDE, 0.02), np.arange(0.01, SIDE, 0.02), indexing="ij")
    points = np.column_stack([x.ravel(), y.ravel(), kerb(x).ravel()])
    return points + np.random.default_rng(1).normal(0, 0.002, points.shape) + lower


def _clouds(folder):
    points = _points((-1.0, -2.0, -0.8))
    tilt = np.deg2rad(3.0)
    turn = np.array([[np.cos(tilt), 0, np.sin(tilt)], [0, 1, 0], [-np.sin(tilt), 0, np.cos(tilt)]])
    tilted = points @ turn.T
    head = "VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\n"
    head += f"WIDTH {len(points)}\nHEIGHT 1\nPOINTS {len(points)}\nDATA binary\n"
    (folder / "lidar.pcd").write_bytes(head.encode() + tilted.astype("<f4").tobytes())
    head = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\n"
    head += "".join(f"property float {axis}\n" for axis in "xyz") + "end_header\n"
    (folder / "mesh.ply").write_bytes(head.encode() + (1000 * _points()).astype("<f4").tobytes())
    las = laspy.create(point_format=0, file_version="1.2")
    las.header.offsets, las.header.scales = [EAST, NORTH, 300.0], [0.001] * 3
    las.x, las.y, las.z = _points((EAST, NORTH, 312.4)).T
    las.write(folder / "drone.las")
    lines = ["x;y;z", *(";".join(f"{value:.3f}".replace(".", ",") for value in point) for point in _points())]
    (folder / "total_station.csv").write_bytes("\r\n".join(lines).encode("utf-8-sig"))


def _depth(folder):
    """Depth image (mm) of a camera 1 m above level ground, which looks down by 45 degrees and ahead along x."""
    row, _ = np.indices((240, 320))
    below = np.sin(np.pi / 4) + (row - 120) / 250 * np.cos(np.pi / 4)  # of a ray with depth 1
    depth = np.where(below > 0.2, 1000 / np.maximum(below, 0.2), 0)
    Image.fromarray(np.rint(depth).astype(np.uint16)).save(folder / "depth.png")


def _unsuitable(folder):
    """A raster in degrees, a raster in cells of 1 m, and a room in the axes of a camera, y up."""
    for name, crs, cell in (("degrees.tif", "EPSG:4326", 1e-6), ("coarse.tif", "EPSG:25832", 1.0)):
        place = rasterio.transform.from_origin(8.0, 50.0, cell, cell)
        with rasterio.open(
            folder / name, "w", driver="GTiff", width=20, height=20, count=1, dtype="float32", crs=crs, transform=place
        ) as raster:
            raster.write(np.zeros((20, 20), np.float32), 1)
    rng = np.random.default_rng(0)
    floor = np.column_stack([rng.uniform(0, 5, 30000), np.zeros(30000), rng.uniform(0, 4, 30000)])
    wall = np.column_stack([np.zeros(9000), rng.uniform(0, 2.5, 9000), rng.uniform(0, 4, 9000)])
    np.savetxt(folder / "camera.xyz", np.concatenate([floor, wall]), fmt="%.3f")
