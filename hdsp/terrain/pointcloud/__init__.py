"""From measured points to a height map: files, faults, direction of gravity, levelling, registration, rasterisation.

    points = read_points("scan.pcd")
    terrain = hdsp.HeightMap.from_points(points)        # map_points(points) with its report

Convention: points are float64 [n, 3] in metres, z up, NaN-free. A map of a cloud has its floor at z = 0. The package
loads no file library on import; the first file in a format loads the library for this format.
"""

from hdsp.terrain.pointcloud.alignment import FloorSettings, Plane, fit_floor, level, register
from hdsp.terrain.pointcloud.cloud_files import FORMATS, read_points
from hdsp.terrain.pointcloud.cloud_mapping import MappedCloud, MappingReport, MapSettings, map_points
from hdsp.terrain.pointcloud.depth import Camera, depth_points
from hdsp.terrain.pointcloud.description import describe_points

__all__ = [
    "FORMATS",
    "Camera",
    "FloorSettings",
    "MapSettings",
    "MappedCloud",
    "MappingReport",
    "Plane",
    "depth_points",
    "describe_points",
    "fit_floor",
    "level",
    "map_points",
    "read_points",
    "register",
]
