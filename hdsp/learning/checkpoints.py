"""Checkpoints of a training: tensors, numbers and texts by name. Nothing in them is run."""

from __future__ import annotations

import pickle
import shutil
import zipfile
from pathlib import Path
from typing import Any

import torch
from lightning.fabric.plugins import TorchCheckpointIO

from hdsp.base.errors import InputError
from hdsp.base.files import replacing
from hdsp.learning.processes import is_first_process


class WholeCheckpoints(TorchCheckpointIO):
    """Writes checkpoints of Lightning, whole or not at all, beside their final place instead of in another folder."""

    def save_checkpoint(self, checkpoint: dict[str, Any], path: Any, storage_options: Any = None) -> None:
        with replacing(path) as temporary:
            torch.save(checkpoint, temporary)


def read_checkpoint(path: Path) -> dict[str, Any]:
    """Reads a checkpoint, onto the CPU.

    Raises:
        InputError: if the file is damaged, no checkpoint, or holds objects, which would run code.
    """
    try:
        state = torch.load(path, map_location="cpu", weights_only=True)
    except pickle.UnpicklingError as error:
        words = str(error).lower()
        reason = "it holds objects, which would run code" if "weights_only" in words or "unsupported" in words else ""
        raise InputError(f"checkpoint {path} is not loaded: {reason or 'damaged'}") from None
    except (OSError, RuntimeError, EOFError, ValueError, KeyError, zipfile.BadZipFile) as error:
        raise InputError(f"checkpoint {path} cannot be read: {_line(error)}") from None
    if not isinstance(state, dict) or not isinstance(state.get("state_dict"), dict):
        raise InputError(f"checkpoint {path}: no checkpoint of a training")
    if not isinstance(state.get("epoch"), int):
        raise InputError(f"checkpoint {path}: its epoch is no number")
    return state


def checkpoint_to_resume(folder: Path, fingerprint: str) -> Path | None:
    """Returns the last checkpoint from the same training; removes checkpoints from another training, and says so."""
    mark = folder / "fingerprint.txt"
    same = mark.is_file() and mark.read_text() == fingerprint
    if same:
        for path in (folder / "last.ckpt", folder / "best.ckpt"):
            if path.is_file() and _is_whole(path):
                return path
    if not is_first_process():
        return None
    if not same and (folder / "last.ckpt").is_file():
        print(f"{folder} holds a training with other settings, maps or selection set; this one begins anew", flush=True)
    shutil.rmtree(folder, ignore_errors=True)
    with replacing(mark) as temporary:
        temporary.write_text(fingerprint)
    return None


def _is_whole(checkpoint: Path) -> bool:
    try:
        read_checkpoint(checkpoint)
    except InputError as error:
        if zipfile.is_zipfile(checkpoint) and "holds objects" in str(error):  # no accident
            raise
        print(f"{checkpoint} is damaged; an earlier state, or none, takes its place", flush=True)
        return False
    return True


def _line(error: Exception) -> str:
    return " ".join(str(error).split())[:160] or type(error).__name__
