"""Pictures of the velocity loop: Bode, Nyquist, poles and step response, from its loops on one frequency grid.

Functions that end in ``axes`` or ``plane`` describe what page and studio both draw.

A measured frequency response: Bode picture with its 95 % band and the model beside it, and the section on it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from emps_design.control.sampled import MARGINAL
from emps_design.figures import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    PALE_BLUE,
    RED,
    TURN,
    Area,
    Axes,
    Band,
    Curve,
    Grid,
    Level,
    Range,
    Remark,
)
from emps_design.frequency_response.coupling import ResponseComparison
from emps_design.frequency_response.response import BAND, resonances
from emps_design.report.page import Line, Picture, Section, angle, delay, number, quantity, ratio
from emps_design.report.style import drawn

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from emps_design.control.margins import Margins
    from emps_design.control.velocity.design import VelocityLoopDesign
    from emps_design.control.verdict import StepResponse

COLOURS = (RED, GREEN)
FREQUENCY, GAIN, PHASE = "frequency [rad/s]", "magnitude [dB]", "phase [deg]"
DECIBEL = Level("y", 0.0, BLACK, "--", 0.9, "0 dB")
HALF_TURN = Level("y", -180.0, BLACK, "--", 0.9, "−180°")


@dataclass(frozen=True)
class LoopCurve:
    """One open loop: its label and colour, frequencies ``w`` [rad/s], complex response ``L``, and its margins."""

    label: str
    color: str
    w: np.ndarray
    L: np.ndarray
    margins: Margins
    response: Callable[[np.ndarray], np.ndarray]

    @property
    def magnitude_db(self) -> np.ndarray:
        """Magnitude [dB]."""
        return 20.0 * np.log10(np.abs(self.L))

    @property
    def phase_deg(self) -> np.ndarray:
        """Phase [deg], unwrapped from the low-frequency end, which lies within (-270, 90]."""
        phase = np.degrees(np.unwrap(np.angle(self.L)))
        return phase - 360.0 * np.ceil((phase[0] - 90.0) / 360.0)


@dataclass(frozen=True)
class BrokenLoop:
    """The loop broken at one place, continuous and sampled."""

    title: str
    continuous: LoopCurve
    sampled: LoopCurve

    @property
    def curves(self) -> tuple[LoopCurve, LoopCurve]:
        """Both loops, continuous first."""
        return self.continuous, self.sampled


def frequency_grid(design: VelocityLoopDesign, points: int = 400) -> np.ndarray:
    """Return frequencies [rad/s] (points,) from 0.02 to 30 times the crossover, or to Nyquist if that is higher."""
    nyquist = np.pi / design.axis.sampling.period
    high = max(nyquist, 30.0 * design.crossover)
    return np.geomspace(0.02 * design.crossover, high, points)


def broken_loops(design: VelocityLoopDesign, points: int = 400) -> tuple[BrokenLoop, BrokenLoop]:
    """Return the loop broken at the velocity error and at the plant input, each continuous and sampled.

    >>> from emps_design.control.velocity.design import design_velocity_loop
    >>> from emps_design.machines import machine
    >>> error, plant = broken_loops(design_velocity_loop(machine("emps2018"), 100.0, phase_margin_deg=60.0))
    >>> round(plant.sampled.margins.phase_margin_deg, 1)
    39.2
    """
    w = frequency_grid(design, points)
    nyquist = np.pi / design.axis.sampling.period
    # At Nyquist itself the response is real and its phase jumps: the curve stops just below.
    below = np.append(w[w < 0.998 * nyquist], 0.998 * nyquist)
    error, plant = design.velocity_error_loop(), design.plant_input_loop()

    def curve(label: str, color: str, grid: np.ndarray, response: Callable, margins: Margins) -> LoopCurve:
        return LoopCurve(label, color, grid, response(grid), margins, response)

    sampled = design.sampled
    return (
        BrokenLoop(
            "broken at the velocity error",
            curve("continuous", BLUE, w, lambda omega: error(1j * np.asarray(omega)), design.velocity_error),
            curve("sampled", RED, below, sampled.velocity_error_response, sampled.velocity_error),
        ),
        BrokenLoop(
            "broken at the plant input",
            curve("continuous", BLUE, w, lambda omega: plant(1j * np.asarray(omega)), design.plant_input),
            curve("sampled", RED, below, sampled.plant_input_response, sampled.margins),
        ),
    )


def bode_axes(loop: BrokenLoop, period: float) -> tuple[Axes, Axes]:
    """Magnitude and phase of one broken loop, continuous and sampled, with crossover, margins and Nyquist."""
    nyquist = np.pi / period
    gains: list[Any] = [Curve(c.w, c.magnitude_db, c.label, c.color, detail=_in_words(c.margins)) for c in loop.curves]
    phases: list[Any] = [Curve(c.w, c.phase_deg, c.label, c.color) for c in loop.curves]
    for curve in loop.curves:
        m, color = curve.margins, curve.color
        if m.crossover is not None and m.phase_margin_deg is not None:
            w, phase = m.crossover, -180.0 + m.phase_margin_deg
            middle, side = -180.0 + 0.5 * m.phase_margin_deg, 6.0 if curve.label == "sampled" else -6.0
            gains.append(_mark(w, 0.0, color))
            phases += [_bar(w, -180.0, phase, color), _mark(w, phase, color)]
            phases.append(Remark(w, middle, angle(m.phase_margin_deg), color, side, size=9.0))
        if m.gain_margin is not None and m.gain_margin_frequency is not None:
            w = m.gain_margin_frequency
            gains.append(_bar(w, -20.0 * np.log10(m.gain_margin), 0.0, color))
            phases.append(_mark(w, -180.0, color, "s", 4.5))
    gains += [DECIBEL, Level("x", nyquist, GREEN, "--", 1.1, f"Nyquist {number(nyquist)} rad/s")]
    phases += [HALF_TURN, Level("x", nyquist, GREEN, "--", 1.1)]
    continuous, sampled = loop.curves
    ends = float(continuous.w[0]), float(max(continuous.w[-1], nyquist) * 1.45)
    floor = min(np.min(sampled.magnitude_db[sampled.w < 0.98 * nyquist]), np.min(continuous.magnitude_db))
    both = np.concatenate([continuous.phase_deg, sampled.phase_deg])
    lowest = max(float(both.min()), -420.0)
    turns = 45.0 * np.floor((lowest - 10.0) / 45.0), max(-45.0, 45.0 * np.ceil((both.max() + 5.0) / 45.0))
    levels = max(floor, -70.0) - 4.0, float(np.max(continuous.magnitude_db)) + 6.0
    return (
        Axes(tuple(gains), "", GAIN, log="x", x_range=ends, y_range=levels, hertz=True),
        Axes(
            tuple(phases), FREQUENCY, PHASE, log="x", x_range=ends, y_range=turns, ticks=45.0 if lowest > -300 else 90.0
        ),
    )


def _mark(x: float, y: float, color: str, mark: str = "o", size: float = 5.0) -> Curve:
    return Curve([x], [y], color=color, line="", mark=mark, size=size)


def _bar(x: float, low: float, high: float, color: str) -> Curve:
    return Curve([x, x], [low, high], color=color, width=2.6, alpha=0.6)


def _in_words(m: Margins) -> str:
    if not m.stable:
        return "unstable, no margins"
    words = [f"{angle(m.phase_margin_deg)} at {number(m.crossover)} rad/s"]
    words.append(f"gain margin {ratio(m.gain_margin)}" if m.gain_margin else "gain margin unbounded")
    words.append(f"delay margin {delay(m.delay_margin, m.period)}")
    return "\n    ".join(words)


def parts_axes(design: VelocityLoopDesign) -> tuple[Axes, Axes]:
    """Bode diagram of the sampled plant, of the controller with its filters, and of the loop of both."""
    loop = design.sampled
    nyquist = np.pi / loop.plant.period
    w = loop.plant.frequencies(600)
    w = w[(w > 0.02 * design.crossover) & (w < 0.998 * nyquist)]
    whole = loop.plant_input_response(w)
    controller = loop.controller_response(w) * loop.plant.filter_response(w)
    names = f"controller, {design.structure.form.upper()}" + (" with filters" if loop.plant.filters else "")
    parts = (("plant", GREEN, whole / controller), (names, GREY, controller), ("loop", RED, whole))
    gains = [Curve(w, 20.0 * np.log10(np.abs(response)), label, color) for label, color, response in parts]
    phases = [Curve(w, np.degrees(np.unwrap(np.angle(response))), label, color) for label, color, response in parts]
    edge = Level("x", nyquist, GREEN, "--", 1.1)
    return (
        Axes((*gains, DECIBEL, edge), "", GAIN, log="x", hertz=True),
        Axes((*phases, HALF_TURN, edge), FREQUENCY, PHASE, log="x"),
    )


def nyquist_axes(loop: BrokenLoop) -> Axes:
    """The Nyquist curves of a broken loop with the rays to their crossovers, the unit circle and -1."""
    parts = []
    for curve in loop.curves:
        parts.append(Curve(curve.L.real, curve.L.imag, curve.label, curve.color))
        if curve.margins.stable and curve.margins.crossover is not None:
            at = complex(curve.response(np.array([curve.margins.crossover]))[0])
            ray = Curve([0.0, at.real], [0.0, at.imag], color=curve.color, width=0.8)
            parts += [ray, _mark(at.real, at.imag, curve.color)]
    return open_loop_plane(tuple(parts), (-2.6, 1.3), (-2.6, 1.3), loop.title, "lower right")


def open_loop_plane(parts: tuple[Curve, ...], real: Range, imaginary: Range, title: str, legend: str = "") -> Axes:
    """``parts`` in the Nyquist plane, with the unit circle and the point -1."""
    around = (
        Curve(np.cos(TURN), np.sin(TURN), color=GREY, line="--", width=0.9),
        Curve([-1.0], [0.0], color=BLACK, line="", mark="P", size=9.0),
        Remark(-1.0, 0.0, "−1", BLACK, -6.0, 10.0, 10.0),
    )
    return _plane((*parts, *around), real, imaginary, title, legend=legend)


def _plane(parts: tuple[Any, ...], real: Range, imaginary: Range, title: str, unit: str = "", legend: str = "") -> Axes:
    """``parts`` in a complex plane with its zero lines."""
    zero = Level("x", 0.0), Level("y", 0.0)
    labels = f"real part{unit}", f"imaginary part{unit}"
    return Axes((*zero, *parts), *labels, title, x_range=real, y_range=imaginary, legend=legend, square=True)


def z_plane(poles: np.ndarray, title: str) -> Axes:
    """Sampled ``poles`` and the unit circle, those outside it in red."""
    inside, circle = np.abs(poles) <= 1.0 + MARGINAL, (np.cos(TURN), np.sin(TURN))
    good, bad = poles[inside], poles[~inside]
    parts: list[Any] = [Area(*circle, PALE_BLUE), Curve(*circle, color=BLACK, width=1.0)]
    parts.append(Curve(good.real, good.imag, color=BLUE, line="", mark="x", size=9.0))
    if bad.size:
        parts.append(Curve(bad.real, bad.imag, "outside: unstable", RED, line="", mark="X", size=10.0))
    limit = max(1.15, 1.1 * float(np.max(np.abs(poles))))
    return _plane(tuple(parts), (-limit, limit), (-limit, limit), title, legend="lower left" if bad.size else "")


def s_plane(poles: np.ndarray, title: str) -> Axes:
    """Continuous ``poles`` [rad/s] with lines of constant damping ratio, the unstable half shaded."""
    reach = 1.25 * float(np.max(np.abs(poles)))
    parts: list[Any] = [Band("x", 0.0, 0.35 * reach, RED, 0.08)]
    for z in (0.3, 0.5, 0.7, 0.9):
        x, y = -z * reach, np.sqrt(1.0 - z * z) * reach
        parts.append(Curve([x, 0.0, x], [y, 0.0, -y], color="#D1D5DB", width=0.8))
        parts.append(Remark(x, y, f"z = {z:g}", GREY, -1.0, 4.0, 7.5))
    parts.append(Curve(poles.real, poles.imag, color=BLUE, line="", mark="x", size=9.0))
    return _plane(tuple(parts), (-1.15 * reach, 0.35 * reach), (-1.1 * reach, 1.1 * reach), title, " [rad/s]")


def step_axes(continuous: StepResponse, sampled: StepResponse | None) -> Axes:
    """The response to a unit step of the velocity reference; ``sampled`` is None if that loop is unstable."""
    parts: list[Any] = [Band("y", 0.98, 1.02, label="±2 %"), Level("y", 1.0)]
    parts.append(Curve(1e3 * continuous.t, continuous.y, "continuous", BLUE, detail=_step_in_words(continuous)))
    if sampled is not None:
        words = _step_in_words(sampled)
        parts.append(Curve(1e3 * sampled.t, sampled.y, "sampled", RED, width=1.2, mark="o", size=2.4, detail=words))
    for step, color in ((continuous, BLUE), (sampled, RED)):
        if step is not None and step.overshoot_percent > 0.05:
            parts.append(_mark(1e3 * step.peak_time, step.peak, color, "^", 6.0))
        if step is not None and step.settling_time is not None:
            parts.append(Level("x", 1e3 * step.settling_time, color, ":", 0.9))
    return Axes(
        tuple(parts),
        "time [ms]",
        "velocity / reference",
        x_range=(0.0, 1e3 * float(continuous.t[-1])),
        y_range=(0.0, None),
        legend="lower right",
        remark="" if sampled else "the sampled loop is unstable: it has no step response",
    )


def _step_in_words(step: StepResponse) -> str:
    settling = "not within the window" if step.settling_time is None else quantity(step.settling_time, "s", 3)
    rise = f"rise 10–90 % {quantity(step.rise_time, 's', 3)}, settling {settling}"
    return f"overshoot {step.overshoot_percent:.1f} %,\n    {rise}"


def velocity_loop_figures(design: VelocityLoopDesign) -> dict[str, Figure]:
    """Return a design's pictures: bode_velocity_error, bode_plant_input, bode_parts, nyquist, poles, step."""
    from emps_design.control.verdict import step_responses

    error, plant = broken_loops(design)
    period = design.axis.sampling.period
    poles = np.asarray(design.closed_loop().poles()), np.asarray(design.sampled.poles)
    planes = s_plane(poles[0], "continuous closed loop (9)"), z_plane(poles[1], "sampled closed loop, as implemented")
    below = {"legend": "outside lower center"}
    grids = {
        "bode_velocity_error": Grid.of(*bode_axes(error, period), height=5.8, heights=(1.1, 1.0), **below),
        "bode_plant_input": Grid.of(*bode_axes(plant, period), height=5.8, heights=(1.1, 1.0), **below),
        "bode_parts": Grid.of(*parts_axes(design), height=5.4, columns=3, **below),
        "nyquist": Grid(((nyquist_axes(error), nyquist_axes(plant)),), 4.2),
        "poles": Grid((planes,), 3.9),
        "step": Grid.of(step_axes(*step_responses(design)), height=3.4),
    }
    return {name: drawn(grid) for name, grid in grids.items()}


