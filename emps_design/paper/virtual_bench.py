"""A virtual bench like that of the paper: ten identification and ten co-manipulation experiments from one seed.

The records of the 2018 paper are not public. This machine has the two-quadrant friction of its Table I, and further
effects of such a machine, chosen so that tables and errors are as printed: nonlinear friction, break-away, friction
that depends on position and drifts between experiments, noise of the friction, an encoder, and a force sensor with a
gripper in front of it. ``NUMBERS`` has every number with its unit, its origin (the paper or chosen), and the reason;
``benchmarks/table_2.py`` shows by a sweep which of them determine Table II. :func:`reproduce_section_3` evaluates the
bench as in section III: Tables I and II, the errors, and the curves of Figs. 3 to 10.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import scipy

from emps_design.axis import Axis
from emps_design.control.velocity.design import design_velocity_loop
from emps_design.effects import Effect, Parameter, get_effect
from emps_design.errors import InputError, nearest_name
from emps_design.identification.chains import Filtered, paper_chain
from emps_design.identification.inverse_model import regression
from emps_design.identification.observation import direct_validation
from emps_design.identification.result import Identification
from emps_design.identification.several import SeveralIdentifications, identify_several
from emps_design.machines import machine
from emps_design.messages import warning
from emps_design.paper.written import BREAK_AWAY, RANGES, TABLES
from emps_design.progress import Progress
from emps_design.quantities import Quantity
from emps_design.records import Record
from emps_design.simulation import Plant
from emps_design.view import Table, View, Viewed

PAPER, CHOSEN = "paper", "chosen"

MODEL = "asymmetric"

# For comparison with the bench's results: never used in a computation.
PRINTED: dict[str, Any] = {**TABLES, **RANGES, "break_away": BREAK_AWAY}


@dataclass(frozen=True)
class BenchNumber:
    """A number of the bench: ``value``, ``unit``, whether it is the ``paper`` 's or ``chosen``, and the reason."""

    value: float
    unit: str
    origin: str
    reason: str


def _of_paper(value: float, unit: str, reason: str) -> BenchNumber:
    return BenchNumber(value, unit, PAPER, reason)


def _chosen(value: float, unit: str, reason: str) -> BenchNumber:
    return BenchNumber(value, unit, CHOSEN, reason)


