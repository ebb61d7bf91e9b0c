"""Force map: a force that varies along the travel, the same in both directions, as a curve through few knots.

Caused by cable chains and hoses, a counterweight, a screw that is not level, or misaligned guides. The curve has seven
equally spaced knots (:mod:`emps_design.effects.travel_map`). A curve that a spring or one harmonic fits as well counts
as one of these.
"""

from emps_design.effects import travel_map
from emps_design.effects.effect import Claims, Words

RISE = {"start": 0.0, "end": 0.6, **dict(zip(travel_map.NAMES, (1.0, 3.0, 2.0, -1.0, 0.0, 4.0), strict=True))}

EFFECT = travel_map.along(
    "force",
    "force",
    confused_with=("elastic_force", "friction_map", "position_ripple"),
    line=True,
    name="force_map",
    label="Force over position",
    equation=r"F = h(q),\quad h \text{ a cubic spline through seven knots},\ h(q_0) = 0",
    source="look-up table over position, as in many drives; B. Armstrong-Helouvry et al., Automatica 30 (1994)",
    words=Words(
        where="slowly varying along the travel, with the same sign in both directions, at any speed",
        experiment="one slow constant-velocity stroke over the whole travel in each direction: half the sum is the map",
        remedy="feed the map forward from position, or repair the cause: chain, hose, alignment",
    ),
    claims=Claims(parity="even", passive=True),
    checks=(
        (RISE, {"q": 0.15}, 2.125),
        (RISE, {"q": 0.35, "v": -0.2}, 0.375),
        (RISE, {"q": 0.7}, 4.0),
    ),
)
