"""Gains with which the sampled loop meets the specification, by solving two linear equations.

At one frequency the open loop at the plant input is k_v1 P + (k_v1/t_v) c P, with P the sampled plant including hold,
delays, current loop and velocity estimator, and c = T z/(z - 1) the integrator. Asking it to be -exp(j phi) at the
crossover is two real equations, linear in k_v1 and k_v1/t_v. The same holds for the loop broken at the velocity error.
"""

from __future__ import annotations

import math

import numpy as np

from emps_design.axis import Axis
from emps_design.control.discretisation import SampledPlant, sample_axis
from emps_design.control.velocity.design import VelocityLoopDesign
from emps_design.control.velocity.gains import IP, MINUS_3_DB, PLACES, Structure, own_filters, own_structure
from emps_design.control.velocity.sampled import SampledVelocityLoop
from emps_design.control.velocity.specification import Pairs, check_specification, nearest_that_works, proposal_in_words
from emps_design.control.velocity.sweeps import sweep_stability
from emps_design.errors import InputError, SpecificationError
from emps_design.laws.library.cascade import Filter

GRID = 240  # crossovers tried for one bandwidth, at equal ratios


def retuned_gains(
    plant: SampledPlant,
    crossover: np.ndarray | float,
    phase_margin_deg: np.ndarray | float,
    at: str = "plant-input",
) -> tuple[np.ndarray, np.ndarray]:
    """Return k_v1 [V/(m/s)] and t_v [s] for the sampled ``plant``, NaN where they would not be positive.

    ``crossover`` [rad/s] and ``phase_margin_deg`` [deg] are those of the sampled loop broken ``at`` "plant-input" or
    "velocity-error"; they broadcast. The gains do not ensure stability: check the poles.

    >>> from emps_design.machines import machine
    >>> plant = sample_axis(machine("emps2018"))
    >>> k_v1, t_v = retuned_gains(plant, 100.0, 60.0)
    >>> round(SampledVelocityLoop(plant, float(k_v1), float(t_v)).margins.phase_margin_deg, 6)
    60.0
    """
    w = np.asarray(crossover, dtype=float)
    inside = (w > 0.0) & (w < math.pi / plant.period)
    w = np.where(inside, w, 1.0)
    P, c = plant.response(w), plant.integrator(w)
    target = -np.exp(1j * np.radians(np.asarray(phase_margin_deg, dtype=float)))
    # plant input: P k + c P k/t = target;  velocity error: c P k/t = target (1 + k P)
    first, second = (P if at == "plant-input" else -target * P), c * P
    with np.errstate(divide="ignore", invalid="ignore"):
        determinant = first.real * second.imag - first.imag * second.real
        k_v1 = (target.real * second.imag - target.imag * second.real) / determinant
        integral = (first.real * target.imag - first.imag * target.real) / determinant
        works = inside & (k_v1 > 0.0) & (integral > 0.0) & np.isfinite(k_v1) & np.isfinite(integral)
        return np.where(works, k_v1, np.nan), np.where(works, k_v1 / integral, np.nan)


