"""Units of LAS files: metres per unit by their coordinate reference system (CRS).

Records of variable length hold the CRS as WKT or as GeoTIFF keys with codes for units and for systems of the EPSG
registry ("LAS Specification 1.4", ASPRS; "GeoTIFF Specification 1.8.2"). rasterio knows systems; codes for units say
enough without it.
"""

from __future__ import annotations

import importlib.util
import struct
import warnings
from collections.abc import Iterator
from typing import Any

import numpy as np

from hdsp.base.errors import InputError
from hdsp.base.quiet import quiet_thread
from hdsp.terrain.map_formats.raster_units import MERCATOR, check_plane, vertical_unit

_OWNER = b"LASF_Projection"
_WKT, _KEYS = 2112, 34735
_MOST_RECORDS = 10_000
# GeoTIFF keys.
_MODEL, _PLANE, _PLANE_UNIT, _HEIGHT, _HEIGHT_UNIT = 1024, 3072, 3076, 4096, 4099
_GEOGRAPHIC, _GEOCENTRIC = 2, 3  # models
_NO_CODE = (0, 32767)
_MERCATOR_CODES = (3857, 3785, 3395)  # of the world: web, its predecessor, ellipsoidal
#: Metres per unit, by the code of the unit.
_METRES = {9001: 1.0, 9002: 0.3048, 9003: 1200 / 3937, 9036: 1000.0}
_ADVICE = "reproject it to metres, e.g. with pdal, or give the option units"


def metres_in_las(content: bytes) -> np.ndarray:
    """Returns metres per unit of x, y and z, float64 [3]; ones for a file without a CRS.

    Heights without units of their own have those of x and y.

    Raises:
        InputError: the CRS is geographic or geocentric, or a Mercator projection of the world.

    Warns:
        UserWarning: the CRS is unknown, and metres are assumed.
    """
    records = dict(_records(content))
    keys = _geo_keys(records.get(_KEYS, b""))
    if keys.get(_MODEL) in (_GEOGRAPHIC, _GEOCENTRIC):
        named = "in degrees" if keys[_MODEL] == _GEOGRAPHIC else "geocentric"
        raise InputError(f"its CRS is {named}; {_ADVICE}")
    if keys.get(_PLANE) in _MERCATOR_CODES:
        raise InputError(f"its CRS EPSG:{keys[_PLANE]} {MERCATOR}; {_ADVICE}")
    wkt = records.get(_WKT, b"").split(b"\0")[0].decode("utf-8", "replace").strip()
    plane, height = _METRES.get(keys.get(_PLANE_UNIT, 0)), _METRES.get(keys.get(_HEIGHT_UNIT, 0))
    if wkt:
        plane, height = _units_of(wkt)
    else:
        if plane is None and keys.get(_PLANE, 0) not in _NO_CODE:
            plane, _ = _units_of(f"EPSG:{keys[_PLANE]}")
        if height is None and keys.get(_HEIGHT, 0) not in _NO_CODE:
            _, height = _units_of(f"EPSG:{keys[_HEIGHT]}")
    plane = 1.0 if plane is None else plane
    return np.array([plane, plane, plane if height is None else height])


def _records(content: bytes) -> Iterator[tuple[int, bytes]]:
    """Numbers and contents of the records on the CRS, as far as they lie within the file."""
    if len(content) < 227:
        return
    at, _, count = struct.unpack_from("<HII", content, 94)
    places = [(at, count, "<16sHH", 54)]
    if content[25] >= 4 and len(content) >= 375:
        places.append((*struct.unpack_from("<QI", content, 235), "<16sHQ", 60))
    for at, count, form, head in places:
        for _ in range(min(count, _MOST_RECORDS)):
            if at + head > len(content):
                break
            owner, number, length = struct.unpack_from(form, content, at + 2)
            if owner.rstrip(b"\0") == _OWNER:
                yield number, content[at + head : at + head + length]
            at += head + length


def _geo_keys(record: bytes) -> dict[int, int]:
    """Values of keys that are whole numbers, by key."""
    words = np.frombuffer(record[: len(record) // 8 * 8], "<u2").reshape(-1, 4)[1:].tolist()
    return {key: value for key, place, _, value in words if place == 0}


def _units_of(system: str) -> tuple[float | None, float | None]:
    """Metres per unit on the plane, and of heights, for a CRS as WKT or code; None where it says nothing."""
    if importlib.util.find_spec("rasterio") is None:
        warnings.warn("its CRS is taken as metres; rasterio knows it: pip install 'hdsp[maps]'", stacklevel=2)
        return None, None
    try:
        return _looked_up(system)
    except InputError:
        raise
    except Exception:  # PROJ rejects damaged texts with errors of several types
        warnings.warn(f"its CRS {system[:40]!r} is unknown, and taken as metres", stacklevel=2)
        return None, None


def _looked_up(system: str) -> tuple[float | None, float | None]:
    import rasterio
    from rasterio.crs import CRS

    with rasterio.Env(), quiet_thread():
        crs: Any = CRS.from_user_input(system)
        check_plane(crs, _ADVICE)
        vertical = vertical_unit(crs)
        return float(crs.units_factor[1]), None if vertical is None else vertical[1]
