"""Folders whose files are whole or absent: on disk, or in an object store by URL (fsspec).

A local file is written beside its final path and then renamed. An object store shows only complete objects.
"""

import os
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Protocol

from hdsp.base.errors import InputError
from hdsp.base.files import replacing

#: Local path, or fsspec URL (``s3://bucket/labels``, ``gs://...``, ``memory://...``, ``file:///...``).
Place = str | os.PathLike

_WRITES = 5  # attempts


class Folder(Protocol):
    """Files by name.

    Attributes:
        place: path or URL, valid in any process on any machine with access to the folder.
        of_one_process: whether the contents are invisible to other processes.
    """

    @property
    def place(self) -> str: ...

    @property
    def of_one_process(self) -> bool: ...

    def prepare(self) -> None:
        """Creates the folder; raises `InputError` if it is not writable."""

    def names(self) -> list[str]:
        """Returns the sorted file names; empty if the folder does not exist."""

    def read(self, name: str) -> bytes:
        """Returns a file's contents; raises `InputError` if it cannot be read."""

    def write(self, name: str, content: bytes) -> None:
        """Creates or replaces a file; raises `InputError` on a failure."""

    def remove(self, name: str) -> None:
        """Removes a file if it exists."""

    def set_aside(self, name: str) -> str:
        """Moves a file into the sibling folder with suffix ``.foreign``; returns its new place."""


def is_url(place: Place) -> bool:
    """Returns whether a place is a URL instead of a path."""
    return "://" in str(place)


def open_folder(place: Place) -> Folder:
    """Returns the folder at a path or URL; it need not exist.

    Raises:
        InputError: fsspec does not know the URL, or the package for it is not installed.
    """
    if is_url(place) and not str(place).startswith("file://"):
        return _RemoteFolder(str(place))
    return _LocalFolder(Path(str(place).removeprefix("file://")))


def split_place(place: Place) -> tuple[Folder, str]:
    """Splits a file's place into its folder and its name."""
    if is_url(place):
        parent, _, name = str(place).rstrip("/").rpartition("/")
        return open_folder(parent if not parent.endswith("/") else f"{parent}/"), name
    return open_folder(Path(place).parent), Path(place).name


def is_folder(place: Place) -> bool:
    """Returns whether a folder exists at a path or URL."""
    folder = open_folder(place)
    if isinstance(folder, _LocalFolder):
        return folder.path.is_dir()
    assert isinstance(folder, _RemoteFolder)
    return folder.exists()


class _LocalFolder:
    of_one_process = False

    def __init__(self, path: Path):
        self.path = path

    @property
    def place(self) -> str:
        return str(self.path.resolve())  # a worker may have another working directory

    def prepare(self) -> None:
        try:
            self.path.mkdir(parents=True, exist_ok=True)
            with tempfile.TemporaryFile(dir=self.path):
                pass
        except OSError as error:
            raise InputError(f"cannot write to {self.path}: {error.strerror}") from error

    def names(self) -> list[str]:
        return sorted(path.name for path in self.path.iterdir() if path.is_file()) if self.path.is_dir() else []

    def read(self, name: str) -> bytes:
        path = self.path / name
        try:
            return path.read_bytes()
        except OSError as error:
            reason = "no such file" if isinstance(error, FileNotFoundError) else error.strerror
            raise InputError(f"{path} cannot be read: {reason}") from error

    def write(self, name: str, content: bytes) -> None:
        # Another run in this folder may take the temporary file for one that a stopped run has left, and remove it.
        for tries_left in reversed(range(_WRITES)):
            try:
                with replacing(self.path / name) as temporary:
                    temporary.write_bytes(content)
                return
            except InputError as error:
                if tries_left == 0 or not isinstance(error.__cause__, FileNotFoundError):
                    raise

    def remove(self, name: str) -> None:
        with self._changing(name):
            (self.path / name).unlink(missing_ok=True)

    def set_aside(self, name: str) -> str:
        aside = self.path.with_name(f"{self.path.name}.foreign")
        with self._changing(name):
            aside.mkdir(exist_ok=True)
            target = aside / _free_name(name, lambda other: (aside / other).exists())
            (self.path / name).rename(target)
        return str(target)

    @contextmanager
    def _changing(self, name: str) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise InputError(f"cannot change {self.path / name}: {error.strerror}") from error


class _RemoteFolder:
    def __init__(self, url: str):
        self.place = url.rstrip("/") if not url.endswith("://") else url
        try:
            import fsspec

            self._files, self._root = fsspec.core.url_to_fs(self.place)
        except (ImportError, ValueError) as error:
            raise InputError(f"cannot use {url}: {_one_line(error)}") from error
        self.of_one_process = type(self._files).__name__ == "MemoryFileSystem"

    def prepare(self) -> None:
        probe = ".can-be-written"

        def write_and_remove() -> None:
            self._files.makedirs(self._root, exist_ok=True)  # needed by file systems, not by object stores
            self._files.pipe_file(self._path(probe), b"")
            self._files.rm_file(self._path(probe))

        self._try(write_and_remove, f"cannot write to {self.place}")

    def exists(self) -> bool:
        return self._try(lambda: self._files.isdir(self._root), f"cannot look at {self.place}")

    def names(self) -> list[str]:
        def listing() -> list[dict]:
            self._files.invalidate_cache()  # other processes write here too
            return self._files.ls(self._root, detail=True) if self._files.isdir(self._root) else []

        entries = self._try(listing, f"cannot list {self.place}")
        return sorted(entry["name"].rpartition("/")[2] for entry in entries if entry["type"] == "file")

    def read(self, name: str) -> bytes:
        return self._try(lambda: self._files.cat_file(self._path(name)), f"{self.place}/{name} cannot be read")

    def write(self, name: str, content: bytes) -> None:
        self._try(lambda: self._files.pipe_file(self._path(name), content), f"cannot write {self.place}/{name}")

    def remove(self, name: str) -> None:
        def remove() -> None:
            if self._files.exists(self._path(name)):
                self._files.rm_file(self._path(name))

        self._try(remove, f"cannot remove {self.place}/{name}")

    def set_aside(self, name: str) -> str:
        def move() -> str:
            aside = f"{self._root}.foreign"
            self._files.makedirs(aside, exist_ok=True)
            target = f"{aside}/{_free_name(name, lambda other: self._files.exists(f'{aside}/{other}'))}"
            self._files.mv(self._path(name), target)
            return self._files.unstrip_protocol(target)

        return self._try(move, f"cannot move {self.place}/{name}")

    def _path(self, name: str) -> str:
        return f"{self._root}/{name}"

    def _try(self, action: Callable[[], Any], failure: str) -> Any:
        try:
            return action()
        except Exception as error:  # each store has its own errors: no network, no rights, no such bucket
            raise InputError(f"{failure}: {_one_line(error)}") from error


def _free_name(name: str, taken: Callable[[str], bool]) -> str:
    numbered = (f"{name}.{k}" for k in range(1, 1_000_000))
    return name if not taken(name) else next(other for other in numbered if not taken(other))


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split()) or type(error).__name__
