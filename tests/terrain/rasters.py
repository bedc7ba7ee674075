"""Small rasters as other programs write them, and the heights of which they tell."""

import numpy as np
import pytest
import rasterio
from affine import Affine

#: Rows and columns as a person would look at them: the first row is the northern edge.
PICTURE = np.array([[1, 2, 3], [4, 5, 6]], float)
#: The same as heights[ix, iy].
HEIGHTS = [[4, 1], [5, 2], [6, 3]]
NORTH_UP = Affine(0.5, 0, 100, 0, -0.5, 200)


def geotiff(path, rows=PICTURE, transform=NORTH_UP, *, mask=None, tags=None, **profile):
    """A GeoTIFF by rasterio; ``tags`` are attributes of the dataset, such as scales."""
    rows = np.asarray(rows)
    bands = rows if rows.ndim == 3 else rows[None]
    shape = {"count": len(bands), "height": bands.shape[1], "width": bands.shape[2]}
    with rasterio.open(path, "w", driver="GTiff", dtype=rows.dtype, transform=transform, **shape, **profile) as file:
        file.write(bands)
        if mask is not None:
            file.write_mask(mask)
        for name, value in (tags or {}).items():
            setattr(file, name, value)
    return path


def equal(terrain, heights, origin=(0.0, 0.0), resolution=0.5):
    np.testing.assert_allclose(terrain.heights, heights, rtol=1e-6)
    assert terrain.origin == pytest.approx(origin) and terrain.resolution == pytest.approx(resolution)
    return True
