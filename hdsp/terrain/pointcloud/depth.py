"""Points from images: depth images with a known camera pose, and images of height maps."""

from __future__ import annotations

import os
from typing import Any, Self

import numpy as np
from pydantic import model_validator

from hdsp.base.errors import InputError
from hdsp.base.files import existing_file
from hdsp.base.messages import shown
from hdsp.base.settings import Count, NotNegative, Positive, checked, fault, load_settings
from hdsp.terrain.no_data import unmasked

#: Formats of images by Pillow's names; others, such as PostScript, start programs.
_FORMATS = ("PNG", "PPM", "TIFF", "JPEG", "BMP")


@checked
class Camera:
    """A pinhole camera; its axes: x right, y down, z forward.

    Attributes:
        fx, fy, cx, cy: focal lengths and principal point, pixels.
        depth_scale: metres per unit in the depth image; 0 in the image means "no measurement".
        nearest, farthest: m; depths outside are dropped, because the depth error grows with the square of the depth.
        stride: step between the used rows and between the used columns.
    """

    fx: Positive
    fy: Positive
    cx: float
    cy: float
    depth_scale: Positive
    nearest: NotNegative = 0.3
    farthest: Positive = 4.0
    stride: Count = 1

    @model_validator(mode="after")
    def _check(self) -> Self:
        if not self.nearest < self.farthest:
            raise fault("nearest", self.nearest, f"less than farthest, {self.farthest:g} m")
        return self


@checked
class Elevation:
    """Scale of a height map image.

    Attributes:
        highest: height for grey value 255, m.
        pixel: pixel size, m.
        spacing: distance between points interpolated from the image, m.
    """

    highest: Positive
    pixel: Positive
    spacing: Positive = 0.0125


def depth_points(image: np.ndarray, camera: Camera, pose=None) -> np.ndarray:
    """Converts a depth image to points.

    Args:
        image: [rows, columns], in units given by the camera's `depth_scale`.
        camera: the camera that took the image.
        pose: (x, y, z, qx, qy, qz, qw), camera to world, in metres; None = points in the camera frame.

    Returns:
        float64 [n, 3], m; one point for each pixel with a depth between the camera's nearest and farthest.

    Raises:
        InputError: if image, camera or pose is invalid.
    """
    image = _pixels(image, "depth image", 0)
    camera = load_settings(Camera, camera, "camera")
    row, column = np.indices(image.shape)[:, :: camera.stride, :: camera.stride]
    depth = image[:: camera.stride, :: camera.stride] * camera.depth_scale
    x, y = (column - camera.cx) / camera.fx * depth, (row - camera.cy) / camera.fy * depth
    points = np.stack([x, y, depth], axis=-1)[(depth > 0) & (depth >= camera.nearest) & (depth <= camera.farthest)]
    if pose is None:
        return points
    from scipy.spatial.transform import Rotation

    try:
        values = np.asarray(pose, dtype=float)
    except (TypeError, ValueError):
        values = np.empty(0)
    if values.shape != (7,) or not np.isfinite(values).all() or not np.linalg.norm(values[3:]) > 0.5:
        raise InputError(f"pose of a depth image is {shown(pose)}; need x, y, z and a quaternion qx, qy, qz, qw")
    return Rotation.from_quat(values[3:]).apply(points) + values[:3]


def elevation_points(image: np.ndarray, highest: float, pixel: float, spacing: float = 0.0125) -> np.ndarray:
    """Converts an image of a height map to points, interpolated between known pixels.

    Convention, as for grid_map images: the next row is a step along -x, the next column a step along -y.

    Args:
        image: [rows, columns], grey values; 0 = unknown, 255 = ``highest``.
        highest: m.
        pixel: pixel size, m.
        spacing: distance between points, m.

    Returns:
        float64 [n, 3], m.

    Raises:
        InputError: if the image is invalid, or another argument is not positive.
    """
    from scipy.ndimage import map_coordinates

    Elevation(highest, pixel, spacing)
    image = _pixels(image, "picture of a height map", 2)[::-1, ::-1]
    sides = [np.arange(0, (count - 1) * pixel, spacing) for count in image.shape]
    x, y = np.meshgrid(*sides, indexing="ij")
    place = np.stack([x, y]) / pixel
    heights = map_coordinates(image / 255 * highest, place, order=1)
    known = map_coordinates((image > 0).astype(float), place, order=1) > 1 - 1e-6
    return np.stack([x, y, heights], axis=-1)[known]


def _pixels(image: Any, name: str, least: int) -> np.ndarray:
    """An image as float64 [rows, columns] with at least so many rows and columns; NaN for masked pixels."""
    try:
        found = np.asarray(unmasked(image), dtype=float)
    except (TypeError, ValueError):
        raise InputError(f"{name} is {shown(image)}; need grey values [rows, columns]") from None
    if found.ndim != 2 or min(found.shape) < least:
        more = f", at least {least} x {least}" if least else ""
        raise InputError(f"{name} has shape {found.shape}; need [rows, columns]{more}")
    return found


def read_image(path: str | os.PathLike, max_pixels: int = 100_000_000) -> np.ndarray:
    """Reads grey values [rows, columns] from an 8 or 16 bit image; a colour image must have three equal channels.

    Args:
        path: a PNG, PGM, TIFF, JPEG or BMP file.
        max_pixels: largest number of pixels.

    Raises:
        InputError: if the file is missing, too large, or no grey image.
    """
    path = existing_file(path, "image")
    try:
        from PIL import Image

        with Image.open(path, formats=_FORMATS) as image:
            if image.width * image.height > max_pixels:
                size = f"{image.width} x {image.height} pixels"
                raise InputError(f"image {path} has {size}; at most {max_pixels:,} are read (max_pixels)")
            values = np.array(image)
    except InputError:
        raise
    except Exception as error:  # Pillow raises errors of many types for damaged files
        raise InputError(f"image {path} cannot be read: {' '.join(str(error).split())}") from error
    if values.ndim == 3 and values.shape[2] >= 3 and (values[..., :3] == values[..., :1]).all():
        values = values[..., 0]
    if values.ndim != 2:
        raise InputError(f"image {path} has shape {values.shape}; need one channel, or the same in all three")
    return values
