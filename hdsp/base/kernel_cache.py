"""Numba's disk cache: its keys cover all code and every constant that a kernel freezes, and its folder can be written.

Numba's own key is a source file's time stamp. A kernel with functions or constants from other files would keep their
old versions after an edit. The key in this module comes from the kernel itself at its first call: its bytecode and
options, its named functions and constants, and everything they name in turn. Edits of comments or unused code cause no
compilation.

Numba keeps machine code beside the source or in the user's home. In a read-only installation without a home, a private
folder for temporary files takes their place, and a warning names it.
"""

import atexit
import dis
import enum
import hashlib
import logging
import os
import re
import shutil
import stat
import tempfile
from collections.abc import Iterator
from functools import cache, cached_property
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any

import numba
import numpy as np
from numba.core import types
from numba.core.caching import IndexDataCacheFile

_CONFIG: Any = numba.config  # numba sets its members at run time
_LOG = logging.getLogger(__name__)


def _share_versions(kernel: Any) -> None:
    """Lets calls with constants use the version for variables; Numba would compile a version for each constant."""
    if not hasattr(kernel, "get_call_template"):  # missing without the JIT
        return
    template = kernel.get_call_template

    def shared(arguments: tuple[Any, ...], named: dict[str, Any]) -> Any:
        found = tuple(map(types.unliteral, arguments))
        return template(found, {name: types.unliteral(kind) for name, kind in named.items()})

    kernel.get_call_template = shared


def keep_on_disk(kernel: Any) -> None:
    """Gives a Numba kernel a disk cache with a key from its content, and few versions to keep there."""
    _share_versions(kernel)
    if not hasattr(kernel, "enable_caching"):  # missing without the JIT
        return
    try:
        kernel.enable_caching()
    except RuntimeError:  # no folder of Numba's choice can be written
        if not _enable_in_spare_folder(kernel):
            return
    cache: Any = kernel._cache
    cache._cache_file = _Index(kernel, cache)


def _enable_in_spare_folder(kernel: Any) -> bool:
    folder, before = _spare_folder(), _CONFIG.CACHE_DIR
    if folder is None:
        return False
    _CONFIG.CACHE_DIR = str(folder)
    try:
        kernel.enable_caching()
    except RuntimeError:  # the disk is full
        return False
    finally:
        _CONFIG.CACHE_DIR = before
    return True


@cache
def _spare_folder() -> Path | None:
    """Folder among the temporary files in which only this user writes; None without one. Warns once."""
    try:
        folder = Path(tempfile.gettempdir()) / f"hdsp-kernels-{os.getuid() if hasattr(os, 'getuid') else 'user'}"
        folder.mkdir(mode=stat.S_IRWXU, exist_ok=True)
        if not _is_private(folder):  # machine code from others could run any command
            folder = Path(tempfile.mkdtemp(prefix="hdsp-kernels-"))
            atexit.register(shutil.rmtree, folder, ignore_errors=True)
    except OSError:
        _LOG.warning("no folder for compiled kernels can be written; each process compiles its own (NUMBA_CACHE_DIR)")
        return None
    _LOG.warning(
        "the folder of hdsp cannot be written; compiled kernels are in %s (NUMBA_CACHE_DIR changes it)", folder
    )
    return folder


def _is_private(folder: Path) -> bool:
    found = folder.lstat()
    if not stat.S_ISDIR(found.st_mode):
        return False
    return not hasattr(os, "getuid") or (
        found.st_uid == os.getuid() and not found.st_mode & (stat.S_IRWXG | stat.S_IRWXO)
    )


@cache
def _warn_unsaved(reason: str) -> None:
    _LOG.warning("compiled kernels cannot be kept: %s (NUMBA_CACHE_DIR names another folder)", reason)


class _Index(IndexDataCacheFile):
    """Numba's index of a kernel's machine code, keyed by content instead of source time and line."""

    def __init__(self, kernel: Any, cache: Any):
        self._kernel = kernel
        # `kernel-123.py311` without the line: a kernel at another line replaces its old machine code.
        super().__init__(cache._cache_path, re.sub(r"-\d+(\.py\d+\w*)$", r"\1", cache._impl.filename_base), None)

    @cached_property
    def _content(self) -> str:
        return content_of(self._kernel)

    @property
    def _source_stamp(self) -> str:
        return self._content

    @_source_stamp.setter
    def _source_stamp(self, stamp: Any) -> None:
        """Ignores Numba's own stamp."""

    def _load_index(self) -> dict:
        try:
            return super()._load_index()
        except Exception:  # a damaged file, or argument types that moved since: compile again
            return {}

    def load(self, key: Any) -> Any:
        try:
            return super().load(key)
        except Exception:  # as above
            return None

    def save(self, key: Any, data: Any) -> None:
        try:
            super().save(key, data)
        except OSError as error:  # the disk is full, or the folder became read-only
            _warn_unsaved(error.strerror or str(error))


