"""A bench that behaves like the paper's: ten identification and ten co-manipulation experiments from one seed.

The records of the 2018 paper are not public. This machine has the two-quadrant friction of its Table I, and, chosen
so that errors and deviations come out as printed, what such a machine has besides: friction that bends, break-away,
friction that depends on position and drifts between experiments, noise of the friction, an encoder and a force sensor.
``BENCH_NUMBERS`` says of every number whether it is the paper's or chosen, and why.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from emps_design.axis import Axis
from emps_design.control.velocity.design import design_velocity_loop
from emps_design.effects import Effect, Parameter, get_effect
from emps_design.machines import machine
from emps_design.records import Record
from emps_design.simulation import Plant

PAPER, CHOSEN = "paper", "chosen"


@dataclass(frozen=True)
class Number:
    """A number of the bench: ``value``, ``unit``, whether it is the ``paper`` 's or ``chosen``, and the reason."""

    value: float
    unit: str
    origin: str
    reason: str


BENCH_NUMBERS: dict[str, Number] = {
    "experiments": Number(10, "", PAPER, "ten of each kind, sections III-A and III-B"),
    "crossover": Number(100.0, "rad/s", PAPER, "velocity loop, section II-C"),
    "largest_force": Number(5.0, "N", PAPER, "range of the force sensor, section III-C"),
    "phase_margin": Number(60.0, "deg", CHOSEN, "the paper gives none"),
    "viscous_bend": Number(25.0, "N", CHOSEN, "Table II's F_v at low speed is well above Table I's"),
    "viscous_exponent": Number(0.5, "", CHOSEN, "steep near rest, then flatter, as grease that shears"),
    "viscous_less": Number(275.0, "N/(m/s)", CHOSEN, "so that the bent friction *identifies* as Table I's F_v"),
    "coulomb_less": Number(5.3, "N", CHOSEN, "so that the bent friction *identifies* as Table I's F_c"),
    "break_away_excess": Number(4.9, "N", CHOSEN, "so that the test at rest gives the F_s of 17 N of section III-A"),
    "stribeck_velocity": Number(0.0005, "m/s", CHOSEN, "a ball screw's excess is gone within a few mm/s"),
    "stribeck_exponent": Number(1.0, "", CHOSEN, "the paper allows 1 to 2"),
    "position_amplitude": Number(4.6, "N", CHOSEN, "where the operator works friction is higher: RMS_2 of 3.9-5.4 N"),
    "position_length": Number(0.35, "m", CHOSEN, "slow, so that neither small workspace sees it change"),
    "ripple_amplitude": Number(1.5, "N", CHOSEN, "1 N at 2.5 mm in the 2019 record of the same machine, here older"),
    "ripple_period": Number(0.0025, "m", CHOSEN, "one revolution, from the 2019 record of the same machine"),
    "friction_noise": Number(1.7, "N", CHOSEN, "brings direct validation to 2.7-3.4 N"),
    "friction_noise_spread": Number(0.13, "", CHOSEN, "of the noise from experiment to experiment: the ranges' width"),
    "friction_noise_speed": Number(0.0152, "m/s", CHOSEN, "at which it has doubled: brings RMS_1 to 3.6-5.3 N"),
    "friction_noise_time": Number(0.06, "s", CHOSEN, "slow enough to pass the filters, as the residual of 2019 does"),
    "drift": Number(0.03, "", CHOSEN, "std of the friction from one experiment to the next: lubrication, temperature"),
    "voltage_noise": Number(0.004, "V", CHOSEN, "3.7 mV in the 2019 record"),
    "sensor_noise": Number(0.05, "N", CHOSEN, "1 % of the sensor's range; the paper calls it insignificant"),
    "kp": Number(160.18, "1/s", CHOSEN, "position controller of 2019; the paper gives none"),
    "kv": Number(243.45, "V/(m/s)", CHOSEN, "position controller of 2019; the paper gives none"),
    "speed": Number(0.04, "m/s", CHOSEN, "of the trajectory; Table I's deviation of F_v over that of F_c says so"),
    "ramp": Number(0.1, "s", CHOSEN, "of the trajectory; Table I's deviation of M over that of F_c says so"),
    "duration": Number(40.0, "s", CHOSEN, "of an experiment; Table I's deviations over its RMS_1 say so"),
    "workspace": Number(0.04, "m", CHOSEN, "where co-manipulation starts: away from where the parameters were found"),
    "hand_ramp": Number(0.2, "s", CHOSEN, "mean ramp of the operator's force, half as long to half as long again"),
    "k_e1": Number(
        0.0024, "(m/s)/N", CHOSEN, "low on purpose, as the paper says: Table II's deviations give the speed"
    ),
    "tau_ref": Number(1.0, "N", PAPER, "not zero (section III-B); its size is chosen"),
}


