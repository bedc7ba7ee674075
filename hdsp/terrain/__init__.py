"""The ground, from files, scans, sensors and random scenes, and its costs for a robot.

- `height_map`, `patches`, `map_formats`: height maps, squares of them in the robot frame, their files
- `map_checks`, `no_data`: signs of other units, no-data values, another axis up
- `conditioning`: from measured heights to heights for planning
- `cost_maps`: edges, unevenness, and cells on which a foot can stand
- `obstacles`, `scenes`: obstacles on level or tilted ground, random scenes by category
- `arenas`, `random_arenas`: walled squares with obstacles, from a description or a seed
- `sensor_model`, `filling`: random maps degraded to the quality of scans; filled holes, averaged noise
- `scans`: descriptions of scanned real places
- `pointcloud`: points to heights; `simulation`: arenas in MuJoCo, scanned by a lidar

Importing this package loads none of its modules; the first use of a name loads its module.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from hdsp.terrain.arenas import Arena, ArenaDescription, read_arena
    from hdsp.terrain.conditioning import ConditioningReport
    from hdsp.terrain.cost_maps import COST_MODEL_VERSION, CostMaps
    from hdsp.terrain.height_map import Conditioned, HeightMap, conditioned
    from hdsp.terrain.map_checks import suspicions
    from hdsp.terrain.map_filters import ConditioningSettings
    from hdsp.terrain.obstacles import Bank, Block, Obstacle, Ramp, Scene, Staircase, Tiles, Tilted, TiltedGround
    from hdsp.terrain.patches import crop_patches
    from hdsp.terrain.random_arenas import ArenaSettings, RandomArena, random_arena
    from hdsp.terrain.scans import Scan, ScanFile, build_map, find_files
    from hdsp.terrain.scenes import (
        ALL_CATEGORIES,
        CATEGORIES,
        SLOPE_CATEGORIES,
        TerrainSettings,
        random_map,
        random_scene,
    )
    from hdsp.terrain.sensor_model import SensingSettings, sensed

__all__ = [
    "ALL_CATEGORIES",
    "CATEGORIES",
    "COST_MODEL_VERSION",
    "SLOPE_CATEGORIES",
    "Arena",
    "ArenaDescription",
    "ArenaSettings",
    "Bank",
    "Block",
    "Conditioned",
    "ConditioningReport",
    "ConditioningSettings",
    "CostMaps",
    "HeightMap",
    "Obstacle",
    "Ramp",
    "RandomArena",
    "Scan",
    "ScanFile",
    "Scene",
    "SensingSettings",
    "Staircase",
    "TerrainSettings",
    "Tiles",
    "Tilted",
    "TiltedGround",
    "build_map",
    "conditioned",
    "crop_patches",
    "find_files",
    "random_arena",
    "random_map",
    "random_scene",
    "read_arena",
    "sensed",
    "suspicions",
]

#: Module of each public name.
_MODULES = {
    "ALL_CATEGORIES": "scenes",
    "CATEGORIES": "scenes",
    "COST_MODEL_VERSION": "cost_maps",
    "SLOPE_CATEGORIES": "scenes",
    "Arena": "arenas",
    "ArenaDescription": "arenas",
    "ArenaSettings": "random_arenas",
    "Bank": "obstacles",
    "Block": "obstacles",
    "Conditioned": "height_map",
    "ConditioningReport": "conditioning",
    "ConditioningSettings": "map_filters",
    "CostMaps": "cost_maps",
    "HeightMap": "height_map",
    "Obstacle": "obstacles",
    "Ramp": "obstacles",
    "RandomArena": "random_arenas",
    "Scan": "scans",
    "ScanFile": "scans",
    "Scene": "obstacles",
    "SensingSettings": "sensor_model",
    "Staircase": "obstacles",
    "TerrainSettings": "scenes",
    "Tiles": "obstacles",
    "Tilted": "obstacles",
    "TiltedGround": "obstacles",
    "build_map": "scans",
    "conditioned": "height_map",
    "crop_patches": "patches",
    "find_files": "scans",
    "random_arena": "random_arenas",
    "random_map": "scenes",
    "random_scene": "scenes",
    "read_arena": "arenas",
    "sensed": "sensor_model",
    "suspicions": "map_checks",
}


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULES[name]}"), name)
