"""(10) and (11), an operator with a sign, and which gains are stable: Routh's inequality, both ways."""

from __future__ import annotations

import sympy as sp

from emps_design.paper import symbols as y
from emps_design.paper.derivations.step import DerivationStep, compared
from emps_design.paper.derivations.velocity_loop import (
    CARRIAGE,
    CONTINUOUS,
    CORRECTION,
    CURRENT_LOOP,
    LINEAR,
    closed_velocity_loop,
)
from emps_design.paper.written import Equation, Sum

SLOW = "T_vc is the second order of (9)"
PAPERS_SIGN = "tau_e = +k_c qd, the paper's relation"
SENSOR_AND_CARRIAGE = "the operator's force reaches sensor and carriage"
tau_in = sp.Symbol(r"(\tau_{ref} + \tau_e)")
a, b, c, d, h = sp.symbols("a b c r p", real=True)


def derive_force_loop() -> tuple[DerivationStep, ...]:
    """Derive (10) and (11), and the limits of k_e1.

    >>> [(step.number, step.verdict) for step in derive_force_loop() if step.number]
    [('10', 'as printed'), ('11', 'as printed'), ('10', 'not as printed')]
    """
    return (*_as_the_paper(), carriage_step(), *routh_steps(), *limits())


def _as_the_paper() -> list[DerivationStep]:
    T_vc = 1 / (1 + 2 * y.z_v / y.omega_0v * y.s + y.s**2 / y.omega_0v**2)
    loop = [sp.Eq(y.qd_1, T_vc * y.k_e1 * tau_in), sp.Eq(y.tau_e, y.k_c * y.qd_1)]
    T_eo = sp.simplify(sp.solve(loop, [y.qd_1, y.tau_e], dict=True)[0][y.tau_e] / tau_in)
    unity = sp.simplify(T_eo.subs(y.k_c, 1 / y.k_e1))
    closed = sp.factor(sp.simplify(unity / (1 - unity)))
    rests_on = (SLOW, PAPERS_SIGN)
    v = sp.Symbol(y.qd_1.name, real=True)
    return [
        compared("Force loop, opened at its sum", "10", Equation(y.T_eo, T_eo),
                 "v = k_e1 (tau_ref + tau_e) through T_vc to the velocity, and tau_e = k_c qd.", rests_on),
        compared("Static gain one", "11", Equation(y.T_eo, unity), "k_c = 1/k_e1.", rests_on),
        DerivationStep(
            "The paper's own reading", "", Equation(y.T_eo / (1 - y.T_eo), closed),
            "tau_e is reference and result at once: positive feedback.", rests_on,
            (("it has a pole at s = 0", sp.denom(closed).subs(y.s, 0) == 0),),
        ),
        compared(
            "A hand that gives no energy", "10", Equation(y.tau_e, -y.k_c * y.qd_1),
            "tau_e acts on the carriage, towards +q; what it puts in is P = tau_e qd. A hand that only damps takes "
            "energy out, so its force has the other sign.", ("the hand is a damper k_c > 0",),
            (("P < 0 with this sign", sp.simplify((-y.k_c * v) * v).is_nonpositive is True),
             ("P > 0 as printed", sp.simplify((y.k_c * v) * v).is_nonnegative is True)),
        ),
    ]  # fmt: skip


def answer_to_a_force(correction: sp.Eq = CORRECTION, carriage: sp.Eq = CARRIAGE) -> tuple[sp.Expr, sp.Expr]:
    """Velocity of the blocks per reference and per force on the carriage."""
    pushed = sp.Eq(carriage.lhs, carriage.rhs + y.tau_e)
    blocks = [correction.subs(y.e_v, y.v_ref - y.qd_1), pushed]
    velocity = sp.expand(sp.solve(blocks, [y.qd_1, y.u], dict=True)[0][y.qd_1])
    return sp.factor(velocity.coeff(y.v_ref)), sp.factor(velocity.coeff(y.tau_e))


def carriage_step(correction: sp.Eq = CORRECTION, carriage: sp.Eq = CARRIAGE) -> DerivationStep:
    """What reference and external force make of the velocity, from the blocks with tau_e on the carriage."""
    per_reference, per_force = answer_to_a_force(correction, carriage)
    T_vc = closed_velocity_loop(correction, carriage)
    short = Sum(((y.T_vc, Sum(((y.v_ref,), (y.s / y.K_v, y.tau_e)))),))
    stiffness = y.k_v1 * y.G_tau / y.t_v
    return DerivationStep(
        "Carriage under reference and force", "", Equation(y.qd_1, short),
        "Correction and (M s + F_v) qd = G_tau u + tau_e solved together: a force answers through T_vc as well.",
        (LINEAR, CURRENT_LOOP, CONTINUOUS),
        (
            ("per reference it is T_vc", sp.simplify(per_reference - T_vc) == 0),
            ("per force it is (s/K_v) T_vc", sp.simplify(per_force - y.s / stiffness * T_vc) == 0),
        ),
    )  # fmt: skip


