"""A bench that behaves like the paper's: ten identification and ten co-manipulation experiments from one seed.

The records of the 2018 paper are not public. This machine has the two-quadrant friction of its Table I, and, chosen
so that tables and errors come out as printed, what such a machine has besides: friction that bends, break-away,
friction that depends on position and drifts between experiments, noise of the friction, an encoder, and a force sensor
with a gripper in front of it. ``bench_numbers.py`` says of every number whether it is the paper's or chosen, and why;
``benchmarks/table_2.py`` shows by a sweep which of them make Table II.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from emps_design.axis import Axis
from emps_design.control.velocity.design import design_velocity_loop
from emps_design.effects import Effect, Parameter, get_effect
from emps_design.machines import machine
from emps_design.paper.bench_numbers import numbers
from emps_design.progress import Progress
from emps_design.records import Record
from emps_design.simulation import Plant


def friction_noise(q: float, v: float, t: float, tau: float, x: np.ndarray, p: np.ndarray, b: np.ndarray) -> float:
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


def bent_friction(q: float, v: float, t: float, tau: float, x: np.ndarray, p: np.ndarray, b: np.ndarray) -> float:
    """Kernel: ``p[0]`` or ``p[1]`` [N] at 0.1 m/s forth and back, to the power ``p[2]`` of the speed; odd near rest."""
    amount = p[0] if v > 0.0 else p[1]
    return amount * (v / 0.1) * ((v * v + 1e-8) / 0.01) ** (0.5 * (p[2] - 1.0))


def bend_of(velocity: np.ndarray, given: Mapping[str, float] | None = None) -> np.ndarray:
    """Force of the bend [N] at velocities (n,) [m/s]."""
    n = numbers() if given is None else given
    p, none = np.array([n["bend_positive"], n["bend_negative"], n["bend_exponent"]]), np.zeros(0)
    return np.array([bent_friction(0.0, v, 0.0, 0.0, none, p, none) for v in velocity])


# As the package's nonlinear viscous friction, but with an amount for each direction, as Tables I and II ask for.
_BEND = Effect(
    name="bent_friction",
    label="Friction that bends",
    channel="plant",
    equation=r"\tau = F^{\pm} \mathrm{sign}(\dot q) (|\dot q| / 0.1)^n",
    source="nonlinear viscous friction of each direction, chosen",
    parameters=(
        Parameter("forth", "F^+", "N", text="at 0.1 m/s"),
        Parameter("back", "F^-", "N", text="at 0.1 m/s"),
        Parameter("exponent", "n", "", text="power of the speed"),
    ),
    force=bent_friction,
    no_regressor="of the bench only",
)


def bench_axis(given: Mapping[str, float] | None = None) -> Axis:
    """Table I with both quadrants less what bends, break-away, position dependence and ripple; controller of 2019.

    The bend itself is no effect of the package: the experiments add it.
    """
    n = numbers() if given is None else given
    axis = machine("emps2018-two-quadrant")
    half = {
        name: ((n[f"{name}_less_positive"] + n[f"{name}_less_negative"]) / 2,
               (n[f"{name}_less_positive"] - n[f"{name}_less_negative"]) / 2)
        for name in ("viscous", "coulomb")
    }  # fmt: skip
    (asymmetric,) = axis.to_dict()["effects"]
    effects = [
        {**asymmetric, "viscous_difference": asymmetric["viscous_difference"] - half["viscous"][1]},
        {
            "kind": "stribeck_friction",
            "excess": n["break_away_excess"],
            "stribeck_velocity": n["stribeck_velocity"],
            "exponent": n["stribeck_exponent"],
        },
        {
            "kind": "position_dependent_friction",
            "amplitude": n["position_amplitude"],
            "phase": 0.0,
            "length": n["position_length"],
        },
        {"kind": "position_ripple", "amplitude": n["ripple_amplitude"], "phase": 0.0, "period": n["ripple_period"]},
    ]
    mechanics = {
        "mass": axis.mechanics.mass - n["mass_less"],
        "viscous": axis.mechanics.viscous - half["viscous"][0],
        "coulomb": axis.mechanics.coulomb - half["coulomb"][0],
        "offset": axis.mechanics.offset - half["coulomb"][1],
    }
    controller = {"kind": "position_pd", "kp": n["kp"], "kv": n["kv"]}
    return axis.replace(mechanics=mechanics, effects=effects, controller=controller)


@dataclass(frozen=True)
class Bench:
    """Records of one seed: ``identification`` and ``comanipulation`` experiments, and the break-away test's ``F_s``."""

    seed: int
    numbers: Mapping[str, float]
    axis: Axis
    identification: tuple[Record, ...]
    comanipulation: tuple[Record, ...]
    break_away: tuple[float, float]


