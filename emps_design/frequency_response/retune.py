"""Retuning on a measured plant: velocity-loop gains for a crossover and phase margin, and a filter of the command.

The gains follow from the same two equations as for the model, :mod:`emps_design.control.velocity.retune`, with the
measured response. A filter is designed on the masses that fit the response and checked on the data.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from emps_design.axis import Axis
from emps_design.control.discretisation import filter_response
from emps_design.control.velocity.design import VelocityLoopDesign
from emps_design.control.velocity.gains import PLACES, Structure, own_filters, own_structure
from emps_design.control.velocity.limits import suggest_filter
from emps_design.control.velocity.retune import retuned_gains
from emps_design.control.velocity.specification import check_specification
from emps_design.errors import InputError, SpecificationError
from emps_design.frequency_response.coupling import ResponseComparison
from emps_design.frequency_response.loop import measured_margins, over_limits
from emps_design.frequency_response.measured_plant import MeasuredPlant
from emps_design.frequency_response.response import FrequencyResponse
from emps_design.laws.estimators import estimator_response
from emps_design.laws.library.cascade import Filter

NEAREST = 60  # slower crossovers that are tried
MET = 1e-2  # relative tolerance of the phase margin

SIDES = ("without", "with_equal_margins", "with")
MARGINS = ("phase_margin_deg", "gain_margin", "disk_margin")


@dataclass(frozen=True, eq=False)
class _Estimated:
    """A measured plant up to the velocity that a law estimates, for :func:`retuned_gains`."""

    plant: MeasuredPlant
    estimator: Any
    filters: tuple[Filter, ...]

    @property
    def period(self) -> float:
        return self.plant.period

    def response(self, w: np.ndarray) -> np.ndarray:
        back = np.exp(-1j * np.asarray(w) * self.period)
        estimate = estimator_response(self.estimator, w, self.period) * (1.0 - back) / self.period
        return self.plant.position(w) * estimate * filter_response(self.filters, w, self.period)

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
    limits: Mapping[str, float] | None = None,
) -> VelocityLoopDesign:
    """Return the design whose loop on the measured plant has ``crossover`` [rad/s] and ``phase_margin_deg`` [deg].

    ``at`` is where the loop is broken; ``limits`` are upper limits of the ratios ``sensitivity_peak_below`` and
    ``sensitivity_peak_above`` the first antiresonance. Raises :class:`SpecificationError` where the gains would not be
    positive, another crossing has less phase margin, the loop is unstable or a limit is exceeded; it has the nearest
    slower crossover that works.

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
    plant: Any = _Estimated(MeasuredPlant.of(response, axis), axis.controller.velocity_estimator, filters)
    place = structure.place(at)

    def design_of(w: float) -> tuple[VelocityLoopDesign | None, str]:
        """The design for a crossover ``w`` [rad/s] and its shortcomings in words, "" for none."""
        k_v1, t_v = (float(gain) for gain in retuned_gains(plant, w, phase_margin_deg, place))
        if not np.isfinite(k_v1):
            return None, "the gains would not be positive"
        design = VelocityLoopDesign(
            axis, k_v1, t_v, requested, retuned_at=at, velocity=velocity, structure=structure, filters=filters
        )
        margins = measured_margins(response, design.loop_axis, draws=0)
        if not margins.stable:
            return design, "the loop would be unstable"
        lacks, phase = over_limits(margins.values, limits or {}), margins.values["phase_margin_deg"]
        if place == PLACES[0] and (phase is None or abs(phase / phase_margin_deg - 1.0) >= MET):
            lacks.append("another crossing has less phase margin")
        return design, " and ".join(lacks)

    design, lacks = design_of(crossover)
    if design is not None and not lacks:
        return design
    slower = np.geomspace(crossover, low, NEAREST)[1:]
    nearest = next((float(w) for w in slower if not design_of(float(w))[1]), None)
    words = "nothing slower within the data works" if nearest is None else f"{nearest:.4g} rad/s works"
    raise SpecificationError(
        f"retune on {response.name}: no gains give {phase_margin_deg:g} deg at a crossover of {crossover:g} rad/s; "
        f"{lacks}; {words}",
        {} if nearest is None else {"crossover": nearest, "phase_margin_deg": phase_margin_deg, **(limits or {})},
    )


def suggest_filter_on_response(
    response: FrequencyResponse,
    axis: Axis,
    phase_margin_deg: float,
    structure: Structure,
    filters: tuple[Filter, ...],
    velocity: float = 0.1,
) -> dict[str, Any]:
    """Return the document of :func:`suggest_filter` for the masses that fit ``response``, checked on the data.

    ``measured`` of each design has ``stable`` and its margins on the data. A filter with which the loop is unstable
    there is not suggested.

    >>> import numpy as np
    >>> from emps_design.control.velocity.gains import PI
    >>> from emps_design.frequency_response.coupling import axis_response
    >>> from emps_design.machines import machine
    >>> bent = [{"kind": "flexible_coupling", "frequency": 48.0, "damping": 0.02, "share": 0.7}]
    >>> axis, f = machine("emps2018").replace(effects=bent), np.geomspace(1.0, 400.0, 300)
    >>> suggestion = suggest_filter_on_response(
    ...     FrequencyResponse.of(f, axis_response(axis, f), np.full(300, 0.01)), machine("emps2018"), 50.0, PI, ()
    ... )
    >>> suggestion["filter"]["kind"], abs(suggestion["with"]["measured"]["phase_margin_deg"] - 50.0) < 2.0
    ('notch', True)
    """
    model = ResponseComparison(response, axis).chain.on(axis)
    suggestion = suggest_filter(model, phase_margin_deg, structure, filters, velocity)
    for name in SIDES:
        side = suggestion[name]
        if side is None or side["crossover"] is None:
            continue
        added = () if name == "without" else (Filter(**suggestion["filter"]),)
        design = VelocityLoopDesign(
            axis, side["k_v1"], side["t_v"], {}, velocity=velocity, structure=structure, filters=(*filters, *added)
        )
        on_data = measured_margins(response, design.loop_axis, draws=0)
        side["measured"] = {"stable": on_data.stable, **{key: on_data.values[key] for key in MARGINS}}
    if suggestion["filter"] is not None and not suggestion["with"]["measured"]["stable"]:
        suggestion |= {"filter": None, "with_equal_margins": None, "with": None}
    return {**suggestion, "model": f"the masses that fit {response.name}"}