def retune_velocity_loop(
    axis: Axis,
    crossover: float | None = None,
    bandwidth: float | None = None,
    phase_margin_deg: float = 60.0,
    at: str = "plant-input",
    velocity: float = 0.1,
    structure: Structure | None = None,
    filters: tuple[Filter, ...] | None = None,
) -> VelocityLoopDesign:
    """Return the design whose *sampled* loop has a given phase margin and a given crossover or -3 dB bandwidth.

    Arguments as for :func:`~emps_design.control.velocity.design.design_velocity_loop`, and ``at``, the place where the
    loop is broken. Raises :class:`SpecificationError` if no positive gains meet it, if the loop with them is unstable,
    or if another crossover has less phase margin.

    >>> from emps_design.machines import machine
    >>> design = retune_velocity_loop(machine("emps2018"), crossover=150.0, phase_margin_deg=50.0)
    >>> margins = design.sampled.margins
    >>> round(margins.crossover, 6), round(margins.phase_margin_deg, 6)
    (150.0, 50.0)
    """
    if at not in PLACES:
        raise InputError(f"place of the margin: found {at!r}, expected one of {', '.join(PLACES)}")
    requested = check_specification(crossover, bandwidth, phase_margin_deg)
    structure, filters = own_structure(axis, structure), own_filters(axis, filters)
    plant = sample_axis(axis, velocity, filters)
    pairs = retuned_pairs(plant, requested, at, structure)
    name, frequency = next(iter(requested.items()))
    loop = pairs.loop(frequency, phase_margin_deg) if 0.0 < phase_margin_deg < 180.0 else None
    if loop is not None and pairs.met(loop, frequency, phase_margin_deg):
        return VelocityLoopDesign(
            axis, loop.k_v1, loop.t_v, requested, at, velocity, structure=structure, filters=filters
        )
    if loop is not None:
        reason = "the loop crosses 0 dB more than once, and another crossing has less phase margin"
        again = loop.margins.crossover or 0.0
        resonance = plant.resonance_beside(again)
        if resonance is not None:
            hertz = 2.0 * math.pi
            reason += f", at {again / hertz:.4g} Hz beside the resonance at {resonance / hertz:.4g} Hz, which binds"
    else:
        reason = _limit(plant, requested, at, structure)
    nearest = nearest_that_works(pairs, requested)
    raise SpecificationError(
        f"retune: no gains give the sampled loop {phase_margin_deg:g} deg at a {name} of {frequency:g} rad/s; "
        f"{reason}; {proposal_in_words(nearest, pairs)}",
        nearest,
    )


def retuned_pairs(plant: SampledPlant, requested: dict[str, float], at: str, structure: Structure = IP) -> Pairs:
    """Return the pairs of the kind ``requested`` with gains for the sampled loop of ``plant`` broken ``at``.

    >>> from emps_design.machines import machine
    >>> requested = {"bandwidth": 50.0, "phase_margin_deg": 60.0}
    >>> pairs = retuned_pairs(sample_axis(machine("emps2018")), requested, "plant-input")
    >>> pairs.judge(np.array([50.0, 60.0]), np.array([60.0, 60.0])).tolist()
    [2, 0]
    """
    place = structure.place(at)
    if "bandwidth" in requested:
        return Pairs(
            plant,
            lambda w, phase: bandwidth_gains(plant, w, phase, place, structure),
            lambda w, phase: w,
            at,
            True,
            structure,
        )

    def passes(w: np.ndarray, phase: np.ndarray) -> np.ndarray:
        if at == "velocity-error" or structure.form == "pi":
            return w
        # With an ideal plant t_v w = tan(phase) there, and the closed-loop bandwidth is about 1/t_v.
        return w * np.clip(1.0 / np.tan(np.radians(phase)), 0.01, 1.0)

    return Pairs(plant, lambda w, phase: retuned_gains(plant, w, phase, place), passes, at, structure=structure)


