"""The paper's symbols for SymPy, by the names of the code; their own names are LaTeX as the paper writes them."""

from __future__ import annotations

import sympy as sp


def _real(text: str) -> list[sp.Symbol]:
    return [sp.Symbol(name, real=True) for name in text.split(" ; ")]


def _positive(text: str) -> list[sp.Symbol]:
    return [sp.Symbol(name, positive=True) for name in text.split(" ; ")]


def _words(text: str) -> list[sp.Symbol]:
    """Matrices of which only the order of a product counts."""
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
