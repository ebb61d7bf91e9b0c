"""Pictures of the force loop: how large k_e1 may be, and the loop at the gain chosen."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from emps_design.report.loop_figures import nyquist_plane, z_plane
from emps_design.report.style import BLACK, BLUE, GREEN, RED, look, subplots

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from emps_design.control.force.design import ForceLoopDesign

WALLS = np.geomspace(1.0 / 30.0, 30.0, 22)  # times the design's own


def force_limit_figure(design: ForceLoopDesign) -> Figure:
    """Draw the largest k_e1 over the stiffness of the wall, continuous and sampled, with the gain chosen.

    Around the design's wall; without one, around the stiffness at which the mass swings at the crossover.
    """
    loop = design.velocity_loop
    centre = design.environment or loop.axis.mechanics.mass * loop.crossover**2
    stiffness = centre * WALLS
    walls = [replace(design, environment=float(one)) for one in stiffness]
    found = {
        name: [getattr(wall, f"k_e1_max_{name}") for wall in walls] for name in ("continuous", "sampled")
    }  # None: no limit, 0: always unstable
    with look():
        figure, axes = subplots(height=3.4)
        for (name, limits), color, style in zip(found.items(), (BLUE, RED), ("-", "--"), strict=True):
            shown = np.array([limit or np.nan for limit in limits], dtype=float)
            axes.loglog(stiffness / 1e3, shown, color=color, linestyle=style, label=f"largest $k_{{e1}}$, {name}")
        axes.autoscale_view()
        bottom, top = axes.get_ylim() if np.any(np.isfinite(_drawn(axes))) else (design.k_e1, design.k_e1)
        bottom, top = min(bottom, design.k_e1 / 2.0), max(top, design.k_e1 * 2.0)
        edge = np.array([np.nan if limit is None else max(limit, bottom) for limit in found["sampled"]])
        if np.any(np.isfinite(edge)):
            axes.fill_between(stiffness / 1e3, edge, np.full(edge.size, top), color=RED, alpha=0.08, linewidth=0)
        axes.set_ylim(bottom, top)
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


def _drawn(axes: Axes) -> np.ndarray:
    return np.concatenate([np.asarray(line.get_ydata(), dtype=float) for line in axes.get_lines()])


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
