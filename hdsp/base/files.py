"""Files that are whole or absent."""

import os
import secrets
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from hdsp.base.errors import InputError


@contextmanager
def replacing(path: str | os.PathLike) -> Iterator[Path]:
    """Yields a temporary path beside ``path``; what is written there becomes ``path`` when the block ends well.

    The folder is created if missing. A process that dies in between leaves ``path`` as it was.

    Raises:
        InputError: if the folder cannot be made or written to, or the disk is full.
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
        # Only the writer's own leftover; after a success it no longer exists.
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def existing_file(path: str | os.PathLike, what: str) -> Path:
    """``path`` as a Path.

    Raises:
        InputError: if there is no such file; the message calls it ``what``.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{what} {path}: {'is a folder, not a file' if path.is_dir() else 'no such file'}")
    return path
