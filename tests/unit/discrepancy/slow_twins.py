"""Simulated twins of what others record: slow robots, PLC traces, an arm moved by hand, a shaft that turns for ever."""

import itertools

import numpy as np

from emps_design.axis import Axis
from emps_design.machines import machine
from emps_design.records import Record
from emps_design.simulation import Plant
from emps_design.simulation.environment import Guide
from emps_design.simulation.synthetic import point_to_point

FINE = 1e-3  # s, at which the machine itself runs


def joint(effects=(), mass: float = 3.5, offset: float = 0.0) -> Axis:
    """A robot's joint with harmonic drive: torque command, friction of several newton metres."""
    loop = {"kind": "position_pd", "kp": 25.0, "kv": 25.0 * mass}
    return machine("emps2019").replace(
        name="joint",
        motion="rotary",
        mechanics={"mass": mass, "viscous": 3.0 * mass, "coulomb": 1.4 * mass, "offset": offset},
        drive={"command": "torque", "command_unit": "N m", "force_gain": 1.0, "command_limit": 100.0 * mass},
        sampling={"period": FINE, "encoder_resolution": 1e-5},
        controller=loop,
        effects=list(effects),
    )


def strokes(places, speeds, acceleration: float) -> np.ndarray:
    """A reference from each of ``places`` [rad] to the next, at the ``speeds`` [rad/s] in turn."""
    moves = []
    for (start, stop), speed in zip(itertools.pairwise(places), itertools.cycle(speeds), strict=False):
        moves += [start + np.sign(stop - start) * point_to_point(FINE, abs(stop - start), speed, acceleration)]
        moves += [np.full(200, stop)]
    return np.concatenate(moves)


def logged(run, period: float, noise: float, seed: int, name: str = "log") -> Record:
    """What a log of every so many samples keeps of a ``run``, its command with ``noise``; no reference."""
    every = round(period / run.period)
    q, u = run.q[::every], run.u[::every] + noise * np.random.default_rng(seed).standard_normal(run.q[::every].size)
    return Record(t=period * np.arange(q.size), q_ref=q, q=q, u=u, period=period, name=name, q_ref_recorded=False)


def unknown(axis: Axis, period: float, wrong: float = 1.1) -> Axis:
    """The axis file of who knows neither the law nor the effects, and the mechanics but for a factor."""
    numbers = dict(
        zip(("mass", "viscous", "coulomb", "offset"), (wrong * axis.mechanics.array()).tolist(), strict=True)
    )
    return axis.replace(controller={"kind": "none"}, mechanics=numbers, sampling={"period": period}, effects=[])


def robot(effects=(), period: float = 0.01, seed: int = 0, mass: float = 3.5) -> tuple[Record, Axis]:
    """Some forty seconds of a joint that goes to and fro at several speeds."""
    axis = joint(effects, mass)
    rng = np.random.default_rng(seed)
    places = np.array([0.0, *(rng.choice([-1.0, 1.0]) * (-1.0) ** np.arange(18) * rng.uniform(0.4, 1.3, 18))])
    reference = strokes(places, (0.3, 1.0, 0.6, 1.4), 3.0)
    run = Plant.of(axis).closed_loop(reference)
    return logged(run, period, 0.02 * float(np.std(run.u)), seed), unknown(axis, period)


def moved_by_hand(torque: float, seed: int = 0) -> tuple[Record, Axis]:
    """An arm whose drive carries its weight by the angle, moved by a person."""
    axis = joint([{"kind": "gravity", "torque": torque, "angle": 0.0}], mass=0.06)
    axis = axis.replace(mechanics={"viscous": 0.02, "coulomb": 0.02, "offset": 0.0})
    t, rng = FINE * np.arange(8_000), np.random.default_rng(seed)
    places = sum(rng.uniform(0.3, 1.0) * np.sin(w * t + rng.uniform(0.0, 6.0)) for w in (0.7, 1.9, 3.1))
    way = np.column_stack([places, np.gradient(places, FINE), np.gradient(np.gradient(places, FINE), FINE)])
    arm, u = Plant.of(axis).touched_by(Guide(5.0, 50.0)), torque * np.sin(places)
    for _ in range(3):  # until the drive carries the weight where the arm is
        run = arm.open_loop(u, q0=float(way[0, 0]), v0=float(way[0, 1]), intention=way)
        u = torque * np.sin(run.q)
    return logged(run, 5e-3, 0.003 * torque, seed), unknown(axis, 5e-3)


def endless(seed: int = 0) -> tuple[Record, Axis]:
    """A motor that turns one way for thousands of radians under steps of its torque."""
    axis = joint(mass=1.2e-4)
    axis = axis.replace(
        mechanics={"viscous": 7e-5, "coulomb": 0.02, "offset": 0.0},
        drive={"command_limit": 0.3},
        sampling={"encoder_resolution": 6.3e-4},
    )
    torque = 0.035 + 0.007 * np.sign(np.sin(2 * np.pi * 0.2 * FINE * np.arange(12_000)))
    run = Plant.of(axis).open_loop(torque)
    return logged(run, 2e-3, 2e-4, seed), unknown(axis, 2e-3)