def value(name: str) -> float:
    """The number called ``name``, in its unit."""
    return BENCH_NUMBERS[name].value


def friction_noise(q, v, t, tau, x, p, b):
    """Kernel of a force [N] that follows samples ``p[2:]`` at ``p[0]`` Hz and grows with speed over ``p[1]`` m/s."""
    k = int(t * p[0])
    share = t * p[0] - k
    return ((1.0 - share) * p[2 + k] + share * p[3 + k]) * (1.0 + abs(v) / p[1])


# Not one of the package's effects: its parameters are the sampling rate, the speed at which the noise has doubled, and
# then the noise itself, sample by sample.
_NOISE = Effect(
    name="friction_noise",
    label="Noise of the friction",
    channel="plant",
    equation=r"\tau = n(t)",
    source="first-order autoregressive, chosen",
    parameters=(
        Parameter("rate", "1/T", "Hz", text="samples in a second"),
        Parameter("doubling", "v_2", "m/s", text="speed at which the noise has doubled; the samples [N] follow"),
    ),
    force=friction_noise,
    no_regressor="it is noise",
)


def bench_axis() -> Axis:
    """Table I with both quadrants, break-away, position dependence and ripple; position controller of 2019."""
    axis = machine("emps2018-two-quadrant")
    effects = [
        *axis.to_dict()["effects"],
        {
            "kind": "nonlinear_viscous_friction",
            "amount": value("viscous_bend"),
            "exponent": value("viscous_exponent"),
        },
        {
            "kind": "stribeck_friction",
            "excess": value("break_away_excess"),
            "stribeck_velocity": value("stribeck_velocity"),
            "exponent": value("stribeck_exponent"),
        },
        {
            "kind": "position_dependent_friction",
            "amplitude": value("position_amplitude"),
            "phase": 0.0,
            "length": value("position_length"),
        },
        {
            "kind": "position_ripple",
            "amplitude": value("ripple_amplitude"),
            "phase": 0.0,
            "period": value("ripple_period"),
        },
    ]
    controller = {"kind": "position_pd", "kp": value("kp"), "kv": value("kv")}
    mechanics = {
        "viscous": axis.mechanics.viscous - value("viscous_less"),
        "coulomb": axis.mechanics.coulomb - value("coulomb_less"),
    }
    return axis.replace(mechanics=mechanics, effects=effects, controller=controller)


@dataclass(frozen=True)
class Bench:
    """Records of one seed: ``identification`` and ``comanipulation`` experiments, and the break-away test's ``F_s``."""

    seed: int
    axis: Axis
    identification: tuple[Record, ...]
    comanipulation: tuple[Record, ...]
    break_away: tuple[float, float]


def virtual_bench(seed: int = 0, progress: Callable[[str, float], None] | None = None) -> Bench:
    """Run the twenty experiments and the break-away test of ``seed``; the same seed gives the same bytes.

    Friction walks slowly from experiment to experiment; the co-manipulation ones come after the identification ones,
    in a small part of the stroke.
    """
    axis = bench_axis()
    rng = np.random.default_rng(seed)
    count = int(value("experiments"))
    # A mean-reverting walk: neighbouring experiments resemble one another.
    levels, level = [], 0.0
    for _ in range(2 * count):
        level = 0.7 * level + np.sqrt(1.0 - 0.7**2) * value("drift") * rng.standard_normal()
        levels.append(1.0 + level)
    runs: list[Record] = []
    for index, scale in enumerate(levels):
        kind = "identification" if index < count else "co-manipulation"
        if progress is not None:
            progress(f"{kind} experiment {index % count + 1}", index / (2 * count))
        make = identification_experiment if index < count else comanipulation_experiment
        runs.append(make(axis, rng, scale, f"{kind}-{index % count + 1}"))
    return Bench(
        seed=seed,
        axis=axis,
        identification=tuple(runs[:count]),
        comanipulation=tuple(runs[count:]),
        break_away=(break_away_test(axis, 1.0), break_away_test(axis, -1.0)),
    )


def identification_experiment(axis: Axis, rng: np.random.Generator, scale: float, name: str) -> Record:
    """Follow :func:`identification_trajectory` under the position controller, no external force."""
    period = axis.sampling.period
    q_ref = identification_trajectory(period)
    return _run(axis, rng, scale, name, q_ref=q_ref)


