"""Backlash: part of the mass is behind a coupling with play; within the gap no force is transmitted.

With d = q - q_load the contact force is k (d -+ gap/2) + c (v - v_load) for |d| > gap/2, else zero. The coupling and
the friction on the load are those of ``flexible_coupling``: in contact the free pair resonates at ``frequency``
(reduced mass m = M share (1 - share), k = m w_n^2, c = 2 damping m w_n). The load starts at rest in the middle of the
play. The damper acts during contact, so the force may pull just before release.
"""

from math import pi

from emps_design.effects import two_mass
from emps_design.effects.effect import COULOMB, MASS, VISCOUS, Claims, Effect, Parameter, Search, Solver, Words
from emps_design.effects.two_mass import load_friction

PARAMETERS = (
    Parameter("gap", "g", "m", 0.0, 5e-3, starts=(5e-5, 1e-4, 2e-4), text="total play"),
    *two_mass.coupling(" in contact", (60.0,), 0.15, "behind the play"),
)


def transmitted(v, x, p, b):
    """Force [N] of spring and damper, in contact."""
    reduced = b[MASS] * p[3] * (1.0 - p[3])
    w = 2.0 * pi * p[1]
    half = 0.5 * p[0]
    if x[0] > half:
        return reduced * w * (w * (x[0] - half) + 2.0 * p[2] * (v - x[1]))
    if x[0] < -half:
        return reduced * w * (w * (x[0] + half) + 2.0 * p[2] * (v - x[1]))
    return 0.0


def force(q, v, t, tau, x, p, b):
    return transmitted(v, x, p, b) - p[4] * b[VISCOUS] * v


def dry(q, v, t, tau, x, p, b):
    return -p[4] * b[COULOMB]


def inertia(q, v, t, tau, x, p, b):
    return -p[3] * b[MASS]


def rate(q, v, t, tau, x, p, b, level, dx):
    dx[0] = v - x[1]
    mass = p[3] * b[MASS]
    dx[1] = (transmitted(v, x, p, b) - load_friction(x[1], p[4], mass, b)) / mass


def affine(p):
    return two_mass.affine(p[4], 0.5 * p[0])


def guard(q, v, t, tau, x, p, b):
    return abs(x[0]) - 0.5 * p[0]


EFFECT = Effect(
    name="backlash",
    label="Backlash",
    equation=r"\tau_c = k\,(d \mp \tfrac{g}{2}) + c\,\dot d \text{ if } |d| > \tfrac{g}{2},\ "
    r"M_l \ddot q_l = \tau_c - \lambda (F_v \dot q_l + F_c\, \mathrm{sign}(\dot q_l))",
    source="dead zone and spring; M. Nordin, P.-O. Gutman, Automatica 38 (2002)",
    parameters=PARAMETERS,
    force=force,
    dry=dry,
    inertia=inertia,
    states=two_mass.STATES,
    rate=rate,
    play="gap",
    over="loop",
    solver=Solver(guard=guard, affine=affine),
    search=Search(confused_with=("flexible_coupling", "presliding_friction", "actuator_deadzone")),
    words=Words(
        where="an impact at every reversal of the transmitted force, after a short free motion",
        experiment="slow reversals with a position sensor on the load, or a small square wave "
        "about rest: the load does not move",
        remedy="preload the nut or the belt, or keep the crossover low enough that there is no limit cycle",
    ),
    claims=Claims(passive=True),
    checks=(
        (
            {"gap": 2e-4, "frequency": 50.0, "damping": 0.0, "share": 0.5},
            {"x": (2e-4, 0.0)},
            25.0 * (100 * pi) ** 2 * 1e-4,
        ),
        ({"gap": 2e-4, "frequency": 50.0, "damping": 0.1, "share": 0.5}, {"x": (9e-5, 0.0), "v": 0.1}, 0.0),
    ),
)
