"""Random drives, and the effects hidden in them at sizes that follow the drive's own friction."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

Numbers = dict[str, float]  # the plant's names
Truth = dict[str, dict[str, float]]  # the package's names: effect -> parameter -> value


@dataclass(frozen=True)
class Drive:
    """A drive and what it is asked to do; SI units."""

    mass: float
    viscous: float
    coulomb: float
    offset: float
    gain: float
    limit: float
    kp: float
    kv: float
    resolution: float
    travel: float
    speeds: tuple[float, ...]
    acceleration: float
    period: float = 1e-3
    radius: float = 1.0  # m of travel for each rad, of an axis that turns

    @property
    def size(self) -> float:
        """Friction against that of a 95 kg axis with 20.4 N of Coulomb friction."""
        return self.coulomb / 20.4


def draw_drive(rng: np.random.Generator) -> Drive:
    """A drive between a half and three times a 95 kg axis, with gains as stiff as its position loop bears."""
    mass = float(np.exp(rng.uniform(np.log(50), np.log(280))))
    gain = mass * rng.uniform(0.27, 0.42)
    fastest = rng.uniform(0.11, 0.16)
    return Drive(
        mass=mass,
        viscous=mass * rng.uniform(1.7, 2.6),
        coulomb=mass * rng.uniform(0.17, 0.25),
        offset=mass * rng.uniform(-0.04, 0.04),
        gain=gain,
        limit=10.0,
        kp=float(np.round(rng.uniform(125, 165), 1)),
        kv=float(np.round(rng.uniform(80, 92) * mass / gain, 1)),
        resolution=float(rng.choice([5e-8, 1e-7])),
        travel=rng.uniform(0.2, 0.32),
        speeds=(fastest * rng.uniform(0.27, 0.36), fastest * rng.uniform(0.55, 0.7), fastest),
        acceleration=rng.uniform(0.7, 0.95),
    )


def turning(drive: Drive, radius: float) -> Drive:
    """``drive`` seen from a pinion of ``radius`` [m] that moves it: an inertia, torques, angles."""
    powers = {
        **dict.fromkeys(("mass", "viscous"), 2),
        **dict.fromkeys(("coulomb", "offset", "gain", "kv"), 1),
        **dict.fromkeys(("resolution", "travel", "acceleration"), -1),
    }
    numbers = {name: getattr(drive, name) * radius**power for name, power in powers.items()}
    return replace(drive, **numbers, speeds=tuple(speed / radius for speed in drive.speeds), radius=radius)


def _between(rng: np.random.Generator, low: float, high: float) -> float:
    return float(rng.uniform(low, high))


def draw_effect(
    name: str, rng: np.random.Generator, drive: Drive, size: int, peak_voltage: float
) -> tuple[Numbers, Truth]:
    """Numbers of effect ``name`` at ``size`` 1 or 2, for the plant and in the package's words.

    ``peak_voltage`` [V] is the largest the healthy drive used on the program.
    """
    big, c = size - 1, drive.size
    if name.endswith("with a load that rubs"):
        kind = name.split()[0]
        values, truth = draw_effect(kind, rng, drive, size, peak_voltage)
        return {**values, "far_rub": 0.6}, {kind: {**truth[kind], "load_friction": 0.6}}
    phase = _between(rng, -np.pi, np.pi)
    period = float(rng.choice([0.002, 0.0025, 0.004, 0.005, 0.008, 0.01]))
    sign = float(rng.choice([-1.0, 1.0]))
    if name == "asymmetric_viscous_friction":
        x = sign * drive.viscous * (0.2, 0.35)[big] * _between(rng, 0.85, 1.2)
        return {"asymmetric": x}, {name: {"viscous_difference": x}}
    if name == "nonlinear_viscous_friction":
        x = (4.4, 7.0)[big] * drive.viscous * (1.0 if sign > 0 else -0.5) * _between(rng, 0.85, 1.2)
        return {"quadratic": x}, {name: {"amount": 0.01 * x, "exponent": 2.0}}
    if name == "stribeck_friction":
        x, w = drive.coulomb * (0.4, 0.7)[big], _between(rng, 0.006, 0.012)
        return (
            {"stribeck_excess": x, "stribeck_velocity": w},
            {name: {"excess": x, "stribeck_velocity": w, "exponent": 1.0}},
        )
    if name == "presliding_friction":
        x = c * (1e5, 5e4)[big] * _between(rng, 0.8, 1.25)
        return {"dahl_stiffness": x}, {name: {"stiffness": x}}
    if name == "load_dependent_friction":
        x = (0.1, 0.16)[big] * _between(rng, 0.9, 1.1)
        return {"load_share": x}, {name: {"share": x}}
    if name == "load_dependent_friction behind the motor's":
        return {"load_share": 0.4, "load_before": 1.0}, {"load_dependent_friction": {"share": 0.4, "motor_side": 1.0}}
    if name == "load_dependent_friction of a weight":
        weight = 3.0 * drive.coulomb
        kind = {"share": 0.2, "carried_force": weight}
        return {"load_share": 0.2, "load_carried": weight}, {"load_dependent_friction": kind}
    if name == "position_dependent_friction":
        x, length = drive.coulomb * (0.25, 0.4)[big], drive.travel * _between(rng, 0.6, 1.5)
        return (
            {"travel_amplitude": x, "travel_length": length, "travel_phase": phase},
            {name: {"amplitude": x, "length": length, "phase": phase}},
        )
    if name == "friction_drift":
        x, w = (0.3, 0.45)[big] * sign, _between(rng, 7.0, 18.0)
        return {"drift_change": x, "drift_time": w}, {name: {"change": x, "time_constant": w}}
    if name == "position_ripple":
        x = c * (3.0, 6.0)[big] * _between(rng, 0.85, 1.2)
        return (
            {"ripple_amplitude": x, "ripple_period": period, "ripple_phase": phase},
            {name: {"amplitude": x, "period": period, "phase": phase}},
        )
    if name == "elastic_force":
        x, rest = c * (50.0, 110.0)[big] * _between(rng, 0.85, 1.2), drive.travel * _between(rng, 0.2, 0.7)
        return {"spring": x, "spring_rest": rest}, {name: {"stiffness": x, "rest_position": rest}}
    if name == "gravity":
        x = drive.coulomb * (0.5, 1.0)[big] * _between(rng, 0.85, 1.2)
        return {"arm_torque": x, "arm_angle": phase}, {name: {"torque": x, "angle": phase}}
    if name == "back_emf_braking":
        x, start = drive.viscous * (0.4, 0.8)[big], _between(rng, 2.0, 3.0)
        return {"winding": x, "off_from": start, "off_to": start + 0.1}, {name: {"braking": x}}
    if name == "maxwell_slip_friction":
        x, w = (0.25, 0.4)[big], _between(rng, 5e-4, 1.5e-3)
        return {"slip_share": x, "slip_travel": w}, {name: {"share": x, "travel": w}}
    if name == "friction_ripple":
        x = drive.coulomb * (0.15, 0.3)[big] * _between(rng, 0.85, 1.2)
        return (
            {"rub_amplitude": x, "rub_period": period, "rub_phase": phase},
            {name: {"amplitude": x, "period": period, "phase": phase}},
        )
    if name in ("force_map", "friction_map"):
        x = drive.coulomb * (0.2, 0.4)[big]
        bends = x * rng.uniform(0.0, 1.0, 6) * ([1.0, -1.0] * 3 if name == "force_map" else np.linspace(0.2, 2.0, 6))
        heights, place = bends.tolist(), {"start": 0.0, "end": round(drive.travel, 3)}
        plant = {f"{'pull' if name == 'force_map' else 'wear'}_{i}": h for i, h in enumerate(heights, start=1)}
        return (
            {"map_start": place["start"], "map_end": place["end"], **plant},
            {name: {**place, **{f"height_{i}": h for i, h in enumerate(heights, start=1)}}},
        )
    if name == "end_stop":
        x, depth = c * (1200.0, 2600.0)[big], _between(rng, 0.012, 0.025)
        place = drive.travel - depth if sign > 0 else depth
        return (
            {"stop_stiffness": x, "stop_position": place, "stop_side": sign},
            {name: {"stiffness": x, "position": place, "side": sign}},
        )
    if name == "mass_change":
        x, w = (0.1, 0.2)[big] * (1.0 if sign > 0 else -0.8), _between(rng, 6.0, 12.0)
        return {"mass_change": x, "mass_time": w}, {name: {"change": x, "time": w}}
    if name == "external_force":
        x, start = sign * c * (30.0, 50.0)[big], _between(rng, 1.0, 4.0)
        length, every = _between(rng, 0.15, 0.4), _between(rng, 4.1, 6.9)
        return (
            {"pulse_force": x, "pulse_start": start, "pulse_length": length, "pulse_every": every},
            {name: {"amplitude": x, "start": start, "duration": length, "every": every}},
        )
    if name == "periodic_disturbance":
        x, f = c * (3.0, 5.0)[big], _between(rng, 3.0, 14.0)
        return (
            {"hum_amplitude": x, "hum_frequency": f, "hum_phase": phase},
            {name: {"amplitude": x, "frequency": f, "phase": phase}},
        )
    if name == "flexible_coupling":
        f, share, damping = (_between(rng, 38, 48), _between(rng, 28, 35))[big], _between(rng, 0.3, 0.5), 0.04
        return (
            {"load_part": share, "coupling_frequency": f, "coupling_damping": damping},
            {name: {"frequency": f, "damping": damping, "share": share}},
        )
    if name == "backlash":
        gap, f, share, damping = (8e-5, 2e-4)[big], _between(rng, 50, 70), _between(rng, 0.3, 0.45), 0.15
        return (
            {"gap": gap, "load_part": share, "coupling_frequency": f, "coupling_damping": damping},
            {name: {"gap": gap, "frequency": f, "damping": damping, "share": share}},
        )
    if name in ("actuator_delay", "actuator_lag"):
        x = (1.6e-3, 2.4e-3)[big] * _between(rng, 0.9, 1.1)
        return (
            ({"delay": x}, {name: {"delay": x}}) if name[9:] == "delay" else ({"lag": x}, {name: {"time_constant": x}})
        )
    if name == "actuator_saturation":
        x = peak_voltage * (0.85, 0.78)[big]
        return {"clip": x}, {name: {"limit": x}}
    if name == "actuator_deadzone":
        x = (0.35, 0.6)[big] * drive.coulomb / drive.gain
        return {"dead": x}, {name: {"width": x}}
    if name == "encoder_error":
        x = (6e-6, 1.2e-5)[big] * (period / 0.005) ** 1.5
        return (
            {"encoder_amplitude": x, "encoder_period": period, "encoder_phase": phase},
            {name: {"amplitude": x, "period": period, "phase": phase}},
        )
    if name == "controller_disturbance":
        x, f = sign * (1.0, 2.0)[big] * drive.coulomb / drive.gain, _between(rng, 0.4, 1.6)
        start = _between(rng, 0.0, 1.0 / f)
        return (
            {"wave_voltage": x, "wave_frequency": f, "wave_duty": 0.5, "wave_start": start},
            {name: {"amplitude": x, "frequency": f, "duty": 0.5, "start": start}},
        )
    if name == "unknown_ageing":
        return {"ageing": drive.coulomb * (0.5, 0.8)[big]}, {}
    if name == "unknown_cross":
        return {"cross": sign * drive.viscous * (6.0, 9.0)[big], "middle": 0.5 * drive.travel}, {}
    if name == "unknown_wake":
        return {"wake": drive.coulomb * (0.4, 0.7)[big]}, {}
    if name == "unknown_crank":
        return {"crank": sign * (0.3, 0.45)[big], "crank_length": 0.8 * drive.travel, "middle": 0.45 * drive.travel}, {}
    if name == "unknown_magnet":
        width, middle = 0.15 * drive.travel, drive.travel * _between(rng, 0.35, 0.65)
        return {"magnet": drive.viscous * (2.0, 3.5)[big], "magnet_width": width, "middle": middle}, {}
    if name == "unknown_thixotropy":
        return {"thixotropy": drive.coulomb * (0.6, 1.0)[big]}, {}
    raise KeyError(f"no effect called {name}")


def draw_several(rng: np.random.Generator, count: int, among: tuple[str, ...]) -> tuple[str, ...]:
    """``count`` effects of ``among`` in any order, no two of which are one and the same physics."""
    chosen: list[str] = []
    for name in map(str, rng.permutation(among)):
        if not any({name, other} <= alike for other in chosen for alike in ALIKE):
            chosen.append(name)
    return tuple(chosen[:count])


EFFECTS = (
    "asymmetric_viscous_friction",
    "nonlinear_viscous_friction",
    "stribeck_friction",
    "presliding_friction",
    "load_dependent_friction",
    "position_dependent_friction",
    "friction_drift",
    "position_ripple",
    "elastic_force",
    "end_stop",
    "mass_change",
    "external_force",
    "periodic_disturbance",
    "flexible_coupling",
    "backlash",
    "actuator_delay",
    "actuator_lag",
    "actuator_saturation",
    "actuator_deadzone",
    "encoder_error",
    "controller_disturbance",
)
TURNING = ("gravity",)  # of an axis that turns: compared between the simulators, in no generated case
FURTHER = ("maxwell_slip_friction", "friction_ripple", "force_map", "friction_map", "back_emf_braking")
FORMS = (  # second forms of the above, compared only
    "load_dependent_friction behind the motor's",
    "load_dependent_friction of a weight",
    "flexible_coupling with a load that rubs",
    "backlash with a load that rubs",
)
UNKNOWN = (
    "unknown_ageing",
    "unknown_cross",
    "unknown_wake",
    "unknown_crank",
    "unknown_magnet",
    "unknown_thixotropy",
)
ALIKE = ({"flexible_coupling", "backlash"}, {"actuator_delay", "actuator_lag"})
AMPLITUDES = {  # effects with an amplitude: the plant's name of it, and the package's
    "asymmetric_viscous_friction": ("asymmetric", "viscous_difference"),
    "nonlinear_viscous_friction": ("quadratic", "amount"),
    "stribeck_friction": ("stribeck_excess", "excess"),
    "load_dependent_friction": ("load_share", "share"),
    "position_dependent_friction": ("travel_amplitude", "amplitude"),
    "friction_drift": ("drift_change", "change"),
    "position_ripple": ("ripple_amplitude", "amplitude"),
    "elastic_force": ("spring", "stiffness"),
    "mass_change": ("mass_change", "change"),
    "external_force": ("pulse_force", "amplitude"),
    "periodic_disturbance": ("hum_amplitude", "amplitude"),
    "actuator_deadzone": ("dead", "width"),
}
PAIRS = (
    ("asymmetric_viscous_friction", "position_ripple"),
    ("stribeck_friction", "actuator_delay"),
    ("flexible_coupling", "stribeck_friction"),
    ("external_force", "asymmetric_viscous_friction"),
    ("nonlinear_viscous_friction", "position_dependent_friction"),
    ("actuator_lag", "position_ripple"),
    ("mass_change", "elastic_force"),
    ("backlash", "periodic_disturbance"),
)