NUMBERS: dict[str, BenchNumber] = {
    "experiments": _of_paper(10, "", "ten of each kind, sections III-A and III-B"),
    "crossover": _of_paper(100.0, "rad/s", "velocity loop, section II-C"),
    "phase_margin": _chosen(60.0, "deg", "the paper gives none"),
    "bend_positive": _chosen(31.3, "N", "at 0.1 m/s: Table II's F_v+ at low speed is above Table I's"),
    "bend_negative": _chosen(49.1, "N", "at 0.1 m/s: Table II's F_v- at low speed is well above Table I's"),
    "bend_exponent": _chosen(0.45, "", "steep near rest, then flatter, as with shear thinning of grease"),
    "viscous_less_positive": _chosen(339.4, "N/(m/s)", "so that the identified F_v+ is that of Table I"),
    "viscous_less_negative": _chosen(571.5, "N/(m/s)", "so that the identified F_v- is that of Table I"),
    "coulomb_less_positive": _chosen(7.52, "N", "so that the identified F_c+ is that of Table I"),
    "coulomb_less_negative": _chosen(11.04, "N", "so that the identified F_c- is that of Table I"),
    "mass_less": _chosen(1.3, "kg", "so that the identified mass is that of Table I, reversals included"),
    "break_away_excess": _chosen(7.1, "N", "so that the test at rest gives the F_s of 17 N of section III-A"),
    "stribeck_velocity": _chosen(0.0005, "m/s", "the excess of a ball screw vanishes within a few mm/s"),
    "stribeck_exponent": _chosen(1.0, "", "the paper allows 1 to 2"),
    "position_amplitude": _chosen(5.5, "N", "friction is higher in the workspace of the operator: RMS_2 of 3.9-5.4 N"),
    "position_length": _chosen(0.35, "m", "long, so that friction is constant within each small workspace"),
    "ripple_amplitude": _chosen(1.5, "N", "1 N at 2.5 mm in the 2019 record of the same machine, here older"),
    "ripple_period": _chosen(0.0025, "m", "one revolution, from the 2019 record of the same machine"),
    "friction_noise": _chosen(1.78, "N", "gives a direct validation error of 2.7-3.4 N"),
    "friction_noise_spread": _chosen(0.13, "", "of the noise between experiments: from the width of the ranges"),
    "friction_noise_speed": _chosen(0.0152, "m/s", "at which the noise has doubled: gives RMS_1 of 3.6-5.3 N"),
    "friction_noise_time": _chosen(0.06, "s", "slow enough to pass the filters, like the residual of 2019"),
    "drift": _chosen(0.015, "", "std of the friction from one experiment to the next: lubrication, temperature"),
    "voltage_noise": _chosen(0.004, "V", "3.7 mV in the 2019 record"),
    "sensor_noise": _chosen(0.05, "N", "1 % of the sensor's range; the paper calls it insignificant"),
    "sensor_gain_error": _chosen(0.0, "", "the paper assumes that the sensor force is the real one"),
    "sensor_lag": _chosen(0.0, "s", "first-order; the paper gives none"),
    "sensor_offset": _chosen(1.02, "N", "zero of the sensor, or the pull of a cable, from day to day"),
    "mass_beyond_sensor": _chosen(8.75, "kg", "gripper in front of the sensor"),
    "kp": _chosen(160.18, "1/s", "position controller of 2019; the paper gives none"),
    "kv": _chosen(243.45, "V/(m/s)", "position controller of 2019; the paper gives none"),
    "speed": _chosen(0.04, "m/s", "of the trajectory; from the ratio of the deviations of F_v and F_c in Table I"),
    "ramp": _chosen(0.1, "s", "of the trajectory; from the ratio of the deviations of M and F_c in Table I"),
    "duration": _chosen(40.0, "s", "of identification; from the ratio of the deviations of Table I and RMS_1"),
    "workspace": _chosen(0.04, "m", "start of co-manipulation: away from the place of identification"),
    "hand_duration": _chosen(
        110.0, "s", "of co-manipulation; from the ratio of the deviations and the RMS error of Table II"
    ),
    "hand_force": _chosen(2.5, "N", "largest step to either side of the force that keeps the carriage at rest"),
    "hand_least": _chosen(0.2, "", "smallest such step over the largest"),
    "hand_bias": _chosen(
        1.0, "", "share of tau_ref that the hand balances; Table II shows equal speeds in both directions"
    ),
    "hand_ramp": _chosen(0.2, "s", "mean ramp of the operator's force, 0.5 to 1.5 times that"),
    "hand_floor": _chosen(0.65, "s", "mean duration of constant operator force, 0.6 to 1.4 times that"),
    "k_e1": _chosen(0.005, "(m/s)/N", "low on purpose, as in the paper: the deviations of Table II give the speed"),
    "tau_ref": _of_paper(2.5, "N", "not zero, for a force at any time (III-B); its size is chosen, half the range"),
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
    equation=r"\tau = n(t)",
    source="first-order autoregressive, chosen",
    parameters=(
        Parameter("rate", "1/T", "Hz", text="samples in a second"),
        Parameter("doubling", "v_2", "m/s", text="speed at which the noise has doubled; the samples [N] follow"),
    ),
    force=friction_noise,
)


def bent_friction(q: float, v: float, t: float, tau: float, x: np.ndarray, p: np.ndarray, b: np.ndarray) -> float:
    """Kernel: ``p[0]`` or ``p[1]`` [N] at 0.1 m/s to + or -, to the power ``p[2]`` of the speed; odd near rest."""
    amount = p[0] if v > 0.0 else p[1]
    return amount * (v / 0.1) * ((v * v + 1e-8) / 0.01) ** (0.5 * (p[2] - 1.0))


def bend_of(velocity: np.ndarray, bench_numbers: Mapping[str, float] | None = None) -> np.ndarray:
    """Force of the bend [N] at velocities (n,) [m/s]."""
    n = numbers() if bench_numbers is None else bench_numbers
    p, none = np.array([n["bend_positive"], n["bend_negative"], n["bend_exponent"]]), np.zeros(0)
    return np.array([bent_friction(0.0, v, 0.0, 0.0, none, p, none) for v in velocity])


# Like nonlinear_viscous_friction, but with one amplitude for each direction, as in Tables I and II.
_BEND = Effect(
    name="bent_friction",
    label="Curved friction characteristic",
    equation=r"\tau = F^{\pm} \mathrm{sign}(\dot q) (|\dot q| / 0.1)^n",
    source="nonlinear viscous friction of each direction, chosen",
    parameters=(
        Parameter("forth", "F^+", "N", text="at 0.1 m/s"),
        Parameter("back", "F^-", "N", text="at 0.1 m/s"),
        Parameter("exponent", "n", "", text="power of the speed"),
    ),
    force=bent_friction,
)


