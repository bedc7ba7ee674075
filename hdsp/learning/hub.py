"""Abstractions in repositories of the Hugging Face hub; only safetensors and JSON are fetched, nothing is run."""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

from hdsp.base.errors import InputError
from hdsp.learning.saved_abstraction import CONFIG, WEIGHTS

_REPOSITORY = re.compile(r"(?P<name>[A-Za-z0-9][\w.-]*/[A-Za-z0-9][\w.-]*)(@(?P<revision>[\w./-]+))?")


def is_repository(source: str) -> bool:
    """Whether a text has the form ``user/repository`` or ``user/repository@revision``."""
    return _REPOSITORY.fullmatch(source) is not None


def download(source: str) -> Path:
    """Returns the local folder of an abstraction from the hub; files that are there already are not fetched again.

    Args:
        source: ``user/repository``, or ``user/repository@revision`` with a branch, tag or commit.

    Raises:
        InputError: the package ``huggingface_hub`` is missing; the repository, revision or a file does not exist or
            needs a token; or there is no network and no earlier download.
    """
    match = _REPOSITORY.fullmatch(source)
    if match is None:
        raise InputError(f"{source!r} is no repository; need user/repository or user/repository@revision")
    found = _try(
        f"hub repository {source}",
        lambda hub: hub.snapshot_download(
            match["name"], revision=match["revision"], allow_patterns=[CONFIG, WEIGHTS], endpoint=_endpoint()
        ),
    )
    folder = Path(found)
    if missing := [name for name in (CONFIG, WEIGHTS) if not (folder / name).is_file()]:
        raise InputError(f"hub repository {source}: holds no {missing[0]}, so it is no abstraction")
    return folder


def upload(folder: Path, repository: str, private: bool = False) -> str:
    """Uploads a folder; the repository is made if it does not exist.

    Args:
        folder: its files replace those with the same names.
        repository: ``user/repository``.
        private: whether a new repository is private.

    Returns:
        the address of the commit.

    Raises:
        InputError: the package ``huggingface_hub`` is missing, the token does not suffice, or there is no network.
    """
    check_repository(repository)

    def action(hub: Any) -> str:
        api = hub.HfApi(endpoint=_endpoint())
        api.create_repo(repository, private=private, exist_ok=True)
        commit = api.upload_folder(repo_id=repository, folder_path=folder, commit_message="Abstraction of hdsp")
        return str(commit.commit_url)

    return str(_try(f"hub repository {repository}", action))


def check_repository(repository: str) -> None:
    """Checks that a text has the form ``user/repository``.

    Raises:
        InputError: it has another form.
    """
    if not is_repository(repository) or "@" in repository:
        raise InputError(f"{repository!r} is no repository; need user/repository")


def _endpoint() -> str | None:
    """Address of the hub; the package itself reads the variable only once, when it is imported."""
    return os.environ.get("HF_ENDPOINT") or None


def _try(what: str, action: Callable[[Any], Any]) -> Any:
    try:
        import huggingface_hub
    except ImportError as error:
        raise InputError(f"{what}: needs the package huggingface_hub: pip install 'hdsp[hub]'") from error
    from huggingface_hub.errors import HfHubHTTPError, LocalEntryNotFoundError, RepositoryNotFoundError

    try:
        return action(huggingface_hub)
    except RepositoryNotFoundError as error:
        raise InputError(f"{what}: does not exist, or needs a token (hf auth login)") from error
    except LocalEntryNotFoundError as error:
        raise InputError(f"{what}: no network, and no earlier download of it") from error
    except (HfHubHTTPError, OSError, ValueError) as error:
        raise InputError(f"{what}: {' '.join(str(error).split())[:200]}") from error
    except Exception as error:  # errors of its network library, which may change
        raise InputError(f"{what}: no answer ({type(error).__name__})") from error
