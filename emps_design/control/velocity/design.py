"""The velocity loop of Fig. 4: integral of the velocity error, proportional on the measured velocity, (6) to (9).

With K = k_v1 G_tau and K_v = K / t_v,

    T_vo(s) = K_v / (s (M s + F_v + K))               loop broken at the velocity error, (6)
    T_vc(s) = 1 / (1 + (t_v + F_v/K_v) s + M/K_v s^2)  closed loop, (8)
    L(s)    = K (1 + 1/(t_v s)) / (M s + F_v)          loop broken at the plant input

Delay, current loop and sampling, which destabilise a real drive, act at the plant input, so margins are given there
too. Two frequencies are called bandwidth: the crossover w_v of T_vo and the -3 dB frequency of T_vc; here ``crossover``
is the former and ``bandwidth`` the latter, with -3 dB as the ratio 10^(-3/20).

The design includes the difference equation, the largest velocity step below the voltage limit, and the encoder noise.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from emps_design.axis import Axis, Controller
from emps_design.control.discretisation import sample_axis
from emps_design.control.linear_plant import ActuatorMap
from emps_design.control.margins import LOOP_NAMES, Margins
from emps_design.control.sampled import NestedLoop, nested_loops
from emps_design.control.velocity.gains import (
    IP,
    Structure,
    own_filters,
    own_structure,
    positive_root,
    second_order_form,
)
from emps_design.control.velocity.sampled import LaggedVelocityLoop, SampledVelocityLoop, left_out, velocity_table
from emps_design.control.velocity.specification import (
    Pairs,
    check_specification,
    effects_in_words,
    ideal_loop_in_words,
    infeasible,
    law_in_words,
    nearest_that_works,
    pairs_by_closed_form,
    proposal_in_words,
    room_in_words,
)
from emps_design.control.view import velocity_loop_view
from emps_design.laws import LawKind, LawTable
from emps_design.laws.estimators import estimator_response, polynomials
from emps_design.laws.library import cascade
from emps_design.laws.library.cascade import Filter, filter_polynomials
from emps_design.messages import Message, note
from emps_design.request import typed
from emps_design.view import View, Viewed

if TYPE_CHECKING:
    import control


CONSTANT = 1e-9  # a pole closer than this to the unit circle counts as one at z = 1


@dataclass(frozen=True)
class DifferenceEquation:
    """The velocity law at each sample, as text for the drive: ``kind`` and ``table`` of the law on ``axis``."""

    axis: Axis
    kind: LawKind[Axis]
    table: LawTable
    k_v1: float
    t_v: float

    @property
    def lines(self) -> tuple[str, ...]:
        """One assignment per line, with anti-windup at the limit of u."""
        return self.kind.equations(self.table, self.axis, self.axis.sampling.period)

    def to_dict(self) -> dict[str, Any]:
        """The lines and their numbers; integral_gain is k_v1 T / t_v [V/(m/s)]."""
        period = self.axis.sampling.period
        return {
            "lines": list(self.lines),
            "k_v1": self.k_v1,
            "integral_gain": self.k_v1 * period / self.t_v,
            "period": period,
            "velocity_estimator": self.table.model_dump(exclude_none=True)["velocity_estimator"],
            "voltage_limit": self.axis.drive.command_limit,
        }


def difference_equation(
    axis: Axis, k_v1: float, t_v: float, structure: Structure = IP, filters: tuple[Filter, ...] = ()
) -> DifferenceEquation:
    """Return the law of the loop with ``k_v1`` [V/(m/s)] and ``t_v`` [s] at the period of ``axis``.

    >>> from emps_design.machines import machine
    >>> print(difference_equation(machine("emps2018"), 556.766, 8.45505e-3).lines[1])
    i[k] = i[k-1] + 65.85011325 * (v_ref[k] - v[k])
    """
    kind, table = velocity_table(k_v1, t_v, structure, filters, axis.controller.velocity_estimator)
    return DifferenceEquation(axis, kind, table, k_v1, t_v)


def largest_velocity_step(axis: Axis, loop: SampledVelocityLoop) -> dict[str, float]:
    """Return the largest step of the velocity reference [m/s] from rest that keeps the voltage within its limit.

    The peak voltage is that of the sampled linear loop [V per m/s] plus the voltage for dry friction and the constant
    force in the worse direction [V]; with a saturation or a dead zone the limit is the largest acting voltage.
    ``window`` [s] is the simulated time until the transient has decayed; with a spring the voltage rises further with
    the travel. ``loop`` must be stable.

    >>> from emps_design.control.discretisation import sample_axis
    >>> from emps_design.machines import machine
    >>> axis = machine("emps2018")
    >>> step = largest_velocity_step(axis, SampledVelocityLoop(sample_axis(axis), 556.766, 8.45505e-3))
    >>> round(step["value"], 4), round(step["dry_friction_voltage"], 3)
    (0.0319, 0.494)
    """
    sizes = np.abs(loop.poles)
    decaying = sizes[
        sizes < 1.0 - CONSTANT
    ]  # a pole at z = 1 (of a spring, or of a load within its play) does not decay
    slowest = float(np.max(decaying, initial=1e-3))
    samples = 10 + math.ceil(math.log(1e-4) / math.log(slowest))
    _, _, voltage = loop.step_response(samples)
    peak = float(np.max(np.abs(voltage)))
    dry = (axis.mechanics.coulomb + abs(axis.mechanics.offset)) / axis.drive.gain
    actuator = ActuatorMap.of(axis)
    largest = min(abs(actuator.command(actuator.acting(side * axis.drive.command_limit))) for side in (1.0, -1.0))
    needed = max(abs(actuator.command(side * dry)) for side in (1.0, -1.0))
    return {
        "value": max(0.0, largest - needed) / peak,
        "peak_voltage_per_unit": peak,
        "dry_friction_voltage": dry,
        "voltage_limit": largest,
        "window": samples * loop.plant.period,
    }


def command_in_a_step(axis: Axis, loop: SampledVelocityLoop, velocity: float) -> float:
    """Largest command [V], including dry friction, in a step of the reference by ``velocity`` [m/s].

    It covers the first two periods of the crossover frequency. ``loop`` must be stable.
    """
    samples = max(20, round(4.0 * math.pi / ((loop.margins.crossover or 1.0) * loop.plant.period)))
    dry = (axis.mechanics.coulomb + abs(axis.mechanics.offset)) / axis.drive.gain
    return dry + velocity * float(np.max(np.abs(loop.step_response(samples)[2])))


def encoder_voltage_noise(axis: Axis, loop: SampledVelocityLoop) -> dict[str, float]:
    """Return the voltage [V] due to the encoder's quantisation: ``rms`` in closed loop, and for one encoder step.

    Quantisation counts as white noise of variance resolution^2/12, which is valid in motion; ``one_step`` is the jump
    of u when the reading changes by one step. ``loop`` must be stable.

    >>> from emps_design.control.discretisation import sample_axis
    >>> from emps_design.machines import machine
    >>> axis = machine("emps2018")
    >>> noise = encoder_voltage_noise(axis, SampledVelocityLoop(sample_axis(axis), 556.766, 8.45505e-3))
    >>> round(1e3 * noise["rms"], 2), round(1e3 * noise["one_step"], 2)  # mV
    (6.44, 15.57)
    """
    plant, resolution = loop.plant, axis.sampling.encoder_resolution
    count = 1 << 14
    w = (np.arange(count) + 0.5) * math.pi / (count * plant.period)
    back = np.exp(-1j * w * plant.period)
    estimate = estimator_response(plant.estimator, w, plant.period) * (1.0 - back) / plant.period
    law = loop.controller_response(w) * plant.filter_response(w)
    noise = law * estimate / (1.0 + loop.plant_input_response(w))
    rms = resolution / math.sqrt(12.0) * math.sqrt(float(np.mean(np.abs(noise) ** 2)))
    first = math.prod(
        filter_polynomials(section, plant.period)[0][0] for section in plant.filters
    )  # what passes at once
    newest = polynomials(plant.estimator, plant.period)[0][0]
    one_step = first * loop.k_v1 * (1.0 + plant.period / loop.t_v) * newest / plant.period * resolution
    return {"rms": rms, "one_step": one_step, "resolution": resolution}


@dataclass(frozen=True)
class VelocityLoopDesign(Viewed):
    """Gains of the velocity loop, the specification, and the margins at each place where the loop can be broken.

    ``k_v1`` [V/(m/s)], ``t_v`` [s]; ``requested`` is the specification; ``retuned_at`` is the place at which the
    sampled loop meets it, "" for gains from (7); the effects of the axis are linearised at ``velocity`` [m/s].
    ``structure`` is IP or PI; only the sampled loop includes the ``filters`` at the law's output.

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
    retuned_at: str = ""
    velocity: float = 0.1
    structure: Structure = IP
    filters: tuple[Filter, ...] = ()

    @property
    def gain(self) -> float:
        """K = k_v1 G_tau [N/(m/s)]."""
        return self.k_v1 * self.axis.drive.gain

    @property
    def K_v(self) -> float:
        """K_v = k_v1 G_tau / t_v [N/m], of (8)."""
        return self.gain / self.t_v

    @property
    def omega_0v(self) -> float:
        """Natural frequency of the closed loop [rad/s], of (9)."""
        return self._second_order_form[0]

    @property
    def z_v(self) -> float:
        """Damping ratio of the closed loop [-], of (9)."""
        return self._second_order_form[1]

    @property
    def _second_order_form(self) -> tuple[float, float]:
        omega_0v, z_v = second_order_form(self.axis.mechanics.mass, self.axis.damping, self.gain, self.t_v)
        return float(omega_0v), float(z_v)

    @property
    def bandwidth(self) -> float:
        """Frequency where T_vc has fallen to -3 dB [rad/s]."""
        return float(self.structure.bandwidth(self.omega_0v, self.z_v, self.t_v))

    @cached_property
    def velocity_error(self) -> Margins:
        """Margins of T_vo, the loop broken at the velocity error: phi_v and w_v of (7), computed from the gains."""
        return _continuous_margins(*self._velocity_error)

    @cached_property
    def _velocity_error(self) -> tuple[float, float]:
        """Crossover [rad/s] and phase margin [rad] of T_vo."""
        if self.structure.form == "pi":
            return self._plant_input
        mass, damping = self.axis.mechanics.mass, self.axis.damping + self.gain
        w = math.sqrt(positive_root(mass**2, damping**2, -(self.K_v**2)))
        return w, math.atan2(damping, mass * w)

    @cached_property
    def plant_input(self) -> Margins:
        """Margins of the loop broken at the plant input, continuous and without any delay."""
        return _continuous_margins(*self._plant_input)

    @cached_property
    def _plant_input(self) -> tuple[float, float]:
        """Crossover [rad/s] and phase margin [rad] of L."""
        mass, viscous = self.axis.mechanics.mass, self.axis.damping
        w = math.sqrt(positive_root(mass**2, viscous**2 - self.gain**2, -(self.K_v**2)))
        return w, math.atan(w * self.t_v) + math.atan2(viscous, mass * w)

    @property
    def crossover(self) -> float:
        """Achieved crossover of T_vo [rad/s]."""
        return self._velocity_error[0]

    @property
    def phase_margin_deg(self) -> float:
        """Achieved phase margin of T_vo [deg]."""
        return math.degrees(self._velocity_error[1])

    @property
    def feasible_phase_margin_deg(self) -> tuple[float, float]:
        """Open interval of feasible phase margins [deg] at the requested crossover, by the closed form."""
        axis, crossover = self.axis, self.requested.get("crossover", self.crossover)
        low, high = self.structure.feasible_phase_margin(axis.mechanics.mass, axis.damping, crossover)
        return float(low), float(high)

    @cached_property
    def with_lags(self) -> LaggedVelocityLoop:
        """The continuous loop with these gains and all lags of the axis."""
        return LaggedVelocityLoop.of(self.axis, self.velocity, self.k_v1, self.t_v, self.structure, self.filters)

    @property
    def left_out(self) -> tuple[str, ...]:
        """What the closed forms of ``velocity_error`` and ``plant_input`` neglect in addition to the sampling."""
        return left_out(self.axis, self.filters)

    @cached_property
    def sampled(self) -> SampledVelocityLoop:
        """The sampled loop with these gains, hold, delays, current loop, effects and velocity estimator."""
        plant = sample_axis(self.axis, self.velocity, self.filters)
        return SampledVelocityLoop(plant, self.k_v1, self.t_v, self.structure)

    @property
    def warnings(self) -> tuple[Message, ...]:
        """Messages on the design, instability first."""
        warnings = [*self.sampled.warnings, *room_in_words(self.sampled)]
        warnings += effects_in_words(self.axis, self.sampled, self.velocity)
        warnings += law_in_words(self.sampled, not self.retuned_at)
        if self.retuned_at:
            request = ", ".join(
                f"{key.removesuffix('_deg').replace('_', ' ')} {value:g} {'deg' if key.endswith('_deg') else 'rad/s'}"
                for key, value in self.requested.items()
            )
            text = (
                f"retuned: the sampled loop meets the request at the {self.retuned_at.replace('-', ' ')} ({request}); "
                "crossover, phase margin and bandwidth of T_vo and T_vc are those of the continuous loop"
            )
            warnings.append(note("retuned", text))
        elif self.requested.get("bandwidth") is None and self.bandwidth > 1.05 * self.crossover:
            text = (
                f"bandwidth has two meanings: the crossover is {self.crossover:.4g} rad/s, the -3 dB frequency of the "
                f"closed loop is {self.bandwidth:.4g} rad/s"
            )
            warnings.append(note("two-bandwidths", text, crossover=self.crossover, bandwidth=self.bandwidth))
        warnings.append(ideal_loop_in_words(self.left_out, self.with_lags.velocity_error))
        return tuple(warnings)

    def velocity_error_loop(self) -> control.TransferFunction:
        """T_vo(s) of (6); for "pi" the loop at the plant input."""
        import control

        if self.structure.form == "pi":
            return self.plant_input_loop()

        names = {"inputs": ["velocity_error"], "outputs": ["velocity"], "name": "T_vo"}
        return control.tf([self.K_v], [self.axis.mechanics.mass, self.axis.damping + self.gain, 0.0], **names)

    def plant_input_loop(self) -> control.TransferFunction:
        """L(s), the loop broken at the plant input."""
        import control

        return control.tf([self.gain, self.K_v], [self.axis.mechanics.mass, self.axis.damping, 0.0], **LOOP_NAMES)

    def closed_loop(self) -> control.TransferFunction:
        """T_vc(s) of (8), from velocity reference to velocity, with the zero of the structure."""
        import control

        zero = self.structure.zero(self.t_v)
        return control.tf(
            [zero, 1.0] if zero else [1.0],
            [self.axis.mechanics.mass / self.K_v, self.t_v + self.axis.damping / self.K_v, 1.0],
            inputs=["velocity_reference"],
            outputs=["velocity"],
            name="T_vc",
        )

    @cached_property
    def nearest_stable(self) -> dict[str, Any]:
        """The nearest specification with a stable sampled loop; the requested one if it is stable."""
        if self.sampled.stable:
            return dict(self.requested)
        return nearest_that_works(self._pairs, self.requested)

    @property
    def nearest_in_words(self) -> str:
        """:attr:`nearest_stable` as text for a message, with its margins in the sampled loop."""
        return proposal_in_words(self.nearest_stable, self._pairs)

    @property
    def _pairs(self) -> Pairs:
        return pairs_by_closed_form(self.axis, self.requested, self.velocity, self.structure, self.filters)

    @property
    def reason(self) -> str:
        """The reason why the design must not run, in one line; empty if the sampled loop is stable."""
        if self.sampled.stable:
            return ""
        return (
            f"the sampled loop with these gains is unstable: its largest pole is {abs(self.sampled.poles[0]):.4g}; "
            f"{self.nearest_in_words}"
        )

    def controller_table(self) -> dict[str, Any]:
        """The ``[controller]`` table of the axis file for this design, with the outer loops of its cascade."""
        controller = self.axis.controller
        in_a_cascade = controller.kind == cascade.LAW.name
        kind, table = velocity_table(
            self.k_v1, self.t_v, self.structure, self.filters, controller.velocity_estimator, in_a_cascade
        )
        return {"kind": kind.name, **table.model_dump(exclude_none=True, exclude_unset=True)}

    @property
    def axis_that_runs(self) -> Axis:
        """The axis with this velocity loop in its controller, with the outer loops of its cascade."""
        return self.axis.replace(controller=self.controller_table())

    @cached_property
    def refused(self) -> str:
        """The reason why the whole controller must not run, in one line; empty if all its loops are stable."""
        loops = self.kept_loops
        if self.reason or not loops or loops[-1].margins.stable:
            return self.reason
        kp = self.axis.controller.parameters["position"]["kp"]
        return (
            f"the axis file's position loop with kp = {kp:g} is unstable around this velocity loop; expected a smaller "
            "kp, a faster velocity loop, or a position loop designed for this one"
        )

    @cached_property
    def kept_loops(self) -> tuple[NestedLoop, ...]:
        """The loops of the axis file's cascade with this velocity loop, the whole loop last; empty without a cascade.

        A position loop designed for a faster velocity loop may be unstable around this one.
        """
        controller = self.axis.controller
        has_position_loop = controller.kind == cascade.LAW.name and controller.parameters.get("position") is not None
        if not has_position_loop or not self.sampled.stable:
            return ()
        return nested_loops(self.axis_that_runs, self.velocity)

    @property
    def loop_axis(self) -> Axis:
        """The axis with only this velocity loop as its controller, without the outer loops of a cascade."""
        kind, table = velocity_table(
            self.k_v1, self.t_v, self.structure, self.filters, self.axis.controller.velocity_estimator
        )
        controller = {"kind": kind.name, **table.model_dump(exclude_none=True)}
        return self.axis.replace(controller=Controller.model_validate(controller))

    def to_dict(self) -> dict[str, Any]:
        """Plain data, SI units, angles in degrees."""
        stable = self.sampled.stable
        law = difference_equation(self.axis, self.k_v1, self.t_v, self.structure, self.filters)
        return {
            "axis": self.axis.name,
            "requested": dict(self.requested),
            "retuned": bool(self.retuned_at),
            "retuned_at": self.retuned_at or None,
            "structure": self.structure.form,
            "reference_filter": self.structure.reference_filter,
            "filters": [section.model_dump(exclude_none=True) for section in self.filters],
            "k_v1": self.k_v1,
            "t_v": self.t_v,
            "drive_names": {
                "kp": {"value": self.k_v1, "unit": self.axis.units.unit("V/(m/s)")},
                "Tn": {"value": 1e3 * self.t_v, "unit": "ms"},
            },
            "K_v": self.K_v,
            "omega_0v": self.omega_0v,
            "z_v": self.z_v,
            "crossover": self.crossover,
            "phase_margin_deg": self.phase_margin_deg,
            "bandwidth": self.bandwidth,
            "feasible_phase_margin_deg": list(self.feasible_phase_margin_deg),
            "velocity_error": self.velocity_error.to_dict(),
            "plant_input": self.plant_input.to_dict(),
            "continuous_with_lags": self.with_lags.velocity_error.to_dict(),
            "closed_forms_leave_out": ["the sampling", *self.left_out],
            "sampled": self.sampled.to_dict(),
            "difference_equation": law.to_dict(),
            "largest_velocity_step": largest_velocity_step(self.axis, self.sampled) if stable else None,
            "encoder_voltage_noise": encoder_voltage_noise(self.axis, self.sampled) if stable else None,
            "warnings": list(self.warnings),
        }

    def view(self) -> View:
        """The lines and tables on the velocity loop, as in the command ``gains``."""
        return velocity_loop_view(self.to_dict(), self.axis.units)


