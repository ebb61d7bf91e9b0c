"""Spectra of position and command in answer to the instrument: periodic, stepped and broadband excitation.

Periodic excitation. Whole periods are transformed, so no power leaks. A stretch of P periods of N samples has a
spectrum of P N lines, of which at most every P-th is excited. The others contain noise and the transient, which is
smooth in frequency. A parabola through the lines around an excited one that are not multiples of P gives the transient
at that line, which is subtracted, and its residuals give the noise: the covariance of position and command from one
stretch. Lines at multiples of P without excitation contain the nonlinear distortion in addition to that noise. Source:
R. Pintelon and J. Schoukens, System Identification: A Frequency Domain Approach, 2nd ed., chapters 3, 4 and 7.

Nonlinear distortion. At lines of the base period without excitation a linear plant has only noise, which the lines
between give. Where only odd lines are excited, a nonlinearity that is even in the motion shows at even lines and an odd
one, such as dry friction at reversals, at odd lines. Feedback acts on the command at these lines too, so the linear
answer to the command is subtracted first. Source: the same book, chapter 4.

Broadband excitation. Long blocks resolve a resonance; short ones have a better signal-to-noise ratio while a sweep
passes. So the answer is computed for several block lengths, and the estimate takes each part of the band from one of
them. Short blocks also smooth the response: the difference to blocks of half the length shows that bias. Since it grows
with the square of the line width, the longer blocks have a third of the difference. The difference to a fourth-order
polynomial shows the interpolation error of the parabola; the last of the correction terms shows the truncation error of
the windows of averaged spectra.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import scipy

from emps_design.errors import RecordError
from emps_design.frequency_response.broadband import Answer, blocks, local_polynomial, welch
from emps_design.frequency_response.response import neighbours
from emps_design.frequency_response.signals import COMMAND, Signals, Step, quantised
from emps_design.messages import Message, warning
from emps_design.progress import Progress

LINES = 14  # lines between the excited ones that the parabola is laid through
ORDER = 2
EXCITED = 1e-3  # share of the strongest line from which on a line counts as excited
ABOVE = 10.0  # and how far it is above its neighbours that are no multiple of P

SEEN = 2.0  # times the noise power from which on a distortion counts
CHANCE = 4.0  # or so many deviations of what the noise power differs by by chance, where that is less
FEWEST = 4  # lines of a kind

SHORTEST_BLOCK = 2.0  # s
LONGER = 6  # times that blocks are doubled
ALIKE = 0.5  # share of the longest part, shorter than which a part is left out
REST = 1.0 / 3.0  # of the difference to blocks of half the length
AVERAGED = 9  # lines over which that is averaged
FEWEST_OF_A_BLOCK = 80  # samples of a block

Method = Callable[[list[Signals], int], tuple[Answer, int]]


@dataclass(frozen=True, eq=False)
class Spectra:
    """Amplitudes of position increment and command at the lines of one stretch, and their noise.

    ``line`` (m,) numbers within the base period; ``r`` (m,), ``z`` (m, 2) amplitudes; ``noise`` (m, 2, 2) covariance of
    ``z``; ``freedom`` its degrees of freedom; ``periods`` P; ``excited`` (m,) True at excited lines. ``repeated`` (m,)
    is the power of the encoder's steps that repeats with the excitation, a part of the position's noise; ``by_chance``
    is the ratio of all power of the steps that repeats to the power that would repeat by chance.
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
        """The spectra at the indices, or where the mask, ``lines`` selects."""
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
    """Spectra of the stretches of ``signals`` up to ``highest`` [Hz].

    The loop settles first: over what a stretch has beyond whole periods, or, of a stretch of three periods or more with
    less than a third of one beyond, over its first period.
    """
    by_stretch = []
    for start, stop in signals.stretches:
        periods = (stop - start) // signals.repeats
        if periods >= 3 and 3 * (stop - start - periods * signals.repeats) < signals.repeats:
            periods -= 1
        if periods >= 2:
            begin = stop - periods * signals.repeats
            by_stretch.append(_spectra_of_stretch(signals, begin, periods, highest))
    return by_stretch


def step_spectra(signals: Signals, step: Step) -> Spectra:
    """Spectra of one ``step`` of a stepped sine, at its line."""
    periods = (step.stop - step.start) // step.samples
    just_above = (step.turns + 0.5) / (step.samples * signals.period)
    whole = _spectra_of_stretch(
        replace(signals, repeats=step.samples), step.stop - periods * step.samples, periods, just_above
    )
    return whole.at(np.array([step.turns - 1]))


