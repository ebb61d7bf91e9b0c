"""Whitening of the force residual by an autoregressive model of its noise, and its undoing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

ORDER = 24  # of the autoregressive model of the noise


@dataclass(frozen=True)
class Whitening:
    """Autoregressive model of the force noise: ``coefficients`` (p + 1,), first 1; the innovation's ``std`` [N]."""

    coefficients: np.ndarray
    std: float

    @classmethod
    def none(cls) -> Whitening:
        """Return what leaves forces as they are, with 1 N as the standard deviation of the noise."""
        return cls(np.array([1.0]), 1.0)

    @classmethod
    def of_autocovariance(cls, lags: np.ndarray) -> Whitening:
        """Model noise with autocovariance ``lags`` (order + 1,) [N^2] by the equations of Yule and Walker."""
        from scipy.linalg import solve_toeplitz

        lags = lags * np.concatenate(([1 + 1e-9], np.ones(lags.size - 1)))
        a = solve_toeplitz(lags[:-1], lags[1:])
        variance = lags[0] - float(a @ lags[1:])
        return cls(np.concatenate(([1.0], -a)), float(np.sqrt(max(variance, 1e-12))))

    def apply(self, residual: np.ndarray) -> np.ndarray:
        """Innovations of ``residual`` (n,) [N] in units of their standard deviation."""
        return np.convolve(self.coefficients, residual)[: residual.size] / self.std

    def undo(self, innovations: np.ndarray) -> np.ndarray:
        """Force noise (n,) [N] that :meth:`apply` makes into ``innovations`` (n,)."""
        from scipy.signal import lfilter

        return self.std * lfilter((1.0,), self.coefficients, innovations)
