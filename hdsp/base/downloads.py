"""Third-party data files: from a folder named by the user, or downloaded once from their public address."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

from hdsp.base.errors import InputError

#: Environment variable with the folder for third-party data sets.
DATA_DIR_VARIABLE = "HDSP_DATA_DIR"


def data_folder(data_dir: str | os.PathLike | None = None) -> Path | None:
    """Returns ``data_dir``, else the folder in environment variable HDSP_DATA_DIR, else None."""
    folder = data_dir or os.environ.get(DATA_DIR_VARIABLE)
    return Path(folder) if folder else None


def fetch(url: str, sha256: str, name: str, timeout: float = 30.0) -> Path:
    """Downloads a file once into the user's cache under ``name``, and verifies its checksum.

    Raises:
        any download error; `first_words` turns it into a reason.
    """
    import pooch

    downloader = pooch.HTTPDownloader(timeout=timeout)
    return Path(pooch.retrieve(url, f"sha256:{sha256}", name, pooch.os_cache("hdsp"), downloader=downloader))


def first_words(error: Exception) -> str:
    """Returns the reason for a failed download in one short line."""
    reason = f"{type(error).__name__}: {str(error).split('(Caused by')[-1]}"
    return reason[:160].splitlines()[0]


def verify(path: Path, sha256: str) -> Path:
    """Returns ``path`` if its contents have this checksum.

    Raises:
        InputError: the checksum differs.
    """
    if hashlib.sha256(path.read_bytes()).hexdigest() != sha256:
        raise InputError(f"{path} is not the file it should be: its SHA-256 differs; remove it and fetch it again")
    return path
