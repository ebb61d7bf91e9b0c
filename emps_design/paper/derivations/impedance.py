"""(24) to (30) derived by SymPy from the plant and the target impedance, beside the equations as printed.

Printed equations are stored as printed and compared by the program; so are (15), (16) and (18). Where (30) prints F_v
and F_c, the hats are read as left out.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import sympy as sp

from emps_design.control.impedance.law import FrictionModel
from emps_design.paper.derivations.step import DerivationStep

M, F_v, F_c = sp.symbols("M F_v F_c", positive=True)
M_h, F_vh, F_ch = sp.symbols(r"\hat{M} \hat{F}_v \hat{F}_c", positive=True)
M_a, B, K = sp.symbols("M_a B K", positive=True)
q, qd, qdd, q_0, qd_0, S = sp.symbols(r"q \dot{q} \ddot{q} q_0 \dot{q}_0 \operatorname{sign}(\dot{q})", real=True)
tau_m, tau_e, tau_eh, current = sp.symbols(r"\tau_m \tau_e \hat{\tau}_e I_m", real=True)
G_ti = sp.Symbol(r"G_{\tau i}", positive=True)

_FRICTION = F_vh * qd + F_ch * S
_R = M_h / M_a

# Right-hand sides as printed in the paper.
PRINTED: dict[str, sp.Expr] = {
    "27": (_R - 1) * tau_e + (F_vh - _R * B) * (qd - qd_0) + F_ch * S - _R * K * (q - q_0),
    "28": (_R - 1) * tau_e + (F_vh - _R * B) * qd + F_ch * S,
    "29": M_h * qdd + _FRICTION - G_ti * current,
    "30": (_R - 1) * M_h * qdd + _R * (F_vh - B) * qd + _R * F_ch * S - 2 * (_R - 1) * G_ti * current,
}


def impedance_derivation() -> list[DerivationStep]:
    """Return the steps from (24) and (25) to (30), then what the law does on the plant, and (15), (16), (18).

    >>> steps = impedance_derivation()
    >>> [step.number for step in steps if step.agrees is False]
    ['27', '30', '15', '16', '18']
    """
    return [*_law_steps(), *_closed_steps(), *_other_steps()]


@cache
def derived_law() -> dict[str, sp.Expr]:
    """Right-hand sides of (26) to (30) by number, derived from (24) and (25)."""
    model = sp.Eq(tau_m + tau_e, M_h * qdd + _FRICTION)
    target = sp.Eq(tau_e, M_a * qdd + B * (qd - qd_0) + K * (q - q_0))
    acceleration = sp.solve(target, qdd)[0]
    law = sp.solve(model.subs(qdd, acceleration), tau_m)[0]
    comanipulation = law.subs({K: 0, qd_0: 0})
    observer = sp.solve(model, tau_e)[0].subs(tau_m, G_ti * current)
    sensorless = comanipulation.subs(tau_e, observer)
    return {
        "26": sp.expand(acceleration),
        "27": _collected(law),
        "28": _collected(comanipulation),
        "29": sp.expand(observer),
        "30": _collected(sensorless),
    }


def felt_under(law: sp.Expr) -> dict[str, sp.Expr]:
    """Apparent mass, damping and Coulomb force that ``law`` (a right-hand side like (30)) leaves on the plant (2).

    Ideal current loop: ``tau_m = G_tau_i I_m``, so the law is solved for the force it asks of itself.
    """
    force = sp.solve(sp.Eq(tau_m, law.subs(current, tau_m / G_ti)), tau_m)[0]
    felt = sp.expand(M * qdd + F_v * qd + F_c * S - force)
    return {
        "apparent_mass": sp.factor(felt.coeff(qdd)),
        "apparent_damping": sp.factor(felt.coeff(qd)),
        "coulomb_left": sp.factor(felt.coeff(S)),
    }


def cost_of_printed(plant: FrictionModel, mass: float, damping: float) -> dict[str, dict[str, float]]:
    """Numbers of :func:`felt_under` for (30) derived and printed, estimates exact, motion to +; SI.

    >>> plant = FrictionModel(115.7315, 474.9727, 474.9727, 17.3811, 17.3811)
    >>> {k: round(v, 1) for k, v in cost_of_printed(plant, 50.0, 100.0)["printed"].items()}
    {'apparent_mass': 73.8, 'apparent_damping': 235.8, 'coulomb_left': 6.3}
    """
    f_v, f_c = plant.viscous_positive, plant.coulomb_positive
    numbers = {M: plant.mass, M_h: plant.mass, F_v: f_v, F_vh: f_v, F_c: f_c, F_ch: f_c, M_a: mass, B: damping}
    laws = {"derived": derived_law()["30"], "printed": PRINTED["30"]}
    return {
        name: {key: float(value.subs(numbers)) for key, value in felt_under(law).items()} for name, law in laws.items()
    }


def to_document(plant: FrictionModel, mass: float = 50.0, damping: float = 100.0) -> dict[str, Any]:
    """The steps as plain data, and what (30) as printed costs on ``plant``."""
    return {
        "steps": [step.to_dict() for step in impedance_derivation()],
        "cost": cost_of_printed(plant, mass, damping),
    }


def _law_steps() -> list[DerivationStep]:
    derived = derived_law()
    return [
        DerivationStep(
            "Model the law is built on", "24", sp.Eq(tau_m + tau_e, M_h * qdd + _FRICTION),
            "Hats are the law's estimates of the plant (2).",
        ),
        DerivationStep(
            "Target impedance", "25", sp.Eq(tau_e, M_a * qdd + B * (qd - qd_0) + K * (q - q_0)),
            "What the operator is to feel, with stiffness K about q_0.",
        ),
        DerivationStep("Acceleration of the target", "26", sp.Eq(qdd, derived["26"]), "(25) solved; M_o read as M_a."),
        _compared("The law", "27", tau_m, derived["27"],
                  "(26) put into (24). As printed the viscous compensation acts on the relative velocity: it differs "
                  "by the estimate of F_v times the reference velocity, nothing once that velocity is zero."),
        _compared("The law for co-manipulation", "28", tau_m, derived["28"], "K = 0 and a reference at rest."),
        _compared("Observer of the external force", "29", tau_eh, derived["29"],
                  "(24) solved for the external force, with the motor force read from the current."),
        _compared("The law without a force sensor", "30", tau_m, derived["30"],
                  "(29) put into (28). As printed the current's term carries a factor 2 that does not follow."),
    ]  # fmt: skip


def _closed_steps() -> list[DerivationStep]:
    exact = {M_h: M, F_vh: F_v, F_ch: F_c}
    steps = []
    for title, law, text in (
        ("Felt with the law as derived", derived_law()["30"], "Exactly the target when the estimates are exact."),
        ("Felt with (30) as printed", PRINTED["30"].subs(exact), "Exact estimates: more mass, more damping, and dry "
         "friction is left."),
    ):  # fmt: skip
        felt = {name: sp.factor(value) for name, value in felt_under(law).items()}
        expression = felt["apparent_mass"] * qdd + felt["apparent_damping"] * qd + felt["coulomb_left"] * S
        steps.append(DerivationStep(title, "", sp.Eq(tau_e, expression), text))
    left = felt_under(derived_law()["30"])
    v = sp.Symbol("v", positive=True)
    creep = sp.solve(sp.Eq(0, left["apparent_damping"] * v + left["coulomb_left"]), v)[0]
    steps.append(
        DerivationStep(
            "Creep speed",
            "",
            sp.Eq(v, sp.factor(creep)),
            "No external force, constant velocity: above zero where Coulomb friction is over-estimated.",
        )
    )
    return steps


def _other_steps() -> list[DerivationStep]:
    return [_covariance_step(), _relative_deviation_step(), _observation_step()]


def least_squares_covariance(regressor: sp.Matrix, sigma: sp.Symbol) -> sp.Matrix:
    """Covariance of ``X = (W^T W)^-1 W^T tau`` for independent errors of standard deviation ``sigma``.

    >>> w = sp.Matrix(3, 1, sp.symbols("w1:4"))
    >>> least_squares_covariance(w, sp.Symbol("s"))
    Matrix([[s**2/(w1**2 + w2**2 + w3**2)]])
    """
    estimator = (regressor.T * regressor).inv() * regressor.T
    return (sigma**2 * estimator * estimator.T).applyfunc(sp.simplify)


def _covariance_step() -> DerivationStep:
    """(15): W^T W is p x p and invertible, W W^T is n x n and singular for n > p; shown for n = 3, p = 2."""
    sigma = sp.Symbol(r"\sigma_\rho", positive=True)
    w = sp.Matrix(3, 2, sp.symbols("w1:7"))
    product = (least_squares_covariance(w, sigma) * w.T * w / sigma**2).applyfunc(sp.simplify)
    n, p = sp.symbols("n p", integer=True, positive=True)
    W = sp.MatrixSymbol("W_1", n, p)
    C = sp.MatrixSymbol("C_X", p, p)
    # C W^T W / sigma^2 is the identity, so C = sigma^2 (W^T W)^-1; as printed there is nothing to invert.
    derived = sigma**2 * sp.Inverse(sp.MatMul(W.T, W, evaluate=False)) if product == sp.eye(2) else C
    printed = sigma**2 * sp.Inverse(sp.MatMul(W, W.T, evaluate=False))
    singular = sp.simplify((w * w.T).det()) == 0
    return DerivationStep(
        "Covariance of the estimate", "15", sp.Eq(C, derived),
        "Propagated through the least-squares estimator on a symbolic 3 x 2 regressor. As printed, W W^T is n x n, of "
        "rank p, and has determinant 0: it has no inverse.",
        sp.Eq(sp.MatrixSymbol("C_X", n, n), printed), printed if singular else sp.Integer(0),
    )  # fmt: skip


def _relative_deviation_step() -> DerivationStep:
    """(16) against Table I: the column is 100 x 2 sigma/|X|, twice what (16) says."""
    value, two_sigma, column = sp.Rational("115.7315"), sp.Rational("0.5765"), sp.Rational("0.4981")
    factor = sp.Integer(round(column * value / (100 * two_sigma / 2)))
    sigma, x = sp.symbols(r"\sigma_X X", positive=True)
    printed = 100 * sigma / x
    derived = factor * 100 * sigma / x
    return DerivationStep(
        "Relative standard deviation in Tables I and II", "16", sp.Eq(sp.Symbol(r"\%\sigma"), derived),
        "From the mass of Table I, 115.7315 kg with 2 sigma = 0.5765 kg: the column of 0.4981 % holds two standard "
        "deviations, (16) says one.",
        sp.Eq(sp.Symbol(r"\%\sigma"), printed), printed - derived,
    )  # fmt: skip


def _observation_step() -> DerivationStep:
    """(18) has the sign opposite to (5) and (19)."""
    wx = sp.Symbol("W X", real=True)
    derived = sp.solve(sp.Eq(tau_m + tau_e, wx), tau_e)[0]
    printed = tau_m - wx
    return DerivationStep(
        "External force from the model", "18", sp.Eq(tau_e, derived),
        "(5) solved for the external force, as (19) and (23) have it; (18) is printed with the opposite sign.",
        sp.Eq(tau_e, printed), sp.expand(printed - derived),
    )  # fmt: skip


def _compared(title: str, number: str, left: sp.Symbol, derived: sp.Expr, text: str) -> DerivationStep:
    difference = sp.factor(sp.simplify(PRINTED[number] - derived))
    return DerivationStep(title, number, sp.Eq(left, derived), text, sp.Eq(left, PRINTED[number]), difference)


def _collected(expression: sp.Expr) -> sp.Expr:
    """The expression as a sum over its signals, each with a factored coefficient."""
    signals = (tau_e, qdd, qd, qd_0, S, q, q_0, current)
    expanded = sp.expand(expression)
    terms = [sp.factor(expanded.coeff(signal)) * signal for signal in signals]
    collected = sum(terms, sp.Integer(0))
    rest = sp.simplify(expanded - collected)  # zero, for a law that is linear in its signals
    return collected + rest
