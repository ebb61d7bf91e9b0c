"""Gains of the velocity loop with which the loop on the measured plant has the crossover and phase margin asked for.

The same two equations as for the model, :mod:`emps_design.control.velocity.retune`, with the measured response in them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from emps_design.axis import Axis
from emps_design.control.plant.discretisation import ESTIMATORS, filter_response
from emps_design.control.velocity.design import VelocityLoopDesign
from emps_design.control.velocity.retune import PLACES, retuned_gains
from emps_design.control.velocity.specification import check_specification
from emps_design.control.velocity.structure import Structure, own_filters, own_structure
from emps_design.errors import InputError, SpecificationError
from emps_design.frequency_response.loop import MeasuredMargins, measured_margins
from emps_design.frequency_response.measured_plant import MeasuredPlant
from emps_design.frequency_response.response import FrequencyResponse
from emps_design.laws.library.cascade import Filter

NEAREST = 60  # slower crossovers that are tried for the nearest that works
MET = 1e-2  # relative deviation of crossover and phase margin


@dataclass(frozen=True, eq=False)
class _Estimated:
    """A measured plant up to the velocity that a law estimates, as :func:`retuned_gains` asks for it."""

    plant: MeasuredPlant
    weights: tuple[float, float]
    filters: tuple[Filter, ...]

    @property
    def period(self) -> float:
        return self.plant.period

    def response(self, w: np.ndarray) -> np.ndarray:
        back = np.exp(-1j * np.asarray(w) * self.period)
        newer, older = self.weights
        found = self.plant.position(w) * (newer + older * back) * (1.0 - back) / self.period
        return found * filter_response(self.filters, w, self.period)

    def integrator(self, w: np.ndarray) -> np.ndarray:
        return self.period / (1.0 - np.exp(-1j * np.asarray(w) * self.period))


def retune_on_response(
    response: FrequencyResponse,
    axis: Axis,
    crossover: float,
    phase_margin_deg: float = 60.0,
    at: str = PLACES[0],
    velocity: float = 0.1,
    structure: Structure | None = None,
    filters: tuple[Filter, ...] | None = None,
) -> VelocityLoopDesign:
    """Return the design whose loop on the measured plant has ``crossover`` [rad/s] and ``phase_margin_deg`` [deg].

    ``at`` says where that loop is broken. :class:`SpecificationError` where no positive gains do it, or another
    crossing has less phase, or the loop is unstable, with the nearest slower crossover that works.

    >>> from emps_design.machines import machine
    >>> f = np.geomspace(1.0, 300.0, 200)
    >>> mass = FrequencyResponse.of(f, 1.0 / (2j * np.pi * f * 100.0 + 200.0))
    >>> design = retune_on_response(mass, machine("emps2018"), 120.0, 50.0)
    >>> run = design.axis.replace(controller=design.controller_table())
    >>> round(measured_margins(mass, run).values["phase_margin_deg"], 2)
    50.0
    """
    if at not in PLACES:
        raise InputError(f"place of the margin: found {at!r}, expected one of {', '.join(PLACES)}")
    requested = check_specification(crossover, None, phase_margin_deg)
    low, high = float(response.w[0]), float(response.w[-1])
    if not low < crossover < high:
        raise InputError(
            f"{response.name}: found a crossover of {crossover:g} rad/s, expected one within the data, {low:.4g} to "
            f"{high:.4g} rad/s"
        )
    structure, filters = own_structure(axis, structure), own_filters(axis, filters)
    weights = ESTIMATORS[axis.controller.velocity_estimator]
    plant: Any = _Estimated(MeasuredPlant.of(response, axis), weights, filters)
    place = PLACES[0] if structure.form == "pi" else at

    def design_of(w: float) -> tuple[VelocityLoopDesign | None, MeasuredMargins | None]:
        k_v1, t_v = (float(gain) for gain in retuned_gains(plant, w, phase_margin_deg, place))
        if not np.isfinite(k_v1):
            return None, None
        design = VelocityLoopDesign(
            axis, k_v1, t_v, requested, retuned_at=at, velocity=velocity, structure=structure, filters=filters
        )
        return design, measured_margins(response, design.loop_axis, draws=0)

    def met(w: float, found: MeasuredMargins | None) -> bool:
        if found is None or not found.stable:
            return False
        if place != PLACES[0]:
            return True
        phase = found.values["phase_margin_deg"]
        return phase is not None and abs(phase / phase_margin_deg - 1.0) < MET

    design, found = design_of(crossover)
    if design is not None and met(crossover, found):
        return design
    slower = np.geomspace(crossover, low, NEAREST)[1:]
    nearest = next((float(w) for w in slower if met(float(w), design_of(float(w))[1])), None)
    if found is None:
        reason = "the gains would not be positive"
    else:
        reason = "another crossing has less phase margin" if found.stable else "the loop would be unstable"
    words = "nothing slower within the data works" if nearest is None else f"{nearest:.4g} rad/s works"
    raise SpecificationError(
        f"retune on {response.name}: no gains give {phase_margin_deg:g} deg at a crossover of {crossover:g} rad/s; "
        f"{reason}; {words}",
        {} if nearest is None else {"crossover": nearest, "phase_margin_deg": phase_margin_deg},
    )
