"""``njit`` for this project: compiled once, kept on disk, and compiled anew when any kernel it could call has changed.

Numba keeps machine code by the time stamp of the file a function stands in. A kernel that calls (and inlines) functions
of other files would go on running their old code after these were edited. Here the key also holds a hash of all sources
of the package that contain kernels.
"""

import hashlib
from functools import lru_cache
from pathlib import Path

import numba


def njit(allocates: bool = True, **options):
    """Decorator: ``numba.njit(cache=True, error_model="numpy", **options)`` with the key described above.

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
        _extend_cache_key(kernel)
        return kernel

    return decorate


def _extend_cache_key(kernel) -> None:
    file = getattr(getattr(kernel, "_cache", None), "_cache_file", None)
    if file is not None:  # absent when the JIT is off
        file._source_stamp = (file._source_stamp, _kernel_sources())


@lru_cache(maxsize=1)
def _kernel_sources() -> str:
    package = Path(__file__).parents[1]
    digest = hashlib.sha256()
    for path in sorted(package.rglob("*.py")):
        source = path.read_bytes()
        if b"njit" in source:
            digest.update(str(path.relative_to(package)).encode() + source)
    return digest.hexdigest()
