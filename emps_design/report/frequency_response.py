"""The picture of a measured frequency response: Bode with its 95 % band, the ratio of spectra beside it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from emps_design.frequency_response.response import BAND
from emps_design.report.style import BLUE, GREEN, GREY, RED, look, subplots

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from emps_design.frequency_response import Estimate


def response_figure(found: Estimate) -> Figure:
    """Draw magnitude and phase with the 95 % band, resonances, and below them deviation and coherence."""
    response = found.response
    f, std = response.frequency, response.std
    reach = BAND * std
    with look():
        figure, (top, middle, bottom) = subplots(
            3, 1, height=7.2, sharex=True, gridspec_kw={"height_ratios": (1.3, 1.0, 0.7)}
        )
        level = 20.0 * np.log10(response.magnitude)
        low, high = (20.0 * np.log10(np.maximum(1.0 + side * reach, 0.05)) for side in (-1.0, 1.0))
        ratio = found.spectral_ratio
        top.semilogx(f, 20.0 * np.log10(np.abs(ratio)), ".", color=GREY, markersize=2.5, label="ratio of spectra")
        top.fill_between(f, level + low, level + high, color=BLUE, alpha=0.25, linewidth=0, label="95 % band")
        top.semilogx(f, level, color=BLUE, linewidth=1.2, label=f"{found.method}, by the {found.instrument}")
        phase, turn = response.phase_deg, np.degrees(np.arcsin(np.minimum(reach, 1.0)))
        middle.semilogx(f, phase + np.degrees(np.angle(ratio / response.response)), ".", color=GREY, markersize=2.5)
        middle.fill_between(f, phase - turn, phase + turn, color=BLUE, alpha=0.25, linewidth=0)
        middle.semilogx(f, phase, color=BLUE, linewidth=1.2)
        for one in found.resonances:
            color = GREEN if one.kind == "resonance" else RED
            for axes in (top, middle):
                axes.axvline(one.frequency, color=color, linewidth=0.9, linestyle="--")
            top.annotate(
                f"{one.frequency:.4g} Hz", (one.frequency, 0.02), xycoords=("data", "axes fraction"), xytext=(3, 0),
                textcoords="offset points", fontsize=8, color=color,
            )  # fmt: skip
        bottom.loglog(f, std, color=BLUE, linewidth=1.2, label="relative standard deviation")
        bottom.loglog(f, np.maximum(1.0 - response.coherence, 1e-12), color=GREEN, linewidth=1.0, label="1 − coherence")
        top.set_ylabel("magnitude [dB (m/s)/N]")
        middle.set_ylabel("phase [deg]")
        bottom.set_xlabel("frequency [Hz]")
        top.legend(loc="lower left")
        bottom.legend(loc="best")
        top.set_title(f"{response.name}: force to velocity", parse_math=False)
    return figure
