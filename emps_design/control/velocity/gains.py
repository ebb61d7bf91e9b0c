"""Closed forms of the velocity loop: gains from a specification, (7) and (9), in both structures, IP and PI.

Functions that raise no error accept arrays (n,) in place of numbers.

IP, as in the paper, has its proportional part on the measured velocity, u = k_v1 (e/(t_v s) - qd), (6) to (9). PI, as
in servo drives, has it on the velocity error e, u = k_v1 (1 + 1/(t_v s)) e. Broken at the plant input the two loops are
the same, with the same poles and the same response to a disturbance; the reference of PI acts through an additional
zero:

    T_vc(s) = (1 + t_v s) / (1 + (t_v + F_v/K_v) s + M/K_v s^2)

so with the same gains its step response is faster and overshoots more. A reference filter 1/(1 + t_v s) cancels the
zero, which gives (8). The loop of PI broken at the velocity error is that at the plant input, so its gains for a
crossover and a phase margin differ from those of (7). ``derive`` shows the steps.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from pydantic import ValidationError

from emps_design.axis import Axis
from emps_design.errors import InputError, SpecificationError
from emps_design.laws import table_of
from emps_design.laws.library import cascade
from emps_design.quantities import read_frequency

NOTCH = {"damping": 0.5, "depth": 0.1}  # defaults of a notch with a frequency alone
FILTER_TEXTS = "lowpass:350Hz, notch:48Hz, notch:48Hz:DAMPING:DEPTH or none"
NO_FILTER = "none"

MINUS_3_DB = 10.0 ** (-3.0 / 20.0)

FORMS = ("ip", "pi")
PLACES = ("plant-input", "velocity-error")  # where the loop may be broken


def feasible_phase_margin(mass: float, viscous: float, crossover: Any) -> tuple[Any, float]:
    """Return the open interval of phase margins [deg] that (7) can give at ``crossover`` [rad/s].

    Below atan(F_v / (M w)) the gain k_v1 would be negative, at 90 deg infinite. ``mass`` [kg], ``viscous`` [N/(m/s)].

    >>> low, high = feasible_phase_margin(115.7315, 474.9727, 100.0)
    >>> round(float(low), 3), high
    (2.35, 90.0)
    """
    return np.degrees(np.arctan2(viscous, mass * crossover))[()], 90.0


def velocity_gains(
    mass: float, viscous: float, force_gain: float, crossover: float, phase_margin_deg: float
) -> tuple[float, float]:
    """Return k_v1 [V/(m/s)] and t_v [s] for a crossover and a phase margin of T_vo, (7).

    ``mass`` [kg], ``viscous`` [N/(m/s)], ``force_gain`` [N/V], ``crossover`` [rad/s], ``phase_margin_deg`` [deg]
    inside :func:`feasible_phase_margin`; :class:`SpecificationError` outside.

    >>> k_v1, t_v = velocity_gains(115.7315, 474.9727, 35.15, 100.0, 60.0)
    >>> round(k_v1, 3), round(t_v, 8)
    (556.766, 0.00845505)
    """
    low, high = feasible_phase_margin(mass, viscous, crossover)
    if not low < phase_margin_deg < high:
        raise SpecificationError(
            f"phase margin: found {phase_margin_deg:g} deg at a crossover of {crossover:g} rad/s, expected more than "
            f"{low:.4g} and less than {high:g} deg; {binding_limit(phase_margin_deg)}",
            {"crossover": crossover, "phase_margin_deg": min(max(phase_margin_deg, low + 0.5), 89.5)},
        )
    gain, t_v = plant_input_gain(mass, viscous, crossover, phase_margin_deg)
    return float(gain) / force_gain, float(t_v)


def plant_input_gain(mass: float, viscous: float, crossover: Any, phase_margin_deg: Any) -> tuple[Any, Any]:
    """Return K = k_v1 G_tau [N/(m/s)] and t_v [s] by (7), positive or not.

    >>> [round(float(x), 5) for x in plant_input_gain(2.0, 1.0, 10.0, 45.0)]
    [19.0, 0.06718]
    """
    phase = np.radians(phase_margin_deg)
    gain = mass * crossover * np.tan(phase) - viscous
    return gain, gain * np.cos(phase) / (mass * crossover**2)


def canonical_form(crossover: Any, phase_margin_deg: Any) -> tuple[Any, Any]:
    """Return omega_0v [rad/s] and z_v [-] of (9); they depend on the specification only, not on the machine.

    >>> w0, z = canonical_form(100.0, 60.0)
    >>> round(float(w0), 2), round(float(z), 5)
    (141.42, 0.61237)
    """
    phase = np.radians(phase_margin_deg)
    root = np.sqrt(np.cos(phase))
    return crossover / root, np.sin(phase) / (2.0 * root)


def second_order_form(mass: Any, viscous: Any, K: Any, t_v: Any) -> tuple[Any, Any]:
    """Return omega_0v [rad/s] and z_v [-] of (9) from the gains, K = k_v1 G_tau [N/(m/s)] and t_v [s].

    >>> [round(float(x), 4) for x in second_order_form(115.7315, 474.9727, 556.766 * 35.15, 8.45505e-3)]
    [141.4214, 0.6124]
    """
    omega_0v = np.sqrt(K / t_v / mass)
    return omega_0v, 0.5 * (t_v + viscous * t_v / K) * omega_0v


def second_order_bandwidth(omega_0v: Any, z_v: Any, zero: Any = 0.0) -> Any:
    """Return the frequency [rad/s] where (9), times 1 + ``zero`` s [s], has fallen to -3 dB, the ratio 10^(-3/20).

    >>> round(float(second_order_bandwidth(*canonical_form(100.0, 60.0))), 2)
    159.9
    """
    # |T_vc| = 10^(-3/20): x^2 - 2 (1 - 2 z^2) x + 1 = 10^(3/10) (1 + (zero w_0v)^2 x) with x = (w/w_0v)^2
    slope = 4.0 * z_v**2 - 2.0 - (zero * omega_0v / MINUS_3_DB) ** 2
    return omega_0v * np.sqrt(positive_root(1.0, slope, 1.0 - MINUS_3_DB**-2))


def positive_root(a: Any, b: Any, c: Any) -> Any:
    """Return the positive root of a x^2 + b x + c = 0 with a > 0 > c, without cancellation.

    >>> float(positive_root(1.0, 1.0, -6.0)), float(positive_root(1.0, -1.0, -6.0))
    (2.0, 3.0)
    """
    root = np.sqrt(b * b - 4.0 * a * c)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(b >= 0.0, -2.0 * c / (b + root), (root - b) / (2.0 * a))[()]


def crossover_of_bandwidth(bandwidth: Any, phase_margin_deg: Any) -> Any:
    """Return the crossover [rad/s] for a -3 dB ``bandwidth`` [rad/s] of the closed loop and a phase margin [deg].

    >>> round(float(crossover_of_bandwidth(159.898, 60.0)), 2)
    100.0
    """
    return bandwidth / second_order_bandwidth(*canonical_form(1.0, phase_margin_deg))


def binding_limit(phase_margin_deg: float) -> str:
    """Return which end of the feasible range a phase margin [deg] outside it violates.

    >>> binding_limit(90.0)
    'the upper limit binds: at 90 deg k_v1 is infinite'
    """
    if phase_margin_deg >= 90.0:
        return "the upper limit binds: at 90 deg k_v1 is infinite"
    return "the lower limit binds: below atan(F_v/(M w)) k_v1 is not positive"


@dataclass(frozen=True)
class Structure:
    """One structure: its ``form``, "ip" or "pi", and whether a reference filter 1/(1 + t_v s) precedes a "pi".

    The methods accept arrays in place of numbers.

    >>> K, t_v = PI.gains(2.0, 1.0, 10.0, 45.0)
    >>> round(float(abs(K * (1 + 1 / (t_v * 10j)) / (2.0 * 10j + 1.0))), 9)
    1.0
    """

    form: str = "ip"
    reference_filter: bool = False

    def __post_init__(self) -> None:
        if self.form not in FORMS:
            raise InputError(f"structure: found {self.form!r}, expected {' or '.join(FORMS)}")
        if self.form == "ip" and self.reference_filter:
            raise InputError("reference filter: found one with structure 'ip', which has no zero to cancel")

    @property
    def label(self) -> str:
        """Short name of the structure."""
        return f"{self.form.upper()}{' with reference filter' if self.reference_filter else ''}"

    @property
    def largest_phase_margin(self) -> float:
        """Upper bound [deg] of the feasible phase margins over all plants and crossovers."""
        return 90.0 if self.form == "ip" else 180.0

    @property
    def as_computed(self) -> Structure:
        """The structure of the equivalent law, sample by sample: PI with its reference filter is IP."""
        return IP if self.reference_filter else self

    def place(self, at: str) -> str:
        """The equivalent of the break point ``at``, one of ``PLACES``: with "pi" both are the plant input."""
        return PLACES[0] if self.form == "pi" else at

    def zero(self, t_v: Any) -> Any:
        """Time constant [s] of the zero of the closed loop: 1 + zero s in its numerator."""
        return t_v if self.form == "pi" and not self.reference_filter else 0.0

    def feasible_phase_margin(self, mass: float, viscous: float, crossover: Any) -> tuple[Any, Any]:
        """Open interval of feasible phase margins [deg] at ``crossover`` [rad/s].

        At the lower end k_v1 is 0; at the upper one k_v1 of "ip" is infinite and 1/t_v of "pi" is 0.

        >>> [round(float(end), 2) for end in PI.feasible_phase_margin(115.7315, 474.9727, 100.0)]
        [2.35, 92.35]
        """
        low, high = feasible_phase_margin(mass, viscous, crossover)
        return low, high if self.form == "ip" else high + low

    def binding_limit(self, phase_margin_deg: float) -> str:
        """Return which end of the feasible range a phase margin [deg] outside it violates."""
        if self.form == "pi" and phase_margin_deg >= 90.0:
            return "the upper limit binds: at 90 deg + atan(F_v/(M w)) there is no integral action"
        return binding_limit(phase_margin_deg)

    def gains(self, mass: Any, viscous: Any, crossover: Any, phase_margin_deg: Any) -> tuple[Any, Any]:
        """K = k_v1 G_tau [N/(m/s)] and t_v [s] for crossover [rad/s] and phase margin of T_vo; positive or not."""
        if self.form == "ip":
            return plant_input_gain(mass, viscous, crossover, phase_margin_deg)
        phase = np.radians(phase_margin_deg)
        gain = mass * crossover * np.sin(phase) - viscous * np.cos(phase)
        return gain, gain / (crossover * (mass * crossover * np.cos(phase) + viscous * np.sin(phase)))

    def bandwidth(self, omega_0v: Any, z_v: Any, t_v: Any) -> Any:
        """Frequency [rad/s] where T_vc has fallen to -3 dB; ``omega_0v`` and ``z_v`` of (9)."""
        return second_order_bandwidth(omega_0v, z_v, self.zero(t_v))

    def crossover_of_bandwidth(self, mass: float, viscous: float, bandwidth: Any, phase_margin_deg: Any) -> Any:
        """Crossover [rad/s] of the loop with that -3 dB ``bandwidth`` [rad/s]; NaN if there are no such gains.

        >>> w = PI.crossover_of_bandwidth(2.0, 1.0, 50.0, 60.0)
        >>> K, t_v = PI.gains(2.0, 1.0, w, 60.0)
        >>> L = K * (1 + 1 / (t_v * 50j)) / (2.0 * 50j + 1.0)
        >>> round(float(abs(L / (1 + L))), 6)  # 10^(-3/20)
        0.707946
        """
        if self.form == "ip":
            return crossover_of_bandwidth(bandwidth, phase_margin_deg)
        f, phase = np.broadcast_arrays(viscous / mass / np.asarray(bandwidth, float), np.radians(phase_margin_deg))
        relative = self._crossover(f.ravel(), phase.ravel()).reshape(f.shape)
        return (relative * bandwidth)[()]

    def _crossover(self, f: np.ndarray, phase: np.ndarray) -> np.ndarray:
        """Crossovers (n,) in units of the bandwidth, the lowest of several; ``f`` (n,) is F_v/M in the same units."""
        s, c = np.sin(phase), np.cos(phase)
        power, ahead = MINUS_3_DB**-2, 0.0 if self.reference_filter else MINUS_3_DB**-2
        # power K_v^2 + ahead K^2 = (K_v - 1)^2 + (f + K)^2, over M, with K = s w - f c and K_v = c w^2 + f s w
        powers_of_w = (
            (power - 1.0) * c * c,
            2.0 * (power - 1.0) * c * f * s,
            (power - 1.0) * f * f * s * s + 2.0 * c + (ahead - 1.0) * s * s,
            2.0 * f * s * c * (1.0 - ahead),
            -1.0 + ahead * f * f * c * c - f * f * (1.0 - c) ** 2,
        )
        companion = np.tile(np.eye(4, k=-1), (f.size, 1, 1))
        companion[:, 0] = -np.stack(powers_of_w[1:], axis=-1) / powers_of_w[0][:, None]
        roots, f, s, c = np.linalg.eigvals(companion), f[:, None], s[:, None], c[:, None]
        real = roots.real
        good = (np.abs(roots.imag) < 1e-9 * np.abs(roots)) & (real > 0.0) & (s * real > f * c) & (c * real > -f * s)
        lowest = np.min(np.where(good, real, np.inf), axis=-1)
        return np.where(np.isfinite(lowest), lowest, np.nan)


IP, PI, PI_WITH_REFERENCE_FILTER = Structure(), Structure("pi"), Structure("pi", True)
STRUCTURES = (IP, PI, PI_WITH_REFERENCE_FILTER)


@dataclass(frozen=True)
class VelocityLoopSweep:
    """Arrays of one shape, NaN where no gains exist; units as in the scalar design.

    ``k_v1`` [V/(m/s)], ``t_v`` [s], ``K_v`` [N/m], ``omega_0v`` [rad/s], ``z_v``, ``bandwidth`` [rad/s] of T_vc;
    ``plant_input_phase_margin_deg`` [deg], ``plant_input_crossover`` [rad/s] and ``delay_margin`` [s] of the continuous
    loop broken at the plant input; ``feasible`` is True where gains exist.
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

    The two broadcast. An infeasible pair gives NaN and ``feasible`` False. Raises :class:`InputError` for crossovers
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


