"""Ground as MuJoCo shapes: boxes and wedges of scenes, boxes of height maps with blocks, height fields.

A height map with few heights becomes boxes, because a height field would turn each vertical edge into a slope. Its
cells are joined to rectangles of equal height. A map of natural ground becomes a height field with a vertex in each
cell.

Convention: world coordinates of the map relative to the simulation's origin, z up, m.
"""

from __future__ import annotations

from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np

from hdsp.detailed.motion.local_motion import Place
from hdsp.planning.driving.robot_model import child
from hdsp.terrain.height_map import HeightMap
from hdsp.terrain.obstacles import Block, Face, Scene, TiltedGround
from hdsp.viz.viewer.textures import height_colors

_MOST_BOXES = 4000
_THICK = 0.3  # m, of the ground below its lowest point
_EQUAL = 1e-4  # m; heights closer than this are equal
_GREY = ".86 .86 .83 1"


class EqualCells(NamedTuple):
    """Cells of equal height: from (x0, y0) to before (x1, y1)."""

    x0: int
    y0: int
    x1: int
    y1: int
    height: float


def rectangles(heights: np.ndarray, most: int = _MOST_BOXES) -> list[EqualCells] | None:
    """Joins cells of equal height to rectangles: runs along y, then equal runs in neighbouring columns.

    Args:
        heights: float [nx, ny], m; NaN belongs to no rectangle.
        most: largest number of rectangles.

    Returns:
        Rectangles that together cover each known cell once; None if there would be more than ``most``.
    """
    levels = np.round(heights / _EQUAL) * _EQUAL
    found: list[EqualCells] = []
    open_runs: dict[tuple[int, int, float], int] = {}
    for x, column in enumerate(levels):
        ends = np.flatnonzero(np.append(column[1:] != column[:-1], True)) + 1
        starts = np.concatenate([[0], ends[:-1]])
        runs = {
            (y0, y1, float(column[y0])) for y0, y1 in zip(starts.tolist(), ends.tolist(), strict=True)
            if not np.isnan(column[y0])
        }  # fmt: skip
        for run in [run for run in open_runs if run not in runs]:
            found.append(EqualCells(open_runs.pop(run), run[0], x, run[1], run[2]))
        for run in runs:
            open_runs.setdefault(run, x)
        if len(found) + len(open_runs) > most:
            return None
    found += [EqualCells(x0, y0, len(levels), y1, height) for (y0, y1, height), x0 in open_runs.items()]
    return found


