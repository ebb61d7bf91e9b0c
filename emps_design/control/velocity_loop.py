"""The velocity loop of Fig. 4: integral of the velocity error, proportional on the measured velocity, (6) to (9).

With K = k_v1 G_tau and K_v = K / t_v,

    T_vo(s) = K_v / (s (M s + F_v + K))               loop broken at the velocity error, (6)
    T_vc(s) = 1 / (1 + (t_v + F_v/K_v) s + M/K_v s^2)  closed loop, (8)
    L(s)    = K (1 + 1/(t_v s)) / (M s + F_v)          loop broken at the plant input

What destabilises a real drive (delay, current loop, sampling) sits at the plant input, so margins are given there too.
Two frequencies are called bandwidth: the crossover w_v of T_vo and the -3 dB frequency of T_vc; here ``crossover`` is
the former and ``bandwidth`` the latter, with -3 dB taken as the ratio 10^(-3/20).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

from emps_design.axis import Axis
from emps_design.control.margins import Margins
from emps_design.errors import InputError, SpecificationError

if TYPE_CHECKING:
    import control

    from emps_design.control.sampled import SampledVelocityLoop

MINUS_3_DB = 10.0 ** (-3.0 / 20.0)


def feasible_phase_margin(mass: float, viscous: float, crossover: float) -> tuple[float, float]:
    """Return the open interval of phase margins [deg] that (7) can give at ``crossover`` [rad/s].

    Below atan(F_v / (M w)) the gain k_v1 would be negative, at 90 deg infinite. ``mass`` [kg], ``viscous`` [N/(m/s)].

    >>> low, high = feasible_phase_margin(115.7315, 474.9727, 100.0)
    >>> round(low, 3), high
    (2.35, 90.0)
    """
    return math.degrees(math.atan2(viscous, mass * crossover)), 90.0


def velocity_gains(
    mass: float, viscous: float, force_gain: float, crossover: float, phase_margin_deg: float
) -> tuple[float, float]:
    """Return k_v1 [V/(m/s)] and t_v [s] that put the crossover and the phase margin of T_vo where asked, (7).

    ``mass`` [kg], ``viscous`` [N/(m/s)], ``force_gain`` [N/V], ``crossover`` [rad/s], ``phase_margin_deg`` [deg]
    inside :func:`feasible_phase_margin`; :class:`SpecificationError` outside.

    >>> k_v1, t_v = velocity_gains(115.7315, 474.9727, 35.15, 100.0, 60.0)
    >>> round(k_v1, 3), round(t_v, 8)
    (556.766, 0.00845505)
    """
    low, high = feasible_phase_margin(mass, viscous, crossover)
    if not low < phase_margin_deg < high:
        raise _infeasible(mass, viscous, crossover, phase_margin_deg)
    phase = math.radians(phase_margin_deg)
    k_v1 = (mass * crossover * math.tan(phase) - viscous) / force_gain
    return k_v1, k_v1 * force_gain * math.cos(phase) / (mass * crossover**2)


def canonical_form(crossover: float, phase_margin_deg: float) -> tuple[float, float]:
    """Return omega_0v [rad/s] and z_v [-] of (9); they depend on the specification alone, not on the machine.

    >>> w0, z = canonical_form(100.0, 60.0)
    >>> round(w0, 2), round(z, 5)
    (141.42, 0.61237)
    """
    phase = math.radians(phase_margin_deg)
    return crossover / math.sqrt(math.cos(phase)), math.sin(phase) / (2.0 * math.sqrt(math.cos(phase)))


def second_order_bandwidth(omega_0v: float, z_v: float) -> float:
    """Return the frequency [rad/s] where (9) has fallen to -3 dB, the ratio 10^(-3/20).

    >>> round(second_order_bandwidth(*canonical_form(100.0, 60.0)), 2)
    159.9
    """
    slope = 1.0 - 2.0 * z_v**2
    root = math.sqrt(slope**2 + MINUS_3_DB**-2 - 1.0)
    # Two ways to write the positive root; each keeps its digits on its side.
    x = slope + root if slope >= 0.0 else (MINUS_3_DB**-2 - 1.0) / (root - slope)
    return omega_0v * math.sqrt(x)


def crossover_of_bandwidth(bandwidth: float, phase_margin_deg: float) -> float:
    """Return the crossover [rad/s] whose closed loop has the -3 dB ``bandwidth`` [rad/s] at that phase margin.

    >>> round(crossover_of_bandwidth(159.898, 60.0), 2)
    100.0
    """
    return bandwidth / second_order_bandwidth(*canonical_form(1.0, phase_margin_deg))


@dataclass(frozen=True)
class VelocityLoopDesign:
    """Gains of the velocity loop, what was asked, and what is achieved at each place where the loop can be broken.

    ``k_v1`` [V/(m/s)], ``t_v`` [s]; ``requested`` holds the specification as given; ``retuned`` says that the gains
    come from the sampled loop instead of (7); ``velocity`` [m/s] is where the effects of the axis are linearised.

    >>> from emps_design.machines import machine
    >>> design = design_velocity_loop(machine("emps2018"), crossover=100.0, phase_margin_deg=60.0)
    >>> round(design.k_v1, 3), round(design.bandwidth, 2), round(design.plant_input.phase_margin_deg, 1)
    (556.766, 159.9, 60.2)
    >>> round(design.sampled.margins.phase_margin_deg, 1)
    39.2
    """

    axis: Axis
    k_v1: float
    t_v: float
    requested: dict[str, float]
    retuned: bool = False
    velocity: float = 0.1

    @property
    def gain(self) -> float:
        """K = k_v1 G_tau [N/(m/s)]."""
        return self.k_v1 * self.axis.drive.force_gain

    @property
    def K_v(self) -> float:
        """K_v = k_v1 G_tau / t_v [N/m], of (8)."""
        return self.gain / self.t_v

    @property
    def omega_0v(self) -> float:
        """Natural frequency of the closed loop [rad/s], of (9)."""
        return math.sqrt(self.K_v / self.axis.mechanics.mass)

    @property
    def z_v(self) -> float:
        """Damping ratio of the closed loop [-], of (9)."""
        return 0.5 * (self.t_v + self.axis.mechanics.viscous / self.K_v) * self.omega_0v

    @property
    def bandwidth(self) -> float:
        """Frequency where T_vc has fallen to -3 dB [rad/s]."""
        return second_order_bandwidth(self.omega_0v, self.z_v)

    @cached_property
    def velocity_error(self) -> Margins:
        """Margins of T_vo, the loop broken at the velocity error: phi_v and w_v of (7), read back from the gains."""
        mass, damping = self.axis.mechanics.mass, self.axis.mechanics.viscous + self.gain
        x = _positive_root(mass**2, damping**2, -(self.K_v**2))
        return _continuous_margins(math.sqrt(x), math.atan2(damping, mass * math.sqrt(x)))

    @cached_property
    def plant_input(self) -> Margins:
        """Margins of the loop broken at the plant input, continuous and without any delay."""
        mass, viscous = self.axis.mechanics.mass, self.axis.mechanics.viscous
        w = math.sqrt(_positive_root(mass**2, viscous**2 - self.gain**2, -(self.K_v**2)))
        return _continuous_margins(w, math.atan(w * self.t_v) + math.atan2(viscous, mass * w))

    @property
    def crossover(self) -> float:
        """Crossover of T_vo [rad/s], achieved."""
        return float(self.velocity_error.crossover)

    @property
    def phase_margin_deg(self) -> float:
        """Phase margin of T_vo [deg], achieved."""
        return float(self.velocity_error.phase_margin_deg)

    @property
    def feasible_phase_margin_deg(self) -> tuple[float, float]:
        """Open interval of phase margins [deg] that (7) can give at the crossover asked for."""
        mechanics = self.axis.mechanics
        return feasible_phase_margin(mechanics.mass, mechanics.viscous, self.requested.get("crossover", self.crossover))

    @cached_property
    def sampled(self) -> SampledVelocityLoop:
        """The same gains in the loop as implemented: hold, delays, current loop, effects, velocity estimator."""
        from emps_design.control.discretisation import sample_axis
        from emps_design.control.sampled import SampledVelocityLoop

        return SampledVelocityLoop(sample_axis(self.axis, self.velocity), self.k_v1, self.t_v)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What a reader of the numbers has to know, instability first."""
        said = [*self.sampled.warnings]
        if self.requested.get("bandwidth") is None and self.bandwidth > 1.05 * self.crossover:
            said.append(
                f"bandwidth has two meanings: the crossover is {self.crossover:.4g} rad/s, "
                f"the closed loop's -3 dB lies at {self.bandwidth:.4g} rad/s"
            )
        said.append("the continuous loop's gain margin is unbounded: its phase never reaches -180 deg")
        return tuple(said)

    def velocity_error_loop(self) -> control.TransferFunction:
        """T_vo(s) of (6)."""
        import control

        mechanics = self.axis.mechanics
        return control.tf([self.K_v], [mechanics.mass, mechanics.viscous + self.gain, 0.0])

    def plant_input_loop(self) -> control.TransferFunction:
        """L(s), the loop broken at the plant input."""
        import control

        mechanics = self.axis.mechanics
        return control.tf([self.gain, self.K_v], [mechanics.mass, mechanics.viscous, 0.0])

    def closed_loop(self) -> control.TransferFunction:
        """T_vc(s) of (8), from velocity reference to velocity."""
        import control

        mechanics = self.axis.mechanics
        return control.tf([1.0], [mechanics.mass / self.K_v, self.t_v + mechanics.viscous / self.K_v, 1.0])

    def controller_table(self) -> dict[str, Any]:
        """The ``[controller]`` table of the axis file that runs this design."""
        return {
            "kind": "ip_velocity",
            "k_v1": self.k_v1,
            "t_v": self.t_v,
            "velocity_estimator": self.axis.controller.velocity_estimator,
        }

    def to_dict(self) -> dict[str, Any]:
        """Plain data with the keys of the contract."""
        sampled = self.sampled.to_dict()
        return {
            "axis": self.axis.name,
            "requested": dict(self.requested),
            "retuned": self.retuned,
            "k_v1": self.k_v1,
            "t_v": self.t_v,
            "K_v": self.K_v,
            "omega_0v": self.omega_0v,
            "z_v": self.z_v,
            "crossover": self.crossover,
            "phase_margin_deg": self.phase_margin_deg,
            "bandwidth": self.bandwidth,
            "feasible_phase_margin_deg": list(self.feasible_phase_margin_deg),
            "velocity_error": self.velocity_error.to_dict(),
            "plant_input": self.plant_input.to_dict(),
            "sampled": sampled,
            "warnings": list(self.warnings),
        }


