"""End stop: a one-sided spring that the carriage touches at a position.

``side`` is +1 for a stop at the upper end (it acts above ``position``) and -1 for one at the lower end.
"""

import numpy as np

from emps_design.effects.effect import Claims, Effect, Motion, Parameter, Parameters, Search, Solver, Words

PARAMETERS = (
    Parameter("stiffness", "k", "N/m", lower=0.0, linear=True, scale=1000.0, text="stiffness of the buffer"),
    Parameter("position", "q_s", "m", -10.0, 10.0, starts=(0.0, 0.05, 0.1, 0.15, 0.2, 0.25),
              text="position at which the carriage touches"),
    Parameter("side", "s", "", -1.0, 1.0, starts=(-1.0, 1.0), discrete=True, text="+1: upper stop, -1: lower stop"),
)  # fmt: skip


def force(q, v, t, tau, x, p, b):
    return p[0] * max(0.0, p[2] * (q - p[1])) * p[2]


def guard(q, v, t, tau, x, p, b):
    return q - p[1]


def regressor(motion: Motion, shape: Parameters, b: np.ndarray) -> np.ndarray:
    side = shape["side"]
    return motion.smooth(np.maximum(0.0, side * (motion.q - shape["position"])) * side)[:, None]


def propose(motion: Motion, residual: np.ndarray, b: np.ndarray, away: np.ndarray) -> list[dict[str, float]]:
    low, high = float(motion.q.min()), float(motion.q.max())
    depths = [share * (high - low) for share in (0.02, 0.06, 0.15, 0.3)]
    ends = ((1.0, high), (-1.0, low))
    return [{"position": end - side * depth, "side": side} for side, end in ends for depth in depths]


def plausible(parameters: Parameters, motion: Motion) -> bool:
    pressed = parameters["side"] * (motion.q - parameters["position"]) > 0
    return 0.0 < float(np.mean(pressed)) < 0.4  # more is a spring, not a stop


def expression(q, v, t, tau, p, b):
    import sympy

    return p["stiffness"] * p["side"] * sympy.Max(0, p["side"] * (q - p["position"]))


EFFECT = Effect(
    name="end_stop",
    label="End stop",
    equation=r"F = s\,k\,\max(0,\, s\,(q - q_s))",
    source="unilateral spring: the rubber buffer at the end of the guide",
    parameters=PARAMETERS,
    force=force,
    over="q",
    regressor=regressor,
    expression=expression,
    solver=Solver(guard=guard),
    search=Search(propose=propose, plausible=plausible, confused_with=("elastic_force", "position_dependent_friction")),
    words=Words(
        where="beyond one position, at one end of the travel, increasing towards the end",
        experiment="repeat the record over a shorter travel that does not reach the suspected end",
        remedy="shorten the travel, move the stop, or limit the reference ahead of it",
    ),
    claims=Claims(parity="even", passive=True),
    checks=(
        ({"stiffness": 1200.0, "position": 0.2, "side": 1.0}, {"q": 0.25}, 60.0),
        ({"stiffness": 1200.0, "position": 0.2, "side": -1.0}, {"q": 0.15}, -60.0),
    ),
)
