"""Simulated twins of what others log: robots and traces of 10 to 50 ms, by a clock of their own, without a law."""

import itertools

import numpy as np

from emps_design.axis import Axis
from emps_design.machines import machine
from emps_design.records import Record
from emps_design.records.clock import on_one_clock
from emps_design.simulation import Plant
from emps_design.simulation.synthetic import point_to_point

FINE = 1e-3  # s, at which the machine itself runs
WEIGHT = {"kind": "gravity", "torque": 37.0, "angle": 3.0}


def joint(effects=(), mass: float = 3.5, viscous: float = 10.5, coulomb: float = 5.0, offset: float = 0.0) -> Axis:
    """A robot's joint with harmonic drive: torque command, friction of several newton metres."""
    return machine("emps2019").replace(
        name="joint",
        motion="rotary",
        mechanics={"mass": mass, "viscous": viscous, "coulomb": coulomb, "offset": offset},
        drive={"command": "torque", "command_unit": "N m", "force_gain": 1.0, "command_limit": 100.0 * mass},
        sampling={"period": FINE, "encoder_resolution": 1e-5},
        controller={"kind": "position_pd", "kp": 25.0, "kv": 25.0 * mass},
        effects=list(effects),
    )


def strokes(places, speeds, acceleration: float) -> np.ndarray:
    """A reference from each of ``places`` [rad] to the next, at the ``speeds`` [rad/s] in turn."""
    moves = []
    for (start, stop), speed in zip(itertools.pairwise(places), itertools.cycle(speeds), strict=False):
        moves += [start + np.sign(stop - start) * point_to_point(FINE, abs(stop - start), speed, acceleration)]
        moves += [np.full(200, stop)]
    return np.concatenate(moves)


def logged(run, period: float, noise: float, random, irregular: bool = False) -> Record:
    """What a log of every ``period`` [s] keeps of a ``run``: instants of the motion and of the command, with ``noise``.

    An ``irregular`` clock is late by up to a third of a period, and by as much as it says.
    """
    late = random.integers(0, round(period / FINE / 3) + 1, int(run.q.size * FINE / period)) if irregular else 0
    places = np.arange(0, run.q.size, round(period / FINE))[: int(run.q.size * FINE / period)] + late
    places = places[places < run.q.size]
    signals = {"t": FINE * (places - places[0]), "q": run.q[places], "u": run.u[places]}
    signals["u"] = signals["u"] + noise * random.standard_normal(places.size)
    notes: tuple[str, ...] = ()
    if irregular:
        period, notes, resampled = on_one_clock(signals, period, "log", 1)
        signals = signals if resampled is None else resampled.signals
    t = period * np.arange(signals["q"].size)
    q, u = signals["q"], signals["u"]
    return Record(t=t, q_ref=q, q=q, u=u, period=period, name="log", warnings=notes, q_ref_recorded=False)


def unknown(axis: Axis, period: float, wrong: float = 1.1) -> Axis:
    """The axis file of who knows neither the law nor the effects, and the mechanics but for a factor."""
    numbers = dict(
        zip(("mass", "viscous", "coulomb", "offset"), (wrong * axis.mechanics.array()).tolist(), strict=True)
    )
    return axis.replace(controller={"kind": "none"}, mechanics=numbers, sampling={"period": period}, effects=[])


def robot(
    axis: Axis, period: float = 0.01, seed: int = 0, irregular: bool = False, noise: float = 0.02, count: int = 11
) -> tuple[Record, Axis]:
    """The log of ``axis`` on ``count`` strokes to and fro at several speeds, and the file of who knows little of it.

    ``noise`` of the logged command, as a share of it.
    """
    random = np.random.default_rng(seed)
    sides = random.choice([-1.0, 1.0]) * (-1.0) ** np.arange(count)
    places = np.array([0.0, *(sides * random.uniform(0.4, 1.3, count))])
    run = Plant.of(axis).closed_loop(strokes(places, (0.3, 1.0, 0.15, 0.6, 2.0), 3.0))
    record = logged(run, period, noise * float(np.std(run.u)), random, irregular)
    return record, unknown(axis, record.period)


KINDS = ("nothing", "coulomb", "gravity", "asymmetric_viscous_friction", "nonlinear_viscous_friction")


def drawn(seed: int, kind: str) -> tuple[Record, Axis, Axis]:
    """A joint drawn at random that has what ``kind`` says: its log at 50 or 100 Hz, its axis file, and itself.

    Of "nothing" and "coulomb" the axis file is right but for noise, or has two thirds of the Coulomb friction.
    """
    random = np.random.default_rng(seed)
    mass = float(np.exp(random.uniform(np.log(0.3), np.log(30.0))))
    viscous, coulomb = mass * random.uniform((1.0, 0.5), (6.0, 3.0))
    offset, period, irregular = 0.3 * coulomb * random.normal(), random.choice([0.01, 0.02]), random.random() < 0.5
    resists, effects = coulomb + 0.6 * viscous, []
    if kind == "gravity":
        effects = [{"kind": kind, "torque": resists * random.uniform(0.5, 5.0), "angle": random.uniform(-3.1, 3.1)}]
    elif kind == "asymmetric_viscous_friction":
        effects = [{"kind": kind, "viscous_difference": viscous * random.choice([-1, 1]) * random.uniform(0.3, 0.7)}]
    elif kind == "nonlinear_viscous_friction":
        power = random.uniform(0.4, 0.6)
        effects = [{"kind": kind, "amount": (viscous + coulomb) * 0.1**power, "exponent": power}]
        viscous, coulomb = 0.0, 0.3 * coulomb
    axis = joint(effects, mass, viscous, float(coulomb), float(offset))
    record, known = robot(axis, float(period), seed, bool(irregular), random.uniform(0.005, 0.03), 18)
    wrong = {"coulomb": float(coulomb) / 1.5} if kind == "coulomb" else {}
    known = known.replace(mechanics=dict(axis.mechanics.model_dump()) | wrong)
    return record, known, axis


def moved_by_hand(torque: float, period: float = 0.01, seed: int = 0) -> tuple[Record, Axis]:
    """An arm that a person moves, whose motor does nothing but carry its weight."""
    random, t = np.random.default_rng(seed), np.arange(0.0, 12.0, period)
    q = sum(random.uniform(0.3, 1.0) * np.sin(w * t + random.uniform(0.0, 6.0)) for w in (0.7, 1.9, 3.1))
    u = torque * np.sin(q) + 0.002 * torque * random.standard_normal(t.size)
    record = Record(t=t, q_ref=q, q=q, u=u, period=period, name="hand", q_ref_recorded=False)
    return record, unknown(joint(mass=0.06, viscous=0.02, coulomb=0.02), period)


def endless(seed: int = 0) -> tuple[Record, Axis]:
    """A motor that turns one way for hundreds of radians under steps of its torque."""
    axis = joint(mass=1.2e-3, viscous=4e-4, coulomb=0.02)
    axis = axis.replace(sampling={"encoder_resolution": 6.3e-4}, drive={"command_limit": 0.3})
    torque = 0.035 + 0.007 * np.sign(np.sin(2 * np.pi * 0.2 * FINE * np.arange(20_000)))
    run = Plant.of(axis).open_loop(torque)
    return logged(run, 0.01, 2e-4, np.random.default_rng(seed)), unknown(axis, 0.01)