def _spectra_of_stretch(signals: Signals, begin: int, periods: int, highest: float) -> Spectra:
    size = periods * signals.repeats
    part = slice(begin, begin + size)
    r, *z = (
        scipy.fft.rfft(_without_trend(values[part], periods)) / size for values in (signals.r, signals.dq, signals.u)
    )
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
        residuals = away @ around
        transient[i] = intercept @ around
        noise[i] = residuals.T @ residuals.conj() / (own.size - ORDER - 1) * (1.0 + intercept @ intercept)
    more, by_chance = quantised(signals.dq[part], periods, at, excited, noise[:, 0, 0].real, signals.step)
    noise[:, 0, 0] += more
    return Spectra(line, r[at], both[at] - transient, noise, LINES - ORDER - 1, periods, excited, more, by_chance)


def _without_trend(values: np.ndarray, periods: int) -> np.ndarray:
    """``values`` without their mean and the trend of the means of their periods, to which no excitation contributes."""
    means = values.reshape(periods, -1).mean(axis=1)
    place = np.arange(periods) - 0.5 * (periods - 1)
    slope = float(place @ (means - means.mean()) / (place @ place)) * periods / values.size
    return values - means.mean() - slope * (np.arange(values.size) - 0.5 * (values.size - 1))


@dataclass(frozen=True, eq=False)
class Distortion:
    """Odd and even distortion and the noise of one period, rms relative to the linear answer.

    A level is None where every line of its kind is excited. ``odd_lines`` (m,) [Hz] and ``odd_power`` (m,), relative
    and without noise, are the spectrum of the odd distortion.
    """

    noise: float
    odd: float | None
    even: float | None
    odd_lines: np.ndarray
    odd_power: np.ndarray

    def odd_variance(self, frequency: np.ndarray, power: np.ndarray) -> np.ndarray:
        """Relative variance (n,) that odd distortion adds to a response; averaging does not lower it.

        ``power`` (n,) is that of the motion: a line with less motion than its neighbours is distorted more.
        """
        if self.odd is None or not self.odd > 0.0:
            return np.zeros(frequency.size)
        half = 4
        smooth = np.maximum(np.mean(self.odd_power[neighbours(self.odd_lines.size, half)], axis=1), 0.0)
        usual = scipy.ndimage.median_filter(power, 2 * half + 1, mode="nearest")
        return np.interp(frequency, self.odd_lines, smooth) * np.maximum(usual / power, 1.0)

    @property
    def warnings(self) -> list[Message]:
        """A message on each kind of distortion above 5 %."""
        messages = []
        for name, level in (("odd", self.odd), ("even", self.even)):
            if level is not None and level > 0.05:
                text = (
                    f"{name} nonlinear distortion of {100 * level:.2g} % of the linear answer, noise of one period "
                    f"{100 * self.noise:.2g} %"
                )
                messages.append(warning("nonlinear-distortion", text, level=level, noise=self.noise))
        return messages

    def to_dict(self) -> dict[str, Any]:
        """The three levels."""
        return {"noise": self.noise, "odd": self.odd, "even": self.even}


def distortion_of(stretches: list[Spectra], excited: np.ndarray, step: float, g: np.ndarray) -> Distortion | None:
    """Distortion at the lines without excitation, relative to the linear answer at the nearest excited line.

    ``excited`` (m,) marks the excited lines of the base period, ``step`` [Hz] apart; ``g`` is increment over command at
    them. None where every line between the first and the last is excited.
    """
    line = stretches[0].line
    inside = (line > line[excited][0]) & (line < line[excited][-1]) & ~excited
    if not np.any(inside):
        return None
    nearest = np.array([int(np.argmin(np.abs(line[excited] - k))) for k in line[inside]])
    there = g[nearest]
    power, noise, linear = np.zeros((3, there.size))
    for stretch in stretches:
        rest = stretch.z[inside, 0] - there * stretch.z[inside, 1]
        C = stretch.noise[inside]
        own = C[:, 0, 0].real + np.abs(there) ** 2 * C[:, 1, 1].real - 2.0 * (C[:, 0, 1] * there.conj()).real
        power = power + np.abs(rest) ** 2
        noise = noise + own
        linear = linear + np.abs(there * stretch.z[excited, 1][nearest]) ** 2
    odd = line[inside] % 2 == 1
    only_odd = bool(np.all(line[excited] % 2 == 1))

    def level(which: np.ndarray) -> float | None:
        if np.count_nonzero(which) < FEWEST:
            return None
        share = (power - noise)[which] / linear[which]
        by_noise = noise[which] / linear[which]
        # The relative deviation of a mean of powers, one of each line and pass, is one over the root of their number.
        count = len(stretches) * float(np.sum(by_noise) ** 2 / np.sum(by_noise**2))
        threshold = min(SEEN, 1.0 + CHANCE / np.sqrt(count)) * np.mean(by_noise)
        significant = np.mean(power[which] / linear[which]) > threshold
        return float(np.sqrt(max(np.mean(share), 0.0))) if significant else 0.0

    return Distortion(
        float(np.sqrt(np.mean(noise * np.mean([stretch.periods for stretch in stretches]) / linear))),
        level(odd),
        level(~odd) if only_odd else None,
        step * line[inside][odd],
        ((power - noise) / linear)[odd],
    )


