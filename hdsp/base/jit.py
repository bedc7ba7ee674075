"""``njit`` for this project: compiled once, kept on disk, compiled again when a kernel or a value inside it changes."""

from collections.abc import Callable
from typing import Any, ParamSpec, TypeVar

import numba

from hdsp.base import compilation as _compilation  # noqa: F401, listens to Numba
from hdsp.base.kernel_cache import keep_on_disk

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")


def njit(
    allocates: bool = True, **options: Any
) -> Callable[[Callable[Arguments, Result]], Callable[Arguments, Result]]:
    """Decorator: ``numba.njit(error_model="numpy", **options)`` with a disk cache from `hdsp.base.kernel_cache`.

    Args:
        allocates: whether the kernel creates or returns arrays. A kernel without new arrays needs no reference counts
            for its arguments, because its caller holds them.
        options: ``numba.njit`` options. ``nogil=True`` is for kernels that may take longer than a millisecond: other
            threads go on meanwhile. A short kernel would wait longer for the lock than it works.
    """
    if not allocates:
        options["_nrt"] = False  # numba's option for code without run-time memory management

    def decorate(function: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
        kernel = numba.njit(error_model="numpy", **options)(function)
        keep_on_disk(kernel)
        return kernel

    return decorate
