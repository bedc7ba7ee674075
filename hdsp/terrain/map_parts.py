"""Rectangular parts of maps, as slices along both axes."""

import numpy as np

#: Slices along both axes.
Part = tuple[slice, slice]


def widened(part: Part, reach: int, shape: tuple[int, ...]) -> Part:
    """Part with ``reach`` more cells on all sides, cut off at the border of an array."""
    a, b = (slice(max(cut.start - reach, 0), min(cut.stop + reach, n)) for cut, n in zip(part, shape, strict=True))
    return a, b


def within(inner: Part, outer: Part) -> Part:
    """Slices of a part in an array that holds a larger part."""
    a, b = (slice(i.start - o.start, i.stop - o.start) for i, o in zip(inner, outer, strict=True))
    return a, b


def changed_part(before: np.ndarray, after: np.ndarray, part: Part) -> Part:
    """Smallest part that holds all cells in a part in which two arrays differ."""
    old, new = before[part], after[part]
    changed = np.argwhere((old != new) & ~(np.isnan(old) & np.isnan(new)))
    if len(changed) == 0:
        return slice(part[0].start, part[0].start), slice(part[1].start, part[1].start)
    (x0, y0), (x1, y1) = changed.min(axis=0).tolist(), changed.max(axis=0).tolist()
    return (
        slice(part[0].start + x0, part[0].start + x1 + 1),
        slice(part[1].start + y0, part[1].start + y1 + 1),
    )
