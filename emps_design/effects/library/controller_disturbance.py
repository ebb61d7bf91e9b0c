"""Controller disturbance: a square wave of voltage, 0 and ``amplitude``, is added to the controller's output.

It is high from ``start`` on for the share ``duty`` of every period 1/frequency, also before the first sample. Causes
are a test signal that was not switched off (the 1 Hz wave of DATA_EMPS_PULSES), or a fault in the output stage ahead of
the recording. The recorded voltage contains it, so only the controller's law shows it; the force balance does not.
"""

from math import floor

import numpy as np

from emps_design.effects.effect import SNAP, Effect, Motion, Parameter, Search, Words

PARAMETERS = (
    Parameter("amplitude", "A", "V", scale=1.0, text="voltage added during a pulse"),
    Parameter("frequency", "f", "Hz", 1e-3, 500.0, starts=(0.5, 1.0, 2.0), text="pulses per second"),
    Parameter("duty", "d", "", 0.0, 1.0, starts=(0.5,), text="share of the period that is high"),
    Parameter("start", "t_0", "s", lower=0.0, per_record=True, scale=0.1,
              text="first rising edge in the record"),
)  # fmt: skip


def command(q, v, t, tau, x, p, b):
    turns = (t - p[3] + SNAP) * p[1]
    if turns - floor(turns) < p[2]:
        return p[0]
    return 0.0


def propose(motion: Motion, residual: np.ndarray, b: np.ndarray, away: np.ndarray) -> list[dict[str, float]]:
    """Levels and edges of the square wave in ``residual``, which for this effect is u minus the law [V]."""
    low, high = np.quantile(residual, (0.05, 0.95))
    if abs(low) > abs(high):
        low, high = high, low
    up = (residual - low) / (high - low) > 0.5 if high != low else np.zeros(residual.size, bool)
    steps = np.diff(up.astype(int))
    rises, falls = np.nonzero(steps == 1)[0] + 1, np.nonzero(steps == -1)[0] + 1
    # The first samples of a record are set to zero, so a wave that is high there has an apparent rising edge.
    if rises.size > 2 and abs(np.diff(rises)[0] - np.median(np.diff(rises))) > 2:
        rises = rises[1:]
    if rises.size == 0 or falls.size == 0:
        return []
    amplitude = float(np.median(residual[up]) - np.median(residual[~up]))
    if rises.size > 1:
        every, start = _equidistant(motion.t[rises], motion.period)
        # A falling edge belongs to the rising edge before it; the wave may be high at the first sample.
        high_time = (_equidistant(motion.t[falls], motion.period, every)[1] - start) % every
    else:
        start, last = float(motion.t[rises[0]]), residual.size * motion.period
        every = 2 * last
        high_time = float(motion.t[falls[falls > rises[0]][0]]) - start if falls[-1] > rises[0] else last - start
    return [{"amplitude": amplitude, "frequency": 1 / every, "duty": high_time / every, "start": max(start, 0.0)}]


def _equidistant(edges: np.ndarray, period: float, every: float | None = None) -> tuple[float, float]:
    """Interval and start [s] of equidistant instants; each of ``edges`` (k,) [s] is at most one ``period`` later."""
    number = np.arange(edges.size)
    if every is None:
        middle = float(np.polyfit(number, edges, 1)[0])
        intervals = middle + np.linspace(-1.0, 1.0, 401) * period / max(edges.size - 1, 1)
    else:
        intervals = np.array([every])
    offsets = edges - number * intervals[:, None]
    latest, earliest = offsets.min(axis=1), offsets.max(axis=1) - period
    best = int(np.argmax(latest - earliest))
    return float(intervals[best]), float(0.5 * (latest[best] + earliest[best]))


def expression(q, v, t, tau, p, b):
    import sympy

    turns = (t - p["start"]) * p["frequency"]
    return p["amplitude"] * sympy.Piecewise((1, sympy.Mod(turns, 1) < p["duty"]), (0, True))


EFFECT = Effect(
    name="controller_disturbance",
    label="Controller disturbance",
    channel="controller",
    equation=r"u = u_{law} + A \;\text{ for } (t - t_0) f \bmod 1 < d",
    source="the pulses of the EMPS validation record, A. Janot, M. Gautier, M. Brunot, 2019",
    parameters=PARAMETERS,
    command=command,
    over="t",
    expression=expression,
    search=Search(propose=propose, confused_with=("external_force", "periodic_disturbance")),
    words=Words(
        where="u minus the controller's law jumps between two levels; the force balance does not change",
        experiment="compute the law from the recorded reference and position and subtract it from the recorded voltage",
        remedy="switch the injected signal off, or repair the output stage",
    ),
    checks=(
        ({"amplitude": 5.0, "frequency": 1.0, "duty": 0.5, "start": 0.344}, {"t": 3.4}, 5.0),
        ({"amplitude": 5.0, "frequency": 1.0, "duty": 0.5, "start": 0.344}, {"t": 0.2}, 0.0),
    ),
)
