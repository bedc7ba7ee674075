"""How networks compute: in bfloat16 where settings ask for it and the hardware has it, with weights in a fast order."""

from contextlib import AbstractContextManager
from typing import TypeVar

import torch


def autocast(device: torch.device, bfloat16: bool) -> AbstractContextManager:
    """Context in which convolutions and linear layers run in bfloat16, if requested."""
    return torch.autocast(device.type, torch.bfloat16, enabled=bfloat16)


Network = TypeVar("Network", bound=torch.nn.Module)


def channels_last(network: Network) -> Network:
    """Orders the network's weights in memory as convolutions read them fastest; returns the network."""
    return network.to(memory_format=torch.channels_last)  # type: ignore[call-overload]  # missing in torch's types
