"""prefetch: a hint of kernels to the memory.

The rows of a sweep are short and depend on one another, so that the processor does not hide the latency of memory.
Prefetching the matrix 4 kB (a page) ahead, in the direction in which it is read, makes a sweep over 263k nodes in 2D
1.5 times faster.
"""

from __future__ import annotations

import numpy as np
from llvmlite import ir
from numba import config, types
from numba.extending import intrinsic

#: distance of the prefetch in doubles
AHEAD = np.int64(512)

_READ, _KEEP_IN_ALL_CACHES, _DATA = (ir.IntType(32)(value) for value in (0, 3, 1))


def _ignored(array: np.ndarray, position: int) -> None:
    """Without the JIT there is nothing to hint."""


def _typed(typing_context, array, position):
    """Ask for ``array[position]`` (1-D array, int64); positions outside the array are harmless: nothing is read."""
    if not (isinstance(array, types.Array) and isinstance(position, types.Integer)):
        return None

    def generate(context, builder, signature, arguments):
        pointer = context.make_array(signature.args[0])(context, builder, arguments[0]).data
        byte_pointer = ir.IntType(8).as_pointer()
        address = builder.bitcast(builder.gep(pointer, [arguments[1]]), byte_pointer)
        function = builder.module.declare_intrinsic(
            "llvm.prefetch", [byte_pointer],
            ir.FunctionType(ir.VoidType(), [byte_pointer, ir.IntType(32), ir.IntType(32), ir.IntType(32)]))
        builder.call(function, [address, _READ, _KEEP_IN_ALL_CACHES, _DATA])
        return context.get_dummy_value()

    return types.void(array, types.int64), generate


prefetch = _ignored if config.DISABLE_JIT else intrinsic(_typed)
