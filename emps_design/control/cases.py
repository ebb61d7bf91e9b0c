"""The machines that a controller has to run on: the axis as it is, both ways, over a range of loads, under mismatch."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

from emps_design.axis import Axis
from emps_design.control.loop.nested import NestedLoop, nested_loops
from emps_design.control.velocity.load_range import LoadRange, loaded
from emps_design.control.velocity.sensitivity import corners, with_errors

NOMINAL = {"inertia": 1.0, "compliance": 1.0, "delay": 0.0}


@dataclass(frozen=True)
class Case:
    """An ``axis`` with its controller, linearised at ``velocity`` [m/s], its command ``delay`` [s] later.

    ``where`` says what it has different from the axis as it is, as :func:`~.loop.worst.where_in_words` reads it.
    """

    axis: Axis
    velocity: float = 0.1
    delay: float = 0.0
    where: Mapping[str, Any] = field(default_factory=dict)

    @cached_property
    def loops(self) -> tuple[NestedLoop, ...]:
        """The loops of the controller, innermost first and the whole last."""
        return self._loops(delay_margins=True)

    @cached_property
    def judged(self) -> tuple[NestedLoop, ...]:
        """The same, quickly, with the margins that a loop is judged by: those of a delay may be missing."""
        return self._loops(delay_margins=False)

    def _loops(self, delay_margins: bool) -> tuple[NestedLoop, ...]:
        found = nested_loops(self.axis, self.velocity, self.delay, delay_margins)
        return tuple(replace(loop, where=self.where) for loop in found)


def where_of(point: Mapping[str, float]) -> dict[str, float]:
    """What a ``point`` of a range of loads has different from the axis as it is.

    >>> where_of({"inertia": 3.0, "compliance": 1.0, "delay": 0.0})
    {'inertia': 3.0}
    """
    return {name: point[name] for name, nominal in NOMINAL.items() if point[name] != nominal}


def cases_of(
    axis: Axis,
    velocity: float = 0.1,
    span: LoadRange | None = None,
    errors: Mapping[str, float] | None = None,
) -> tuple[Case, ...]:
    """Return the machines that the controller of ``axis`` runs on, the axis as it is first.

    An axis with effects is there at -``velocity`` [m/s] too. ``span``: the loads of a range, its ends and several
    between; ``errors``: the corners of these relative errors of the parameters.

    >>> from emps_design.machines import machine
    >>> [dict(case.where) for case in cases_of(machine("emps2019"), errors={"mass": 0.1})]
    [{}, {'mass': -0.1}, {'mass': 0.1}]
    """
    found = [Case(axis, velocity)]
    if axis.effects:
        found.append(Case(axis, -velocity, where={"velocity": -velocity}))
    for point in span.points(span.enough) if span is not None else ():
        where = where_of(point)
        if where:
            found.append(Case(loaded(axis, point["inertia"], point["compliance"]), velocity, point["delay"], where))
    off = corners(errors) if errors else []
    return (*found, *(Case(with_errors(axis, shares), velocity, where=shares) for shares in off))


def loops_over(cases: Iterable[Case]) -> tuple[NestedLoop, ...]:
    """Return the loops of every case, those of the first case first; :func:`~.loop.worst.worst_loop` picks one.

    >>> from emps_design.control.loop.worst import worst_loop
    >>> from emps_design.machines import machine
    >>> cascade = {"kind": "cascade", "position": {"kp": 30.0, "every": 2}, "velocity": {"kp": 300.0, "ti": 0.05}}
    >>> axis = machine("emps2019").replace(controller=cascade)
    >>> worst = worst_loop(loops_over(cases_of(axis, span=LoadRange(inertia=(1.0, 9.0)))))
    >>> worst.name, dict(worst.where), worst.margins.stable
    ('whole loop', {'inertia': 9.0}, True)
    """
    return tuple(loop for case in cases for loop in case.loops)
