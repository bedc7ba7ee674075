"""Terrain and robot, compiled into flat arrays for the kernels.

- `geometry`: cells under feet, contacts and body, by heading
- `world`: `World` and its construction
- `body`: whether the base is free over its feet
- `world_update`: a `World` after a change in the map
"""

from hdsp.detailed.world.world import Constants, Tables, World, build_world
from hdsp.detailed.world.world_update import updated_world

__all__ = ["Constants", "Tables", "World", "build_world", "updated_world"]
