"""How large a force gain may be: in closed form for the continuous loop, by a search where only poles say so."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np


def largest_force_gain(
    omega_0v: float,
    z_v: float,
    K_v: float,
    hand: float = 0.0,
    environment: float = 0.0,
    on_carriage: bool = True,
    zero: float = 0.0,
) -> float | None:
    """Return the k_e1 [(m/s)/N] at which the continuous force loop loses stability (Routh); None: never.

    ``omega_0v`` [rad/s], ``z_v``, ``K_v`` [N/m] of (8), (9); ``hand`` [N/(m/s)], ``environment`` [N/m]. For a wall
    alone 2 z_v w_0v / K_env, times (1 + K_env/K_v) when the force also acts on the carriage. ``zero`` [s] is that of
    T_vc, t_v of a PI loop: the answer it hurries needs less of the operator's own damping, so there may be no limit.

    >>> round(largest_force_gain(141.42, 0.61237, 2.3146e6, environment=1e4, on_carriage=False), 6)
    0.01732
    >>> largest_force_gain(141.42, 0.61237, 2.3146e6, hand=100.0) is None
    True
    """
    share = 1.0 / K_v if on_carriage else 0.0
    # s^3/w0^2 + (second + k zero k_h) s^2 + (first + k (k_h + zero K)) s + k K = 0
    second, first = 2.0 * z_v / omega_0v + hand * share, 1.0 + environment * share
    by_gain = hand + zero * environment
    products = zero * hand * by_gain, second * by_gain + zero * hand * first - environment / omega_0v**2, second * first
    gains = np.roots(products)
    positive = gains.real[(gains.imag == 0.0) & (gains.real > 0.0)]
    return float(positive.min()) if positive.size else None


def first_instability(stable: Callable[[np.ndarray], np.ndarray], start: float) -> float | None:
    """The gain where ``stable``, asked of many gains at once, turns false; None below 1e9 starts, 0.0 at ``start``."""
    low, high = 0.0, start
    while bool(np.all(found := stable(grid := high * 1.15 ** np.arange(16.0)))):
        low, high = float(grid[-1]), float(grid[-1]) * 1.15
        if low > 1e9 * start:
            return None
    while True:
        first = int(np.argmin(found))
        low, high = (float(grid[first - 1]) if first else low), float(grid[first])
        if low == 0.0 or high - low <= 1e-12 * high:
            return low
        grid = np.linspace(low, high, 18)[1:]
        found = stable(grid)
