"""The derivations: every claim holds, a broken premise or print is seen, and LaTeX that compiles."""

import shutil
import subprocess
from dataclasses import replace

import numpy as np
import pytest
import sympy as sp

from emps_design.commands import derive
from emps_design.messages import Severity
from emps_design.paper import written as y
from emps_design.paper.errata import derivation, document, find_errata
from emps_design.paper.loops import (
    CARRIAGE,
    CORRECTION,
    MODEL,
    TARGET,
    carriage_step,
    characteristic,
    derive_impedance,
    derive_velocity_loop,
    derived_law,
    limits,
)
from emps_design.paper.model import column_factor, covariance, covariance_step, estimator
from emps_design.paper.written import EQUATIONS, TABLE_TEXT, Equation, latex, text


@pytest.fixture(scope="module")
def steps():
    """Every step of every part, derived where a test asks: a module is imported by every worker."""
    return [one for _, part in derivation().values() for one in part]


def verdicts(steps):
    return {one.number: one.verdict for one in steps if one.number}


@pytest.mark.slow("derives every equation")
def test_every_claim_holds_and_every_step_says_what_it_assumes(steps):
    assert [one.title for one in steps if not one.holds] == []
    assert [one.title for one in steps if not one.assumes] == []


def test_every_printed_equation_is_compared(steps):
    compared = {one.number for one in steps if one.printed is not None}
    assert compared - {""} == set(EQUATIONS) == {str(number) for number in range(1, 31)}


def test_what_is_not_as_printed(steps):
    places = [one.place for one in find_errata()]
    assert [p for p in places if p.startswith("(")] == [
        "(1)", "(8)", "(9)", "(10)", "(13)", "(15)", "(16)", "(18)", "(26)", "(27)", "(30)",
    ]  # fmt: skip
    assert {"8", "9", "26", "13"} <= {one.number for one in steps if "once" in one.verdict}
    found = verdicts(steps)
    assert found["26"] == "as printed once M_o is read as M_a"
    assert found["30"] == "not as printed"


def test_the_law_stands_in_the_order_and_with_the_signs_of_the_paper():
    assert text(EQUATIONS["30"][0]) == (
        "tau_m = (Mhat/M_a - 1) Mhat qdd + Mhat/M_a (F_v - B) qd + Mhat/M_a F_c sign(qd) - 2 (Mhat/M_a - 1) G_tau_i I_m"
    )
    assert text(derived_law()["30"]) == (
        "(Mhat/M_a - 1) Mhat qdd + Mhat/M_a (Fhat_v - B) qd + Mhat/M_a Fhat_c sign(qd) - (Mhat/M_a - 1) G_tau_i I_m"
    )
    assert text(derived_law()["28"]) == text(EQUATIONS["28"][0].right)
    assert latex(y.W * y.X) == r"\mathbf{W} \mathbf{X}"


@pytest.mark.slow("derives every equation again")
def test_a_broken_print_is_seen(monkeypatch):
    """Any printed equation with a factor too many is not as printed any more; (3) to (5) are what others rest on."""
    broken = [number for number in EQUATIONS if number not in ("3", "4", "5")]
    for number in broken:
        monkeypatch.setitem(EQUATIONS, number, tuple(Equation(one.left, 3 * one.rhs) for one in EQUATIONS[number]))
    again = [one for _, steps in derivation.__wrapped__().values() for one in steps if one.number in broken]
    assert {one.number for one in again} == set(broken)
    assert [one.title for one in again if one.verdict != "not as printed"] == []


def test_a_broken_block_makes_the_velocity_loop_fail():
    slower = sp.Eq(CARRIAGE.lhs + y.F_v1 * y.qd_1, CARRIAGE.rhs)  # twice the viscous friction
    assert "not as printed" in verdicts(derive_velocity_loop(carriage=slower)).values()
    double = sp.Eq(y.u, y.k_v1 * (y.e_v / (y.t_v * y.s) - 2 * y.qd_1))  # twice the proportional path
    assert verdicts(derive_velocity_loop(correction=double))["6"] == "not as printed"


