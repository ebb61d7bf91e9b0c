"""Excitation that does not repeat: the local polynomial method, and averaged spectra for long records.

Over one block the loop answers the instrument with Z(k) = G(k) R(k) + T(k), Z the position increment and the command,
G and the transient T smooth in frequency. Around each line parabolas for both are fitted to 2n + 1 lines of Z at
once, which takes the leakage away with T (R. Pintelon and J. Schoukens, System Identification: A Frequency Domain
Approach, 2nd ed., chapter 7). Many short blocks under a window leak a little and cost less: the averaged cross spectra
of P. D. Welch (IEEE Trans. Audio Electroacoust. 15, 1967), with the instrument in the place of the input.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from emps_design.errors import RecordError
from emps_design.frequency_response.signals import Signals

NEAR = 10  # lines on either side
ORDER = 2
CLEAR = 10.0  # times the noise that the answers of command and position have to be, or their quotient is the noise's
ROUGH = 0.05  # share of the instrument's power near a line that no parabola has, or it excites nothing there
AT_ONCE = 2048  # lines fitted together
FEWEST_BLOCKS = 4  # that averaged spectra are taken of


@dataclass(frozen=True, eq=False)
class Answer:
    """What instrument of amplitude 1 does at ``frequency`` (m,) [Hz]: ``z`` (m, 2), its ``noise`` (m, 2, 2) covariance.

    ``freedom`` is that of the covariance, ``weight`` (m,) what to average several of them by: the instrument's power,
    or the inverse of what noise becomes in ``z``; 0 where the instrument excites nothing.
    """

    frequency: np.ndarray
    z: np.ndarray
    noise: np.ndarray
    freedom: float
    weight: np.ndarray

    @property
    def variance(self) -> np.ndarray:
        """Of the quotient of position and command, relative, to first order (m,)."""
        z_q, z_u, C = self.z[:, 0], self.z[:, 1], self.noise
        found = (
            C[:, 0, 0].real / np.abs(z_q) ** 2
            + C[:, 1, 1].real / np.abs(z_u) ** 2
            - 2.0 * (C[:, 0, 1] / (z_q * z_u.conj())).real
        )
        return np.maximum(found, 0.0)


def blocks(signals: Signals, samples: int) -> Iterator[slice]:
    """Blocks of at most ``samples`` that the stretches of ``signals`` divide into, as equal as they come."""
    for start, stop in signals.stretches:
        count = max(1, -(-(stop - start) // samples))
        length = (stop - start) // count
        for i in range(count):
            yield slice(start + i * length, start + (i + 1) * length)


def local_polynomial(signals: Signals, part: slice, lowest: float, highest: float) -> Answer:
    """The answer over one block at every (n/2)-th line from ``lowest`` to ``highest`` [Hz]."""
    from scipy.fft import rfft

    size = part.stop - part.start
    r, dq, u = (_spectrum(values[part], rfft) for values in (signals.r, signals.dq, signals.u))
    both = np.stack([dq, u], axis=-1)
    step = 1.0 / (size * signals.period)
    low, high = max(NEAR + 1, round(lowest / step)), min(r.size - NEAR - 2, int(highest / step))
    centres = np.arange(low, max(high, low) + 1, NEAR // 2)
    offsets = np.arange(-NEAR, NEAR + 1)
    powers = (offsets[:, None] / NEAR) ** np.arange(ORDER + 1)
    z, noise = np.empty((centres.size, 2), complex), np.empty((centres.size, 2, 2), complex)
    weight = np.empty(centres.size)
    freedom = offsets.size - 2 * (ORDER + 1)
    away = np.eye(offsets.size) - powers @ np.linalg.pinv(powers)
    for first in range(0, centres.size, AT_ONCE):
        own = slice(first, first + AT_ONCE)
        at = centres[own, None] + offsets
        K = np.concatenate([r[at][..., None] * powers, np.broadcast_to(powers, (*at.shape, ORDER + 1))], axis=-1)
        scale = np.sqrt(np.sum(np.abs(K) ** 2, axis=1, keepdims=True))
        fit = np.linalg.pinv(K / scale, rcond=1e-8)
        theta = fit @ both[at]
        left = both[at] - (K / scale) @ theta
        z[own] = theta[:, 0] / scale[:, 0, 0, None]
        grown = np.sum(np.abs(fit[:, 0]) ** 2, axis=-1) / scale[:, 0, 0] ** 2
        # An instrument that is as smooth as a transient there, such as the leakage of a sweep, cannot be told from one.
        rough = np.sum(np.abs(r[at] @ away) ** 2, axis=1) > ROUGH * np.sum(np.abs(r[at]) ** 2, axis=1)
        weight[own] = np.where(rough, 1.0 / grown, 0.0)
        noise[own] = np.einsum("kli,klj->kij", left, left.conj()) / freedom * grown[:, None, None]
    return Answer(centres * step, z, noise, freedom, weight)


def welch(signals: Signals, samples: int, lowest: float, highest: float) -> Answer:
    """The answer from the averaged spectra of all blocks of ``samples``, which overlap by half, under a Hann window.

    Raises :class:`RecordError` for fewer than :data:`FEWEST_BLOCKS`: how they differ tells the noise.
    """
    from scipy.fft import rfft

    window = np.hanning(samples + 1)[:-1]
    begins = [b for start, stop in signals.stretches for b in range(start, stop - samples + 1, samples // 2)]
    count = len(begins)
    if count < FEWEST_BLOCKS:
        raise RecordError(
            f"{signals.name}: found {count} blocks of {samples * signals.period:g} s, expected at least "
            f"{FEWEST_BLOCKS} for averaged spectra; record for longer, or take local-polynomial"
        )
    cross, power, other = 0.0, 0.0, 0.0
    for begin in begins:
        part = slice(begin, begin + samples)
        r, dq, u = (rfft(window * _detrended(values[part])) for values in (signals.r, signals.dq, signals.u))
        both = np.stack([dq, u], axis=-1)
        cross = cross + both * r.conj()[:, None]
        power = power + np.abs(r) ** 2
        other = other + both[:, :, None] * both.conj()[:, None, :]
    frequency = np.arange(samples // 2 + 1) / (samples * signals.period)
    kept = (frequency >= max(lowest, 2.0 / (samples * signals.period))) & (frequency <= highest)
    power = np.maximum(np.asarray(power)[kept], np.finfo(float).tiny)
    z = np.asarray(cross)[kept] / power[:, None]
    # Hann windows that overlap by half: 11/18 of the blocks are independent (Welch's formula, for many of them).
    freedom = 11.0 / 18.0 * count - 1.0
    left = np.asarray(other)[kept] - z[:, :, None] * z.conj()[:, None, :] * power[:, None, None]
    noise = left / power[:, None, None] / freedom
    return Answer(frequency[kept], z, noise, freedom, power)


def _spectrum(values: np.ndarray, rfft: object) -> np.ndarray:
    return rfft(_detrended(values)) / np.sqrt(values.size)  # type: ignore[operator]


def _detrended(values: np.ndarray) -> np.ndarray:
    """``values`` without their mean and their straight line."""
    place = np.arange(values.size) - 0.5 * (values.size - 1)
    slope = float(place @ values / (place @ place))
    return values - values.mean() - slope * place
