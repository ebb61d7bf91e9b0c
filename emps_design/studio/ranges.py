"""The numbers that controls set: label, range, step and first value, all sized to the axis at hand.

They are written for an ordinary axis, the embedded emps2018. On another one a mass is that of its load, a force that of
its friction or its motor, and a frequency what its sampling and its current loop allow.

The requirements of a velocity loop, and the specification that a session starts with: one that meets them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import product
from typing import TYPE_CHECKING, Any

from emps_design.axis import Axis
from emps_design.axis.tables import NO_LIMIT
from emps_design.errors import EmpsError
from emps_design.machines import machine
from emps_design.quantities import one_two_five
from emps_design.units import TURN

if TYPE_CHECKING:
    from emps_design.control.velocity.design import VelocityLoopDesign

ANY_AXIS = 1e9  # how far the ranges of two axes may lie apart

# Shares of the first frequency: slower ones first; faster ones for a position loop that the axis has around it.
SHARES = (1.0, 0.5, 0.2, 0.1, 0.05, 2.0, 5.0)
PHASES = (60.0, 70.0, 80.0)  # deg


@dataclass(frozen=True)
class Choice:
    """A number that a control sets: its label with the unit, its range, the step of the control, and its first value.

    ``size`` names what makes it larger or smaller on another axis, one of those of :func:`sizes`; "" for what is alike
    on every axis. A ``frequency`` is in rad/s, and may be given as text with its unit, such as 30Hz.
    """

    label: str
    lower: float
    upper: float
    step: float
    first: float
    size: str = ""

    @property
    def frequency(self) -> bool:
        """Whether it is in rad/s."""
        return self.label.endswith("[rad/s]")

    def holds(self, value: float) -> bool:
        """Whether ``value`` is in the range."""
        return self.lower <= value <= self.upper

    def with_value(self, value: float) -> Choice:
        """The same with a range that has ``value`` in it."""
        return self if self.holds(value) else replace(self, lower=min(self.lower, value), upper=max(self.upper, value))

    def of_any_axis(self, value: Any) -> Choice:
        """The same with ``value`` in its range where that may be a number of a smaller or a larger axis."""
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
    """:data:`CHOICES`, sized to ``axis``.

    >>> choices_of(machine("emps2018")) == CHOICES
    True
    >>> joint = {"mass": 1.15, "viscous": 8.1, "coulomb": 7.2}
    >>> found = choices_of(machine("emps2018").replace(motion="rotary", mechanics=joint))["mass"]
    >>> found.lower, found.first, found.upper
    (0.01, 0.5, 2.0)
    """
    found = sizes(axis)
    sized = {name: _sized(choice, found[choice.size]) if choice.size else choice for name, choice in CHOICES.items()}
    return sized | {name: sized[name].with_value(value) for name, value in _own(axis).items()}


def _own(axis: Axis) -> dict[str, float]:
    """Numbers of the controls that ``axis`` has itself, whatever the range is otherwise."""
    kp = position_gain(axis)
    return {"computation_delay": axis.sampling.computation_delay, **({} if kp is None else {"position_kp": kp})}


def position_gain(axis: Axis) -> float | None:
    """The position gain kp [1/s] that the controller of ``axis`` has; None where it has none, or takes a record's."""
    kp = (axis.controller.position or {}).get("kp")
    return kp if isinstance(kp, int | float) else None


def sizes(axis: Axis) -> dict[str, float]:
    """How much larger than on the ordinary axis each kind of number is on ``axis``: 1, 2 or 5 times a power of ten.

    No motion is quicker than the ordinary one; it is slower where the loop is slow, the motor weak, or friction large.
    """
    own, ordinary = _quantities(axis), _ordinary()
    ratio = {name: own[name] / ordinary[name] for name in own if own[name] and ordinary[name]}
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
    """What an axis is sized by, SI; 0 where it does not say."""
    mechanics, drive = axis.mechanics, axis.drive
    limited = drive.command_limit < NO_LIMIT
    motor = drive.force_gain * (drive.supply or 1.0) * drive.command_limit if limited else 0.0
    left, brake = max(motor - mechanics.coulomb, 0.0), axis.damping
    return {
        "mass": mechanics.mass,
        "coulomb": mechanics.coulomb,
        "motor": motor,
        "acceleration": left / mechanics.mass,
        "speed": left / brake if brake else 0.0,
        "frequency": 1.0 / (axis.sampling.period + drive.current_time_constant),
    }


