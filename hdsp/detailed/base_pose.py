"""Base pose: height, pitch and roll of the base over the ground under its feet.

The ground of the base is the plane through the ground under the four feet. Its gradient ahead is the difference
between the mean heights of the front and the rear feet over their mean distance; its gradient to the left follows from
the left and the right feet. Both are exact on any plane, with feet at any offsets. Between feet on steps, the plane
would be steeper than any slope; the base leans by no more than the steepest slope (``Slope``). The base lies above the
plane, at its centre's height.

Search, relaxed problems, refinement and reasons all take the base pose from here. Source: ours; the paper says nothing
about it. Evidence: docs/cost-model.md.
"""

import numpy as np

from hdsp.base.jit import njit
from hdsp.robot.robot import Robot


@njit(inline="always")
def ground_plane(neutral_x, neutral_y, steepest_ahead, steepest_left, x, z):
    """Plane through the ground under four feet.

    Args:
        neutral_x, neutral_y: neutral position of the front left foot.
        steepest_ahead, steepest_left: largest gradients.
        x: foot offsets from the neutral positions, a tuple in foot order.
        z: heights under the feet, a tuple.

    Returns:
        Height of the plane under the base centre, gradient ahead, gradient to the left. Lengths and offsets may have
        another unit than heights; gradients are then in height units per length unit.
    """
    front, rear = 0.5 * (x[0] + x[3]), 0.5 * (x[1] + x[2])
    left, right = 0.5 * (x[0] + x[1]), 0.5 * (x[2] + x[3])
    ahead = 0.5 * ((z[0] + z[3]) - (z[1] + z[2])) / (2 * neutral_x + front - rear)
    across = (0.5 * ((z[0] + z[1]) - (z[2] + z[3])) - ahead * (left - right)) / (2 * neutral_y)
    ahead = min(max(ahead, -steepest_ahead), steepest_ahead)
    across = min(max(across, -steepest_left), steepest_left)
    return 0.25 * ((z[0] + z[1]) + (z[2] + z[3])) - ahead * 0.5 * (front + rear), ahead, across


def base_poses(robot: Robot, offsets: np.ndarray, heights: np.ndarray) -> np.ndarray:
    """Base poses over feet on the ground.

    Args:
        robot: the robot.
        offsets: float64 [n, 4], foot offsets from the neutral positions, m.
        heights: float64 [n, 4], ground under the feet, m.

    Returns:
        Float64 [n, 3]: ground height under the base centre (m), roll and pitch (rad). Positive roll leans to the
        right, positive pitch lowers the nose, as in `hdsp.detailed.motion.motion`.
    """
    feet, steepest = robot.feet, robot.slope.steepest()
    planes = _ground_planes(feet.neutral_x, feet.neutral_y, *steepest, np.asarray(offsets, float), heights)
    ground, ahead, left = planes.T
    # Rz(heading) Ry(pitch) Rx(roll): the base's left side rises by sin(roll) cos(pitch) per metre.
    pitch = -np.arctan(ahead)
    return np.stack([ground, np.arctan(left * np.cos(pitch)), pitch], axis=1)


@njit()
def _ground_planes(neutral_x, neutral_y, steepest_ahead, steepest_left, offsets, heights):
    planes = np.empty((len(offsets), 3))
    for k in range(len(offsets)):
        x = offsets[k, 0], offsets[k, 1], offsets[k, 2], offsets[k, 3]
        z = np.float64(heights[k, 0]), np.float64(heights[k, 1]), np.float64(heights[k, 2]), np.float64(heights[k, 3])
        planes[k] = ground_plane(neutral_x, neutral_y, steepest_ahead, steepest_left, x, z)
    return planes
