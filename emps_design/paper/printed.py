"""What the paper prints: every numbered equation, Tables I and II, the ranges of the errors. Nothing else is typed in.

In the paper's order and signs, misprints included; the derivations compare with this and nothing computes with it.
The text at hand was read from a scan, so a symbol may be the reader's mistake rather than the paper's.
"""

from __future__ import annotations

import sympy as sp

from emps_design.paper import symbols as y
from emps_design.paper.written import Equation, Sum

_R = y.M_h / y.M_a
_COUNTED = Sum(((_R,), (-1,)))  # M-hat/M_a - 1
_MOVED, _AWAY = Sum(((y.qd,), (-1, y.qd_0))), Sum(((y.q,), (-1, y.q_0)))
_LESS_DAMPING = Sum(((y.F_vh,), (-1, _R, y.B)))
_FRICTION = ((y.F_v, y.qd), (y.F_c, y.S))
_CANONICAL = 1 + 2 * y.z_v / y.omega_0v * y.s + y.s**2 / y.omega_0v**2
_MODEL = ((y.M_h, y.qdd), (y.F_vh, y.qd), (y.F_ch, y.S))

EQUATIONS: dict[str, tuple[Equation, ...]] = {
    "1": (Equation(y.tau_m, Sum(((y.G_i, y.r, y.k_t, y.v_I),))),),
    "2": (Equation(Sum(((y.tau_m,), (y.tau_e,))), Sum(((y.M, y.qdd), *_FRICTION))),),
    "3": (Equation(sp.Symbol("F_{fc}"), Sum(_FRICTION)),),
    "4": (
        Equation(
            sp.Symbol("F_{fs}"),
            Sum((*_FRICTION, (Sum(((y.F_s,), (-1, y.F_c))), sp.exp(-(sp.Abs(y.qd / y.qd_s) ** y.delta_s)), y.S))),
        ),
    ),
    "5": (Equation(Sum(((y.tau_m,), (y.tau_e,))), y.W * y.X),),
    "6": (
        Equation(y.T_vo, y.k_v1 * y.G_tau / (y.t_v * y.s) / (y.M_1 * y.s + y.F_v1 + y.k_v1 * y.G_tau)),
    ),
    "7": (
        Equation(y.k_v1, (y.M_1 * y.omega_v * sp.tan(y.phi_v) - y.F_v1) / y.G_tau),
        Equation(y.t_v, y.k_v1 * y.G_tau / (y.M_1 * y.omega_v**2) * sp.cos(y.phi_v)),
    ),
    "8": (Equation(y.T_vc, 1 / (1 + (y.t_v + y.F_v1 / y.K_c) * y.s + y.M_1 / y.K_c * y.s**2)),),
    "9": (
        Equation(y.omega_0v, sp.sqrt(y.K_v / y.M_1)),
        Equation(y.z_v, (y.t_v + y.F_v1 / y.K_) * y.omega_0v / 2),
        Equation(y.T_vc, 1 / _CANONICAL),
    ),
    "10": (Equation(y.T_eo, y.k_e1 * y.k_c / _CANONICAL), Equation(y.tau_e, y.k_c * y.qd_1)),
    "11": (Equation(y.T_eo, 1 / _CANONICAL),),
    "12": (Equation(y.tau_m1, y.W_1v * y.X_1),),
    "13": (Equation(y.C_rho, y.sigma**2 * y.I_N),),
    "14": (Equation(y.variance, y.residual**2 / (y.n - y.p)),),
    "15": (Equation(y.C_x, y.sigma**2 * sp.Inverse(sp.MatMul(y.W_1, y.W_1.T, evaluate=False))),),
    "16": (Equation(sp.Symbol(r"\%\sigma"), 100 * y.sigma_x / sp.Abs(y.x)),),
    "17": (Equation(y.tau_m1, Sum(((y.W_1v, y.X_1h), (y.e_1,)))),),
    "18": (Equation(y.tau_e2, Sum(((y.tau_m2,), (-1, y.W_2, y.X_2)))),),
    "19": (Equation(y.tau_e2h, Sum(((y.W_2, y.X_1m), (-1, y.tau_m2)))),),
    "20": (Equation(y.tau_e2, Sum(((y.tau_e2h,), (y.e_2,)))),),
    "21": (Equation(y.Y, Sum(((y.tau_mv,), (y.tau_ev,)))), Equation(y.Y, y.W * y.X)),
    "22": (Equation(y.Y, Sum(((y.W, y.X_hat), (y.e_i,)))),),
    "23": (Equation(y.tau_evh, Sum(((y.W, y.X_hat), (-1, y.tau_mv)))),),
    "24": (Equation(Sum(((y.tau_m,), (y.tau_e,))), Sum(_MODEL)),),
    "25": (Equation(y.tau_e, Sum(((y.M_a, y.qdd), (y.B, _MOVED), (y.K, _AWAY)))),),
    "26": (Equation(y.qdd, Sum(((1 / y.M_o, Sum(((y.tau_e,), (-1, y.B, _MOVED), (-1, y.K, _AWAY)))),))),),
    "27": (
        Equation(
            y.tau_m,
            Sum(((_COUNTED, y.tau_e), (_LESS_DAMPING, _MOVED), (y.F_ch, y.S), (-1, _R, y.K, _AWAY))),
        ),
    ),
    "28": (Equation(y.tau_m, Sum(((_COUNTED, y.tau_e), (_LESS_DAMPING, y.qd), (y.F_ch, y.S)))),),
    "29": (Equation(y.tau_eh, Sum((*_MODEL, (-1, y.G_ti, y.current)))),),
    "30": (
        Equation(
            y.tau_m,
            Sum(
                (
                    (_COUNTED, y.M_h, y.qdd),
                    (_R, Sum(((y.F_v,), (-1, y.B))), y.qd),
                    (_R, y.F_c, y.S),
                    (-2, _COUNTED, y.G_ti, y.current),
                )
            ),
        ),
    ),
}  # fmt: skip

# Symbols that the print has where nothing else fits than another one.
READ_AS: dict[str, dict[sp.Symbol, sp.Symbol]] = {
    "8": {y.K_c: y.K_v},
    "9": {y.K_: y.K_v},
    "13": {y.I_N: y.I_n},
    "26": {y.M_o: y.M_a},
    "30": {y.F_v: y.F_vh, y.F_c: y.F_ch},
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
