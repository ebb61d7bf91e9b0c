"""Frequency response from closed-loop records by the joint input-output method, which feedback does not bias.

Noise reaches the command through the controller, so the ratio of the spectra of velocity and command tends to minus the
inverse of the controller wherever noise dominates the excitation. The instrument r is free of noise: the answers
Z = [position increment, command] to r are averaged, and G is the quotient of the averages. With the covariance C of the
averages its relative variance is, to first order,

    std^2 = C_qq/|z_q|^2 + C_uu/|z_u|^2 - 2 Re(C_qu / (z_q z_u*)).

Source: R. Pintelon and J. Schoukens, System Identification: A Frequency Domain Approach, 2nd ed., chapter 2.

Excess variance. A response is smooth in frequency, so the four lines around each predict it: the cubic through 1/G,
which is a straight line for a mass with viscous friction, or through j w G, which is smooth at an antiresonance;
whichever is closer. The variances predict the difference. Where the median difference of many lines is clearly larger,
as where dry friction spreads the power of each line over the others, the excess is treated as noise in the motion,
which weighs most on the lines that move least.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
import scipy

from emps_design.advice import advised
from emps_design.axis import Axis
from emps_design.errors import RecordError
from emps_design.frequency_response.answers import Distortion, Extra, broadband_answers, periodic_answer, stepped_answer
from emps_design.frequency_response.broadband import CLEAR, Answer
from emps_design.frequency_response.coupling import ResponseComparison
from emps_design.frequency_response.measured_plant import continuous_from_increments, without_aliases
from emps_design.frequency_response.response import (
    BAND,
    FrequencyResponse,
    Resonance,
    has_wrong_sign,
    neighbours,
    resonances,
)
from emps_design.frequency_response.signals import COMMAND, EXCITATION, REFERENCE, Signals, motion, signals_of
from emps_design.laws import NONE
from emps_design.messages import Message, note, warning, wrong
from emps_design.observer import back_emf_compensation, motor_share
from emps_design.progress import Progress, no_progress
from emps_design.records import Record
from emps_design.records.clock import same_period
from emps_design.units import Units
from emps_design.view import Line, Table, View, Viewed

AROUND = 20  # lines on either side, whose usual difference counts
CLEARLY = 2.0  # times the variance that noise explains
FEWEST = 12  # lines for a median
NEIGHBOURS = np.array([-2, -1, 1, 2])

METHODS = ("periodic", "stepped", "local-polynomial", "welch")
HIGHEST_SHARE = 0.8  # of the Nyquist frequency; above it the aliases are as large as the response
KEPT = 0.5  # share of the most information that the longest blocks have to keep
PER_OCTAVE = 24  # frequencies at which they are compared
WORST = 0.5  # relative deviation beyond which a line is left out
POOLED = 9  # neighbouring lines whose noise is averaged
REPEATED = 1.5  # power of repeated encoder steps, over that by chance, above which a warning says so
APART = {"periodic": 1, "local-polynomial": 4, "welch": 2}  # distance of lines with independent noise
SHOWN = 16  # lines of the table that a reader sees
RESTING = 0.01  # share of the time at rest above which a warning says so


def excess_variance(
    frequency: np.ndarray, response: np.ndarray, variance: np.ndarray, power: np.ndarray, apart: int = 1
) -> np.ndarray:
    """Return the relative variance (n,) of ``response`` (n,) that its scatter shows beyond ``variance``.

    ``frequency`` (n,) ascends, ``variance`` (n,) is relative, ``power`` (n,) is that of the motion over that of the
    disturbance. Lines nearer than ``apart`` share their noise.

    >>> f, random = np.arange(1.0, 101.0), np.random.default_rng(0)
    >>> mass, noise = 1.0 / (3j * f + 5.0), random.standard_normal((2, 100)) / np.sqrt(2.0)
    >>> rough = mass * (1.0 + 0.1 * (noise[0] + 1j * noise[1]))
    >>> excess = [excess_variance(f, rough, np.full(100, v), np.ones(100)) for v in (1e-2, 1e-6)]
    >>> float(np.max(excess[0])), round(float(np.sqrt(np.median(excess[1]))), 2)
    (0.0, 0.08)
    """
    n, offsets = frequency.size, apart * NEIGHBOURS
    if n < FEWEST + 4 * apart:
        return np.zeros(n)
    centre = np.arange(2 * apart, n - 2 * apart)
    near = centre[:, None] + offsets
    place = frequency[near] - frequency[centre, None]
    weight = np.ones(place.shape)
    for j in range(NEIGHBOURS.size):  # Lagrange weights at the line itself
        for k in range(NEIGHBOURS.size):
            if k != j:
                weight[:, j] *= place[:, k] / (place[:, k] - place[:, j])
    difference = np.full(centre.size, np.inf)
    expected = by_motion = difference
    for even in (1.0 / response, frequency * response):
        shares = weight * even[near] / even[centre, None]
        size = np.abs(np.sum(shares, axis=1) - 1.0) ** 2
        closer = size < difference
        expected, by_motion = (
            np.where(closer, level[centre] + np.sum(np.abs(shares) ** 2 * level[near], axis=1), other)
            for level, other in ((variance, expected), (1.0 / power, by_motion))
        )
        difference = np.where(closer, size, difference)
    usual = _mean_by_median(difference / np.maximum(expected, 1e-300))
    excess = np.where(usual > CLEARLY, _mean_by_median(difference / by_motion), 0.0)
    return np.interp(np.arange(n), centre, excess) / power


def _mean_by_median(ratio: np.ndarray) -> np.ndarray:
    """The mean of noise powers with the running median of ``ratio`` (m,), which is chi-squared with two degrees."""
    size = min(2 * AROUND + 1, ratio.size)
    return np.asarray(scipy.ndimage.median_filter(ratio, size, mode="nearest")) / np.log(2.0)


@dataclass(frozen=True, eq=False)
class ResponseEstimate(Viewed):
    """A measured response with its method, and the ratio of the spectra of velocity and command at the same lines.

    ``method`` is one of ``METHODS``, ``instrument`` the signal that excites the loop, ``spectral_ratio`` (n,)
    [(m/s)/N] the response without regard to feedback, for comparison; ``passes`` the number of stretches used, of
    ``seconds`` [s] together.
    """

    response: FrequencyResponse
    method: str
    instrument: str
    spectral_ratio: np.ndarray
    distortion: Distortion | None
    resonances: tuple[Resonance, ...]
    passes: int
    periods: int
    seconds: float
    reversals: int
    rest_share: float
    left_out: int
    axis: Axis = field(repr=False)
    warnings: tuple[Message, ...] = ()

    @cached_property
    def comparison(self) -> ResponseComparison:
        """The response beside the model of the axis, and beside the masses that fit it."""
        return ResponseComparison(self.response, self.axis)

    @property
    def all_warnings(self) -> tuple[Message, ...]:
        """Warnings about the data and about the chain of masses that fits them."""
        return (*self.warnings, *self.comparison.chain.warnings)

    def to_dict(self) -> dict[str, Any]:
        """Plain data: the table, the comparison, the method and its figures."""
        ratio = self.spectral_ratio
        apart = np.abs(ratio / self.response.response - 1.0)
        document = {
            "records": self.response.name,
            "method": self.method,
            "instrument": self.instrument,
            "lines": len(self.response),
            **self.response.to_dict(),
            "resonances": [resonance.to_dict() for resonance in self.resonances],
            **self.comparison.to_dict(),
            "distortion": None if self.distortion is None else self.distortion.to_dict(),
            "spectral_ratio": {
                "magnitude": np.abs(ratio),
                "phase_deg": np.degrees(np.angle(ratio)),
                "difference": {"median": float(np.median(apart)), "largest": float(np.max(apart))},
            },
            "passes": self.passes,
            "periods": self.periods,
            "seconds": self.seconds,
            "reversals": self.reversals,
            "rest_share": self.rest_share,
            "lines_left_out": self.left_out,
            "units": {"frequency_hz": "Hz", "magnitude": self.axis.units.unit("(m/s)/N"), "std": "of the modulus"},
            "warnings": list(self.all_warnings),
        }
        return advised("frf", document, self.axis.units)

    def view(self) -> View:
        """The method, some lines of the response, its resonances, the masses that fit it, and its distortion."""
        response, comparison = self.response, self.comparison
        passes = f"{self.passes} pass{'' if self.passes == 1 else 'es'}"
        return (
            Line(
                f"{response.name}: {len(response)} lines from {response.frequency[0]:.4g} to "
                f"{response.frequency[-1]:.4g} Hz; {self.method}, by the {self.instrument}, {self.seconds:.4g} s on "
                f"{passes}",
                "prose",
            ),
            self._table(),
            *(
                Line(f"{found.kind} at {found.frequency:.2f} +- {found.std:.2f} Hz, damping {found.damping:.3f}")
                for found in self.resonances
            ),
            *comparison.view(),
            *self._distortion(),
            Line("ratio of spectra: velocity over command, which ignores feedback; for comparison only", "prose"),
        )

    def _table(self) -> Table:
        """Some lines of the response, evenly spaced on a logarithmic scale."""
        response, unit = self.response, self.axis.units.unit
        wanted = np.geomspace(response.frequency[0], response.frequency[-1], SHOWN)
        apart = np.abs(self.spectral_ratio / response.response - 1.0)
        headings = ("frequency [Hz]", f"magnitude [{unit('(m/s)/N')}]", "phase [deg]", "std [%]")
        rows = [
            (
                f"{response.frequency[i]:.4g}",
                f"{response.magnitude[i]:.4g}",
                f"{response.phase_deg[i]:.1f}",
                f"{100 * response.std[i]:.2f}",
                f"{response.coherence[i]:.4f}",
                f"{100 * apart[i]:.2g} % off",
            )
            for i in sorted({int(np.argmin(np.abs(response.frequency - f))) for f in wanted})
        ]
        return Table((*headings, "coherence", "ratio of spectra"), rows)

    def _distortion(self) -> list[Line]:
        if self.distortion is None:
            return []
        levels = self.distortion.to_dict()
        words = ", ".join(f"{name} {100 * level:.2g} %" for name, level in levels.items() if level is not None)
        return [Line(f"relative to the linear answer, one period: {words} (odd, even: nonlinear distortion)", "prose")]


def estimate_response(
    records: Record | Sequence[Record],
    axis: Axis,
    method: str = "auto",
    instrument: str = "",
    low: float = 0.0,
    high: float | None = None,
    progress: Progress | None = None,
) -> ResponseEstimate:
    """Return the response of ``axis`` from force to velocity in ``records``, with its deviations.

    Of ``axis`` only the drive's gain and the computation delay are used: the force is the command, held over a period
    and delayed by that many samples. Hold, difference and delay are divided out; a lag of the current loop stays in the
    response. A duty refers to the ``supply`` of the record at each sample, else to the drive's. Where ``enable`` is 0
    the force is 0, without braking by the back-EMF. ``method`` is ``auto`` or one of ``METHODS``; ``instrument`` is as
    for :func:`~emps_design.frequency_response.signals.signals_of`, or ``command`` for open-loop records, where ``axis``
    has no controller; ``low`` and ``high`` [Hz] bound the lines. Raises :class:`RecordError` without an excitation, for
    a command as the excitation of a closed loop, where the motor is switched off throughout, where the excitation is
    too weak, and for frequencies beyond Nyquist; :class:`AxisError` for a duty whose supply neither ``axis`` nor a
    record has.
    """
    several = [records] if isinstance(records, Record) else list(records)
    axis = axis.supplied_by(*several)
    period = _same_period(several, axis)
    nyquist = 0.5 / period
    for bound in (low, *(() if high is None else (high,))):
        if not 0.0 <= bound <= nyquist:
            raise RecordError(
                f"{several[0].name}: found a frequency of {bound:g} Hz, expected at most the Nyquist frequency, "
                f"{nyquist:g} Hz, and at least 0"
            )
    highest = min(np.inf if high is None else high, HIGHEST_SHARE * nyquist)
    if low >= highest:
        raise RecordError(
            f"{several[0].name}: found a band from {low:g} to {highest:g} Hz, expected its lowest frequency below its "
            f"highest, which is at most {HIGHEST_SHARE * nyquist:g} Hz at this sampling"
        )
    _check_excitation(several, axis, instrument)
    if instrument == COMMAND:  # in open loop the whole command is the excitation
        several, instrument = [replace(record, excitation=record.u) for record in several], EXCITATION
    signals = [signals_of(_with_acting_command(record, axis), instrument) for record in several]
    method = _method(signals) if method == "auto" else method
    report_progress = progress or no_progress
    if method == "periodic":
        answers = [periodic_answer(signals, highest, report_progress)]
    elif method == "stepped":
        answers = [stepped_answer(signals, highest, report_progress)]
    else:
        answers = broadband_answers(signals, method, low, highest, report_progress)
    return _estimate(several, signals, axis, answers, method, low, highest)


def _check_excitation(records: list[Record], axis: Axis, instrument: str) -> None:
    """Refuse the command as the excitation where the controller of ``axis`` computes it, since it contains feedback."""
    if axis.controller.kind == NONE or instrument == REFERENCE:
        return
    for record in records:
        added = record.u if instrument == COMMAND else record.excitation
        if added is not None and np.ptp(added) > 0.0 and np.allclose(added, record.u, rtol=1e-9, atol=0.0):
            raise RecordError(
                f"{record.name}: found the command as the excitation too, expected the signal added to the output of "
                f"the controller of {axis.name} ({axis.controller.kind}): the command contains its feedback; for a "
                "record "
                'made in open loop the axis file has kind = "none" in [controller]'
            )


def _with_acting_command(record: Record, axis: Axis) -> Record:
    """The record with the command that, times ``axis.drive.gain``, is the force at its supply and motor switch.

    Supply and switch are those at the time at which the command acts, the computation delay after its sample.
    """
    share = motor_share(axis, record)
    if np.ndim(share) == 0:
        return record
    at = np.minimum(np.arange(len(record)) + round(axis.sampling.computation_delay), len(record) - 1)
    return replace(record, u=record.u * share[at] + back_emf_compensation(axis, record)[at])


def _same_period(records: list[Record], axis: Axis) -> float:
    for record in records:
        if not same_period(record.period, records[0].period):
            raise RecordError(
                f"{record.name}: sampled every {record.period:g} s, {records[0].name} every {records[0].period:g} s; "
                "expected the same period"
            )
    if axis.sampling.computation_delay and not same_period(records[0].period, axis.sampling.period):
        raise RecordError(
            f"{records[0].name}: sampled every {records[0].period:g} s, axis {axis.name} every "
            f"{axis.sampling.period:g} s; expected the same period, since its computation delay is in samples"
        )
    return records[0].period


def _method(signals: list[Signals]) -> str:
    if all(record.steps for record in signals):
        return "stepped"
    periods = {record.repeats for record in signals}
    if len(periods) == 1 and 0 not in periods and all(record.stretches for record in signals):
        return "periodic"
    return "local-polynomial"


@dataclass(frozen=True, eq=False)
class Lines:
    """The lines (m,) [Hz] of an answer: the ``quotient`` of increment and command, its relative variance and coherence.

    ``kept`` (m,) is True where both stand out of their noise, within the band.
    """

    frequency: np.ndarray
    quotient: np.ndarray
    variance: np.ndarray
    coherence: np.ndarray
    kept: np.ndarray


def _lines_of(answer: Answer, extra: Extra, method: str, low: float, highest: float) -> Lines:
    """The lines of ``answer`` with all of their variance, those from ``low`` to ``highest`` [Hz] to be kept."""
    f, z_q, z_u = answer.frequency, answer.z[:, 0], answer.z[:, 1]
    variance, freedom = answer.variance, answer.freedom
    if method != "stepped":  # its lines are far apart, each with its own amplitude
        variance = _pooled(variance, np.abs(z_q / z_u))
        freedom *= min(POOLED, variance.size) * (1.0 if method == "periodic" else 0.5)
    variance = variance * max(1.0, extra.scatter) * _few_degrees_factor(freedom)
    power = answer.weight * _near(np.abs(z_q) ** 2, np.median)
    if extra.distortion is not None:
        variance = variance + extra.distortion.odd_variance(f, power)
    coherence = 1.0 / (1.0 + variance * extra.averages)
    variance = variance + extra.bias
    of_q, of_u = answer.noise[:, 0, 0].real, answer.noise[:, 1, 1].real
    if method != "stepped":
        variance = np.maximum(variance, excess_variance(f, z_q / z_u, variance, power, APART[method]))
        of_q, of_u = _near(of_q, np.mean), _near(of_u, np.mean)
    quiet = np.finfo(float).tiny  # noise of a command that is the excitation
    above = np.minimum(*(np.abs(z) ** 2 / np.maximum(of, quiet) for z, of in ((z_q, of_q), (z_u, of_u))))
    if method != "stepped":  # selection by a line's own answer would bias the response upwards
        above = _near(above, np.median)
    kept = (above >= CLEAR) & (np.sqrt(variance) <= WORST) & (f >= low) & (f <= highest * (1.0 + 1e-9))
    return Lines(f, z_q / z_u, variance, coherence, kept)


def longest_blocks(lengths: Sequence[Lines]) -> list[np.ndarray]:
    """Masks (m,) of the lines of each of ``lengths``, from short blocks to long ones, that make up the response.

    At each frequency the longest blocks are taken that keep :data:`KEPT` of the most information per hertz, one over
    variance and distance of the lines; changes back and forth within a third of an octave are smoothed out.

    >>> short, long, kept = np.arange(1.0, 100.0), 0.5 * np.arange(1.0, 100.0), np.ones(99, bool)
    >>> lengths = [Lines(f, f, np.full(99, v), f, kept) for f, v in ((short, 0.01), (long, 0.03))]
    >>> [f[mask][[0, -1]].tolist() for f, mask in zip((short, long), longest_blocks(lengths))]
    [[49.0, 99.0], [0.5, 48.5]]
    """
    kept = np.concatenate([lines.frequency[lines.kept] for lines in lengths])
    if len(lengths) == 1 or not kept.size:
        return [np.full(lines.kept.size, lines is lengths[-1]) for lines in lengths]
    octave = np.log2(np.min(kept)), np.log2(np.max(kept))
    grid = np.linspace(*octave, 2 + int(PER_OCTAVE * (octave[1] - octave[0])))
    information = np.zeros((len(lengths), grid.size))
    for lines, row in zip(lengths, information, strict=True):
        per_hertz = lines.kept / np.maximum(lines.variance, 1e-12) / np.gradient(lines.frequency)
        row[:] = np.interp(grid, np.log2(lines.frequency), per_hertz, 0.0, 0.0)
    enough = information >= KEPT * np.max(information, axis=0)
    longest = len(lengths) - 1 - np.argmax(enough[::-1], axis=0)
    longest = scipy.ndimage.median_filter(longest, PER_OCTAVE // 3 | 1, mode="nearest")
    nearest = [np.interp(np.log2(lines.frequency), grid, np.arange(grid.size)) for lines in lengths]
    return [longest[np.rint(place).astype(int)] == i for i, place in enumerate(nearest)]


def _estimate(
    records: list[Record],
    signals: list[Signals],
    axis: Axis,
    answers: list[tuple[Answer, Extra]],
    method: str,
    low: float,
    highest: float,
) -> ResponseEstimate:
    """The response and its deviations from the ``answers`` of the loop, from short blocks to long ones."""
    lengths = [_lines_of(answer, extra, method, low, highest) for answer, extra in answers]
    masks = longest_blocks(lengths)
    parts = [(lines, extra, mask & lines.kept) for lines, (_, extra), mask in zip(lengths, answers, masks, strict=True)]
    count, most = (sum(map(np.count_nonzero, several)) for several in ([kept for *_, kept in parts], masks))
    name = ", ".join(record.name for record in records)
    if count < 4:
        few = max(run.few_lines for run in signals)
        if few:
            raise RecordError(
                f"{name}: found {few} line{'' if few == 1 else 's'} in the {signals[0].kind}, expected at least 4, or "
                "a band; excite more frequencies, in whole periods of all of them"
            )
        raise RecordError(
            f"{name}: found {count} of {most} lines where the answer to the {signals[0].kind} is above the noise, "
            "expected at least 4: the coherence is too low; increase the amplitude or the duration"
        )
    parts = [part for part in parts if np.any(part[2])]
    columns = [
        [column[kept] for column in (lines.frequency, lines.quotient, lines.variance, lines.coherence, extra.ratio())]
        for lines, extra, kept in parts
    ]
    order = np.argsort(np.concatenate([part[0] for part in columns]))
    frequency, quotient, variance, coherence, ratio = (
        np.concatenate(column)[order] for column in zip(*columns, strict=True)
    )
    extra = parts[-1][1]
    period, w, std = records[0].period, 2.0 * np.pi * frequency, np.sqrt(variance)
    late, gain = axis.sampling.computation_delay * period, axis.drive.gain

    def plant(ratio: np.ndarray) -> np.ndarray:
        return continuous_from_increments(ratio, w, period, late) / gain

    corrected, aliases = without_aliases(w, plant(quotient), std, period)
    response = FrequencyResponse(frequency, corrected, np.hypot(std, aliases), coherence, name)
    motions = [motion(run) for run in signals]
    reversals = int(sum(run["reversals"] for run in motions))
    seconds = sum(run["seconds"] for run in motions)
    rest = sum(run["rest_share"] * run["seconds"] for run in motions) / seconds
    left_out = int(most - count)
    return ResponseEstimate(
        response,
        method,
        signals[0].kind,
        plant(ratio),
        extra.distortion,
        resonances(response),
        extra.passes,
        extra.periods,
        seconds,
        reversals,
        rest,
        left_out,
        axis,
        (
            *(text for record in records for text in (*record.contradictions, *record.gaps_in_words)),
            *_messages(response, extra, reversals, rest, seconds, left_out, axis.units),
        ),
    )


def _pooled(variance: np.ndarray, size: np.ndarray) -> np.ndarray:
    """Relative variances (n,) averaged over neighbouring lines, since noise is smooth in frequency.

    Noise at the input makes a smooth relative variance; noise at the output, such as the encoder's, one proportional
    to 1/``size``^2 of the response. The likelier of the two is taken for each line.
    """
    near = neighbours(variance.size, POOLED // 2)
    power = size**2
    as_input, as_output = np.mean(variance[near], axis=1), np.mean((variance * power)[near], axis=1)
    with np.errstate(divide="ignore"):
        output = np.log(as_output) - np.mean(np.log(power[near]), axis=1) < np.log(as_input)
    return np.where(output, as_output / power, as_input)


def _near(power: np.ndarray, kind: Callable[..., np.ndarray]) -> np.ndarray:
    """``kind``, the mean or the median, of ``power`` (n,) over neighbouring lines."""
    return kind(power[neighbours(power.size, min(POOLED // 2, (power.size - 1) // 2))], axis=1)


def _few_degrees_factor(freedom: float) -> float:
    """Factor on a variance of ``freedom`` degrees so that the circle of known noise still holds 95 %."""
    return float(scipy.stats.f.ppf(0.95, 2.0, 2.0 * max(freedom, 1.0)) / BAND**2)


def _messages(
    response: FrequencyResponse,
    extra: Extra,
    reversals: int,
    rest: float,
    seconds: float,
    left_out: int,
    units: Units,
) -> list[Message]:
    """Messages on the response and the motion of its records."""
    messages, carriage = list[Message](), units.word("carriage")
    if has_wrong_sign(response):
        text = (
            f"the command has the wrong sign: at {response.frequency[0]:.3g} Hz the phase of the response is "
            f"{response.phase_deg[0]:.0f} deg, expected between -90 (a {units.word('mass')}) and 0 (a friction)"
        )
        messages.append(wrong("wrong-sign", text, phase_deg=float(response.phase_deg[0])))
    if reversals > extra.passes or rest > RESTING:
        text = (
            f"the {carriage} reverses {reversals} times in {seconds:.3g} s and is at rest {100 * rest:.2g} % of the "
            f"time: dry friction biases the response, mostly at low frequencies, and the standard deviations do not "
            f"include this bias; excite the {carriage} while it moves steadily"
        )
        messages.append(warning("dry-friction-biases", text, reversals=reversals, rest=rest))
    if extra.scatter > 2.0:
        text = (
            f"the passes differ {np.sqrt(extra.scatter):.2g} times as much as noise explains, and the standard "
            "deviations are increased by this factor: the plant depends on position, direction or time"
        )
        messages.append(warning("passes-differ", text, scatter=extra.scatter))
    if extra.steps > REPEATED:
        text = (
            f"the quantisation error repeats with the excitation, {extra.steps:.2g} times as much as by chance, and "
            f"the standard deviations are increased for it: in each period the {carriage} moves by whole encoder "
            "steps, or a simple fraction of one; use a slightly different speed"
        )
        messages.append(warning("encoder-steps-repeat", text, steps=extra.steps))
    if extra.distortion is not None:
        messages += extra.distortion.warnings
    if left_out:
        text = f"{left_out} lines left out: outside the band, or the answer is not above the noise"
        messages.append(note("lines-left-out", text, count=left_out))
    return messages
