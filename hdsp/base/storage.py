"""Folders whose files are whole or absent: on disk, or in an object store by URL (fsspec).

A local file is written beside its final path and then renamed. An object store shows only complete objects.
"""

import os
import shutil
import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Protocol

from hdsp.base.errors import InputError
from hdsp.base.files import replacing

#: Local path, or fsspec URL (``s3://bucket/labels``, ``gs://...``, ``memory://...``, ``file:///...``).
Place = str | os.PathLike

_WRITES = 5  # attempts


class Folder(Protocol):
    """Files by name; a name may lead into subfolders (``a/b.h5``).

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
        """Returns the sorted names of its own files; empty if the folder does not exist."""

    def folders(self) -> list[str]:
        """Returns the sorted names of its subfolders; empty if the folder does not exist."""

    def stamps(self) -> dict[str, str]:
        """Returns all files, also in subfolders, with a text that changes when a file is written again.

        The text consists of size and time, or the store's own mark of a version.
        """

    def has(self, name: str) -> bool:
        """Returns whether a file exists."""

    def read(self, name: str) -> bytes:
        """Returns a file's contents; raises `InputError` if it cannot be read."""

    def read_many(self, names: Sequence[str]) -> list[bytes]:
        """Returns the contents of several files, fetched at the same time where the store allows it."""

    def write(self, name: str, content: bytes) -> None:
        """Creates or replaces a file; raises `InputError` on a failure."""

    def remove(self, name: str) -> None:
        """Removes a file if it exists."""

    def remove_all(self) -> None:
        """Removes the folder with everything in it."""


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


def inside(place: Place, *names: str) -> Place:
    """Returns the place of a file or folder inside a folder; a path for a path, a URL for a URL."""
    if not is_url(place):
        return Path(place).joinpath(*names)
    text = str(place)
    return "".join([text if text.endswith("/") else f"{text}/", "/".join(names)])


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
        return os.path.isdir(folder.path)
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
        return [path.name for path in self._entries() if os.path.isfile(path)]

    def folders(self) -> list[str]:
        return [path.name for path in self._entries() if os.path.isdir(path)]

    def stamps(self) -> dict[str, str]:
        if not os.path.isdir(self.path):
            return {}
        with self._listing():
            return dict(_stamps(str(self.path), "", (os.path.realpath(self.path),)))

    def has(self, name: str) -> bool:
        return os.path.isfile(self.path / name)

    def read_many(self, names: Sequence[str]) -> list[bytes]:
        return [self.read(name) for name in names]

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

    def remove_all(self) -> None:
        with self._changing(""):
            shutil.rmtree(self.path)

    def _entries(self) -> list[Path]:
        with self._listing():
            return sorted(self.path.iterdir()) if os.path.isdir(self.path) else []

    @contextmanager
    def _listing(self) -> Iterator[None]:
        try:
            yield
        except OSError as error:
            raise InputError(f"cannot list {error.filename or self.path}: {error.strerror}") from error

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
        self._made: set[str] = set()

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
        return self._entries("file")

    def folders(self) -> list[str]:
        return self._entries("directory")

    def stamps(self) -> dict[str, str]:
        def listing() -> dict[str, dict]:
            self._files.invalidate_cache()  # other processes write here too
            return self._files.find(self._root, detail=True) if self._files.isdir(self._root) else {}

        found = self._try(listing, f"cannot list {self.place}")
        start = len(self._files._strip_protocol(self._root).rstrip("/")) + 1
        return {name[start:]: _remote_stamp(entry) for name, entry in found.items()}

    def has(self, name: str) -> bool:
        def look() -> bool:
            self._files.invalidate_cache()
            return self._files.isfile(self._path(name))

        return self._try(look, f"cannot look at {self.place}/{name}")

    def read_many(self, names: Sequence[str]) -> list[bytes]:
        paths = [self._path(name) for name in names]
        if not paths:
            return []
        found = self._try(lambda: self._files.cat(paths), f"{self.place} cannot be read")
        return [found[path] for path in paths] if isinstance(found, dict) else [found]

    def read(self, name: str) -> bytes:
        return self._try(lambda: self._files.cat_file(self._path(name)), f"{self.place}/{name} cannot be read")

    def write(self, name: str, content: bytes) -> None:
        def write() -> None:
            folder = self._path(name).rpartition("/")[0]
            if folder not in self._made:
                self._files.makedirs(folder, exist_ok=True)  # needed by file systems, not by object stores
                self._made.add(folder)
            self._files.pipe_file(self._path(name), content)

        self._try(write, f"cannot write {self.place}/{name}")

    def remove(self, name: str) -> None:
        def remove() -> None:
            if self._files.exists(self._path(name)):
                self._files.rm_file(self._path(name))

        self._try(remove, f"cannot remove {self.place}/{name}")

    def remove_all(self) -> None:
        self._try(lambda: self._files.rm(self._root, recursive=True), f"cannot remove {self.place}")

    def _entries(self, kind: str) -> list[str]:
        def listing() -> list[dict]:
            self._files.invalidate_cache()  # other processes write here too
            return self._files.ls(self._root, detail=True) if self._files.isdir(self._root) else []

        entries = self._try(listing, f"cannot list {self.place}")
        return sorted(entry["name"].rstrip("/").rpartition("/")[2] for entry in entries if entry["type"] == kind)

    def _path(self, name: str) -> str:
        return f"{self._root}/{name}"

    def _try(self, action: Callable[[], Any], failure: str) -> Any:
        try:
            return action()
        except Exception as error:  # each store has its own errors: no network, no rights, no such bucket
            raise InputError(f"{failure}: {_one_line(error)}") from error


def _stamps(folder: str, before: str, around: tuple[str, ...]) -> Iterator[tuple[str, str]]:
    """Stamps below a folder; ``around``: real paths of the folders around it and of itself, to which no link leads."""
    with os.scandir(folder) as entries:
        for entry in entries:
            if entry.is_symlink() and not os.path.exists(entry.path):
                continue
            if entry.is_dir():
                real = os.path.realpath(entry.path) if entry.is_symlink() else f"{around[-1]}/{entry.name}"
                if real not in around:
                    yield from _stamps(entry.path, f"{before}{entry.name}/", (*around, real))
            else:
                with suppress(FileNotFoundError):  # another process has removed its temporary file
                    status = entry.stat()
                    yield f"{before}{entry.name}", f"{status.st_size} {status.st_mtime_ns}"


def _remote_stamp(entry: dict[str, Any]) -> str:
    versions = (entry.get(key) for key in ("ETag", "etag", "md5Hash", "LastModified", "mtime", "created"))
    return f"{entry.get('size') or 0} {next((version for version in versions if version is not None), '')}"


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split()) or type(error).__name__
