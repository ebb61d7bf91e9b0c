"""Presliding friction: before sliding the contact deflects like a spring with hysteresis (Dahl).

F = stiffness z, dz/dt = v - |v| stiffness z / L, with the present Coulomb level L: a spring for small travel, Coulomb
friction L sign(v) after a travel of about 3 L / stiffness. It replaces the set-valued friction, so the carriage never
sticks completely. If other effects reduce the level to zero, the deflection decays over a travel of ``FORGET``. The
deflection is at least ``FINEST``: no encoder resolves less.
"""

from emps_design.effects.effect import Claims, Effect, Parameter, Search, Solver, Words
from emps_design.quantities import Quantity

FORGET = 1e-4  # m
FINEST = 1e-9  # m
SETTLED = 1e-9  # of the full deflection: closer to it the contact counts as sliding, and steps may be long
PARAMETERS = (
    Parameter("stiffness", r"\sigma", "N/m", 1e3, 1e8, starts=(2e4, 1e5, 5e5, 2e6),
              text="stiffness of the contact before it slides"),
)  # fmt: skip


def force(q, v, t, tau, x, p, b):
    return p[0] * x[0]


def rate(q, v, t, tau, x, p, b, level, dx):
    if level > 0.0:
        full = level / p[0]
        change = v * full - abs(v) * x[0]
        dx[0] = change / max(full, FINEST) if abs(change) > SETTLED * abs(v) * full else 0.0
    else:
        dx[0] = -abs(v) * x[0] / FORGET


EFFECT = Effect(
    name="presliding_friction",
    label="Presliding friction",
    equation=r"F = \sigma z,\quad \dot z = \dot q - |\dot q|\, \sigma z / L",
    source="P. R. Dahl, A solid friction model, Aerospace Corporation, 1968",
    parameters=PARAMETERS,
    force=force,
    states=(Quantity("deflection", "z", "m"),),
    rate=rate,
    takes_dry=True,
    over="loop",
    solver=Solver(by_travel=True),
    search=Search(confused_with=("stribeck_friction", "backlash", "actuator_deadzone")),
    words=Words(
        where="the first tenths of a millimetre after every reversal",
        experiment="small sine motion, below a thousandth of the travel: force over position is a rounded hysteresis",
        remedy="avoid hunting of the integral action: feed the spring force forward near reversals, or use dither",
    ),
    claims=Claims(passive=True),
    checks=(
        ({"stiffness": 1e5}, {"x": (1e-4,)}, 10.0),
        ({"stiffness": 2e6}, {"x": (-1e-5,), "v": 0.3}, -20.0),
    ),
)
