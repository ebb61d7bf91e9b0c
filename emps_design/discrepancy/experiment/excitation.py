"""Excitations that bring out what a record did not show, inside what the machine has been seen to do.

Every excitation is a reference ``q_ref`` (n,) [m] at the record's period that begins and ends at rest where the record
began, lasts ten to thirty seconds on an ordinary axis, and stays within the positions, speeds, accelerations and jerks
of the record. The order of its strokes leaves some of every kind to fit and some to select (every third one).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from emps_design.records import Record
from emps_design.simulation.synthetic import point_to_point

MARGIN = 0.9  # of the record's top speed and acceleration
EDGE = 0.02  # of its travel, left free at both ends
SHORTEST, LONGEST = 10.0, 25.0  # s: cycles are repeated to the one, none is begun beyond the other
BAND_HZ = 60.0  # in which the measured acceleration counts
SWEEP_HZ = (2.0, 100.0)  # of the chirp
LEAST_FOLLOWED = 0.02  # of a chirp: the reference never asks for more than fifty times what it wants

Move = tuple[float, float, float, float]  # target [m], share of the speed, of the acceleration, pause after it [s]


@dataclass(frozen=True)
class Envelope:
    """What an excitation may use: positions ``low`` to ``high`` [m], ``speed`` [m/s], ``acceleration`` [m/s^2],
    ``jerk`` [m/s^3]; it starts from rest at ``home`` [m] and is sampled every ``period`` [s].

    ``follows`` (n,) -> (n,) is the gain from reference to position at angular frequencies [rad/s]. What a loop does not
    follow may be asked for in proportion: the limits are those of the machine, not of its reference.
    """

    period: float
    home: float
    low: float
    high: float
    speed: float
    acceleration: float
    jerk: float
    follows: Callable[[np.ndarray], np.ndarray] = np.ones_like

    @classmethod
    def of(cls, records: Iterable[Record]) -> Envelope:
        """The envelope of what ``records`` show, with a margin.

        Speed and acceleration are the smaller of what was asked for and what was measured below 60 Hz: a reference
        that jumps asks for more than any machine does.
        """
        from emps_design.identification.filters import motion

        records = tuple(records)
        period = records[0].period
        asked = [np.diff(r.q_ref) / period for r in records]
        moved = [motion(r, BAND_HZ) for r in records]
        low, high = min(float(r.q.min()) for r in records), max(float(r.q.max()) for r in records)
        return cls(
            period=period,
            home=float(records[0].q_ref[0]),
            low=low + EDGE * (high - low),
            high=high - EDGE * (high - low),
            speed=MARGIN * min(_top(asked), _top(m.v for m in moved)),
            acceleration=MARGIN * min(_top(np.diff(v) / period for v in asked), _top(m.a for m in moved)),
            jerk=MARGIN * _top(np.diff(v, 2) / period**2 for v in asked),
        )

    @property
    def travel(self) -> float:
        """Distance [m] between the ends."""
        return self.high - self.low

    @property
    def far(self) -> float:
        """Position [m] of the far end of a stroke from ``low`` that takes no longer than 2.5 s or so."""
        return self.low + min(self.travel, 2.5 * self.speed)

    @property
    def middle(self) -> float:
        """Position [m] half-way to the far end."""
        return 0.5 * (self.low + self.far)

    def at(self, share: float) -> float:
        """Position [m] at this ``share`` of the travel."""
        return self.low + share * self.travel

    def trace(self, cycle: list[Move]) -> np.ndarray:
        """Position (n,) [m] of the moves of ``cycle``, repeated to ten seconds at least, then home.

        Steps of acceleration are spread until they jerk no more than the record did.
        """
        parts, here, n = [np.full(self.samples(0.2), self.home)], self.home, 0
        while n * self.period < SHORTEST:
            for target, speed, acceleration, pause in cycle:
                if n * self.period > LONGEST:
                    break
                parts += self._move(here, target, speed, acceleration, pause)
                here, n = target, n + parts[-2].size + parts[-1].size
        away = np.concatenate(parts + self._move(here, self.home, 0.5, 0.5, 0.3)) - self.home
        width = max(1, int(np.ceil(2 * self.acceleration / (self.jerk * self.period))))
        return self.home + np.convolve(away, np.full(width, 1 / width))

    def _move(self, here: float, target: float, speed: float, acceleration: float, pause: float) -> list[np.ndarray]:
        rest = np.full(self.samples(pause), target)
        if target == here:
            return [np.empty(0), rest]
        way = point_to_point(self.period, abs(target - here), speed * self.speed, acceleration * self.acceleration)
        return [here + np.sign(target - here) * way, rest]

    def samples(self, seconds: float) -> int:
        """Number of samples in ``seconds``, two at least."""
        return max(2, round(seconds / self.period))


def slow_crawl(e: Envelope) -> np.ndarray:
    """Crawl from rest, both ways, at 0.5 to 5 % of the top speed."""
    moves: list[Move] = [(e.middle, 0.5, 1.0, 0.3)]
    for share in (0.005, 0.01, 0.02, 0.05):
        there = e.middle + min(1.5 * share * e.speed, e.far - e.middle)
        moves += [(there, share, 1.0, 0.3), (e.middle, share, 1.0, 0.3)]
    return e.trace(moves)


def speed_staircase(e: Envelope) -> np.ndarray:
    """Run both ways at eight constant speeds, from 5 % of the top speed to all of it."""
    moves: list[Move] = []
    for share in (0.05, 0.1, 0.2, 0.35, 0.5, 0.65, 0.8, 1.0):
        ramps = (share * e.speed) ** 2 / e.acceleration
        there = e.low + min(0.8 * share * e.speed + ramps, e.travel)
        moves += [(there, share, 1.0, 0.1), (e.low, share, 1.0, 0.1)]
    return e.trace(moves)


def two_speeds(e: Envelope) -> np.ndarray:
    """Run strokes forth and back at two constant speeds, one three times the other."""
    there = e.low + min(e.speed, e.travel)
    fast = min(1.0, e.travel / e.speed)
    return e.trace([(end, share, 1.0, 0.2) for share in (fast / 3, fast) for end in (there, e.low)])


def three_accelerations(e: Envelope) -> np.ndarray:
    """Repeat one stroke at full, half and a quarter of the top acceleration."""
    ends = 3 * (e.far, e.low)
    return e.trace([(end, 1.0, share, 0.2) for end, share in zip(ends, (1.0, 0.25, 0.5, 0.5, 0.25, 1.0), strict=True)])


def fast_strokes(e: Envelope) -> np.ndarray:
    """Stroke without a pause at the top speed and acceleration, over three distances."""
    shares = (1.0, 0.0, 0.5, 0.0, 1.0, 0.0, 0.2, 0.0)
    return e.trace([(e.low + share * (e.far - e.low), 1.0, 1.0, 0.0) for share in shares])


def small_reversals(e: Envelope) -> np.ndarray:
    """Reverse about one place with amplitudes that grow from 0.01 to 3 % of the travel."""
    moves: list[Move] = [(e.middle, 0.5, 1.0, 0.3)]
    for amplitude in e.travel * np.geomspace(1e-4, 0.03, 10):
        share = min(amplitude / 0.25 / e.speed, 1.0)
        moves += 2 * [(e.middle + amplitude, share, 1.0, 0.05), (e.middle, share, 1.0, 0.05)]
    return e.trace(moves)


def small_strokes(e: Envelope) -> np.ndarray:
    """Make three short strokes at each of five places along the travel."""
    moves: list[Move] = []
    for place in (0.0, 0.245, 0.49, 0.735, 0.98):
        moves += [(e.at(place), 0.5, 1.0, 0.1)] + 3 * [(e.at(place + 0.02), 0.1, 1.0, 0.05), (e.at(place), 0.1, 1.0, 0)]
    return e.trace(moves)


def stop_and_dwell(e: Envelope) -> np.ndarray:
    """Stop at three places along the travel, coming from both sides, and rest there for 1.5 s."""
    moves: list[Move] = []
    for place in (0.25, 0.5, 0.75):
        moves += [(e.at(place), 0.5, 1.0, 1.5), (e.at(place + 0.25), 0.5, 1.0, 0.1), (e.at(place), 0.5, 1.0, 1.5)]
    return e.trace([*moves, (e.low, 0.5, 1.0, 0.1)])


def identical_laps(e: Envelope) -> np.ndarray:
    """Repeat one lap, forth at full and back at half the top speed, again and again."""
    lap = [(e.far, 1.0, 1.0, 0.1), (e.low, 0.5, 1.0, 0.1)]
    return e.trace(lap * max(1, round(LONGEST * e.speed / (3.5 * (e.far - e.low)))))


def chirp_on_a_slow_run(e: Envelope) -> np.ndarray:
    """Run slowly forth and back with a small chirp on top, from 2 to 100 Hz and back in every stroke."""
    stroke = e.far - e.low
    # A stroke takes 3 s at least, so that the chirp has room, and not much more than 4.
    slow = min(max(0.2, stroke / (4.0 * e.speed)), stroke / (3.0 * e.speed), 0.6)
    base = e.trace(2 * [(e.far, slow, 0.4, 0.1), (e.low, slow, 0.4, 0.1)])
    turning = np.abs(np.gradient(base, e.period)) < 0.99 * slow * e.speed
    width = e.samples(0.2)
    fade = np.convolve(turning, np.ones(3 * width), mode="same") < 0.5
    for _ in range(3):  # in and out inside the runs at constant speed, without a step of jerk
        fade = np.convolve(fade, np.full(width, 1 / width), mode="same")
    first, last = SWEEP_HZ[0], min(SWEEP_HZ[1], 0.2 / e.period)
    up_and_down = 0.5 - 0.5 * np.cos(2 * np.pi * (base - e.low) / stroke)
    omega = 2 * np.pi * first * (last / first) ** up_and_down
    # Smoothly the least of what speed (the run must not reverse), acceleration and jerk leave room for.
    half = 0.5 * e.acceleration
    room = half / (1 + half / (0.35 * slow * e.speed * omega) + half * omega / e.jerk)
    amplitude = room / omega**2 / np.maximum(e.follows(omega), LEAST_FOLLOWED)
    return base + fade * amplitude * np.sin(np.cumsum(omega) * e.period)


EXCITATIONS: tuple[Callable[[Envelope], np.ndarray], ...] = (
    slow_crawl, speed_staircase, two_speeds, three_accelerations, fast_strokes,
    small_reversals, small_strokes, stop_and_dwell, identical_laps, chirp_on_a_slow_run,
)  # fmt: skip


def excitations(envelope: Envelope) -> dict[str, np.ndarray]:
    """Every excitation by name: ``q_ref`` (n,) [m] inside ``envelope``.

    >>> from emps_design.machines import machine
    >>> from emps_design.simulation.synthetic import synthetic_record
    >>> envelope = Envelope.of([synthetic_record(machine("emps2019"), laps=1)])
    >>> crawl = excitations(envelope)["slow_crawl"]
    >>> bool(np.abs(np.diff(crawl)).max() <= envelope.speed * envelope.period), crawl.size * envelope.period > 10
    (True, True)
    """
    return {excitation.__name__: excitation(envelope) for excitation in EXCITATIONS}


def instruction(name: str) -> str:
    """What the excitation called ``name`` does, as an instruction.

    >>> instruction("slow_crawl")
    'crawl from rest, both ways, at 0.5 to 5 % of the top speed'
    """
    text = next(excitation.__doc__ or name for excitation in EXCITATIONS if excitation.__name__ == name)
    return text[0].lower() + text[1:].rstrip(".")


def _top(signals: Iterable[np.ndarray]) -> float:
    return max(float(np.abs(signal).max()) for signal in signals)
