"""A measured frequency response: Bode picture with its 95 % band and the model beside it, and the section on it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from emps_design.frequency_response.coupling import MassChain, ResponseComparison
from emps_design.frequency_response.response import BAND, resonances
from emps_design.report.display import NOTHING, number
from emps_design.report.page import Callout, Picture, Section, Table, Text
from emps_design.report.style import BLUE, GREEN, GREY, RED, look, plain_subplots

if TYPE_CHECKING:
    from matplotlib.figure import Figure


COLOURS = (RED, GREEN)


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


def response_blocks(comparison: ResponseComparison, ratio: np.ndarray | None = None) -> tuple[Any, ...]:
    """Return the picture of a response beside the model, the agreement in words, the fitted masses, and warnings."""
    warnings = (*comparison.response.warnings, *comparison.chain.warnings)
    return (
        Picture(
            response_figure(comparison, ratio),
            "Force to velocity of the plant, hold and delay of the drive taken out, with the 95 % band of the data.",
            "Measured frequency response",
        ),
        Text(f"{comparison.axis.name}: {comparison.agreement.sentence}."),
        _chain_table(comparison.chain),
        Callout("warning", "What the data do not say", items=warnings) if warnings else None,
    )


def response_section(comparison: ResponseComparison) -> Section:
    """Return the section on a measured response."""
    return Section(f"Measured response {comparison.response.name}", *response_blocks(comparison))


def _chain_table(chain: MassChain) -> Table:
    rows = [
        [name.replace("_", " "), unit, *((number(value, 6), number(std, 3)) if known else ("not determined", NOTHING))]
        for name, (value, std, unit) in chain.parameters.items()
        for known in [chain.determines(name)]
    ]
    text = f"The response asks for {chain.label}; residuals are {number(chain.misfit, 2)} times the data's deviations."
    return Table(["parameter", "unit", "value", "standard deviation"], rows, text)
