"""Linear layer at cells of a map: kernels gather its rows, ONNX Runtime multiplies them."""

from __future__ import annotations

import numpy as np

from hdsp.base.gradual import Steps
from hdsp.learning.inference.dense_layers import Graph
from hdsp.learning.inference.gather_kernels import gather, store, store_codes

#: Values in the rows of one product; they stay in the cache of a core.
VALUES = 1 << 17
#: Products in a step of a computation, which takes some milliseconds.
PRODUCTS = 32


class Layer:
    """Linear layer with a rectifier, for the cells of a map.

    Args:
        weight: float32 [in, out].
        bias: float32 [out].
    """

    def __init__(self, weight: np.ndarray, bias: np.ndarray):
        graph = Graph(["rows"], "result")
        graph.linear("rows", "result", weight, bias)
        self._session, (self._width, self._outputs) = graph.session(), weight.shape

    def convolve(
        self,
        values: np.ndarray,
        cells: np.ndarray,
        offsets: np.ndarray,
        run: int,
        result: np.ndarray,
        code: float | None = None,
    ) -> Steps[None]:
        """Computes features at some cells, in short steps.

        Args:
            values: float32 [cells of the map, channels].
            cells: int64 [n].
            offsets: int64, where the pieces of a row begin, relative to its cell.
            run: neighbouring cells in a piece.
            result: [cells of the map, out], float32, or codes, uint8.
            code: value of one code.
        """
        flat, channels = values.reshape(-1), values.shape[1]
        most = max(VALUES // self._width, 1)
        rows = np.empty((min(len(cells), most), self._width), np.float32)
        for number, start in enumerate(range(0, len(cells), most), 1):
            part = cells[start : start + most]
            inputs = rows[: len(part)]
            gather(flat, channels, part, offsets, run * channels, inputs)
            (features,) = self._session.run(None, {"rows": inputs})
            if result.dtype == np.uint8:
                store_codes(features, part, np.float32(code), result)
            else:
                store(features, part, result)
            if number % PRODUCTS == 0:
                yield