@lru_cache(maxsize=1)
def _ordinary() -> dict[str, float]:
    return _quantities(machine("emps2018"))


def _sized(choice: Choice, size: float) -> Choice:
    lower, upper, step, first = (
        float(f"{one * size:.12g}") for one in (choice.lower, choice.upper, choice.step, choice.first)
    )
    return replace(choice, lower=lower, upper=upper, step=step, first=first)


def _decade(milliseconds: float) -> float:
    """The power of ten next to 1 that takes 0.1 to 5 ms to a range with ``milliseconds`` in it.

    >>> _decade(0.25), _decade(10.0), _decade(0.05)
    (1.0, 10.0, 0.1)
    """
    size = math.log10(max(milliseconds, 1e-6))
    at_least, at_most = math.ceil(size - math.log10(5.0)), math.floor(size - math.log10(0.1))
    return float(f"1e{min(max(0, at_least), at_most)}")


@dataclass(frozen=True)
class Requirements:
    """What a stable design has of what is required: its phase margin [deg], None for any, and its overshoot [%]."""

    phase_margin_deg: float | None
    overshoot_percent: float
    phase_met: bool
    overshoot_met: bool

    @property
    def met(self) -> bool:
        """Whether it has all of it."""
        return self.phase_met and self.overshoot_met


def requirements(
    design: VelocityLoopDesign, required_phase_deg: float, required_overshoot_percent: float
) -> Requirements | None:
    """What ``design`` has of what is required of it when sampled; None where that loop is unstable."""
    from emps_design.control.velocity.comparison import sampled_step

    margins = design.sampled.margins
    if not margins.stable:
        return None
    phase, overshoot = margins.phase_margin_deg, sampled_step(design).overshoot_percent
    phase_met = phase is None or phase >= required_phase_deg
    return Requirements(phase, overshoot, phase_met, overshoot <= required_overshoot_percent)


def first_specification(axis: Axis) -> dict[str, float]:
    """The first specification on ``axis`` whose design meets the first requirements; {} where none of those tried does.

    The force gain is half of what that design bears, where it bears less than the first.
    """
    return _first(axis.to_toml())


@lru_cache(maxsize=64)
def _first(table: str) -> dict[str, float]:
    axis = Axis.from_toml(table)
    first = {name: choice.first for name, choice in choices_of(axis).items()}
    for share, phase in product(SHARES, PHASES):
        asked = {"frequency": float(f"{share * first['frequency']:.6g}"), "phase_margin_deg": phase}
        design = _met(axis, asked, first)
        if design is not None:
            return asked | _force_gain(design, first)
    return {}


def _met(axis: Axis, asked: dict[str, float], first: dict[str, float]) -> VelocityLoopDesign | None:
    """The design of what is ``asked`` where it has what is required of it and its worst loop is safe."""
    from emps_design.control.nested_loops import safety
    from emps_design.control.velocity.design import design_velocity_loop
    from emps_design.control.verdict import DesignVerdict

    try:
        design = design_velocity_loop(axis, asked["frequency"], phase_margin_deg=asked["phase_margin_deg"])
    except EmpsError:  # no gains are positive
        return None
    found = requirements(design, first["required_phase_deg"], first["required_overshoot_percent"])
    met = found and found.met and not design.refused and safety(DesignVerdict(design).worst.margins) >= 1.0
    return design if met else None


def _force_gain(design: VelocityLoopDesign, first: dict[str, float]) -> dict[str, float]:
    from emps_design.control.force import design_force_loop

    force = design_force_loop(design, first["k_e1"], hand=first["hand"], environment=first["wall"] * 1e3)
    limit = force.k_e1_max_sampled
    return {} if force.stable or limit is None else {"k_e1": float(f"{0.5 * limit:.1g}")}
