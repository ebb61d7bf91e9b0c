"""Equations (6) to (11) derived by SymPy from the block diagram of Fig. 4, each beside what the paper prints.

The blocks, in Laplace variables with the external force neglected as in section II-C:

    u = k_v1 ((v - qd) / (t_v s) - qd)        IP correction
    (M s + F_v) qd = G_tau u                  drive and carriage
    v = k_e1 (tau_ref + tau_e),  tau_e = k_c qd   force loop

Nothing below is typed in as a result: the equations of the blocks are solved, and the printed ones are compared.
"""

from __future__ import annotations

from functools import cache
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

from emps_design.paper.derivations.step import DerivationStep

if TYPE_CHECKING:
    import sympy


@cache
def symbols() -> SimpleNamespace:
    """The symbols of the derivation, real and positive where they stand for positive quantities.

    >>> symbols().k, symbols().w0
    (k_v1, omega_0v)
    """
    import sympy

    positive = {
        "M": "M_1", "F": "F_v1", "G": "G_tau", "k": "k_v1", "t": "t_v", "w": "omega_v",
        "K_v": "K_v", "w0": "omega_0v", "z": "z_v", "k_e1": "k_e1", "k_c": "k_c", "K": "K_env", "k_h": "k_h",
    }  # fmt: skip
    found = {name: sympy.Symbol(text, positive=True) for name, text in positive.items()}
    return SimpleNamespace(s=sympy.Symbol("s"), phi=sympy.Symbol("phi_v", real=True), **found)


@cache
def derive_cascade() -> tuple[DerivationStep, ...]:
    """Derive the velocity loop, (6) to (9), and the force loop, (10) and (11), from the blocks of Fig. 4.

    >>> [(step.number, step.agrees) for step in derive_cascade() if step.number]  # doctest: +NORMALIZE_WHITESPACE
    [('6', True), ('7', True), ('7', True), ('8', True), ('9', True), ('9', True), ('9', True), ('10', True),
     ('11', True)]
    """
    return (*_velocity_loop(), *_force_loop())


