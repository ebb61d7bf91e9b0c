"""Derivations of the paper's loops: velocity loop and force loop, (6) to (11), and impedance law, (24) to (30).

u = k_v1 (e / (t_v s) - qd)          IP correction of the velocity error e = v - qd
(M s + F_v) qd = G_tau u             drive and carriage, (1) and (2) without Coulomb friction

The force loop has (10) and (11), the sign of the operator's force, and the stable gains by Routh's inequality. The
impedance law follows from a model and a target; then what it does on the plant, and what (30) as printed costs.
"""

from __future__ import annotations

import sympy as sp

from emps_design.laws.law import FrictionModel
from emps_design.paper import written as y
from emps_design.paper.model import DerivationStep, compared
from emps_design.paper.written import EQUATIONS, READ_AS, Equation, Sum, in_order

LINEAR = "Coulomb friction left out"
FREE = "no external force"
CURRENT_LOOP = "the current loop is a gain"
CONTINUOUS = "continuous time"
FEASIBLE = "atan(F_v/(M omega_v)) < phi_v < 90 deg"

PHASES = "atan(F_v/(M omega_v)) < phi_v < 90 deg + atan(F_v/(M omega_v))"

CORRECTION = sp.Eq(y.u, y.k_v1 * (y.e_v / (y.t_v * y.s) - y.qd_1))
PI_CORRECTION = sp.Eq(y.u, y.k_v1 * (1 + 1 / (y.t_v * y.s)) * y.e_v)
CARRIAGE = sp.Eq((y.M_1 * y.s + y.F_v1) * y.qd_1, y.G_tau * y.u)

SLOW = "T_vc is the second order of (9)"
PAPERS_SIGN = "tau_e = +k_c qd, the paper's relation"
SENSOR_AND_CARRIAGE = "the operator's force reaches sensor and carriage"
tau_in = sp.Symbol(r"(\tau_{ref} + \tau_e)")
a, b, c, d, h = sp.symbols("a b c r p", real=True)

# The impedance law.
RATIO = (y.M_h, y.M_a)
MOVED, AWAY = y.qd - y.qd_0, y.q - y.q_0

MODEL = sp.Eq(y.tau_m + y.tau_e, y.M_h * y.qdd + y.F_vh * y.qd + y.F_ch * y.S)
TARGET = sp.Eq(y.tau_e, y.M_a * y.qdd + y.B * MOVED + y.K * AWAY)

ONE_QUADRANT = "friction alike in both directions"
BELIEVED = "the plant parameters equal the estimates"
AT_REST = "K = 0 and qd_0 = 0"
IDEAL = "ideal current loop: tau_m = G_tau_i I_m"


def closed_velocity_loop(correction: sp.Eq = CORRECTION, carriage: sp.Eq = CARRIAGE) -> sp.Expr:
    """T_vc: both blocks solved with the error v - qd put back."""
    blocks = [correction.subs(y.e_v, y.v_ref - y.qd_1), carriage]
    return sp.simplify(sp.solve(blocks, [y.qd_1, y.u], dict=True)[0][y.qd_1] / y.v_ref)


def derive_velocity_loop(correction: sp.Eq = CORRECTION, carriage: sp.Eq = CARRIAGE) -> tuple[DerivationStep, ...]:
    """Derive (6) to (9) from the blocks.

    >>> [(step.number, step.verdict) for step in derive_velocity_loop() if step.number]
    ... # doctest: +NORMALIZE_WHITESPACE
    [('6', 'as printed'), ('7', 'as printed'), ('7', 'as printed'), ('8', 'as printed once K_c is read as K_v'),
     ('9', 'as printed'), ('9', 'as printed once K is read as K_v'), ('9', 'as printed')]
    """
    rests_on = (LINEAR, FREE, CURRENT_LOOP, CONTINUOUS)
    solved = sp.solve([correction, carriage], [y.qd_1, y.u], dict=True)[0]
    T_vo = sp.factor(solved[y.qd_1] / y.e_v)
    real, imaginary = _crossover(T_vo)
    k = sp.simplify(sp.solve(real, y.k_v1)[0])
    t = sp.simplify(sp.solve(imaginary.subs(y.k_v1, k), y.t_v)[0])
    T_vc = closed_velocity_loop(correction, carriage)
    stiffness = {y.K_v: y.k_v1 * y.G_tau / y.t_v}
    return (
        DerivationStep("Correction", "", Equation(*correction.args),
                       "Fig. 4: integral of the velocity error, proportional to the velocity.", (CONTINUOUS,)),
        DerivationStep("Drive and carriage", "", Equation(*carriage.args), "(1) and (2).",
                       (LINEAR, FREE, CURRENT_LOOP)),
        compared("Open loop at the velocity error", "6", Equation(y.T_vo, T_vo),
                 "Both blocks solved for the response of the velocity to e_v, with the proportional path closed.",
                 rests_on),
        DerivationStep("Crossover and phase margin", "", Equation(real, sp.Integer(0)),
                       "Real part of T_vo(j omega_v) = exp(j (-pi + phi_v)), multiplied out.", rests_on),
        compared("Gain", "7", Equation(y.k_v1, k),
                 "Positive only for phi_v above atan(F_v/(M omega_v)), finite only below 90 deg.",
                 (*rests_on, FEASIBLE)),
        compared("Integral time", "7", Equation(y.t_v, t), "The imaginary part, with this gain.",
                 (*rests_on, FEASIBLE), put={y.k_v1: k}),
        compared("Closed loop", "8", Equation(y.T_vc, T_vc), "e_v = v - qd and K_v = k_v1 G_tau/t_v inserted.",
                 rests_on, put=stiffness),
        *_canonical(T_vc, rests_on, stiffness),
        *_from_the_specification(T_vc, k, t, (*rests_on, FEASIBLE)),
        *_plant_input_loop(correction, carriage, rests_on),
    )  # fmt: skip


