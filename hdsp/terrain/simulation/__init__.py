"""Simulated arenas: physics, lidar scans, height maps made from the scans, and their accuracy.

- `mujoco_world`: an arena as a MuJoCo world, for rays and pictures
- `lidar`, `fusion`, `lidar_mapping`: scans along a path, the surface that their points agree on, its height map
- `tour`: a path past all free ground; `courses`: random arenas with places worth a label

Importing this package loads none of its modules. MuJoCo, the optional dependency ``simulation``, is first imported when
a world is built.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hdsp.terrain.simulation.courses import Course, CourseSettings, Place, random_course
    from hdsp.terrain.simulation.fusion import Surface, fuse, smooth
    from hdsp.terrain.simulation.lidar import Cloud, Lidar, scan
    from hdsp.terrain.simulation.lidar_mapping import accuracy, scanned_map
    from hdsp.terrain.simulation.mujoco_world import MujocoWorld, is_available, mjcf

__all__ = [
    "Cloud",
    "Course",
    "CourseSettings",
    "Lidar",
    "MujocoWorld",
    "Place",
    "Surface",
    "accuracy",
    "fuse",
    "is_available",
    "mjcf",
    "random_course",
    "scan",
    "scanned_map",
    "smooth",
]

#: Module of each public name.
_MODULES = {
    "Cloud": "lidar",
    "Course": "courses",
    "CourseSettings": "courses",
    "Lidar": "lidar",
    "MujocoWorld": "mujoco_world",
    "Place": "courses",
    "Surface": "fusion",
    "accuracy": "lidar_mapping",
    "fuse": "fusion",
    "is_available": "mujoco_world",
    "mjcf": "mujoco_world",
    "random_course": "courses",
    "scan": "lidar",
    "scanned_map": "lidar_mapping",
    "smooth": "fusion",
}


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