def _velocity_loop() -> list[DerivationStep]:
    import sympy

    y = symbols()
    s = y.s
    v, qd, u, e = sympy.symbols(r"v_{\dot{q}} \dot{q}_1 u e_v")
    K = y.k * y.G
    law = sympy.Eq(u, y.k * (e / (y.t * s) - qd))
    drive = sympy.Eq((y.M * s + y.F) * qd, y.G * u)

    steps = [
        DerivationStep("Correction", "", law, "Fig. 4: integral of the velocity error, proportional on the velocity"),
        DerivationStep("Drive and carriage", "", drive, "(1) and (2), linear part, external force neglected"),
    ]

    solved = sympy.solve([law, drive], [qd, u], dict=True)[0]
    T_vo = sympy.factor(solved[qd] / e)
    steps.append(
        _compare(
            "Open loop at the velocity error", "6", sympy.Symbol("T_vo"), T_vo,
            K / (y.t * s) / (y.M * s + y.F + K),
            "both blocks solved for the velocity as an answer to the error e_v; the proportional path is closed inside",
        )
    )  # fmt: skip

    at_crossover = T_vo.subs(s, sympy.I * y.w)
    numerator, denominator = sympy.fraction(sympy.together(at_crossover))
    balance = sympy.expand(denominator * (-sympy.cos(y.phi) - sympy.I * sympy.sin(y.phi)) - numerator)
    real, imaginary = (sympy.expand(part) for part in balance.as_real_imag())
    steps.append(
        DerivationStep(
            "Crossover and phase margin", "", sympy.Eq(balance, 0),
            "T_vo(j omega_v) = exp(j (-pi + phi_v)), multiplied out: real and imaginary part give two equations",
        )
    )  # fmt: skip
    gains = _solve_gains(real, imaginary)
    steps.append(
        _compare(
            "Gain", "7", y.k, gains[0], (y.M * y.w * sympy.tan(y.phi) - y.F) / y.G,
            "positive only for phi_v above atan(F_v/(M omega_v)), finite only below 90 deg",
        )
    )  # fmt: skip
    steps.append(
        _compare(
            "Integral time", "7", y.t, gains[1],
            gains[0] * y.G / (y.M * y.w**2) * sympy.cos(y.phi), "with the gain just found",
        )
    )  # fmt: skip

    closed = sympy.solve([law.subs(e, v - qd), drive], [qd, u], dict=True)[0]
    T_vc = sympy.simplify(closed[qd] / v)
    K_v = K / y.t
    steps.append(
        _compare(
            "Closed loop", "8", sympy.Symbol("T_vc"), T_vc,
            1 / (1 + (y.t + y.F / K_v) * s + y.M / K_v * s**2),
            "e_v = v - qd put back; K_v = k_v1 G_tau / t_v",
        )
    )  # fmt: skip

    coefficients = sympy.Poly(sympy.expand(sympy.cancel(1 / T_vc)), s).all_coeffs()
    canonical = sympy.Poly(1 + 2 * y.z / y.w0 * s + s**2 / y.w0**2, s).all_coeffs()
    pairs = [sympy.Eq(left, right) for left, right in zip(coefficients, canonical, strict=True)]
    w0 = sympy.solve(pairs[0], y.w0)[0]
    z = sympy.solve(pairs[1], y.z)[0].subs(y.w0, w0)
    steps += [
        _compare("Natural frequency", "9", y.w0, w0, sympy.sqrt(K_v / y.M), "the coefficient of s^2"),
        _compare(
            "Damping ratio", "9", y.z, z, (y.t + y.F / K_v) * sympy.sqrt(K_v / y.M) / 2, "the coefficient of s"
        ),
        _compare(
            "Canonical form", "9", sympy.Symbol("T_vc"), T_vc, 1 / (1 + 2 * z / w0 * s + s**2 / w0**2),
            "with these two, T_vc is (9)",
        ),
    ]  # fmt: skip

    phase = {y.k: gains[0], y.t: gains[1]}
    steps += [
        DerivationStep(
            "What T_vc depends on: natural frequency", "", sympy.Eq(y.w0, _positive_phase(w0.subs(phase))),
            "(7) put into (9): mass and friction are gone, T_vc follows from the specification alone",
        ),
        DerivationStep(
            "What T_vc depends on: damping ratio", "", sympy.Eq(y.z, _positive_phase(z.subs(phase))),
            "so 2 z_v omega_0v = omega_v tan(phi_v)",
        ),
    ]  # fmt: skip
    x, omega_b = sympy.Symbol("x", positive=True), sympy.Symbol("omega_b", positive=True)
    answer = 1 / (1 + 2 * y.z * sympy.I * sympy.sqrt(x) - x)  # (9) at s = j omega_0v sqrt(x)
    power = sympy.simplify(sympy.expand(answer * sympy.conjugate(answer), complex=True))
    level = sympy.Rational(3, 10)  # -3 dB of the magnitude is 10^(-3/10) of its square
    roots = sympy.solve(sympy.Eq(sympy.simplify(1 / power), 10**level), x)
    positive = max(roots, key=lambda root: root.subs(y.z, 1).evalf())
    plant_input = sympy.solve([law.subs(e, -qd), sympy.Eq((y.M * s + y.F) * qd, y.G * sympy.Symbol("u_in"))], [qd, u])
    steps += [
        DerivationStep(
            "Bandwidth of the closed loop", "", sympy.Eq(omega_b, y.w0 * sympy.sqrt(positive)),
            "|T_vc(j omega_b)| = 10^(-3/20), from (9): not the crossover omega_v",
        ),
        DerivationStep(
            "Loop broken at the plant input", "",
            sympy.Eq(sympy.Symbol("L"), sympy.factor(-plant_input[u] / sympy.Symbol("u_in"))),
            "where delay, current loop and sampling sit: their phase is taken from this loop's margin",
        ),
    ]  # fmt: skip
    return steps