def bench_axis(bench_numbers: Mapping[str, float] | None = None) -> Axis:
    """Axis of Table I, both quadrants, with break-away, position dependence and ripple; controller of 2019.

    Its viscous and Coulomb friction are reduced by the share of the bent friction, which the experiments add.
    """
    n = numbers() if bench_numbers is None else bench_numbers
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
    bench_numbers: Mapping[str, float] | None = None,
    progress: Progress | None = None,
) -> Bench:
    """Run the twenty experiments and the break-away test of ``seed``; the same seed gives the same bytes.

    ``bench_numbers`` are the numbers of the bench, :func:`numbers` by default. Friction drifts slowly from one
    experiment to the next; the co-manipulation ones come after the identification ones, in a small part of the stroke.
    """
    n = numbers() if bench_numbers is None else bench_numbers
    rng = np.random.default_rng(seed)
    count = int(n["experiments"])
    # First-order autoregressive: neighbouring experiments resemble one another.
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
    sensor = _sensor_reading(n, force, run.v, period) + n["sensor_noise"] * rng.standard_normal(len(force))
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
        trapezoid = np.concatenate([up, np.full(2 * ramp, up[-1]), up[::-1]])
        pieces += [trapezoid, -trapezoid]
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
    moving = np.flatnonzero(np.abs(run.position - run.position[0]) > 2e-6)
    return float(gain * abs(u[moving[0]]))


def _machine(
    axis: Axis, n: Mapping[str, float], rng: np.random.Generator, scale: float, samples: int
) -> tuple[Plant, dict[str, Any]]:
    """The bench's machine for one experiment of so many samples, and the options of its simulation."""
    period = axis.sampling.period
    decay = np.exp(-period / n["friction_noise_time"])
    # The size of the noise differs from one experiment to the next, like the lubrication.
    size = n["friction_noise"] * rng.uniform(1.0 - n["friction_noise_spread"], 1.0 + n["friction_noise_spread"])
    noise = _low_passed(size * np.sqrt(1.0 - decay**2) * rng.standard_normal(samples), 1.0, decay)
    # The encoder's zero differs at every start: so is the phase of every ripple.
    turned = []
    for entry in axis.effects:
        p = dict(entry.parameters)
        if {"period", "phase"} <= set(p):
            p["phase"] = float(rng.uniform(-np.pi, np.pi))
        turned.append((get_effect(entry.kind), get_effect(entry.kind).values(p)))
    bend = np.array([scale * n["bend_positive"], scale * n["bend_negative"], n["bend_exponent"]])
    held = np.concatenate([[1.0 / period, n["friction_noise_speed"]], noise, noise[-1:], noise[-1:]])
    baseline = axis.mechanics.array() * np.array([1.0, scale, scale, 1.0])
    options = {"baseline": baseline, "voltage_noise": n["voltage_noise"] * rng.standard_normal(samples)}
    return Plant(axis, [*turned, (_BEND, bend), (_NOISE, held)]), options


def _sensor_reading(n: Mapping[str, float], force: np.ndarray, v: np.ndarray, period: float) -> np.ndarray:
    """Reading (n,) [N] of the sensor between gripper and carriage for the operator's ``force``, without noise."""
    reading = force - n["mass_beyond_sensor"] * np.gradient(v, period)
    if n["sensor_lag"] > 0.0:
        decay = np.exp(-period / n["sensor_lag"])
        reading = reading[0] + _low_passed(reading - reading[0], 1.0 - decay, decay)
    return (1.0 + n["sensor_gain_error"]) * reading + n["sensor_offset"]


def _low_passed(signal: np.ndarray, gain: float, decay: float) -> np.ndarray:
    return scipy.signal.lfilter([gain], [1.0, -decay], signal)


