"""What a loop answers to an instrument that never repeats, in blocks as long as it and the noise allow.

In long blocks a resonance is resolved; in short ones a sweep stands out of the noise while it passes. So blocks of
several lengths are tried, and the longest taken that keep, at most frequencies, most of what the best ones tell. What
short blocks smooth over is no noise: it shows as the difference to blocks of half the length. Since that error goes
with the square of the width, a third of the difference is left in the longer ones. What a parabola between the lines
misses shows as the difference to a polynomial of the fourth order; what the windows of averaged spectra cut off, as the
last of the terms that are taken off for it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from emps_design.errors import RecordError
from emps_design.frequency_response.answers import Extra
from emps_design.frequency_response.broadband import CLEAR, Answer, blocks, local_polynomial, welch
from emps_design.frequency_response.signals import COMMAND, Signals
from emps_design.progress import Progress

SHORTEST_BLOCK = 2.0  # s
LONGER = 6  # times that blocks are doubled
KEPT = 0.5  # share of the most information that the longest blocks have to keep
MOST = 0.8  # share of the octaves in which they do
ALIKE = 0.5  # share of the longest part, shorter than which a part is left out
REST = 1.0 / 3.0  # of the difference to blocks of half the length
NEAR = 9  # lines over which that is averaged
FEWEST = 80  # samples of a block

Method = Callable[[list[Signals], int], tuple[Answer, int]]


def broadband_answer(
    read: list[Signals], method: str, low: float, highest: float, tell: Progress
) -> tuple[Answer, Extra]:
    """The answer of what does not repeat, by the ``method`` local-polynomial or welch."""

    def polynomial(signals: list[Signals], samples: int) -> tuple[Answer, int]:
        parts = [(one, part) for one in signals for part in blocks(one, samples)]
        longest = max((part.stop - part.start for _, part in parts), default=0)
        parts = [(one, part) for one, part in parts if part.stop - part.start >= ALIKE * longest]
        shortest = min((part.stop - part.start for _, part in parts), default=0)
        if shortest < FEWEST:
            raise RecordError(f"{read[0].name}: found stretches of {shortest} samples, expected at least {FEWEST}")
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
        by_hertz = uniform_filter1d(by_line, NEAR, mode="nearest") / np.min(np.diff(one.frequency))
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

    return np.asarray(uniform_filter1d(variance, NEAR, mode="nearest"))


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
