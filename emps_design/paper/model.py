"""A step of a derivation, and the steps of the paper's model and its least squares.

(1) to (5): drive and carriage from Newton's law, and the model linear in its parameters. (12) to (23): least squares
for any number of samples and parameters, its statistics, and the observed force.

A step has an equation, its assumptions, the statements checked by the program, and the printed equation.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import sympy as sp
from sympy.physics import units

from emps_design.paper import written as y
from emps_design.paper.written import (
    BREAK_AWAY,
    EQUATIONS,
    READ_AS,
    TABLE_TEXT,
    TABLES,
    UNIT_OF_K_T,
    Equation,
    Sum,
    latex,
    text,
)
from emps_design.view import Line, View, Viewed

AS_PRINTED, NOT_AS_PRINTED, FAILS = "as printed", "not as printed", "does not hold"

J, m, T, T_s, f = sp.symbols("J m T T_s f", positive=True)
qdd_m = sp.Symbol(r"\ddot{q}_m", real=True)

RIGID = "rigid: the motor turns by q_m = r q"
LOSSLESS = "the screw has no losses: friction is referred to the load side"
CURRENT_LOOP = "the current loop is a gain, 20 times faster than the velocity loop"
LINE = "friction is a straight line in each direction, away from rest"

FULL_RANK = "n > p, and W_1 has full rank p, so that W_1^T W_1 has an inverse"
WHITE = "W_1 is not random; the noise has zero mean and covariance sigma_rho^2 I_n (13)"
rho = sp.MatrixSymbol(r"\rho", y.n, 1)
X_true = sp.MatrixSymbol("X", y.p, 1)


@dataclass(frozen=True)
class DerivationStep(Viewed):
    """One step of a derivation.

    ``number`` is the equation number of the paper ("" for a step between two of its equations), ``assumes`` are the
    assumptions of the step, and ``checks`` the checked statements, each with whether it holds. If the paper prints the
    equation, ``printed`` has it as printed, ``read_as`` its undefined symbols with those that they must mean, and
    ``difference`` is the printed minus the derived right-hand side with these symbols.
    """

    title: str
    number: str
    equation: Equation
    text: str
    assumes: tuple[str, ...] = ()
    checks: tuple[tuple[str, bool], ...] = ()
    printed: Equation | None = None
    read_as: Mapping[sp.Symbol, sp.Symbol] = field(default_factory=dict)
    difference: Any = None

    @property
    def place(self) -> str:
        """Place in the paper: the equation number in brackets, else the title."""
        return f"({self.number})" if self.number else self.title

    @property
    def holds(self) -> bool:
        """Whether all checked statements are true."""
        return all(true for _, true in self.checks)

    @property
    def agrees(self) -> bool | None:
        """Whether the printed equation is the derived one, symbol by symbol; None without a printed equation."""
        return None if self.printed is None else self.difference == 0 and not self.read_as

    @property
    def verdict(self) -> str:
        """The verdict in a few words, "" without a printed equation."""
        if not self.holds:
            return FAILS
        if self.printed is None:
            return ""
        if self.difference != 0:
            return NOT_AS_PRINTED
        read = " and ".join(f"{text(symbol)} is read as {text(meant)}" for symbol, meant in self.read_as.items())
        return f"{AS_PRINTED} once {read}" if read else AS_PRINTED

    def view(self) -> View:
        """The step with its verdict, assumptions, checked statements, and its equation with the printed one."""
        title = "  ".join(filter(None, (self.title, f"({self.number})" if self.number else "", self.verdict)))
        style = "good" if self.agrees else "bad" if self.verdict else "strong"
        return (
            Line(""),
            Line(title, style),
            Line(self.text, "prose"),
            *([Line(f"assumes: {'; '.join(self.assumes)}", "prose")] if self.assumes else []),
            *(Line(f"checked: {claim}{'' if true else ': FOUND FALSE'}", "prose") for claim, true in self.checks),
            Line(f"    {text(self.equation)}", "code"),
            *([Line("printed:"), Line(f"    {text(self.printed)}", "code")] if self.agrees is False else []),
        )

    def to_dict(self) -> dict[str, Any]:
        """Texts, and equations as LaTeX and as text."""

        def both(written: Any) -> dict[str, str] | None:
            return None if written is None else {"latex": latex(written), "text": text(written)}

        return {
            "place": self.place,
            "title": self.title,
            "number": self.number,
            "equation": both(self.equation),
            "text": self.text,
            "assumes": list(self.assumes),
            "checks": [{"claim": claim, "holds": true} for claim, true in self.checks],
            "holds": self.holds,
            "printed": both(self.printed),
            "read_as": {text(symbol): text(meant) for symbol, meant in self.read_as.items()},
            "difference": both(self.difference),
            "agrees": self.agrees,
            "verdict": self.verdict,
        }


def compared(
    title: str,
    number: str,
    derived: Equation,
    words: str,
    assumes: tuple[str, ...] = (),
    checks: tuple[tuple[str, bool], ...] = (),
    put: Mapping[Any, Any] | None = None,
) -> DerivationStep:
    """Return the step with the printed equation of that number and left-hand side beside it.

    ``put`` are expressions that earlier steps derived for symbols of the printed equation.
    """
    printed = next(equation for equation in EQUATIONS[number] if equation.lhs == derived.lhs)
    there = printed.rhs.free_symbols
    read_as = {symbol: meant for symbol, meant in READ_AS.get(number, {}).items() if symbol in there}
    difference = sp.simplify(sp.expand(printed.rhs.subs(read_as).subs(put or {}) - derived.rhs))
    return DerivationStep(title, number, derived, words, assumes, checks, printed, read_as, sp.factor(difference))


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
        "The power of the motor torque T = k_t I_m equals that of the force on the carriage: tau_m = r T.",
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
        "With tau_m in N, G_i in A/V, r in rad/m and v_I in V, k_t is a torque per current.",
        ("the units of section II-A except for k_t",),
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
    difference = sp.simplify(total.subs(J, (y.M - m) / y.r**2) - derived.expression)
    return [
        DerivationStep(
            "Rotor and screw", "", Equation(J * qdd_m, Sum(((T,), (-1, T_s)))),
            "The motor torque accelerates the inertia J (rotor, coupling, screw) and loads the screw with T_s.",
            (RIGID,),
        ),
        DerivationStep(
            "Equivalent mass", "", Equation(y.M, equivalent),
            "The screw force is f = r T_s; m is the translating mass. Coefficient of the acceleration after "
            "elimination of T, T_s and f.", (RIGID, LOSSLESS),
        ),
        compared(
            "Inverse dynamic model", "2", Equation(Sum(((y.tau_m,), (y.tau_e,))), derived),
            "Newton's law for rotor and carriage, with the force in the screw eliminated.",
            (RIGID, LOSSLESS, LINE, "no gravity along the axis"),
            (("only mass and friction remain", difference == 0),),
        ),
    ]  # fmt: skip


def _friction() -> list[DerivationStep]:
    steady = EQUATIONS["2"][0].rhs.subs(y.qdd, 0)
    stribeck = EQUATIONS["4"][0]
    v = sp.Symbol("v", positive=True)
    moving = stribeck.rhs.subs(y.S, 1).subs(y.qd, v)
    at_rest = sp.limit(moving.subs(y.delta_s, 1), v, 0)
    asymptote = sp.limit(moving.subs(y.delta_s, 1) - (y.F_v * v + y.F_c), v, sp.oo)
    below = TABLES["table_1"]["coulomb_positive"][0] > BREAK_AWAY
    printed = Equation(y.F_s, sp.Float(BREAK_AWAY, 2))
    identified = sp.Float(TABLES["table_1"]["coulomb_positive"][0], 6)
    return [
        compared(
            "Friction", "3", Equation(sp.Symbol("F_{fc}"), Sum(((steady.coeff(y.qd), y.qd), (steady.coeff(y.S), y.S)))),
            "(2) at constant speed.", (LINE,),
        ),
        compared(
            "Break-away", "4", stribeck,
            "A model, not a derivation: it is F_s at rest and tends to (3).", ("F_s > F_c", "1 <= delta_s <= 2"),
            (("F_fs tends to F_s at rest", at_rest == y.F_s), ("F_fs - F_fc tends to 0 at high speed", asymptote == 0)),
        ),
        DerivationStep(
            "Break-away force of section III-A", "", Equation(sp.Symbol(r"F_c^+"), identified),
            "Section II-B has F_s > F_c; the F_s of section III-A is below the F_c+ of Table I.", ("Table I",),
            printed=Equation(y.F_s, printed.right), difference=printed.right - identified if below else sp.Integer(0),
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
        "W = [qdd, qd+, qd-, sign(qd+), sign(qd-)] with X = [M, F_v+, F_v-, F_c+, F_c-]; the columns of the other "
        "direction are zero.", (LINE,), tuple(checks),
    )  # fmt: skip


def estimator(W: sp.MatrixExpr = y.W_1) -> sp.MatrixExpr:
    """The matrix of the least-squares estimate from the forces: ``(W^T W)^-1 W^T``, for any n x p."""
    return sp.Inverse(W.T * W) * W.T


def derive_least_squares() -> tuple[DerivationStep, ...]:
    """Derive (12) to (23).

    >>> steps = derive_least_squares()
    >>> [step.number for step in steps if step.agrees is False]
    ['13', '15', '16', '18']
    >>> all(step.holds for step in steps)
    True
    """
    return (_free(), _noise(), _normal(), _variance(), covariance_step(), relative_deviation_step(), *_observation())


def _free() -> DerivationStep:
    return compared(
        "Without an external force", "12", Equation(y.tau_m1, y.W_1v * y.X_1),
        "(5) with tau_e = 0, one row per sample.", ("nobody touches the carriage",),
    )  # fmt: skip


def _noise() -> DerivationStep:
    square = (rho * rho.T).shape == (y.n, y.n)
    return compared(
        "Covariance of the noise", "13", Equation(y.C_rho, y.sigma**2 * y.I_n),
        "rho has one row for each of the n samples; the printed N must be n.",
        ("samples are independent and have equal variance",), (("rho rho^T is n x n", square),),
    )  # fmt: skip


def _normal() -> DerivationStep:
    A = estimator()
    tau = y.W_1 * X_true + rho
    residual = tau - y.W_1 * A * tau
    across = (y.W_1.T * residual).expand().doit()
    exact = (A * y.W_1).doit() == sp.Identity(y.p)
    return compared(
        "Residual", "17", Equation(y.tau_m1, Sum(((y.W_1v, y.X_1h), (y.e_1,)))),
        "e_1 is the residual of the estimate; least squares makes it orthogonal to every column of W_1.", (FULL_RANK,),
        (
            ("W_1^T e_1 = 0", across == sp.ZeroMatrix(y.p, 1) or across == 0),
            ("forces without noise give the exact parameters", exact),
        ),
    )  # fmt: skip


def _variance() -> DerivationStep:
    """(14): E ||e||^2 = sigma^2 tr((I - H)^T (I - H)) = sigma^2 (n - p)."""
    W, A, identity = y.W_1, estimator(), sp.Identity(y.n)
    H = W * A
    residual_maker = identity - H
    once = sp.MatMul(*H.args, *H.args).doit() == H and H.T.doit() == H
    blind = (residual_maker * W).expand().doit() == sp.ZeroMatrix(y.n, y.p)
    # The trace of a product is that of its factors in a circle: tr(W A) = tr(A W).
    rank = sp.Trace(A * W).doit()
    degrees = sp.Trace(identity).doit() - rank
    return compared(
        "Variance of the noise", "14", Equation(y.variance, y.residual**2 / degrees),
        "e_1 = (I - H) rho with the projector H = W_1 (W_1^T W_1)^-1 W_1^T, so E(e_1^T e_1) = sigma_rho^2 tr(I - H).",
        (FULL_RANK, WHITE),
        (("H H = H and H^T = H", once), ("(I - H) W_1 = 0", blind), ("tr(H) = p", rank == y.p)),
    )  # fmt: skip


def covariance(A: sp.MatrixExpr, sigma: sp.Symbol = y.sigma) -> sp.MatrixExpr:
    """Covariance of ``A tau`` for noise of covariance ``sigma^2 I``."""
    return sigma**2 * (A * A.T).doit()


def covariance_step(A: sp.MatrixExpr | None = None) -> DerivationStep:
    """(15) for any n x p, from the matrix ``A`` of the estimate, by default :func:`estimator`."""
    A = estimator() if A is None else A
    W, identity = y.W_1, sp.Identity(y.n)
    error = (A * (W * X_true + rho)).expand().doit() - X_true
    C = covariance(A)
    H = W * estimator()
    # Whatever is orthogonal to W is sent to zero by W W^T; there is such a thing, for the trace of I - H is n - p > 0.
    sent_to_zero = (W * W.T * (identity - H)).expand().doit() == sp.ZeroMatrix(y.n, y.n)
    more = sp.Trace(identity).doit() - sp.Trace(estimator() * W).doit()
    printed = EQUATIONS["15"][0]
    same = printed.right.shape == C.shape and sp.simplify(printed.right - C) == sp.ZeroMatrix(*C.shape)
    inverse = (C * W.T * W / y.sigma**2).doit()
    return DerivationStep(
        "Covariance of the estimate", "15", Equation(y.C_x, C),
        "The error of the estimate is A rho with A = (W_1^T W_1)^-1 W_1^T, and E(A rho rho^T A^T) = sigma_rho^2 A A^T. "
        "The printed inverse does not exist: W_1 W_1^T is n x n and maps every column of I - H to zero, "
        "which is not zero for n > p; C is p x p.",
        (FULL_RANK, WHITE),
        (
            ("the error of the estimate is A rho", (error - A * rho).expand().doit() == sp.ZeroMatrix(y.p, 1)),
            ("C W_1^T W_1 / sigma_rho^2 is the identity", inverse == sp.Identity(y.p)),
            ("W_1 W_1^T (I - H) = 0", sent_to_zero),
            ("tr(I - H) = n - p", sp.simplify(more - (y.n - y.p)) == 0),
            ("W_1 W_1^T is n x n, C is p x p", (W * W.T).shape == (y.n, y.n) and C.shape == (y.p, y.p)),
        ),
        printed,
        {},
        sp.Integer(0) if same else printed.right,
    )  # fmt: skip


def _interval(cell: str, cut: bool) -> tuple[float, float]:
    """The ranges of numbers printed as ``cell``: rounded to its last digit, or truncated after it."""
    unit = 10.0 ** -(len(cell.split(".")[1]) if "." in cell else 0)
    value = float(cell)
    return (value, value + unit) if cut else (value - 0.5 * unit, value + 0.5 * unit)


def column_factor(row: tuple[str, str, str], cut: bool = False) -> tuple[float, float]:
    """Least and largest ratio of the column %sigma to 100 sigma/|X| that the digits of a table's row allow.

    >>> [round(bound, 2) for bound in column_factor(("115.7315", "0.5765", "0.4981"))]
    [2.0, 2.0]
    """
    (x0, x1), (d0, d1), (c0, c1) = (_interval(cell, cut) for cell in row)
    return c0 * x0 / (100.0 * d1 / 2.0), c1 * x1 / (100.0 * d0 / 2.0)


def relative_deviation_step() -> DerivationStep:
    """(16) against every row of Tables I and II."""
    checks, factors = [], []
    for table, rows in TABLE_TEXT.items():
        for name, row in rows.items():
            low, high = column_factor(row)
            cut_low, cut_high = column_factor(row, cut=True)
            factors.append(0.5 * (low + high))
            rounded, either = low <= 2.0 <= high, cut_low <= 2.0 <= cut_high
            how = "" if rounded else ", truncated instead of rounded"
            where = {"table_1": "Table I", "table_2": "Table II"}[table]
            checks.append((f"{where}, {name.replace('_', ' ')}: twice (16){how}", rounded or either))
            checks.append((f"{where}, {name.replace('_', ' ')}: not (16) itself", not low <= 1.0 <= high))
    factor = sp.Integer(round(sum(factors) / len(factors)))
    percent_sigma = sp.Symbol(r"\%\sigma")
    derived = Equation(percent_sigma, factor * 100 * y.sigma_x / sp.Abs(y.x))
    return compared(
        "Relative standard deviation in Tables I and II", "16", derived,
        "The column has two standard deviations over the value, (16) has one; within the printed digits, in every row.",
        ("a printed number is rounded to its last digit, or truncated after it",), tuple(checks),
    )  # fmt: skip


def _observation() -> list[DerivationStep]:
    """(18) to (23) from (5); W X does not commute, so these are solved by hand and checked by substitution."""
    balance = "(5) on the second experiments"

    def solved(unknown: sp.Symbol, W: sp.Symbol, X: sp.Symbol, motor: sp.Symbol) -> tuple[Equation, tuple[str, bool]]:
        force = Sum(((W, X), (-1, motor)))
        return Equation(unknown, force), ("substituted into (5)", sp.expand(motor + force.expression - W * X) == 0)

    observed, back = solved(y.tau_e2, y.W_2, y.X_2, y.tau_m2)
    cross, cross_back = solved(y.tau_e2h, y.W_2, y.X_1m, y.tau_m2)
    square, own_back = solved(y.tau_evh, y.W, y.X_hat, y.tau_mv)
    error = sp.expand(y.Y - y.W * y.X_hat)
    observer_error = sp.expand((y.Y - y.tau_mv) - square.rhs)
    return [
        compared(
            "External force from the model", "18", observed,
            "(5) solved for the external force, as in (19) and (23); (18) is printed with the opposite sign.",
            (balance,), (back,),
        ),
        compared(
            "The same with identified parameters", "19", cross, "X_2 is unknown: the mean of ten identifications "
            "replaces it.", (balance, "friction is that of the identification"), (cross_back,),
        ),
        compared(
            "Error of the observer", "20", Equation(y.tau_e2, Sum(((y.tau_e2h,), (y.e_2,)))),
            "e_2 is the error of (19).", (balance,),
        ),
        compared(
            "Direct validation", "21", Equation(y.Y, Sum(((y.tau_mv,), (y.tau_ev,)))),
            "Both forces of (5) are measured.", ("the sensor reads the force on the carriage",),
        ),
        compared(
            "Its error", "22", Equation(y.Y, Sum(((y.W, y.X_hat), (y.e_i,)))),
            "e_i is the residual of least squares.", ("the sensor reads the force on the carriage",),
        ),
        compared(
            "Its observed force", "23", square, "(21) and (22): the measured minus the observed force is e_i.",
            ("the sensor reads the force on the carriage",),
            (own_back, ("tau_e minus the observed force is e_i", sp.expand(observer_error - error) == 0)),
        ),
    ]  # fmt: skip
