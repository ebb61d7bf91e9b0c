"""What a loop answers to its instrument, from records that repeat, or that step from line to line."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from emps_design.errors import RecordError
from emps_design.frequency_response.broadband import Answer
from emps_design.frequency_response.distortion import Distortion, distortion_of
from emps_design.frequency_response.periodic import Spectra, spectra, step_spectra
from emps_design.frequency_response.signals import Signals
from emps_design.progress import Progress


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