def test_a_broken_carriage_fails_its_step():
    assert carriage_step().holds
    there = sp.Eq(CARRIAGE.lhs, CARRIAGE.rhs + y.F_v1 * y.tau_e)  # a force that comes in scaled
    assert not carriage_step(CORRECTION, there).holds


def test_a_broken_model_or_target_makes_the_law_fail():
    less = sp.Eq(MODEL.lhs, MODEL.rhs - y.F_ch * y.S)
    assert verdicts(derive_impedance(model=less))["24"] == "not as printed"
    double = sp.Eq(TARGET.lhs, TARGET.rhs + y.B * (y.qd - y.qd_0))
    steps = derive_impedance(target=double)
    broken = verdicts(steps)
    assert broken["25"] == broken["28"] == "not as printed"
    assert not all(one.holds for one in steps)


def test_a_broken_estimator_fails_the_covariance():
    assert covariance_step().holds
    assert not covariance_step(2 * estimator()).holds


def test_covariance_is_that_of_many_least_squares_fits():
    regressor = np.array([[1.0, 0.2], [0.5, -1.0], [2.0, 0.3]])
    errors = 0.1 * np.random.default_rng(0).standard_normal((3, 20000))
    fits = np.linalg.lstsq(regressor, errors, rcond=None)[0]
    derived = covariance(estimator()).subs({y.n: 3, y.p: 2, y.sigma: 0.1})
    derived = derived.subs(sp.MatrixSymbol(y.W_1.name, 3, 2), sp.Matrix(regressor.tolist())).doit()
    np.testing.assert_allclose(np.cov(fits), np.array(derived, dtype=float), rtol=0.05, atol=1e-4)


def test_a_wrong_column_of_a_table_is_seen():
    name, (value, two_sigma, _) = next(iter(TABLE_TEXT["table_1"].items()))
    one_sigma = f"{50.0 * float(two_sigma) / float(value):.4f}"
    low, high = column_factor((value, two_sigma, one_sigma))
    assert name == "mass"
    assert low <= 1.0 <= high < 2.0


def test_routh_is_the_roots():
    """The derived limit against the roots, above and below, and no limit for a viscous hand."""
    limit = next(one for one in limits() if one.title == "Largest gain against a wall").equation.rhs
    numbers = {y.omega_0v: 141.0, y.z_v: 0.6, y.K_v: 2.3e6, y.K_env: 3e4, y.k_h: 80.0}
    wall, hand = characteristic(y.K_env / y.s), characteristic(y.k_h)
    for share, stable in ((0.999, True), (1.001, False)):
        gain = {**numbers, y.k_e1: share * limit.subs(numbers)}
        roots = np.roots([float(sp.sympify(k).subs(gain)) for k in wall])
        assert bool(roots.real.max() < 0) is stable
    for gain in (1e-6, 1.0, 1e6):
        roots = np.roots([float(sp.sympify(k).subs({**numbers, y.k_e1: gain})) for k in hand])
        assert roots.real.max() < 0


@pytest.mark.skipif(shutil.which("pdflatex") is None, reason="no TeX distribution here (pdflatex)")
def test_the_document_compiles(tmp_path):
    (tmp_path / "derivations.tex").write_text(document(), encoding="utf-8")
    command = ["pdflatex", "-interaction=nonstopmode", "-halt-on-error", "derivations.tex"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, errors="replace", check=False)
    assert done.returncode == 0, done.stdout[-2000:]
    assert (tmp_path / "derivations.pdf").stat().st_size > 50_000
    assert "Undefined control sequence" not in done.stdout


def test_every_equation_says_where_it_stands():
    import pydoc

    from emps_design.paper.errata import PLACES

    assert set(PLACES) == set(EQUATIONS)
    assert [name for names in PLACES.values() for name in names if pydoc.locate(name) is None] == []


def test_a_claim_that_does_not_hold_is_a_grave_message(monkeypatch):
    false = replace(carriage_step(), checks=(("both sides are equal", False),))
    monkeypatch.setattr("emps_design.paper.errata.derivation", lambda: {"part": ("Part", [false])})
    (message,) = derive.answer(derive.DeriveRequest()).document["warnings"]
    assert (message.code, message.severity) == ("claim-is-false", Severity.GRAVE)
    assert message.endswith("both sides are equal: this is false")
