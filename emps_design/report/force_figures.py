"""Pictures of the force loop: how large k_e1 may be, and the loop at the gain chosen."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from emps_design.report.loop_figures import nyquist_plane, z_plane
from emps_design.report.style import BLACK, BLUE, GREEN, RED, look, subplots

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from emps_design.control.force.design import ForceLoopDesign

STIFFNESS = np.geomspace(1e3, 1e6, 22)  # N/m, from a soft cushion to a steel frame


def force_limit_figure(design: ForceLoopDesign) -> Figure:
    """Draw the largest k_e1 over the stiffness of the wall, continuous and sampled, with the gain chosen."""
    walls = [replace(design, environment=float(stiffness)) for stiffness in STIFFNESS]
    with look():
        figure, axes = subplots(height=3.4)
        for name, color, style in (("continuous", BLUE, "-"), ("sampled", RED, "--")):
            limits = [getattr(wall, f"k_e1_max_{name}") for wall in walls]
            shown = np.array([np.nan if limit in (None, 0.0) else limit for limit in limits], dtype=float)
            axes.loglog(STIFFNESS / 1e3, shown, color=color, linestyle=style, label=f"largest $k_{{e1}}$, {name}")
        top = axes.get_ylim()[1]
        if shown[np.isfinite(shown)].size:
            axes.fill_between(STIFFNESS / 1e3, shown, np.full(shown.size, top * 3), color=RED, alpha=0.08, linewidth=0)
        axes.set_ylim(top=top)
        axes.axhline(design.k_e1, color=BLACK, linewidth=1.1, linestyle=":", label="$k_{e1}$ of this design")
        if design.environment > 0:
            axes.plot(
                [design.environment / 1e3],
                [design.k_e1],
                "o" if design.stable else "X",
                color=GREEN if design.stable else RED,
                markersize=9,
                zorder=5,
                label="this design: " + ("stable" if design.stable else "unstable"),
            )
        axes.set(xlabel="stiffness of the wall $K_{env}$ [N/mm]", ylabel=r"$k_{e1}$ [(m/s)/N]")
        axes.grid(which="both", linewidth=0.5)
        axes.legend(loc="lower left")
    return figure


def force_loop_figure(design: ForceLoopDesign) -> Figure:
    """Draw the Nyquist curve of the sampled force loop and its poles in the z plane."""
    period = design.velocity_loop.axis.sampling.period
    w = np.geomspace(0.5, np.pi / period * (1 - 1e-9), 500)
    loop = design.response(w)
    with look():
        figure, (left, right) = subplots(1, 2, height=4.0)
        left.plot(loop.real, loop.imag, color=RED)
        nyquist_plane(left, (-2.2, 1.4), (-2.6, 1.0), "force loop, sampled")
        z_plane(right, np.asarray(design.poles), "closed-loop poles, z plane")
    return figure
