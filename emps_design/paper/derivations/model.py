"""(1) to (5): drive and carriage from Newton's law, and the model linear in its parameters."""

from __future__ import annotations

import sympy as sp
from sympy.physics import units

from emps_design.paper import symbols as y
from emps_design.paper.derivations.step import DerivationStep, compared
from emps_design.paper.printed import BREAK_AWAY, EQUATIONS, TABLES, UNIT_OF_K_T
from emps_design.paper.written import Equation, Sum

J, m, T, T_s, f = sp.symbols("J m T T_s f", positive=True)
qdd_m = sp.Symbol(r"\ddot{q}_m", real=True)

RIGID = "rigid: the motor turns by q_m = r q"
LOSSLESS = "the screw loses nothing: friction is counted on the load side"
CURRENT_LOOP = "the current loop is a gain, 20 times faster than the velocity loop"
LINE = "friction is a straight line in each direction, away from rest"


def derive_model() -> tuple[DerivationStep, ...]:
    """Derive (1) to (5).

    >>> [(step.number, step.verdict) for step in derive_model() if step.number]  # doctest: +NORMALIZE_WHITESPACE
    [('1', 'as printed'), ('1', 'not as printed'), ('2', 'as printed'), ('3', 'as printed'), ('4', 'as printed'),
     ('5', 'as printed')]
    """
    return (_drive(), _unit(), *_carriage(), *_friction(), _linear())


def _drive() -> DerivationStep:
    # Power in is power out: tau_m qd = T r qd; T = k_t I_m, I_m = G_i v_I.
    force = sp.solve(sp.Eq(y.tau_m * y.qd, T * y.r * y.qd), y.tau_m)[0].subs(T, y.k_t * y.G_i * y.v_I)
    written = Sum(((y.G_i, y.r, y.k_t, y.v_I),))
    return compared(
        "Force of the drive", "1", Equation(y.tau_m, written),
        "The power of the motor's torque T = k_t I_m is that of the force on the carriage: tau_m = r T.",
        (RIGID, LOSSLESS, CURRENT_LOOP),
        (("the power balance gives this product", sp.simplify(force - written.expression) == 0),),
    )  # fmt: skip


def _unit() -> DerivationStep:
    """The unit of k_t from that of every other factor of (1)."""
    newton, metre, ampere, volt = units.newton, units.meter, units.ampere, units.volt
    needed = newton / ((ampere / volt) * (1 / metre) * volt)  # radians are numbers
    printed = {"N/A": newton / ampere}[UNIT_OF_K_T]
    k_t = sp.Symbol("[k_t]")
    return DerivationStep(
        "Unit of the torque constant", "1", Equation(k_t, needed),
        "With tau_m in N, G_i in A/V, r in rad/m and v_I in V, k_t is a torque over a current.",
        ("the units of section II-A for all but k_t",),
        printed=Equation(k_t, printed), difference=sp.simplify(printed - needed),
    )  # fmt: skip


def _carriage() -> list[DerivationStep]:
    rotor = sp.Eq(J * qdd_m, T - T_s)
    screw = sp.Eq(f * y.qd, T_s * y.r * y.qd)
    load = sp.Eq(m * y.qdd, f + y.tau_e - y.F_v * y.qd - y.F_c * y.S)
    drive = sp.Eq(y.tau_m, y.r * T)
    system = [rotor.subs(qdd_m, y.r * y.qdd), screw, load, drive]
    solved = sp.solve(system, [T_s, f, T, y.tau_e], dict=True)[0][y.tau_e]
    total = sp.expand(solved + y.tau_m)
    equivalent = total.coeff(y.qdd)
    derived = Sum(((y.M, y.qdd), (total.coeff(y.qd), y.qd), (total.coeff(y.S), y.S)))
    left = sp.simplify(total.subs(J, (y.M - m) / y.r**2) - derived.expression)
    return [
        DerivationStep(
            "Rotor and screw", "", Equation(J * qdd_m, Sum(((T,), (-1, T_s)))),
            "The motor turns its own inertia J (rotor, coupling, screw) and the screw with T_s.", (RIGID,),
        ),
        DerivationStep(
            "Equivalent mass", "", Equation(y.M, equivalent),
            "The screw pushes with f = r T_s; m is what translates. Coefficient of the acceleration after T, T_s and f "
            "are solved away.", (RIGID, LOSSLESS),
        ),
        compared(
            "Inverse dynamic model", "2", Equation(Sum(((y.tau_m,), (y.tau_e,))), derived),
            "Newton's law for rotor and carriage, the force inside the screw solved away.",
            (RIGID, LOSSLESS, LINE, "no gravity along the axis"),
            (("nothing but mass and friction is left", left == 0),),
        ),
    ]  # fmt: skip


def _friction() -> list[DerivationStep]:
    steady = EQUATIONS["2"][0].rhs.subs(y.qdd, 0)
    stribeck = EQUATIONS["4"][0]
    v = sp.Symbol("v", positive=True)
    moving = stribeck.rhs.subs(y.S, 1).subs(y.qd, v)
    at_rest = sp.limit(moving.subs(y.delta_s, 1), v, 0)
    far = sp.limit(moving.subs(y.delta_s, 1) - (y.F_v * v + y.F_c), v, sp.oo)
    below = TABLES["table_1"]["coulomb_positive"][0] > BREAK_AWAY
    printed = Equation(y.F_s, sp.Float(BREAK_AWAY, 2))
    found = sp.Float(TABLES["table_1"]["coulomb_positive"][0], 6)
    return [
        compared(
            "Friction", "3", Equation(sp.Symbol("F_{fc}"), Sum(((steady.coeff(y.qd), y.qd), (steady.coeff(y.S), y.S)))),
            "What (2) asks for at constant speed.", (LINE,),
        ),
        compared(
            "Break-away", "4", stribeck,
            "A model, not a consequence: it starts from F_s and tends to (3).", ("F_s > F_c", "1 <= delta_s <= 2"),
            (("F_fs tends to F_s at rest", at_rest == y.F_s), ("F_fs - F_fc tends to 0 at high speed", far == 0)),
        ),
        DerivationStep(
            "Break-away force of section III-A", "", Equation(sp.Symbol(r"F_c^+"), found),
            "Section II-B has F_s > F_c; the F_s of section III-A is below the F_c+ of Table I.", ("Table I",),
            printed=Equation(y.F_s, printed.right), difference=printed.right - found if below else sp.Integer(0),
        ),
    ]  # fmt: skip


def _linear() -> DerivationStep:
    plus_v, minus_v, plus_c, minus_c = sp.symbols("F_v^+ F_v^- F_c^+ F_c^-", positive=True)
    X = sp.Matrix([y.M, plus_v, minus_v, plus_c, minus_c])
    checks = []
    for name, row, v_friction, c_friction, sign in (
        ("forth", [y.qdd, y.qd, 0, 1, 0], plus_v, plus_c, 1),
        ("back", [y.qdd, 0, y.qd, 0, -1], minus_v, minus_c, -1),
    ):
        model = EQUATIONS["2"][0].rhs.subs({y.F_v: v_friction, y.F_c: c_friction, y.S: sign})
        checks.append((f"W X is (2) moving {name}", sp.expand((sp.Matrix([row]) * X)[0] - model) == 0))
    return compared(
        "Linear in the parameters", "5", EQUATIONS["5"][0],
        "W = [qdd, qd+, qd-, sign(qd+), sign(qd-)] with X = [M, F_v+, F_v-, F_c+, F_c-]; what belongs to the other "
        "direction is zero.", (LINE,), tuple(checks),
    )  # fmt: skip
