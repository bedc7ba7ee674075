"""Keys of the kernels that Numba keeps on disk: a key covers all code and every constant that a kernel freezes.

Numba's own key is the time stamp of the file in which a function stands. A kernel that calls functions of other files,
or uses their constants, would go on with the old ones after these were edited. The key here is taken from the kernel
itself when it is first called: its bytecode and options, the functions and constants that it names, and all that these
name. An edit of comments or of code that a kernel does not use compiles nothing.
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


def key_by_content(kernel: Any) -> None:
    """Give a kernel that Numba caches the key described above."""
    cache = getattr(kernel, "_cache", None)
    if hasattr(cache, "_cache_file"):  # not when the JIT is off
        cache._cache_file = _Index(kernel, cache)


class _Index(IndexDataCacheFile):
    """Numba's list of the machine code of a kernel, under its content instead of the time and line of its source."""

    def __init__(self, kernel: Any, cache: Any):
        self._kernel = kernel
        # `kernel-123.py311` without the line: a kernel that moves down replaces its old machine code.
        super().__init__(cache._cache_path, re.sub(r"-\d+(\.py\d+\w*)$", r"\1", cache._impl.filename_base), None)

    @cached_property
    def _content(self) -> str:
        return content_of(self._kernel)

    @property
    def _source_stamp(self) -> str:
        return self._content

    @_source_stamp.setter
    def _source_stamp(self, stamp: Any) -> None:
        """Numba sets a stamp of its own first."""

    def _load_index(self) -> dict:
        try:
            return super()._load_index()
        except Exception:  # a damaged file, or types of arguments that were somewhere else then: compile again
            return {}

    def load(self, key: Any) -> Any:
        try:
            return super().load(key)
        except Exception:  # as above
            return None


def content_of(kernel: Any) -> str:
    """Hex digest of a kernel: bytecode, options, and all functions and constants of its package that it reaches.

    Raises:
        TypeError: if it names a value that cannot be told from another one by its text.
    """
    digest = hashlib.sha256(f"bounds checked: {numba.config.BOUNDSCHECK}".encode())  # a switch that Numba's key lacks
    found = [kernel]
    numbers = {id(_python(kernel)): 0}
    package = _python(kernel).__module__.partition(".")[0]
    for function in found:  # grows while it is read
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
    """The Python function inside a kernel or an intrinsic; None if the value is neither these nor a function."""
    if isinstance(value, type):
        return None
    inner = getattr(value, "py_func", getattr(value, "__wrapped__", value))
    return inner if isinstance(inner, FunctionType) else None


def _parts(kernel: Any, package: str) -> Iterator[Any]:
    """All that one function is made of: instructions, options, constants, and what its names stand for."""
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
        elif number or constant != function.__doc__:  # the first one is the docstring
            yield constant
    for value in (function.__globals__[name] for name in _global_names(code) if name in function.__globals__):
        if isinstance(value, ModuleType) and value.__name__.partition(".")[0] == package:
            yield from (vars(value)[inner] for inner in code.co_names if inner in vars(value))
        else:
            yield value


@cache
def _global_names(code: CodeType) -> list[str]:
    """Names that code takes from its module or from the builtins, in order."""
    steps = dis.get_instructions(code)
    return list(dict.fromkeys(step.argval for step in steps if step.opname == "LOAD_GLOBAL"))


def _in_words(value: Any) -> str:
    """A text that two different values do not share, the same in every process."""
    if isinstance(value, ModuleType):
        return value.__name__
    if isinstance(value, enum.EnumType):
        return f"{value.__qualname__} {[_in_words(member) for member in value]}"
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
