"""External force: pulses of ``duration`` that push the carriage, once or periodically.

A positive amplitude pushes towards +q, so the kernel, which is on the side of the friction, returns a negative force.
``every`` is the time from one pulse to the next; if it is not longer than the pulse, such as 0, there is one pulse.
"""

from math import floor, inf

import numpy as np

from emps_design.effects import guesses as search
from emps_design.effects.effect import SNAP, Claims, Effect, Motion, Parameter, Parameters, Search, Solver, Words

ALIKE = 1e-3  # of the variance of the position, up to which two laps are one motion
PARAMETERS = (
    Parameter("amplitude", "A", "N", linear=True, scale=20.0, text="force on the carriage, positive towards +q"),
    Parameter("start", "t_0", "s", lower=0.0, per_record=True, scale=0.1, text="start of the first pulse"),
    Parameter("duration", "D", "s", lower=1e-3, starts=(0.1, 0.25, 0.5, 1.0), text="length of a pulse"),
    Parameter("every", "T", "s", lower=0.0, per_record=True, scale=0.1,
              text="time from one pulse to the next, 0: a single pulse"),
)  # fmt: skip


def force(q, v, t, tau, x, p, b):
    since = t - p[1] + SNAP
    if since < 0.0:
        return 0.0
    if p[3] > p[2]:
        since -= p[3] * floor(since / p[3])
    if since < p[2]:
        return -p[0]
    return 0.0


def jump_time(q, v, t, tau, x, p, b):
    since = t - p[1] + SNAP
    if since < 0.0:
        return p[1]
    rise = 0.0
    if p[3] > p[2]:
        rise = p[3] * floor(since / p[3])
    if since - rise < p[2]:
        return p[1] + rise + p[2]
    if p[3] > p[2]:
        return p[1] + rise + p[3]
    return inf


def regressor(motion: Motion, shape: Parameters, b: np.ndarray) -> np.ndarray:
    since = motion.t - shape["start"] + SNAP
    folded = np.mod(since, shape["every"]) if shape["every"] > shape["duration"] else since
    return -motion.smooth(((since >= 0) & (folded < shape["duration"])).astype(float))[:, None]


def propose(motion: Motion, residual: np.ndarray, b: np.ndarray, away: np.ndarray) -> list[dict[str, float]]:
    # The residual is positive against the motor, the pulse towards +q.
    return search.pulses(-residual, motion.t, motion.period)


def plausible(parameters: Parameters, motion: Motion) -> bool:
    every = parameters["every"] or float(motion.t[-1])
    if parameters["duration"] >= 0.5 * every:
        return False  # a constant force with gaps
    later = round(every / motion.period)
    if not 0 < later < motion.q.size // 2:
        return True
    difference = motion.q[later:] - motion.q[:-later]
    return float(np.var(difference)) > ALIKE * float(np.var(motion.q))  # else synchronous with laps: depends on q


def expression(q, v, t, tau, p, b):
    import sympy

    since = t - p["start"]
    folded = sympy.Piecewise((sympy.Mod(since, p["every"]), p["every"] > p["duration"]), (since, True))
    return -p["amplitude"] * sympy.Piecewise((1, (since >= 0) & (folded < p["duration"])), (0, True))


EFFECT = Effect(
    name="external_force",
    label="External force",
    equation=r"F = -A \;\text{ for } t \in [t_0 + k T,\, t_0 + k T + D),\quad k \ge 0",
    source="the external force of paper eq. (2), as pulses; the pulses of DATA_EMPS_PULSES enter at the controller",
    parameters=PARAMETERS,
    force=force,
    over="t",
    regressor=regressor,
    expression=expression,
    solver=Solver(jump_time=jump_time),
    search=Search(
        propose=propose,
        plausible=plausible,
        confused_with=("periodic_disturbance", "friction_drift", "controller_disturbance"),
    ),
    words=Words(
        where="within intervals of time, at any position and speed",
        experiment="repeat the same lap: a force that acts at other places of the lap is external",
        remedy="find the source; the observer gives the force in real time",
    ),
    claims=Claims(parity="even"),
    checks=(
        ({"amplitude": 30.0, "start": 2.3, "duration": 0.25, "every": 5.3}, {"t": 7.7}, -30.0),
        ({"amplitude": 30.0, "start": 2.3, "duration": 0.25, "every": 0.0}, {"t": 7.7}, 0.0),
        ({"amplitude": 30.0, "start": 2.3, "duration": 0.25, "every": 1e-20}, {"t": 7.7}, 0.0),
    ),
)
