"""What a loop answers to its instrument, from records that repeat, or that step from line to line.

Periodic excitation: whole periods, so nothing leaks; noise and transients from the lines between.

A stretch of P periods of N samples has a spectrum of P N lines. The excitation is on every P-th of them at most; the
others hold noise, and what is left of the transient, which is smooth in frequency. Around each excited line a parabola
through the lines that are no multiple of P gives the transient there, to be taken off, and its residuals the noise: a
covariance of position and command from one stretch, with as many degrees of freedom as lines were used. The lines
at multiples of P without excitation hold, above that noise, what a nonlinear plant makes of the others: even and
odd distortion apart. Source: R. Pintelon and J. Schoukens, System Identification: A Frequency Domain Approach, 2nd ed.,
chapters 3, 4 and 7.

Noise and nonlinear distortion told apart, from the lines of the base period that were left without excitation.

A linear plant answers there with noise only, known from the lines between. Where only odd lines are excited, a
nonlinearity that is even in the motion answers at even lines and an odd one, such as dry friction that reverses, at odd
lines, those left out among them. Feedback makes the command move there too, so the linear answer to it is taken off
first. Source: R. Pintelon and J. Schoukens, System Identification: A Frequency Domain Approach, 2nd ed., chapter 4.

What a loop answers to an instrument that never repeats, in blocks as long as it and the noise allow.

In long blocks a resonance is resolved; in short ones a sweep stands out of the noise while it passes. So blocks of
several lengths are tried, and the longest taken that keep, at most frequencies, most of what the best ones tell. What
short blocks smooth over is no noise: it shows as the difference to blocks of half the length. Since that error goes
with the square of the width, a third of the difference is left in the longer ones. What a parabola between the lines
misses shows as the difference to a polynomial of the fourth order; what the windows of averaged spectra cut off, as the
last of the terms that are taken off for it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from emps_design.errors import RecordError
from emps_design.frequency_response.broadband import CLEAR, Answer, blocks, local_polynomial, welch
from emps_design.frequency_response.signals import COMMAND, Signals, Step, quantised
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
KEPT = 0.5  # share of the most information that the longest blocks have to keep
MOST = 0.8  # share of the octaves in which they do
ALIKE = 0.5  # share of the longest part, shorter than which a part is left out
REST = 1.0 / 3.0  # of the difference to blocks of half the length
AVERAGED = 9  # lines over which that is averaged
FEWEST_OF_A_BLOCK = 80  # samples of a block

Method = Callable[[list[Signals], int], tuple[Answer, int]]


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


@dataclass(frozen=True, eq=False)
class Distortion:
    """Amplitudes relative to the linear answer: of odd and even distortion and of the noise of one period.

    None where no line of that kind was left without excitation. ``odd_lines`` (m,) [Hz] and ``odd_power`` (m,),
    relative, noise taken off, say where the odd distortion is.
    """

    noise: float
    odd: float | None
    even: float | None
    odd_lines: np.ndarray
    odd_power: np.ndarray

    def odd_variance(self, frequency: np.ndarray, power: np.ndarray) -> np.ndarray:
        """Relative variance (n,) that odd distortion adds to a response; more averages do not lower it.

        ``power`` (n,) of the motion: what moves less than the lines beside it is distorted the more.
        """
        if self.odd is None or not self.odd > 0.0:
            return np.zeros(frequency.size)
        from scipy.ndimage import median_filter

        half = 4
        near = np.clip(np.arange(self.odd_lines.size)[:, None] + np.arange(-half, half + 1), 0, self.odd_lines.size - 1)
        smooth = np.maximum(np.mean(self.odd_power[near], axis=1), 0.0)
        usual = median_filter(power, 2 * half + 1, mode="nearest")
        return np.interp(frequency, self.odd_lines, smooth) * np.maximum(usual / power, 1.0)

    @property
    def words(self) -> list[str]:
        """What to say of it."""
        found = []
        for name, level in (("odd", self.odd), ("even", self.even)):
            if level is not None and level > 0.05:
                found.append(
                    f"{name} nonlinear distortion of {100 * level:.2g} % of the linear answer, noise of one period "
                    f"{100 * self.noise:.2g} %"
                )
        return found

    def to_dict(self) -> dict[str, Any]:
        """The three levels."""
        return {"noise": self.noise, "odd": self.odd, "even": self.even}


def distortion_of(found: list[Spectra], excited: np.ndarray, step: float, g: np.ndarray) -> Distortion | None:
    """Compare the lines without excitation with noise and with the linear answer at the excited lines beside them.

    ``excited`` (m,) says which lines of the base period are, ``step`` [Hz] apart; ``g`` is increment over command
    there. None where every line is.
    """
    line = found[0].line
    inside = (line > line[excited][0]) & (line < line[excited][-1]) & ~excited
    if not np.any(inside):
        return None
    nearest = np.array([int(np.argmin(np.abs(line[excited] - k))) for k in line[inside]])
    there = g[nearest]
    power, noise, linear = np.zeros((3, there.size))
    for one in found:
        rest = one.z[inside, 0] - there * one.z[inside, 1]
        C = one.noise[inside]
        own = C[:, 0, 0].real + np.abs(there) ** 2 * C[:, 1, 1].real - 2.0 * (C[:, 0, 1] * there.conj()).real
        power = power + np.abs(rest) ** 2
        noise = noise + own
        linear = linear + np.abs(there * one.z[excited, 1][nearest]) ** 2
    odd = line[inside] % 2 == 1
    only_odd = bool(np.all(line[excited] % 2 == 1))

    def level(which: np.ndarray) -> float | None:
        if np.count_nonzero(which) < FEWEST:
            return None
        share = (power - noise)[which] / linear[which]
        by_noise = noise[which] / linear[which]
        # The mean of so many powers, each of a line and a pass, differs by chance by one over the root of their number.
        count = len(found) * float(np.sum(by_noise) ** 2 / np.sum(by_noise**2))
        seen = np.mean(power[which] / linear[which]) > min(SEEN, 1.0 + CHANCE / np.sqrt(count)) * np.mean(by_noise)
        return float(np.sqrt(max(np.mean(share), 0.0))) if seen else 0.0

    return Distortion(
        float(np.sqrt(np.mean(noise * np.mean([one.periods for one in found]) / linear))),
        level(odd),
        level(~odd) if only_odd else None,
        step * line[inside][odd],
        ((power - noise) / linear)[odd],
    )


@dataclass(frozen=True, eq=False)
class Extra:
    """What else an estimate found: periods, scatter between the passes, distortion, and the ratio of spectra (m,).

    ``steps`` is the power of the encoder's steps that repeats over what would by chance, where most of the noise is
    that. ``bias`` is the relative variance, (m,) or 0, of what is no noise and no average lowers.
    """

    passes: int
    periods: int
    averages: float
    ratio: np.ndarray
    scatter: float = 1.0
    distortion: Distortion | None = None
    steps: float = 1.0
    bias: np.ndarray | float = 0.0


def periodic_answer(read: list[Signals], highest: float, tell: Progress) -> tuple[Answer, Extra]:
    """The answer at the excited lines of whole periods up to ``highest`` [Hz], averaged over all stretches."""
    for one in read:
        if not one.repeats:
            raise RecordError(f"{one.name}: the {one.kind} repeats nowhere, expected two whole periods on one pass")
    if len({one.repeats for one in read}) > 1:
        every = ", ".join(f"{one.name}: {one.repeats * one.period:g} s" for one in read)
        raise RecordError(f"found periods that differ ({every}), expected the same excitation in every record")
    found: list[Spectra] = []
    for i, one in enumerate(read):
        tell("spectra", i / len(read))
        found += spectra(one, highest)
    excited = np.all([one.excited for one in found], axis=0)
    if np.count_nonzero(excited) < 4:
        raise RecordError(
            f"{read[0].name}: found {np.count_nonzero(excited)} excited lines, expected at least 4; excite more of the "
            "band, or more strongly"
        )
    line = found[0].line[excited]
    frequency = line / (read[0].repeats * read[0].period)
    answer, ratio, scatter = _mean([one.at(excited) for one in found], frequency)
    distortion = distortion_of(found, excited, float(frequency[0] / line[0]), answer.z[:, 0] / answer.z[:, 1])
    periods = sum(one.periods for one in found)
    return answer, Extra(len(found), periods, periods, ratio, scatter, distortion, _steps(found, excited))


def stepped_answer(read: list[Signals], highest: float, tell: Progress) -> tuple[Answer, Extra]:
    """The answer at the line of each step up to ``highest`` [Hz], averaged over the steps at the same line."""
    lines: dict[float, list[Spectra]] = {}
    for i, one in enumerate(read):
        tell("steps", i / len(read))
        for step in one.steps:
            frequency = step.turns / (step.samples * one.period)
            if frequency <= highest:
                lines.setdefault(round(frequency, 9), []).append(step_spectra(one, step))
    if len(lines) < 4:
        raise RecordError(f"{read[0].name}: found {len(lines)} steps at different lines, expected at least 4")
    means = [_mean(lines[f], np.array([f])) for f in sorted(lines)]
    repeated = _steps([one for f in lines for one in lines[f]], np.array([True]))
    answers = [answer for answer, _, _ in means]
    answer = Answer(
        np.concatenate([one.frequency for one in answers]),
        np.concatenate([one.z for one in answers]),
        np.concatenate([one.noise for one in answers]),
        float(np.mean([one.freedom for one in answers])),
        np.concatenate([one.weight for one in answers]),
    )
    steps = sum(map(len, lines.values()))
    blocks_of = float(np.mean([sum(one.periods for one in lines[f]) for f in lines]))
    scatter = float(np.mean([scatter for _, _, scatter in means]))
    ratio = np.concatenate([ratio for _, ratio, _ in means])
    return answer, Extra(steps, round(blocks_of), blocks_of, ratio, scatter, steps=repeated)


def _steps(found: list[Spectra], excited: np.ndarray) -> float:
    """What repeats of the encoder's steps over what would by chance; 1 where that is not most of the noise."""
    share = np.median([one.repeated[excited] / one.noise[excited, 0, 0].real for one in found])
    return float(np.median([one.by_chance for one in found])) if share > 0.5 else 1.0


