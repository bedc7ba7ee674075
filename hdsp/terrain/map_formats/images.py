"""Height map images by Pillow: PNG and PGM, 8 or 16 bit, with grey values as heights.

The first row of an image is the upper edge of the map (largest y), its first column the left edge (smallest x).
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from hdsp.base.errors import InputError
from hdsp.terrain.map_formats.fields import MapFields, MissingOption, ReadOptions

#: Deflate unpacks a byte to at most 1032, of eight pixels each.
_PIXELS_IN_A_BYTE = 8 * 1032
_FORMATS = {".png": ["PNG"], ".pgm": ["PPM"]}


def read_image_map(path: Path, options: ReadOptions) -> MapFields:
    """Reads grey values; cell size and metres per grey step are options."""
    units = "an image has no units; give the option scale, metres per grey step (and offset, nodata)"
    further = f"; {units}" if options.scale is None else ""
    resolution = options.cell_size("an image has no cell size", further)
    if further:
        raise MissingOption(units)
    with _opened(path, options) as image:
        grey = _grey(image)
    return MapFields(grey.T[:, ::-1], options.origin or (0.0, 0.0), resolution)


def image_contents(path: Path) -> str:
    """Size, mode and range of grey values of an image."""
    with _opened(path, ReadOptions()) as image:
        grey = _grey(image)
        return f"{image.width} x {image.height} pixels, mode {image.mode}, grey values {grey.min()} to {grey.max()}"


@contextmanager
def _opened(path: Path, options: ReadOptions) -> Iterator[Any]:
    from PIL import Image

    with Image.open(path, formats=_FORMATS[path.suffix.lower()]) as image:
        options.check_cells(image.width, image.height)
        if image.width * image.height > _PIXELS_IN_A_BYTE * path.stat().st_size:
            raise InputError(f"it is cut off or damaged: {image.width} x {image.height} pixels in so short a file")
        yield image


def _grey(image: Any) -> np.ma.MaskedArray:
    """Grey values [rows, columns] as in the file; transparent pixels are masked."""
    largest = _largest(image)
    transparent = image.info.get("transparency")
    if image.mode == "F":
        raise InputError("its grey values are floats (Pf); need whole numbers, or a GeoTIFF")
    if image.mode == "P":
        image = image.convert("RGBA" if transparent is not None else "RGB")
    values = np.array(image)
    mask: np.ndarray | bool = False
    if values.ndim == 3 and image.mode in ("LA", "RGBA"):
        values, mask = values[..., :-1], values[..., -1] == 0
    elif isinstance(transparent, int) and values.ndim == 2:
        mask = values == transparent
    if values.ndim == 3 and (values == values[..., :1]).all():
        values = values[..., 0]
    if values.ndim != 2:
        raise InputError(f"it is a colour image (mode {image.mode}); need grey values")
    if largest is not None:  # Pillow stretches a PGM to 8 or 16 bits
        values = np.rint(values.astype(float) * largest / (255 if largest < 256 else 65535)).astype(np.int32)
    return np.ma.masked_array(values.astype(np.int32), mask=mask)


def _largest(image: Any) -> int | None:
    """Largest grey value of a PGM; None where Pillow gives the values of the file."""
    if image.format != "PPM" or not image.tile:
        return None
    arguments = image.tile[0][3]
    return int(arguments[1]) if isinstance(arguments, tuple) and isinstance(arguments[1], int) else None
