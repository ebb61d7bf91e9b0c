"""The numbers of the controls: label, range, step and default, scaled to the axis.

:data:`CHOICES` is for the embedded emps2018. For another axis masses scale with its load, forces with its friction or
motor, and frequencies with its sampling and current loop. A new session starts with a specification whose design meets
the default requirements.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import product
from typing import TYPE_CHECKING, Any

from emps_design.axis import NO_LIMIT, Axis
from emps_design.errors import EmpsError
from emps_design.machines import machine
from emps_design.quantities import one_two_five
from emps_design.units import TURN

if TYPE_CHECKING:
    from emps_design.control.velocity.design import VelocityLoopDesign

ANY_AXIS = 1e9  # largest ratio between the ranges of two axes

# Factors on the default frequency, slower ones first; the faster ones are for an axis with a position loop.
SHARES = (1.0, 0.5, 0.2, 0.1, 0.05, 2.0, 5.0)
PHASES = (60.0, 70.0, 80.0)  # deg


@dataclass(frozen=True)
class Choice:
    """A number of a control: label with unit, range, step of the control, and default value ``first``.

    ``size`` is the key of :func:`sizes` with which the number scales, "" if it is the same on every axis. A
    ``frequency`` is in rad/s; it may also be text with a unit, such as 30Hz.
    """

    label: str
    lower: float
    upper: float
    step: float
    first: float
    size: str = ""

    @property
    def frequency(self) -> bool:
        """Whether the unit is rad/s."""
        return self.label.endswith("[rad/s]")

    def holds(self, value: float) -> bool:
        """Whether ``value`` is within the range."""
        return self.lower <= value <= self.upper

    def with_value(self, value: float) -> Choice:
        """Return the choice with its range extended to ``value``."""
        return self if self.holds(value) else replace(self, lower=min(self.lower, value), upper=max(self.upper, value))

    def of_any_axis(self, value: Any) -> Choice:
        """Return the choice with its range extended to ``value`` if that is plausible on a smaller or larger axis."""
        number = isinstance(value, int | float) and not isinstance(value, bool)
        if self.size and number and self.lower / ANY_AXIS <= value <= self.upper * ANY_AXIS:
            return self.with_value(value)
        return self


CHOICES: dict[str, Choice] = {
    "frequency": Choice("Frequency [rad/s]", 5.0, 600.0, 1.0, 100.0, "frequency"),
    "phase_margin_deg": Choice("Phase margin [deg]", 1.0, 89.0, 0.5, 60.0),
    "period_ms": Choice("Sampling period [ms]", 0.1, 5.0, 0.1, 1.0, "period"),
    "computation_delay": Choice("Computation delay [samples]", 0, 5, 1, 0),
    "current_ms": Choice("Current loop [ms]", 0.0, 5.0, 0.05, 0.0, "current loop"),
    "k_e1": Choice("Force gain k_e1 [(m/s)/N]", 0.0005, 0.1, 0.0005, 0.01, "1/mass"),
    "hand": Choice("Viscous hand [N/(m/s)]", 0.0, 500.0, 5.0, 0.0, "mass"),
    "wall": Choice("Wall [N/mm]", 0.0, 200.0, 1.0, 10.0, "mass x frequency"),
    "mass": Choice("Apparent mass M_a [kg]", 1.0, 200.0, 1.0, 50.0, "mass"),
    "damping": Choice("Apparent damping B [N/(m/s)]", 0.0, 500.0, 5.0, 100.0, "mass"),
    "filter": Choice("Filter of the law [rad/s]", 10.0, 3000.0, 10.0, 500.0, "frequency"),
    "mismatch_percent": Choice("Mismatch [%]", 0.0, 20.0, 0.5, 2.0),
    "required_phase_deg": Choice("Required phase margin, sampled [deg]", 0.0, 80.0, 1.0, 30.0),
    "required_overshoot_percent": Choice("Allowed overshoot [%]", 0.0, 100.0, 1.0, 20.0),
    "push": Choice("Push [N]", 1.0, 500.0, 5.0, 40.0, "force"),
    "hand_stiffness": Choice("Hand stiffness [N/m]", 0.0, 20000.0, 100.0, 1000.0, "force/length"),
    "hand_damping": Choice("Hand damping [N/(m/s)]", 0.0, 2000.0, 10.0, 100.0, "force/length"),
    "stroke": Choice("Stroke [m]", 1e-6, 1000.0, 0.01, 0.24, "length"),
    "speed": Choice("Speed [m/s]", 1e-6, 1000.0, 0.01, 0.2, "speed"),
    "acceleration": Choice("Acceleration [m/s^2]", 1e-6, 1e6, 0.1, 1.0, "acceleration"),
    "pause": Choice("Pause [s]", 0.0, 100.0, 0.1, 0.1),
    "position_kp": Choice("Position gain kp [1/s]", 0.01, 10000.0, 1.0, 20.0, "frequency"),
    "plants": Choice("Random plants", 0, 10000, 100, 200),
    "seed": Choice("Seed", 0, 10**6, 1, 0),
}


def choices_of(axis: Axis) -> dict[str, Choice]:
    """Return :data:`CHOICES` scaled to ``axis``.

    >>> choices_of(machine("emps2018")) == CHOICES
    True
    >>> joint = {"mass": 1.15, "viscous": 8.1, "coulomb": 7.2}
    >>> mass = choices_of(machine("emps2018").replace(motion="rotary", mechanics=joint))["mass"]
    >>> mass.lower, mass.first, mass.upper
    (0.01, 0.5, 2.0)
    """
    size_of = sizes(axis)
    sized = {name: _sized(choice, size_of[choice.size]) if choice.size else choice for name, choice in CHOICES.items()}
    return sized | {name: sized[name].with_value(value) for name, value in _axis_values(axis).items()}


def _axis_values(axis: Axis) -> dict[str, float]:
    """Return the numbers of the controls that ``axis`` defines; they extend the ranges."""
    kp = position_gain(axis)
    return {"computation_delay": axis.sampling.computation_delay, **({} if kp is None else {"position_kp": kp})}


def position_gain(axis: Axis) -> float | None:
    """Return the position gain kp [1/s] of the controller of ``axis``; None if it has none or a record has it."""
    kp = (axis.controller.position or {}).get("kp")
    return kp if isinstance(kp, int | float) else None


def sizes(axis: Axis) -> dict[str, float]:
    """Return the scale of each kind of number on ``axis`` relative to emps2018: 1, 2 or 5 times a power of ten.

    Motions are at most as fast as on emps2018; they are slower for a slow loop, a weak motor or large friction.
    """
    here, reference = _quantities(axis), _reference_quantities()
    ratio = {name: here[name] / reference[name] for name in here if here[name] and reference[name]}
    length = TURN if axis.units.rotary else 1.0
    mass, force = ratio["mass"], max(ratio.get("coulomb", 0.0), ratio.get("motor", 0.0)) or ratio["mass"]
    pace = min(1.0, ratio["frequency"])
    acceleration = min(length * pace**2, ratio.get("acceleration", math.inf))
    speed = min(length * pace, math.sqrt(length * acceleration), ratio.get("speed", math.inf))
    period = _decade(axis.sampling.period * 1e3)
    return {
        "mass": one_two_five(mass),
        "1/mass": 1.0 / one_two_five(mass),
        "force": one_two_five(force),
        "force/length": one_two_five(force / length),
        "length": length,
        "speed": one_two_five(speed),
        "acceleration": one_two_five(acceleration),
        "frequency": one_two_five(ratio["frequency"]),
        "mass x frequency": one_two_five(mass * ratio["frequency"]),
        "period": period,
        "current loop": max(period, _decade(axis.drive.current_time_constant * 1e3)),
    }


def _quantities(axis: Axis) -> dict[str, float]:
    """Return the quantities that determine the scales [SI]; 0 if the axis does not have one."""
    mechanics, drive = axis.mechanics, axis.drive
    limited = drive.command_limit < NO_LIMIT
    motor = drive.force_gain * (drive.supply or 1.0) * drive.command_limit if limited else 0.0
    spare, brake = max(motor - mechanics.coulomb, 0.0), axis.damping
    return {
        "mass": mechanics.mass,
        "coulomb": mechanics.coulomb,
        "motor": motor,
        "acceleration": spare / mechanics.mass,
        "speed": spare / brake if brake else 0.0,
        "frequency": 1.0 / (axis.sampling.period + drive.current_time_constant),
    }


@lru_cache(maxsize=1)
def _reference_quantities() -> dict[str, float]:
    return _quantities(machine("emps2018"))


def _sized(choice: Choice, size: float) -> Choice:
    lower, upper, step, first = (
        float(f"{number * size:.12g}") for number in (choice.lower, choice.upper, choice.step, choice.first)
    )
    return replace(choice, lower=lower, upper=upper, step=step, first=first)


def _decade(milliseconds: float) -> float:
    """Return the power of ten nearest to 1 that scales the range 0.1 to 5 ms so that it contains ``milliseconds``.

    >>> _decade(0.25), _decade(10.0), _decade(0.05)
    (1.0, 10.0, 0.1)
    """
    size = math.log10(max(milliseconds, 1e-6))
    at_least, at_most = math.ceil(size - math.log10(5.0)), math.floor(size - math.log10(0.1))
    return float(f"1e{min(max(0, at_least), at_most)}")


@dataclass(frozen=True)
class Requirements:
    """Phase margin [deg] (None: unbounded) and overshoot [%] of a stable design, and whether they are met."""

    phase_margin_deg: float | None
    overshoot_percent: float
    phase_met: bool
    overshoot_met: bool

    @property
    def met(self) -> bool:
        """Whether both requirements are met."""
        return self.phase_met and self.overshoot_met


def requirements(
    design: VelocityLoopDesign, required_phase_deg: float, required_overshoot_percent: float
) -> Requirements | None:
    """Compare the sampled loop of ``design`` with the requirements; None if the loop is unstable."""
    from emps_design.control.verdict import sampled_step

    margins = design.sampled.margins
    if not margins.stable:
        return None
    phase, overshoot = margins.phase_margin_deg, sampled_step(design).overshoot_percent
    phase_met = phase is None or phase >= required_phase_deg
    return Requirements(phase, overshoot, phase_met, overshoot <= required_overshoot_percent)


def first_specification(axis: Axis) -> dict[str, float]:
    """Return a specification for ``axis`` whose design meets the default requirements, {} if none was found.

    If the force loop is unstable with the default k_e1, it also has half of the largest stable k_e1.
    """
    return _first(axis.to_toml())


@lru_cache(maxsize=64)
def _first(table: str) -> dict[str, float]:
    axis = Axis.from_toml(table)
    first = {name: choice.first for name, choice in choices_of(axis).items()}
    for share, phase in product(SHARES, PHASES):
        specification = {"frequency": float(f"{share * first['frequency']:.6g}"), "phase_margin_deg": phase}
        design = _acceptable(axis, specification, first)
        if design is not None:
            return specification | _force_gain(design, first)
    return {}


def _acceptable(axis: Axis, specification: dict[str, float], first: dict[str, float]) -> VelocityLoopDesign | None:
    """Return the design for ``specification`` if it meets the requirements and its worst loop is safe, else None."""
    from emps_design.control.sampled import safety
    from emps_design.control.velocity.design import design_velocity_loop
    from emps_design.control.verdict import DesignVerdict

    try:
        phase = specification["phase_margin_deg"]
        design = design_velocity_loop(axis, specification["frequency"], phase_margin_deg=phase)
    except EmpsError:  # there are no positive gains
        return None
    achieved = requirements(design, first["required_phase_deg"], first["required_overshoot_percent"])
    met = achieved and achieved.met and not design.refused and safety(DesignVerdict(design).worst.margins) >= 1.0
    return design if met else None


def _force_gain(design: VelocityLoopDesign, first: dict[str, float]) -> dict[str, float]:
    from emps_design.control.force import design_force_loop

    force = design_force_loop(design, first["k_e1"], hand=first["hand"], environment=first["wall"] * 1e3)
    limit = force.k_e1_max_sampled
    return {} if force.stable or limit is None else {"k_e1": float(f"{0.5 * limit:.1g}")}