def content_of(kernel: Any) -> str:
    """Returns a kernel's hex digest: bytecode, options, and all functions and constants it reaches in its package.

    Raises:
        TypeError: the kernel names a value whose text does not identify it.
    """
    digest = hashlib.sha256(f"bounds checked: {_CONFIG.BOUNDSCHECK}".encode())  # missing in Numba's key
    digest.update(_layout())
    found = [kernel]
    numbers = {id(_python(kernel)): 0}
    package = _python(kernel).__module__.partition(".")[0]
    for function in found:  # grows during the loop
        for value in _parts(function, package):
            if (code := _python(value)) is None:
                text = _in_words(value)
            else:
                if id(code) not in numbers:
                    numbers[id(code)] = len(found)
                    found.append(value)
                text = f"function {numbers[id(code)]}"
            digest.update(f"{text}\n".encode())
    return digest.hexdigest()


@cache
def _layout() -> bytes:
    """Text of the module by which kernels read records, because machine code depends on it."""
    return Path(__file__).with_name("records.py").read_bytes()


def _python(value: Any) -> FunctionType | None:
    """Python function inside a kernel, an intrinsic or a function; None for other values."""
    if isinstance(value, type):
        return None
    inner = getattr(value, "py_func", getattr(value, "__wrapped__", value))
    return inner if isinstance(inner, FunctionType) else None


def _parts(kernel: Any, package: str) -> Iterator[Any]:
    """All parts of a function: instructions, options, constants, and the values of its names."""
    function = _python(kernel)
    assert function is not None
    yield getattr(kernel, "targetoptions", None)
    if function.__module__.partition(".")[0] != package:
        yield f"{function.__module__}.{function.__qualname__}"
        return
    yield from (function.__defaults__, function.__kwdefaults__)
    yield from (cell.cell_contents for cell in function.__closure__ or ())
    yield from _parts_of_code(function.__code__, function, package)


def _parts_of_code(code: CodeType, function: FunctionType, package: str) -> Iterator[Any]:
    yield from (code.co_code, code.co_exceptiontable, code.co_varnames, code.co_names)
    for number, constant in enumerate(code.co_consts):
        if isinstance(constant, CodeType):
            yield from _parts_of_code(constant, function, package)
        elif number or constant != function.__doc__:  # constant 0 is the docstring
            yield constant
    for value in (function.__globals__[name] for name in _global_names(code) if name in function.__globals__):
        if isinstance(value, ModuleType) and value.__name__.partition(".")[0] == package:
            yield from (vars(value)[inner] for inner in code.co_names if inner in vars(value))
        else:
            yield value


@cache
def _global_names(code: CodeType) -> list[str]:
    """Names that code reads from its module or from builtins, in order."""
    steps = dis.get_instructions(code)
    return list(dict.fromkeys(step.argval for step in steps if step.opname == "LOAD_GLOBAL"))


def _in_words(value: Any) -> str:
    """Text that identifies a value, the same in every process."""
    if isinstance(value, ModuleType):
        return value.__name__
    if isinstance(value, enum.EnumType):
        members: list[Any] = list(value)
        return f"{value.__qualname__} {[_in_words(member) for member in members]}"
    if isinstance(value, type):
        return f"{value.__qualname__} {getattr(value, '_fields', '')}"
    if isinstance(value, enum.Enum):
        return f"{value!s} {value.value!r}"
    if isinstance(value, np.ndarray):
        return f"{value.dtype} {value.shape} {hashlib.sha256(value.tobytes()).hexdigest()}"
    if isinstance(value, dict):
        return f"{{{', '.join(f'{key}: {_in_words(item)}' for key, item in value.items())}}}"
    if isinstance(value, tuple | list):
        return f"{type(value).__name__} ({', '.join(map(_in_words, value))})"
    if isinstance(value, frozenset):
        return f"{sorted(map(_in_words, value))}"
    if re.search(r"\bat 0x[0-9a-f]+", text := f"{type(value).__qualname__} {value!r}"):
        raise TypeError(f"a kernel freezes {text}, whose value no key can hold")
    return text
