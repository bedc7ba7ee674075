import codecs

import numpy as np
import pytest

from hdsp.base.errors import InputError
from hdsp.terrain.pointcloud import read_points

POINTS = np.array([[1.25, 0.5, 0.01], [-2.125, 3.0, 10.5], [1.5, 12.25, -0.75]])


def read(tmp_path, content, name="cloud.csv"):
    (tmp_path / name).write_bytes(content if isinstance(content, bytes) else content.encode())
    return read_points(tmp_path / name)


def rows(points=POINTS, between=" ", end="\n", number="{:.3f}"):
    return "".join(between.join(number.format(value) for value in point) + end for point in points)


HEADERS = {
    "names": "x,y,z\n" + rows(between=","),
    "cloudcompare": "//X Y Z\n" + rows(),
    "comment": "# x y z\n" + rows(),
    "title": "Scan of 2024-05-01, courtyard\n" + rows(),
    "quoted": '"X","Y","Z"\n' + rows(between=","),
    "units in brackets": "X [m];Y [m];Z [m]\n" + rows(between=";"),
    "second line": "x;y;z\nm;m;m\n" + rows(between=";"),
    "paraview": "Points:0,Points:1,Points:2\n" + rows(between=","),
    "position": "position_x\tposition_y\tposition_z\n" + rows(between="\t"),
    "survey": "Easting,Northing,Height\n" + rows(between=","),
    "other order": "z,y,x\n" + rows(POINTS[:, ::-1], ","),
    "colours first": "r g b x y z\n" + rows(np.c_[np.full((3, 3), 7), POINTS]),
    "normals too": "normal_x,normal_y,normal_z,pos_x,pos_y,pos_z\n" + rows(np.c_[np.eye(3), POINTS], ","),
    "northing first": "Northing;Easting;Height\n" + rows(POINTS[:, [1, 0, 2]], ";"),
    "labels": "id,x,y,z,class\n" + "".join(f"p{k}," + rows([p], ",", ",car\n") for k, p in enumerate(POINTS)),
}


@pytest.mark.parametrize("kind", HEADERS)
def test_m11_headers_name_the_columns(tmp_path, kind):
    np.testing.assert_allclose(read(tmp_path, HEADERS[kind]), POINTS)


@pytest.mark.parametrize(
    ("mark", "encoding"),
    [
        (codecs.BOM_UTF8, "utf-8"),
        (codecs.BOM_UTF16_LE, "utf-16-le"),
        (codecs.BOM_UTF16_BE, "utf-16-be"),
        (codecs.BOM_UTF32_LE, "utf-32-le"),
        (b"", "utf-16-le"),
        (b"", "utf-16-be"),
        (b"", "latin-1"),
    ],
)
def test_m11_marks_and_encodings(tmp_path, mark, encoding):
    for head in ("", "x,y,z\n", "# Höhe in m\n" if encoding != "utf-16-be" else ""):
        np.testing.assert_allclose(read(tmp_path, mark + (head + rows(between=",")).encode(encoding)), POINTS)


@pytest.mark.parametrize(
    "text",
    [
        "3\n" + rows(),
        "3 1\n" + rows(),
        "3\nwater\n" + "".join(f"C {rows([point])}" for point in POINTS),
        "2\n" + rows(POINTS[:2]) + "1\n" + rows(POINTS[2:]),
    ],
)
def test_m11_lines_with_the_number_of_points(tmp_path, text):
    np.testing.assert_allclose(read(tmp_path, text, "cloud.xyz"), POINTS)
    with pytest.raises(InputError, match="cut off: 2 points; a line says"):
        read(tmp_path, text.rsplit("\n", 2)[0] + "\n", "cloud.xyz")


COMMAS = {
    "semicolons": rows(between=";").replace(".", ","),
    "spaces": rows().replace(".", ","),
    "tabs": rows(between="\t").replace(".", ","),
    "some are whole": "1,25;0,5;0,01\n-2,125;3;10,5\n1,5;12,25;-0,75\n",
    "more columns": "".join(rows([p], ";", ";7;255\n") for p in POINTS).replace(".", ","),
    "header": "X;Y;Z\n" + rows(between=";").replace(".", ","),
}


