"""Checkpoints of a training: tensors, numbers and texts by name. Nothing in them is run."""

from __future__ import annotations

import pickle
import zipfile
from pathlib import Path
from typing import Any

import torch

from hdsp.base.errors import InputError


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


def _line(error: Exception) -> str:
    return " ".join(str(error).split())[:160] or type(error).__name__
