"""A trunk of convolutions evaluated at every cell of a map instead of in every patch.

Where patches overlap, a trunk without padding computes the same values again for each of them. Evaluated densely it
computes them once: pooling with a stride becomes pooling at every cell, and what follows is dilated by that stride
(Giusti et al. 2013, "Fast image scanning with deep max-pooling convolutional neural networks"). The feature map of a
patch is then a window of the dense result with that dilation as step.
"""

from typing import Any, Protocol

import torch
from torch import Tensor, nn
from torch.nn import functional

from hdsp.base.errors import InputError
from hdsp.robot.lattice import PATCH_CELLS


class DenseEvaluation(Protocol):
    """What gives the features of all patches of a map at once; it shares the weights of the network.

    Attributes:
        exact: whether they are the features of each patch alone.
        margin: cells that it looks beyond a patch, on each side.
    """

    exact: bool
    margin: int

    def __call__(self, encoded: Tensor) -> Any:
        """All that patches share, from the encoded window of a turned map.

        Args:
            encoded: float [1, channels, nx, ny], with ``margin`` cells around the patches in question. The network may
                run under autocast here.
        """
        ...

    def windows(self, dense: Any, corners: Tensor) -> Tensor:
        """Features of patches, float [n, F], as ``TaskNetwork.map_part`` gives them.

        Args:
            dense: what a call returned.
            corners: int64 [n, 2], lower corners (x, y) of the patches: the one at (x, y) begins at cell (x + margin, y
                + margin) of ``encoded``.
        """
        ...


class DenseTrunk:
    """Dense evaluation of a trunk of convolutions, ReLUs and poolings.

    Attributes:
        exact: whether a window of the dense result equals the features of the patch. Zero padding makes the features
            near the rim of a patch differ, because the map goes on there.
        margin: cells that the padded layers look beyond a patch, on each side.
        step: cells between neighbours of a patch's feature map.
        cells: side of that feature map.

    Raises:
        InputError: if the trunk has other layers, or convolutions with a stride.
    """

    def __init__(self, trunk: nn.Sequential):
        self.layers: list[tuple[nn.Module, int]] = []
        self.margin, self.step, self.cells = 0, 1, PATCH_CELLS
        for layer in trunk:
            if isinstance(layer, nn.Conv2d) and layer.stride == (1, 1):
                padding, dilation = int(layer.padding[0]), layer.dilation[0]
                self.margin += padding * self.step
                self.cells += 2 * padding - dilation * (layer.kernel_size[0] - 1)
                self.layers.append((layer, dilation * self.step))
            elif isinstance(layer, nn.MaxPool2d) and layer.stride == layer.kernel_size and layer.padding == 0:
                self.layers.append((layer, self.step))
                self.cells //= layer.kernel_size
                self.step *= layer.kernel_size
            elif isinstance(layer, nn.ReLU):
                self.layers.append((layer, self.step))
            elif not isinstance(layer, nn.Flatten):
                raise InputError(f"a trunk with {layer} cannot be evaluated densely")
        self.exact = self.margin == 0

    def __call__(self, encoded: Tensor) -> Tensor:
        """Features at every cell.

        Args:
            encoded: float [1, channels, nx, ny], with ``margin`` cells around the patches in question.

        Returns:
            float [1, features, mx, my]; ``[..., x + step * i, y + step * j]`` is cell (i, j) of the feature map of the
            patch whose lower corner is cell (x + margin, y + margin) of ``encoded``.
        """
        values = encoded
        for layer, dilation in self.layers:
            if isinstance(layer, nn.Conv2d):
                values = functional.conv2d(values, layer.weight, layer.bias, dilation=dilation)
            elif isinstance(layer, nn.MaxPool2d):
                values = _greatest(values, layer.kernel_size, dilation)
            else:
                values = layer(values)
        return values

    def windows(self, dense: Tensor, corners: Tensor) -> Tensor:
        """Flattened feature maps of patches.

        Args:
            dense: what a call returned.
            corners: int64 [n, 2], lower corners (x, y) of the patches, in the coordinates of ``dense``.

        Returns:
            float [n, features * cells * cells], as ``nn.Flatten`` orders the feature map of a patch.
        """
        width = dense.shape[-1]
        inside = torch.arange(self.cells, device=dense.device) * self.step
        index = (corners[:, 0] * width + corners[:, 1])[:, None, None] + inside[:, None] * width + inside
        # Cells first: what belongs to one cell then lies side by side, and is copied in one piece.
        rows = dense[0].permute(1, 2, 0).reshape(-1, dense.shape[1])[index.flatten()]
        return rows.view(len(corners), self.cells**2, -1).transpose(1, 2).flatten(1)


def _greatest(values: Tensor, kernel: int, dilation: int) -> Tensor:
    """Maximum over ``kernel`` x ``kernel`` cells, ``dilation`` apart, at every cell."""
    for axis in (-2, -1):
        length = values.shape[axis] - (kernel - 1) * dilation
        parts = [values.narrow(axis, start * dilation, length) for start in range(kernel)]
        values = parts[0]
        for part in parts[1:]:
            values = torch.maximum(values, part)
    return values
