"""What an effect looks like: its curve over the variable it is best seen in, and its own states along a motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from emps_design.effects.effect import COULOMB, Effect, Parameters

Resolved = Sequence[tuple[Effect, np.ndarray]]  # effects with the arrays of their parameters

_AXES = {
    "v": "velocity [m/s]",
    "q": "position [m]",
    "t": "time [s]",
    "tau": "motor force [N]",
    "u": "recorded voltage [V]",
    "loop": "position [m]",
    "step": "time after a step of the motor force [s]",
}
_LOOP_AMPLITUDE, _LOOP_FREQUENCY = 1e-3, 5.0  # m, Hz: the motion on which effects with own states are drawn
_PASSING = 0.1  # m/s, where the direction matters and the speed does not


def states_along(
    effect: Effect, p: np.ndarray, b: np.ndarray, effects: Resolved, q: np.ndarray, v: np.ndarray, t: np.ndarray
) -> np.ndarray:
    """Own states of ``effect`` (n, n_states) while the carriage follows ``q`` [m], ``v`` [m/s] over ``t`` [s].

    They start at rest; ``effects`` are those whose dry friction adds to the Coulomb level of the moment.
    """
    change, initial = effect.rate, effect.initial
    if change is None or initial is None:
        return np.zeros((q.size, 0))
    from scipy.integrate import solve_ivp
    from scipy.interpolate import CubicHermiteSpline

    start = np.array(initial(q[0], p, b), dtype=float)
    if q.size < 2:
        return start[None, :]
    path = CubicHermiteSpline(t, q, v)
    speed = path.derivative()

    def rate(now: float, x: np.ndarray) -> np.ndarray:
        here, there, dx = float(path(now)), float(speed(now)), np.zeros(start.size)
        dry = [one.dry(here, there, now, 0.0, (), values, b) for one, values in effects if one.dry is not None]
        change(here, there, now, 0.0, x, p, b, max(0.0, b[COULOMB] + sum(dry)), dx)
        return dx

    longest = float(np.diff(t).max())
    return solve_ivp(
        rate, (t[0], t[-1]), start, "LSODA", t_eval=t, rtol=1e-7, atol=1e-10, max_step=longest
    ).y.T  # fmt: skip


@dataclass(frozen=True)
class Curve:
    """What an effect looks like: ``y`` (n,) by line over ``x`` (n,), with labels that carry the units."""

    title: str
    x: np.ndarray = field(repr=False)
    lines: dict[str, np.ndarray] = field(repr=False)
    x_label: str
    y_label: str


def curve(
    effect: Effect,
    parameters: Parameters,
    b: np.ndarray,
    span: tuple[float, float] | None = None,
    points: int = 400,
) -> Curve:
    """Evaluate ``effect`` over the variable it is best seen in (``effect.over``), for the baseline array ``b``.

    ``span`` (lower, upper) of that variable; without it a range that the parameters suggest. Dry friction that does
    not depend on speed gets a line for each direction. Effects with own states are drawn over a sine of 1 mm, 5 Hz.

    >>> from emps_design.effects import get_effect
    >>> drawn = curve(get_effect("elastic_force"), {"stiffness": 50.0, "rest_position": 0.0}, np.zeros(4), (0.0, 0.2))
    >>> drawn.x_label, drawn.y_label, {name: float(y[-1]) for name, y in drawn.lines.items()}
    ('position [m]', 'force [N]', {'extra force': 10.0})
    """
    low, high = span or _span(effect, parameters, b)
    p, x = effect.values(parameters), np.linspace(low, high, points)
    if effect.over == "loop":
        t = np.linspace(0.0, 2.0 / _LOOP_FREQUENCY, points)
        w = 2 * np.pi * _LOOP_FREQUENCY
        q = 0.5 * high * (1 - np.cos(w * t))
        v = 0.5 * high * w * np.sin(w * t)
        states = states_along(effect, p, b, (), q, v, t)
        force = [effect.force(*now, 0.0, own, p, b) for *now, own in zip(q, v, t, states, strict=True)]
        return Curve(effect.label, q, {"force": np.array(force)}, _AXES["loop"], "force [N]")
    if effect.over == "step":
        return Curve(
            effect.label, x, {"acting force": _after_step(effect, p, b, x)}, _AXES["step"], "share of the step"
        )
    label = {"controller": "voltage added [V]", "actuator": "acting voltage [V]", "sensor": "error of position [m]"}
    y_label, line = label.get(effect.channel, "force [N]"), "extra force"
    if effect.channel != "plant":
        line = y_label.split(" [")[0]
    elif effect.force is None and effect.dry is None:
        y_label, line = "added mass [kg]", "added mass"
    directions = {line: 0.0}
    if effect.dry is not None and effect.over != "v":
        directions = {f"{line}, v > 0": _PASSING, f"{line}, v < 0": -_PASSING}
    lines = {
        name: np.array([effect.contribution(parameters, b, **{"v": v, effect.over: value}) for value in x.tolist()])
        for name, v in directions.items()
    }
    return Curve(effect.label, x, lines, _AXES[effect.over], y_label)


def _span(effect: Effect, parameters: Parameters, b: np.ndarray) -> tuple[float, float]:
    """A range of ``effect.over`` that shows the effect: a few of its own lengths, times or voltages."""
    sizes = {one.unit: 0.0 for one in effect.parameters}
    for one in effect.parameters:
        sizes[one.unit] = max(sizes[one.unit], abs(parameters[one.name]))
    if effect.over == "v":
        fastest = 6 * sizes["m/s"] if sizes.get("m/s") else 0.3
        return -fastest, fastest
    if effect.over == "q":
        return 0.0, 2 * sizes["m"] if sizes.get("m") else 0.3
    if effect.over == "tau":
        return -10 * float(b[COULOMB]) - 1.0, 10 * float(b[COULOMB]) + 1.0
    if effect.over == "u":
        return -2 * sizes["V"] - 0.1, 2 * sizes["V"] + 0.1
    if effect.over == "loop":
        return 0.0, _LOOP_AMPLITUDE
    turns = 1 / parameters["frequency"] if "frequency" in parameters else 0.0
    longest = max(sizes.get("s", 0.0), turns)
    return (-longest, 5 * longest + 1e-4) if effect.over == "step" else (0.0, 3 * longest + 1e-4)


def _after_step(effect: Effect, p: np.ndarray, b: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Force that acts after the motor force stepped from 0 to 1 N at t = 0, the carriage held."""
    if effect.delay is not None:
        return np.where(t >= effect.delay(0.0, 0.0, 0.0, 0.0, (), p, b), 1.0, 0.0)
    from scipy.integrate import solve_ivp

    start = np.array(effect.initial(0.0, p, b), dtype=float)

    def rate(now: float, x: np.ndarray) -> np.ndarray:
        dx = np.zeros(start.size)
        effect.rate(0.0, 0.0, now, 1.0, x, p, b, 0.0, dx)
        return dx

    after = t[t >= 0]
    states = solve_ivp(rate, (0.0, after[-1]), start, "LSODA", t_eval=after, rtol=1e-8, atol=1e-10).y.T
    acting = [1.0 - effect.force(0.0, 0.0, now, 1.0, x, p, b) for now, x in zip(after, states, strict=True)]
    return np.concatenate([np.zeros(t.size - after.size), acting])