def design_velocity_loop(
    axis: Axis,
    crossover: float | None = None,
    bandwidth: float | None = None,
    phase_margin_deg: float = 60.0,
    velocity: float = 0.1,
) -> VelocityLoopDesign:
    """Return the velocity loop of ``axis`` that meets a specification, by (7).

    Give ``crossover`` [rad/s] of T_vo or ``bandwidth`` [rad/s], the -3 dB of T_vc, not both; ``phase_margin_deg`` is
    that of T_vo. ``velocity`` [m/s]: where the effects of the axis are linearised for the sampled loop.
    Raises :class:`InputError` for a specification that cannot be meant, :class:`SpecificationError` for one that no
    gains can meet, with the nearest pair that works.

    >>> from emps_design.machines import machine
    >>> by_bandwidth = design_velocity_loop(machine("emps2018"), bandwidth=159.898, phase_margin_deg=60.0)
    >>> round(by_bandwidth.crossover, 2)
    100.0
    """
    requested = check_specification(crossover, bandwidth, phase_margin_deg)
    mechanics, drive = axis.mechanics, axis.drive
    if crossover is None:
        if not 0.0 < phase_margin_deg < 90.0:
            raise _infeasible(mechanics.mass, mechanics.viscous, float(bandwidth), phase_margin_deg, "bandwidth")
        crossover = crossover_of_bandwidth(float(bandwidth), phase_margin_deg)
    low, high = feasible_phase_margin(mechanics.mass, mechanics.viscous, crossover)
    if "bandwidth" in requested and not low < phase_margin_deg < high:
        raise _infeasible(mechanics.mass, mechanics.viscous, requested["bandwidth"], phase_margin_deg, "bandwidth")
    k_v1, t_v = velocity_gains(mechanics.mass, mechanics.viscous, drive.force_gain, crossover, phase_margin_deg)
    return VelocityLoopDesign(axis, k_v1, t_v, requested, velocity=velocity)


