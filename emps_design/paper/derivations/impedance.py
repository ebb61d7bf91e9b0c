"""(24) to (30) from model and target, what the law does on the plant, and what (30) as printed costs."""

from __future__ import annotations

import sympy as sp

from emps_design.laws.friction_model import FrictionModel
from emps_design.paper import written as y
from emps_design.paper.derivations.model import DerivationStep, compared
from emps_design.paper.written import EQUATIONS, READ_AS, Equation, Sum, in_order

RATIO = (y.M_h, y.M_a)
MOVED, AWAY = y.qd - y.qd_0, y.q - y.q_0

MODEL = sp.Eq(y.tau_m + y.tau_e, y.M_h * y.qdd + y.F_vh * y.qd + y.F_ch * y.S)
TARGET = sp.Eq(y.tau_e, y.M_a * y.qdd + y.B * MOVED + y.K * AWAY)

ONE_QUADRANT = "friction alike in both directions"
BELIEVED = "the plant is what the estimates say"
AT_REST = "K = 0 and qd_0 = 0"
IDEAL = "ideal current loop: tau_m = G_tau_i I_m"


def derived_law(model: sp.Eq = MODEL, target: sp.Eq = TARGET) -> dict[str, Sum]:
    """Right-hand sides of (26) to (30) by number in the paper's order, from (24) and (25)."""
    acceleration = sp.solve(target, y.qdd)[0]
    law = sp.solve(model.subs(y.qdd, acceleration), y.tau_m)[0]
    comanipulation = law.subs({y.K: 0, y.qd_0: 0})
    observer = sp.solve(model, y.tau_e)[0].subs(y.tau_m, y.G_ti * y.current)
    sensorless = comanipulation.subs(y.tau_e, observer)
    inside = in_order(sp.expand(acceleration * y.M_a), (y.tau_e, MOVED, AWAY), RATIO)
    return {
        "26": Sum(((1 / y.M_a, inside),)),
        "27": in_order(sp.expand(law), (y.tau_e, y.qd, MOVED, y.S, AWAY), RATIO),
        "28": in_order(sp.expand(comanipulation), (y.tau_e, y.qd, y.S), RATIO),
        "29": in_order(sp.expand(observer), (y.qdd, y.qd, y.S, y.current), RATIO),
        "30": in_order(sp.expand(sensorless), (y.qdd, y.qd, y.S, y.current), RATIO),
    }


def printed_law() -> sp.Expr:
    """(30) as printed, with the hats that are left out."""
    return EQUATIONS["30"][0].rhs.subs(READ_AS["30"])


def felt_under(law: sp.Expr) -> dict[str, sp.Expr]:
    """Apparent mass, damping and Coulomb force that ``law`` (a right-hand side like (30)) leaves on the plant (2).

    Ideal current loop: ``tau_m = G_tau_i I_m``, so the law is solved for the force it asks of itself.
    """
    force = sp.solve(sp.Eq(y.tau_m, law.subs(y.current, y.tau_m / y.G_ti)), y.tau_m)[0]
    felt = sp.expand(y.M * y.qdd + y.F_v * y.qd + y.F_c * y.S - force)
    return {
        "apparent_mass": sp.factor(felt.coeff(y.qdd)),
        "apparent_damping": sp.factor(felt.coeff(y.qd)),
        "coulomb_left": sp.factor(felt.coeff(y.S)),
    }


def cost_of_printed(plant: FrictionModel, mass: float, damping: float) -> dict[str, dict[str, float]]:
    """Numbers of :func:`felt_under` for (30) derived and printed, estimates exact, motion to +; SI.

    >>> plant = FrictionModel(115.7315, 474.9727, 474.9727, 17.3811, 17.3811)
    >>> {k: round(v, 1) for k, v in cost_of_printed(plant, 50.0, 100.0)["printed"].items()}
    {'apparent_mass': 73.8, 'apparent_damping': 235.8, 'coulomb_left': 6.3}
    """
    f_v, f_c = plant.viscous_positive, plant.coulomb_positive
    numbers = {
        y.M: plant.mass, y.M_h: plant.mass, y.F_v: f_v, y.F_vh: f_v, y.F_c: f_c, y.F_ch: f_c, y.M_a: mass, y.B: damping,
    }  # fmt: skip
    laws = {"derived": derived_law()["30"].expression, "printed": printed_law()}
    return {
        name: {key: float(value.subs(numbers)) for key, value in felt_under(law).items()} for name, law in laws.items()
    }


def derive_impedance(model: sp.Eq = MODEL, target: sp.Eq = TARGET) -> tuple[DerivationStep, ...]:
    """Derive (24) to (30) from the model of the law and its target, and what the law does on the plant.

    >>> [(step.number, step.verdict) for step in derive_impedance() if step.number]  # doctest: +NORMALIZE_WHITESPACE
    [('24', 'as printed'), ('25', 'as printed'), ('26', 'as printed once M_o is read as M_a'), ('27', 'not as printed'),
     ('28', 'as printed'), ('29', 'as printed'), ('30', 'not as printed')]
    """
    derived = derived_law(model, target)
    return (*_law_steps(model, target, derived), *_closed_steps(derived["30"].expression))