def virtual_bench(
    seed: int = 0,
    given: Mapping[str, float] | None = None,
    progress: Progress | None = None,
) -> Bench:
    """Run the twenty experiments and the break-away test of ``seed``; the same seed gives the same bytes.

    ``given`` are the numbers of the bench, :func:`numbers` by default. Friction walks slowly from experiment to
    experiment; the co-manipulation ones come after the identification ones, in a small part of the stroke.
    """
    n = numbers() if given is None else given
    rng = np.random.default_rng(seed)
    count = int(n["experiments"])
    # A mean-reverting walk: neighbouring experiments resemble one another.
    levels, level = [], 0.0
    for _ in range(2 * count):
        level = 0.7 * level + np.sqrt(1.0 - 0.7**2) * n["drift"] * rng.standard_normal()
        levels.append(1.0 + level)
    runs: list[Record] = []
    for index, scale in enumerate(levels):
        kind = "identification" if index < count else "co-manipulation"
        if progress is not None:
            progress(f"{kind} experiment {index % count + 1}", index / (2 * count))
        make = identification_experiment if index < count else comanipulation_experiment
        runs.append(make(n, rng, scale, f"{kind}-{index % count + 1}"))
    axis = bench_axis(n)
    return Bench(
        seed=seed,
        numbers=n,
        axis=axis,
        identification=tuple(runs[:count]),
        comanipulation=tuple(runs[count:]),
        break_away=(break_away_test(axis, 1.0), break_away_test(axis, -1.0)),
    )


def identification_experiment(n: Mapping[str, float], rng: np.random.Generator, scale: float, name: str) -> Record:
    """Follow :func:`identification_trajectory` under the position controller, no external force."""
    axis = bench_axis(n)
    period = axis.sampling.period
    q_ref = identification_trajectory(n, period)
    plant, options = _machine(axis, n, rng, scale, len(q_ref))
    run = plant.closed_loop(q_ref, **options)
    return Record(t=run.t, q_ref=q_ref, q=run.q, u=run.u, period=period, name=name)


def comanipulation_experiment(n: Mapping[str, float], rng: np.random.Generator, scale: float, name: str) -> Record:
    """Ramps and floors of an operator's force on the cascaded loop of Fig. 4; the force reference is not zero."""
    loop = design_velocity_loop(machine("emps2018"), crossover=n["crossover"], phase_margin_deg=n["phase_margin"])
    controller = {"kind": "ip_velocity", "k_v1": loop.k_v1, "t_v": loop.t_v, "k_e1": n["k_e1"]}
    axis = Axis.from_dict({**bench_axis(n).to_dict(), "controller": controller})
    period = axis.sampling.period
    force = operator_force(n, period, rng)
    plant, options = _machine(axis, n, rng, scale, len(force))
    still = np.zeros(len(force))
    reference = np.full(len(force), n["k_e1"] * n["tau_ref"])
    run = plant.closed_loop(still, disturbance=force, reference=reference, q0=n["workspace"], **options)
    sensor = _sensed(n, force, run.v, period) + n["sensor_noise"] * rng.standard_normal(len(force))
    return Record(t=run.t, q_ref=still, q=run.q, u=run.u, f_ext=sensor, period=period, name=name)


