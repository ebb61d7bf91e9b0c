"""Compile the kernels of effects and controllers one by one, and call them by address from compiled code.

A kernel becomes a C callback of fixed signature. The steppers receive the *addresses* of the kernels in an array, so a
new combination of effects needs no compilation; each kernel is cached on disk and compiled again when its own file
changes. The steppers share code across files, which numba's cache ignores: :func:`cached` makes their cache depend on
the content of every file they are built from.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Callable
from pathlib import Path
from types import FunctionType, ModuleType
from typing import Any

import numba
from llvmlite import ir
from numba import cfunc, extending, njit, types
from numba.core.dispatcher import Dispatcher
from numba.core.extending import _Intrinsic as Intrinsic

from emps_design.errors import SimulationError

_NUMBER = types.float64
_POINTER = types.CPointer(types.float64)
intrinsic: Any = extending.intrinsic  # what it returns is called without the context of typing
_OPTIONS: dict[str, Any] = {"error_model": "numpy", "nogil": True}

SIGNATURES = {
    # kernel(q, v, t, tau, x, p, b)
    "kernel": types.float64(*[_NUMBER] * 4, *[_POINTER] * 3),
    # actuator(u, p)
    "actuator": types.float64(_NUMBER, _POINTER),
    # rate(q, v, t, tau, x, p, b, level, dx)
    "rate": types.void(*[_NUMBER] * 4, *[_POINTER] * 3, _NUMBER, _POINTER),
    # law(sample, reference, q, f_ext, limit, gains, memory)
    "law": types.float64(types.intp, *[_NUMBER] * 4, _POINTER, _POINTER),
}

_compiled: dict[tuple[Callable[..., Any], str], Any] = {}  # keeps the machine code alive as long as its address is used


def address(function: Callable[..., Any], form: str = "kernel") -> int:
    """Return the machine address of ``function`` compiled with the signature called ``form``.

    Raises :class:`SimulationError` when the function is not made of plain arithmetic on numbers.

    >>> def spring(q, v, t, tau, x, p, b):
    ...     return p[0] * q
    >>> address(spring) == address(spring) != 0
    True
    """
    key = (function, form)
    if key not in _compiled:
        try:
            _compiled[key] = _compile(function, SIGNATURES[form])
        except numba.core.errors.NumbaError as error:
            reason = " ".join(str(error).split())[:300]
            raise SimulationError(
                f"{function.__module__}.{function.__name__} does not compile: {reason}", 0.0
            ) from error
    return _compiled[key].address


def _compile(function: Callable[..., Any], signature: Any) -> Any:
    function = _with_compiled_neighbours(function)
    try:
        return cfunc(signature, cache=True, **_OPTIONS)(function)
    except RuntimeError as error:  # a function typed into a session has no file to cache beside
        if "cannot cache" not in str(error):
            raise
        return cfunc(signature, **_OPTIONS)(function)


def _with_compiled_neighbours(function: Callable[..., Any]) -> Callable[..., Any]:
    """``function`` with the plain functions of its own file that it calls compiled as well."""
    neighbours = {
        name: function.__globals__[name]
        for name in function.__code__.co_names
        if isinstance(function.__globals__.get(name), FunctionType)
    }
    if not neighbours:
        return function
    compiled = {name: njit(**_OPTIONS)(_with_compiled_neighbours(value)) for name, value in neighbours.items()}
    linked = FunctionType(
        function.__code__,
        {**function.__globals__, **compiled},
        function.__name__,
        function.__defaults__,
        function.__closure__,
    )
    linked.__module__, linked.__qualname__ = function.__module__, function.__qualname__
    return linked


def built_in(function: Callable[..., Any]) -> Any:
    """The kernel ``function`` inlined into a stepper, instead of a call by address."""
    return njit(forceinline=True, **_OPTIONS)(_with_compiled_neighbours(function))


def cached(contract: bool = False) -> Callable[[Callable[..., Any]], Any]:
    """Compile a stepper with a disk cache that is renewed when any file it is built from changes.

    ``contract`` lets the compiler round a product and a sum once instead of twice, as C compilers do.
    """

    def decorate(function: Callable[..., Any]) -> Any:
        fastmath = {"contract"} if contract else False
        try:
            dispatcher = njit(cache=True, fastmath=fastmath, **_OPTIONS)(function)
        except RuntimeError as error:  # nowhere to write a cache: compile in every process
            if "cannot cache" not in str(error):
                raise
            return njit(fastmath=fastmath, **_OPTIONS)(function)
        # numba stamps a cache with the content of the function's own file only.
        content = b"".join(file.read_bytes() for file in sorted(source_files(function)))
        cache = dispatcher._cache._cache_file
        cache._source_stamp = hashlib.sha256(content).digest()
        # It numbers the files of a function: two processes that compile it at once, for different arguments, would
        # write the same file. With the process in the name, one of them at worst compiles again.
        cache._data_name_pattern = cache._data_name_pattern.replace("{number:d}", f"{os.getpid()}.{{number:d}}")
        return dispatcher

    return decorate


def source_files(function: Callable[..., Any]) -> set[Path]:
    """Files of ``function``, of this module, and of every compiled function that it calls, directly or not."""
    files, open_ends = {Path(__file__)}, [function]
    visited = set()
    while open_ends:
        code, space = (piece := open_ends.pop()).__code__, piece.__globals__
        if code in visited:
            continue
        visited.add(code)
        files.add(Path(code.co_filename))
        reached = [space.get(name) for name in code.co_names]
        reached += [
            getattr(module, name, None)
            for module in reached
            if isinstance(module, ModuleType)
            for name in code.co_names
        ]
        open_ends += [value.py_func for value in reached if isinstance(value, Dispatcher)]
        files |= {Path(value._defn.__code__.co_filename) for value in reached if isinstance(value, Intrinsic)}
    return files


# A part of a stepper: compiled into its callers and cached with them. Divisions by a constant, or several by the same
# number, may become products with its reciprocal: a division takes as long as five of them. The inlined ones are called
# in every sample: a call passes its results in memory. In the fused ones a product and a sum may be rounded once; where
# this happens differs from stepper to stepper, so a part that must round alike in several is not fused.
part = njit(fastmath={"arcp"}, **_OPTIONS)
inlined = njit(inline="always", **_OPTIONS)
fused = njit(fastmath={"arcp", "contract"}, **_OPTIONS)
fused_inlined = njit(forceinline=True, fastmath={"arcp", "contract"}, **_OPTIONS)


_double, _void = ir.DoubleType(), ir.VoidType()


def _call(builder: Any, place: Any, result: Any, arguments: list[Any]) -> Any:
    form = ir.FunctionType(result, [argument.type for argument in arguments])
    return builder.call(builder.inttoptr(place, form.as_pointer()), arguments)


@intrinsic
def pointer(typingctx, array):
    """The data of a contiguous array, without its reference count: the caller of a stepper keeps the arrays alive."""

    def generate(context, builder, signature, arguments):
        return context.make_array(signature.args[0])(context, builder, arguments[0]).data

    return types.CPointer(array.dtype)(array), generate


@intrinsic
def shifted(typingctx, start, offset):
    """The pointer ``offset`` numbers behind ``start``."""

    def generate(context, builder, signature, arguments):
        return builder.gep(arguments[0], [arguments[1]])

    return start(start, types.int64), generate


@intrinsic
def call_kernel(typingctx, place, q, v, t, tau, x, x_at, p, p_at, b):
    """``kernel(q, v, t, tau, x[x_at:], p[p_at:], b)`` at address ``place``."""
    signature = types.float64(types.int64, *[_NUMBER] * 4, _POINTER, types.int64, _POINTER, types.int64, _POINTER)

    def generate(context, builder, signature, arguments):
        place, q, v, t, tau, x, x_at, p, p_at, b = arguments
        states, parameters = builder.gep(x, [x_at]), builder.gep(p, [p_at])
        return _call(builder, place, _double, [q, v, t, tau, states, parameters, b])

    return signature, generate


@intrinsic
def call_rate(typingctx, place, q, v, t, tau, x, x_at, p, p_at, b, level, dx):
    """``rate(q, v, t, tau, x[x_at:], p[p_at:], b, level, dx[x_at:])`` at address ``place``."""
    whole = (types.int64, *[_NUMBER] * 4, _POINTER, types.int64, _POINTER, types.int64, _POINTER, _NUMBER, _POINTER)

    def generate(context, builder, signature, arguments):
        place, q, v, t, tau, x, x_at, p, p_at, b, level, dx = arguments
        states, parameters, change = builder.gep(x, [x_at]), builder.gep(p, [p_at]), builder.gep(dx, [x_at])
        _call(builder, place, _void, [q, v, t, tau, states, parameters, b, level, change])
        return context.get_dummy_value()

    return types.void(*whole), generate


@intrinsic
def call_actuator(typingctx, place, u, p, p_at):
    """``actuator(u, p[p_at:])`` at address ``place``."""

    def generate(context, builder, signature, arguments):
        place, u, p, p_at = arguments
        return _call(builder, place, _double, [u, builder.gep(p, [p_at])])

    return types.float64(types.int64, _NUMBER, _POINTER, types.int64), generate


@intrinsic
def call_law(typingctx, place, sample, reference, q, f_ext, limit, gains, memory):
    """``law(sample, reference, q, f_ext, limit, gains, memory)`` at address ``place``."""

    def generate(context, builder, signature, arguments):
        return _call(builder, arguments[0], _double, list(arguments[1:]))

    return types.float64(types.int64, types.int64, *[_NUMBER] * 4, _POINTER, _POINTER), generate