@dataclass(frozen=True, eq=False)
class Extra:
    """Figures beside an answer: passes, periods, averages, ratio of spectra (m,), scatter between passes, distortion.

    ``steps`` is the ratio of the power of the encoder's steps that repeats to what would repeat by chance; 1 where the
    steps are less than half of the noise. ``bias``, (m,) or 0, is the relative variance that averaging does not lower.
    ``ratio`` is computed when it is called: without a period it takes as long as the answer.
    """

    passes: int
    periods: int
    averages: float
    ratio: Callable[[], np.ndarray]
    scatter: float = 1.0
    distortion: Distortion | None = None
    steps: float = 1.0
    bias: np.ndarray | float = 0.0


def periodic_answer(signals: list[Signals], highest: float, report_progress: Progress) -> tuple[Answer, Extra]:
    """The answer at the excited lines of whole periods up to ``highest`` [Hz], averaged over all stretches."""
    for record in signals:
        if not record.repeats:
            raise RecordError(
                f"{record.name}: found no period in the {record.kind}, expected two whole periods on one pass"
            )
    if len({record.repeats for record in signals}) > 1:
        every = ", ".join(f"{record.name}: {record.repeats * record.period:g} s" for record in signals)
        raise RecordError(f"found different periods ({every}), expected the same excitation in every record")
    stretches: list[Spectra] = []
    for i, record in enumerate(signals):
        report_progress("spectra", i / len(signals))
        stretches += spectra(record, highest)
    excited = np.all([stretch.excited for stretch in stretches], axis=0)
    if np.count_nonzero(excited) < 4:
        raise RecordError(
            f"{signals[0].name}: found {np.count_nonzero(excited)} excited lines, expected at least 4; excite a larger "
            "part of the band, or increase the amplitude"
        )
    line = stretches[0].line[excited]
    frequency = line / (signals[0].repeats * signals[0].period)
    answer, ratio, scatter = _mean([stretch.at(excited) for stretch in stretches], frequency)
    distortion = distortion_of(stretches, excited, float(frequency[0] / line[0]), answer.z[:, 0] / answer.z[:, 1])
    periods = sum(stretch.periods for stretch in stretches)
    repeated = _repeated_steps(stretches, excited)
    return answer, Extra(len(stretches), periods, periods, lambda: ratio, scatter, distortion, repeated)


def stepped_answer(signals: list[Signals], highest: float, report_progress: Progress) -> tuple[Answer, Extra]:
    """The answer at the line of each step up to ``highest`` [Hz], averaged over the steps at the same line."""
    lines: dict[float, list[Spectra]] = {}
    for i, record in enumerate(signals):
        report_progress("steps", i / len(signals))
        for step in record.steps:
            frequency = step.turns / (step.samples * record.period)
            if frequency <= highest:
                lines.setdefault(round(frequency, 9), []).append(step_spectra(record, step))
    if len(lines) < 4:
        found = "1 step" if len(lines) == 1 else f"{len(lines)} steps"
        raise RecordError(
            f"{signals[0].name}: found {found} at different lines, expected at least 4; give the records of the other "
            "lines too"
        )
    means = [_mean(lines[f], np.array([f])) for f in sorted(lines)]
    repeated = _repeated_steps([stretch for f in lines for stretch in lines[f]], np.array([True]))
    answers = [answer for answer, _, _ in means]
    answer = Answer(
        np.concatenate([answer.frequency for answer in answers]),
        np.concatenate([answer.z for answer in answers]),
        np.concatenate([answer.noise for answer in answers]),
        float(np.mean([answer.freedom for answer in answers])),
        np.concatenate([answer.weight for answer in answers]),
    )
    steps = sum(map(len, lines.values()))
    blocks_of = float(np.mean([sum(stretch.periods for stretch in lines[f]) for f in lines]))
    scatter = float(np.mean([scatter for _, _, scatter in means]))
    ratio = np.concatenate([ratio for _, ratio, _ in means])
    return answer, Extra(steps, round(blocks_of), blocks_of, lambda: ratio, scatter, steps=repeated)


