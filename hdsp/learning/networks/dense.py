"""Dense evaluation: a convolutional trunk runs at every map cell once instead of in every patch.

A trunk without padding computes the same values again for each overlapping patch. Dense evaluation computes them once:
a pooling with stride becomes a pooling at every cell, and all later layers are dilated by this stride (Giusti et al.
2013, "Fast image scanning with deep max-pooling convolutional neural networks"). A patch's feature map is then a window
into the dense result, with this dilation as step.
"""

from typing import Any, Protocol

import torch
from torch import Tensor, nn
from torch.nn import functional

from hdsp.base.errors import InputError
from hdsp.robot.lattice import PATCH_CELLS


class DenseEvaluation(Protocol):
    """Computes features for all patches in a map at once; shares the network's weights.

    Attributes:
        exact: whether the features equal the features from each patch alone.
        margin: cells read beyond a patch, on each side.
    """

    exact: bool
    margin: int

    def __call__(self, encoded: Tensor) -> Any:
        """Computes everything that patches share, from an encoded window in a rotated map.

        Args:
            encoded: float [1, channels, nx, ny], with ``margin`` cells around the requested patches. The network may
                run under autocast here.
        """
        ...

    def windows(self, dense: Any, corners: Tensor) -> Tensor:
        """Returns patch features, float [n, F], as ``TaskNetwork.map_part`` does.

        Args:
            dense: result of a call.
            corners: int64 [n, 2], lower patch corners (x, y); patch (x, y) begins at cell (x + margin, y + margin) of
                ``encoded``.
        """
        ...


class DenseTrunk:
    """Dense evaluation for a trunk with convolutions, ReLUs and poolings.

    Attributes:
        exact: whether a window into the dense result equals the patch features. Zero padding changes features near a
            patch's rim, because the map continues there.
        margin: cells that padded layers read beyond a patch, on each side.
        step: cells between neighbours in a patch's feature map.
        cells: side of this feature map.

    Raises:
        InputError: the trunk has other layers, or convolutions with a stride.
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
                self.cells //= _side(layer)
                self.step *= _side(layer)
            elif isinstance(layer, nn.ReLU):
                self.layers.append((layer, self.step))
            elif not isinstance(layer, nn.Flatten):
                raise InputError(f"a trunk with {layer} cannot be evaluated densely")
        self.exact = self.margin == 0

    def __call__(self, encoded: Tensor) -> Tensor:
        """Returns features at every cell.

        Args:
            encoded: float [1, channels, nx, ny], with ``margin`` cells around the requested patches.

        Returns:
            float [1, features, mx, my]; ``[..., x + step * i, y + step * j]`` is feature map cell (i, j) for the patch
            with lower corner (x + margin, y + margin) in ``encoded``.
        """
        values = encoded
        for layer, dilation in self.layers:
            if isinstance(layer, nn.Conv2d):
                values = functional.conv2d(values, layer.weight, layer.bias, dilation=dilation)
            elif isinstance(layer, nn.MaxPool2d):
                values = _greatest(values, _side(layer), dilation)
            else:
                values = layer(values)
        return values

    def windows(self, dense: Tensor, corners: Tensor) -> Tensor:
        """Returns flattened feature maps for patches.

        Args:
            dense: result of a call.
            corners: int64 [n, 2], lower patch corners (x, y), in ``dense`` coordinates.

        Returns:
            float [n, features * cells * cells], in ``nn.Flatten`` order.
        """
        width = dense.shape[-1]
        inside = torch.arange(self.cells, device=dense.device) * self.step
        index = (corners[:, 0] * width + corners[:, 1])[:, None, None] + inside[:, None] * width + inside
        # Cells first: the features at one cell are then contiguous and copied in one piece.
        rows = dense[0].permute(1, 2, 0).reshape(-1, dense.shape[1])[index.flatten()]
        return rows.view(len(corners), self.cells**2, -1).transpose(1, 2).flatten(1)


def _side(pooling: nn.MaxPool2d) -> int:
    side = pooling.kernel_size
    if not isinstance(side, int):
        raise InputError(f"a trunk with {pooling} cannot be evaluated densely")
    return side


def _greatest(values: Tensor, kernel: int, dilation: int) -> Tensor:
    """Maximum over ``kernel`` x ``kernel`` cells, ``dilation`` apart, at every cell."""
    for axis in (-2, -1):
        length = values.shape[axis] - (kernel - 1) * dilation
        parts = [values.narrow(axis, start * dilation, length) for start in range(kernel)]
        values = parts[0]
        for part in parts[1:]:
            values = torch.maximum(values, part)
    return values
