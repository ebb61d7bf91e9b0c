"""Many velocity-loop designs at once: gains and margins as arrays for arrays of specifications."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from emps_design.axis import Axis
from emps_design.control.discretisation import SampledPlant
from emps_design.control.linear_plant import POSITION
from emps_design.control.margins import KEYS, LOWEST, margin_arrays
from emps_design.control.sampled import MARGINAL, close
from emps_design.control.velocity.gains import IP, Structure, positive_root, second_order_form
from emps_design.control.velocity.sampled import SampledVelocityLoop, velocity_table
from emps_design.errors import InputError
from emps_design.laws.linear import linear_law

SURE = 1e3  # least distance of a step of the stability test from its limit, in rounding errors


@dataclass(frozen=True)
class VelocityLoopSweep:
    """Arrays of one shape, NaN where there are no gains; units as in the scalar design.

    ``k_v1`` [V/(m/s)], ``t_v`` [s], ``K_v`` [N/m], ``omega_0v`` [rad/s], ``z_v``, ``bandwidth`` [rad/s] of T_vc;
    ``plant_input_phase_margin_deg`` [deg], ``plant_input_crossover`` [rad/s] and ``delay_margin`` [s] of the continuous
    loop broken at the plant input; ``feasible`` is True where there are gains.
    """

    crossover: np.ndarray
    phase_margin_deg: np.ndarray
    feasible: np.ndarray
    k_v1: np.ndarray
    t_v: np.ndarray
    K_v: np.ndarray
    omega_0v: np.ndarray
    z_v: np.ndarray
    bandwidth: np.ndarray
    plant_input_phase_margin_deg: np.ndarray
    plant_input_crossover: np.ndarray
    delay_margin: np.ndarray

    def to_dict(self) -> dict[str, Any]:
        """The arrays by name."""
        return dict(vars(self))


def sweep_velocity_loop(
    axis: Axis, crossover: np.ndarray | float, phase_margin_deg: np.ndarray | float, structure: Structure = IP
) -> VelocityLoopSweep:
    """Design by (7), or its counterpart for "pi", for pairs of ``crossover`` [rad/s] and ``phase_margin_deg`` [deg].

    The two broadcast. A pair that cannot be met gives NaN and ``feasible`` False; :class:`InputError` for crossovers
    that are not positive numbers.

    >>> from emps_design.machines import machine
    >>> sweep = sweep_velocity_loop(machine("emps2018"), np.array([100.0, 100.0]), np.array([60.0, 1.0]))
    >>> np.round(sweep.k_v1, 3).tolist(), sweep.feasible.tolist()
    ([556.766, nan], [True, False])
    """
    w, phase = np.broadcast_arrays(np.asarray(crossover, dtype=float), np.asarray(phase_margin_deg, dtype=float))
    if not np.all(np.isfinite(w) & (w > 0.0)):
        raise InputError("crossover: found a value that is not a positive number of rad/s")
    mass, viscous, gain = axis.mechanics.mass, axis.damping, axis.drive.gain
    low, high = structure.feasible_phase_margin(mass, viscous, w)
    feasible = (phase > low) & (phase < high)
    feasible_phase = np.where(feasible, phase, np.nan)
    K, t_v = structure.gains(mass, viscous, w, feasible_phase)
    K_v, (omega_0v, z_v) = K / t_v, second_order_form(mass, viscous, K, t_v)
    # |L| = 1 at the plant input: M^2 x^2 + (F^2 - K^2) x - K_v^2 = 0 with x = w^2
    at_input = np.sqrt(positive_root(mass**2, viscous**2 - K**2, -(K_v**2)))
    lag = np.arctan(at_input * t_v) + np.arctan2(viscous, mass * at_input)
    return VelocityLoopSweep(
        w, phase, feasible, K / gain, t_v, K_v, omega_0v, z_v, structure.bandwidth(omega_0v, z_v, t_v),
        np.degrees(lag), at_input, lag / at_input,
    )  # fmt: skip


def sweep_stability(plant: SampledPlant, k_v1: np.ndarray, t_v: np.ndarray) -> np.ndarray:
    """Return for every pair of gains whether the sampled loop is stable, by the Schur-Cohn test of its polynomial.

    Where rounding may decide, as in loops much slower than their sampling, the poles are computed.
    ``k_v1`` [V/(m/s)], ``t_v`` [s] (n,); returns (n,) of bool, False where the gains are NaN.

    >>> from emps_design.control.discretisation import sample_axis
    >>> from emps_design.machines import machine
    >>> sweep_stability(sample_axis(machine("emps2018")), np.array([556.8, 5568.0]), np.array([8.455e-3, 8.455e-3]))
    array([ True, False])
    """
    numerator, denominator = plant.polynomials
    integrated = plant.period * np.append(numerator, 0.0)  # T z N, over (z - 1) in the law
    proportional, open_loop = np.polymul(numerator, [1.0, -1.0]), np.polymul(denominator, [1.0, -1.0])
    if plant.kept[0] == POSITION and abs(np.sum(numerator)) < 1e-6 * np.sum(np.abs(numerator)):
        # With a force over position the final velocity is zero: the root of N at z = 1 cancels that of the integrator.
        integrated = plant.period * np.append(np.polydiv(numerator, [1.0, -1.0])[0], 0.0)
        proportional, open_loop = numerator, denominator
    k, t = np.asarray(k_v1, dtype=float)[:, None], np.asarray(t_v, dtype=float)[:, None]
    size = open_loop.size
    both = np.zeros((2, size))  # what k_v1 and k_v1/t_v multiply
    both[0, size - proportional.size :] = proportional
    both[1, size - integrated.size :] = integrated
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        a = open_loop + k * both[0] + k / t * both[1]
        stable, doubtful = np.ones(len(a), dtype=bool), np.zeros(len(a), dtype=bool)
        error = np.full(len(a), np.finfo(float).eps)  # each step divides it by the distance from the limit
        for degree in range(size - 1, 0, -1):
            reflection = a[:, degree : degree + 1] / a[:, :1]
            stable &= np.abs(reflection[:, 0]) < 1.0
            apart = np.abs(1.0 - reflection[:, 0] ** 2)
            doubtful |= apart < SURE * error
            error = error / np.minimum(apart, 1.0)
            a = a[:, :degree] - reflection * a[:, degree:0:-1]
            a = a / a[:, :1]
    which = np.flatnonzero(doubtful & np.isfinite(k[:, 0]))
    stable[which] = _stable_by_poles(plant, k[which, 0], t[which, 0])
    return stable


def _stable_by_poles(plant: SampledPlant, k_v1: np.ndarray, t_v: np.ndarray) -> np.ndarray:
    """Return stability (n,) by eigenvalues, for loops much slower than their sampling.

    The matrix of the loop is affine in k_v1 and k_v1/t_v.
    """
    if not k_v1.size:
        return np.ones(0, dtype=bool)

    def matrix(k: float, integral: float) -> np.ndarray:
        kind, table = velocity_table(k, k / integral, IP, plant.filters, plant.estimator, in_a_cascade=True)
        return close(plant, linear_law(kind.law(table, None, plant.period), plant.period)).A

    k, integral = k_v1[:, None, None], (k_v1 / t_v)[:, None, None]
    k_0, integral_0 = float(k.min()), float(integral.min())
    base = matrix(k_0, integral_0)
    more, more_integral = matrix(2.0 * k_0, integral_0) - base, matrix(k_0, 2.0 * integral_0) - base
    A = base + (k / k_0 - 1.0) * more + (integral / integral_0 - 1.0) * more_integral
    return np.abs(np.linalg.eigvals(A)).max(axis=-1) <= 1.0 + MARGINAL


def sweep_sampled_margins(
    plant: SampledPlant,
    k_v1: np.ndarray,
    t_v: np.ndarray,
    frequencies: int = 100,
    at: str = "plant-input",
    exact_delay: bool = True,
) -> dict[str, np.ndarray]:
    """Return stability and margins of the sampled loop, broken ``at`` that place, for every pair of gains.

    ``k_v1`` [V/(m/s)] and ``t_v`` [s] of one shape. Keys: ``stable`` and those of
    ``emps_design.control.margins.KEYS`` and ``LOWEST``, NaN where the loop is unstable or a margin unbounded.
    ``frequencies`` is the size of the grid that brackets the crossings; ``at`` is "plant-input" or "velocity-error".
    Without ``exact_delay`` the delay margin is that of the phase alone: exact at whole samples, and so sufficient for
    a comparison with one.

    >>> from emps_design.control.discretisation import sample_axis
    >>> from emps_design.machines import machine
    >>> margins = sweep_sampled_margins(sample_axis(machine("emps2018")), np.array([556.766]), np.array([8.45505e-3]))
    >>> round(float(margins["phase_margin_deg"][0]), 1), bool(margins["stable"][0])
    (39.2, True)
    """
    shape = np.shape(k_v1)
    k, t = np.ravel(np.asarray(k_v1, dtype=float)), np.ravel(np.asarray(t_v, dtype=float))
    stable = sweep_stability(plant, k, t)
    chosen = np.flatnonzero(stable)
    grid = plant.frequencies(frequencies)
    margins = {key: np.full(k.size, np.nan) for key in (*KEYS, LOWEST)}
    for start in range(0, chosen.size, 2000):  # pieces that stay in the cache
        piece = chosen[start : start + 2000]
        for key, values in _margins(plant, k[piece], t[piece], grid, at, exact_delay).items():
            margins[key][piece] = values
    return {"stable": stable.reshape(shape), **{key: values.reshape(shape) for key, values in margins.items()}}


def _margins(
    plant: SampledPlant, k_v1: np.ndarray, t_v: np.ndarray, grid: np.ndarray, at: str, exact_delay: bool
) -> dict[str, Any]:
    """Margins of stable loops (n,); the delay margin may be exact where the delay acts."""

    def loops(rows: np.ndarray) -> SampledVelocityLoop:
        return SampledVelocityLoop(plant, k_v1[rows], t_v[rows])

    nyquist = np.pi / plant.period
    if at != "plant-input":
        return margin_arrays(lambda w, rows: loops(rows).velocity_error_response(w), k_v1.size, grid, nyquist)
    return margin_arrays(
        lambda w, rows: loops(rows).plant_input_response(w),
        k_v1.size,
        grid,
        nyquist,
        (lambda w, rows, delay: loops(rows).delayed_response(w, delay)) if exact_delay else None,
    )