@pytest.mark.parametrize("kind", COMMAS)
def test_m12_decimal_commas_are_read(tmp_path, kind):
    np.testing.assert_allclose(read(tmp_path, COMMAS[kind]), POINTS)


def test_m12_groups_of_thousands_are_read(tmp_path):
    survey = [[412345.678, 5654321.123, 59.25]]
    np.testing.assert_allclose(read(tmp_path, "412.345,678;5.654.321,123;59,25\n"), survey)
    np.testing.assert_allclose(read(tmp_path, "412,345.678;5,654,321.123;59.25\n"), survey)
    np.testing.assert_allclose(read(tmp_path, "412 345,678;5 654 321,123;59,25\n"), survey)


@pytest.mark.parametrize(
    ("text", "points"),
    [("1,2,3,4\n", [[1, 2, 3]]), ("x,y,z,r,g,b\n1,2,3,4,5,6\n", [[1, 2, 3]]), ("1,2,3,-4,5,-6\n", [[1, 2, 3]])],
)
def test_m12_whole_numbers_between_commas_have_one_reading(tmp_path, text, points):
    np.testing.assert_allclose(read(tmp_path, text), points)


@pytest.mark.parametrize("text", ["1,250,0,500,0,010\n", "1,2,3,4,5,6\n", "1,25,3,50,4,10,0,5\n", "1,05,2\n"])
def test_m12_commas_with_two_readings_are_refused(tmp_path, text):
    with pytest.raises(InputError, match="are its commas decimal signs"):
        read(tmp_path, text)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("1,250;0.5;2\n", "is the comma a decimal sign"),
        ("1 2 3\n4 5\n", "line 2 is no point: '4 5'"),
        ("1 2 3\n4 5 a\n", "point 2: 'a' is no number"),
        ("1 2 3\n4 5 6 7\n", "line 2 has 4 columns; the lines before have 3"),
        ("lon,lat,alt\n1,2,3\n", "latitudes and longitudes; need metres"),
        ("a,b,c\n1,2,3\n", "columns are a, b, c; need x, y and z"),
        ("intensity x y z\n1 2 3\n", "4 names of columns"),
        ("\x00\x01\x02 1 2 3\n", "binary contents"),
        ("OFF\n3 1 0\n1 2 3\n4 5 6\n7 8 9\n3 0 1 2\n", "a mesh in the format OFF"),
        ("OFF\n3 0 0\n1 2 3\n4 5 6\n7 8 9\n", "a mesh in the format OFF; write it as PLY or OBJ"),
    ],
)
def test_m11_lines_that_are_no_points_are_named(tmp_path, text, words):
    with pytest.raises(InputError, match=words) as error:
        read(tmp_path, text)
    assert "\n" not in str(error.value)


def test_missing_coordinates_are_no_points(tmp_path):
    np.testing.assert_allclose(read(tmp_path, "x;y;z\n1;;3\n1;NA;2\n4;5;6\n"), [[4, 5, 6]])


SURVEY = np.array([[412345.678, 5654321.123, 0.01], [412346.25, 5654322.5, -1.5]])


def test_quoted_numbers_have_their_commas_to_themselves(tmp_path):
    grouped = "".join(",".join(f'"{value:,.3f}"' for value in point) + "\n" for point in SURVEY)
    decimal = "".join(",".join(f'"{value:.3f}"'.replace(".", ",") for value in point) + "\n" for point in SURVEY)
    for head in ("", '"X","Y","Z"\n', "x,y,z\n", '"Survey, 2024"\nx,y,z\n'):
        for text in (grouped, decimal, grouped.replace('","', '", "')):
            np.testing.assert_allclose(read(tmp_path, head + text), SURVEY)
        np.testing.assert_allclose(read(tmp_path, head.replace(",", ";") + decimal.replace('","', '";"')), SURVEY)
    with pytest.raises(InputError, match="is the comma a decimal sign"):
        read(tmp_path, '"1,250","0.5","2.5"\n')


