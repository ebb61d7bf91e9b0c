"""Equations in the order and with the signs in which the paper writes them, as LaTeX and as plain text.

SymPy reorders the terms of a sum. A :class:`Sum` preserves the given order; everything else is printed by SymPy. The
Python names of the paper's symbols are those of the code; their SymPy names are the paper's LaTeX.

This file contains every numbered equation, Tables I and II and the error ranges as printed, with misprints. The
derivations are compared with them; no computation uses them. The text was read from a scan, so a single symbol may be
a reading error and not one of the paper.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

import sympy as sp


def _real(text: str) -> list[sp.Symbol]:
    return [sp.Symbol(name, real=True) for name in text.split(" ; ")]


def _positive(text: str) -> list[sp.Symbol]:
    return [sp.Symbol(name, positive=True) for name in text.split(" ; ")]


def _words(text: str) -> list[sp.Symbol]:
    """Non-commutative symbols for matrices."""
    return [sp.Symbol(name, commutative=False) for name in text.split(" ; ")]


# Drive and carriage, (1) to (5)
q, qd, qdd, q_0, qd_0 = _real(r"q ; \dot{q} ; \ddot{q} ; q_0 ; \dot{q}_0")
tau_m, tau_e, tau_eh, tau_ref = _real(r"\tau_m ; \tau_e ; \hat{\tau}_e ; \tau_{ref}")
S = sp.Symbol(r"\operatorname{sign}(\dot{q})", real=True)
M, F_v, F_c, F_s, qd_s, delta_s = _positive(r"M ; F_v ; F_c ; F_s ; \dot{q}_s ; \delta_s")
G_i, r, k_t, G_tau, G_ti = _positive(r"G_i ; r ; k_t ; G_{\tau} ; G_{\tau i}")
v_I, current = _real("v_I ; I_m")

# Cascaded loops, (6) to (11); the paper has the index 1 there
M_1, F_v1, k_v1, t_v, omega_v, K_v, omega_0v, z_v = _positive(
    r"M_1 ; F_{v1} ; k_{v1} ; t_v ; \omega_v ; K_v ; \omega_{0v} ; z_v"
)
k_e1, k_c, K_env, k_h, K_c, K_ = _positive("k_{e1} ; k_c ; K_{env} ; k_h ; K_c ; K")
s = sp.Symbol("s")
phi_v = sp.Symbol(r"\phi_v", real=True)
v_ref, qd_1, u, e_v = sp.symbols(r"v_{\dot{q}} \dot{q}_1 u e_v")
T_vo, T_vc, T_eo = sp.symbols("T_{vo} T_{vc} T_{eo}")

# Impedance law, (24) to (30)
M_h, F_vh, F_ch = _positive(r"\hat{M} ; \hat{F}_v ; \hat{F}_c")
M_a, B, K, M_o = _positive("M_a ; B ; K ; M_o")

# Identification and observation, (12) to (23)
n, p = sp.symbols("n p", integer=True, positive=True)
I_n, I_N = sp.symbols(r"\mathbf{I_n} \mathbf{I_N}")
residual = sp.Symbol(r"\Vert\tau_{\mathbf{m1}} - \mathbf{W_1}\widehat{\mathbf{X}}_{\mathbf{1}}\Vert", positive=True)
variance = sp.Symbol(r"\widehat{\sigma}_{\rho}^2", positive=True)
sigma, sigma_x, x = _positive(r"\sigma_{\rho} ; \hat{\sigma}_{X} ; X")
W, X, X_hat, Y, e_i = _words(r"\mathbf{W} ; \mathbf{X} ; \widehat{\mathbf{X}} ; \mathbf{Y} ; \mathbf{e_i}")
W_1v, X_1, X_1h, e_1 = _words(r"\mathbf{W_1} ; \mathbf{X_1} ; \widehat{\mathbf{X}}_{\mathbf{1}} ; \mathbf{e_1}")
W_2, X_2, X_1m, e_2 = _words(
    r"\mathbf{W_2} ; \mathbf{X_2} ; \widehat{\overline{\mathbf{X}}}_{\mathbf{1}} ; \mathbf{e_2}"
)
(tau_m1,) = _words(r"\tau_{\mathbf{m1}}")
tau_m2, tau_e2, tau_e2h, tau_mv, tau_ev, tau_evh = _words(
    r"\tau_{\mathbf{m2}} ; \tau_{\mathbf{e2}} ; \widehat{\tau}_{\mathbf{e2}} ; "
    r"\tau_{\mathbf{m}} ; \tau_{\mathbf{e}} ; \widehat{\tau}_{\mathbf{e}}"
)
W_1 = sp.MatrixSymbol(r"\mathbf{W}_1", n, p)
C_rho = sp.Symbol(r"\mathbf{C}_{\rho\rho}")
C_x = sp.MatrixSymbol(r"\mathbf{C}_{\widehat{X}_1\widehat{X}_1}", p, p)


@dataclass(frozen=True)
class Sum:
    """A sum of ``terms`` in their order, each a tuple of factors: SymPy expressions, or a :class:`Sum` in brackets.

    >>> a, b = sp.symbols("a b")
    >>> written = Sum(((Sum(((b,), (-1,))), a), (-2, b)))
    >>> text(written), written.expression
    ('(b - 1) a - 2 b', a*(b - 1) - 2*b)
    """

    terms: tuple[tuple[Any, ...], ...]

    @property
    def expression(self) -> sp.Expr:
        """The sum as a SymPy expression."""
        return sp.Add(*(sp.Mul(*(_expression(factor) for factor in term)) for term in self.terms))

    def subs(self, changes: dict[Any, Any]) -> Sum:
        """Substitute symbols in every factor; the order does not change."""
        return Sum(
            tuple(
                tuple(f.subs(changes) if isinstance(f, Sum) else sp.sympify(f).subs(changes) for f in term)
                for term in self.terms
            )
        )


def _expression(factor: Any) -> sp.Expr:
    return factor.expression if isinstance(factor, Sum) else sp.sympify(factor)


def in_order(expression: sp.Expr, signals: tuple[sp.Expr, ...], ratio: tuple[sp.Symbol, sp.Symbol]) -> Sum:
    """Write ``expression``, linear in ``signals``, as their sum in that order, with coefficients in ``ratio``.

    The coefficients are polynomials in the quotient of the two symbols of ``ratio``, here M-hat over M_a. A signal may
    be a difference of two symbols; the first symbol is then replaced by the second plus that signal.

    >>> a, b, x, y = sp.symbols("a b x y")
    >>> text(in_order(a / b * x - y - x, (x, y), (a, b)))
    '(a/b - 1) x - y'
    """
    places = {signal: sp.Dummy() for signal in signals}
    original = expression
    for signal, place in places.items():
        if signal.is_Add:
            (minus,) = [term for term in signal.args if term.could_extract_minus_sign()]
            expression = expression.subs(-minus, signal - minus - place)
    expanded = sp.expand(expression).subs({signal: place for signal, place in places.items() if signal.is_Symbol})
    ordered = Sum(
        tuple(
            (*_factors(expanded.coeff(place), ratio), _bracket(signal) if signal.is_Add else signal)
            for signal, place in places.items()
            if expanded.coeff(place) != 0
        )
    )
    difference = sp.expand(ordered.expression - original)
    if difference != 0 and sp.simplify(difference) != 0:
        raise ValueError(f"not linear in {signals}: {original}")
    return ordered


def _bracket(difference: sp.Expr) -> Sum:
    terms = sorted(difference.args, key=lambda term: term.could_extract_minus_sign())
    return Sum(tuple((-1, -term) if term.could_extract_minus_sign() else (term,) for term in terms))


def _factors(coefficient: sp.Expr, ratio: tuple[sp.Symbol, sp.Symbol]) -> tuple[Any, ...]:
    """Factors of a coefficient: number, ratio, sums in brackets, symbols."""
    over, under = ratio
    R = sp.Dummy("R", positive=True)
    number = sp.Integer(1)
    plain: list[sp.Expr] = []
    brackets: list[sp.Expr] = []
    ratios: list[sp.Expr] = []
    if coefficient.has(over):
        coefficient = sp.expand(coefficient).subs(under, over / R)
    for factor in sp.Mul.make_args(sp.factor(coefficient)):
        if factor.is_number:
            number *= factor
        elif factor.is_Add:
            brackets.append(factor)
        else:
            (ratios if factor.has(R) else plain).append(over / under if factor.has(R) else factor)
    # In a bracket that contains a number the ratio is positive; any other bracket absorbs a minus sign.
    for i, bracket in enumerate(brackets):
        has_number = any(term.is_number for term in bracket.args)
        if (has_number and bracket.coeff(R).could_extract_minus_sign()) or (not has_number and number < 0):
            number, brackets[i] = -number, sp.expand(-bracket)
    sums = [
        Sum(
            tuple(
                _term(term, R, over / under)
                for term in sorted(bracket.args, key=lambda t: (t.could_extract_minus_sign(), not t.has(R)))
            )
        )
        for bracket in brackets
    ]
    return (*(() if number == 1 else (number,)), *ratios, *sums, *plain)


def _term(term: sp.Expr, R: sp.Symbol, ratio: sp.Expr) -> tuple[Any, ...]:
    """Factors of one term: its sign, the ratio, the others."""
    sign = -1 if term.could_extract_minus_sign() else 1
    factors = sp.Mul.make_args(sign * term)
    return (sign, *(ratio for f in factors if f.has(R)), *(f for f in factors if not f.has(R)))


def latex(written: Any) -> str:
    """LaTeX of a :class:`Sum`, a SymPy expression, or an equation of them."""
    if isinstance(written, Equation):
        return f"{latex(written.left)} = {latex(written.right)}"
    if not isinstance(written, Sum):
        return sp.latex(written)
    return _joined(written, latex, r"\left({}\right)", " ")


def text(written: Any) -> str:
    """The same as one line of plain text with the names qd, qdd, Mhat, sign(qd)."""
    if isinstance(written, Equation):
        return f"{text(written.left)} = {text(written.right)}"
    if not isinstance(written, Sum):
        if isinstance(written, sp.MatrixExpr):
            return plain_name(str(written))
        return str(plain_symbols(sp.sympify(written)))
    return _joined(written, text, "({})", " ")


def _joined(written: Sum, show: Any, bracket: str, between: str) -> str:
    result = ""
    for term in written.terms:
        number = sp.Mul(*(f for f in term if not isinstance(f, Sum) and sp.sympify(f).is_number))
        factors = [f for f in term if isinstance(f, Sum) or not sp.sympify(f).is_number]
        shown = [
            bracket.replace("{}", show(f)) if isinstance(f, Sum) or sp.sympify(f).is_Add else show(f) for f in factors
        ]
        if abs(number) != 1 or not factors:
            shown.insert(0, show(abs(number)))
        sign = "-" if number < 0 else "+"
        result += (f" {sign} " if result else "-" if sign == "-" else "") + between.join(shown)
    return result


@dataclass(frozen=True)
class Equation:
    """The equation ``left = right``; each side is a SymPy expression or a :class:`Sum`."""

    left: Any
    right: Any

    @property
    def lhs(self) -> sp.Expr:
        """Left-hand side as a SymPy expression."""
        return _expression(self.left)

    @property
    def rhs(self) -> sp.Expr:
        """Right-hand side as a SymPy expression."""
        return _expression(self.right)


def plain_symbols(expression: Any) -> Any:
    r"""Return ``expression`` with LaTeX names of its symbols made readable as text: qd, qdd, M_hat, sign(qd).

    >>> plain_symbols(sp.Symbol(r"\ddot{q}") * sp.Symbol(r"\hat{F}_v") * sp.Symbol(r"\tau_e"))
    Fhat_v*qdd*tau_e
    """
    names = {symbol: plain_name(symbol.name) for symbol in expression.atoms(sp.Symbol)}
    return expression.xreplace(
        {
            symbol: sp.Symbol(name, commutative=symbol.is_commutative)
            for symbol, name in names.items()
            if name != symbol.name
        }
    )


def plain_name(name: str) -> str:
    r"""A LaTeX name in the code's words.

    >>> plain_name(r"\widehat{\overline{\mathbf{X}}}_{\mathbf{1}}"), plain_name(r"\dot{q}_1")
    ('Xmeanhat_1', 'qd_1')
    """
    name = re.sub(r"\\(mathbf|operatorname){([^{}]*)}", r"\2", name)
    for command, suffix in (("ddot", "dd"), ("dot", "d"), ("overline", "mean"), ("widehat", "hat"), ("hat", "hat")):
        name = re.sub(rf"\\{command}{{([^{{}}]*)}}", rf"\1{suffix}", name)
    return re.sub(r"[\\{}]", "", name.replace(r"\Vert", "|")).replace(" - ", "-").replace(" ", "_")


_R = M_h / M_a
_COUNTED = Sum(((_R,), (-1,)))  # M-hat/M_a - 1
_MOVED, _AWAY = Sum(((qd,), (-1, qd_0))), Sum(((q,), (-1, q_0)))
_LESS_DAMPING = Sum(((F_vh,), (-1, _R, B)))
_FRICTION = ((F_v, qd), (F_c, S))
_CANONICAL = 1 + 2 * z_v / omega_0v * s + s**2 / omega_0v**2
_MODEL = ((M_h, qdd), (F_vh, qd), (F_ch, S))

EQUATIONS: dict[str, tuple[Equation, ...]] = {
    "1": (Equation(tau_m, Sum(((G_i, r, k_t, v_I),))),),
    "2": (Equation(Sum(((tau_m,), (tau_e,))), Sum(((M, qdd), *_FRICTION))),),
    "3": (Equation(sp.Symbol("F_{fc}"), Sum(_FRICTION)),),
    "4": (
        Equation(
            sp.Symbol("F_{fs}"),
            Sum((*_FRICTION, (Sum(((F_s,), (-1, F_c))), sp.exp(-(sp.Abs(qd / qd_s) ** delta_s)), S))),
        ),
    ),
    "5": (Equation(Sum(((tau_m,), (tau_e,))), W * X),),
    "6": (
        Equation(T_vo, k_v1 * G_tau / (t_v * s) / (M_1 * s + F_v1 + k_v1 * G_tau)),
    ),
    "7": (
        Equation(k_v1, (M_1 * omega_v * sp.tan(phi_v) - F_v1) / G_tau),
        Equation(t_v, k_v1 * G_tau / (M_1 * omega_v**2) * sp.cos(phi_v)),
    ),
    "8": (Equation(T_vc, 1 / (1 + (t_v + F_v1 / K_c) * s + M_1 / K_c * s**2)),),
    "9": (
        Equation(omega_0v, sp.sqrt(K_v / M_1)),
        Equation(z_v, (t_v + F_v1 / K_) * omega_0v / 2),
        Equation(T_vc, 1 / _CANONICAL),
    ),
    "10": (Equation(T_eo, k_e1 * k_c / _CANONICAL), Equation(tau_e, k_c * qd_1)),
    "11": (Equation(T_eo, 1 / _CANONICAL),),
    "12": (Equation(tau_m1, W_1v * X_1),),
    "13": (Equation(C_rho, sigma**2 * I_N),),
    "14": (Equation(variance, residual**2 / (n - p)),),
    "15": (Equation(C_x, sigma**2 * sp.Inverse(sp.MatMul(W_1, W_1.T, evaluate=False))),),
    "16": (Equation(sp.Symbol(r"\%\sigma"), 100 * sigma_x / sp.Abs(x)),),
    "17": (Equation(tau_m1, Sum(((W_1v, X_1h), (e_1,)))),),
    "18": (Equation(tau_e2, Sum(((tau_m2,), (-1, W_2, X_2)))),),
    "19": (Equation(tau_e2h, Sum(((W_2, X_1m), (-1, tau_m2)))),),
    "20": (Equation(tau_e2, Sum(((tau_e2h,), (e_2,)))),),
    "21": (Equation(Y, Sum(((tau_mv,), (tau_ev,)))), Equation(Y, W * X)),
    "22": (Equation(Y, Sum(((W, X_hat), (e_i,)))),),
    "23": (Equation(tau_evh, Sum(((W, X_hat), (-1, tau_mv)))),),
    "24": (Equation(Sum(((tau_m,), (tau_e,))), Sum(_MODEL)),),
    "25": (Equation(tau_e, Sum(((M_a, qdd), (B, _MOVED), (K, _AWAY)))),),
    "26": (Equation(qdd, Sum(((1 / M_o, Sum(((tau_e,), (-1, B, _MOVED), (-1, K, _AWAY)))),))),),
    "27": (
        Equation(
            tau_m,
            Sum(((_COUNTED, tau_e), (_LESS_DAMPING, _MOVED), (F_ch, S), (-1, _R, K, _AWAY))),
        ),
    ),
    "28": (Equation(tau_m, Sum(((_COUNTED, tau_e), (_LESS_DAMPING, qd), (F_ch, S)))),),
    "29": (Equation(tau_eh, Sum((*_MODEL, (-1, G_ti, current)))),),
    "30": (
        Equation(
            tau_m,
            Sum(
                (
                    (_COUNTED, M_h, qdd),
                    (_R, Sum(((F_v,), (-1, B))), qd),
                    (_R, F_c, S),
                    (-2, _COUNTED, G_ti, current),
                )
            ),
        ),
    ),
}  # fmt: skip

# Symbols of the print that can only be misprints, with those that fit.
READ_AS: dict[str, dict[sp.Symbol, sp.Symbol]] = {
    "8": {K_c: K_v},
    "9": {K_: K_v},
    "13": {I_N: I_n},
    "26": {M_o: M_a},
    "30": {F_v: F_vh, F_c: F_ch},
}

# (value, 2 sigma, % sigma) of each parameter, as text, so that the number of digits is the paper's.
_TABLES = {
    "table_1": """
        mass              115.7315   0.5765  0.4981
        viscous_positive  474.9727  17.5686  3.6989
        viscous_negative  563.8568  19.3088  3.4244
        coulomb_positive   17.3811   0.3259  1.8750
        coulomb_negative   11.5846   0.3363  2.9030""",
    "table_2": """
        mass              109    1.24  1.13
        viscous_positive  707   27.5   3.89
        viscous_negative  998   26.4   2.65
        coulomb_positive   18.9  0.21  1.15
        coulomb_negative    9.8  0.21  2.22""",
}
TABLE_TEXT: dict[str, dict[str, tuple[str, str, str]]] = {
    table: {name: (value, two_sigma, percent) for name, value, two_sigma, percent in map(str.split, rows.splitlines())}
    for table, rows in ((table, text.strip()) for table, text in _TABLES.items())
}
TABLES: dict[str, dict[str, tuple[float, float, float]]] = {
    table: {name: (float(row[0]), float(row[1]), float(row[2])) for name, row in rows.items()}
    for table, rows in TABLE_TEXT.items()
}
RANGES: dict[str, tuple[float, float]] = {"rms_1": (3.6, 5.3), "rms_2": (3.9, 5.4), "rms_direct": (2.7, 3.4)}  # N
BREAK_AWAY = 17.0  # N, F_s+ of section III-A
UNIT_OF_K_T = "N/A"  # section II-A
