"""Rounding of heights: they are float32, so a difference of two heights may exceed a limit that it just reaches."""

import numpy as np
from numba.extending import register_jitable

#: Least tolerance, m: sums and means of heights, e.g. of conditioned maps, round several times.
_LEAST = 1e-5
#: Distance between neighbouring float32 values, as a share of the larger one, at most.
ROUNDING = float(np.finfo(np.float32).eps)


@register_jitable
def height_tolerance(height):
    """Excess (m) over a limit that counts as rounding, for the difference of two heights.

    Args:
        height: one of both heights, or an array of them, m.
    """
    return _LEAST + ROUNDING * abs(height)