@pytest.mark.parametrize("sign", [",", ";", "\t"])
def test_an_empty_last_field_is_a_missing_number_or_the_end_of_a_line(tmp_path, sign):
    def rewritten(text):
        return text.replace(",", sign)

    for head in ("", "x,y,z\n"):
        some = "1.0,2.0,\n1.5,2.5,3.5\n,,\n4.5,,\n5.5,6.5,7.5\n"
        np.testing.assert_allclose(read(tmp_path, rewritten(head + some)), [[1.5, 2.5, 3.5], [5.5, 6.5, 7.5]])
        ended = "1.0,2.0,3.0,\n1.5,2.5,3.5,\n"
        for end in (head, head.replace("z", "z,")):
            np.testing.assert_allclose(read(tmp_path, rewritten(end + ended)), [[1, 2, 3], [1.5, 2.5, 3.5]])
    with pytest.raises(InputError, match="none of its 2 points is finite"):
        read(tmp_path, rewritten("x,y,z\n1.0,2.0,\n1.5,2.5,\n"))


def test_lines_indented_by_tabs_are_read(tmp_path):
    for text in ("\t1.0\t2.0\t3.0\n", "x\ty\tz\n\t1.0\t2.0\t3.0\n", "\t1.0 2.0 3.0\n# a\n"):
        np.testing.assert_allclose(read(tmp_path, text), [[1, 2, 3]])


@pytest.mark.parametrize(
    ("head", "metres"),
    [
        ("x_ft,y_ft,z_ft", 0.3048),
        ("X(mm),Y(mm),Z(mm)", 0.001),
        ("X [cm];Y [cm];Z [cm]", 0.01),
        ("pos x in mm,pos y in mm,pos z in mm", 0.001),
        ("x,y,z\nmm,mm,mm", 0.001),
        ("x,y,z\n[ft],[ft],[ft]", 0.3048),
        ("easting [m],northing [m],height [cm]", (1, 1, 0.01)),
        ("x_m,y_m,z_m", 1),
        ("x [local],y [local],z", 1),
    ],
)
def test_units_in_a_header_count_unless_the_option_says_others(tmp_path, head, metres):
    text = head + "\n" + rows(between=";" if ";" in head else ",")
    np.testing.assert_allclose(read(tmp_path, text), POINTS * metres)
    np.testing.assert_allclose(read_points(tmp_path / "cloud.csv", units=2.0), POINTS * 2)


@pytest.mark.parametrize("between", [" ", ",", ";"])
def test_numbers_of_points_and_grids_need_names(tmp_path, between):
    numbered = np.c_[np.arange(1, 4), POINTS]
    lines = "".join(between.join(["%d", *["%.3f"] * 3]) % tuple(point) + "\n" for point in numbered)
    with pytest.raises(InputError, match=r"the first column counts 1, 2, 3: numbers of points.* id x y z"):
        read(tmp_path, lines)
    np.testing.assert_allclose(read(tmp_path, between.join(["id", "x", "y", "z"]) + "\n" + lines), POINTS)
    grid = rows(np.random.default_rng(0).random((12, 30)), between)
    with pytest.raises(InputError, match=r"12 lines of 30 numbers: a grid of heights.* HeightMap"):
        read(tmp_path, grid)


def test_an_ascii_grid_is_no_text_of_points(tmp_path):
    with pytest.raises(InputError, match="an ASCII grid of heights, no points; unpack it"):
        read(tmp_path, "ncols 3\nnrows 2\nxllcorner 0\nyllcorner 0\ncellsize 1\n1 2 3\n4 5 6\n", "grid.txt")


def test_nan_as_windows_prints_it_is_no_comment(tmp_path):
    np.testing.assert_allclose(read(tmp_path, "1 2 1.#QNAN\n1 2 3\n4 5 -1.#IND00\n"), [[1, 2, 3]])