def derive_pi_loop(correction: sp.Eq = PI_CORRECTION, carriage: sp.Eq = CARRIAGE) -> tuple[DerivationStep, ...]:
    """Derive (6) to (9) with the proportional part on the velocity error, as in servo drives.

    >>> all(step.holds for step in derive_pi_loop())
    True
    """
    rests_on = (LINEAR, FREE, CURRENT_LOOP, CONTINUOUS)
    solved = sp.solve([correction, carriage], [y.qd_1, y.u], dict=True)[0]
    T_vo = sp.factor(solved[y.qd_1] / y.e_v)
    L = _plant_input_loop(CORRECTION, carriage, rests_on)[0].equation.rhs
    parts = _crossover(T_vo.subs(y.k_v1, y.K_v * y.t_v / y.G_tau))
    solution = sp.solve(parts, [y.K_v, y.t_v], dict=True)[0]
    k, t = sp.simplify(solution[y.K_v] * solution[y.t_v] / y.G_tau), sp.simplify(solution[y.t_v])
    T_vc, ip = closed_velocity_loop(correction, carriage), closed_velocity_loop(CORRECTION, carriage)
    end = sp.pi / 2 + sp.atan(y.F_v1 / (y.M_1 * y.omega_v))
    return (
        DerivationStep("PI correction", "", Equation(*correction.args),
                       "Proportional and integral of the velocity error.", (CONTINUOUS,)),
        DerivationStep("Open loop at the velocity error, PI", "", Equation(y.T_vo, T_vo),
                       "There is no inner loop.", rests_on,
                       (("it is the loop of IP at the plant input", sp.simplify(T_vo - L) == 0),)),
        DerivationStep("Gain, PI", "", Equation(y.k_v1, k), "T_vo(j omega_v) = exp(j (-pi + phi_v)).",
                       (*rests_on, PHASES)),
        DerivationStep("Integral time, PI", "", Equation(y.t_v, t),
                       "The imaginary part of that equation; at the upper end of the range the integral is zero.",
                       (*rests_on, PHASES),
                       (("1/t_v is 0 at the upper end", sp.simplify((1 / t).subs(y.phi_v, end)) == 0),)),
        DerivationStep("Closed loop, PI", "", Equation(y.T_vc, sp.factor(T_vc)),
                       "The poles of (8), and a zero at -1/t_v: faster and with more overshoot for the same gains.",
                       rests_on,
                       (("T_vc of PI is (8) times 1 + t_v s", sp.simplify(T_vc / ip - 1 - y.t_v * y.s) == 0),)),
        DerivationStep("PI with a reference filter", "", Equation(y.T_vc, sp.factor(T_vc / (1 + y.t_v * y.s))),
                       "A filter 1/(1 + t_v s) of the reference cancels the zero.", rests_on,
                       (("the result is (8)", sp.simplify(T_vc / (1 + y.t_v * y.s) - ip) == 0),)),
    )  # fmt: skip