def _law_steps(model: sp.Eq, target: sp.Eq, derived: dict[str, Sum]) -> list[DerivationStep]:
    of_model = in_order(sp.expand(model.rhs), (y.qdd, y.qd, y.S), RATIO)
    of_target = in_order(sp.expand(target.rhs), (y.qdd, MOVED, AWAY), RATIO)
    # The law put back into the model must leave the target, and the observer must give the force of the model.
    felt = sp.solve(model.subs(y.tau_m, derived["27"].expression), y.tau_e)[0]
    closes = sp.simplify(felt - target.rhs) == 0
    same_force = (
        sp.simplify(derived["29"].expression.subs(y.current, y.tau_m / y.G_ti) - sp.solve(model, y.tau_e)[0]) == 0
    )
    sum_of_two = derived["28"].expression.subs(y.tau_e, derived["29"].expression)
    return [
        compared("Model the law is built on", "24", Equation(Sum(((y.tau_m,), (y.tau_e,))), of_model),
                 "(2) with the law's estimates, which wear hats.", (ONE_QUADRANT, BELIEVED)),
        compared("Target impedance", "25", Equation(y.tau_e, of_target),
                 "What the operator is to feel, with stiffness K about q_0.", ("chosen",)),
        compared("Acceleration of the target", "26", Equation(y.qdd, derived["26"]), "(25) solved.", ("M_a > 0",)),
        compared("The law", "27", Equation(y.tau_m, derived["27"]),
                 "(26) put into (24). As printed the viscous compensation acts on the relative velocity: it differs "
                 "by the estimate of F_v times the reference velocity, nothing once that velocity is zero.",
                 (ONE_QUADRANT, BELIEVED), (("put back into (24) it leaves (25)", closes),)),
        compared("The law for co-manipulation", "28", Equation(y.tau_m, derived["28"]), "(27) with these two.",
                 (ONE_QUADRANT, BELIEVED, AT_REST)),
        compared("Observer of the external force", "29", Equation(y.tau_eh, derived["29"]),
                 "(24) solved for the external force, with the motor force read from the current.",
                 (ONE_QUADRANT, BELIEVED, IDEAL), (("it is the tau_e of (24)", same_force),)),
        compared("The law without a force sensor", "30", Equation(y.tau_m, derived["30"]),
                 "(29) put into (28). As printed the current's term carries a factor 2 that does not follow, and F_v "
                 "and F_c have lost their hats.", (ONE_QUADRANT, BELIEVED, AT_REST, IDEAL),
                 (("it is (28) with (29) in the place of tau_e",
                   sp.expand(derived["30"].expression - sum_of_two) == 0),)),
    ]  # fmt: skip


def _closed_steps(law: sp.Expr) -> list[DerivationStep]:
    exact = {y.M_h: y.M, y.F_vh: y.F_v, y.F_ch: y.F_c}
    rests_on = (IDEAL, "no filters, continuous time")
    steps = []
    for title, tried, rests, words in (
        ("Felt with the law as derived", law, rests_on, "What the errors of the estimates leave."),
        ("Felt with the law as derived, estimates exact", law.subs(exact), (*rests_on, "exact estimates"),
         "Exactly the target."),
        ("Felt with (30) as printed, estimates exact", printed_law().subs(exact), (*rests_on, "exact estimates"),
         "More mass, more damping, and dry friction is left."),
    ):  # fmt: skip
        felt = felt_under(tried)
        coefficients = tuple(sp.factor(value) for value in felt.values())
        shown = Sum(tuple(pair for pair in zip(coefficients, (y.qdd, y.qd, y.S), strict=True) if pair[0] != 0))
        target = (y.M_a, y.B, sp.Integer(0))
        checks = (("it is M_a, B and no friction", coefficients == target),) if words == "Exactly the target." else ()
        steps.append(DerivationStep(title, "", Equation(y.tau_e, shown), words, rests, checks))
    impedance = felt_under(law)
    v = sp.Symbol("v", positive=True)
    creep = sp.solve(sp.Eq(0, impedance["apparent_damping"] * v + impedance["coulomb_left"]), v)[0]
    error = sp.Symbol("epsilon", positive=True)
    over = sp.factor(creep.subs({y.F_vh: (1 + error) * y.F_v, y.F_ch: (1 + error) * y.F_c}))
    return [
        *steps,
        DerivationStep(
            "Creep speed", "", Equation(v, sp.factor(creep)),
            "No external force, constant velocity: above zero where Coulomb friction is over-estimated.", rests_on,
            (("over-estimated by epsilon it is epsilon F_c/(B - epsilon F_v)",
              sp.simplify(over - error * y.F_c / (y.B - error * y.F_v)) == 0),),
        ),
    ]  # fmt: skip
