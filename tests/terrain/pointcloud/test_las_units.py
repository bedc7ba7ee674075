"""Point clouds in LAS and LAZ files are read in the units of their CRS."""

import numpy as np
import pytest

from hdsp.base.errors import InputError
from hdsp.terrain.pointcloud import read_points
from tests.terrain.pointcloud.clouds import las_with_crs

FOOT, SURVEY_FOOT = 0.3048, 1200 / 3937


def wkt(system):
    return pytest.importorskip("rasterio").CRS.from_string(system).to_wkt(version="WKT1_GDAL")


@pytest.mark.parametrize(
    ("keys", "factors", "suffix"),
    [
        ({1024: 1, 3072: 32618}, (1, 1), "las"),
        ({1024: 1, 3072: 2263}, (SURVEY_FOOT, SURVEY_FOOT), "las"),
        ({1024: 1, 3072: 2263, 4096: 5703}, (SURVEY_FOOT, 1), "las"),
        ({1024: 1, 3072: 32767, 3076: 9002}, (FOOT, FOOT), "laz"),
        ({1024: 1, 3072: 32618, 3076: 9001, 4099: 9003}, (1, SURVEY_FOOT), "las"),
        ({1024: 1, 3072: 32618, 4096: 6360}, (1, SURVEY_FOOT), "las"),
        ({}, (1, 1), "las"),
    ],
)
def test_las_files_are_read_in_the_units_of_their_keys(tmp_path, keys, factors, suffix):
    path = las_with_crs(tmp_path / f"a.{suffix}", *([keys] if keys else []))
    plane, height = factors
    np.testing.assert_allclose(read_points(path), [[10 * plane, 20 * plane, 30 * height]], rtol=1e-9)
    np.testing.assert_allclose(read_points(path, units=2.0), [[20, 40, 60]])


@pytest.mark.parametrize("extended", [False, True])
def test_las_files_are_read_in_the_units_of_their_wkt(tmp_path, extended):
    for system, plane, height in (
        ("EPSG:2263", SURVEY_FOOT, SURVEY_FOOT),
        ("EPSG:32618+6360", 1, SURVEY_FOOT),
        ("EPSG:2263+5703", SURVEY_FOOT, 1),
    ):
        path = las_with_crs(tmp_path / "a.las", wkt(system), {1024: 1, 3076: 9001}, extended=extended)
        np.testing.assert_allclose(read_points(path), [[10 * plane, 20 * plane, 30 * height]], rtol=1e-9)


@pytest.mark.parametrize(
    ("record", "words"),
    [
        ({1024: 2, 2048: 4326}, "its CRS is in degrees"),
        ({1024: 3, 2048: 4978}, "its CRS is geocentric"),
        ("EPSG:4326", "EPSG:4326 is in degrees"),
        ("EPSG:4978", "EPSG:4978 is geocentric"),
        ({1024: 1, 3072: 3857, 3076: 9001}, "EPSG:3857 is a Mercator projection, whose metres are true at the equator"),
        ("EPSG:3857", "EPSG:3857 is a Mercator projection"),
        ("EPSG:3395+5703", "is a Mercator projection"),
    ],
)
def test_las_files_that_are_not_on_a_plane_need_units(tmp_path, record, words):
    path = las_with_crs(tmp_path / "a.las", record if isinstance(record, dict) else wkt(record))
    with pytest.raises(InputError, match=rf"a\.las: .*{words}.* the option units"):
        read_points(path)
    np.testing.assert_allclose(read_points(path, units=1.0), [[10, 20, 30]])


def test_a_crs_that_nobody_knows_is_taken_as_metres_with_a_warning(tmp_path, monkeypatch):
    path = las_with_crs(tmp_path / "a.las", 'PROJCS["cut off", GEOGCS[')
    with pytest.warns(UserWarning, match="is unknown, and taken as metres"):
        np.testing.assert_allclose(read_points(path), [[10, 20, 30]])
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.warns(UserWarning, match="rasterio knows it"):
        read_points(path)