@typed
def design_velocity_loop(
    axis: Axis,
    crossover: float | None = None,
    bandwidth: float | None = None,
    phase_margin_deg: float = 60.0,
    velocity: float = 0.1,
    structure: Structure | str | None = None,
    filters: Sequence[Filter | str] | None = None,
) -> VelocityLoopDesign:
    """Return the velocity loop of ``axis`` that meets a specification, by (7) or its counterpart for "pi".

    Give ``crossover`` [rad/s] of T_vo or ``bandwidth`` [rad/s], the -3 dB frequency of T_vc, not both;
    ``phase_margin_deg`` is that of T_vo. For the sampled loop the effects of the axis are linearised at ``velocity``
    [m/s]. ``structure`` and ``filters`` default to those of the axis's controller. Raises :class:`InputError` for an
    invalid specification, :class:`SpecificationError` with the nearest pair that works if no gains can meet it.

    >>> from emps_design.machines import machine
    >>> by_bandwidth = design_velocity_loop(machine("emps2018"), bandwidth=159.898, phase_margin_deg=60.0)
    >>> round(by_bandwidth.crossover, 2)
    100.0
    """
    requested = check_specification(crossover, bandwidth, phase_margin_deg)
    structure, filters = own_structure(axis, structure), own_filters(axis, filters)
    mass, viscous, w = axis.mechanics.mass, axis.damping, float(crossover or math.nan)
    if bandwidth is not None and 0.0 < phase_margin_deg < structure.largest_phase_margin:
        w = float(structure.crossover_of_bandwidth(mass, viscous, bandwidth, phase_margin_deg))
    low, high = structure.feasible_phase_margin(mass, viscous, w)
    if not low < phase_margin_deg < high:
        raise infeasible(axis, requested, velocity, structure, filters)
    gain, t_v = structure.gains(mass, viscous, w, phase_margin_deg)
    k_v1 = float(gain) / axis.drive.gain
    return VelocityLoopDesign(
        axis, k_v1, float(t_v), requested, velocity=velocity, structure=structure, filters=filters
    )


def _continuous_margins(crossover: float, phase: float) -> Margins:
    return Margins(
        stable=True, phase_margin_deg=math.degrees(phase), crossover=crossover, delay_margin=phase / crossover
    )
