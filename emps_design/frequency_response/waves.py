"""Excitation signals of an experiment: a random-phase multi-sine with all lines at once, or a stepped sine.

A multi-sine has odd lines only, one of every four left out, which separates noise, even and odd distortion; lines are
at least a hundredth of their frequency apart. Of several random draws of the phases the one with the smallest peak is
taken. A stepped sine puts all of the amplitude into one line at a time, in steps of whole periods with pauses between
them. Both are faded in and out, and the loop settles during the first period, or block.
Source: R. Pintelon and J. Schoukens, System Identification: A Frequency Domain Approach, 2nd ed., chapter 5.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Protocol

import numpy as np

from emps_design.errors import InputError
from emps_design.request import HERTZ, Request, option

PLACES = ("command", "reference")  # where an excitation is added

DRAWS = 100
GROUP = 4  # one line of each group of this size is left out
CLOSEST = 0.01  # least relative distance of neighbouring lines
LEAST = 2  # periods of a multi-sine on a pass, besides the one in which the loop settles
BLOCKS = 4  # of a step, besides the one in which the loop settles
PAUSE = 32  # samples between two steps


@dataclass(frozen=True)
class ExcitationRequest(Request):
    """Speed of the passes of a carriage, and the excitation added to them."""

    speed: float = option(..., "largest speed of the passes [m/s]; the excitation may reach 80 % of it")
    low: float = option(2.0, "lowest frequency [Hz]", flags=("--from",), **HERTZ)
    high: float | None = option(None, "highest frequency [Hz]; by default 0.8 of Nyquist", flags=("--to",), **HERTZ)
    resolution: float = option(0.5, "fundamental of a multi-sine [Hz]; each step lasts one period of it", **HERTZ)
    passes: int = option(4, "number of passes, to and fro; repetitions of each step", limits=(1, 1000))
    slope: float = option(0.5, "the command decreases with this power of the frequency", limits=(0.0, 3.0))
    at: str = option(PLACES[0], "command: added to the controller's output; or reference", choices=PLACES)
    noise: float | None = option(
        None, "expected white force noise [N rms]; by default 2 % of the Coulomb friction", limits=(0.0, None)
    )
    seed: int = option(0, "seed of lines and phases of a multi-sine", limits=(0, None))
    steps: int | None = option(None, "lines of a stepped sine, instead of a multi-sine", limits=(None, 2000))

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.steps is not None:
            self.refuse(["seed"], "cannot be combined with `steps`; a stepped sine has no random part")


class Wave(Protocol):
    """An excitation with m lines, for complex amplitudes (m,); ``label`` is its name."""

    label: str

    @property
    def cycles(self) -> np.ndarray:
        """The lines (m,) [periods per sample]."""

    @property
    def blocks(self) -> np.ndarray:
        """Samples after which the lines repeat, (1,) or (m,)."""

    @property
    def shortest(self) -> int:
        """Samples that a pass has to have."""

    def length(self, flat: int, times: int) -> int:
        """Samples of all passes of up to ``flat`` samples together, ``times`` as for :meth:`trains`."""

    def phased(self, added: np.ndarray, command: np.ndarray) -> np.ndarray:
        """``added`` (m,) with phases for which the peak of ``added * command`` is small."""

    def peak(self, amplitudes: np.ndarray) -> float:
        """The largest value that is reached."""

    def trains(self, amplitudes: np.ndarray, flat: int, times: int) -> tuple[list[np.ndarray], np.ndarray | int]:
        """The signal of each pass of up to ``flat`` samples, all of one length, and the samples measured of each line.

        ``times`` is how many passes a multi-sine gets, and how often each step comes.
        """


@dataclass(frozen=True, eq=False)
class MultiSine:
    """``lines`` (m,) of a base period of ``samples``, faded in and out over ``fade`` samples."""

    lines: np.ndarray
    samples: int
    fade: int
    random: np.random.Generator = field(repr=False)
    label = "multi-sine"

    @classmethod
    def between(cls, low: float, high: float, samples: int, fade: int, random: np.random.Generator) -> MultiSine:
        """Odd lines from ``low`` to ``high`` [periods per sample], without a random one of every group."""
        chosen: list[int] = []
        line = int(np.ceil(low * samples)) | 1
        while line <= min(high * samples, samples / 2 - 1):
            chosen.append(line)
            line = max(line + 2, int(line * (1.0 + CLOSEST)) | 1)
        groups = [chosen[i : i + GROUP] for i in range(0, len(chosen), GROUP)]
        out = {group[int(random.integers(GROUP))] for group in groups if len(group) == GROUP}
        kept = np.array([line for line in chosen if line not in out])
        if kept.size < GROUP:
            raise InputError(
                f"resolution: found {kept.size} lines in the band, expected at least {GROUP}: use a finer one"
            )
        return cls(kept, samples, fade, random)

    @property
    def cycles(self) -> np.ndarray:
        """The lines (m,) [periods per sample]."""
        return self.lines / self.samples

    @property
    def blocks(self) -> np.ndarray:
        """As in :class:`Wave`."""
        return np.array([self.samples])

    @property
    def shortest(self) -> int:
        """Samples that a pass has to have."""
        return (LEAST + 1) * self.samples + self.fade

    def length(self, flat: int, times: int) -> int:
        """As in :class:`Wave`."""
        return times * flat

    def phased(self, added: np.ndarray, command: np.ndarray) -> np.ndarray:
        """As in :class:`Wave`."""
        phases = np.exp(2j * np.pi * self.random.random((DRAWS, self.lines.size)))
        crest = [self.peak(draw * added * command) for draw in phases]  # one draw at a time, to save memory
        return phases[int(np.argmin(crest))] * added

    def peak(self, amplitudes: np.ndarray) -> float:
        """As in :class:`Wave`."""
        return float(np.max(np.abs(self._period(amplitudes))))

    def trains(self, amplitudes: np.ndarray, flat: int, times: int) -> tuple[list[np.ndarray], np.ndarray | int]:
        """As in :class:`Wave`."""
        periods, period = self.periods(flat), self._period(amplitudes)
        wave = np.concatenate([np.tile(period, periods + 1), period[: self.fade]])
        return [_faded(wave, self.fade)] * times, periods * self.samples * times

    def periods(self, flat: int) -> int:
        """Periods measured on a pass of ``flat`` samples."""
        return (flat - self.fade) // self.samples - 1

    def _period(self, amplitudes: np.ndarray) -> np.ndarray:
        """One period (..., samples) of sines with complex ``amplitudes`` (..., m) at the lines."""
        spectrum = np.zeros((*amplitudes.shape[:-1], self.samples // 2 + 1), complex)
        spectrum[..., self.lines] = 0.5 * self.samples * amplitudes
        return np.fft.irfft(spectrum, self.samples, axis=-1)


@dataclass(frozen=True, eq=False)
class SteppedSine:
    """Steps of ``turns`` (m,) periods in blocks of ``samples`` (m,), both integers."""

    turns: np.ndarray
    samples: np.ndarray
    label = "stepped sine"

    @classmethod
    def between(cls, low: float, high: float, count: int, samples: int) -> SteppedSine:
        """``count`` logarithmically spaced lines from ``low`` to ``high`` [periods per sample], in steps of about
        ``samples``, or longer where a block would be shorter than a period."""
        wanted = np.geomspace(low, high, count)
        turns = np.maximum(1, np.floor(wanted * samples / BLOCKS))
        blocks = np.round(turns / wanted)
        # Duplicate lines are dropped.
        lines = np.unique(turns / blocks, return_index=True)[1]
        return cls(turns[lines].astype(int), blocks[lines].astype(int))

    @property
    def cycles(self) -> np.ndarray:
        """The lines (m,) [periods per sample]."""
        return self.turns / self.samples

    @property
    def blocks(self) -> np.ndarray:
        """As in :class:`Wave`."""
        return self.samples

    @cached_property
    def _lengths(self) -> np.ndarray:
        """Samples (m,) of each step with its pause, faded in and out over half a block each."""
        return (BLOCKS + 1) * self.samples + 2 * (self.samples // 2) + PAUSE

    @property
    def shortest(self) -> int:
        """Samples that a pass has to have."""
        return int(np.max(self._lengths))

    def length(self, flat: int, times: int) -> int:
        """As in :class:`Wave`."""
        return times * int(np.sum(self._lengths))

    def phased(self, added: np.ndarray, command: np.ndarray) -> np.ndarray:
        """As in :class:`Wave`."""
        return added.astype(complex)

    def peak(self, amplitudes: np.ndarray) -> float:
        """As in :class:`Wave`."""
        return float(np.max(np.abs(amplitudes)))

    def trains(self, amplitudes: np.ndarray, flat: int, times: int) -> tuple[list[np.ndarray], np.ndarray | int]:
        """As in :class:`Wave`."""
        passes: list[list[np.ndarray]] = [[]]
        filled = 0
        for turn in range(times):  # alternately up and down, so that each line is measured in both directions
            for i in range(self.turns.size) if turn % 2 == 0 else reversed(range(self.turns.size)):
                length = int(self._lengths[i])
                if filled + length > flat:
                    passes.append([])
                    filled = 0
                k = np.arange(length - PAUSE)
                sine = np.real(amplitudes[i] * np.exp(2j * np.pi * self.cycles[i] * k))
                passes[-1] += [_faded(sine, int(self.samples[i]) // 2), np.zeros(PAUSE)]
                filled += length
        waves = [np.concatenate(parts) for parts in passes]
        longest = max(wave.size for wave in waves)
        return [np.pad(wave, (0, longest - wave.size)) for wave in waves], BLOCKS * self.samples * times


def _faded(wave: np.ndarray, fade: int) -> np.ndarray:
    """The ``wave`` (n,), faded in over its first ``fade`` samples and out over its last."""
    rise = 0.5 - 0.5 * np.cos(np.pi * (np.arange(fade) + 0.5) / fade)
    faded = wave.copy()
    faded[:fade] *= rise
    faded[wave.size - fade :] *= rise[::-1]
    return faded