def response_figure(comparison: ResponseComparison, ratio: np.ndarray | None = None) -> Figure:
    """Draw magnitude and phase with the 95 % band and the models, and below them deviation and coherence.

    ``ratio`` (n,) complex is the ratio of the spectra, drawn for comparison.
    """
    response, chain = comparison.response, comparison.chain
    models = {
        f"model of {comparison.axis.name}": comparison.model,
        f"fitted, {chain.label}": chain.response(response.w),
    }
    f, std = response.frequency, response.std
    reach = BAND * std
    gain, phase = 20.0 * np.log10(response.magnitude), response.phase_deg
    low, high = (20.0 * np.log10(np.maximum(1.0 + side * reach, 0.05)) for side in (-1.0, 1.0))
    turn = np.degrees(np.arcsin(np.minimum(reach, 1.0)))

    def beside(other: np.ndarray, *look: Any) -> tuple[Curve, Curve]:
        apart = np.degrees(np.angle(other / response.response))
        return Curve(f, 20.0 * np.log10(np.abs(other)), *look), Curve(f, phase + apart, *look)

    pairs: list[tuple[Any, Any]] = []
    if ratio is not None:
        pairs.append(beside(ratio, "ratio of spectra", GREY, "", 1.6, ".", 2.5))
    pairs.append((Area.between(f, gain + low, gain + high, "95 % band"), Area.between(f, phase - turn, phase + turn)))
    pairs.append((Curve(f, gain, "measured", BLUE, width=1.2), Curve(f, phase, color=BLUE, width=1.2)))
    pairs += [
        beside(model, label, colour, "--", 1.1) for (label, model), colour in zip(models.items(), COLOURS, strict=True)
    ]
    for resonance in resonances(response):
        name, edge = f"{resonance.frequency:.4g} Hz", Level("x", resonance.frequency, GREY, ":")
        pairs.append((replace(edge, text=name), edge))
    top, middle = zip(*pairs, strict=True)
    spread = (Curve(f, std, "relative standard deviation", BLUE, width=1.2),) if np.any(std > 0.0) else ()
    rest = Curve(f, np.maximum(1.0 - response.coherence, 1e-12), "1 − coherence", GREEN, width=1.0)
    title, unit = f"{response.name}: force to velocity", "magnitude [(m/s)/N, dB]"
    grid = Grid.of(
        Axes(top, "", unit, title, log="x", legend="lower left"),
        Axes(middle, "", PHASE, log="x"),
        Axes((*spread, rest), "frequency [Hz]", log="xy", legend="best"),
        height=7.2,
        heights=(1.3, 1.0, 0.7),
    )
    return drawn(grid)


def response_section(comparison: ResponseComparison) -> Section:
    """Return the section on a measured response beside the model: picture, agreement, fitted masses, warnings."""
    warnings = (*comparison.response.warnings, *comparison.chain.warnings)
    return Section(
        f"Measured response {comparison.response.name}",
        response_picture(comparison),
        *comparison.view(),
        *(Line(warning, "note") for warning in warnings),
    )


def response_picture(comparison: ResponseComparison, ratio: np.ndarray | None = None) -> Picture:
    """Return the picture of a response beside the model; ``ratio`` as in :func:`response_figure`."""
    force = comparison.axis.units.word("force").capitalize()
    return Picture(
        response_figure(comparison, ratio),
        f"{force} to velocity of the plant, hold and delay of the drive taken out, with the 95 % band of the data.",
        "Measured frequency response",
    )
