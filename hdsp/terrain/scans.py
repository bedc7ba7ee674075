"""Scans of real places: description, files, and height map.

A small YAML file (conf/scans) describes a scan: source and licence, file format, and the parts to cut off. Several
scans may show one place; results are reported per place.
"""

from __future__ import annotations

import math
import os
import re
from collections.abc import Mapping
from dataclasses import asdict, field
from pathlib import Path, PurePosixPath
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from hdsp.base.downloads import DATA_DIR_VARIABLE, data_folder, fetch, first_words, verify
from hdsp.base.errors import InputError
from hdsp.base.settings import FileName, Name, NotNegative, PathInside, Positive, checked, fault, load_settings
from hdsp.base.yaml_files import Document, read_yaml
from hdsp.terrain.height_map import HeightMap
from hdsp.terrain.pointcloud import (
    Camera,
    MapSettings,
    depth_points,
    fit_floor,
    level,
    read_points,
)
from hdsp.terrain.pointcloud import register as register_clouds
from hdsp.terrain.pointcloud.depth import Elevation, elevation_points, read_image

#: Folder of the scans in a data folder: files lie in real/NAME/.
FOLDER = "real"

_PACKAGE = re.compile(r"^#\s*@package\s+scans\.sources\.(\S+)", re.MULTILINE)

Axis = Literal["x", "y", "z", "-x", "-y", "-z"]


@checked
class ScanFile:
    """One file of a scan.

    Attributes:
        path: path relative to the scan's address.
        sha256: checksum of the contents.
        local: path relative to the scan's folder in a data folder; default: the last part of ``path``.
        pose: camera pose for a depth image, camera to world: x, y, z (m), qx, qy, qz, qw.
        guess: x, y (m), yaw (rad): approximate pose relative to the first file's cloud. Registration starts from it.
    """

    path: Annotated[PathInside, Field(min_length=1)]
    sha256: Name
    local: PathInside = ""
    pose: tuple[float, float, float, float, float, float, float] | None = None
    guess: tuple[float, float, float] | None = None

    @property
    def place(self) -> str:
        return self.local or PurePosixPath(self.path).name


@checked
class Scan:
    """A scan of a real place.

    Attributes:
        name: unique name.
        place: the scanned place; scans of one place share this value.
        what: a sentence about the scan.
        sensor: sensor name.
        licence: licence for the files.
        source: web page with the files, for people.
        address: download address for programs; ends with a slash.
        files: at least one file.
        units, axes: arguments of `read_points` for point files; without ``units``, LAS and LAZ have those of their CRS.
        drop_within: m; points closer to the sensor's vertical axis are dropped, because they show the carrying robot.
        level_each: whether each file is levelled on its floor before the files are fused.
        camera: camera of the depth images; None = the files are no depth images.
        elevation: scale of height map images; None = the files are no height map images.
        map: settings for the conversion from points to heights.
    """

    name: FileName
    place: Name
    what: str
    sensor: str
    licence: Name
    source: Name
    address: Name
    files: Annotated[tuple[ScanFile, ...], Field(min_length=1)]
    units: Positive | None = None
    axes: tuple[Axis, Axis, Axis] = ("x", "y", "z")
    drop_within: NotNegative = 0.0
    level_each: bool = False
    camera: Camera | None = None
    elevation: Elevation | None = None
    map: MapSettings = field(default_factory=MapSettings)

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.camera is not None and self.elevation is not None:
            raise fault("elevation", asdict(self.elevation), "none beside camera: files are of one kind")
        return self

    @classmethod
    def from_dict(cls, name: str, values: Mapping[str, Any], document: Document | None = None) -> Scan:
        """Makes a scan from plain nested values, as in a YAML file.

        Raises:
            InputError: if a key is unknown or missing; the message names it.
        """
        return load_settings(cls, {"name": name, **values}, f"scan {name}", document)


def load_scan(path: str | os.PathLike) -> Scan:
    """Loads the description of a scan; its name is that of the line ``# @package scans.sources.NAME``, or the file's.

    Raises:
        InputError: if the file is missing, or a key is unknown or missing.
    """
    document = read_yaml(path, "description of a scan")
    found = _PACKAGE.search(document.text)
    return Scan.from_dict(found.group(1) if found else Path(path).stem, document.values, document)