class GroundModel:
    """Ground in a model.

    Attributes:
        field: heights for ``model.hfield_data``, float32, scaled to [0, 1]; None without a height field.
    """

    def __init__(self, root: ElementTree.Element, terrain: HeightMap | Scene, place: Place):
        self.field: np.ndarray | None = None
        self._place = place
        self._world, self._assets = child(root, "worldbody"), child(root, "asset")
        if isinstance(terrain, Scene):
            self._add_scene(terrain)
        else:
            self._add_map(terrain)

    def _add_scene(self, scene: Scene) -> None:
        ground, tilt = scene.ground, {}
        if ground is not None:
            level, up = ground.height(*self._place), (-ground.slope_x, -ground.slope_y, 1.0)
            tilt = {"pos": _text(0.0, 0.0, level), "zaxis": _text(*up)}
        self._add("plane", **({"pos": "0 0 0", "size": "50 50 1", "rgba": _GREY} | tilt))
        for obstacle in scene.obstacles:
            for block in obstacle.blocks():
                for face in block.faces():
                    self._add_face(block, face, ground)

    def _add_face(self, block: Block, face: Face, ground: TiltedGround | None) -> None:
        """Column below a plane piece; inclined pieces, and all on tilted ground, are convex meshes."""
        face = face._replace(x=face.x - self._place[0], y=face.y - self._place[1])
        turn = f"0 0 {face.yaw:.7g}"
        if not face.slope_along and not face.slope_across and ground is None:
            half = face.height / 2
            self._add(
                "box", pos=_text(face.x, face.y, half), euler=turn,
                size=_text(face.length / 2, face.width / 2, half), rgba=_shade(face.height),
            )  # fmt: skip
            return
        cos, sin = np.cos(face.yaw), np.sin(face.yaw)
        corners = []
        for along in (-face.length / 2, face.length / 2):
            for across in (-face.width / 2, face.width / 2):
                top = max(face.height + face.slope_along * along + face.slope_across * across, 0.0)
                x, y = face.x + cos * along - sin * across, face.y + sin * along + cos * across
                level = 0.0 if ground is None else float(ground.height(x + self._place[0], y + self._place[1]))
                corners += [(x, y, level - _THICK), (x, y, level + top)]
        self._add_mesh(np.array(corners), _shade(block.height))

    def _add_mesh(self, corners: np.ndarray, color: str) -> None:
        """Convex hull of points [n, 3]; the mesh frame is its centre of inertia, so the world frame is given back."""
        name = f"piece{len(self._assets)}"
        text = "  ".join(_text(*corner) for corner in corners.tolist())
        ElementTree.SubElement(self._assets, "mesh", name=name, vertex=text, inertia="convex")
        self._add("mesh", mesh=name, rgba=color)

    def _add_map(self, terrain: HeightMap) -> None:
        heights = terrain.heights
        found = rectangles(heights)
        low, cell = float(np.nanmin(heights)), terrain.resolution
        if found is None:
            self._add_field(terrain, low)
            return
        (x0, y0), colors = self._corner(terrain), height_colors(terrain)[..., :3] / 255.0
        for piece in found:
            x, y = x0 + (piece.x0 + piece.x1) / 2 * cell, y0 + (piece.y0 + piece.y1) / 2 * cell
            half = (piece.height - low + _THICK) / 2
            color = 1 - 0.62 * (1 - colors[piece.x0, piece.y0])
            self._add(
                "box", pos=_text(x, y, piece.height - half),
                size=_text((piece.x1 - piece.x0) * cell / 2, (piece.y1 - piece.y0) * cell / 2, half),
                rgba=" ".join(f"{value:.3f}" for value in (*color, 1.0)),
            )  # fmt: skip

    def _add_field(self, terrain: HeightMap, low: float) -> None:
        heights, cell = np.where(np.isnan(terrain.heights), low, terrain.heights), terrain.resolution
        (nx, ny), span = heights.shape, max(float(heights.max()) - low, 1e-3)
        reach = (nx - 1) * cell / 2, (ny - 1) * cell / 2
        x0, y0 = self._corner(terrain)
        middle = x0 + nx * cell / 2, y0 + ny * cell / 2
        size = _text(*reach, span, _THICK)
        ElementTree.SubElement(self._assets, "hfield", name="ground", nrow=str(ny), ncol=str(nx), size=size)
        self._add("hfield", hfield="ground", pos=_text(*middle, low), rgba=_GREY)
        self.field = ((heights.T - low) / span).astype(np.float32).ravel()

    def _corner(self, terrain: HeightMap) -> tuple[float, float]:
        return terrain.origin[0] - self._place[0], terrain.origin[1] - self._place[1]

    def _add(self, kind: str, **values: str) -> None:
        fixed = {"type": kind, "contype": "1", "conaffinity": "0", "friction": "0.01 0.005 0.0001"}
        ElementTree.SubElement(self._world, "geom", fixed | values)


def _text(*lengths: float) -> str:
    """Lengths to a hundredth of a millimetre at least, also hundreds of metres."""
    return " ".join(f"{value:.7g}" if abs(value) < 100 else f"{value:.6f}" for value in lengths)


def _shade(height: float) -> str:
    return ".80 .78 .74 1" if height >= 0.7 else ".83 .68 .50 1"