def _force_loop() -> list[DerivationStep]:
    import sympy

    y = symbols()
    s = y.s
    r, tau_e, qd = sympy.symbols(r"\tau_{in} tau_e \dot{q}_1")
    T_vc = 1 / (1 + 2 * y.z / y.w0 * s + s**2 / y.w0**2)
    solved = sympy.solve([sympy.Eq(qd, T_vc * y.k_e1 * r), sympy.Eq(tau_e, y.k_c * qd)], [qd, tau_e], dict=True)[0]
    T_eo = sympy.simplify(solved[tau_e] / r)
    unity = sympy.simplify(T_eo.subs(y.k_c, 1 / y.k_e1))
    steps = [
        _compare(
            "Force loop, opened at its sum", "10", sympy.Symbol("T_eo"), T_eo,
            y.k_e1 * y.k_c / (1 + 2 * y.z / y.w0 * s + s**2 / y.w0**2),
            "v = k_e1 (tau_ref + tau_e) through T_vc to the velocity, and tau_e = k_c qd",
        ),
        _compare(
            "Static gain one", "11", sympy.Symbol("T_eo"), unity,
            1 / (1 + 2 * y.z / y.w0 * s + s**2 / y.w0**2), "k_c = 1/k_e1",
        ),
    ]  # fmt: skip
    closed = sympy.factor(sympy.simplify(unity / (1 - unity)))
    steps.append(
        DerivationStep(
            "The paper's own reading", "", sympy.Eq(sympy.Symbol("T_eo") / (1 - sympy.Symbol("T_eo")), closed),
            "tau_e = +k_c qd is reference and result at once: positive feedback with a pole at s = 0",
        )
    )  # fmt: skip

    operator = -(y.k_h + y.K / s) * qd
    on_carriage = sympy.Eq(qd, T_vc * (y.k_e1 * (r + tau_e) + s * tau_e / y.K_v))
    answer = sympy.solve([on_carriage, sympy.Eq(tau_e, operator)], [qd, tau_e], dict=True)[0][qd]
    characteristic = sympy.Poly(sympy.denom(sympy.together(answer / r)), s)
    monic = [sympy.simplify(c / characteristic.LC()) for c in characteristic.all_coeffs()]
    cubic = sum(c * s ** (len(monic) - 1 - place) for place, c in enumerate(monic))
    steps.append(
        DerivationStep(
            "An operator with a sign", "", sympy.Eq(cubic, 0),
            "tau_e = -(k_h + K_env/s) qd, positive towards +q, on the sensor and on the carriage: negative feedback",
        )
    )  # fmt: skip
    wall = [c.subs(y.k_h, 0) for c in monic]
    routh = sympy.simplify(wall[1] * wall[2] - wall[3])
    limit = sympy.solve(routh, y.k_e1)[0]
    steps += [
        DerivationStep(
            "Largest gain against a wall", "", sympy.Eq(y.k_e1, sympy.factor(limit)),
            "Routh on the cubic with k_h = 0; stable below. Without the force on the carriage: K_v to infinity",
        ),
        DerivationStep(
            "The same, force on the sensor only", "", sympy.Eq(y.k_e1, sympy.limit(limit, y.K_v, sympy.oo)),
            "so k_e1 K_env < 2 z_v omega_0v = omega_v tan(phi_v)",
        ),
    ]  # fmt: skip
    return steps


def _solve_gains(real: Any, imaginary: Any) -> tuple[sympy.Expr, sympy.Expr]:
    """k_v1 and t_v from the two equations; the cosine is not zero inside the feasible range."""
    import sympy

    y = symbols()
    k = sympy.simplify(sympy.solve(real, y.k)[0])
    return k, sympy.simplify(sympy.solve(imaginary.subs(y.k, k), y.t)[0])


def _positive_phase(expression: sympy.Expr) -> sympy.Expr:
    """Simplify for a phase margin inside (0, 90) deg, where sine and cosine are positive."""
    import sympy

    y = symbols()
    c = sympy.Symbol("c", positive=True)
    free = sympy.simplify(expression).rewrite(sympy.cos).subs(sympy.tan(y.phi), sympy.sin(y.phi) / sympy.cos(y.phi))
    return sympy.simplify(sympy.simplify(free.subs(sympy.cos(y.phi), c)).subs(c, sympy.cos(y.phi)))


def _compare(title: str, number: str, left: Any, derived: sympy.Expr, printed: sympy.Expr, text: str) -> DerivationStep:
    """A step with what the paper prints, and the difference of the two."""
    import sympy

    difference = sympy.simplify(printed - derived)
    return DerivationStep(title, number, sympy.Eq(left, derived), text, sympy.Eq(left, printed), difference)
