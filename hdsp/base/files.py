"""Atomic file replacement: a file is whole or absent."""

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from hdsp.base.errors import InputError


@contextmanager
def replacing(path: str | os.PathLike) -> Iterator[Path]:
    """Yields a temporary path beside ``path``, which replaces ``path`` after a successful block.

    A missing folder is created. If the process dies in between, ``path`` stays unchanged.

    Raises:
        InputError: the folder cannot be created or written to, or the disk is full.
    """
    path = Path(path)
    # The suffix stays last because writers choose their format by it; the leading dot hides leftovers from globs.
    temporary = path.with_name(f".{path.stem}.{os.getpid()}-{secrets.token_hex(4)}.tmp{path.suffix}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield temporary
        temporary.replace(path)
    except OSError as error:
        raise InputError(f"cannot write {path}: {error.strerror or error}".splitlines()[0]) from error
    finally:
        # Leftover after a failure; after a success it no longer exists.
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def existing_file(path: str | os.PathLike, what: str) -> Path:
    """Returns ``path`` as a Path.

    Raises:
        InputError: there is no such file; the message calls it ``what``.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{what} {path}: {'is a folder, not a file' if path.is_dir() else 'no such file'}")
    return path
