"""Periodic excitation: whole periods, so nothing leaks; noise and transients from the lines between.

A stretch of P periods of N samples has a spectrum of P N lines. The excitation is on every P-th of them at most; the
others hold noise, and what is left of the transient, which is smooth in frequency. Around each excited line a parabola
through the lines that are no multiple of P gives the transient there, to be taken off, and its residuals the noise: a
covariance of position and command from one stretch, with as many degrees of freedom as lines were used. The lines
at multiples of P without excitation hold, above that noise, what a nonlinear plant makes of the others: even and
odd distortion apart. Source: R. Pintelon and J. Schoukens, System Identification: A Frequency Domain Approach, 2nd ed.,
chapters 3, 4 and 7.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from emps_design.frequency_response.quantisation import quantised
from emps_design.frequency_response.signals import Signals
from emps_design.frequency_response.steps import Step

LINES = 14  # lines between the excited ones that the parabola is laid through
ORDER = 2
EXCITED = 1e-3  # share of the strongest line from which on a line counts as excited
ABOVE = 10.0  # and how far it is above its neighbours that are no multiple of P


@dataclass(frozen=True, eq=False)
class Spectra:
    """Amplitudes of position increment and command at the lines of one stretch, and what of them is noise.

    ``line`` (m,) numbers within the base period; ``r`` (m,), ``z`` (m, 2) amplitudes; ``noise`` (m, 2, 2) covariance of
    ``z``; ``freedom`` its degrees of freedom; ``periods`` P; ``excited`` (m,) whether the line is. ``repeated`` (m,) is
    the part of the noise of the position that is the encoder's steps and repeats with the excitation, ``by_chance`` all
    that repeats of them over what would by chance.
    """

    line: np.ndarray
    r: np.ndarray
    z: np.ndarray
    noise: np.ndarray
    freedom: int
    periods: int
    excited: np.ndarray
    repeated: np.ndarray
    by_chance: float

    def at(self, lines: np.ndarray) -> Spectra:
        """Those of ``lines`` (m,) alone."""
        return replace(
            self,
            line=self.line[lines],
            r=self.r[lines],
            z=self.z[lines],
            noise=self.noise[lines],
            excited=self.excited[lines],
            repeated=self.repeated[lines],
        )


def spectra(signals: Signals, highest: float) -> list[Spectra]:
    """Spectra of the stretches of ``signals`` up to ``highest`` [Hz]; the loop settles over a third of a period first,
    or over the first period of a long stretch that has no such rest.
    """
    found = []
    for start, stop in signals.stretches:
        periods = (stop - start) // signals.repeats
        if periods >= 3 and 3 * (stop - start - periods * signals.repeats) < signals.repeats:
            periods -= 1
        if periods >= 2:
            begin = stop - periods * signals.repeats
            found.append(_stretch(signals, begin, periods, highest))
    return found


def step_spectra(signals: Signals, step: Step) -> Spectra:
    """The spectra of a step at its one line."""
    periods = (step.stop - step.start) // step.samples
    just_above = (step.turns + 0.5) / (step.samples * signals.period)
    whole = _stretch(replace(signals, repeats=step.samples), step.stop - periods * step.samples, periods, just_above)
    return whole.at(np.array([step.turns - 1]))


def _stretch(signals: Signals, begin: int, periods: int, highest: float) -> Spectra:
    from scipy.fft import rfft

    size = periods * signals.repeats
    part = slice(begin, begin + size)
    r, *z = (rfft(_level(values[part], periods)) / size for values in (signals.r, signals.dq, signals.u))
    both = np.stack(z, axis=-1)
    last = min((r.size - 2) // periods, int(highest * signals.period * signals.repeats + 1e-9))
    line = np.arange(1, last + 1)
    at = line * periods
    strength = np.abs(r[at])
    between = np.abs(r[: at[-1] + periods])
    floor = np.array([np.sqrt(np.mean(between[k - periods + 1 : k] ** 2)) for k in at])
    excited = (strength > EXCITED * np.max(strength)) & (strength > ABOVE * floor)
    offsets = np.array([j for j in range(-6 * LINES, 6 * LINES + 1) if j % periods])
    offsets = offsets[np.argsort(np.abs(offsets), kind="stable")][:LINES]
    transient, noise = np.empty((last, 2), complex), np.empty((last, 2, 2), complex)
    weights: dict[tuple[int, ...], tuple[np.ndarray, np.ndarray]] = {}
    for i, centre in enumerate(at):
        own = offsets
        if centre + offsets.min() < 1 or centre + offsets.max() > r.size - 1:
            near = np.arange(max(1, centre - 3 * LINES), min(r.size, centre + 3 * LINES)) - centre
            near = near[(near + centre) % periods != 0]
            own = near[np.argsort(np.abs(near), kind="stable")][:LINES]
        if tuple(own) not in weights:
            powers = (own[:, None] / LINES) ** np.arange(ORDER + 1)
            fit = np.linalg.pinv(powers)
            weights[tuple(own)] = (fit[0], np.eye(own.size) - powers @ fit)
        intercept, away = weights[tuple(own)]
        around = both[centre + own]
        left = away @ around
        transient[i] = intercept @ around
        noise[i] = left.T @ left.conj() / (own.size - ORDER - 1) * (1.0 + intercept @ intercept)
    more, by_chance = quantised(signals.dq[part], periods, at, excited, noise[:, 0, 0].real, signals.step)
    noise[:, 0, 0] += more
    return Spectra(line, r[at], both[at] - transient, noise, LINES - ORDER - 1, periods, excited, more, by_chance)


def _level(values: np.ndarray, periods: int) -> np.ndarray:
    """``values`` without their mean and the trend of the means of their periods, which no excitation is part of."""
    means = values.reshape(periods, -1).mean(axis=1)
    place = np.arange(periods) - 0.5 * (periods - 1)
    slope = float(place @ (means - means.mean()) / (place @ place)) * periods / values.size
    return values - means.mean() - slope * (np.arange(values.size) - 0.5 * (values.size - 1))
