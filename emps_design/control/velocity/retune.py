"""Gains with which the loop as implemented meets the specification, solved for instead of searched.

At one frequency the open loop at the plant input is k_v1 P + (k_v1/t_v) c P, with P the sampled plant including hold,
delays, current loop and velocity estimator, and c = T z/(z - 1) the integrator. Asking it to be -exp(j phi) at the
crossover is two real equations, linear in k_v1 and k_v1/t_v. The same holds for the loop broken at the velocity error.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from emps_design.axis import Axis
from emps_design.control.loop.sampled_loop import SampledVelocityLoop
from emps_design.control.plant.discretisation import SampledPlant, sample_axis
from emps_design.control.velocity.design import VelocityLoopDesign
from emps_design.control.velocity.specification import check_specification, in_words, nearest_that_works
from emps_design.control.velocity.sweeps import sweep_sampled_margins
from emps_design.errors import InputError, SpecificationError

PLACES = ("plant-input", "velocity-error")


def retuned_gains(
    plant: SampledPlant,
    crossover: np.ndarray | float,
    phase_margin_deg: np.ndarray | float,
    at: str = "plant-input",
) -> tuple[np.ndarray, np.ndarray]:
    """Return k_v1 [V/(m/s)] and t_v [s] for the sampled ``plant``, NaN where they would not be positive.

    ``crossover`` [rad/s] and ``phase_margin_deg`` [deg] are those of the sampled loop broken ``at`` "plant-input" or
    "velocity-error"; they broadcast. Whether the loop is stable with the gains is for its poles to say.

    >>> from emps_design.machines import machine
    >>> plant = sample_axis(machine("emps2018"))
    >>> k_v1, t_v = retuned_gains(plant, 100.0, 60.0)
    >>> round(SampledVelocityLoop(plant, float(k_v1), float(t_v)).margins.phase_margin_deg, 6)
    60.0
    """
    w = np.asarray(crossover, dtype=float)
    inside = (w > 0.0) & (w < math.pi / plant.period)
    w = np.where(inside, w, 1.0)
    P, c = plant.response(w), plant.period / (1.0 - np.exp(-1j * w * plant.period))
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
) -> VelocityLoopDesign:
    """Return the design whose *sampled* loop has the phase margin and the crossover, or the -3 dB bandwidth, asked for.

    Arguments as :func:`~emps_design.control.velocity.design.design_velocity_loop`, and ``at``, the place where the
    loop is broken. :class:`SpecificationError` where no positive gains do it, or the loop with them is unstable, or
    another crossover has less phase margin.

    >>> from emps_design.machines import machine
    >>> design = retune_velocity_loop(machine("emps2018"), crossover=150.0, phase_margin_deg=50.0)
    >>> margins = design.sampled.margins
    >>> round(margins.crossover, 6), round(margins.phase_margin_deg, 6)
    (150.0, 50.0)
    """
    if at not in PLACES:
        raise InputError(f"place of the margin: found {at!r}, expected one of {', '.join(PLACES)}")
    requested = check_specification(crossover, bandwidth, phase_margin_deg)
    plant = sample_axis(axis, velocity)

    def loop_of(w: float, phase: float) -> SampledVelocityLoop | None:
        k_v1, t_v = (float(gain) for gain in retuned_gains(plant, w, phase, at))
        loop = SampledVelocityLoop(plant, k_v1, t_v) if math.isfinite(k_v1) else None
        return loop if loop is not None and loop.stable else None

    def works(w: np.ndarray, phase: np.ndarray) -> np.ndarray:
        found = sweep_sampled_margins(plant, *retuned_gains(plant, w, phase, at), frequencies=400, at=at)
        return np.abs(found["phase_margin_deg"] - phase) < 1e-6  # NaN, unstable, compares False

    frequency, reason = requested[next(iter(requested))], ""
    if not 0.0 < phase_margin_deg < 180.0:
        loop = None
    elif bandwidth is None:
        loop = loop_of(frequency, phase_margin_deg)
    else:
        loop, reached = _for_bandwidth(lambda w: loop_of(w, phase_margin_deg), frequency, math.pi / plant.period)
        reason = (
            f"with that phase margin at the {at.replace('-', ' ')} the bandwidth reaches {reached:.5g} rad/s at most"
        )
    if loop is not None:
        margins = loop.margins if at == "plant-input" else loop.velocity_error
        if abs((margins.phase_margin_deg or 0.0) - phase_margin_deg) > 1e-6:
            loop, reason = None, "the loop crosses 0 dB more than once, and another crossing has less phase margin"
    if loop is None:
        if bandwidth is not None and reason and reached > 0.0:
            nearest = {"bandwidth": float(f"{0.99 * reached:.3g}"), "phase_margin_deg": phase_margin_deg}
        elif bandwidth is not None:
            nearest = {}
        else:
            nearest = nearest_that_works(works, requested)
        raise SpecificationError(
            f"retune: no gains give the sampled loop {phase_margin_deg:g} deg at a {next(iter(requested))} of "
            f"{frequency:g} rad/s; {reason or _limit(plant, requested, at)}; {in_words(nearest)}",
            nearest,
        )
    return VelocityLoopDesign(axis, loop.k_v1, loop.t_v, requested, retuned_at=at, velocity=velocity)


def _for_bandwidth(
    loop_of: Callable[[float], SampledVelocityLoop | None], bandwidth: float, nyquist: float
) -> tuple[SampledVelocityLoop | None, float]:
    """The loop with that -3 dB ``bandwidth``, or None, and the largest bandwidth met on the way [rad/s].

    With the crossover the bandwidth first rises and then falls, as the plant's lag leaves less and less room for the
    integral action; the slowest loop that reaches it is taken.
    """

    def reach(w: float) -> float:
        loop = loop_of(w)
        return (loop.bandwidth or 0.0) if loop else 0.0

    grid = np.geomspace(bandwidth / 50.0, min(10.0 * bandwidth, 0.999 * nyquist), 120)
    found = np.array([reach(float(w)) for w in grid])
    rising = np.nonzero((found[:-1] < bandwidth) & (found[1:] >= bandwidth) & (found[:-1] > 0.0))[0]
    if not rising.size:
        return None, float(np.max(found))
    low, high = float(grid[rising[0]]), float(grid[rising[0] + 1])
    while high - low > 1e-13 * high:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if reach(middle) < bandwidth else (low, middle)
    return loop_of(high), float(np.max(found))


def _limit(plant: SampledPlant, requested: dict[str, float], at: str) -> str:
    """Which limit binds, from the plant's phase at the crossover."""
    if not 0.0 < requested["phase_margin_deg"] < 180.0:
        return "a phase margin lies between 0 and 180 deg"
    if "crossover" not in requested or at != "plant-input":
        return "the gains would not be positive, or the loop with them unstable"
    w, phase = requested["crossover"], requested["phase_margin_deg"]
    if w >= math.pi / plant.period:
        return f"the crossover lies beyond the Nyquist frequency, {math.pi / plant.period:.5g} rad/s"
    plant_phase = math.degrees(np.angle(complex(plant.response(np.array(w)))))
    if plant_phase > 90.0:
        plant_phase -= 360.0
    low, high = 90.0 + plant_phase + math.degrees(0.5 * w * plant.period), 180.0 + plant_phase
    if phase >= high:
        return (
            f"the upper limit binds: hold, delays, current loop and estimator leave at most {high:.4g} deg there, "
            "even without integral action"
        )
    if phase <= low:
        return f"the lower limit binds: below {low:.4g} deg k_v1 is not positive"
    return "the sampled loop with those gains is unstable"
