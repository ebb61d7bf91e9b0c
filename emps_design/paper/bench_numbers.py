"""The numbers of the virtual bench: value, unit, whether the paper gives it, and the reason where it is chosen."""

from __future__ import annotations

from dataclasses import dataclass

from emps_design.errors import InputError, nearest_name

PAPER, CHOSEN = "paper", "chosen"


@dataclass(frozen=True)
class Number:
    """A number of the bench: ``value``, ``unit``, whether it is the ``paper`` 's or ``chosen``, and the reason."""

    value: float
    unit: str
    origin: str
    reason: str


NUMBERS: dict[str, Number] = {
    "experiments": Number(10, "", PAPER, "ten of each kind, sections III-A and III-B"),
    "crossover": Number(100.0, "rad/s", PAPER, "velocity loop, section II-C"),
    "phase_margin": Number(60.0, "deg", CHOSEN, "the paper gives none"),
    "bend_positive": Number(31.3, "N", CHOSEN, "at 0.1 m/s: Table II's F_v+ at low speed is above Table I's"),
    "bend_negative": Number(49.1, "N", CHOSEN, "at 0.1 m/s: Table II's F_v- at low speed is well above Table I's"),
    "bend_exponent": Number(0.45, "", CHOSEN, "steep near rest, then flatter, as grease that shears"),
    "viscous_less_positive": Number(339.4, "N/(m/s)", CHOSEN, "so that the bent friction identifies as Table I's F_v+"),
    "viscous_less_negative": Number(571.5, "N/(m/s)", CHOSEN, "so that the bent friction identifies as Table I's F_v-"),
    "coulomb_less_positive": Number(7.52, "N", CHOSEN, "so that the bent friction identifies as Table I's F_c+"),
    "coulomb_less_negative": Number(11.04, "N", CHOSEN, "so that the bent friction identifies as Table I's F_c-"),
    "mass_less": Number(1.3, "kg", CHOSEN, "so that the mass identifies as Table I's, reversals included"),
    "break_away_excess": Number(7.1, "N", CHOSEN, "so that the test at rest gives the F_s of 17 N of section III-A"),
    "stribeck_velocity": Number(0.0005, "m/s", CHOSEN, "a ball screw's excess is gone within a few mm/s"),
    "stribeck_exponent": Number(1.0, "", CHOSEN, "the paper allows 1 to 2"),
    "position_amplitude": Number(5.5, "N", CHOSEN, "where the operator works friction is higher: RMS_2 of 3.9-5.4 N"),
    "position_length": Number(0.35, "m", CHOSEN, "slow, so that neither small workspace sees it change"),
    "ripple_amplitude": Number(1.5, "N", CHOSEN, "1 N at 2.5 mm in the 2019 record of the same machine, here older"),
    "ripple_period": Number(0.0025, "m", CHOSEN, "one revolution, from the 2019 record of the same machine"),
    "friction_noise": Number(1.78, "N", CHOSEN, "brings direct validation to 2.7-3.4 N"),
    "friction_noise_spread": Number(0.13, "", CHOSEN, "of the noise from experiment to experiment: the ranges' width"),
    "friction_noise_speed": Number(0.0152, "m/s", CHOSEN, "at which it has doubled: brings RMS_1 to 3.6-5.3 N"),
    "friction_noise_time": Number(0.06, "s", CHOSEN, "slow enough to pass the filters, as the residual of 2019 does"),
    "drift": Number(0.015, "", CHOSEN, "std of the friction from one experiment to the next: lubrication, temperature"),
    "voltage_noise": Number(0.004, "V", CHOSEN, "3.7 mV in the 2019 record"),
    "sensor_noise": Number(0.05, "N", CHOSEN, "1 % of the sensor's range; the paper calls it insignificant"),
    "sensor_gain_error": Number(0.0, "", CHOSEN, "the paper takes the sensor's force for the real one"),
    "sensor_lag": Number(0.0, "s", CHOSEN, "first-order; the paper gives none"),
    "sensor_offset": Number(1.02, "N", CHOSEN, "zero of the sensor, or the pull of a cable, from one day to the other"),
    "mass_beyond_sensor": Number(8.75, "kg", CHOSEN, "gripper in front of the sensor"),
    "kp": Number(160.18, "1/s", CHOSEN, "position controller of 2019; the paper gives none"),
    "kv": Number(243.45, "V/(m/s)", CHOSEN, "position controller of 2019; the paper gives none"),
    "speed": Number(0.04, "m/s", CHOSEN, "of the trajectory; Table I's deviation of F_v over that of F_c says so"),
    "ramp": Number(0.1, "s", CHOSEN, "of the trajectory; Table I's deviation of M over that of F_c says so"),
    "duration": Number(40.0, "s", CHOSEN, "of identification; Table I's deviations over its RMS_1 say so"),
    "workspace": Number(0.04, "m", CHOSEN, "where co-manipulation starts: away from where the parameters were found"),
    "hand_duration": Number(110.0, "s", CHOSEN, "of co-manipulation; Table II's deviations over its RMS error say so"),
    "hand_force": Number(2.5, "N", CHOSEN, "largest step to either side of the force that keeps the carriage at rest"),
    "hand_least": Number(0.2, "", CHOSEN, "smallest such step over the largest"),
    "hand_bias": Number(
        1.0, "", CHOSEN, "share of tau_ref that the hand balances; Table II says equal speeds both ways"
    ),
    "hand_ramp": Number(0.2, "s", CHOSEN, "mean ramp of the operator's force, half as long to half as long again"),
    "hand_floor": Number(0.65, "s", CHOSEN, "mean floor of the operator's force, 0.6 to 1.4 times that"),
    "k_e1": Number(0.005, "(m/s)/N", CHOSEN, "low on purpose, as the paper says: Table II's deviations give the speed"),
    "tau_ref": Number(2.5, "N", PAPER, "not zero, for a force at any time (III-B); its size is chosen, half the range"),
}


def numbers(**changes: float) -> dict[str, float]:
    """The numbers of the bench in their units, with ``changes``; raises :class:`InputError` for a name not among them.

    >>> numbers(tau_ref=1.0)["tau_ref"], numbers()["crossover"]
    (1.0, 100.0)
    """
    for name in changes:
        if name not in NUMBERS:
            raise InputError(
                f"bench: found the number {name!r}{nearest_name(name, tuple(NUMBERS))}, expected one of NUMBERS"
            )
    return {name: float(changes.get(name, number.value)) for name, number in NUMBERS.items()}
