"""Presliding friction: before it slides the contact bends like a spring and remembers its travel (Dahl).

F = stiffness z, dz/dt = v - |v| stiffness z / L, with L the Coulomb level of the moment: a spring at small travel,
Coulomb friction L sign(v) after about 3 L / stiffness of travel. It stands in for the set-valued friction, so the
carriage has no true stick; a level that other effects drive to zero erases the memory over ``FORGET``. A contact
that would bend by less than ``FINEST`` bends over that: no encoder resolves it.
"""

from emps_design.effects.effect import Claims, Effect, Parameter, Search, Solver, Words
from emps_design.quantities import Quantity

FORGET = 1e-4  # m
FINEST = 1e-9  # m
SETTLED = 1e-9  # of the whole bend: closer to it the contact counts as sliding, and steps may be long
PARAMETERS = (
    Parameter("stiffness", r"\sigma", "N/m", 1e3, 1e8, starts=(2e4, 1e5, 5e5, 2e6),
              text="stiffness of the contact before it slides"),
)  # fmt: skip


def force(q, v, t, tau, x, p, b):
    return p[0] * x[0]


def rate(q, v, t, tau, x, p, b, level, dx):
    if level > 0.0:
        bend = level / p[0]
        missing = v * bend - abs(v) * x[0]
        dx[0] = missing / max(bend, FINEST) if abs(missing) > SETTLED * abs(v) * bend else 0.0
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
        experiment="small sine motion, below a thousandth of the travel: force over position draws a rounded loop",
        remedy="an integral action that does not hunt: lead it with the spring near reversals, or dither",
    ),
    claims=Claims(passive=True),
    checks=(
        ({"stiffness": 1e5}, {"x": (1e-4,)}, 10.0),
        ({"stiffness": 2e6}, {"x": (-1e-5,), "v": 0.3}, -20.0),
    ),
)