def _mean(found: list[Spectra], frequency: np.ndarray) -> tuple[Answer, np.ndarray, float]:
    """Several spectra at the same excited lines as one answer, each by its power; the ratio of spectra, and the scatter
    between them over what their noise explains."""
    weights = np.array([one.periods * np.abs(one.r) ** 2 for one in found])
    share = weights / weights.sum(axis=0)
    each = np.array([one.z / one.r[:, None] for one in found])
    own = np.array([one.noise / np.abs(one.r[:, None, None]) ** 2 for one in found])
    z = np.sum(share[..., None] * each, axis=0)
    noise = np.sum(share[..., None, None] ** 2 * own, axis=0)
    # What repeats of the encoder's steps does so on the next pass too: of it amplitudes add up.
    repeated = share * np.sqrt([one.repeated / np.abs(one.r) ** 2 for one in found])
    noise[:, 0, 0] += np.sum(repeated, axis=0) ** 2 - np.sum(repeated**2, axis=0)
    answer = Answer(frequency, z, noise, float(found[0].freedom * len(found)), weights.sum(axis=0))
    g = z[:, 0] / z[:, 1]
    scatter = 1.0
    if len(found) > 1:
        # What a pass differs by from the mean, as an output, against what its own noise predicts.
        left = each[..., 0] - g * each[..., 1]
        predicted = own[..., 0, 0].real + np.abs(g) ** 2 * own[..., 1, 1].real - 2.0 * (own[..., 0, 1] * g.conj()).real
        scatter = float(np.mean(np.abs(left) ** 2 / predicted / (1.0 - share)))
    ratio = np.sum([o.z[:, 0] * o.z[:, 1].conj() + o.noise[:, 0, 1] * o.periods for o in found], axis=0)
    ratio /= np.sum([np.abs(o.z[:, 1]) ** 2 + o.noise[:, 1, 1].real * o.periods for o in found], axis=0)
    return answer, ratio, scatter


