"""Points measured by a sensor -> height map: files, levelling on the floor, registration, cells.

    points = read_points("scan.pcd")
    terrain = height_map(points)                        # = hdsp.HeightMap.from_points(points)

Convention: points are float64 [n, 3] in metres, z up, NaN-free. A levelled cloud has its floor at z = 0.
Importing this package loads none of the libraries that read files; each is loaded by the first file of its kind.
"""

from hdsp.terrain.pointcloud.alignment import FloorSettings, Plane, fit_floor, level, register
from hdsp.terrain.pointcloud.cloud_files import FORMATS, read_points
from hdsp.terrain.pointcloud.cloud_mapping import MapSettings, height_map
from hdsp.terrain.pointcloud.depth import Camera, depth_points

__all__ = [
    "FORMATS",
    "Camera",
    "FloorSettings",
    "MapSettings",
    "Plane",
    "depth_points",
    "fit_floor",
    "height_map",
    "level",
    "read_points",
    "register",
]
