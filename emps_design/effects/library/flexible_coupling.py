"""Flexible coupling: part of the mass is behind a spring and a damper, seen from the encoder.

The mass M is split into M (1 - share) on the encoder's side and M share behind the coupling. The free pair resonates at
``frequency`` (w_n = 2 pi f, reduced mass m = M share (1 - share)), so k = m w_n^2 and c = 2 damping m w_n. The share
``load_friction`` of the baseline friction acts on the load, the rest on the encoder's side. States: twist
d = q - q_load [m] and load velocity [m/s].
"""

from math import inf, pi

from emps_design.effects import two_mass
from emps_design.effects.effect import COULOMB, MASS, VISCOUS, Claims, Effect, Search, Solver, Words
from emps_design.effects.two_mass import load_friction


def transmitted(v, x, p, b):
    """Force [N] of spring and damper."""
    reduced = b[MASS] * p[2] * (1.0 - p[2])
    w = 2.0 * pi * p[0]
    return reduced * w * w * x[0] + 2.0 * p[1] * reduced * w * (v - x[1])


def force(q, v, t, tau, x, p, b):
    return transmitted(v, x, p, b) - p[3] * b[VISCOUS] * v


def dry(q, v, t, tau, x, p, b):
    return -p[3] * b[COULOMB]


def inertia(q, v, t, tau, x, p, b):
    return -p[2] * b[MASS]


def rate(q, v, t, tau, x, p, b, level, dx):
    dx[0] = v - x[1]
    mass = p[2] * b[MASS]
    dx[1] = (transmitted(v, x, p, b) - load_friction(x[1], p[3], mass, b)) / mass


def affine(p):
    return two_mass.affine(p[3], inf)


EFFECT = Effect(
    name="flexible_coupling",
    label="Flexible coupling",
    equation=r"\tau_c = k (q - q_l) + c (\dot q - \dot q_l),\quad "
    r"M_l \ddot q_l = \tau_c - \lambda (F_v \dot q_l + F_c\, \mathrm{sign}(\dot q_l))",
    source="two-mass model; the coupling of paper section II-A, assumed rigid there",
    parameters=two_mass.coupling("", (20.0, 35.0, 60.0, 100.0), 0.05, "behind the coupling"),
    force=force,
    dry=dry,
    inertia=inertia,
    states=two_mass.STATES,
    rate=rate,
    over="loop",
    solver=Solver(affine=affine),
    search=Search(confused_with=("actuator_delay", "actuator_lag", "backlash")),
    words=Words(
        where="in a band around the resonance, after every jerk of the reference",
        experiment="a multi-sine or chirp across the resonance at small amplitude, without reversals",
        remedy="keep the crossover below a fifth of the resonance, or use a notch filter",
    ),
    claims=Claims(passive=True),
    checks=(
        ({"frequency": 50.0, "damping": 0.0, "share": 0.5}, {"x": (1e-5, 0.0)}, 25.0 * (100 * pi) ** 2 * 1e-5),
        ({"frequency": 50.0, "damping": 0.1, "share": 0.5}, {"x": (0.0, 0.0), "v": 0.01}, 5.0 * pi),
    ),
)