def bandwidth_gains(
    plant: SampledPlant,
    bandwidth: np.ndarray,
    phase_margin_deg: np.ndarray,
    at: str = "plant-input",
    structure: Structure = IP,
) -> tuple[np.ndarray, np.ndarray]:
    """Return k_v1 [V/(m/s)] and t_v [s] of the sampled loops with that -3 dB ``bandwidth`` [rad/s], NaN for none.

    With rising crossover the bandwidth first rises and then falls, since the plant's lag leaves ever less phase for the
    integral action; the slowest stable loop with that bandwidth is taken. Arrays (n,).

    >>> from emps_design.machines import machine
    >>> plant = sample_axis(machine("emps2018"))
    >>> k_v1, t_v = bandwidth_gains(plant, np.array([50.0]), np.array([60.0]))
    >>> round(SampledVelocityLoop(plant, float(k_v1[0]), float(t_v[0])).bandwidth, 6)
    50.0
    """
    B, phase = np.broadcast_arrays(np.asarray(bandwidth, float), np.asarray(phase_margin_deg, float))

    def over(w: np.ndarray, B: np.ndarray, phase: np.ndarray) -> np.ndarray:
        """Gain of the closed loop with crossover ``w`` at ``B``, less that at -3 dB."""
        loops = SampledVelocityLoop(plant, *retuned_gains(plant, w, phase, at), structure)
        with np.errstate(invalid="ignore"):
            return np.abs(loops.closed_loop_response(B)) - MINUS_3_DB

    nyquist = 0.999 * math.pi / plant.period
    k_found, t_found = np.full(B.size, np.nan), np.full(B.size, np.nan)
    lowest, highest = B / 50.0, np.minimum(100.0 * B, nyquist)
    inside = np.flatnonzero((lowest < highest) & (nyquist > B))
    shares = np.linspace(0.0, 1.0, GRID)
    grid = lowest[inside, None] * (highest[inside] / lowest[inside])[:, None] ** shares
    excess = over(grid, B[inside, None], phase[inside, None])
    rising = (excess[:, :-1] < 0.0) & (excess[:, 1:] >= 0.0)
    for turn in range(1, 4):  # the first crossing whose loop is stable
        here = rising & (np.cumsum(rising, axis=1) == turn)
        rows, places = np.nonzero(here)
        todo = np.isnan(k_found[inside[rows]])
        rows, places = rows[todo], places[todo]
        if not rows.size:
            break
        who = inside[rows]
        low, high = grid[rows, places], grid[rows, places + 1]
        for _ in range(50):
            middle = np.sqrt(low * high)
            below = over(middle, B[who], phase[who]) < 0.0
            low, high = np.where(below, middle, low), np.where(below, high, middle)
        k_v1, t_v = retuned_gains(plant, high, phase[who], at)
        good = sweep_stability(plant, k_v1, t_v)
        k_found[who[good]], t_found[who[good]] = k_v1[good], t_v[good]
    return k_found, t_found


def _limit(plant: SampledPlant, requested: dict[str, float], at: str, structure: Structure) -> str:
    """Return which limit binds, from the plant's phase at the crossover."""
    if not 0.0 < requested["phase_margin_deg"] < 180.0:
        return "a phase margin lies between 0 and 180 deg"
    place = structure.place(at)
    if "bandwidth" in requested:
        most = _largest_bandwidth(plant, requested["phase_margin_deg"], place, structure)
        if requested["bandwidth"] > most > 0.0:
            return (
                f"with that phase margin at the {at.replace('-', ' ')} the bandwidth reaches {most:.5g} rad/s at most"
            )
        return "the gains would not be positive, or the loop with them unstable"
    if place != "plant-input":
        return "the gains would not be positive, or the loop with them unstable"
    w, phase = requested["crossover"], requested["phase_margin_deg"]
    if w >= math.pi / plant.period:
        return f"the crossover lies beyond the Nyquist frequency, {math.pi / plant.period:.5g} rad/s"
    grid = np.geomspace(1e-5 * w, w, 2000)
    plant_phase = math.degrees(np.unwrap(np.angle(plant.response(grid)))[-1])
    low, high = 90.0 + plant_phase + math.degrees(0.5 * w * plant.period), 180.0 + plant_phase
    if phase >= high and high <= 0.0:
        return "the upper limit binds: hold, delays, current loop and estimator leave no phase margin there"
    if phase >= high:
        return (
            f"the upper limit binds: hold, delays, current loop and estimator leave at most {high:.4g} deg there, "
            "even without integral action"
        )
    if phase <= low:
        return f"the lower limit binds: below {low:.4g} deg k_v1 is not positive"
    return "the sampled loop with those gains is unstable"


def _largest_bandwidth(plant: SampledPlant, phase_margin_deg: float, at: str, structure: Structure) -> float:
    """The largest -3 dB bandwidth [rad/s] of a stable sampled loop with that phase margin, 0 if there is none."""

    def works(bandwidth: np.ndarray) -> np.ndarray:
        phase = np.full(bandwidth.size, phase_margin_deg)
        return np.isfinite(bandwidth_gains(plant, bandwidth, phase, at, structure)[0])

    grid = np.geomspace(1e-5, 0.99, 400) * math.pi / plant.period
    feasible = np.flatnonzero(works(grid))
    if not feasible.size:
        return 0.0
    low, high = grid[feasible[-1]], grid[min(feasible[-1] + 1, grid.size - 1)]
    for _ in range(30):
        middle = np.sqrt(low * high)
        low, high = (middle, high) if works(np.array([middle]))[0] else (low, middle)
    return float(low)
