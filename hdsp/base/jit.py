"""``njit`` for this project: compiled once, kept on disk, compiled again when a kernel or a value inside it changes."""

import numba

from hdsp.base.kernel_cache import key_by_content


def njit(allocates: bool = True, **options):
    """Decorator: ``numba.njit(cache=True, error_model="numpy", **options)`` with the keys of `hdsp.base.kernel_cache`.

    Args:
        allocates: whether the kernel makes arrays, or returns any. One that does neither need not count references to
            those it is given, which its caller holds. With tuples of dozens of arrays (``World``), counting takes
            longer than the work, once in every call and again in every loop.
        options: of ``numba.njit``.
    """
    if not allocates:
        options["_nrt"] = False  # numba's switch for code without its run-time memory management

    def decorate(function):
        kernel = numba.njit(cache=True, error_model="numpy", **options)(function)
        key_by_content(kernel)
        return kernel

    return decorate
