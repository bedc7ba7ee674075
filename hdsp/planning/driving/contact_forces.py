"""Ground forces on the wheels that carry a robot, by a quadratic programme (quadprog).

The forces hold the wanted wrench on the centre of mass as well as friction pyramids allow, and are small otherwise.
"""

from __future__ import annotations

import numpy as np

from hdsp.base.errors import InputError

_SMALL = 1e-3  # weight of small forces against the wrench
_PYRAMID = 0.7  # a pyramid inside the friction cone


class ContactForces:
    """Distributes a wrench.

    Args:
        friction: friction coefficient.
        most: largest force of one wheel along the normal, N.
        lever: length that turns torques to forces, m.
    """

    def __init__(self, friction: float, most: float, lever: float):
        try:
            from quadprog import solve_qp
        except ImportError as error:
            raise InputError(
                f"driving needs quadprog ({error}); install it with: pip install 'hdsp[simulation]'"
            ) from None
        self._solve, self._most, self._lever = solve_qp, most, lever
        share = _PYRAMID * friction
        self._sides = np.array(
            [(0, 0, 1), (1, 0, share), (-1, 0, share), (0, 1, share), (0, -1, share), (0, 0, -1)], float
        )

    def __call__(self, feet: np.ndarray, center: np.ndarray, wrench: np.ndarray, load: np.ndarray) -> np.ndarray:
        """Returns ground forces, float64 [4, 3], N.

        Args:
            feet: float64 [4, 3], contact points, m.
            center: float64 [3], centre of mass, m.
            wrench: float64 [6], wanted force (N) and torque (Nm) on the centre of mass.
            load: float64 [4] in [0, 1], share of the largest force that each wheel may take; 0 for a wheel in the air.
        """
        carrying = np.flatnonzero(load > 0)
        n = 3 * len(carrying)
        acts = np.zeros((6, n))
        for k, foot in enumerate(carrying.tolist()):
            x, y, z = feet[foot] - center
            acts[:3, 3 * k : 3 * k + 3] = np.eye(3)
            acts[3:, 3 * k : 3 * k + 3] = np.array([(0, -z, y), (z, 0, -x), (-y, x, 0)]) / self._lever
        wanted = wrench / np.array([1, 1, 1, *[self._lever] * 3])
        limits = np.zeros((n, 6 * len(carrying)))
        bounds = np.zeros(6 * len(carrying))
        for k, foot in enumerate(carrying.tolist()):
            limits[3 * k : 3 * k + 3, 6 * k : 6 * k + 6] = self._sides.T
            bounds[6 * k + 5] = -self._most * load[foot]
        forces = np.zeros((4, 3))
        forces[carrying] = self._solve(acts.T @ acts + _SMALL * np.eye(n), acts.T @ wanted, limits, bounds)[0].reshape(
            -1, 3
        )
        return forces