def check_specification(crossover: float | None, bandwidth: float | None, phase_margin_deg: float) -> dict[str, float]:
    """Return the specification as a dict of what was given, or raise :class:`InputError`."""
    if (crossover is None) == (bandwidth is None):
        found = "neither" if crossover is None else "both"
        raise InputError(f"specification: found {found} of crossover and bandwidth, expected exactly one [rad/s]")
    name, value = ("crossover", crossover) if crossover is not None else ("bandwidth", bandwidth)
    if not math.isfinite(value) or value <= 0.0:
        raise InputError(f"{name}: found {value:g} rad/s, expected a positive number of rad/s")
    if not math.isfinite(phase_margin_deg):
        raise InputError(f"phase margin: found {phase_margin_deg:g} deg, expected a number of degrees between 0 and 90")
    return {name: float(value), "phase_margin_deg": float(phase_margin_deg)}


def _positive_root(a: float, b: float, c: float) -> float:
    """The positive root of a x^2 + b x + c = 0 with a > 0 > c, without cancellation."""
    root = math.sqrt(b * b - 4.0 * a * c)
    return 2.0 * -c / (b + root) if b >= 0.0 else (root - b) / (2.0 * a)


def _continuous_margins(crossover: float, phase: float) -> Margins:
    return Margins(
        stable=True, phase_margin_deg=math.degrees(phase), crossover=crossover, delay_margin=phase / crossover
    )


