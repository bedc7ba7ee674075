"""Linear layers in ONNX Runtime: a small graph for each group of layers, made in memory from the weights.

The graphs are written as protocol buffers by hand (onnx.proto of ONNX IR version 8), because the package ``onnx`` has
no other use here and is larger than the runtime.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    import onnxruntime

_IR_VERSION, _OPSET = 8, 13
_FLOAT, _CODES = 1, 2
_ELEMENT = {np.dtype(np.float32): _FLOAT, np.dtype(np.int8): 3, np.dtype(np.int64): 7}
#: Largest quantised weight. A sum of two products with codes stays within 16 bits, so processors with and without
#: instructions for 8 bit products compute the same.
LARGEST_WEIGHT = 63


class Graph:
    """Graph of an ONNX model, built operation by operation.

    Args:
        inputs: names of the float inputs.
        output: name of the float output.
        codes: names of inputs with codes, uint8.
    """

    def __init__(self, inputs: Sequence[str], output: str, codes: Sequence[str] = ()):
        self._parts: list[bytes] = [_field(2, b"layers"), _field(12, _value(output, _FLOAT))]
        self._parts += [_field(11, _value(name, _FLOAT)) for name in inputs]
        self._parts += [_field(11, _value(name, _CODES)) for name in codes]

    def constant(self, name: str, values: np.ndarray) -> str:
        """Adds a constant, float32, int8 or int64; returns its name."""
        tensor = b"".join(_field(1, size) for size in values.shape)
        tensor += _field(2, _ELEMENT[values.dtype]) + _field(8, name.encode())
        self._parts.append(_field(5, tensor + _field(9, np.ascontiguousarray(values).tobytes())))
        return name

    def operation(self, kind: str, inputs: Sequence[str], output: str, **integers: int) -> str:
        """Adds an operation with integer attributes; returns its output's name."""
        node = b"".join(_field(1, name.encode()) for name in inputs)
        node += _field(2, output.encode()) + _field(4, kind.encode())
        for name, number in integers.items():
            node += _field(5, _field(1, name.encode()) + _field(3, number) + _field(20, 2))
        self._parts.append(_field(1, node))
        return output

    def linear(self, values: str, name: str, weight: np.ndarray, bias: np.ndarray, *, relu: bool = True) -> str:
        """Adds a linear layer for rows ``values`` [n, in], with weight [in, out]; returns its output's name."""
        parts = [values, self.constant(f"{name}.weight", weight), self.constant(f"{name}.bias", bias)]
        output = self.operation("Gemm", parts, name if not relu else f"{name}.linear")
        return self.operation("Relu", [output], name) if relu else output

    def product(self, values: str, name: str, weight: np.ndarray, code: float | None = None) -> str:
        """Adds a product of rows ``values`` [n, in] with weight [in, out]; returns its output's name.

        Args:
            values: name of float rows, or of rows with codes.
            name: output's name.
            weight: float32 [in, out].
            code: value of one code; None for float rows. The weights are then quantised, each column with its own
                scale, and the sums are exact.
        """
        if code is None:
            return self.operation("Gemm", [values, self.constant(f"{name}.weight", weight)], name)
        scale = np.maximum(np.abs(weight).max(axis=0), np.float32(1e-30)) / LARGEST_WEIGHT
        quantised = self.constant(f"{name}.weight", np.rint(weight / scale).astype(np.int8))
        sums = self.operation("MatMulInteger", [values, quantised], f"{name}.sums")
        sums = self.operation("Cast", [sums], f"{name}.floats", to=_FLOAT)
        return self.operation("Mul", [sums, self.constant(f"{name}.scale", scale * np.float32(code))], name)

    def session(self) -> onnxruntime.InferenceSession:
        """Returns a session that computes the graph in the thread of its caller."""
        import onnxruntime

        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = options.inter_op_num_threads = 1
        options.log_severity_level = 3
        model = _field(1, _IR_VERSION) + _field(7, b"".join(self._parts)) + _field(8, _field(2, _OPSET))
        return onnxruntime.InferenceSession(model, options, providers=["CPUExecutionProvider"])


def _field(number: int, content: int | bytes) -> bytes:
    """Field of a protocol buffer: an integer, or bytes with their length."""
    if isinstance(content, bytes):
        return _integer(number << 3 | 2) + _integer(len(content)) + content
    return _integer(number << 3) + _integer(content)


def _integer(value: int) -> bytes:
    """Integer >= 0, seven bits a byte, lowest first."""
    groups = [value & 127]
    while value := value >> 7:
        groups.append(value & 127)
    return bytes([group | 128 for group in groups[:-1]] + groups[-1:])


def _value(name: str, element: int) -> bytes:
    """Input or output with a free shape."""
    return _field(1, name.encode()) + _field(2, _field(1, _field(1, element)))
