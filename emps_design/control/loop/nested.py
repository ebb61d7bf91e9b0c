"""The loops of an axis's controller within one another, each with its margins and where it is broken for them.

The velocity loop is broken at the plant input with the position loop open; the position loop at the position error with
the velocity loop closed, at the rate at which it runs: there it is one sampled loop, whatever the rate inside. Last
comes the whole loop at the plant input, where a delay or a current loop sits; of different rates it is periodic.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from emps_design.axis import Axis
from emps_design.control.loop import periodic
from emps_design.control.loop.margins import Margins, loop_margins
from emps_design.control.loop.sampled_loop import SampledLoop, close
from emps_design.control.loop.transfer import transfer
from emps_design.control.plant.discretisation import SampledPlant, sample_axis
from emps_design.control.plant.peaks import law_peaks, peaks_of_roots
from emps_design.laws import get_law, law_of, table_of
from emps_design.laws.linear import LinearLaw, linear_law

PLANT_INPUT, POSITION_ERROR = "plant input", "position error"
VELOCITY_LOOP, WHOLE = "velocity loop", "whole loop"
_REFERENCE, _POSITION = 0, 1  # places among the inputs of a law


@dataclass(frozen=True)
class NestedLoop:
    """One loop of a controller: its ``name``, where it is ``broken``, and its margins there.

    ``where`` has what its machine has different from the axis, as :func:`~.worst.where_in_words` reads it.
    """

    name: str
    broken: str
    margins: Margins
    where: Mapping[str, Any] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        """Plain data: name, place, margins, and the machine where that is another than the axis."""
        where = {"where": dict(self.where)} if self.where else {}
        return {"name": self.name, "broken": self.broken, **where, **self.margins.to_dict()}


def nested_loops(
    axis: Axis, velocity: float = 0.1, delay: float = 0.0, delay_margins: bool = True
) -> tuple[NestedLoop, ...]:
    """The loops of the controller of ``axis``, innermost first and the whole last; linearised at ``velocity`` [m/s].

    ``delay`` [s] of the command comes on top. A controller that has a velocity loop and nothing else is that one loop.
    Without ``delay_margins`` those of loops of different rates, which take longest, are left out.

    Raises :class:`~emps_design.errors.AxisError` where the axis has no controller.

    >>> from emps_design.machines import machine
    >>> cascade = {"kind": "cascade", "position": {"kp": 30.0, "every": 2}, "velocity": {"kp": 300.0, "ti": 0.05}}
    >>> for loop in nested_loops(machine("emps2019").replace(controller=cascade)):
    ...     print(loop.name, "broken at the", loop.broken, round(loop.margins.phase_margin_deg))
    velocity loop broken at the plant input 71
    position loop broken at the position error 77
    whole loop broken at the plant input 57
    """
    period, direction = axis.sampling.period, float(np.sign(velocity))
    plant = sample_axis(axis, velocity)
    plant = plant.delayed(delay) if delay else plant
    whole = law_of(axis, period)
    kind = get_law(axis.controller.kind)
    found = []
    for name, table in kind.loops(table_of(axis)) if kind.loops else ():
        law = kind.law(table, axis, period)
        form = linear_law(law, period, direction)
        if law.follows == "velocity":
            found.append(NestedLoop(name, PLANT_INPUT, at_plant_input(plant, form)))
        else:
            found.append(NestedLoop(name, POSITION_ERROR, at_position_error(plant, form)))
    if len(found) != 1:
        name = VELOCITY_LOOP if not found and whole.follows == "velocity" else WHOLE
        margins = at_plant_input(plant, linear_law(whole, period, direction), delay_margins)
        found.append(NestedLoop(name, PLANT_INPUT, margins))
    return tuple(found)


def at_plant_input(plant: SampledPlant, form: LinearLaw, delay_margins: bool = True) -> Margins:
    """Margins of the loop of ``form`` around ``plant``, everything closed, broken at the plant input.

    That of a delay is left out of loops of different rates without ``delay_margins``.
    """
    loop = close(plant, form, plant_input=True)
    if form.cycle > 1:
        delayed = (lambda delay: _radius_with(plant.delayed(delay), form)) if delay_margins else None
        return periodic.margins(*loop.opened, plant.period, delayed)

    return loop_margins(
        loop.loop_gain,
        plant.frequencies(peaks=law_peaks(form, plant.period)),
        loop.stable,
        plant.period,
        lambda w, delay: loop.loop_gain(w) * plant.delayed_response(w, delay) / plant.response(w),
    )


def _radius_with(plant: SampledPlant, form: LinearLaw) -> float:
    return float(np.abs(close(plant, form, plant_input=True).poles).max())


def at_position_error(plant: SampledPlant, form: LinearLaw) -> Margins:
    """Margins of the position loop broken at the position error, at the rate at which it runs.

    ``form`` hears of position and reference only through their difference, but for velocities of its own.
    """
    A, b, c = position_loop(plant, form)
    period, stable = form.cycle * plant.period, close(plant, form).stable
    inner = [*peaks_of_roots(np.linalg.eigvals(A), period), *law_peaks(form, plant.period)]
    grid = replace(plant, period=period, filters=()).frequencies(peaks=inner)
    return loop_margins(lambda w: transfer(A, b, c, 0.0, np.exp(1j * np.asarray(w) * period)), grid, stable, period)


def position_loop(plant: SampledPlant, form: LinearLaw) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The position loop broken at the position error: ``x[i+1] = A x + b e``, ``q = c x``, one step a cycle of the law.

    Read as ``reference + q`` the reference is the error alone; in the other samples of a cycle nothing hears it.
    """
    B, D = form.B.copy(), form.D.copy()
    B[..., _POSITION] += B[..., _REFERENCE]
    D[..., _POSITION] += D[..., _REFERENCE]
    loop: SampledLoop = close(plant, replace(form, B=B, D=D), keep_position=True)
    row = np.zeros(loop.A.shape[-1])
    row[: plant.C.size] = plant.C
    place = loop.inputs.index("reference")
    if form.cycle == 1:
        return loop.A, loop.B[:, place], row
    A, b, _, _ = periodic.lifted(loop.A, loop.B[..., [place]], loop.C, loop.D[..., [place]])
    return A, b[:, 0], row
