"""A velocity loop on an axis whose load changes: margins over a range, the one design that holds, or a schedule.

A range has factors of the inertia and of the compliance, and delay that may come on top; each is tried at its ends and
in the middle. Where the axis has a second mass behind a coupling, the change of inertia is that of the second mass.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from emps_design.axis import Axis
from emps_design.control.plant.discretisation import SampledPlant, sample_axis
from emps_design.control.velocity.design import VelocityLoopDesign
from emps_design.control.velocity.limits import GAIN_MARGIN, INTEGRAL, reach
from emps_design.control.velocity.retune import retuned_gains
from emps_design.control.velocity.sampled import SampledVelocityLoop
from emps_design.control.velocity.sweeps import sweep_sampled_margins
from emps_design.errors import InputError

COUPLING = {"frequency", "damping", "share"}  # parameters of an effect that splits the mass by a spring
MORE_PHASE = np.arange(0.0, 31.0, 3.0)  # deg, tried above what is asked, for the load that has most
CROSSOVERS = 60


@dataclass(frozen=True)
class LoadRange:
    """Lowest and highest ``inertia`` and ``compliance`` as factors, and ``delay`` [s] that comes on top."""

    inertia: tuple[float, float] = (1.0, 1.0)
    compliance: tuple[float, float] = (1.0, 1.0)
    delay: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        for name, (low, high) in vars(self).items():
            least = 0.0 if name == "delay" else 1e-3
            if not least <= low <= high < math.inf:
                raise InputError(f"range of {name}: found {low:g} to {high:g}, expected {least:g} or more, rising")

    def points(self) -> list[dict[str, float]]:
        """Every combination of the ends and the middles."""

        def tried(low: float, high: float) -> list[float]:
            middle = math.sqrt(low * high) if low > 0.0 else 0.5 * (low + high)
            return sorted({low, middle, high})

        names = tuple(vars(self))
        return [
            dict(zip(names, one, strict=True))
            for one in itertools.product(*(tried(*ends) for ends in vars(self).values()))
        ]


def loaded(axis: Axis, inertia: float, compliance: float) -> Axis:
    """``axis`` with its inertia and the compliance of its coupling times these factors.

    Raises :class:`InputError` for a compliance without a coupling, and an inertia less than what is before it.

    >>> from emps_design.machines import machine
    >>> bent = [{"kind": "flexible_coupling", "frequency": 50.0, "damping": 0.02, "share": 0.5}]
    >>> heavy = loaded(machine("emps2018").replace(effects=bent), 2.0, 1.0)
    >>> [round(heavy.effects[0].parameters[name], 3) for name in ("frequency", "share")]
    [40.825, 0.75]
    """
    mass = axis.mechanics.mass
    effects, bent = [], False
    for entry in axis.effects:
        parameters = dict(entry.parameters)
        if set(parameters) >= COUPLING:
            share, w, bent = parameters["share"], 2.0 * math.pi * parameters["frequency"], True
            before, reduced = mass * (1.0 - share), mass * share * (1.0 - share)
            behind = inertia * mass - before
            if behind <= 0.0:
                raise InputError(
                    f"range of inertia: found {inertia:g}, expected more than {1.0 - share:g}, the share of the "
                    "inertia before the coupling"
                )
            now = before * behind / (before + behind)
            own = w * math.sqrt(reduced / (compliance * now))
            damping = parameters["damping"] * reduced * w / (now * own)
            parameters |= {"share": behind / (inertia * mass), "frequency": own / (2.0 * math.pi), "damping": damping}
        effects.append({"kind": entry.kind, **parameters})
    if compliance != 1.0 and not bent:
        raise InputError("range of compliance: found one for a rigid axis, expected a coupling among its effects")
    return axis.replace(mechanics={"mass": inertia * mass}, effects=effects)


def margins_over_range(design: VelocityLoopDesign, span: LoadRange) -> dict[str, Any]:
    """Margins of ``design`` at every point of ``span``, the one design that holds over it, and the schedule.

    ``points`` have the margins of the gains as they are; ``worst`` is the point with the least phase margin, an
    unstable one first. ``one``: gains with which every point has the phase margin asked for and the gain margin of
    :mod:`.limits`, the fastest such by its slowest crossover; None where there are none. ``schedule``: by inertia, the
    fastest gains that hold at that inertia, whatever compliance and delay in the range. ``text`` says which is needed.

    >>> from emps_design.control.velocity.design import design_velocity_loop
    >>> from emps_design.machines import machine
    >>> design = design_velocity_loop(machine("emps2018"), crossover=40.0, phase_margin_deg=50.0)
    >>> study = margins_over_range(design, LoadRange(inertia=(1.0, 3.0)))
    >>> len(study["points"]), study["one"]["phase_margin_deg"] >= 50.0 - 1e-6
    (3, True)
    """
    phase = design.requested.get("phase_margin_deg", design.phase_margin_deg)
    points, plants = span.points(), []
    for point in points:
        axis = loaded(design.axis, point["inertia"], point["compliance"])
        plant = sample_axis(axis, design.velocity, design.filters)
        plants.append(plant.delayed(point["delay"]) if point["delay"] else plant)
    found = []
    for point, plant in zip(points, plants, strict=True):
        loop = SampledVelocityLoop(plant, design.k_v1, design.t_v, design.structure)
        found.append({**point, "bandwidth": loop.bandwidth, **loop.margins.to_dict()})
    worst = min(
        found, key=lambda one: (one["stable"], math.inf if one["phase_margin_deg"] is None else one["phase_margin_deg"])
    )
    one = _holding(plants, phase)
    schedule = []
    for inertia in sorted({point["inertia"] for point in points}):
        own = [plant for point, plant in zip(points, plants, strict=True) if point["inertia"] == inertia]
        schedule.append({"inertia": inertia, "gains": _holding(own, phase)})
    return {
        "phase_margin_deg": phase,
        "points": found,
        "worst": worst,
        "one": one,
        "schedule": schedule,
        "text": _in_words(design, one, schedule),
    }


def _holding(plants: list[SampledPlant], phase: float) -> dict[str, Any] | None:
    """The fastest gains with which all ``plants`` have that phase margin [deg], None where there are none."""
    ends = [reach(plant, phase).crossover for plant in (plants[0], plants[-1])]
    if min(ends) == 0.0:
        return None
    k_all, t_all = [], []
    for plant, end in ((plants[0], ends[0]), (plants[-1], ends[-1])):
        w, more = np.meshgrid(np.geomspace(0.02 * end, end, CROSSOVERS), phase + MORE_PHASE)
        k_v1, t_v = retuned_gains(plant, w.ravel(), more.ravel())
        k_all.append(k_v1[np.isfinite(k_v1)])
        t_all.append(t_v[np.isfinite(k_v1)])
    k_v1, t_v = np.concatenate(k_all), np.concatenate(t_all)
    good, slowest, least = np.ones(k_v1.size, bool), np.full(k_v1.size, np.inf), np.full(k_v1.size, np.inf)
    for plant in plants:
        margins = sweep_sampled_margins(plant, k_v1, t_v, 120)
        good &= margins["stable"] & (margins["phase_margin_deg"] >= phase - 1e-6)
        good &= ~(margins["gain_margin"] < GAIN_MARGIN) & (margins["crossover"] * t_v <= 2.0 * INTEGRAL)
        slowest, least = np.fmin(slowest, margins["crossover"]), np.fmin(least, margins["phase_margin_deg"])
    if not good.any():
        return None
    best = int(np.flatnonzero(good)[np.argmax(slowest[good])])
    return {
        "k_v1": float(k_v1[best]),
        "t_v": float(t_v[best]),
        "slowest_crossover": float(slowest[best]),
        "phase_margin_deg": float(least[best]),
    }


def _in_words(design: VelocityLoopDesign, one: dict[str, Any] | None, schedule: list[dict[str, Any]]) -> str:
    asked = design.requested.get("crossover", design.crossover)
    alone = [entry["gains"] for entry in schedule]
    if one is not None and one["slowest_crossover"] >= asked * (1.0 - 1e-3):
        return f"one design holds over the range: at least {one['slowest_crossover']:.4g} rad/s of crossover everywhere"
    if all(gains is not None and gains["slowest_crossover"] >= asked * (1.0 - 1e-3) for gains in alone):
        return f"no one design has {asked:.4g} rad/s over the range: the gains have to follow the inertia, as scheduled"
    if one is not None:
        return (
            f"{asked:.4g} rad/s cannot be had over the range, scheduled or not; one design holds with at least "
            f"{one['slowest_crossover']:.4g} rad/s"
        )
    return "no one design holds over the range, at any crossover"