def routh_steps() -> list[DerivationStep]:
    """Routh's inequality for a cubic, both ways, from its factors."""
    product = sp.Poly(sp.expand((y.s + d) * (y.s**2 + h * y.s + y.q)), y.s).all_coeffs()
    _, first, second, third = product
    claim = sp.expand(first * second - third - h * (d**2 + second))
    over_zero = sp.symbols("x a b c", positive=True)
    on_the_right = sp.Poly([1, *over_zero[1:]], y.s).as_expr().subs(y.s, over_zero[0])
    return [
        DerivationStep(
            "A cubic and its factors", "",
            Equation(y.s**3 + a * y.s**2 + b * y.s + c, (y.s + d) * (y.s**2 + h * y.s + y.q)),
            "A real cubic has a real root -r; p and q are those of the other two.", ("a, b, c are real",),
            (("a = r + p, b = q + r p, c = r q", product == [1, d + h, y.q + d * h, d * y.q]),),
        ),
        DerivationStep(
            "Routh's inequality", "", Equation(Sum(((a, b), (-1, c))), Sum(((h, Sum(((d**2,), (b,)))),))),
            "With a, b, c > 0 there is no root at or right of zero on the real line, so r > 0, and q = c/r > 0: the "
            "other two roots lie left exactly if p > 0. As r^2 + b > 0, p has the sign of a b - c: stable if a b > c, "
            "and not stable if a b <= c. A coefficient that is not positive is never stable: left roots make "
            "r, p, q > 0 and all three sums of products.", ("a, b, c > 0",),
            (
                ("a b - c = p (r^2 + b)", claim == 0),
                ("no root at s >= 0", on_the_right.is_positive is True and over_zero[3].is_positive),
            ),
        ),
    ]  # fmt: skip


def characteristic(hand: sp.Expr, on_carriage: bool = True) -> list[sp.Expr]:
    """Coefficients of the characteristic polynomial with a hand tau_e = -hand(s) qd, the leading one 1."""
    T_vc = 1 / (1 + 2 * y.z_v / y.omega_0v * y.s + y.s**2 / y.omega_0v**2)
    feedback = T_vc * (y.k_e1 * hand + (y.s * hand / y.K_v if on_carriage else 0))
    polynomial = sp.Poly(sp.numer(sp.together(1 + feedback)), y.s)
    return [sp.simplify(coefficient / polynomial.LC()) for coefficient in polynomial.all_coeffs()]


def limits(wall: sp.Expr = y.K_env / y.s, hand: sp.Expr = y.k_h) -> list[DerivationStep]:
    """The largest stable k_e1 against a wall, and that a viscous hand has none."""
    rests_on = (SLOW, SENSOR_AND_CARRIAGE)
    _, first, second, third = characteristic(wall)
    margin = sp.expand(first * second - third)
    limit = sp.factor(sp.solve(margin, y.k_e1)[0])
    x = sp.Symbol("x", positive=True)
    inside = sp.simplify(sp.together(margin.subs(y.k_e1, limit * x / (1 + x))))  # any gain below the limit
    outside = sp.simplify(sp.together(margin.subs(y.k_e1, limit * (1 + x))))  # any gain above it
    sensor = characteristic(wall, on_carriage=False)
    sensor_limit = sp.solve(sp.expand(sensor[1] * sensor[2] - sensor[3]), y.k_e1)[0]
    viscous = characteristic(hand)
    cubic = sp.Add(*(k * y.s ** (3 - i) for i, k in enumerate([sp.Integer(1), first, second, third])))
    square = sp.Add(*(k * y.s ** (2 - i) for i, k in enumerate(viscous)))
    sums = sp.expand((y.s + d) * (y.s + h))
    return [
        DerivationStep(
            "A stiff wall", "", Equation(cubic, sp.Integer(0)),
            "tau_e = -(K_env/s) qd put into the carriage under reference and force: negative feedback.", rests_on,
            (("all coefficients are positive", all(k.is_positive for k in (first, second, third))),),
        ),
        DerivationStep(
            "Largest gain against a wall", "", Equation(y.k_e1, limit),
            "Routh's inequality on that cubic: stable for every gain below, unstable for every one above.", rests_on,
            (
                ("a b - c > 0 for every k_e1 below", inside.is_positive is True),
                ("a b - c < 0 for every k_e1 above", outside.is_negative is True),
            ),
        ),
        DerivationStep(
            "The same, force on the sensor only", "", Equation(y.k_e1, sp.factor(sensor_limit)),
            "So k_e1 K_env < 2 z_v omega_0v = omega_v tan(phi_v).", (SLOW, "the force reaches only the sensor"),
            (("it is that limit with K_v to infinity", sp.limit(limit, y.K_v, sp.oo).equals(sensor_limit)),),
        ),
        DerivationStep(
            "A viscous hand has no limit", "", Equation(square, sp.Integer(0)),
            "tau_e = -k_h qd leaves two roots; they lie left exactly if their sum is negative and their product "
            "positive, that is if both coefficients are positive, and they are for every k_e1 > 0. Sampling, the "
            "current loop or a delay of the sensor add phase that this leaves out, and then there is a limit.",
            (*rests_on, CONTINUOUS),
            (
                ("second order", len(viscous) == 3),
                ("both coefficients are positive for every k_e1 > 0", all(k.is_positive for k in viscous)),
                ("coefficients are sum and product of the roots", sp.Poly(sums, y.s).all_coeffs() == [1, d + h, d * h]),
            ),
        ),
    ]  # fmt: skip
