"""Equations in the order and with the signs in which the paper writes them, as LaTeX and as plain text.

SymPy orders the terms of a sum its own way. A :class:`Sum` keeps the order that it was given; everything else is
printed by SymPy.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

import sympy as sp


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
        """The same for SymPy."""
        return sp.Add(*(sp.Mul(*(_expression(factor) for factor in term)) for term in self.terms))

    def subs(self, changes: dict[Any, Any]) -> Sum:
        """Put other symbols into every factor; the order stays."""
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

    ``ratio`` is numerator and denominator of what the coefficients are polynomials in, here M-hat over M_a. A signal
    that is a difference of symbols stands for itself: the first of them is counted from the second.

    >>> a, b, x, y = sp.symbols("a b x y")
    >>> text(in_order(a / b * x - y - x, (x, y), (a, b)))
    '(a/b - 1) x - y'
    """
    places = {signal: sp.Dummy() for signal in signals}
    given = expression
    for signal, place in places.items():
        if signal.is_Add:
            (minus,) = [term for term in signal.args if term.could_extract_minus_sign()]
            expression = expression.subs(-minus, signal - minus - place)
    expanded = sp.expand(expression).subs({signal: place for signal, place in places.items() if signal.is_Symbol})
    found = Sum(
        tuple(
            (*_factors(expanded.coeff(place), ratio), _bracket(signal) if signal.is_Add else signal)
            for signal, place in places.items()
            if expanded.coeff(place) != 0
        )
    )
    left = sp.expand(found.expression - given)
    if left != 0 and sp.simplify(left) != 0:
        raise ValueError(f"not linear in {signals}: {given}")
    return found


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
    # A bracket with a number in it has the ratio positive; another one takes a minus sign in.
    for i, bracket in enumerate(brackets):
        counted = any(term.is_number for term in bracket.args)
        if (counted and bracket.coeff(R).could_extract_minus_sign()) or (not counted and number < 0):
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
    """Factors of one term: its sign, the ratio, the rest."""
    sign = -1 if term.could_extract_minus_sign() else 1
    factors = sp.Mul.make_args(sign * term)
    return (sign, *(ratio for f in factors if f.has(R)), *(f for f in factors if not f.has(R)))


def latex(written: Any) -> str:
    """LaTeX of a :class:`Sum`, of SymPy, or of an equation of two of them."""
    if isinstance(written, Equation):
        return f"{latex(written.left)} = {latex(written.right)}"
    if not isinstance(written, Sum):
        return sp.latex(written)
    return _joined(written, latex, r"\left({}\right)", " ")


def text(written: Any) -> str:
    """One line of plain text: qd, qdd, Mhat, sign(qd)."""
    if isinstance(written, Equation):
        return f"{text(written.left)} = {text(written.right)}"
    if not isinstance(written, Sum):
        if isinstance(written, sp.MatrixExpr):
            return plain_name(str(written))
        return str(plain_symbols(sp.sympify(written)))
    return _joined(written, text, "({})", " ")


def _joined(written: Sum, show: Any, bracket: str, between: str) -> str:
    out = ""
    for term in written.terms:
        number = sp.Mul(*(f for f in term if not isinstance(f, Sum) and sp.sympify(f).is_number))
        factors = [f for f in term if isinstance(f, Sum) or not sp.sympify(f).is_number]
        shown = [
            bracket.replace("{}", show(f)) if isinstance(f, Sum) or sp.sympify(f).is_Add else show(f) for f in factors
        ]
        if abs(number) != 1 or not factors:
            shown.insert(0, show(abs(number)))
        sign = "-" if number < 0 else "+"
        out += (f" {sign} " if out else "-" if sign == "-" else "") + between.join(shown)
    return out


@dataclass(frozen=True)
class Equation:
    """``left = right``, each SymPy or a :class:`Sum`."""

    left: Any
    right: Any

    @property
    def lhs(self) -> sp.Expr:
        """Left-hand side for SymPy."""
        return _expression(self.left)

    @property
    def rhs(self) -> sp.Expr:
        """Right-hand side for SymPy."""
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
