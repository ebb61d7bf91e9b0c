"""Excitation that does not repeat: the local polynomial method, and averaged spectra for long records.

Over one block the loop answers the instrument with Z(k) = G(k) R(k) + T(k), Z the position increment and the command,
G and the transient T smooth in frequency. Around each line parabolas for both are fitted to 2n + 1 lines of Z at
once, which removes the leakage with T (R. Pintelon and J. Schoukens, System Identification: A Frequency Domain
Approach, 2nd ed., chapter 7). Many short blocks under a window cost less: the averaged cross spectra of P. D. Welch
(IEEE Trans. Audio Electroacoust. 15, 1967), with the instrument as the input. A window w truncates the answer and the
instrument differently. That error is the same on every pass, so the scatter between blocks does not show it (J. Antoni
and J. Schoukens, Automatica 43, 2007). Where the response is smooth over the lines k, it is a Taylor series in time,

    Z_w = G R_w + j/2 dG/dk R_sin - 1/4 d^2G/dk^2 R_cos + ...,

for a Hann window, with R_sin and R_cos the instrument times one period of a sine and of a cosine. The two terms are
subtracted.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import scipy

from emps_design.errors import RecordError
from emps_design.frequency_response.signals import Signals

NEAR = 10  # lines on either side
ORDER = 2
FINER = 4  # the order of the fit that shows what parabolas miss
CLEAR = 10.0  # power of an answer over its noise below which the quotient of position and command is noise
ROUGH = 0.2  # share of the instrument's power near a line that no parabola has, or it excites nothing there
UNCUT = 0.05  # share of the instrument's power at a line that the windows leave, or it excites nothing there
AT_ONCE = 2048  # lines fitted together
FEWEST_BLOCKS = 4  # that averaged spectra are taken of
FEWEST_ACTING = 1.5  # of them that have the power of a line
ROUNDS = 2  # in which averaged spectra are freed of what the window cuts off
LEAST_LEFT = 0.1  # share of a line's power in other blocks than one; with less, the average hides that one's error


@dataclass(frozen=True, eq=False)
class Answer:
    """Position increment and command ``z`` (m, 2) for an instrument of amplitude 1 at ``frequency`` (m,) [Hz].

    ``noise`` (m, 2, 2) is the covariance of ``z``, ``freedom`` its degrees of freedom; ``weight`` (m,) is the weight in
    an average of several answers: the instrument's power, or the inverse of the noise gain; 0 where the instrument
    excites nothing. ``missed`` (m, 2) is what a finer interpolation between the lines adds to ``z``, and
    ``missed_noise`` (m, 2, 2) its covariance.
    """

    frequency: np.ndarray
    z: np.ndarray
    noise: np.ndarray
    freedom: float
    weight: np.ndarray
    missed: np.ndarray | None = None
    missed_noise: np.ndarray | None = None

    @property
    def variance(self) -> np.ndarray:
        """Relative variance (m,) of the quotient of position and command, to first order."""
        return self._of_quotient(self.noise)

    @property
    def interpolation(self) -> np.ndarray:
        """Squared relative error (m,) of the quotient by interpolation between the lines.

        The contribution of noise is subtracted, so it may be negative.
        """
        if self.missed is None or self.missed_noise is None:
            return np.zeros(self.frequency.size)
        relative = self.missed / self.z
        return np.abs(relative[:, 0] - relative[:, 1]) ** 2 - self._of_quotient(self.missed_noise)

    def _of_quotient(self, covariance: np.ndarray) -> np.ndarray:
        z_q, z_u = self.z[:, 0], self.z[:, 1]
        variance = (
            covariance[:, 0, 0].real / np.abs(z_q) ** 2
            + covariance[:, 1, 1].real / np.abs(z_u) ** 2
            - 2.0 * (covariance[:, 0, 1] / (z_q * z_u.conj())).real
        )
        return np.maximum(variance, 0.0)


def blocks(signals: Signals, samples: int) -> Iterator[slice]:
    """Blocks of at most ``samples``, equal within each stretch of ``signals``."""
    for start, stop in signals.stretches:
        count = max(1, -(-(stop - start) // samples))
        length = (stop - start) // count
        for i in range(count):
            yield slice(start + i * length, start + (i + 1) * length)


def local_polynomial(signals: Signals, part: slice, lowest: float, highest: float) -> Answer:
    """The answer over one block at every (n/2)-th line from ``lowest`` to ``highest`` [Hz]."""
    size = part.stop - part.start
    r, dq, u = (scipy.fft.rfft(_detrended(x[part])) / np.sqrt(size) for x in (signals.r, signals.dq, signals.u))
    both = np.stack([dq, u], axis=-1)
    step = 1.0 / (size * signals.period)
    low, high = max(NEAR + 1, round(lowest / step)), min(r.size - NEAR - 2, int(highest / step))
    centres = np.arange(low, max(high, low) + 1, NEAR // 2)
    offsets = np.arange(-NEAR, NEAR + 1)
    powers = (offsets[:, None] / NEAR) ** np.arange(FINER + 1)
    coarse = powers[:, : ORDER + 1]
    z, noise = np.empty((centres.size, 2), complex), np.empty((centres.size, 2, 2), complex)
    missed, missed_noise = np.empty_like(z), np.empty_like(noise)
    weight = np.empty(centres.size)
    freedom = offsets.size - 2 * (ORDER + 1)
    away = np.eye(offsets.size) - coarse @ np.linalg.pinv(coarse)
    for first in range(0, centres.size, AT_ONCE):
        own = slice(first, first + AT_ONCE)
        at = centres[own, None] + offsets
        theta, residuals, growth = _fit_lines(r[at], both[at], coarse)
        z[own] = theta
        # An instrument as smooth as a transient, such as the leakage of a sweep, cannot be separated from one.
        rough = np.sum(np.abs(r[at] @ away) ** 2, axis=1) > ROUGH * np.sum(np.abs(r[at]) ** 2, axis=1)
        weight[own] = np.where(rough, 1.0 / growth, 0.0)
        of_lines = np.einsum("kli,klj->kij", residuals, residuals.conj()) / freedom
        noise[own] = of_lines * growth[:, None, None]
        finer, residuals, finer_growth = _fit_lines(r[at], both[at], powers)
        missed[own] = finer - theta
        # The difference to a fit that has more columns is uncorrelated with the fit itself.
        of_lines = np.einsum("kli,klj->kij", residuals, residuals.conj()) / (offsets.size - 2 * (FINER + 1))
        missed_noise[own] = of_lines * np.maximum(finer_growth - growth, 0.0)[:, None, None]
    return Answer(centres * step, z, noise, freedom, weight, missed, missed_noise)


def _fit_lines(r: np.ndarray, both: np.ndarray, powers: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Fit plant and transient, each a polynomial with columns ``powers`` (l, p), to the lines ``both`` (k, l, 2).

    Returns the plant at the middle line (k, 2), the residuals (k, l, 2), and the noise gain (k,), variance of the plant
    over that of one line.
    """
    K = np.concatenate([r[..., None] * powers, np.broadcast_to(powers, (*r.shape, powers.shape[1]))], axis=-1)
    scale = np.sqrt(np.sum(np.abs(K) ** 2, axis=1, keepdims=True))
    fit = np.linalg.pinv(K / scale, rcond=1e-8)
    theta = fit @ both
    residuals = both - (K / scale) @ theta
    growth = np.sum(np.abs(fit[:, 0]) ** 2, axis=-1) / scale[:, 0, 0] ** 2
    return theta[:, 0] / scale[:, 0, 0, None], residuals, growth


