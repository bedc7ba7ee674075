"""Hardware settings: device, precision, threads. They change results by rounding only."""

from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Literal

import torch

from hdsp.base.errors import InputError


@dataclass(frozen=True)
class HardwareSettings:
    """Device, precision and threads.

    Attributes:
        accelerator: ``auto`` takes a GPU if there is one.
        precision: ``bf16`` runs the network's trunk in bfloat16, ``32`` runs the whole network in float32; ``auto``
            takes bf16 if the hardware computes in it.
        threads: torch CPU threads; None = torch's choice.
    """

    accelerator: Literal["auto", "cpu", "gpu"] = "auto"
    precision: Literal["auto", "32", "bf16"] = "auto"
    threads: int | None = None

    def __post_init__(self):
        if self.threads is not None and self.threads < 1:
            raise InputError(f"hardware.threads: {self.threads} is below 1")

    def device(self) -> torch.device:
        """Returns the device for computations outside a trainer.

        Raises:
            InputError: a GPU is requested and there is none.
        """
        if self.accelerator == "gpu" and not torch.cuda.is_available():
            raise InputError("hardware.accelerator: gpu was asked for, but torch sees none; allowed are auto, cpu")
        return torch.device("cuda" if self.accelerator != "cpu" and torch.cuda.is_available() else "cpu")

    def uses_bfloat16(self) -> bool:
        """Returns whether trunks run in bfloat16 on this machine."""
        return self.precision == "bf16" or (self.precision == "auto" and _computes_in_bfloat16(self.device()))

    def apply_threads(self) -> None:
        """Sets this process's torch threads."""
        if self.threads is not None:
            torch.set_num_threads(self.threads)


def autocast(device: torch.device, bfloat16: bool) -> AbstractContextManager:
    """Context in which convolutions and linear layers run in bfloat16, if requested."""
    return torch.autocast(device.type, torch.bfloat16, enabled=bfloat16)


def _computes_in_bfloat16(device: torch.device) -> bool:
    if device.type == "cuda":
        return torch.cuda.is_bf16_supported()
    capabilities = torch.cpu.get_capabilities() if hasattr(torch.cpu, "get_capabilities") else {}
    return bool(capabilities.get("avx512_bf16") or capabilities.get("amx_bf16"))
