"""Friction map: the Coulomb level varies along the travel as a curve through few knots, for example towards one end.

Caused by a screw that is worn or dry at one end, a varying preload, or guides that are not parallel. The curve has
seven equally spaced knots (:mod:`emps_design.effects.travel_map`); a periodic level is ``position_dependent_friction``.
"""

from emps_design.effects import travel_map
from emps_design.effects.effect import Claims, Words

TOWARDS_THE_END = {
    **{"start": 0.0, "end": 0.3},
    **dict(zip(travel_map.NAMES, (0.0, 0.0, 1.0, 3.0, 6.0, 10.0), strict=True)),
}
DIP = {"start": -0.3, "end": 0.3, **dict(zip(travel_map.NAMES, (-1.0, -4.0, -4.0, 0.0, 2.0, 0.0), strict=True))}

EFFECT = travel_map.along(
    "dry",
    "Coulomb level relative to the start",
    confused_with=("position_dependent_friction", "force_map", "friction_drift"),
    name="friction_map",
    label="Friction over position",
    equation=r"F = h(q)\, \mathrm{sign}(\dot q),\quad h \text{ a cubic spline through seven knots},\ h(q_0) = 0",
    source="look-up table over position; B. Armstrong-Helouvry et al., Automatica 30 (1994)",
    words=Words(
        where="slowly varying along the travel, with opposite sign in the two directions, at any speed",
        experiment="one slow constant-velocity stroke over the whole travel in each direction: "
        "half the difference is the map",
        remedy="relubricate or align where the level is high, or schedule the friction compensation with position",
    ),
    claims=Claims(parity="odd"),
    checks=(
        (TOWARDS_THE_END, {"q": 0.275, "v": 0.2}, 8.4375),
        (TOWARDS_THE_END, {"q": 0.225, "v": -0.2}, -4.375),
        (DIP, {"q": -0.15, "v": 0.1}, -2.5625),
    ),
)