def welch(signals: Signals, samples: int, lowest: float, highest: float) -> Answer:
    """The answer from the averaged spectra of all blocks of ``samples``, which overlap by half, under a Hann window.

    Raises :class:`RecordError` for fewer than :data:`FEWEST_BLOCKS`, since the noise follows from their scatter.
    """
    begins = [b for start, stop in signals.stretches for b in range(start, stop - samples + 1, samples // 2)]
    count = len(begins)
    if count < FEWEST_BLOCKS:
        raise RecordError(
            f"{signals.name}: found {count} blocks of {samples * signals.period:g} s, expected at least "
            f"{FEWEST_BLOCKS} for averaged spectra; make a longer record, or use local-polynomial"
        )
    step = 1.0 / (samples * signals.period)
    lines = np.arange(max(2, int(np.ceil(lowest / step - 1e-9))), min(int(highest / step + 1e-9), samples // 2 - 1) + 1)

    def spectra(begin: int) -> tuple[np.ndarray, np.ndarray]:
        part = slice(begin, begin + samples)
        r, dq, u = (scipy.fft.rfft(_detrended(values[part])) for values in (signals.r, signals.dq, signals.u))
        return _windowed(r, lines), np.stack([_windowed(channel, lines)[0] for channel in (dq, u)], axis=-1)

    tiny = np.finfo(float).tiny
    cross, power, squares = np.zeros((lines.size, 2), complex), np.full(lines.size, tiny), np.zeros(lines.size)
    moments, whole = np.zeros((2, lines.size), complex), np.zeros(lines.size)
    for begin in begins:
        r, both = spectra(begin)
        cross += both * r[0].conj()[:, None]
        moments += r[1:] * r[0].conj()
        power += np.abs(r[0]) ** 2
        squares += np.abs(r[0]) ** 4
        whole += np.abs(2.0 * r[0] + r[2]) ** 2
    # A single block, such as at the ends of a sweep, does not show the truncation error. Where the window removed
    # nearly all of the instrument, what remains describes its ends alone.
    several = (power**2 >= FEWEST_ACTING * squares) & (power > UNCUT * whole)
    z = cross / power[:, None]
    terms, cut = np.zeros((2, 2, *z.shape), complex)
    for _ in range(ROUNDS if np.count_nonzero(several) > 2 else 0):
        slope = np.gradient(z[several], lines[several], axis=0, edge_order=2)
        terms[:, several] = 0.5j * slope, -0.25 * np.gradient(slope, lines[several], axis=0, edge_order=2)
        cut = moments[..., None] * terms / power[:, None]
        z = cross / power[:, None] - cut.sum(axis=0)
    alike, weighed = np.zeros((2, power.size, 2, 2), complex)
    for begin in begins:
        r, both = spectra(begin)
        residuals = both - z * r[0][:, None] - np.einsum("il,ilj->lj", r[1:], terms)
        products = residuals[:, :, None] * residuals.conj()[:, None, :]
        share = np.abs(r[0]) ** 2 / power
        alike += products
        weighed += products * (share / np.maximum(1.0 - share, LEAST_LEFT))[:, None, None]
    # Hann windows that overlap by half: 11/18 of the blocks are independent (Welch's formula, for many of them).
    freedom = 11.0 / 18.0 * count - 1.0
    # The residuals are noise of all blocks alike, or, as the leakage of a sweep, an error of the blocks with the line's
    # power (HC2 of J. G. MacKinnon and H. White, J. Econometrics 29, 1985): the larger counts.
    by_block = [noise / power[:, None, None] for noise in (alike / freedom, weighed * 18.0 / 11.0)]
    answers = [Answer(lines * step, z, noise, freedom, power) for noise in by_block]
    larger = answers[1].variance > answers[0].variance
    noise = np.where(larger[:, None, None], by_block[1], by_block[0])
    # The second difference has 3/8 of the variance of a line and enters with the factor 1/4.
    missed_noise = noise * (0.375 / 16.0 * np.abs(moments[1] / power) ** 2)[:, None, None]
    weight = np.where(several, power, 0.0)
    return Answer(lines * step, z, noise, freedom, weight, -cut[1], missed_noise)


def _windowed(spectrum: np.ndarray, lines: np.ndarray) -> np.ndarray:
    """The spectra (3, m) at ``lines`` (m,) of a signal under a Hann window, (1 - cos)/2, under the sine and under the
    cosine of one turn in the block, from its ``spectrum`` (n,) under none."""
    before, at, after = (spectrum[lines + i] for i in (-1, 0, 1))
    cosine = 0.5 * (before + after)
    return np.array([0.5 * (at - cosine), -0.5j * (before - after), cosine])


def _detrended(values: np.ndarray) -> np.ndarray:
    """``values`` without their mean and their straight line."""
    place = np.arange(values.size) - 0.5 * (values.size - 1)
    slope = float(place @ values / (place @ place))
    return values - values.mean() - slope * place