def _repeated_steps(stretches: list[Spectra], excited: np.ndarray) -> float:
    """Power of the encoder's steps that repeats over what would by chance; 1 where it is not most of the noise."""
    share = np.median([stretch.repeated[excited] / stretch.noise[excited, 0, 0].real for stretch in stretches])
    return float(np.median([stretch.by_chance for stretch in stretches])) if share > 0.5 else 1.0


def _mean(stretches: list[Spectra], frequency: np.ndarray) -> tuple[Answer, np.ndarray, float]:
    """The mean of spectra at the same excited lines, weighted by power; the ratio of spectra (m,); the variance between
    the stretches over what their noise explains."""
    weights = np.array([stretch.periods * np.abs(stretch.r) ** 2 for stretch in stretches])
    share = weights / weights.sum(axis=0)
    each = np.array([stretch.z / stretch.r[:, None] for stretch in stretches])
    own = np.array([stretch.noise / np.abs(stretch.r[:, None, None]) ** 2 for stretch in stretches])
    z = np.sum(share[..., None] * each, axis=0)
    noise = np.sum(share[..., None, None] ** 2 * own, axis=0)
    # Steps of the encoder that repeat do so on the next pass too: their amplitudes add up.
    repeated = share * np.sqrt([stretch.repeated / np.abs(stretch.r) ** 2 for stretch in stretches])
    noise[:, 0, 0] += np.sum(repeated, axis=0) ** 2 - np.sum(repeated**2, axis=0)
    answer = Answer(frequency, z, noise, float(stretches[0].freedom * len(stretches)), weights.sum(axis=0))
    g = z[:, 0] / z[:, 1]
    scatter = 1.0
    if len(stretches) > 1:
        # The difference of a pass to the mean, as an output error, against the variance that its noise predicts.
        residual = each[..., 0] - g * each[..., 1]
        predicted = own[..., 0, 0].real + np.abs(g) ** 2 * own[..., 1, 1].real - 2.0 * (own[..., 0, 1] * g.conj()).real
        scatter = float(np.mean(np.abs(residual) ** 2 / predicted / (1.0 - share)))
    cross = [
        stretch.z[:, 0] * stretch.z[:, 1].conj() + stretch.noise[:, 0, 1] * stretch.periods for stretch in stretches
    ]
    own_power = [np.abs(stretch.z[:, 1]) ** 2 + stretch.noise[:, 1, 1].real * stretch.periods for stretch in stretches]
    ratio = np.sum(cross, axis=0) / np.sum(own_power, axis=0)
    return answer, ratio, scatter


