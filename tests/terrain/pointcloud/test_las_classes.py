"""Points in LAS and LAZ files that the file itself calls no measurements are left out."""

import numpy as np
import pytest

from hdsp.base.errors import InputError
from hdsp.terrain.pointcloud import read_points

PLACES = np.arange(18.0).reshape(6, 3)
#: Class 18 is noise only in formats with 256 classes.
CLASSES = (2, 7, 18, 2, 0, 6)
WITHHELD = (0, 0, 0, 1, 0, 0)


def las(path, kind, classes=CLASSES, withheld=WITHHELD):
    laspy = pytest.importorskip("laspy")
    header = laspy.LasHeader(point_format=kind, version="1.4" if kind >= 6 else "1.2")
    header.scales = [1e-3] * 3
    data = laspy.LasData(header)
    data.x, data.y, data.z = PLACES.T
    data.classification, data.withheld = np.array(classes, np.uint8), np.array(withheld, np.uint8)
    data.synthetic = np.ones(len(PLACES), np.uint8)  # another flag beside
    data.write(path)
    return path


@pytest.mark.parametrize("suffix", ["las", "laz"])
@pytest.mark.parametrize(("kind", "kept"), [(0, [0, 2, 4, 5]), (3, [0, 2, 4, 5]), (6, [0, 4, 5]), (7, [0, 4, 5])])
def test_noise_and_withheld_points_are_left_out_and_counted(tmp_path, suffix, kind, kept):
    path = las(tmp_path / f"a.{suffix}", kind)
    with pytest.warns(UserWarning, match=f"^{6 - len(kept)} points called noise or withheld left out"):
        np.testing.assert_allclose(read_points(path), PLACES[kept])
    las(path, kind, (2,) * 6, (0,) * 6)
    np.testing.assert_allclose(read_points(path), PLACES)


@pytest.mark.filterwarnings("ignore:6 points")
def test_a_file_of_noise_has_no_point(tmp_path):
    with pytest.raises(InputError, match="none of its 6 points is finite"):
        read_points(las(tmp_path / "a.las", 6, (7,) * 6))
