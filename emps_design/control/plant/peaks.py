"""Where a frequency response is narrow, at resonances of a plant and notches of a law, and what to look at there.

A grid that steps over a narrow peak reads margins that no loop has. A peak is a frequency [rad/s] and a damping ratio,
half the relative width; in the z plane it belongs to a root ``z = exp((-damping w + j w) T)`` beside the unit circle.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from emps_design.laws.library.cascade import Filter, filter_polynomials
from emps_design.laws.linear import LinearLaw

Peaks = Sequence[tuple[float, float]]
BROAD = 0.5  # damping ratio from which on any grid is fine enough
NARROWEST = 1e-6  # what is narrower is looked at as if it had this damping ratio
BESIDE_CENTRE = 1e-9  # relative, of the point nearest to a centre: at an undamped one there is no response


def oscillations(A: np.ndarray) -> Peaks:
    """Frequency [rad/s] and damping ratio of the oscillating eigenvalues of ``A`` (n, n), damping below 0.5.

    >>> [(round(w, 6), round(z, 6)) for w, z in oscillations(np.array([[0.0, 1.0], [-25.0, -1.0]]))]
    [(5.0, 0.1)]
    """
    poles = np.linalg.eigvals(A) if A.size else np.zeros(0)
    sizes = [(float(abs(pole)), float(-pole.real / abs(pole))) for pole in poles if pole.imag > 0.0]
    return sorted((w, damping) for w, damping in sizes if damping < BROAD)


def peaks_of_roots(roots: np.ndarray, period: float) -> Peaks:
    """The peaks of poles or zeros (n,) in the z plane, at a ``period`` [s].

    >>> [(round(w, 6), round(z, 6)) for w, z in peaks_of_roots(np.exp(np.array([-0.01 + 0.2j, -0.01 - 0.2j])), 1e-3)]
    [(200.0, 0.05)]
    """
    turning = [complex(z) for z in np.ravel(roots) if z.imag > 0.0]
    sizes = [(float(np.angle(z)), float(abs(np.log(abs(z))))) for z in turning]
    return sorted((angle / period, away / angle) for angle, away in sizes if away < BROAD * angle)


def filter_peaks(filters: Iterable[Filter], period: float) -> Peaks:
    """The peaks of sampled ``filters``: of a notch those of its poles and of its zeros, narrower by its depth.

    >>> notch = Filter(kind="notch", frequency=50.0, damping=0.1, depth=0.1)
    >>> [(round(w, 1), round(z, 3)) for w, z in filter_peaks([notch], 1e-3)]  # 2/T atan(pi f T) = 311.6 rad/s
    [(310.1, 0.099), (311.6, 0.01)]
    """
    return sorted(
        peak
        for one in filters
        for side in filter_polynomials(one, period)
        for peak in peaks_of_roots(np.roots(side), period)
    )


def law_peaks(law: LinearLaw, period: float) -> Peaks:
    """The peaks of any law from position to command, its notches among them; of several rates those of the fastest."""
    A, B, C, D = (x if law.cycle == 1 else x[-1] for x in (law.A, law.B[..., 1], law.C, law.D[..., 1]))
    found = [*peaks_of_roots(np.linalg.eigvals(A), period)]
    if D != 0.0:
        found += peaks_of_roots(np.linalg.eigvals(A - np.outer(B, C) / D), period)
    return sorted(found)


def frequencies_around(peaks: Peaks) -> np.ndarray:
    """Frequencies [rad/s] at the centres of ``peaks`` and beside them, as close together as each is narrow.

    >>> frequencies_around([(10.0, 0.1)]).size
    65
    """
    found = []
    for w, damping in peaks:
        beside = max(damping, NARROWEST) * w * np.geomspace(0.1, 100.0, 32)
        found += [w - beside, [w * (1.0 + BESIDE_CENTRE)], w + beside]
    return np.concatenate([np.zeros(0), *found])