def find_files(
    scan: Scan,
    data_dir: str | os.PathLike | None = None,
    timeout: float = 30.0,
    beside: str | os.PathLike | None = None,
) -> tuple[list[Path], str]:
    """Finds a scan's files in the data folder, or downloads them once from their address. Checksums are verified.

    Args:
        scan: the scan.
        data_dir: the data folder; None = that of the environment.
        timeout: s, for each download.
        beside: folder of the description; the files may be in ``real/NAME/`` or ``NAME/`` below it, or in it.

    Returns:
        (paths in the order of the scan's files, ""), or ([], reason why a file is missing and how to get it).

    Raises:
        InputError: if a file in the data folder has another checksum.
    """
    if beside is not None:
        for place in places_beside(scan, Path(beside)):
            if all(os.path.isfile(place / file.place) for file in scan.files):
                return [verify(place / file.place, file.sha256) for file in scan.files], ""
    folder = data_folder(data_dir)
    paths = []
    for file in scan.files:
        local = folder / FOLDER / scan.name / file.place if folder else None
        if local and os.path.isfile(local):
            paths.append(verify(local, file.sha256))
            continue
        url = scan.address + file.path
        try:
            paths.append(fetch(url, file.sha256, f"{scan.name}-{PurePosixPath(file.path).name}", timeout))
        except Exception as error:  # no failed download may stop a pipeline that can run without the scan
            looked = f"not in {folder}" if folder else f"{DATA_DIR_VARIABLE} is not set"
            return [], (
                f"scan {scan.name}: {looked} and not fetched from {url}: {first_words(error)}; put its files into "
                f"{FOLDER}/{scan.name}/ in a folder and name that folder in {DATA_DIR_VARIABLE}"
            )
    return paths, ""


def places_beside(scan: Scan, folder: Path) -> tuple[Path, ...]:
    """Returns the folders where a scan's files may be if its description is in ``folder``, the first choice first."""
    return folder / FOLDER / scan.name, folder / scan.name, folder


def build_map(scan: Scan, paths: list[Path]) -> HeightMap:
    """Builds a scan's height map from its files: reads, levels, registers, fuses and rasterises them.

    Raises:
        InputError: if a file is missing or cannot be read, or its points make no map; the message names the scan.
    """
    if len(paths) != len(scan.files):
        raise InputError(f"scan {scan.name}: {len(paths)} files; its description has {len(scan.files)}")
    try:
        clouds = [_cloud(scan, file, path) for file, path in zip(scan.files, paths, strict=True)]
        for k, file in enumerate(scan.files):
            if file.guess is not None and k > 0:
                motion = register_clouds(clouds[k], clouds[0], _motion(*file.guess))
                clouds[k] = clouds[k] @ motion[:3, :3].T + motion[:3, 3]
        return HeightMap.from_points(np.concatenate(clouds), scan.map)
    except InputError as error:
        raise InputError(f"scan {scan.name}: {error}") from None


def _cloud(scan: Scan, file: ScanFile, path: Path) -> np.ndarray:
    if scan.camera is not None:
        points = depth_points(read_image(path), scan.camera, file.pose)
    elif scan.elevation is not None:
        points = elevation_points(read_image(path), **asdict(scan.elevation))
    else:
        points = read_points(path, scan.units, scan.axes)
    if scan.drop_within:
        points = points[np.hypot(points[:, 0], points[:, 1]) > scan.drop_within]
    if len(points) == 0:
        raise InputError(f"{file.place}: no point is left; look at drop_within, and at camera or elevation")
    return level(points, fit_floor(points, scan.map.floor)) if scan.level_each else points


def _motion(x: float, y: float, yaw: float) -> np.ndarray:
    c, s = math.cos(yaw), math.sin(yaw)
    return np.array([[c, -s, 0, x], [s, c, 0, y], [0, 0, 1, 0], [0, 0, 0, 1]])
