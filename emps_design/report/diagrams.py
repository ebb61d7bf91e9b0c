"""Block diagrams: the cascaded loop of Fig. 4, and the impedance law of Fig. 11 with its target impedance."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from emps_design.figures import BLACK, BLUE, GREEN, GREY, RED
from emps_design.report.style import WIDTH, look, subplots

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from emps_design.control.velocity.gains import Structure

Point = tuple[float, float]


def _block(
    axes: Axes, x: float, y: float, text: str, width: float = 1.5, color: str = BLUE, height: float = 0.9
) -> None:
    from matplotlib.patches import FancyBboxPatch

    axes.add_patch(
        FancyBboxPatch(
            (x - width / 2, y - height / 2),
            width,
            height,
            boxstyle="round,pad=0,rounding_size=0.08",
            facecolor="white",
            edgecolor=color,
            linewidth=1.5,
            zorder=3,
        )
    )
    axes.text(x, y, text, ha="center", va="center", fontsize=10, zorder=4)


def _sum(axes: Axes, x: float, y: float, signs: dict[str, str]) -> None:
    """A summing point; ``signs`` maps where a signal enters (left, below, above) to its sign."""
    from matplotlib.patches import Circle

    axes.add_patch(Circle((x, y), 0.2, facecolor="white", edgecolor=BLACK, linewidth=1.3, zorder=3))
    place = {"left": (-0.36, -0.22), "below": (0.2, -0.38), "above": (0.2, 0.38)}
    for side, sign in signs.items():
        dx, dy = place[side]
        axes.text(x + dx, y + dy, sign.replace("-", "−"), ha="center", va="center", fontsize=10, zorder=4)


def _wire(axes: Axes, *points: Point, arrow: bool = True, color: str = BLACK) -> None:
    xs, ys = [p[0] for p in points], [p[1] for p in points]
    axes.plot(xs, ys, color=color, linewidth=1.2, zorder=2, solid_joinstyle="miter")
    if arrow:
        axes.annotate(
            "",
            xy=points[-1],
            xytext=points[-2],
            arrowprops={"arrowstyle": "-|>", "color": color, "linewidth": 1.2, "shrinkA": 0, "shrinkB": 0},
            zorder=2,
        )


def _node(axes: Axes, x: float, y: float) -> None:
    axes.plot([x], [y], "o", color=BLACK, markersize=3.5, zorder=4)


def _label(axes: Axes, x: float, y: float, text: str, **options: Any) -> None:
    style: dict[str, Any] = {"ha": "center", "va": "bottom", "fontsize": 9.5, **options}
    axes.text(x, y, text, **style)


def _canvas(width: float, height: float) -> tuple[Figure, Axes]:

    figure, axes = subplots(height=WIDTH * height / width)
    axes.set(xlim=(0, width), ylim=(0, height))
    axes.set_aspect("equal")
    axes.axis("off")
    return figure, axes


def velocity_and_force_loop_diagram(structure: Structure, filtered: bool = False) -> Figure:
    """Draw Fig. 4, the velocity loop of that ``structure`` in the force loop, the operator's impedance written out.

    ``filtered``: the command passes filters.
    """
    with look():
        figure, axes = _canvas(15.4, 4.9)
        y = 3.0
        _wire(axes, (0.2, y), (0.9, y))
        _label(axes, 0.45, y + 0.1, r"$\tau_{ref}$")
        _sum(axes, 1.1, y, {"left": "+", "below": "+"})
        _wire(axes, (1.3, y), (1.55, y))
        _block(axes, 1.9, y, "$k_{e1}$", 0.7, GREEN)
        _wire(axes, (2.25, y), (4.0, y))
        _label(axes, 2.42, y + 0.1, r"$v_{\dot q}$")
        if structure.reference_filter:
            _block(axes, 3.15, y, r"$\dfrac{1}{1 + t_v\,s}$", 1.05)
        _sum(axes, 4.2, y, {"left": "+", "below": "-"})
        _wire(axes, (4.4, y), (4.95, y))
        if structure.form == "ip":
            _block(axes, 5.45, y, r"$\dfrac{1}{t_v\,s}$", 1.0)
            _wire(axes, (5.95, y), (6.4, y))
            _sum(axes, 6.6, y, {"left": "+", "below": "-"})
            _wire(axes, (6.8, y), (7.1, y))
            _block(axes, 7.45, y, "$k_{v1}$", 0.7)
        else:
            _block(axes, 6.2, y, r"$k_{v1}\left(1 + \dfrac{1}{t_v\,s}\right)$", 2.5)
        _wire(axes, (7.8 if structure.form == "ip" else 7.45, y), (9.75, y))
        if filtered:
            _block(axes, 8.5, y, "filters", 0.85)
        _label(axes, 9.27, y - 0.42, "$u$ [V]")
        _block(axes, 10.3, y, r"$G_\tau$", 1.1, GREY)
        _wire(axes, (10.85, y), (11.4, y))
        _label(axes, 11.1, y + 0.1, r"$\tau_m$")
        _sum(axes, 11.6, y, {"left": "+", "above": "+"})
        _wire(axes, (11.8, y), (12.25, y))
        _block(axes, 13.15, y, r"$\dfrac{1}{M s + F_v}$", 1.8, GREY)
        _wire(axes, (14.05, y), (15.2, y))
        _label(axes, 14.85, y + 0.1, r"$\dot q$ [m/s]")
        _node(axes, 14.35, y)
        # velocity feedback: one line serves the integral and the proportional path
        _wire(axes, (14.35, y), (14.35, 1.75), (4.2, 1.75), (4.2, y - 0.2))
        if structure.form == "ip":
            _wire(axes, (6.6, 1.75), (6.6, y - 0.2))
            _node(axes, 6.6, 1.75)
            _label(axes, 5.45, 1.68, "integral on the error", fontsize=8.5, color=GREY, va="top")
            _label(axes, 8.5, 1.68, "proportional on the velocity", fontsize=8.5, color=GREY, va="top")
        # operator
        _wire(axes, (14.35, 1.75), (14.35, 0.55), (10.5, 0.55))
        _node(axes, 14.35, 1.75)
        _block(axes, 9.4, 0.55, r"operator $-Z(s)$", 2.2, RED, 0.7)
        _wire(axes, (8.3, 0.55), (1.1, 0.55), (1.1, y - 0.2), color=RED)
        _label(axes, 4.6, 0.62, r"$\tau_e$ [N], measured by the force sensor", color=RED)
        _wire(axes, (11.6, 4.3), (11.6, y + 0.2), color=RED)
        _label(axes, 11.6, 4.33, r"$\tau_e$ on the carriage", color=RED)
        # where the loops are broken
        for x, text in ((4.62, "broken here:\nvelocity error"), (9.3, "broken here:\nplant input")):
            axes.annotate(
                text,
                xy=(x, y - 0.03),
                xytext=(x, 4.1),
                ha="center",
                fontsize=8.5,
                color=BLUE,
                arrowprops={"arrowstyle": "-", "color": BLUE, "linestyle": ":", "linewidth": 1.1, "shrinkB": 0},
            )
    return figure


def impedance_law_diagram() -> Figure:
    """Draw Fig. 11: (a) the law around the drive, (b) the target impedance."""
    with look():
        figure, axes = _canvas(15.4, 5.0)
        y = 3.2
        _label(axes, 0.1, 4.6, "(a) the law on the drive", ha="left", fontweight="bold")
        _wire(axes, (0.1, y), (0.75, y))
        _label(axes, 0.4, y + 0.1, r"$q_0$")
        _block(axes, 1.9, y, "impedance\nlaw (27)–(30)", 2.2, GREEN, 1.3)
        _wire(axes, (3.0, y), (4.0, y))
        _label(axes, 3.5, y + 0.1, r"$\tau_m^*$")
        _block(axes, 4.8, y, "current\nloop", 1.5, GREY, 1.1)
        _wire(axes, (5.55, y), (6.6, y))
        _label(axes, 6.05, y + 0.1, r"$\tau_m$")
        _sum(axes, 6.8, y, {"left": "+", "above": "+"})
        _wire(axes, (6.8, 4.3), (6.8, y + 0.2), color=RED)
        _label(axes, 6.8, 4.33, r"$\tau_e$, the hand", color=RED)
        _wire(axes, (7.0, y), (7.5, y))
        _block(axes, 8.3, y, "carriage\n(2)", 1.6, GREY, 1.1)
        _wire(axes, (9.1, y), (10.2, y))
        _label(axes, 9.85, y + 0.1, r"$q,\ \dot q$")
        _node(axes, 9.45, y)
        _wire(axes, (9.45, y), (9.45, 0.7), (1.5, 0.7), (1.5, y - 0.65))
        _label(axes, 5.6, 0.62, r"$q,\ \dot q,\ \ddot q$ from the encoder", va="top", color=GREY, fontsize=8.5)
        _node(axes, 5.8, y)
        _wire(axes, (5.8, y), (5.8, 1.6), (2.3, 1.6), (2.3, y - 0.65))
        _label(axes, 4.1, 1.67, r"$I_m$, the motor current", color=GREY, fontsize=8.5)
        # (b) the target
        _label(axes, 11.0, 4.6, "(b) what the hand shall feel", ha="left", fontweight="bold")
        _target(axes, 11.1, 2.2)
    return figure


def _target(axes: Axes, x: float, y: float) -> None:
    from matplotlib.patches import Rectangle

    axes.plot([x, x], [y - 1.1, y + 1.1], color=BLACK, linewidth=1.6)
    for k in range(8):
        base = y - 1.1 + 2.2 * k / 8
        axes.plot([x - 0.22, x], [base, base + 0.24], color=GREY, linewidth=0.9)
    # damper B above, spring K below
    top, low = y + 0.6, y - 0.6
    axes.plot([x, x + 0.7], [top, top], color=BLACK, linewidth=1.3)
    axes.plot(
        [x + 1.25, x + 0.7, x + 0.7, x + 1.25], [top + 0.25, top + 0.25, top - 0.25, top - 0.25], color=BLACK, lw=1.3
    )
    axes.plot([x + 1.0, x + 1.0], [top - 0.18, top + 0.18], color=BLACK, linewidth=1.3)
    axes.plot([x + 1.0, x + 2.0], [top, top], color=BLACK, linewidth=1.3)
    _label(axes, x + 1.0, top + 0.3, "$B$")
    xs = [x, x + 0.3] + [x + 0.3 + 0.2 * k + 0.1 for k in range(7)] + [x + 1.8, x + 2.0]
    ys = [low, low] + [low + (0.2 if k % 2 == 0 else -0.2) for k in range(7)] + [low, low]
    axes.plot(xs, ys, color=BLACK, linewidth=1.3)
    _label(axes, x + 1.0, low + 0.25, "$K$")
    axes.add_patch(Rectangle((x + 2.0, y - 0.95), 1.1, 1.9, facecolor="#EEF7FD", edgecolor=BLACK, linewidth=1.4))
    _label(axes, x + 2.55, y, "$M_a$", va="center", fontsize=11)
    _wire(axes, (x + 4.1, y), (x + 3.1, y), color=RED)
    _label(axes, x + 3.65, y + 0.1, r"$\tau_e$", color=RED)
    _label(axes, x + 1.75, y - 1.5, r"$\tau_e = M_a \ddot q + B(\dot q-\dot q_0) + K(q-q_0)$", va="top", fontsize=9.5)
