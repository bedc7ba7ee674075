"""Rasters whose CRS counts in other units than metres."""

import numpy as np
import pytest
import rasterio

from hdsp.base.errors import InputError
from hdsp.terrain.height_map import HeightMap
from tests.terrain.rasters import HEIGHTS, PICTURE, equal, geotiff

SITE_IN_FEET = 'LOCAL_CS["site",UNIT["foot",0.3048]]'
UTM_WITH_HEIGHTS_IN_FEET = """PROJCRS["UTM with heights",
    BASEGEOGCRS["WGS 84",DATUM["World Geodetic System 1984",ELLIPSOID["WGS 84",6378137,298.257223563]]],
    CONVERSION["UTM zone 32N",METHOD["Transverse Mercator"],PARAMETER["Latitude of natural origin",0],
        PARAMETER["Longitude of natural origin",9],PARAMETER["Scale factor at natural origin",0.9996],
        PARAMETER["False easting",500000],PARAMETER["False northing",0]],
    CS[Cartesian,3],AXIS["E",east,LENGTHUNIT["metre",1]],AXIS["N",north,LENGTHUNIT["metre",1]],
    AXIS["h",up,LENGTHUNIT["foot",0.3048]]]"""


def test_heights_in_feet_of_the_crs_become_metres(tmp_path):
    for name, crs, foot in (
        ("compound", "EPSG:32632+6360", 1200 / 3937),
        ("solid", UTM_WITH_HEIGHTS_IN_FEET, 0.3048),
        ("international", "EPSG:32632+8228", 0.3048),
    ):
        terrain = HeightMap.load(geotiff(tmp_path / f"{name}.tif", crs=crs))
        assert equal(terrain, np.array(HEIGHTS) * foot, (100, 199)) and terrain.resolution == 0.5
        assert any("foot to metres" in note for note in terrain.frame.notes)
    terrain = HeightMap.load(geotiff(tmp_path / "metres.tif", crs="EPSG:32632+5703"))
    assert equal(terrain, HEIGHTS, (100, 199)) and terrain.frame.notes == ()
    own = geotiff(tmp_path / "own.tif", crs="EPSG:32632+6360", tags={"units": ("m",)})  # the band has the last word
    assert equal(HeightMap.load(own), HEIGHTS, (100, 199))
    (tmp_path / "a.asc").write_text("ncols 3\nnrows 2\nxllcorner 10\nyllcorner 20\ncellsize 0.5\n1 2 3\n4 5 6\n")
    (tmp_path / "a.prj").write_text(rasterio.CRS.from_string("EPSG:32632+6360").to_wkt())
    assert equal(HeightMap.load(tmp_path / "a.asc"), np.array(HEIGHTS) * 1200 / 3937, (10, 20))


@pytest.mark.parametrize(
    "crs",
    ['LOCAL_CS["site",UNIT["metre",1]]', 'LOCAL_CS["site"]', "EPSG:32632", "EPSG:3001", "EPSG:3994", "EPSG:2056"],
)
def test_a_plane_in_metres_is_welcome(tmp_path, crs):
    assert equal(HeightMap.load(geotiff(tmp_path / "a.tif", crs=crs)), HEIGHTS, (100, 199))


@pytest.mark.parametrize("tags", [{"scales": (0,)}, {"scales": (np.nan,)}, {"offsets": (np.inf,)}])
def test_a_band_whose_scale_gives_no_heights_is_refused(tmp_path, tags):
    with pytest.raises(InputError, match=r"band 1 has the scale .* and the offset .*; need finite ones, no scale 0"):
        HeightMap.load(geotiff(tmp_path / "a.tif", np.array(HEIGHTS, np.int16), tags=tags))


@pytest.mark.parametrize(
    ("crs", "words"),
    [
        ("EPSG:4326", "EPSG:4326 is in degrees; reproject it to metres"),
        ("EPSG:2263", "in units of US survey foot; reproject it"),
        (SITE_IN_FEET, "in units of foot; scale its transform to metres"),
        ("EPSG:2263+5703", "in units of US survey foot; reproject it"),
        ("EPSG:4979", "EPSG:4979 is in degrees"),
        ("EPSG:4978", "EPSG:4978 is geocentric; need metres on a plane"),
        ("EPSG:3857", "EPSG:3857 is a Mercator projection, whose metres are true at the equator only; .* gdalwarp"),
        ("EPSG:3395", "EPSG:3395 is a Mercator projection"),
        ("EPSG:3857+5703", "is a Mercator projection"),
    ],
)
def test_m7_rasters_in_other_units_than_metres_are_refused(tmp_path, crs, words):
    with pytest.raises(InputError, match=words) as error:
        HeightMap.load(geotiff(tmp_path / "a.tif", crs=crs))
    assert "\n" not in str(error.value)


def test_a_raster_with_ground_control_points_needs_a_transform(tmp_path):
    corners = [
        rasterio.control.GroundControlPoint(row, column, 10 + column, 20 - row) for row in (0, 2) for column in (0, 3)
    ]
    shape = {"count": 1, "height": 2, "width": 3, "dtype": "float32"}
    with rasterio.open(tmp_path / "a.tif", "w", driver="GTiff", gcps=corners, crs="EPSG:25832", **shape) as file:
        file.write(PICTURE.astype("f4"), 1)
    with pytest.raises(InputError, match=r"it has ground control points and no transform; make one"):
        HeightMap.load(tmp_path / "a.tif", resolution=0.5)