def broadband_answers(
    signals: list[Signals], method: str, low: float, highest: float, report_progress: Progress
) -> list[tuple[Answer, Extra]]:
    """The answers to an excitation that does not repeat, by ``method`` local-polynomial or welch, from blocks of
    several lengths, short ones first."""

    def polynomial(signals: list[Signals], samples: int) -> tuple[Answer, int]:
        parts = [(record, part) for record in signals for part in blocks(record, samples)]
        longest = max((part.stop - part.start for _, part in parts), default=0)
        parts = [(record, part) for record, part in parts if part.stop - part.start >= ALIKE * longest]
        shortest = min((part.stop - part.start for _, part in parts), default=0)
        if shortest < FEWEST_OF_A_BLOCK:
            raise RecordError(
                f"{signals[0].name}: found stretches of {shortest} samples, expected at least {FEWEST_OF_A_BLOCK}"
            )
        # Blocks of one length have their lines at the same frequencies.
        cut = [(record, slice(part.start, part.start + shortest)) for record, part in parts]
        return _averaged([local_polynomial(record, part, low, highest) for record, part in cut]), len(cut)

    def spectra(signals: list[Signals], samples: int) -> tuple[Answer, int]:
        answer = _averaged([welch(record, samples // 4, low, highest) for record in signals])
        return answer, max(1, round(answer.freedom))

    take = spectra if method == "welch" else polynomial
    by_length = _answers_by_length(signals, take, report_progress)
    of_command = [replace(record, r=record.u, kind=COMMAND) for record in signals]

    def ratio(samples: int, frequency: np.ndarray) -> np.ndarray:
        return _quotient_at(frequency, take(of_command, samples)[0])

    answers = []
    for i, (samples, answer, count) in enumerate(by_length):
        passes = len(signals) if method == "welch" else count
        bias = _bias(answer, *(shorter for _, shorter, _ in by_length[max(i - 1, 0) : i]))
        answers.append((answer, Extra(passes, count, count, partial(ratio, samples, answer.frequency), bias=bias)))
    return answers[1:] or answers  # the shortest blocks serve only for comparison


def _answers_by_length(
    signals: list[Signals], take: Method, report_progress: Progress
) -> list[tuple[int, Answer, int]]:
    """Samples of a block, answer and number of blocks, for each block length that the records allow."""
    longest = max((stop - start for record in signals for start, stop in record.stretches), default=0)
    answers: list[tuple[int, Answer, int]] = []
    refused = None
    for i in range(LONGER + 1):
        samples = round(SHORTEST_BLOCK / signals[0].period) << i
        report_progress("blocks of several lengths", i / (LONGER + 1))
        try:
            answers.append((samples, *take(signals, samples)))
        except RecordError as error:  # too short for any line, or too long for blocks to average
            refused = refused or error
        if samples >= longest:
            break
    if not answers:
        raise refused or RecordError(f"{signals[0].name}: found no usable stretch")
    return answers


def _bias(answer: Answer, *shorter: Answer) -> np.ndarray:
    """Relative variance (m,) of the systematic error, from a finer interpolation and from blocks of half the length."""
    variance = np.maximum(_smooth(answer.interpolation), 0.0)
    return np.max([variance, *(REST**2 * _difference_variance(answer, other) for other in shorter)], axis=0)


def _difference_variance(answer: Answer, shorter: Answer) -> np.ndarray:
    """Relative variance (m,) by which blocks of half the length differ, less the contribution of noise.

    Beyond their lowest and highest line it is that of the nearest line.
    """
    f = answer.frequency
    apart = _quotient_at(f, shorter) / _quotient_at(f, answer) - 1.0
    excess = _smooth(np.abs(apart) ** 2 - answer.variance - np.interp(f, shorter.frequency, shorter.variance))
    both = (f >= shorter.frequency[0]) & (f <= shorter.frequency[-1])
    return np.interp(f, f[both], excess[both]) if np.any(both) else excess


def _smooth(variance: np.ndarray) -> np.ndarray:
    """The mean of ``variance`` (m,) over neighbouring lines."""
    return np.asarray(scipy.ndimage.uniform_filter1d(variance, AVERAGED, mode="nearest"))


def _quotient_at(frequency: np.ndarray, answer: Answer) -> np.ndarray:
    """Increment over command at ``frequency`` (m,) [Hz], interpolated times frequency squared, flat for a mass."""
    even = answer.z[:, 0] / answer.z[:, 1] * answer.frequency**2
    return np.interp(frequency, answer.frequency, even) / frequency**2


def _averaged(answers: list[Answer]) -> Answer:
    """Weighted mean of several answers at the same lines."""
    if len({answer.frequency.size for answer in answers}) > 1 or not answers[0].frequency.size:
        raise RecordError("found no lines between the lowest and the highest frequency, expected a wider band")
    weights = np.array([answer.weight for answer in answers])
    excited = weights.sum(axis=0) > 0.0
    if np.count_nonzero(excited) < 4:
        raise RecordError(
            f"found {np.count_nonzero(excited)} excited lines, expected at least 4 between the "
            "lowest and the highest frequency: excite that band"
        )
    weights = weights[:, excited]
    share = weights / weights.sum(axis=0)
    z = np.sum(share[..., None] * np.array([answer.z[excited] for answer in answers]), axis=0)
    noise = np.sum(share[..., None, None] ** 2 * np.array([answer.noise[excited] for answer in answers]), axis=0)
    freedom = sum(answer.freedom for answer in answers)
    # An interpolation error is the same in every block: its amplitudes are averaged, of noise the powers.
    finer = [(answer.missed[excited], answer.missed_noise[excited]) for answer in answers if answer.missed is not None]  # type: ignore[index]
    pairs = list(zip(share, finer, strict=True)) if finer else []
    missed = np.sum([s[:, None] * difference for s, (difference, _) in pairs], axis=0) if finer else None
    of_noise = np.sum([s[:, None, None] ** 2 * covariance for s, (_, covariance) in pairs], axis=0) if finer else None
    frequency = answers[0].frequency[excited]
    return Answer(frequency, z, noise, freedom, weights.sum(axis=0), missed, of_noise)
