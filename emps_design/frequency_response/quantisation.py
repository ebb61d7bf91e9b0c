"""What the steps of the encoder add to a spectrum, and how much of that repeats with a periodic excitation.

The encoder says x + e(x), e a sawtooth of one step d, of variance d^2/12. Under a periodic excitation the carriage is,
a period later, where it was, further by an advance a. The m-th harmonic of the sawtooth, of a power that goes with
1/m^2, has then turned by m a/d: its share of P periods that repeats is (sin(pi P x)/(P sin(pi x)))^2 with x = m a/d.
At an advance of whole steps all of e repeats: it falls on the excited lines, and the lines between, which tell the
noise, know nothing of it. Source: W. R. Bennett, Bell System Technical Journal 27, 1948 (the spectrum of e).
"""

from __future__ import annotations

import numpy as np

HARMONICS = 64  # of the sawtooth
OFFSETS = 16  # of the carriage within a step, over which is averaged
NEAR = 9  # neighbouring lines over which the powers are averaged
WHOLE = 0.05  # of a step, by which an increment may miss whole steps
MOST = 0.01  # share of the increments that may miss them by more
CANDIDATES = 24  # distances between increments that are tried as the step
LOOKED_AT = 1 << 16  # increments
CLEAR = 10.0  # times the power of steps that all repeat, from which on a line is motion
TINY = 1e-3  # share of the noise below which quantisation is not looked at


def repeated_share(advance: np.ndarray | float, periods: int) -> np.ndarray:
    """The share of the quantisation's power that repeats in ``periods``, at an ``advance`` (...) in steps by period.

    >>> repeated_share(np.array([17.0, 17.5, 17.618]), 4).round(2).tolist()
    [1.0, 0.25, 0.1]
    """
    m = np.arange(1, HARMONICS + 1)
    turn = np.asarray(advance)[..., None] * m
    turn = turn - np.rint(turn)
    same = (np.sinc(periods * turn) / np.sinc(turn)) ** 2
    return np.sum(same / m**2, axis=-1) / np.sum(1.0 / m**2)