def comanipulation_experiment(axis: Axis, rng: np.random.Generator, scale: float, name: str) -> Record:
    """Ramps and floors of an operator's force on the cascaded loop of Fig. 4; the force reference is not zero."""
    loop = design_velocity_loop(
        machine("emps2018"), crossover=value("crossover"), phase_margin_deg=value("phase_margin")
    )
    controller = {"kind": "ip_velocity", "k_v1": loop.k_v1, "t_v": loop.t_v, "k_e1": value("k_e1")}
    data = axis.to_dict()
    data["controller"] = controller
    force = operator_force(axis.sampling.period, rng)
    return _run(Axis.from_dict(data), rng, scale, name, force=force)


def identification_trajectory(period: float) -> np.ndarray:
    """Position reference (n,) [m]: trapezoids of velocity, ramps half of the time, at four speeds, forth and back."""
    n, pieces = int(value("duration") / period), []
    shares = (1.0, 0.35, 0.7, 0.2)
    while sum(map(len, pieces)) < n:
        share = shares[(len(pieces) // 2) % len(shares)]
        ramp = int(value("ramp") / period)
        up = np.linspace(0.0, share * value("speed"), ramp)
        one = np.concatenate([up, np.full(2 * ramp, up[-1]), up[::-1]])
        pieces += [one, -one]
    bell = np.hanning(int(0.03 / period))
    velocity = np.convolve(np.concatenate(pieces)[:n], bell / bell.sum(), "same")
    return np.cumsum(velocity) * period


def operator_force(period: float, rng: np.random.Generator) -> np.ndarray:
    """Force of the operator (n,) [N]: ramps and floors of either sign within the sensor's range.

    >>> force = operator_force(1e-3, np.random.default_rng(0))
    >>> len(force), bool(abs(force).max() <= value("largest_force"))
    (40000, True)
    """
    n, force, level, sign = int(value("duration") / period), [], 0.0, 1.0
    while len(force) < n:
        target = sign * rng.uniform(0.5, 0.95) * value("largest_force")
        ramp = int(rng.uniform(0.5, 1.5) * value("hand_ramp") / period)
        force += [*np.linspace(level, target, ramp), *np.full(int(rng.uniform(0.4, 0.9) / period), target)]
        level, sign = target, -sign
    return np.array(force[:n])


def break_away_test(axis: Axis, direction: float, rate: float = 0.5) -> float:
    """F_s [N]: the motor force, rising from rest by ``rate`` [N/s], at which the carriage has moved by 2 um.

    >>> round(break_away_test(machine("emps2018"), 1.0), 0)  # Coulomb friction alone: Table I's
    17.0
    """
    period, gain = axis.sampling.period, axis.drive.force_gain
    u = direction * rate / gain * np.arange(int(60.0 / period)) * period
    run = Plant.of(axis).open_loop(u)
    moved = np.flatnonzero(np.abs(run.position - run.position[0]) > 2e-6)
    return float(gain * abs(u[moved[0]]))


def _run(axis, rng, scale, name, q_ref=None, force=None) -> Record:
    period = axis.sampling.period
    n = len(q_ref) if q_ref is not None else len(force)
    decay = np.exp(-period / value("friction_noise_time"))
    # The size of the noise differs from one experiment to the next, like the lubrication.
    size = value("friction_noise") * rng.uniform(
        1.0 - value("friction_noise_spread"), 1.0 + value("friction_noise_spread")
    )
    noise = _autoregressive(size * np.sqrt(1.0 - decay**2) * rng.standard_normal(n), decay)
    # The encoder's zero is another one at every start: so is the phase of what repeats with its turns.
    turned = []
    for one in axis.effects:
        p = dict(one.parameters)
        if {"period", "phase"} <= set(p):
            p["phase"] = float(rng.uniform(-np.pi, np.pi))
        turned.append((get_effect(one.kind), get_effect(one.kind).values(p)))
    samples = np.concatenate([[1.0 / period, value("friction_noise_speed")], noise, noise[-1:], noise[-1:]])
    plant = Plant(axis, [*turned, (_NOISE, samples)])
    baseline = axis.mechanics.array() * np.array([1.0, scale, scale, 1.0])
    options = {
        "baseline": baseline,
        "voltage_noise": value("voltage_noise") * rng.standard_normal(n),
    }
    if q_ref is not None:
        run = plant.closed_loop(q_ref, **options)
        return Record(t=run.t, q_ref=q_ref, q=run.q, u=run.u, period=period, name=name)
    reference = np.full(n, value("k_e1") * value("tau_ref"))
    run = plant.closed_loop(np.zeros(n), disturbance=force, reference=reference, q0=value("workspace"), **options)
    sensor = force + value("sensor_noise") * rng.standard_normal(n)
    return Record(t=run.t, q_ref=np.zeros(n), q=run.q, u=run.u, f_ext=sensor, period=period, name=name)


def _autoregressive(white: np.ndarray, decay: float) -> np.ndarray:
    from scipy.signal import lfilter

    return lfilter([1.0], [1.0, -decay], white)
