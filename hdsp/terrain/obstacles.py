"""Obstacles on level or tilted ground: blocks, ramps, banks, tiles, staircases, and the height map of a scene of them.

Convention: x forward, y left, m; yaw counter-clockwise, rad.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple, overload

import numpy as np

from hdsp.base.short_repr import short_repr
from hdsp.robot import lattice
from hdsp.robot.lattice import Grid
from hdsp.terrain.height_map import HeightMap

_ON_SIDE = 1e-9  # m; a point this close to a side counts as on the side, despite rounding errors


class Face(NamedTuple):
    """A plane piece of an upper side, rectangular seen from above.

    Attributes:
        x, y: centre, m.
        yaw: direction of the length, rad.
        length, width: m.
        height: its centre's height, m.
        slope_along, slope_across: rise over run along the length and to its left.
    """

    x: float
    y: float
    yaw: float
    length: float
    width: float
    height: float
    slope_along: float = 0.0
    slope_across: float = 0.0


@dataclass(frozen=True)
class Block:
    """A block on the ground: a cuboid, a wall, or one step of a staircase.

    Attributes:
        x, y: centre, m.
        yaw: direction of the length, rad.
        length, width, height: m.
    """

    x: float
    y: float
    yaw: float
    length: float
    width: float
    height: float

    def blocks(self) -> tuple["Block", ...]:
        return (self,)

    def covers(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Whether points (x, y) lie on the block, sides included; bool with x's shape."""
        turn = lattice.rotation(-self.yaw)
        along = turn[0, 0] * (x - self.x) + turn[0, 1] * (y - self.y)
        across = turn[1, 0] * (x - self.x) + turn[1, 1] * (y - self.y)
        return (np.abs(along) <= self.length / 2 + _ON_SIDE) & (np.abs(across) <= self.width / 2 + _ON_SIDE)

    def top(self, x: np.ndarray, y: np.ndarray) -> np.ndarray | float:
        """Upper side's height at points (x, y) on the block, m."""
        return self.height

    def faces(self) -> tuple[Face, ...]:
        """Plane pieces of the upper side; where they lie below the ground, the ground counts."""
        return (Face(self.x, self.y, self.yaw, self.length, self.width, self.height),)

    def _face(self, begin: float, end: float, low: float, high: float) -> Face:
        """Face over the whole width from ``begin`` to ``end`` along the length, with these heights at its ends."""
        ahead = (begin + end - self.length) / 2
        x, y = self.x + ahead * math.cos(self.yaw), self.y + ahead * math.sin(self.yaw)
        slope = (high - low) / (end - begin)
        return Face(x, y, self.yaw, end - begin, self.width, (low + high) / 2, slope)