@dataclass(frozen=True)
class SectionThree(Viewed):
    """Results of section III: identification of ten, observation of ten others, direct validation of these.

    ``rms_1``, ``rms_2``, ``rms_direct`` (10,) [N] as the paper defines them; ``table_1`` and ``table_2`` rows of
    (value, 2 sigma, 100 * 2 sigma / |value|), as its tables print them.
    """

    bench: Bench = field(repr=False)
    identification: SeveralIdentifications = field(repr=False)
    direct: tuple[Identification, ...] = field(repr=False)
    rms_1: np.ndarray
    rms_2: np.ndarray
    rms_direct: np.ndarray

    @property
    def table_1(self) -> dict[str, tuple[float, float, float]]:
        """The first experiment's parameters."""
        return _table(self.identification.identifications[0])

    @property
    def table_2(self) -> dict[str, tuple[float, float, float]]:
        """Parameters of direct validation on the first co-manipulation experiment."""
        return _table(self.direct[0])

    def observed(self, index: int = 0) -> dict[str, np.ndarray]:
        """Curves of Figs. 8 to 10 for co-manipulation experiment ``index``: t [s] and forces [N]."""
        record = self.bench.comanipulation[index]
        filtered, W, motor, sensor = _filtered_regression(record, self.bench)
        mean = self.identification.values.mean(axis=0)
        values = self.direct[index].values()
        return {
            "t": filtered.t,
            "sensor": sensor,
            "cross": W @ mean - motor,
            "direct": W @ values - motor,
            "motor": motor,
            "model": W @ values,
        }

    def to_dict(self) -> dict[str, Any]:
        """Plain data, with what the paper printed beside it."""
        return {
            "scenario": "bench",
            "axis": self.bench.axis.name,
            "seed": self.bench.seed,
            "numbers": dict(self.bench.numbers),
            "table_1": {name: list(row) for name, row in self.table_1.items()},
            "table_2": {name: list(row) for name, row in self.table_2.items()},
            "rms_1": self.rms_1.tolist(),
            "rms_2": self.rms_2.tolist(),
            "rms_direct": self.rms_direct.tolist(),
            "break_away": list(self.bench.break_away),
            "printed": PRINTED,
            "warnings": [
                warning(
                    "records-not-public",
                    "the paper's records are not public: a machine with its Table I, other numbers chosen so that its "
                    "errors come out alike",
                )
            ],
        }

    def view(self) -> View:
        """Tables I and II and the errors, beside those printed."""
        headings = ("parameter", "value", "2 sigma", "% sigma", "printed", "2 sigma", "% sigma")
        tables = [
            Table(headings, [(name.replace("_", " "), *row, *PRINTED[key][name]) for name, row in found.items()], title)
            for key, title, found in (("table_1", "Table I", self.table_1), ("table_2", "Table II", self.table_2))
        ]
        rows = [
            (title, f"{errors.min():.2f} to {errors.max():.2f}", "{:g} to {:g}".format(*PRINTED[key]))
            for key, title, errors in (
                ("rms_1", "identification", self.rms_1),
                ("rms_2", "observation", self.rms_2),
                ("rms_direct", "direct validation", self.rms_direct),
            )
        ]
        rows.append(("break-away forth", f"{self.bench.break_away[0]:.2f}", f"{PRINTED['break_away']:g}"))
        errors = Table(("", "found", "printed"), rows, "Errors [N], least and largest of ten", ("found", "printed"))
        return *tables, errors


def reproduce_section_3(
    seed: int = 0,
    bench_numbers: Mapping[str, float] | None = None,
    progress: Progress | None = None,
) -> SectionThree:
    """Run the virtual bench of ``seed`` and evaluate it with the paper's chain of filters.

    ``bench_numbers`` are the numbers of the bench, :func:`emps_design.paper.virtual_bench.numbers` by default.
    """
    bench = virtual_bench(seed, bench_numbers, progress)
    # The paper uses G_tau alone, and the current loop is a gain.
    ideal = bench.axis.replace(effects=[], drive={"current_time_constant": 0.0})
    several = identify_several(bench.identification, ideal, model=MODEL, filter="paper")
    mean = several.values.mean(axis=0)
    cross, direct = [], []
    for record in bench.comanipulation:
        _, W, motor, sensor = _filtered_regression(record, bench)
        cross.append(float(np.sqrt(np.mean((W @ mean - motor - sensor) ** 2))))
        direct.append(direct_validation(record, ideal, model=MODEL, filter="paper"))
    return SectionThree(
        bench=bench,
        identification=several,
        direct=tuple(direct),
        rms_1=np.diag(several.cross_validation).copy(),
        rms_2=np.array(cross),
        rms_direct=np.array([validation.rms_error for validation in direct]),
    )


def _filtered_regression(record: Record, bench: Bench) -> tuple[Filtered, np.ndarray, np.ndarray, Any]:
    """The filtered record, its regressor (m, 5), motor force (m,) and sensor force (m,) [N]."""
    filtered = paper_chain(record, bench.axis.drive.force_gain)
    W, _ = regression(filtered, MODEL)
    return filtered, W, filtered.force, filtered.f_ext


def _table(identification: Identification) -> dict[str, tuple[float, float, float]]:
    return {
        name: _row(estimate.quantity, estimate.value, estimate.std)
        for name, estimate in identification.parameters.items()
    }


def _row(quantity: Quantity, value: float | None, std: float | None) -> tuple[float, float, float]:
    if value is None or std is None:
        return (float("nan"),) * 3
    return value, 2.0 * std, 200.0 * std / abs(value)
