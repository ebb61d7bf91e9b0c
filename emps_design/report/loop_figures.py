"""Pictures of the velocity loop: Bode, Nyquist, poles and step response, from its loops on one frequency grid.

A measured frequency response: Bode picture with its 95 % band and the model beside it, and the section on it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from emps_design.control.sampled import MARGINAL
from emps_design.frequency_response.coupling import ResponseComparison
from emps_design.frequency_response.response import BAND, resonances
from emps_design.report.page import Line, Picture, Section, angle, delay, number, quantity, ratio
from emps_design.report.style import BLACK, BLUE, GREEN, GREY, RED, hertz_axis, look, note, plain_subplots, subplots

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.ticker import MultipleLocator

    from emps_design.control.margins import Margins
    from emps_design.control.velocity.design import VelocityLoopDesign
    from emps_design.control.verdict import StepResponse

COLOURS = (RED, GREEN)


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


def bode_figure(loop: BrokenLoop, period: float) -> Figure:
    """Draw magnitude and phase of one broken loop, continuous and sampled, with crossover, margins and Nyquist."""
    nyquist = np.pi / period
    with look():
        figure, (top, bottom) = subplots(2, 1, height=5.8, sharex=True, gridspec_kw={"height_ratios": (1.1, 1)})
        for curve in loop.curves:
            top.semilogx(curve.w, curve.magnitude_db, color=curve.color, label=_margin_label(curve))
            bottom.semilogx(curve.w, curve.phase_deg, color=curve.color)
            _mark_margins(top, bottom, curve)
        low, high = float(loop.continuous.w[0]), float(max(loop.continuous.w[-1], nyquist) * 1.45)
        top.set_xlim(low, high)
        sampled = loop.sampled
        shown = sampled.w < 0.98 * nyquist
        floor = min(np.min(sampled.magnitude_db[shown]), np.min(loop.continuous.magnitude_db))
        top.set_ylim(max(floor, -70.0) - 4.0, float(np.max(loop.continuous.magnitude_db)) + 6.0)
        phase = np.concatenate([loop.continuous.phase_deg, sampled.phase_deg])
        lowest = max(float(phase.min()), -420.0)
        bottom.set_ylim(45.0 * np.floor((lowest - 10.0) / 45.0), max(-45.0, 45.0 * np.ceil((phase.max() + 5.0) / 45.0)))
        bottom.yaxis.set_major_locator(_locator(45.0 if lowest > -300 else 90.0))
        for axes, level, text in ((top, 0.0, "0 dB"), (bottom, -180.0, "−180°")):
            axes.axhline(level, color=BLACK, linewidth=0.9, linestyle=(0, (6, 3)))
            axes.annotate(
                text, (low, level), xytext=(4, 3), textcoords="offset points", fontsize=8.5, color=BLACK, va="bottom"
            )
            axes.axvline(nyquist, color=GREEN, linewidth=1.1, linestyle="--")
        top.annotate(
            f"Nyquist {number(nyquist)} rad/s",
            (nyquist, 0.5),
            xycoords=("data", "axes fraction"),
            xytext=(3, 0),
            textcoords="offset points",
            ha="left",
            va="center",
            rotation=90,
            fontsize=8,
            color=GREEN,
        )
        top.set_ylabel("magnitude [dB]")
        bottom.set(ylabel="phase [deg]", xlabel="frequency [rad/s]")
        figure.legend(*top.get_legend_handles_labels(), loc="outside lower center", ncols=2)
        hertz_axis(top)
    return figure


def parts_figure(design: VelocityLoopDesign) -> Figure:
    """Draw the Bode diagram of the sampled plant, of the controller with its filters, and of the loop of both."""
    loop = design.sampled
    nyquist = np.pi / loop.plant.period
    w = loop.plant.frequencies(600)
    w = w[(w > 0.02 * design.crossover) & (w < 0.998 * nyquist)]
    whole = loop.plant_input_response(w)
    controller = loop.controller_response(w) * loop.plant.filter_response(w)
    names = f"controller, {design.structure.form.upper()}" + (" with filters" if loop.plant.filters else "")
    parts = (("plant", GREEN, whole / controller), (names, GREY, controller), ("loop", RED, whole))
    with look():
        figure, (top, bottom) = subplots(2, 1, height=5.4, sharex=True)
        for label, color, response in parts:
            top.semilogx(w, 20.0 * np.log10(np.abs(response)), color=color, label=label)
            bottom.semilogx(w, np.degrees(np.unwrap(np.angle(response))), color=color)
        top.axhline(0.0, color=BLACK, linewidth=0.9, linestyle=(0, (6, 3)))
        bottom.axhline(-180.0, color=BLACK, linewidth=0.9, linestyle=(0, (6, 3)))
        for axes in (top, bottom):
            axes.axvline(nyquist, color=GREEN, linewidth=1.1, linestyle="--")
        top.set_ylabel("magnitude [dB]")
        bottom.set(ylabel="phase [deg]", xlabel="frequency [rad/s]")
        figure.legend(*top.get_legend_handles_labels(), loc="outside lower center", ncols=3)
        hertz_axis(top)
    return figure


def _locator(base: float) -> MultipleLocator:
    from matplotlib.ticker import MultipleLocator

    return MultipleLocator(base)


def _margin_label(curve: LoopCurve) -> str:
    m = curve.margins
    if not m.stable:
        return f"{curve.label}: unstable, no margins"
    words = [f"{curve.label}: {angle(m.phase_margin_deg)} at {number(m.crossover)} rad/s"]
    words.append(f"gain margin {ratio(m.gain_margin)}" if m.gain_margin else "gain margin unbounded")
    words.append(f"delay margin {delay(m.delay_margin, m.period)}")
    return "\n    ".join(words)


def _mark_margins(top: Axes, bottom: Axes, curve: LoopCurve) -> None:
    m = curve.margins
    if not m.stable:
        return
    if m.crossover is not None and m.phase_margin_deg is not None:
        top.plot([m.crossover], [0.0], "o", color=curve.color, markersize=5, zorder=5)
        bottom.plot(
            [m.crossover] * 2, [-180.0, -180.0 + m.phase_margin_deg], color=curve.color, linewidth=2.6, alpha=0.6
        )
        bottom.plot([m.crossover], [-180.0 + m.phase_margin_deg], "o", color=curve.color, markersize=5, zorder=5)
        right = curve.label == "sampled"
        bottom.annotate(
            angle(m.phase_margin_deg),
            (m.crossover, -180.0 + 0.5 * m.phase_margin_deg),
            xytext=(6 if right else -6, 0),
            textcoords="offset points",
            ha="left" if right else "right",
            va="center",
            fontsize=9,
            color=curve.color,
        )
    if m.gain_margin is not None and m.gain_margin_frequency is not None:
        level = -20.0 * np.log10(m.gain_margin)
        top.plot([m.gain_margin_frequency] * 2, [level, 0.0], color=curve.color, linewidth=2.6, alpha=0.6)
        bottom.plot([m.gain_margin_frequency], [-180.0], "s", color=curve.color, markersize=4.5, zorder=5)


def nyquist_figure(loops: tuple[BrokenLoop, ...]) -> Figure:
    """Draw the Nyquist curves of the broken loops, the unit circle and -1."""
    with look():
        figure, grid = subplots(1, len(loops), height=4.2, squeeze=False)
        for axes, loop in zip(grid.flat, loops, strict=True):
            for curve in loop.curves:
                axes.plot(curve.L.real, curve.L.imag, color=curve.color, label=curve.label)
                m = curve.margins
                if m.stable and m.crossover is not None:
                    point = curve.response(np.array([m.crossover]))[0]
                    axes.plot([0.0, point.real], [0.0, point.imag], color=curve.color, linewidth=0.8)
                    axes.plot([point.real], [point.imag], "o", color=curve.color, markersize=5)
            nyquist_plane(axes, (-2.6, 1.3), (-2.6, 1.3), loop.title)
            axes.legend(loc="lower right")
    return figure


def complex_plane(
    axes: Axes, real: tuple[float, float], imaginary: tuple[float, float], title: str, unit: str = ""
) -> None:
    """Give ``axes`` the zero lines, limits and labels of a complex plane with equal scales."""
    axes.axhline(0.0, color=GREY, linewidth=0.8)
    axes.axvline(0.0, color=GREY, linewidth=0.8)
    axes.set(xlim=real, ylim=imaginary, xlabel=f"real part{unit}", ylabel=f"imaginary part{unit}", title=title)
    axes.set_aspect("equal", adjustable="box")


def nyquist_plane(axes: Axes, real: tuple[float, float], imaginary: tuple[float, float], title: str) -> None:
    """Give ``axes`` the plane of an open loop: the unit circle, and the point -1."""
    turn = np.linspace(0, 2 * np.pi, 300)
    axes.plot(np.cos(turn), np.sin(turn), color=GREY, linewidth=0.9, linestyle="--")
    axes.plot([-1.0], [0.0], "P", color=BLACK, markersize=9, zorder=6)
    axes.annotate("−1", (-1.0, 0.0), xytext=(-6, 8), textcoords="offset points", ha="right", fontsize=10)
    complex_plane(axes, real, imaginary, title)


def z_plane(axes: Axes, poles: np.ndarray, title: str) -> None:
    """Draw sampled ``poles`` and the unit circle, those outside it in red."""
    turn, inside = np.linspace(0, 2 * np.pi, 300), np.abs(poles) <= 1.0 + MARGINAL
    axes.fill(np.cos(turn), np.sin(turn), color="#EEF7FD", linewidth=0)
    axes.plot(np.cos(turn), np.sin(turn), color=BLACK, linewidth=1.0)
    axes.plot(poles.real[inside], poles.imag[inside], "x", color=BLUE, markersize=9, markeredgewidth=2)
    if not inside.all():
        beyond = poles[~inside]
        axes.plot(beyond.real, beyond.imag, "X", color=RED, markersize=10, label="outside: unstable")
        axes.legend(loc="lower left")
    limit = max(1.15, 1.1 * float(np.max(np.abs(poles))))
    complex_plane(axes, (-limit, limit), (-limit, limit), title)


def poles_figure(design: VelocityLoopDesign) -> Figure:
    """Draw the closed-loop poles: continuous in the s plane with (9), sampled in the z plane with the unit circle."""
    continuous = np.asarray(design.closed_loop().poles())
    with look():
        figure, (s_axes, z_axes) = subplots(1, 2, height=3.9)
        reach = 1.25 * float(np.max(np.abs(continuous)))
        s_axes.axvspan(0.0, 0.35 * reach, color=RED, alpha=0.08, linewidth=0)
        for z in (0.3, 0.5, 0.7, 0.9):
            x, y = -z * reach, np.sqrt(1.0 - z * z) * reach
            s_axes.plot([x, 0.0, x], [y, 0.0, -y], color="#D1D5DB", linewidth=0.8)
            s_axes.annotate(f"z = {z:g}", (x, y), fontsize=7.5, color=GREY, ha="right", va="bottom")
        s_axes.plot(continuous.real, continuous.imag, "x", color=BLUE, markersize=9, markeredgewidth=2)
        title = "continuous closed loop (9)"
        complex_plane(s_axes, (-1.15 * reach, 0.35 * reach), (-1.1 * reach, 1.1 * reach), title, " [rad/s]")
        z_plane(z_axes, np.asarray(design.sampled.poles), "sampled closed loop, as implemented")
    return figure


def step_figure(continuous: StepResponse, sampled: StepResponse | None) -> Figure:
    """Draw the response to a unit step of the velocity reference; ``sampled`` is None if that loop is unstable."""
    with look():
        figure, axes = subplots(height=3.4)
        t_end = float(continuous.t[-1]) * 1e3
        axes.axhspan(0.98, 1.02, color="#E5E7EB", linewidth=0, label="±2 %")
        axes.axhline(1.0, color=GREY, linewidth=0.8)
        axes.plot(continuous.t * 1e3, continuous.y, color=BLUE, label=_step_label("continuous", continuous))
        if sampled is not None:
            axes.plot(
                sampled.t * 1e3,
                sampled.y,
                color=RED,
                marker="o",
                markersize=2.4,
                linewidth=1.2,
                label=_step_label("sampled", sampled),
            )
        else:
            note(axes, "the sampled loop is unstable: it has no step response", x=0.35, y=0.55)
        for step, color in ((continuous, BLUE), (sampled, RED)):
            if step is None:
                continue
            if step.overshoot_percent > 0.05:
                axes.plot([step.peak_time * 1e3], [step.peak], "^", color=color, markersize=6)
            if step.settling_time is not None:
                axes.axvline(step.settling_time * 1e3, color=color, linewidth=0.9, linestyle=":")
        axes.set_xlim(0.0, t_end)
        axes.set_ylim(bottom=0.0)
        axes.set(xlabel="time [ms]", ylabel="velocity / reference")
        axes.legend(loc="lower right")
    return figure


def _step_label(name: str, step: StepResponse) -> str:
    settling = "not within the window" if step.settling_time is None else quantity(step.settling_time, "s", 3)
    return (
        f"{name}: overshoot {step.overshoot_percent:.1f} %,\n"
        f"    rise 10–90 % {quantity(step.rise_time, 's', 3)}, settling {settling}"
    )


def velocity_loop_figures(design: VelocityLoopDesign) -> dict[str, Figure]:
    """Return a design's pictures: bode_velocity_error, bode_plant_input, bode_parts, nyquist, poles, step."""
    from emps_design.control.verdict import step_responses

    error, plant = broken_loops(design)
    period = design.axis.sampling.period
    return {
        "bode_velocity_error": bode_figure(error, period),
        "bode_plant_input": bode_figure(plant, period),
        "bode_parts": parts_figure(design),
        "nyquist": nyquist_figure((error, plant)),
        "poles": poles_figure(design),
        "step": step_figure(*step_responses(design)),
    }


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
    with look():
        figure, (top, middle, bottom) = plain_subplots(
            3, 1, height=7.2, sharex=True, gridspec_kw={"height_ratios": (1.3, 1.0, 0.7)}
        )
        level = 20.0 * np.log10(response.magnitude)
        low, high = (20.0 * np.log10(np.maximum(1.0 + side * reach, 0.05)) for side in (-1.0, 1.0))
        phase, turn = response.phase_deg, np.degrees(np.arcsin(np.minimum(reach, 1.0)))
        if ratio is not None:
            top.semilogx(f, 20.0 * np.log10(np.abs(ratio)), ".", color=GREY, markersize=2.5, label="ratio of spectra")
            middle.semilogx(f, phase + np.degrees(np.angle(ratio / response.response)), ".", color=GREY, markersize=2.5)
        top.fill_between(f, level + low, level + high, color=BLUE, alpha=0.25, linewidth=0, label="95 % band")
        top.semilogx(f, level, color=BLUE, linewidth=1.2, label="measured")
        middle.fill_between(f, phase - turn, phase + turn, color=BLUE, alpha=0.25, linewidth=0)
        middle.semilogx(f, phase, color=BLUE, linewidth=1.2)
        for (label, model), colour in zip(models.items(), COLOURS, strict=True):
            top.semilogx(f, 20.0 * np.log10(np.abs(model)), "--", color=colour, linewidth=1.1, label=label)
            apart = np.degrees(np.angle(model / response.response))
            middle.semilogx(f, phase + apart, "--", color=colour, linewidth=1.1)
        for resonance in resonances(response):
            for axes in (top, middle):
                axes.axvline(resonance.frequency, color=GREY, linewidth=0.8, linestyle=":")
            side = 1 if resonance.kind == "resonance" else -1
            top.annotate(
                f"{resonance.frequency:.4g} Hz", (resonance.frequency, 0.02), xycoords=("data", "axes fraction"),
                xytext=(3 * side, 0), textcoords="offset points", ha="left" if side > 0 else "right",
                fontsize=8, color=GREY,
            )  # fmt: skip
        if np.any(std > 0.0):
            bottom.loglog(f, std, color=BLUE, linewidth=1.2, label="relative standard deviation")
        bottom.loglog(f, np.maximum(1.0 - response.coherence, 1e-12), color=GREEN, linewidth=1.0, label="1 − coherence")
        top.set_ylabel("magnitude [(m/s)/N, dB]")
        middle.set_ylabel("phase [deg]")
        bottom.set_xlabel("frequency [Hz]")
        top.legend(loc="lower left")
        bottom.legend(loc="best")
        top.set_title(f"{response.name}: force to velocity", parse_math=False)
    return figure


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
