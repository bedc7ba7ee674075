"""Files of data that are not ours: from a folder that the user names, or fetched once from their public address."""

from __future__ import annotations

import hashlib
import os
from pathlib import Path

from hdsp.base.errors import InputError

#: Environment variable that names a folder with data sets that others published.
DATA_DIR_VARIABLE = "HDSP_DATA_DIR"


def data_folder(data_dir: str | os.PathLike | None = None) -> Path | None:
    """``data_dir``, else the folder named by the environment variable HDSP_DATA_DIR, else None."""
    folder = data_dir or os.environ.get(DATA_DIR_VARIABLE)
    return Path(folder) if folder else None


def fetch(url: str, sha256: str, name: str, timeout: float = 30.0) -> Path:
    """The file at a public address, fetched once into the user's cache under ``name``; its checksum is verified.

    Raises:
        whatever a download can fail with; `first_words` makes a reason of it.
    """
    import pooch

    downloader = pooch.HTTPDownloader(timeout=timeout)
    return Path(pooch.retrieve(url, f"sha256:{sha256}", name, pooch.os_cache("hdsp"), downloader=downloader))


def first_words(error: Exception) -> str:
    """Why a download failed, in one short line."""
    reason = f"{type(error).__name__}: {str(error).split('(Caused by')[-1]}"
    return reason[:160].splitlines()[0]


def verify(path: Path, sha256: str) -> Path:
    """``path``, if its contents have this checksum.

    Raises:
        InputError: they have another one.
    """
    if hashlib.sha256(path.read_bytes()).hexdigest() != sha256:
        raise InputError(f"{path} is not the file it should be: its SHA-256 differs; remove it and fetch it again")
    return path