@dataclass(frozen=True)
class Ramp(Block):
    """A wedge: its upper side rises along ``yaw`` from the ground to ``height`` over ``length``."""

    def top(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        along = math.cos(self.yaw) * (x - self.x) + math.sin(self.yaw) * (y - self.y)
        return self.height * np.clip(0.5 + along / self.length, 0.0, 1.0)

    def faces(self) -> tuple[Face, ...]:
        return (self._face(0.0, self.length, 0.0, self.height),)


@dataclass(frozen=True)
class Bank(Block):
    """A block with an inclined end: its upper side rises along ``yaw`` over ``run``, then is level at ``height``.

    A run of 0 is a sharp edge.

    Attributes:
        run: horizontal length of the incline, m; at most ``length``.
    """

    run: float

    def top(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        along = math.cos(self.yaw) * (x - self.x) + math.sin(self.yaw) * (y - self.y) + self.length / 2
        return self.height * np.clip(along / max(self.run, _ON_SIDE), 0.0, 1.0)

    def faces(self) -> tuple[Face, ...]:
        level = (self._face(self.run, self.length, self.height, self.height),) if self.run < self.length else ()
        return ((self._face(0.0, self.run, 0.0, self.height),) if self.run > 0 else ()) + level


@dataclass(frozen=True)
class Tilted(Block):
    """A block with a plane upper side; ``height`` is its middle's height, and may be less than half its rise.

    Attributes:
        slope_along, slope_across: rise over run along the length and to its left.
    """

    slope_along: float
    slope_across: float

    def top(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        turn = lattice.rotation(-self.yaw)
        along = turn[0, 0] * (x - self.x) + turn[0, 1] * (y - self.y)
        across = turn[1, 0] * (x - self.x) + turn[1, 1] * (y - self.y)
        return np.maximum(self.height + self.slope_along * along + self.slope_across * across, 0.0)

    def faces(self) -> tuple[Face, ...]:
        return (super().faces()[0]._replace(slope_along=self.slope_along, slope_across=self.slope_across),)


@dataclass(frozen=True)
class Tiles(Block):
    """A field of square tiles, each with its own height and tilt; ``height`` is unused.

    Attributes:
        side: tile side length, m; tiles at the far borders may be cut.
        tiles: rows along the length; each tile is (height at the middle in m, slope along, slope across).
    """

    side: float
    tiles: tuple[tuple[tuple[float, float, float], ...], ...]

    def __repr__(self) -> str:
        return short_repr(self)

    def top(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        turn = lattice.rotation(-self.yaw)
        along = turn[0, 0] * (x - self.x) + turn[0, 1] * (y - self.y) + self.length / 2
        across = turn[1, 0] * (x - self.x) + turn[1, 1] * (y - self.y) + self.width / 2
        tiles = np.array(self.tiles)
        i, j = (
            np.clip(np.floor(at / self.side), 0, count - 1).astype(int)
            for at, count in zip((along, across), tiles.shape, strict=False)
        )
        height, slope_along, slope_across = np.moveaxis(tiles[i, j], -1, 0)
        top = height + slope_along * (along - (i + 0.5) * self.side) + slope_across * (across - (j + 0.5) * self.side)
        return np.maximum(top, 0.0)

    def faces(self) -> tuple[Face, ...]:
        found = []
        cos, sin = math.cos(self.yaw), math.sin(self.yaw)
        for i, row in enumerate(self.tiles):
            for j, (height, slope_along, slope_across) in enumerate(row):
                length = min(self.side, self.length - i * self.side)
                width = min(self.side, self.width - j * self.side)
                along = i * self.side + (length - self.length) / 2
                across = j * self.side + (width - self.width) / 2
                # The height counts at the middle of the whole tile.
                height += slope_along * (length - self.side) / 2 + slope_across * (width - self.side) / 2
                x, y = self.x + cos * along - sin * across, self.y + sin * along + cos * across
                found.append(Face(x, y, self.yaw, length, width, height, slope_along, slope_across))
        return tuple(found)


@dataclass(frozen=True)
class Staircase:
    """Steps that rise along ``yaw``; each step is a block that begins at its own riser.

    Attributes:
        x, y: middle of the first riser, m.
        yaw: direction of ascent, rad.
        steps: number of steps.
        rise, tread: step height, distance between two risers, m.
        width: width across the direction of ascent, m.
        depth: step length behind the riser, m; the last step is the landing.
    """

    x: float
    y: float
    yaw: float
    steps: int
    rise: float
    tread: float
    width: float
    depth: float

    def blocks(self) -> tuple[Block, ...]:
        return tuple(self._step(number) for number in range(self.steps))

    def _step(self, number: int) -> Block:
        middle = number * self.tread + self.depth / 2
        x, y = self.x + middle * math.cos(self.yaw), self.y + middle * math.sin(self.yaw)
        return Block(x, y, self.yaw, self.depth, self.width, self.rise * (number + 1))


@dataclass(frozen=True)
class TiltedGround:
    """Tilted ground through the scene's origin.

    Attributes:
        slope_x, slope_y: rise over run along x and along y.
    """

    slope_x: float
    slope_y: float

    @overload
    def height(self, x: float, y: float) -> float: ...

    @overload
    def height(self, x: np.ndarray, y: np.ndarray) -> np.ndarray: ...

    def height(self, x, y):
        """Heights at points (x, y), m."""
        return self.slope_x * x + self.slope_y * y


Obstacle = Block | Staircase


@dataclass(frozen=True)
class Scene:
    """Obstacles on the ground.

    Attributes:
        obstacles: blocks and staircases; their heights count from the ground below each point.
        ground: tilted ground; None: level ground at height 0.
    """

    obstacles: tuple[Obstacle, ...]
    ground: TiltedGround | None = None

    def __repr__(self) -> str:
        return short_repr(self)

    def rasterise(self, shape: tuple[int, int], center_cell: tuple[int, int], angle: float = 0.0) -> HeightMap:
        """Makes a height map with the heights at the cell centres. Where obstacles overlap, the highest one counts.

        Args:
            shape: map size (nx, ny) in cells.
            center_cell: cell with its centre at the scene's origin.
            angle: counter-clockwise rotation of the scene, rad; rotations by 90 degrees permute the cells exactly.

        Returns:
            a height map with the scene's origin at world (0, 0).
        """
        grid = Grid((0.0, 0.0), shape)
        offset = grid.center(center_cell)
        cells = np.moveaxis(np.indices(shape), 0, -1) - center_cell
        x, y = np.moveaxis(grid.center(cells) - grid.center((0, 0)), -1, 0)
        turn = lattice.rotation(-angle)
        x, y = turn[0, 0] * x + turn[0, 1] * y, turn[1, 0] * x + turn[1, 1] * y
        return HeightMap(self.heights_at(x, y), origin=tuple(-offset))

    def heights_at(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Heights at points (x, y), m; float32 with x's shape."""
        heights = np.zeros(np.shape(x), np.float32)
        for obstacle in self.obstacles:
            for block in obstacle.blocks():
                top = np.asarray(block.top(x, y), np.float32)
                np.maximum(heights, top, out=heights, where=block.covers(x, y))
        if self.ground is not None:
            heights += self.ground.height(x, y)
        return heights
