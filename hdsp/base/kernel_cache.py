"""Keys for kernels in Numba's disk cache: a key covers all code and every constant that a kernel freezes.

Numba's own key is a source file's time stamp. A kernel with functions or constants from other files would keep their
old versions after an edit. The key in this module comes from the kernel itself at its first call: its bytecode and
options, its named functions and constants, and everything they name in turn. Edits of comments or unused code cause no
compilation.
"""

import dis
import enum
import hashlib
import re
from collections.abc import Iterator
from functools import cache, cached_property
from types import CodeType, FunctionType, ModuleType
from typing import Any

import numba
import numpy as np
from numba.core.caching import IndexDataCacheFile

_CONFIG: Any = numba.config  # numba sets its members at run time


def key_by_content(kernel: Any) -> None:
    """Gives a cached Numba kernel a key from its content."""
    cache: Any = getattr(kernel, "_cache", None)
    if hasattr(cache, "_cache_file"):  # missing without the JIT
        cache._cache_file = _Index(kernel, cache)


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


def content_of(kernel: Any) -> str:
    """Returns a kernel's hex digest: bytecode, options, and all functions and constants it reaches in its package.

    Raises:
        TypeError: the kernel names a value whose text does not identify it.
    """
    digest = hashlib.sha256(f"bounds checked: {_CONFIG.BOUNDSCHECK}".encode())  # missing in Numba's key
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
