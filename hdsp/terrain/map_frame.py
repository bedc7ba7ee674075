"""Frame of a height map: where it lies in the world of the file or cloud from which it was made."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from hdsp.base.errors import InputError
from hdsp.base.messages import shown


@dataclass(frozen=True, eq=False)
class MapFrame:
    """Relation between a height map and its source: a point cloud, a survey, a robot's odometry.

    Attributes:
        name: source frame's name, e.g. ``odom``; "" if the source has none.
        crs: coordinate reference system of the source, e.g. ``EPSG:25832`` or WKT; "" if unknown.
        to_source: float64 [4, 4], rigid motion from the map frame to the source frame, metres; a read-only copy. The
            identity unless the source was levelled, turned or lifted.
        notes: what was read and assumed, one phrase each, e.g. the layer of a grid_map or a tilt that was removed.

    Raises:
        InputError: if ``to_source`` is no rigid motion.
    """

    name: str = ""
    crs: str = ""
    to_source: np.ndarray = field(default_factory=lambda: np.eye(4))
    notes: tuple[str, ...] = ()

    def __post_init__(self):
        try:
            motion = np.array(self.to_source, dtype=float)
        except (TypeError, ValueError, OverflowError):
            raise InputError(f"map frame: to_source is {shown(self.to_source)}; need a rigid motion, 4 x 4") from None
        if motion.shape != (4, 4) or not np.isfinite(motion).all() or not _is_rigid(motion):
            raise InputError(f"map frame: to_source is {motion.tolist()}; need a rigid motion, 4 x 4")
        motion.flags.writeable = False
        object.__setattr__(self, "to_source", motion)
        object.__setattr__(self, "notes", tuple(str(note) for note in self.notes))

    @property
    def is_source(self) -> bool:
        """Whether map and source frame are the same."""
        return bool((self.to_source == np.eye(4)).all())

    def on_axes(self, rotation: np.ndarray, origin: np.ndarray) -> MapFrame:
        """Returns the frame of a map with other axes and the same source.

        Args:
            rotation: float64 [2, 2], from the new axes to the axes of this map.
            origin: float64 [2], place of the new origin in this map, m.
        """
        motion = np.eye(4)
        motion[:2, :2], motion[:2, 3] = rotation, origin
        return replace(self, to_source=self.to_source @ motion)

    def points_to_source(self, points: np.ndarray) -> np.ndarray:
        """Moves points [..., 3] (m) from the map frame to the source frame."""
        return np.asarray(points, float) @ self.to_source[:3, :3].T + self.to_source[:3, 3]

    def points_from_source(self, points: np.ndarray) -> np.ndarray:
        """Moves points [..., 3] (m) from the source frame to the map frame."""
        return (np.asarray(points, float) - self.to_source[:3, 3]) @ self.to_source[:3, :3]


def _is_rigid(motion: np.ndarray) -> bool:
    turn = motion[:3, :3]
    straight = np.allclose(turn @ turn.T, np.eye(3), atol=1e-6) and np.linalg.det(turn) > 0
    return bool(straight and (motion[3] == (0, 0, 0, 1)).all())