def identification_trajectory(n: Mapping[str, float], period: float) -> np.ndarray:
    """Position reference (n,) [m]: trapezoids of velocity, ramps half of the time, at four speeds, forth and back."""
    samples = int(n["duration"] / period)
    pieces: list[np.ndarray] = []
    shares = (1.0, 0.35, 0.7, 0.2)
    while sum(map(len, pieces)) < samples:
        share = shares[(len(pieces) // 2) % len(shares)]
        ramp = int(n["ramp"] / period)
        up = np.linspace(0.0, share * n["speed"], ramp)
        one = np.concatenate([up, np.full(2 * ramp, up[-1]), up[::-1]])
        pieces += [one, -one]
    bell = np.hanning(int(0.03 / period))
    velocity = np.convolve(np.concatenate(pieces)[:samples], bell / bell.sum(), "same")
    return np.cumsum(velocity) * period


def operator_force(n: Mapping[str, float], period: float, rng: np.random.Generator) -> np.ndarray:
    """Force of the operator (n,) [N]: ramps and floors to either side of what balances tau_ref.

    >>> force = operator_force(numbers(hand_duration=40.0), 1e-3, np.random.default_rng(0))
    >>> len(force), bool(abs(force).max() <= 5.0)
    (40000, True)
    """
    samples, level = int(n["hand_duration"] / period), 0.0
    force: list[float] = []
    while len(force) < samples:
        # Forth and back by the same, so that the carriage stays in its small workspace.
        size = rng.uniform(n["hand_least"], 1.0) * n["hand_force"]
        floor = int(rng.uniform(0.6, 1.4) * n["hand_floor"] / period)
        ramp = int(rng.uniform(0.5, 1.5) * n["hand_ramp"] / period)
        for target in (size, -size):
            force += [*np.linspace(level, target, ramp), *np.full(floor, target)]
            level = target
    return np.array(force[:samples]) - n["hand_bias"] * n["tau_ref"]


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


def _machine(
    axis: Axis, n: Mapping[str, float], rng: np.random.Generator, scale: float, samples: int
) -> tuple[Plant, dict[str, Any]]:
    """The bench's machine for one experiment of so many samples, and the options of its simulation."""
    period = axis.sampling.period
    decay = np.exp(-period / n["friction_noise_time"])
    # The size of the noise differs from one experiment to the next, like the lubrication.
    size = n["friction_noise"] * rng.uniform(1.0 - n["friction_noise_spread"], 1.0 + n["friction_noise_spread"])
    noise = _low_passed(size * np.sqrt(1.0 - decay**2) * rng.standard_normal(samples), 1.0, decay)
    # The encoder's zero is another one at every start: so is the phase of what repeats with its turns.
    turned = []
    for one in axis.effects:
        p = dict(one.parameters)
        if {"period", "phase"} <= set(p):
            p["phase"] = float(rng.uniform(-np.pi, np.pi))
        turned.append((get_effect(one.kind), get_effect(one.kind).values(p)))
    bend = np.array([scale * n["bend_positive"], scale * n["bend_negative"], n["bend_exponent"]])
    held = np.concatenate([[1.0 / period, n["friction_noise_speed"]], noise, noise[-1:], noise[-1:]])
    baseline = axis.mechanics.array() * np.array([1.0, scale, scale, 1.0])
    options = {"baseline": baseline, "voltage_noise": n["voltage_noise"] * rng.standard_normal(samples)}
    return Plant(axis, [*turned, (_BEND, bend), (_NOISE, held)]), options


def _sensed(n: Mapping[str, float], force: np.ndarray, v: np.ndarray, period: float) -> np.ndarray:
    """What the sensor between gripper and carriage makes of the operator's force, without its noise."""
    seen = force - n["mass_beyond_sensor"] * np.gradient(v, period)
    if n["sensor_lag"] > 0.0:
        decay = np.exp(-period / n["sensor_lag"])
        seen = seen[0] + _low_passed(seen - seen[0], 1.0 - decay, decay)
    return (1.0 + n["sensor_gain_error"]) * seen + n["sensor_offset"]


def _low_passed(signal: np.ndarray, gain: float, decay: float) -> np.ndarray:
    from scipy.signal import lfilter

    return lfilter([gain], [1.0, -decay], signal)