def broadband_answer(
    read: list[Signals], method: str, low: float, highest: float, tell: Progress
) -> tuple[Answer, Extra]:
    """The answer of what does not repeat, by the ``method`` local-polynomial or welch."""

    def polynomial(signals: list[Signals], samples: int) -> tuple[Answer, int]:
        parts = [(one, part) for one in signals for part in blocks(one, samples)]
        longest = max((part.stop - part.start for _, part in parts), default=0)
        parts = [(one, part) for one, part in parts if part.stop - part.start >= ALIKE * longest]
        shortest = min((part.stop - part.start for _, part in parts), default=0)
        if shortest < FEWEST_OF_A_BLOCK:
            raise RecordError(
                f"{read[0].name}: found stretches of {shortest} samples, expected at least {FEWEST_OF_A_BLOCK}"
            )
        # Blocks of one length have their lines at the same frequencies.
        cut = [(one, slice(part.start, part.start + shortest)) for one, part in parts]
        return _averaged([local_polynomial(one, part, low, highest) for one, part in cut]), len(cut)

    def spectra(signals: list[Signals], samples: int) -> tuple[Answer, int]:
        answer = _averaged([welch(one, samples // 4, low, highest) for one in signals])
        return answer, max(1, round(answer.freedom))

    take = spectra if method == "welch" else polynomial
    tried = _tried(read, take, tell)
    answers = [answer for _, answer, _ in tried]
    biases = [_bias(one, *answers[max(i - 1, 0) : i]) for i, one in enumerate(answers)]
    at = _longest_that_keeps(answers, biases)
    samples, answer, count = tried[at]
    ratio, _ = take([replace(one, r=one.u, kind=COMMAND) for one in read], samples)
    passes = len(read) if method == "welch" else count
    return answer, Extra(passes, count, count, _quotient_at(answer.frequency, ratio), bias=biases[at])


def _tried(read: list[Signals], take: Method, tell: Progress) -> list[tuple[int, Answer, int]]:
    """Samples of a block, the answer, and the number of blocks, for each length that there is."""
    longest = max((stop - start for one in read for start, stop in one.stretches), default=0)
    found: list[tuple[int, Answer, int]] = []
    refused = None
    for i in range(LONGER + 1):
        samples = round(SHORTEST_BLOCK / read[0].period) << i
        tell("blocks of several lengths", i / (LONGER + 1))
        try:
            found.append((samples, *take(read, samples)))
        except RecordError as error:  # too short for any line, or too long for blocks to average
            refused = refused or error
        if samples >= longest:
            break
    if not found:
        raise refused or RecordError(f"{read[0].name}: found no stretch that can be used")
    return found


def _bias(answer: Answer, *shorter: Answer) -> np.ndarray:
    """The relative variance (m,) of what is no noise, by a finer interpolation and by blocks of half the length."""
    found = np.maximum(_smooth(answer.interpolation), 0.0)
    return np.max([found, *(REST**2 * _apart(answer, one) for one in shorter)], axis=0)


def _longest_that_keeps(tried: list[Answer], biases: list[np.ndarray]) -> int:
    """Which answer is of the longest blocks that keep most of the information, at most of the frequencies."""
    from scipy.ndimage import uniform_filter1d

    grid = min(tried, key=lambda one: one.frequency.size).frequency
    told = np.empty((len(tried), grid.size))
    for i, (one, bias) in enumerate(zip(tried, biases, strict=True)):
        of_noise = one.noise[:, (0, 1), (0, 1)].real
        clear = np.all(np.abs(one.z) ** 2 >= CLEAR * of_noise, axis=1)
        by_line = np.where(clear, 1.0 / np.maximum(one.variance + bias, 1e-12), 0.0)
        by_hertz = uniform_filter1d(by_line, AVERAGED, mode="nearest") / np.min(np.diff(one.frequency))
        told[i] = np.interp(grid, one.frequency, by_hertz)
    octaves = np.gradient(np.log(grid)) * (np.max(told, axis=0) > 0.0)
    enough = told >= KEPT * np.max(told, axis=0)
    keeps = enough @ octaves >= MOST * np.sum(octaves)
    # The shortest are there for the others to be compared with.
    return max(min(1, len(tried) - 1), *np.flatnonzero(keeps).tolist() or [int(np.argmax(enough @ octaves))])


def _apart(answer: Answer, shorter: Answer) -> np.ndarray:
    """The relative variance (m,) by which blocks of half the length differ, less what noise makes of it.

    Below their lowest line and above their highest it is that of the nearest line.
    """
    f = answer.frequency
    apart = _quotient_at(f, shorter) / _quotient_at(f, answer) - 1.0
    found = _smooth(np.abs(apart) ** 2 - answer.variance - np.interp(f, shorter.frequency, shorter.variance))
    both = (f >= shorter.frequency[0]) & (f <= shorter.frequency[-1])
    return np.interp(f, f[both], found[both]) if np.any(both) else found


def _smooth(variance: np.ndarray) -> np.ndarray:
    """The mean of ``variance`` (m,) over neighbouring lines."""
    from scipy.ndimage import uniform_filter1d

    return np.asarray(uniform_filter1d(variance, AVERAGED, mode="nearest"))


def _quotient_at(frequency: np.ndarray, answer: Answer) -> np.ndarray:
    """Increment over command at ``frequency`` (m,) [Hz]; between lines the frequency twice of a mass is taken out."""
    even = answer.z[:, 0] / answer.z[:, 1] * answer.frequency**2
    return np.interp(frequency, answer.frequency, even) / frequency**2


def _averaged(answers: list[Answer]) -> Answer:
    """Several answers at the same lines as one, each by its weight."""
    if len({one.frequency.size for one in answers}) > 1 or not answers[0].frequency.size:
        raise RecordError("found no lines between the lowest and the highest frequency, expected a wider band")
    weights = np.array([one.weight for one in answers])
    excited = weights.sum(axis=0) > 0.0
    if np.count_nonzero(excited) < 4:
        raise RecordError(
            f"found {np.count_nonzero(excited)} lines that the instrument excites, expected at least 4 between the "
            "lowest and the highest frequency: excite that band"
        )
    weights = weights[:, excited]
    share = weights / weights.sum(axis=0)
    z = np.sum(share[..., None] * np.array([one.z[excited] for one in answers]), axis=0)
    noise = np.sum(share[..., None, None] ** 2 * np.array([one.noise[excited] for one in answers]), axis=0)
    freedom = sum(one.freedom for one in answers)
    # What an interpolation misses it misses in every block alike: amplitudes are averaged, of noise the powers.
    finer = [(one.missed[excited], one.missed_noise[excited]) for one in answers if one.missed is not None]  # type: ignore[index]
    missed = np.sum([s[:, None] * one for s, (one, _) in zip(share, finer, strict=True)], axis=0) if finer else None
    of_noise = [s[:, None, None] ** 2 * one for s, (_, one) in zip(share, finer, strict=True)] if finer else None
    return Answer(
        answers[0].frequency[excited],
        z,
        noise,
        freedom,
        weights.sum(axis=0),
        missed,
        None if of_noise is None else np.sum(of_noise, axis=0),
    )
