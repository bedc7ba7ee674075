"""Files of height maps: formats, options and checks.

- `fields`: contents of a file before validation, options for reading, the frame as text
- `archives`: .npz, HDF5 and bare .npy arrays
- `rasters`, `raster_units`: GeoTIFF and other rasters of geographic information systems; units of their CRS and heights
- `images`: PNG and PGM with grey values as heights
- `grid_map_bags`: grid_map messages in ROS bags
- `registry`: format for each suffix, and the one place where a file is read or written

Each library for a format loads with the first file in this format.
"""

from hdsp.terrain.map_formats.fields import MapFields, MissingOption, ReadOptions
from hdsp.terrain.map_formats.registry import (
    MAP_SUFFIXES,
    MapFormat,
    check_writable,
    is_map,
    is_self_contained,
    map_contents,
    read_map,
    write_map,
)

__all__ = [
    "MAP_SUFFIXES",
    "MapFields",
    "MapFormat",
    "MissingOption",
    "ReadOptions",
    "check_writable",
    "is_map",
    "is_self_contained",
    "map_contents",
    "read_map",
    "write_map",
]
