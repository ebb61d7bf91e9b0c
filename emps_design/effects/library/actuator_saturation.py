"""Actuator saturation: the acting voltage stays within +-limit, whatever the controller commands.

A current limit of the amplifier below the voltage limit that the controller knows. The recorded voltage is the command
and may exceed the limit. The limit is symmetric. There is no regressor: the lost force depends on the command alone,
and only where the command exceeds the limit.
"""

import numpy as np

from emps_design.effects.effect import Effect, Motion, Parameter, Search, Words

PARAMETERS = (
    Parameter("limit", r"u_{max}", "V", 0.05, 100.0, starts=(2.0, 3.0, 4.0, 6.0, 8.0),
              text="largest acting voltage"),
)  # fmt: skip


def actuator(u, p):
    return max(-p[0], min(p[0], u))


def propose(motion: Motion, residual: np.ndarray, b: np.ndarray, away: np.ndarray) -> list[dict[str, float]]:
    # With a loop at its limit, the minimum of the residual over the limit is only a few percent wide.
    largest = float(np.abs(np.asarray(motion.voltage)).max())
    return [{"limit": float(limit)} for limit in largest * np.geomspace(0.98, 0.25, 40)]


def expression(q, v, t, tau, p, b):
    import sympy

    return sympy.Max(-p["limit"], sympy.Min(p["limit"], tau))


EFFECT = Effect(
    name="actuator_saturation",
    label="Actuator saturation",
    channel="actuator",
    equation=r"u_a = \max(-u_{max}, \min(u_{max}, u))",
    source="current limit of the amplifier; peak current in the data sheet of a drive",
    parameters=PARAMETERS,
    actuator=actuator,
    over="u",
    expression=expression,
    search=Search(propose=propose, confused_with=("mass_change", "end_stop", "actuator_lag")),
    words=Words(
        where="while the command is large, after a fast change of the reference: the acceleration does not follow it",
        experiment="the same stroke at half the acceleration: below the limit the residual disappears",
        remedy="limit the acceleration of the reference to what the limit allows, and put the limit in the anti-windup",
    ),
    checks=(
        ({"limit": 3.5}, {"u": 5.0}, 3.5),
        ({"limit": 3.5}, {"u": -1.0}, -1.0),
    ),
)
