"""Maxwell-slip friction: after a reversal, part of the dry friction changes sign only over a certain travel.

One element of the generalised Maxwell-slip model, in addition to the Coulomb friction or to the stiff element of
``presliding_friction``: F = share F_c w, dw/dt = (v - |v| w) / travel. So w = sign(v), except for a part that falls by
a factor of e over every ``travel`` since the reversal, at any speed. It adds to the Coulomb level F_c of the baseline.
"""

from emps_design.effects.effect import COULOMB, Claims, Effect, Parameter, Search, Solver, Words
from emps_design.quantities import Quantity

PARAMETERS = (
    Parameter("share", r"\kappa", "", 0.0, 1.0, starts=(0.2,), text="friction of the element, in Coulomb levels"),
    Parameter("travel", r"\ell", "m", 5e-5, 2e-2, starts=(2e-4, 6e-4, 2e-3),
              text="travel after a reversal over which its force settles"),
)  # fmt: skip


def force(q, v, t, tau, x, p, b):
    return p[0] * b[COULOMB] * x[0]


def rate(q, v, t, tau, x, p, b, level, dx):
    dx[0] = (v - abs(v) * x[0]) / p[1]


EFFECT = Effect(
    name="maxwell_slip_friction",
    label="Maxwell-slip friction",
    equation=r"F = \kappa F_c w,\quad \dot w = (\dot q - |\dot q|\, w) / \ell",
    source="F. Al-Bender, V. Lampaert, J. Swevers, IEEE Trans. Automatic Control 50 (2005); elements as of Dahl (1968)",
    parameters=PARAMETERS,
    force=force,
    states=(Quantity("memory", "w", ""),),
    rate=rate,
    over="loop",
    solver=Solver(by_travel=True),
    search=Search(confused_with=("presliding_friction", "stribeck_friction", "backlash"), element=True),
    words=Words(
        where="0.1 to a few millimetres after every reversal: friction rises more slowly than in presliding",
        experiment="reversals at several accelerations: the rise is the same over travel, not over time",
        remedy="compensate friction as a function of the path since the last reversal, not of the sign of the velocity",
    ),
    claims=Claims(passive=True),
    checks=(
        ({"share": 0.25, "travel": 4e-4}, {"x": (0.5,)}, 2.5),
        ({"share": 0.1, "travel": 1e-3}, {"x": (-1.0,), "v": -0.2}, -2.0),
    ),
)
