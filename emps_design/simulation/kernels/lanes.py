"""Plants in parallel: the numbers of many plants in rows, one lane per plant, in the layout of vector instructions.

A kernel that gets a lane in place of an array works on the numbers of one plant; the compiler vectorises a loop over
the lanes.
"""

from __future__ import annotations

import operator
from typing import Any

import numpy as np
from llvmlite import ir
from numba import extending, types
from numba.core.datamodel import models

from emps_design.simulation.kernels.compile import inlined, intrinsic, shifted

LANES = 32
_LINE = 8  # numbers in a line of the cache


class _Lane(types.Type):
    """Numbers that stand :data:`LANES` apart."""


_LANE = _Lane(f"one of {LANES} lanes")


@extending.register_model(_Lane)
class _LaneModel(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, ir.DoubleType().as_pointer())


def room(rows: int) -> np.ndarray:
    """Return zeros (``rows``, LANES) aligned with the cache lines of the processor, so that no vector spans two."""
    padded = np.zeros(rows * LANES + _LINE)
    first = -padded.ctypes.data // padded.itemsize % _LINE
    return padded[first : first + rows * LANES].reshape(rows, LANES)


@inlined
def row(rows, j):
    """Row ``j`` of ``rows``, a pointer."""
    return shifted(rows, j * LANES)


@intrinsic
def lane(typingctx, rows, i):
    """The numbers of plant ``i`` in ``rows``: with index j that of row j."""

    def generate(context, builder, signature, arguments):
        return builder.gep(arguments[0], [arguments[1]])

    return _LANE(rows, types.int64), generate


@intrinsic
def _read(typingctx, numbers, j):
    def generate(context, builder, signature, arguments):
        return builder.load(_place(builder, *arguments))

    return types.float64(numbers, types.int64), generate


@intrinsic
def _write(typingctx, numbers, j, value):
    def generate(context, builder, signature, arguments):
        builder.store(arguments[2], _place(builder, *arguments[:2]))
        return context.get_dummy_value()

    return types.void(numbers, types.int64, types.float64), generate


def _place(builder, numbers, j):
    return builder.gep(numbers, [builder.mul(j, ir.Constant(j.type, LANES))])


@extending.overload(operator.getitem)
def _getitem(numbers, j):
    return (lambda numbers, j: _read(numbers, j)) if isinstance(numbers, _Lane) else None


@extending.overload(operator.setitem)
def _setitem(numbers, j, value):
    return (lambda numbers, j, value: _write(numbers, j, value)) if isinstance(numbers, _Lane) else None
