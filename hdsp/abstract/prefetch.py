"""Processor hint for memory-bound kernels: fetches an array element into the cache without waiting."""

from typing import Any

from llvmlite import ir
from numba import config, types
from numba.core import cgutils
from numba.extending import intrinsic

_CONFIG: Any = config  # numba sets its members at run time
_READ, _KEEP, _DATA = 0, 3, 1  # arguments of LLVM's prefetch


@intrinsic
def _prefetch(context, array, index):
    def generate(context, builder, signature, arguments):
        data = context.make_array(signature.args[0])(context, builder, arguments[0]).data
        pointer = ir.PointerType(ir.IntType(8))
        word = ir.IntType(32)
        hint = cgutils.get_or_insert_function(
            builder.module, ir.FunctionType(ir.VoidType(), [pointer, word, word, word]), "llvm.prefetch.p0"
        )
        address = builder.bitcast(builder.gep(data, [arguments[1]]), pointer)
        builder.call(hint, [address, word(_READ), word(_KEEP), word(_DATA)])
        return context.get_dummy_value()

    return types.void(array, index), generate


def _no_prefetch(array, index):
    """Does nothing; for runs without the JIT."""


#: `prefetch(array, index)` for a contiguous 1-D array, inside `@njit` functions only; the index must be in bounds.
prefetch = _no_prefetch if _CONFIG.DISABLE_JIT else _prefetch
