"""A velocity loop on an axis whose load or model varies: margins over a range, one robust design, or a gain schedule.

A range has factors of the inertia and of the compliance, and additional delay; each is evaluated at its ends and in the
middle. If the axis has a second mass behind a coupling, the change of inertia is that of the second mass. Phase margin
and crossover are those of the loop broken where the specification applies: at the velocity error for gains of (7), at
the place of retuning for retuned ones. Gain and delay margin are those at the plant input, where both act.

Under a mismatch of the model the same gains run on other plants; the gains of (7) for these plants are listed too.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from emps_design.axis import Axis
from emps_design.control.discretisation import SampledPlant, sample_axis
from emps_design.control.margins import LOWEST
from emps_design.control.velocity.design import VelocityLoopDesign
from emps_design.control.velocity.gains import PLACES
from emps_design.control.velocity.limits import GAIN_MARGIN, INTEGRAL, retuned_gains
from emps_design.control.velocity.sampled import SampledVelocityLoop, sweep_sampled_margins
from emps_design.control.velocity.specification import ROOM
from emps_design.errors import InputError
from emps_design.tables import FACTORS

COUPLING = {"frequency", "damping", "share"}  # parameters of an effect with a second mass behind a spring
MORE_PHASE = np.arange(0.0, 31.0, 3.0)  # deg above the requested phase margin, for the design at one end of the range
CROSSOVERS = 60
CLOSE = 1.17  # ratio of two neighbours on a grid of that many crossovers up to Nyquist
ENOUGH = (3, 9, 5, 3)  # steps per quantity if none, one, two or three quantities vary
MOST_DELAY = 1000  # samples, the limit for the computation delay of an axis
EQUAL = 0.02  # share of the crossover that may be given up for more integral action

PARAMETERS = {"mass": "mechanics", "viscous": "mechanics", "force_gain": "drive"}


@dataclass(frozen=True)
class LoadRange:
    """Lowest and highest ``inertia`` and ``compliance`` as factors, and additional ``delay`` [s]."""

    inertia: tuple[float, float] = (1.0, 1.0)
    compliance: tuple[float, float] = (1.0, 1.0)
    delay: tuple[float, float] = (0.0, 0.0)

    def __post_init__(self) -> None:
        for name, (low, high) in vars(self).items():
            least = 0.0 if name == "delay" else 1e-3
            if not least <= low <= high < math.inf:
                raise InputError(
                    f"range of {name}: found {low:g} to {high:g}, expected a rising range from {least:g} on"
                )

    @property
    def enough(self) -> int:
        """Steps per quantity that suffice to find instability within the range; fewer if more quantities vary."""
        return ENOUGH[sum(low < high for low, high in vars(self).values())]

    def points(self, count: int = 3) -> list[dict[str, float]]:
        """Every combination of 3, 5, 9 ... steps of each quantity: the ends, the middle, and the middles between."""

        def steps_of(low: float, high: float) -> list[float]:
            steps = [low, high] if low < high else [low]
            while 1 < len(steps) < count:
                pairs = list(itertools.pairwise(steps))
                middles = [math.sqrt(a * b) if low > 0.0 else 0.5 * (a + b) for a, b in pairs]
                steps = sorted([*steps, *middles])
            return steps

        names = tuple(vars(self))
        return [
            dict(zip(names, combination, strict=True))
            for combination in itertools.product(*(steps_of(*ends) for ends in vars(self).values()))
        ]


def loaded(axis: Axis, inertia: float, compliance: float) -> Axis:
    """Return ``axis`` with these factors on its inertia and on the compliance of its coupling.

    Raises :class:`InputError` for a compliance without a coupling, and for an inertia below that before the coupling.

    >>> from emps_design.machines import machine
    >>> bent = [{"kind": "flexible_coupling", "frequency": 50.0, "damping": 0.02, "share": 0.5}]
    >>> heavy = loaded(machine("emps2018").replace(effects=bent), 2.0, 1.0)
    >>> [round(heavy.effects[0].parameters[name], 3) for name in ("frequency", "share")]
    [40.825, 0.75]
    """
    mass = axis.mechanics.mass
    effects, has_coupling = [], False
    for entry in axis.effects:
        parameters = dict(entry.parameters)
        if set(parameters) >= COUPLING:
            share, w, has_coupling = parameters["share"], 2.0 * math.pi * parameters["frequency"], True
            before, reduced = mass * (1.0 - share), mass * share * (1.0 - share)
            behind = inertia * mass - before
            if behind <= 0.0:
                raise InputError(
                    f"range of inertia: found {inertia:g}, expected more than {1.0 - share:g}, the share of the "
                    "inertia before the coupling"
                )
            new_reduced = before * behind / (before + behind)
            new_w = w * math.sqrt(reduced / (compliance * new_reduced))
            damping = parameters["damping"] * reduced * w / (new_reduced * new_w)
            parameters |= {"share": behind / (inertia * mass), "frequency": new_w / (2.0 * math.pi), "damping": damping}
        effects.append({"kind": entry.kind, **parameters})
    if compliance != 1.0 and not has_coupling:
        raise InputError("range of compliance: found one for a rigid axis, expected an axis with a coupling")
    return axis.replace(mechanics={"mass": inertia * mass}, effects=effects)


def margins_over_range(design: VelocityLoopDesign, span: LoadRange) -> dict[str, Any]:
    """Return the margins of ``design`` at every point of ``span``, the best single design over it, and a schedule.

    - ``at``: the place of the phase margins [deg] and crossovers [rad/s], "velocity-error" or "plant-input".
    - ``points``: the margins of the present gains there and at the ``plant_input``; ``worst``: the point with the
      smallest phase margin, an unstable one first.
    - ``one``: the gains with the largest ``slowest_crossover`` with which every point has the requested phase margin
      and the gain and delay margins of :mod:`.limits`; None if there are none. The crossover of a point is its lowest,
      since a loop may cross 0 dB again above a resonance.
    - ``schedule``: for each inertia, the fastest such gains for every compliance and delay of the range.
    - ``text``: whether one design or a schedule is needed.

    Raises :class:`InputError` for more delay than :data:`MOST_DELAY`.

    >>> from emps_design.control.velocity.design import design_velocity_loop
    >>> from emps_design.machines import machine
    >>> design = design_velocity_loop(machine("emps2018"), crossover=40.0, phase_margin_deg=50.0)
    >>> study = margins_over_range(design, LoadRange(inertia=(1.0, 3.0)))
    >>> study["at"], len(study["points"]), study["one"]["phase_margin_deg"] >= 50.0 - 1e-6
    ('velocity-error', 3, True)
    """
    period = design.axis.sampling.period
    if span.delay[1] > MOST_DELAY * period * (1.0 + 1e-9):
        raise InputError(
            f"range of delay: found up to {span.delay[1]:g} s, {span.delay[1] / period:.4g} samples, expected at most "
            f"{MOST_DELAY} samples, {MOST_DELAY * period:g} s"
        )
    at = design.structure.place(design.retuned_at or "velocity-error")
    phase = design.requested.get("phase_margin_deg", design.phase_margin_deg)
    points, entries = span.points(), []
    plants = [
        sample_axis(
            loaded(design.axis, point["inertia"], point["compliance"]), design.velocity, design.filters, point["delay"]
        )
        for point in points
    ]
    for point, plant in zip(points, plants, strict=True):
        loop = SampledVelocityLoop(plant, design.k_v1, design.t_v, design.structure)
        margins, at_input = loop.margins_at(at).to_dict(), loop.margins.to_dict()
        entries.append({**point, "bandwidth": loop.bandwidth, **margins, "plant_input": at_input})
    crossover = _requested_crossover(design, at)
    single = _fastest_gains(plants, phase, at, crossover)
    schedule = []
    for inertia in sorted({point["inertia"] for point in points}):
        of_inertia = [plant for point, plant in zip(points, plants, strict=True) if point["inertia"] == inertia]
        schedule.append({"inertia": inertia, "gains": _fastest_gains(of_inertia, phase, at, crossover)})
    return {
        "at": at,
        "phase_margin_deg": phase,
        "points": entries,
        "worst": _least_phase_margin(entries),
        "one": single,
        "schedule": schedule,
        "text": _summary(crossover, at, single, schedule),
    }


def _least_phase_margin(entries: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """The entry with the smallest phase margin, an unstable one first; without a crossover the margin is unbounded."""

    def margin(entry: dict[str, Any]) -> float:
        return math.inf if entry["phase_margin_deg"] is None else entry["phase_margin_deg"]

    return min(entries, key=lambda entry: (entry["stable"], margin(entry)))


def _fastest_gains(plants: list[SampledPlant], phase: float, at: str, crossover: float) -> dict[str, Any] | None:
    """Return the fastest gains with that phase margin [deg] at ``at`` on all ``plants``, None if there are none.

    Of gains whose crossovers differ by less than :data:`EQUAL`, it returns those with the most integral action. They
    have at least the requested ``crossover`` [rad/s] if any gains do.
    """
    nyquist, best, fastest = math.pi / plants[0].period, None, 0.0
    for plant in (plants[0], plants[-1]):  # gains are computed for the ends of the range
        w = np.geomspace(1e-4, 0.9, CROSSOVERS) * nyquist
        for _ in range(2):  # over all crossovers, then near the best
            crossovers, phases = (pair.ravel() for pair in np.meshgrid(w, phase + MORE_PHASE))
            k_v1, t_v = retuned_gains(plant, crossovers, phases, at)
            slowest, least = _over_plants(plants, k_v1, t_v, phase, at)
            top = float(slowest.max())
            if top > fastest:
                good = np.flatnonzero(slowest >= max((1.0 - EQUAL) * top, min(crossover, top)))
                place = good[np.argmax(k_v1[good] / t_v[good])]
                fields = {"k_v1": k_v1, "t_v": t_v, "slowest_crossover": slowest, "phase_margin_deg": least}
                fastest, best = top, {name: float(values[place]) for name, values in fields.items()}
            if top == 0.0:
                break
            centre = float(crossovers[np.argmax(slowest)])
            w = np.geomspace(centre / CLOSE, min(centre * CLOSE, 0.9 * nyquist), CROSSOVERS)
    return best


def _over_plants(
    plants: list[SampledPlant], k_v1: np.ndarray, t_v: np.ndarray, phase: float, at: str
) -> tuple[np.ndarray, np.ndarray]:
    """Slowest crossover [rad/s] and smallest phase margin [deg] of gains (n,) over ``plants``; 0 if a plant fails."""
    good, extremes = np.flatnonzero(np.isfinite(k_v1)), np.full((2, k_v1.size), np.inf)
    for plant in plants:
        margins = {
            place: sweep_sampled_margins(plant, k_v1[good], t_v[good], 120, place, exact_delay=False)
            for place in {at, PLACES[0]}
        }
        there, input_margins = margins[at], margins[PLACES[0]]
        holds = there["stable"] & (there["phase_margin_deg"] >= phase - 1e-6)
        holds &= ~(input_margins["gain_margin"] < GAIN_MARGIN) & ~(input_margins["delay_margin"] < ROOM * plant.period)
        holds &= there[LOWEST] * t_v[good] <= 2.0 * INTEGRAL
        extremes[:, good] = np.fmin(extremes[:, good], [there[LOWEST], there["phase_margin_deg"]])
        good = good[holds]
    slowest, least = np.where(np.isin(np.arange(k_v1.size), good), extremes, 0.0)
    return slowest, least


def _requested_crossover(design: VelocityLoopDesign, at: str) -> float:
    """Return the requested crossover [rad/s], or the one at ``at`` that follows from the requested bandwidth."""
    crossover = design.requested.get("crossover")
    if crossover is None and design.retuned_at:
        gains = np.array([design.k_v1]), np.array([design.t_v])
        crossover = float(sweep_sampled_margins(design.sampled.plant, *gains, at=at)[LOWEST][0])
    return float(design.crossover if crossover is None else crossover)


def _summary(crossover: float, at: str, single: dict[str, Any] | None, schedule: list[dict[str, Any]]) -> str:
    place = f"at the {at.replace('-', ' ')}"
    scheduled, enough = [entry["gains"] for entry in schedule], crossover * (1.0 - 1e-3)
    if single is not None and single["slowest_crossover"] >= enough:
        return (
            f"one pair of gains meets the margins over the range, with a crossover {place} of at least "
            f"{single['slowest_crossover']:.4g} rad/s"
        )
    if all(gains is not None and gains["slowest_crossover"] >= enough for gains in scheduled):
        return (
            f"no single pair of gains has a crossover of {crossover:.4g} rad/s {place} over the range: schedule the "
            "gains with the inertia"
        )
    if single is not None:
        return (
            f"a crossover of {crossover:.4g} rad/s {place} is not feasible over the range, scheduled or not; one pair "
            f"of gains has at least {single['slowest_crossover']:.4g} rad/s"
        )
    return "no single pair of gains meets the margins over the range, at any crossover"


def relative_mismatch(mismatch: float) -> dict[str, float]:
    """The same relative error for mass, viscous friction and force gain; raises :class:`InputError` outside [0, 1).

    >>> relative_mismatch(0.02)
    {'mass': 0.02, 'viscous': 0.02, 'force_gain': 0.02}
    """
    if not 0.0 <= mismatch < 1.0:
        raise InputError(f"mismatch: found {mismatch:g}, expected a relative error in [0, 1), such as 0.02")
    return dict.fromkeys(PARAMETERS, mismatch)


def identified_mismatch(axis: Axis, parameters: Mapping[str, Mapping[str, float]]) -> dict[str, float]:
    """Return the relative uncertainty of identified mass and viscous friction: half of their 95 % intervals.

    ``parameters`` is that member of ``identify --json``: name -> {value, std, interval_95 ...}, of one record or of
    several. The interval includes the estimated error of a filter. Of several intervals (a bootstrap, two directions),
    or of deviations only (2 std, the spread between records), the largest counts. The uncertainty is relative to the
    numbers of the axis. Raises :class:`InputError` if mass or viscous has no interval.

    >>> from emps_design.machines import machine
    >>> parameters = {"mass": {"std": 0.29}, "viscous": {"std": 8.8, "interval_95": [455.0, 493.0]}}
    >>> round(identified_mismatch(machine("emps2018"), parameters)["viscous"], 3)
    0.04
    """
    shares: dict[str, float] = {}
    for name in ("mass", "viscous"):
        entries = [parameters[key] for key in (name, f"{name}_positive", f"{name}_negative") if key in parameters]
        halves = [
            half
            for entry in entries
            for key, number in entry.items()
            if (half := _half_interval(key, number)) is not None
        ]
        if not halves:
            raise InputError(f"identified parameters: {name} has no std, expected the JSON of an identification")
        value = getattr(axis.mechanics, name)
        shares[name] = max(halves) / value if value > 0.0 else 0.0
        if shares[name] >= 1.0:
            raise InputError(
                f"identified parameters: the interval of {name} is +-{shares[name]:.3g} of its value, expected below 1"
            )
    return shares


def _half_interval(key: str, value: Any) -> float | None:
    """Half of the 95 % interval in an entry of an identified parameter, None for other entries."""
    if key.startswith("interval_95") and isinstance(value, Sequence) and len(value) == 2:
        low, high = value
        half = 0.5 * (high - low) if all(isinstance(end, int | float) for end in value) else math.nan
    elif key == "spread" or key.startswith("std"):
        half = 2.0 * value if isinstance(value, int | float) else math.nan
    else:
        return None
    return half if math.isfinite(half) and half >= 0.0 else None


def margins_under_mismatch(design: VelocityLoopDesign, errors: Mapping[str, float]) -> dict[str, Any]:
    """Return margins and gains over the corners of ``errors``, the relative error of each parameter.

    The gains of ``design`` run on the plant of every corner: ``worst`` is the corner with the smallest phase margin of
    the sampled loop at the plant input (the first unstable one, if any). ``gains`` are the intervals of k_v1 and t_v by
    (7) at the corners, for the same crossover and phase margin.

    >>> from emps_design.control.velocity.design import design_velocity_loop
    >>> from emps_design.machines import machine
    >>> design = design_velocity_loop(machine("emps2018"), crossover=100.0, phase_margin_deg=60.0)
    >>> study = margins_under_mismatch(design, relative_mismatch(0.02))
    >>> study["stable_share"], round(study["phase_margin_deg"][0], 1), round(study["phase_margin_deg"][1], 1)
    (1.0, 39.1, 39.2)
    """
    outcomes, k_v1s, t_vs = [], [], []
    crossover, phase = design.crossover, design.phase_margin_deg
    for shares in corners(errors):
        axis = with_errors(design.axis, shares)
        plant = sample_axis(axis, design.velocity, design.filters)
        loop = SampledVelocityLoop(plant, design.k_v1, design.t_v, design.structure)
        outcomes.append({"parameters": shares, "bandwidth": loop.bandwidth, **loop.margins.to_dict()})
        mass, damping = axis.mechanics.mass, axis.damping
        low, high = design.structure.feasible_phase_margin(mass, damping, crossover)
        if low < phase < high:
            gain, t_v = design.structure.gains(mass, damping, crossover, phase)
            k_v1s.append(float(gain) / axis.drive.gain)
            t_vs.append(float(t_v))
    stable = [corner for corner in outcomes if corner["stable"]]

    def interval(key: str) -> list[float] | None:
        values = [corner[key] for corner in stable if corner[key] is not None]
        return [min(values), max(values)] if values else None

    return {
        "errors": dict(errors),
        "corners": len(outcomes),
        "stable_share": len(stable) / len(outcomes),
        "worst": _least_phase_margin(outcomes),
        **{key: interval(key) for key in ("phase_margin_deg", "crossover", "delay_margin", "gain_margin", "bandwidth")},
        "gains": {"k_v1": [min(k_v1s), max(k_v1s)], "t_v": [min(t_vs), max(t_vs)]} if k_v1s else None,
    }


def corners(errors: Mapping[str, float]) -> list[dict[str, float]]:
    """Every combination of plus and minus the relative ``errors``.

    >>> corners({"mass": 0.02})
    [{'mass': -0.02}, {'mass': 0.02}]
    """
    signs = itertools.product((-1.0, 1.0), repeat=len(errors))
    return [{name: sign * errors[name] for name, sign in zip(errors, each, strict=True)} for each in signs]


def with_errors(axis: Axis, shares: Mapping[str, float]) -> Axis:
    """Return ``axis`` with the relative errors ``shares`` of its parameters.

    >>> from emps_design.machines import machine
    >>> round(with_errors(machine("emps2018"), {"mass": 0.02}).mechanics.mass / 115.7315, 6)
    1.02
    """
    tables: dict[str, dict[str, float]] = {}
    for name, share in shares.items():
        place = PARAMETERS[name]
        tables.setdefault(place, {})[name] = getattr(getattr(axis, place), name) * (1.0 + share)
    if "drive" in tables:  # the product of the data sheet no longer holds
        table = {key: value for key, value in axis.drive.model_dump(exclude_none=True).items() if key not in FACTORS}
        drive = type(axis.drive)(**{**table, **tables.pop("drive")})
        axis = axis.model_copy(update={"drive": drive})
    return axis.model_copy(update={"mechanics": axis.mechanics.model_copy(update=tables.get("mechanics", {}))})
