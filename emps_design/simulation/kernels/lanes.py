"""Plants in parallel: the numbers of many plants in rows, one lane per plant, in the layout of vector instructions.

A kernel that gets a lane instead of an array works on the numbers of one plant; the compiler vectorises a loop over the
lanes. :func:`step` and :func:`step_again` compute one hold period of the friction plant (:mod:`.friction_period`) in
all lanes: first in one vector loop, then those that stop or start within the period one by one. Lanes are independent,
so the results of a plant do not depend on its neighbours.
"""

from __future__ import annotations

import operator
from typing import Any

import numpy as np
from llvmlite import ir
from numba import extending, types
from numba.core.datamodel import models

from emps_design.simulation.kernels.compile import inlined, intrinsic, shifted
from emps_design.simulation.kernels.friction_period import advance, uneventful

LANES = 32
_LINE = 8  # numbers in a line of the cache


class _Lane(types.Type):
    """Numbers with a stride of :data:`LANES`."""


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


# An intrinsic: around an overload that is inlined numba drops stores into rows.
@intrinsic
def of_plant(typingctx, numbers, i):
    """The number of plant ``i``: in its row, or one for all plants; or a tuple of such numbers."""
    several = isinstance(numbers, types.BaseTuple)

    def number(builder, kind, value, i):
        return builder.load(builder.gep(value, [i])) if isinstance(kind, types.CPointer) else value

    def generate(context, builder, signature, arguments):
        value, i = arguments
        if not several:
            return number(builder, numbers, value, i)
        each = [number(builder, kind, builder.extract_value(value, n), i) for n, kind in enumerate(numbers)]
        return context.make_tuple(builder, signature.return_type, each)

    result = types.UniTuple(types.float64, len(numbers)) if several else types.float64
    return result(numbers, types.int64), generate


@inlined
def step(i, now, after, command, push, period, forward, backward, friction, stops):
    """Step plant ``i`` through a hold period without a stop or start; return 1 if there is one, else 0.

    ``now`` and ``after`` are rows of position, velocity and motor force, ``command`` is a row [N], and ``stops`` marks
    the plants for :func:`step_again`. ``push`` [N] and ``forward``, ``backward`` and ``friction``, as :func:`advance`
    takes them, are rows or numbers for all plants.
    """
    (q, v, tau), (q1, v1, tau1) = now, after
    quiet, q1[i], v1[i], tau1[i] = uneventful(
        q[i], v[i], tau[i], command[i], of_plant(push, i), period, of_plant(forward, i), of_plant(backward, i),
        of_plant(friction, i),
    )  # fmt: skip
    stops[i] = 0.0 if quiet else 1.0
    return 0 if quiet else 1


@inlined
def step_again(now, after, command, push, period, forward, backward, friction, t, stops, lost, nothing):
    """Step each plant marked in ``stops`` and not ``lost`` again, one by one, through its stops and starts.

    ``nothing`` are two zeros: no event is recorded. The other arguments are those of :func:`step`.
    """
    (q, v, tau), (q1, v1, tau1) = now, after
    for i in range(LANES):
        if stops[i] > 0.0 and lost[i] == 0.0:
            q1[i], v1[i], tau1[i] = advance(
                q[i], v[i], tau[i], command[i], of_plant(push, i), period, of_plant(forward, i), of_plant(backward, i),
                of_plant(friction, i), t, stops, nothing,
            )  # fmt: skip