def _crossover(T_vo: sp.Expr) -> tuple[sp.Expr, sp.Expr]:
    numerator, denominator = sp.fraction(sp.together(T_vo.subs(y.s, sp.I * y.omega_v)))
    balance = sp.expand(denominator * (-sp.cos(y.phi_v) - sp.I * sp.sin(y.phi_v)) - numerator)
    real, imaginary = (sp.expand(part) for part in balance.as_real_imag())
    # Which of the two has k_v1 without t_v depends on the blocks; that one is solved first.
    both = sorted((real, imaginary), key=lambda part: part.subs(y.k_v1, 0).has(y.t_v) and part.has(y.t_v))
    return both[0], both[1]


def _coefficients(T_vc: sp.Expr) -> tuple[sp.Expr, sp.Expr]:
    """Natural frequency and damping ratio of T_vc, by the coefficients of s^2 and s."""
    square, once, _ = sp.Poly(sp.expand(sp.cancel(1 / T_vc)), y.s).all_coeffs()
    w0 = sp.solve(sp.Eq(square, 1 / y.omega_0v**2), y.omega_0v)[0]
    return w0, sp.solve(sp.Eq(once, 2 * y.z_v / y.omega_0v), y.z_v)[0]


def _canonical(T_vc: sp.Expr, rests_on: tuple[str, ...], stiffness: dict) -> list[DerivationStep]:
    w0, z = _coefficients(T_vc)
    form = {y.z_v: z.subs(y.omega_0v, w0), y.omega_0v: w0}
    return [
        compared("Natural frequency", "9", Equation(y.omega_0v, w0), "The coefficient of s^2.", rests_on,
                 put=stiffness),
        compared("Damping ratio", "9", Equation(y.z_v, z), "The coefficient of s.", rests_on, put=stiffness),
        compared("Canonical form", "9", Equation(y.T_vc, T_vc), "With these two, T_vc is (9).", rests_on, put=form),
    ]  # fmt: skip


def _from_the_specification(T_vc: sp.Expr, k: sp.Expr, t: sp.Expr, rests_on: tuple[str, ...]) -> list[DerivationStep]:
    w0, z = _coefficients(T_vc)
    w0_specified = _positive_phase(w0.subs(y.t_v, t).subs(y.k_v1, k))
    z_specified = _positive_phase(z.subs(y.omega_0v, w0).subs(y.t_v, t).subs(y.k_v1, k))
    free = not (w0_specified.free_symbols | z_specified.free_symbols) & {y.M_1, y.F_v1, y.G_tau}
    product = sp.simplify(_positive_phase(2 * z_specified * w0_specified) - y.omega_v * sp.tan(y.phi_v)) == 0
    ratio, omega_b = sp.Symbol("x", positive=True), sp.Symbol(r"\omega_b", positive=True)
    answer = 1 / (1 + 2 * y.z_v * sp.I * sp.sqrt(ratio) - ratio)  # (9) at s = j omega_0v sqrt(x)
    power = sp.simplify(sp.expand(answer * sp.conjugate(answer), complex=True))
    level = sp.Rational(3, 10)  # -3 dB of the magnitude is 10^(-3/10) of its square
    roots = sp.solve(sp.Eq(sp.simplify(1 / power), 10**level), ratio)
    largest = max(roots, key=lambda root: root.subs(y.z_v, 1).evalf())
    return [
        DerivationStep(
            "What T_vc depends on: natural frequency", "", Equation(y.omega_0v, w0_specified),
            "(7) inserted into (9): T_vc depends only on the specification.", rests_on,
            (("it does not depend on mass, friction and gain", free),),
        ),
        DerivationStep(
            "What T_vc depends on: damping ratio", "", Equation(y.z_v, z_specified), "The same.", rests_on,
            (("2 z_v omega_0v = omega_v tan(phi_v)", product),),
        ),
        DerivationStep(
            "Bandwidth of the closed loop", "", Equation(omega_b, y.omega_0v * sp.sqrt(largest)),
            "|T_vc(j omega_b)| = 10^(-3/20), from (9): not the crossover omega_v.", rests_on,
        ),
    ]  # fmt: skip


def _plant_input_loop(correction: sp.Eq, carriage: sp.Eq, rests_on: tuple[str, ...]) -> list[DerivationStep]:
    broken = sp.Symbol("u_{in}")
    opened = sp.solve([correction.subs(y.e_v, -y.qd_1), carriage.subs(y.u, broken)], [y.qd_1, y.u])
    return [
        DerivationStep(
            "Loop broken at the plant input", "", Equation(sp.Symbol("L"), sp.factor(-opened[y.u] / broken)),
            "Delay, current loop and sampling act here: their phase is subtracted from the margin of this loop.",
            rests_on,
        )
    ]  # fmt: skip


