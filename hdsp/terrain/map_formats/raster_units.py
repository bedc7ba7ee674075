"""Units of rasters: coordinates have to be metres on a plane, heights are converted to metres."""

from __future__ import annotations

import math
from typing import Any

from hdsp.base.errors import InputError

#: Metres per unit of length, by its name in small letters.
METRES = {
    **dict.fromkeys(("", "m", "metre", "metres", "meter", "meters"), 1.0),
    **dict.fromkeys(("ft", "foot", "feet", "international foot"), 0.3048),
    **dict.fromkeys(("us survey foot", "us-ft", "ftus", "us_survey_foot", "foot_us", "us survey feet"), 1200 / 3937),
    **dict.fromkeys(("cm", "centimetre", "centimeter", "centimetres", "centimeters"), 0.01),
    **dict.fromkeys(("mm", "millimetre", "millimeter", "millimetres", "millimeters"), 0.001),
    **dict.fromkeys(("dm", "decimetre", "decimeter", "decimetres", "decimeters"), 0.1),
    **dict.fromkeys(("km", "kilometre", "kilometer", "kilometres", "kilometers"), 1000.0),
}

#: What is wrong with a Mercator projection of the world, where a metre is 0.6 to 0.7 m in Europe.
MERCATOR = "is a Mercator projection, whose metres are true at the equator only"
_REPROJECT = "reproject it to metres, e.g. gdalwarp -t_srs EPSG:25832 IN OUT"


def check_crs(crs: Any) -> None:
    """Refuses a CRS whose coordinates are not metres on a plane; None is welcome.

    Raises:
        InputError: the CRS is geographic or geocentric, has another unit, or is a Mercator projection of the world.
    """
    if not crs:
        return
    check_plane(crs, _REPROJECT)
    unit, factor = crs.units_factor
    if not math.isclose(factor, 1.0):
        advice = _REPROJECT if crs.is_projected else "scale its transform to metres, and name a CRS in metres"
        raise InputError(f"its CRS {_short(crs)} is in units of {unit}; {advice}")


def check_plane(crs: Any, advice: str) -> None:
    """Refuses a geographic or geocentric CRS, and a Mercator projection of the world, with advice."""
    if crs.is_geographic:
        raise InputError(f"its CRS {_short(crs)} is in degrees; {advice}")
    if any(str(axis.get("direction", "")).startswith("geocentric") for axis in _axes(crs)):
        raise InputError(f"its CRS {_short(crs)} is geocentric; need metres on a plane: {advice}")
    if any(map(_is_true_at_the_equator, _conversions(crs))):
        raise InputError(f"its CRS {_short(crs)} {MERCATOR}; {advice}")


def height_units(raster: Any, band: int) -> tuple[float, float, list[str]]:
    """Scale and offset to metres by the scale, offset and units of a band, and notes.

    Units of a band that names none are those of the heights in the CRS.

    Raises:
        InputError: the scale is 0, or one of them is not finite.
    """
    scale, offset, notes = raster.scales[band - 1], raster.offsets[band - 1], []
    if not (math.isfinite(scale) and math.isfinite(offset) and scale != 0):
        raise InputError(f"band {band} has the scale {scale:g} and the offset {offset:g}; need finite ones, no scale 0")
    if (scale, offset) != (1.0, 0.0):
        notes.append(f"heights times {scale:g} plus {offset:g}, as the band says")
    unit, in_crs = str(raster.units[band - 1] or "").strip(), vertical_unit(raster.crs)
    factor = METRES.get(unit.lower())
    if in_crs is not None and unit.lower() in ("", in_crs[0].lower()):
        unit, factor = in_crs
    if factor is None:
        notes.append(f"unknown vertical units {unit!r}, taken as metres")
    elif not math.isclose(factor, 1.0):
        notes.append(f"heights converted from {unit} to metres")
    return scale * (factor or 1.0), offset * (factor or 1.0), notes


def vertical_unit(crs: Any) -> tuple[str, float] | None:
    """Name of the unit of heights in a CRS, and metres in it; None for a CRS without heights."""
    for axis in _axes(crs) if crs else []:
        if axis.get("direction") in ("up", "down"):
            unit = axis.get("unit", "metre")
            if isinstance(unit, dict):
                return str(unit.get("name", "")), float(unit.get("conversion_factor", 1.0))
            return str(unit), 1.0  # only metres have no factor
    return None


def _is_true_at_the_equator(conversion: dict[str, Any]) -> bool:
    """Whether a projection is a Mercator projection, web or other, whose scale holds at the equator."""
    name = str(conversion.get("method", {}).get("name", ""))
    values = {str(each.get("name", "")): each.get("value") for each in conversion.get("parameters", [])}
    whole = {"Latitude": 0.0, "Scale": 1.0}  # first words of names, and the value at the equator
    true = all(values[key] == whole.get(key.split()[0], values[key]) for key in values)
    return true and (name.startswith("Mercator") or "Pseudo Mercator" in name)


def _axes(crs: Any) -> list[dict[str, Any]]:
    """All axes of a CRS, as in PROJJSON; none for a CRS that PROJ cannot describe."""
    return [axis for part in _parts(crs) for axis in part.get("coordinate_system", {}).get("axis", [])]


def _conversions(crs: Any) -> list[dict[str, Any]]:
    """All projections of a CRS, as in PROJJSON."""
    return [part["conversion"] for part in _parts(crs) if "conversion" in part]


def _parts(crs: Any) -> list[dict[str, Any]]:
    """A CRS and the systems that it is made of, as in PROJJSON."""
    from rasterio.errors import CRSError

    try:
        return _parts_in(crs.to_dict(projjson=True))
    except CRSError:
        return []


def _parts_in(described: dict[str, Any]) -> list[dict[str, Any]]:
    inner = [*described.get("components", []), *([described["source_crs"]] if "source_crs" in described else [])]
    return [described, *(part for each in inner for part in _parts_in(each))]


def _short(crs: Any) -> str:
    text = crs.to_string()
    return text if len(text) < 60 else text[:57] + "..."
