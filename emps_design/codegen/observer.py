"""The on-line force observer, with what the effects of the axis add, as one more equation that is exported."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from emps_design.codegen.effects import Part, parts_of
from emps_design.codegen.program import (
    LAW_ARGUMENTS,
    REAL,
    Apply,
    Binary,
    Expression,
    Function,
    Name,
    Program,
    Return,
    rewritten,
)
from emps_design.codegen.reader import read_program
from emps_design.compensation.feedforward import names_of_effects, why_not
from emps_design.effects.effect import ADDED
from emps_design.errors import InputError
from emps_design.laws.law import LawKind, LawTable, Positive, parameter
from emps_design.observer import block
from emps_design.observer.external_force import ForceObserver

if TYPE_CHECKING:
    from emps_design.axis import Axis

COMMAND = "command"  # what the observer is given in place of a reference


class Table(LawTable):
    """The observer's only parameter."""

    cutoff: Positive = parameter("corner of the first-order low-pass", "Hz")


def observer_of(axis: Axis, cutoff_hz: float) -> ForceObserver:
    """The observer of ``axis``: what a back-EMF brakes joins the viscous friction."""
    return ForceObserver(axis.replace(mechanics={"viscous": axis.damping}, drive={"back_emf": 0.0}), cutoff_hz)


def observed_parts(axis: Axis) -> tuple[Part, ...]:
    """The kernels of the effects of ``axis``; :class:`InputError` for those that no position and velocity give."""
    named = list(zip(names_of_effects(axis), axis.effects, strict=True))
    reasons = [f"{name}, {reason}" for name, one in named if (reason := why_not(one.effect))]
    if reasons:
        raise InputError(
            f"observer of {axis.name}: found {'; '.join(reasons)}; "
            "take such effects out of the axis file, or observe on the record"
        )
    effects = ((name, one.effect, one.effect.values(one.parameters)) for name, one in named)
    return parts_of(effects, axis.mechanics.array())


def observer_program(parts: Iterable[Part]) -> Program:
    """The observer's equation with the kernels of ``parts`` in it."""
    plain = read_program(block.force_observer, LAW_ARGUMENTS)
    functions: list[Function] = []
    calls: dict[str, list[str]] = {f"added_{hook}": [] for hook in ADDED}
    for part in parts:
        own = _renamed(part.program, f"{part.term}_{part.hook}")
        functions += own.functions
        plain = Program(plain.functions, plain.calls | own.calls)
        calls[f"added_{part.hook}"].append(own.kernel.name)
    for function in plain.functions:
        added = calls.get(function.name)
        if added:
            given = tuple(Name(name, REAL) for name in function.parameters)
            total: Expression = Apply(added[0], given)
            for name in added[1:]:
                total = Binary("+", total, Apply(name, given), REAL)
            function = Function(function.name, function.parameters, {}, (Return(total),))
        functions.append(function)
    nothing = {name for name, added in calls.items() if not added}

    def drop(one: Any) -> Any:
        """What is left of a sum with nothing."""
        empty = isinstance(one, Binary) and isinstance(one.right, Apply) and one.right.function in nothing
        return one.left if empty else one

    kept = tuple(rewritten(function, drop) for function in functions if function.name not in nothing)
    return Program(kept, plain.calls)


def _renamed(program: Program, prefix: str) -> Program:
    """``program`` with ``prefix`` before the names of its functions."""

    def rename(one: Any) -> Any:
        if isinstance(one, Apply):
            return replace(one, function=f"{prefix}_{one.function}")
        return replace(one, name=f"{prefix}_{one.name}") if isinstance(one, Function) else one

    return rewritten(program, rename)


def _gains(p: Any, axis: Axis, period: float) -> list[float]:
    return observer_of(axis, p.cutoff).gains


def _equations(p: Any, axis: Axis, period: float) -> tuple[str, ...]:
    period, gain, alpha, mass, viscous, coulomb, offset, rest = _gains(p, axis, period)
    terms = {hook: [part.term for part in observed_parts(axis) if part.hook == hook] for hook in ADDED}
    names = dict(zip(ADDED, ("e[k]", "c[k]", "m[k]"), strict=True))
    with_own = {
        hook: (f"({number:.10g} + {names[hook]})" if terms[hook] else f"{number:.10g}")
        for hook, number in zip(ADDED, (offset, coulomb, mass), strict=True)
    }
    level = f"max{with_own['dry'][:-1]}, 0)" if terms["dry"] else with_own["dry"]
    return (
        f"v[k] = (q[k] - q[k-1]) / {period:.10g},  a[k] = (v[k] - v[k-1]) / {period:.10g}",
        f"w[k] = (v[k] + v[k-1]) / 2,  tau[k] = {gain:.10g} * (u[k-1] + u[k-2]) / 2",
        f"s[k] = sign(w[k]), 0 where |w[k]| <= {rest:.10g}",
        *(
            f"{names[hook]} = {what} of {', '.join(terms[hook])} at q[k-1], w[k], tau[k]"
            for hook, what in zip(ADDED, ("force", "dry friction", "mass"), strict=True)
            if terms[hook]
        ),
        f"x[k] = {with_own['inertia']} * a[k] + {viscous:.10g} * w[k] + {level} * s[k] + {with_own['force']} - tau[k]",
        f"f[k] = f[k-1] + {alpha:.10g} * (x[k] - f[k-1])",
    )


OBSERVER = LawKind(
    name="force_observer",
    label="on-line observer of the external force",
    source="paper, (19)",
    table=Table,
    kernel=block.force_observer,
    gains=_gains,
    memory=4,
    equations=_equations,
    follows=lambda p: COMMAND,
)