def filter_from_text(text: str) -> cascade.Filter | str:
    """A command filter from its text, such as "notch:48Hz"; "none" is returned as such.

    >>> filter_from_text("notch:48Hz:0.6:0.2").depth, filter_from_text("none")
    (0.2, 'none')
    """
    if text == NO_FILTER:
        return text
    kind, *numbers = text.split(":")
    if kind not in ("lowpass", "notch") or not numbers or len(numbers) not in ((1,) if kind == "lowpass" else (1, 3)):
        raise InputError(f"found {text!r}, expected {FILTER_TEXTS}")
    frequency, *shape = numbers
    try:
        more = dict(zip(NOTCH, map(float, shape), strict=True)) if shape else NOTCH if kind == "notch" else {}
        return cascade.Filter(kind=kind, frequency=read_frequency(frequency, "Hz"), **more)
    except ValidationError as error:
        problem = error.errors(include_url=False)[0]
        name = ".".join(map(str, problem["loc"]))
        raise InputError(f"{text}: {name}: found {problem['input']}, {problem['msg'].lower()}") from error
    except ValueError as error:
        raise InputError(f"found {text!r}, expected {FILTER_TEXTS}") from error


def own_structure(axis: Axis, structure: Structure | str | None = None) -> Structure:
    """Return ``structure``, also given by name; if None that of the controller of ``axis``, IP except for a cascade.

    >>> from emps_design.machines import machine
    >>> own_structure(machine("emps2018"), "pi").label, own_structure(machine("emps2018")).label
    ('PI', 'IP')
    """
    if isinstance(structure, str):
        return Structure(structure)
    table = _cascade(axis) if structure is None else None
    return structure or (Structure(table.velocity.form) if table else IP)