def _infeasible(
    mass: float, viscous: float, frequency: float, phase_margin_deg: float, name: str = "crossover"
) -> SpecificationError:
    """The error for a pair outside the feasible range: which limit binds, and the nearest pair that works."""

    def lowest(w: float, phase: float) -> bool:
        crossover = w if name == "crossover" else crossover_of_bandwidth(w, phase)
        return feasible_phase_margin(mass, viscous, crossover)[0] < phase

    low = next((phase for phase in (0.1 * n for n in range(1, 900)) if lowest(frequency, phase)), 89.9)
    nearest: dict[str, Any] = {name: frequency}
    if phase_margin_deg >= 90.0:
        nearest["phase_margin_deg"] = 89.0
        limit = "the upper limit binds: at 90 deg k_v1 is infinite"
    else:
        nearest["phase_margin_deg"] = round(low, 1)
        limit = (
            f"the lower limit binds: below atan(F_v/(M w)) = {math.degrees(math.atan2(viscous, mass * frequency)):.4g}"
            " deg k_v1 is not positive"
            if name == "crossover"
            else "the lower limit binds: below atan(F_v/(M w)) k_v1 is not positive"
        )
    if 0.0 < phase_margin_deg < 90.0:
        scale = viscous / (mass * math.tan(math.radians(phase_margin_deg)))
        if name == "bandwidth":
            scale /= crossover_of_bandwidth(1.0, phase_margin_deg)
        nearest["or"] = {name: 1.01 * scale, "phase_margin_deg": phase_margin_deg}
    return SpecificationError(
        f"phase margin: found {phase_margin_deg:g} deg at {name} {frequency:g} rad/s; {limit}; "
        f"nearest that works: {nearest['phase_margin_deg']:g} deg at {frequency:g} rad/s",
        nearest,
    )
