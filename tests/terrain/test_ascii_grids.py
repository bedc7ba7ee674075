"""ASCII grids: headers without a doubt, no-data words, multipliers, and words amid heights."""

import math

import numpy as np
import pytest
import rasterio

from hdsp.base.errors import InputError
from hdsp.terrain.height_map import HeightMap
from hdsp.terrain.map_formats import map_contents
from tests.terrain.rasters import equal

ESRI = "ncols 3\nnrows 2\nxllcorner 10\nyllcorner 20\ncellsize 0.5\n"
GRASS = "north: 21\nsouth: 20\neast: 11.5\nwest: 10\nrows: 2\ncols: 3\n"
HEIGHTS = [[4, 0], [5, 2], [6, 3]]
BODY = "0 2 3\n4 5 6\n"
UNKNOWN = [[4, 0], [5, math.nan], [6, 3]]


def load(tmp_path, text):
    (tmp_path / "a.asc").write_text(text)
    return HeightMap.load(tmp_path / "a.asc")


@pytest.mark.parametrize("word", ["*", "none", "nan", "NaN", "", " "])
def test_a_no_data_value_without_a_number_leaves_the_height_zero_known(tmp_path, word):
    assert equal(load(tmp_path, f"{ESRI}NODATA_value {word}\n{BODY}"), HEIGHTS, (10, 20))
    assert equal(load(tmp_path, f"{ESRI}nodata_value{word}\n{BODY}"), HEIGHTS, (10, 20)) or word.strip()
    assert equal(load(tmp_path, f"{GRASS}null: {word}\n{BODY}"), HEIGHTS, (10, 20))
    assert "no-data value none" in map_contents(tmp_path / "a.asc")


@pytest.mark.parametrize("word", ["*", "nan", "none", "1.#QNAN", "-1.#IND00", "-nan"])
def test_words_for_an_unknown_height(tmp_path, word):
    assert equal(load(tmp_path, f"{ESRI}NODATA_value {word}\n{BODY.replace(' 2', f' {word}')}"), UNKNOWN, (10, 20))
    assert equal(load(tmp_path, f"{GRASS}{BODY.replace(' 2', f' {word}')}"), UNKNOWN, (10, 20))


def test_a_multiplier_counts_for_heights_and_not_for_the_no_data_value(tmp_path):
    terrain = load(tmp_path, f"{GRASS}null: 2\ntype: float\nmultiplier: 0.001\n{BODY}")
    assert equal(terrain, np.array(UNKNOWN) * 0.001, (10, 20))
    assert terrain.frame.notes == ("heights times 0.001, as the header says",)


@pytest.mark.parametrize(
    "text",
    [f"\n\n{ESRI}{BODY}", f"  {ESRI}{BODY}", f"# made by X\n# 2024\n{ESRI}{BODY}", ESRI.replace("\n", "\n  ") + BODY],
    ids=["blank lines", "indented", "comments", "indented keys"],
)
def test_a_header_behind_comments_and_spaces_is_read_with_the_crs_beside_it(tmp_path, text):
    assert equal(load(tmp_path, text), HEIGHTS, (10, 20))
    (tmp_path / "a.prj").write_text(rasterio.CRS.from_epsg(4326).to_wkt(version="WKT1_ESRI"))
    with pytest.raises(InputError, match="in degrees"):
        load(tmp_path, text)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("xllcorner 10\nyllcorner 20\n", "", "need xllcorner and yllcorner, or xllcenter and yllcenter"),
        ("llcorner", "llcentre", "has ncols, nrows, xllcentre, yllcentre, cellsize; need xllcorner and yllcorner"),
        ("xllcorner", "xllcenter", "need xllcorner and yllcorner, or xllcenter and yllcenter"),
        ("xllcorner 10", "xllcorner 10\nxllcenter 10", "need xllcorner and yllcorner, or"),
        ("cellsize 0.5\n", "", "need cellsize, or dx and dy"),
        ("nrows 2\n", "", "need ncols and nrows"),
        ("0.5", "-0.5", r"cellsize is -0\.5; need a positive number"),
        ("0.5", "0", "cellsize is 0; need a positive number"),
        ("0.5", "nan", "cellsize is 'nan' in its header; need a number"),
        ("cellsize 0.5", "dx 0.5\ndy -0.5", r"dy is -0\.5; need a positive number"),
        ("corner 10", "corner ten", "xllcorner is 'ten' in its header; need a number"),
        ("0.5\n", "0.5\nNODATA_value water\n", "no-data value is 'water' in its header; need a number"),
    ],
)
def test_headers_that_lack_an_entry_or_have_an_impossible_one_are_refused(tmp_path, old, new, words):
    with pytest.raises(InputError, match=words) as error:
        load(tmp_path, ESRI.replace(old, new) + BODY)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(("word", "line"), [("x", 6), ("2;", 6), ("2_0", 6), ("٣", 6)])
def test_a_word_amid_heights_is_named_with_its_line(tmp_path, word, line):
    for before in (0, 2):
        text = "# a comment\n" * before + ESRI + BODY.replace(" 2", f" {word}")
        (tmp_path / "a.asc").write_text(text, encoding="utf-8-sig")
        with pytest.raises(InputError, match=rf"a\.asc: line {line + before} has '{word}' amid heights; need numbers"):
            HeightMap.load(tmp_path / "a.asc")