def own_filters(axis: Axis, filters: Sequence[cascade.Filter | str] | None = None) -> tuple[cascade.Filter, ...]:
    """Return ``filters``, also given as text such as "notch:48Hz"; if None those of the controller of ``axis``.

    >>> from emps_design.machines import machine
    >>> [stage.frequency for stage in own_filters(machine("emps2018"), ["notch:48Hz", "lowpass:350Hz"])]
    [48.0, 350.0]
    """
    if filters is None:
        table = _cascade(axis)
        return table.filters if table else ()
    read = [filter_from_text(stage) if isinstance(stage, str) else stage for stage in filters]
    return tuple(stage for stage in read if isinstance(stage, cascade.Filter))


def own_gains(axis: Axis) -> tuple[float, float] | None:
    """k_v1 [V/(m/s)] and t_v [s] of the velocity loop of the controller of ``axis``; None if it has none."""
    table = _cascade(axis)
    k_v1, t_v = (table.velocity.kp, table.velocity.ti) if table else (axis.controller.k_v1, axis.controller.t_v)
    return None if k_v1 is None or t_v is None else (k_v1, t_v)


def _cascade(axis: Axis) -> cascade.Table | None:
    """The cascade controller of ``axis``, None if it has another one."""
    table = table_of(axis) if axis.controller.kind == cascade.LAW.name else None
    return table if isinstance(table, cascade.Table) else None
