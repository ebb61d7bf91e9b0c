"""The part of a diagnosis page that says what to record next: in words, drawn, and beside its alternatives."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from emps_design.report.display import quantity, words
from emps_design.report.page import Picture, Section, Table, Text, html
from emps_design.report.style import BLUE, look, plain_subplots, thin

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def experiment_section(chosen: Mapping[str, Any] | None, experiment: Any = None) -> Section | None:
    """Return the section for ``chosen``, the document's ``experiment``, or None where nothing is to be recorded.

    ``experiment`` itself, where there is one, has the reference: ``t`` [s] and ``q_ref`` [m], (n,), the latter or None.
    """
    if not chosen:
        return None
    text = chosen["text"]
    blocks: list[Any] = [Text(f"{text[0].upper()}{text[1:]}.")]
    if getattr(experiment, "q_ref", None) is not None:
        blocks.append(
            Picture(
                reference_figure(experiment.t, experiment.q_ref),
                f"The reference that would tell, {words(chosen['program'])}, {experiment.t[-1]:.0f} s. It begins and "
                "ends at rest where the record began.",
                "What to record",
            )
        )
    if chosen.get("file"):
        blocks.append(
            Text(
                html(
                    "It is in <code>{}</code>, columns t [s] and q_ref [m]. Try it first: "
                    "<code>emps-design simulate model.toml --reference {}</code>.",
                    chosen["file"],
                    chosen["file"],
                )
            )
        )
    if chosen.get("menu"):
        between = " and ".join(words(name) for name in chosen["between"])
        blocks.append(
            Table(
                ["program", "what it does", "apart [N rms]", "apart [std of the noise]"],
                [[words(row["program"]), row["text"], row["distance"], row["over_noise"]] for row in chosen["menu"]],
                f"How far apart {between} are on each program that stays within what the records show, fitted to one "
                f"another; {quantity(chosen['needed'], '', 2)} standard deviations decide.",
            )
        )
    return Section("What to record next", *blocks)


def reference_figure(t: np.ndarray, q_ref: np.ndarray) -> Figure:
    """Draw a reference: position [m] (n,) over ``t`` [s], and its velocity."""
    with look():
        figure, (top, bottom) = plain_subplots(2, 1, height=3.6, sharex=True)
        top.plot(*thin(t, 1e3 * q_ref), color=BLUE, linewidth=1.3)
        top.set_ylabel("reference [mm]")
        bottom.plot(*thin(t, 1e3 * np.gradient(q_ref, t)), color=BLUE, linewidth=0.9)
        bottom.set(ylabel="velocity [mm/s]", xlabel="time [s]")
        for axes in (top, bottom):
            axes.margins(x=0.01)
    return figure
