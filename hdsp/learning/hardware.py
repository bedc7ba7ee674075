"""What a computation runs on: device, precision, threads. Nothing here changes what is computed beyond rounding."""

from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Literal

import torch

from hdsp.base.errors import InputError


@dataclass(frozen=True)
class HardwareSettings:
    """Device and precision.

    Attributes:
        accelerator: ``auto`` takes a GPU if there is one.
        precision: ``bf16`` runs the trunk of the network in bfloat16, ``32`` all of it in float32; ``auto`` takes bf16
            where the hardware computes in it.
        threads: threads of torch on the CPU; None leaves torch's choice.
    """

    accelerator: Literal["auto", "cpu", "gpu"] = "auto"
    precision: Literal["auto", "32", "bf16"] = "auto"
    threads: int | None = None

    def __post_init__(self):
        if self.threads is not None and self.threads < 1:
            raise InputError(f"hardware.threads: {self.threads} is below 1")

    def device(self) -> torch.device:
        """The device for a computation outside of a trainer.

        Raises:
            InputError: if a GPU was asked for and there is none.
        """
        if self.accelerator == "gpu" and not torch.cuda.is_available():
            raise InputError("hardware.accelerator: gpu was asked for, but torch sees none; allowed are auto, cpu")
        return torch.device("cuda" if self.accelerator != "cpu" and torch.cuda.is_available() else "cpu")

    def uses_bfloat16(self) -> bool:
        """Whether trunks run in bfloat16 on this machine."""
        return self.precision == "bf16" or (self.precision == "auto" and _computes_in_bfloat16(self.device()))

    def apply_threads(self) -> None:
        """Sets the number of torch threads of this process."""
        if self.threads is not None:
            torch.set_num_threads(self.threads)


def autocast(device: torch.device, bfloat16: bool) -> AbstractContextManager:
    """Context in which convolutions and linear layers run in bfloat16, if asked for."""
    return torch.autocast(device.type, torch.bfloat16, enabled=bfloat16)


def _computes_in_bfloat16(device: torch.device) -> bool:
    if device.type == "cuda":
        return torch.cuda.is_bf16_supported()
    capabilities = torch.cpu.get_capabilities() if hasattr(torch.cpu, "get_capabilities") else {}
    return bool(capabilities.get("avx512_bf16") or capabilities.get("amx_bf16"))