def encoder_step(dq: np.ndarray) -> float:
    """The step [m] that all increments ``dq`` (n,) are whole numbers of, 0 where there is none.

    >>> steps = np.random.default_rng(0).integers(-40, 40, 200)
    >>> round(encoder_step(2.5e-6 * steps + 1e-12) * 1e6, 6), encoder_step(np.sin(np.arange(99.0)))
    (2.5, 0.0)
    """
    some = dq[:: -(-dq.size // LOOKED_AT)]
    away = some - np.quantile(some, 0.5, method="nearest")
    values = np.unique(away)
    gaps = np.unique(np.diff(values))
    gaps = gaps[gaps > 1e-9 * np.max(np.abs(away), initial=0.0)]
    if not gaps.size:
        return 0.0
    tried = np.unique(np.quantile(gaps, np.linspace(0.0, 1.0, CANDIDATES), method="nearest"))[::-1]
    for step in map(float, tried):
        for most in (2.0, 8.0, 32.0, 128.0, np.inf):  # a step that is not quite right is told from few of them first
            near = away[np.abs(away) < most * step]
            whole = np.rint(near / step)
            if np.any(whole):
                step = float(whole @ near / (whole @ whole))
        whole = np.rint(away / step)
        if np.mean(whole != 0.0) > MOST > np.mean(np.abs(away / step - whole) > WHOLE):
            return abs(step)
    return 0.0


def quantised(
    dq: np.ndarray, periods: int, at: np.ndarray, excited: np.ndarray, noise: np.ndarray, step: float
) -> tuple[np.ndarray, float]:
    """What repeated quantisation adds to the power (m,) of the spectrum of increments ``dq`` (n,) at the lines ``at``,
    beyond the ``noise`` (m,) between them, and the power that repeats over what would by chance.

    The motion is built of the ``excited`` (m,) lines, of what the mean position of each period says, and of noise like
    that between the lines; it is rounded to steps at several places within one, and the spectra of what rounding adds
    are averaged. Spectra are sums over the samples, over their number.
    """
    from scipy.fft import irfft, rfft

    size = dq.size
    turn = np.abs(1.0 - np.exp(-2j * np.pi * np.arange(size // 2 + 1) / size)) ** 2
    white = step**2 / 12.0 / size * turn[at]
    if step == 0.0 or periods * np.max(white / np.maximum(noise, 1e-300)) < TINY:
        return np.zeros(at.size), 1.0
    spectrum = rfft(dq) / size
    between = np.ones(turn.size, dtype=bool)
    between[:: at[0]] = False  # the first line is the base period's
    kept, seen = np.zeros(turn.size, complex), at[excited & (np.abs(spectrum[at]) ** 2 > CLEAR * periods * white)]
    kept[seen] = spectrum[seen] / (1.0 - np.exp(-2j * np.pi * seen / size))
    position, moved = np.cumsum(dq), irfft(kept * size, size)
    moved += _drift(position - moved, periods)
    unsure = step * np.sqrt(_unsure((position - moved) / step, periods) / (12.0 * size))
    random, power, levels = np.random.default_rng(0), np.zeros(turn.size), np.zeros(OFFSETS)
    for i in range(OFFSETS):
        noisy = unsure * np.exp(2j * np.pi * random.random(turn.size))
        x = (moved + irfft(noisy * size, size)) / step + i / OFFSETS
        rounded = np.abs(rfft(np.rint(x) - x)) ** 2 * 12.0 / size  # over what is white
        power += rounded / OFFSETS
        levels[i] = np.mean(rounded[at[excited]])
    off = _mean_of(np.where(between, power, 0.0), NEAR * periods)[at] * periods / (periods - 1.0)
    on = power[at]
    for alike in (excited, ~excited):  # what is odd answers odd lines with odd ones
        on[alike] = _mean_of(on[alike], NEAR) if np.any(alike) else on[alike]
    # Where the carriage is within a step nobody knows. Rounding is odd, or even, about two places each: the worst is
    # as far above the mean as the second harmonic says.
    worst = 1.0 + 2.0 * float(np.abs(np.fft.rfft(levels)[2])) / float(np.sum(levels))
    return worst * np.maximum(on - off, 0.0) * white, float(np.mean(on[excited]))


def _unsure(left: np.ndarray, periods: int) -> np.ndarray:
    """The power (n // 2 + 1,) over that of white steps of the noise in ``left`` (n,), by which periods differ.

    It is what stands clearly above the steps and spreads the carriage over them, so that less of these repeats. Of the
    differences from one period to the next the median is taken, since the last often has the end of the excitation in
    it.
    """
    from scipy.fft import rfft

    gaps = np.diff(rfft(left.reshape(periods, -1), axis=1), axis=0)
    power = 0.5 * np.abs(gaps) ** 2 * 12.0 * periods / left.size
    usual = np.median(power, axis=0) / np.log(2.0) if periods > 3 else np.mean(power, axis=0)
    level = _mean_of(usual, NEAR)
    above = np.where(level > 1.0 + 4.0 / np.sqrt(NEAR * (periods - 1)), level - 1.0, 0.0)
    found = np.interp(np.arange(left.size // 2 + 1), np.arange(above.size) * periods, above)
    found[:periods] = 0.0  # which the means of the periods have
    return found


def _drift(position: np.ndarray, periods: int) -> np.ndarray:
    """The straight lines (n,) through the mean ``position`` (n,) of each period, which excitation has no part in."""
    samples = position.size // periods
    middle = (np.arange(periods) + 0.5) * samples - 0.5
    means = position.reshape(periods, samples).mean(axis=1)
    k = np.arange(position.size)
    slope = np.diff(means) / samples
    found = np.interp(k, middle, means)
    found[k < middle[0]] += slope[0] * (k[k < middle[0]] - middle[0])
    found[k > middle[-1]] += slope[-1] * (k[k > middle[-1]] - middle[-1])
    return found


def _mean_of(power: np.ndarray, lines: int) -> np.ndarray:
    """``power`` (n,) averaged over so many neighbouring ``lines``."""
    from scipy.ndimage import uniform_filter1d

    return np.asarray(uniform_filter1d(power, lines | 1, mode="reflect"))