def _positive_phase(expression: sp.Expr) -> sp.Expr:
    """Simplify for a phase margin inside (0, 90) deg, where sine and cosine are positive."""
    c = sp.Symbol("c", positive=True)
    tangent = sp.sin(y.phi_v) / sp.cos(y.phi_v)
    free = sp.simplify(expression).rewrite(sp.cos).subs(sp.tan(y.phi_v), tangent)
    return sp.simplify(sp.simplify(free.subs(sp.cos(y.phi_v), c)).subs(c, sp.cos(y.phi_v)))


def derive_force_loop() -> tuple[DerivationStep, ...]:
    """Derive (10) and (11), and the limits of k_e1.

    >>> [(step.number, step.verdict) for step in derive_force_loop() if step.number]
    [('10', 'as printed'), ('11', 'as printed'), ('10', 'not as printed')]
    """
    return (*_paper_steps(), carriage_step(), *routh_steps(), *limits())


def _paper_steps() -> list[DerivationStep]:
    T_vc = 1 / (1 + 2 * y.z_v / y.omega_0v * y.s + y.s**2 / y.omega_0v**2)
    loop = [sp.Eq(y.qd_1, T_vc * y.k_e1 * tau_in), sp.Eq(y.tau_e, y.k_c * y.qd_1)]
    T_eo = sp.simplify(sp.solve(loop, [y.qd_1, y.tau_e], dict=True)[0][y.tau_e] / tau_in)
    unity = sp.simplify(T_eo.subs(y.k_c, 1 / y.k_e1))
    closed = sp.factor(sp.simplify(unity / (1 - unity)))
    rests_on = (SLOW, PAPERS_SIGN)
    v = sp.Symbol(y.qd_1.name, real=True)
    return [
        compared("Force loop, opened at its sum", "10", Equation(y.T_eo, T_eo),
                 "v = k_e1 (tau_ref + tau_e), velocity T_vc v, and tau_e = k_c qd.", rests_on),
        compared("Static gain one", "11", Equation(y.T_eo, unity), "k_c = 1/k_e1.", rests_on),
        DerivationStep(
            "Interpretation of the paper", "", Equation(y.T_eo / (1 - y.T_eo), closed),
            "tau_e is both reference and result: positive feedback.", rests_on,
            (("it has a pole at s = 0", sp.denom(closed).subs(y.s, 0) == 0),),
        ),
        compared(
            "A passive hand", "10", Equation(y.tau_e, -y.k_c * y.qd_1),
            "tau_e acts on the carriage, towards +q, with the power P = tau_e qd. A hand that only damps absorbs "
            "energy, so its force has the other sign.", ("the hand is a damper k_c > 0",),
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
    """Response of the velocity to reference and external force, from the blocks with tau_e on the carriage."""
    per_reference, per_force = answer_to_a_force(correction, carriage)
    T_vc = closed_velocity_loop(correction, carriage)
    short = Sum(((y.T_vc, Sum(((y.v_ref,), (y.s / y.K_v, y.tau_e)))),))
    stiffness = y.k_v1 * y.G_tau / y.t_v
    return DerivationStep(
        "Carriage under reference and force", "", Equation(y.qd_1, short),
        "Correction and (M s + F_v) qd = G_tau u + tau_e solved together: the response to a force contains T_vc, too.",
        (LINEAR, CURRENT_LOOP, CONTINUOUS),
        (
            ("the response to the reference is T_vc", sp.simplify(per_reference - T_vc) == 0),
            ("the response to the force is (s/K_v) T_vc", sp.simplify(per_force - y.s / stiffness * T_vc) == 0),
        ),
    )  # fmt: skip


def routh_steps() -> list[DerivationStep]:
    """Routh's inequality for a cubic, necessary and sufficient, from its factors."""
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
            "With a, b, c > 0 there is no real root s >= 0, so r > 0, and q = c/r > 0: the other two roots are in the "
            "left half-plane if and only if p > 0. As r^2 + b > 0, p has the sign of a b - c: stable if a b > c, and "
            "not stable if a b <= c. A polynomial with a coefficient that is not positive is not stable: roots in the "
            "left half-plane make r, p, q > 0, and with them a, b and c.", ("a, b, c > 0",),
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
    """The largest stable k_e1 against a wall; with a viscous hand there is no limit."""
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
            "tau_e = -(K_env/s) qd inserted into the response to reference and force: negative feedback.", rests_on,
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
            (("it is that limit for K_v to infinity", sp.limit(limit, y.K_v, sp.oo).equals(sensor_limit)),),
        ),
        DerivationStep(
            "A viscous hand has no limit", "", Equation(square, sp.Integer(0)),
            "With tau_e = -k_h qd there are two roots; they are in the left half-plane if and only if both "
            "coefficients are positive, which holds for every k_e1 > 0. Sampling, the current loop or a delay of the "
            "sensor, not included here, add phase, and then there is a limit.",
            (*rests_on, CONTINUOUS),
            (
                ("second order", len(viscous) == 3),
                ("both coefficients are positive for every k_e1 > 0", all(k.is_positive for k in viscous)),
                ("coefficients are sum and product of the roots", sp.Poly(sums, y.s).all_coeffs() == [1, d + h, d * h]),
            ),
        ),
    ]  # fmt: skip


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
    """Apparent mass, damping and Coulomb force of the plant (2) under ``law``, a right-hand side like (30).

    Ideal current loop: ``tau_m = G_tau_i I_m``, so the law, which contains the motor force, is solved for it.
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
    # The law inserted into the model must give the target, and the observer must give the force of the model.
    felt = sp.solve(model.subs(y.tau_m, derived["27"].expression), y.tau_e)[0]
    closes = sp.simplify(felt - target.rhs) == 0
    same_force = (
        sp.simplify(derived["29"].expression.subs(y.current, y.tau_m / y.G_ti) - sp.solve(model, y.tau_e)[0]) == 0
    )
    sum_of_two = derived["28"].expression.subs(y.tau_e, derived["29"].expression)
    return [
        compared("Model of the law", "24", Equation(Sum(((y.tau_m,), (y.tau_e,))), of_model),
                 "(2) with the estimates of the law, marked by hats.", (ONE_QUADRANT, BELIEVED)),
        compared("Target impedance", "25", Equation(y.tau_e, of_target),
                 "The impedance that the operator is to feel, with stiffness K about q_0.", ("chosen",)),
        compared("Acceleration of the target", "26", Equation(y.qdd, derived["26"]), "(25) solved.", ("M_a > 0",)),
        compared("The law", "27", Equation(y.tau_m, derived["27"]),
                 "(26) inserted into (24). As printed, the viscous compensation acts on the relative velocity: it "
                 "differs by the estimate of F_v times the reference velocity, which is zero in co-manipulation.",
                 (ONE_QUADRANT, BELIEVED), (("inserted into (24) it gives (25)", closes),)),
        compared("The law for co-manipulation", "28", Equation(y.tau_m, derived["28"]), "(27) with these two.",
                 (ONE_QUADRANT, BELIEVED, AT_REST)),
        compared("Observer of the external force", "29", Equation(y.tau_eh, derived["29"]),
                 "(24) solved for the external force, with the motor force from the current.",
                 (ONE_QUADRANT, BELIEVED, IDEAL), (("it is the tau_e of (24)", same_force),)),
        compared("The law without a force sensor", "30", Equation(y.tau_m, derived["30"]),
                 "(29) inserted into (28). As printed, the term of the current has an additional factor 2, and the "
                 "hats of F_v and F_c are missing.", (ONE_QUADRANT, BELIEVED, AT_REST, IDEAL),
                 (("it is (28) with (29) for tau_e",
                   sp.expand(derived["30"].expression - sum_of_two) == 0),)),
    ]  # fmt: skip


def _closed_steps(law: sp.Expr) -> list[DerivationStep]:
    exact = {y.M_h: y.M, y.F_vh: y.F_v, y.F_ch: y.F_c}
    rests_on = (IDEAL, "no filters, continuous time")
    steps = []
    for title, damping_title, rests, words in (
        ("Felt with the law as derived", law, rests_on, "The target and the errors of the estimates."),
        ("Felt with the law as derived, estimates exact", law.subs(exact), (*rests_on, "exact estimates"),
         "Exactly the target."),
        ("Felt with (30) as printed, estimates exact", printed_law().subs(exact), (*rests_on, "exact estimates"),
         "More mass, more damping, and remaining dry friction."),
    ):  # fmt: skip
        felt = felt_under(damping_title)
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
            "No external force, constant velocity: positive if Coulomb friction is over-estimated.", rests_on,
            (("over-estimated by epsilon it is epsilon F_c/(B - epsilon F_v)",
              sp.simplify(over - error * y.F_c / (y.B - error * y.F_v)) == 0),),
        ),
    ]  # fmt: skip
