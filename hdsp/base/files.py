"""Atomic file replacement: a file is whole or absent."""

import os
import re
import secrets
import shutil
import stat
import tempfile
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path

from hdsp.base.errors import InputError
from hdsp.base.messages import shown


@contextmanager
def replacing(path: str | os.PathLike) -> Iterator[Path]:
    """Yields a temporary path beside ``path``, which replaces ``path`` after a successful block.

    A missing folder is created. If the process dies in between, ``path`` stays unchanged, and the next write of the
    file removes the temporary one. Contents and name are on the disk at the end of the block, also after a loss of
    power. A link in place of the file is replaced; its target stays, for example in a cache.

    Raises:
        InputError: the folder cannot be created or written to, or the disk is full.
    """
    path = Path(path)
    temporary = _temporary(path)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield temporary
        _sync(temporary)
        temporary.replace(path)
        _sync(path.parent)
        _remove_leftovers(path)
    except OSError as error:
        raise InputError(f"cannot write {path}: {error.strerror or error}".splitlines()[0]) from error
    finally:
        # Leftover after a failure; after a success it no longer exists.
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def replace_folder(folder: Path, files: Mapping[str, bytes]) -> Path:
    """Writes a folder with these files, by name, in place of an existing one; behind a link, in place of its target.

    If the process dies in between, the former folder stays as it was, or, between two renamings, beside its place under
    a name with a leading dot; the next write removes that.

    Raises:
        InputError: the folder cannot be written, the disk is full, or the working folder lies in it.
    """
    given, folder = folder, Path(os.path.realpath(folder))
    if _has_working_folder(folder):
        raise InputError(f"cannot write {given}: the working folder lies in it, and would be lost; name another folder")
    work, former = _temporary(folder), _temporary(folder)
    try:
        work.mkdir(parents=True)
        for name, content in files.items():
            (work / name).write_bytes(content)
            _sync(work / name)
        _sync(work)
        if os.path.exists(folder):
            folder.rename(former)
        work.rename(folder)
        _sync(folder.parent)
    except OSError as error:
        if os.path.exists(former) and not os.path.exists(folder):
            former.rename(folder)
        raise InputError(f"cannot write {given}: {error.strerror or error}") from error
    finally:
        shutil.rmtree(work, ignore_errors=True)
        if os.path.exists(folder):
            shutil.rmtree(former, ignore_errors=True)
            _remove_leftovers(folder)
    return given


def _has_working_folder(folder: Path) -> bool:
    try:
        return Path.cwd().is_relative_to(folder)
    except OSError:  # it was removed
        return False


def _temporary(path: Path) -> Path:
    # The suffix stays last because writers choose their format by it; the leading dot hides leftovers from globs.
    return path.with_name(f".{path.stem}.{os.getpid()}-{secrets.token_hex(4)}.tmp{path.suffix}")


def _remove_leftovers(path: Path) -> None:
    """Removes temporary files or folders of a path from processes of this machine that died."""
    pattern = re.compile(rf"\.{re.escape(path.stem)}\.(\d+)-[0-9a-f]{{8}}\.tmp{re.escape(path.suffix)}")
    with os.scandir(path.parent) as entries:
        found = [(entry, int(match[1])) for entry in entries if (match := pattern.fullmatch(entry.name))]
    for leftover, process in found:
        if _is_alive(process):
            continue
        if leftover.is_dir():
            shutil.rmtree(leftover.path, ignore_errors=True)
        else:
            Path(leftover.path).unlink(missing_ok=True)


def _is_alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:  # of another user
        return True
    return True


def _sync(path: Path) -> None:
    """Waits until a file's contents, or a folder's names, are on the disk."""
    opened = os.open(path, os.O_RDONLY)
    try:
        os.fsync(opened)
    finally:
        os.close(opened)


def writable_file(path: str | os.PathLike, what: str, suffixes: Collection[str] = ()) -> Path:
    """Returns ``path`` as a Path after a check that a file can be written there; a missing folder is created.

    Args:
        path: path of the file.
        what: the file's name in messages.
        suffixes: allowed suffixes in small letters; none: any.

    Raises:
        InputError: another suffix, a folder in place of the file, a name that is too long, or a folder that cannot be
            written to.
    """
    path = as_path(path, what)
    if suffixes and path.suffix.lower() not in suffixes:
        raise InputError(f"{what} {path}: suffix {path.suffix!r}; need {' or '.join(suffixes)}")
    if os.path.isdir(path):
        raise InputError(f"{what} {path}: is a folder, not a file")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=path.parent).close()
        for name in (path, _temporary(path)):  # one of them may be too long
            with suppress(FileNotFoundError):
                os.lstat(name)
    except OSError as error:
        raise InputError(f"cannot write {path}: {error.strerror or error}".splitlines()[0]) from error
    return path


def made_folder(path: Path) -> Path:
    """Returns a folder after its creation, if it is missing.

    Raises:
        InputError: it cannot be created, for example because a file is in its place.
    """
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"cannot write {error.filename or path}: {error.strerror or error}") from error
    return path


def existing_file(path: str | os.PathLike, what: str) -> Path:
    """Returns ``path`` as a Path.

    Raises:
        InputError: there is no such file, or the system refuses to look at it; the message calls it ``what``.
    """
    path = as_path(path, what)
    try:
        mode = os.stat(path).st_mode
    except (FileNotFoundError, NotADirectoryError, ValueError):  # ValueError: a zero byte in the name
        raise InputError(f"{what} {path}: no such file") from None
    except OSError as error:
        raise InputError(f"{what} {path}: {error.strerror}") from None
    if not stat.S_ISREG(mode):
        raise InputError(f"{what} {path}: is {'a folder, not a file' if stat.S_ISDIR(mode) else 'no ordinary file'}")
    return path


def as_path(path: str | os.PathLike, what: str) -> Path:
    """Returns ``path`` as a Path.

    Raises:
        InputError: it is neither a text nor a path; the message calls it ``what``.
    """
    try:
        return Path(path)
    except TypeError:
        raise InputError(f"path of {what} is {shown(path)}; need a text or a Path") from None
