"""Evaluation of task networks with torch: single patches, and windows of a map."""

from collections.abc import Iterator
from contextlib import AbstractContextManager

import numpy as np
import torch
from safetensors import SafetensorError
from safetensors.torch import load as load_tensors
from safetensors.torch import save as tensor_bytes

from hdsp.base.errors import InputError
from hdsp.learning.encoding import encode
from hdsp.learning.hardware import autocast, channels_last
from hdsp.learning.judgements import Judgements
from hdsp.learning.learning_settings import HardwareSettings, ModelSettings
from hdsp.learning.networks import TaskNetwork, build_network
from hdsp.learning.networks.dense import DenseEvaluation
from hdsp.learning.saved_abstraction import CONFIG, WEIGHTS

WINDOWS = 24  # patches per goal evaluation in ``TorchEvaluation.windows``


class TorchEvaluation:
    """A network on a device.

    Attributes:
        network: in evaluation mode, on the ``hardware`` device.
        hardware: device and precision.
    """

    def __init__(self, network: TaskNetwork, hardware: HardwareSettings):
        self.hardware, self.device = hardware, hardware.device()
        self.network = channels_last(network.to(self.device)).eval()

    @classmethod
    def of(cls, model: ModelSettings, weights: bytes, hardware: HardwareSettings) -> "TorchEvaluation":
        """Builds a network and loads its weights from the bytes of a safetensors file.

        Raises:
            InputError: the weights do not fit the network, or the network is too large for the memory; names the file.
        """
        try:
            network = build_network(model)
        except (ValueError, RuntimeError, MemoryError) as error:
            raise InputError(f"{CONFIG}: {' '.join(str(error).split())}") from None
        try:
            network.load_state_dict(load_tensors(weights))
        except (RuntimeError, SafetensorError) as error:
            reason = str(error).splitlines()[0]
            raise InputError(f"{WEIGHTS}: does not fit {model.architecture}: {reason}") from None
        return cls(network, hardware)

    @torch.inference_mode()
    def patches(self, patches: np.ndarray, goals: np.ndarray) -> Judgements:
        """Returns judgements [n, G] for patches [n, 72, 72] and goals [n, G, 3]."""
        heights = torch.tensor(patches)[:, None].to(self.device, memory_format=torch.channels_last)
        with self._precision():
            outputs = self.network(heights, torch.tensor(goals).to(self.device))
        return Judgements(*(output.float().cpu().numpy() for output in outputs))

    @torch.inference_mode()
    def windows(
        self, trunk: DenseEvaluation, heights: np.ndarray, corners: np.ndarray, wanted: np.ndarray, goals: np.ndarray
    ) -> Iterator[tuple[slice, Judgements] | None]:
        """Like ``patches`` with shared goals, for patches that are windows into one array; some patches at a time.

        Args:
            trunk: the network's dense trunk.
            heights: float32 [nx, ny], metres, NaN = unknown; with ``trunk.margin`` cells around the patches.
            corners: int64 [n, 2], lower patch corners, relative to cell (margin, margin) of ``heights``.
            wanted: bool [n], patches to evaluate. A patch's result does not depend on the other entries, to the last
                bit.
            goals: float32 [G, 3] in abstract steps in the robot frame.

        Yields:
            None after the trunk. Then, for each group with a wanted patch, its slice of ``corners``, and judgements
            [m, G].
        """
        with self._precision():
            encoded = encode(self.network.encoding, torch.from_numpy(heights)[None, None].to(self.device))
            # Channels innermost, as the weights are.
            dense = trunk(encoded.contiguous(memory_format=torch.channels_last))
        yield None
        shared_goals = torch.from_numpy(goals)[None].to(self.device)
        # Small groups, because the values for all goals and patches together exceed the processor's cache. The groups
        # are always the same, because sums over another number of rows may round differently.
        for start in range(0, len(corners), WINDOWS):
            part = slice(start, start + WINDOWS)
            if wanted[part].any():
                features = trunk.windows(dense, torch.from_numpy(corners[part]).to(self.device)).float()
                outputs = self.network.goal_part(features, shared_goals)
                yield part, Judgements(*(output.cpu().numpy() for output in outputs))

    def weights(self, half: bool) -> bytes:
        """Returns the content of a safetensors file; with ``half``, trained values are rounded to half precision."""
        # Buffers (running means in normalisation) are small, and may exceed the half float range.
        halved = {key for key, _ in self.network.named_parameters()} if half else set()
        return tensor_bytes(
            {
                key: (value.detach().half() if key in halved else value.detach()).cpu().contiguous()
                for key, value in self.network.state_dict().items()
            }
        )

    def _precision(self) -> AbstractContextManager:
        return autocast(self.device, self.hardware.precision == "bf16")
