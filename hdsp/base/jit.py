"""``njit`` for this project: compiled once, kept on disk, compiled again when a kernel or a value inside it changes."""

import numba

from hdsp.base.kernel_cache import key_by_content


def njit(allocates: bool = True, **options):
    """Decorator: ``numba.njit(cache=True, error_model="numpy", **options)`` with keys from `hdsp.base.kernel_cache`.

    Args:
        allocates: whether the kernel creates or returns arrays. A kernel without new arrays needs no reference counts
            for its arguments, because its caller holds them. With tuples of dozens of arrays (``World``), counting
            takes longer than the work, once per call and again in every loop.
        options: ``numba.njit`` options.
    """
    if not allocates:
        options["_nrt"] = False  # numba's option for code without run-time memory management

    def decorate(function):
        kernel = numba.njit(cache=True, error_model="numpy", **options)(function)
        key_by_content(kernel)
        return kernel

    return decorate
