"""The sections and pictures of the page of ``diagnose``, one function each; a section is None if it would be empty."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from emps_design.discrepancy.acceptance import explained
from emps_design.discrepancy.residual_views import SPECTRAL
from emps_design.effects import get_effect, kind_of
from emps_design.errors import EmpsError
from emps_design.figures import BLACK, BLUE, GREY, RED, YELLOW, Axes, Band, Curve, Grid, Level, thin
from emps_design.quantities import inside
from emps_design.report.page import (
    NOTHING,
    Line,
    Picture,
    Section,
    Table,
    html,
    inputs_table,
    interval,
    number,
    probability,
    quantity,
    sentence_of,
    versions,
    with_std,
    words,
)
from emps_design.report.style import drawn, look, plain_subplots

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from emps_design.discrepancy.result import Diagnosis
    from emps_design.units import Units

BESIDE = (60, 1)  # ratio of the widths of a map and its colour bar
DECADE = 10.0
EVERYWHERE = 0.5  # a mark over more than this share of a view is not drawn
_SCALE = {"m": (1e3, "mm"), "m/s": (1e3, "mm/s")}

IN_LOOP = "after a refit in closed loop"


def where_figure(diagnosis: Any) -> Figure:
    """Draw the first view of ``diagnosis`` large: mean residual force before and after over one quantity."""
    with look():
        figure, axes = plain_subplots(height=3.3)
        _draw_view(axes, diagnosis.views[0])
        axes.legend(loc="best")
    return figure


def views_figure(views: Sequence[Any]) -> Figure:
    """Draw every view, two in a row."""
    rows = -(-len(views) // 2)
    with look():
        figure, grid = plain_subplots(rows, 2, height=2.5 * rows, squeeze=False)
        for axes, view in zip(grid.flat, views, strict=False):
            _draw_view(axes, view)
        for axes in grid.flat[len(views) :]:
            axes.axis("off")
        grid.flat[0].legend(loc="best")
    return figure


def map_figure(missing: Mapping[str, Any]) -> Figure:
    """Draw the mean missing force over position and velocity, as ``unexplained.map`` of a diagnosis has it."""
    force = np.array(missing["force"], float)
    most = float(np.nanmax(np.abs(force)))
    with look():
        figure, (axes, bar) = plain_subplots(1, 2, height=3.6, width_ratios=BESIDE)
        places = (1e3 * np.array(missing["position"]), 1e3 * np.array(missing["velocity"]))
        shown = axes.pcolormesh(*places, force, cmap="PuOr", vmin=-most, vmax=most, shading="nearest", rasterized=True)
        figure.colorbar(shown, cax=bar, label="missing force [N]")
        axes.set(xlabel="position [mm]", ylabel="velocity [mm/s]")
        axes.grid(visible=False)
    return figure


def spectrum_figure(spectrum: Mapping[str, Any]) -> Figure:
    """Draw the spectrum of the missing force over time, as ``spectrum_over_time`` of a diagnosis has it."""
    force = np.array(spectrum["force"], float)
    with look():
        figure, (axes, bar) = plain_subplots(1, 2, height=3.0, width_ratios=BESIDE)
        shown = axes.pcolormesh(
            spectrum["time"], spectrum["frequency"], force, cmap="Purples", vmin=0.0, shading="nearest", rasterized=True
        )
        figure.colorbar(shown, cax=bar, label="missing force [N rms in a line]")
        axes.set(xlabel="time [s]", ylabel="frequency [Hz]")
        axes.grid(visible=False)
    return figure


def _draw_view(axes: Any, view: Any) -> None:
    factor, unit = _SCALE.get(view.unit, (1.0, view.unit))
    x = np.asarray(view.x) * factor
    for low, high in view.marks:
        if (high - low) * factor > EVERYWHERE * np.ptp(x):
            continue
        axes.axvspan(low * factor, high * factor, color=YELLOW, alpha=0.45, linewidth=0)
    if view.band is not None:
        center = np.zeros_like(x)
        low = center if view.quantity in SPECTRAL else center - view.band
        axes.fill_between(x, low, center + view.band, color="#9CA3AF", alpha=0.4, linewidth=0, label="healthy record")
    # Without findings there is one model, and one line.
    both = not np.array_equal(view.before, view.after, equal_nan=True)
    for y, color, label in ((view.before, RED, "before" if both else "model"), (view.after, BLUE, "after"))[: 1 + both]:
        xs, ys = thin(x, y)
        axes.plot(xs, ys, color=color, linewidth=1.4, label=label)
    axes.axhline(0.0, color=GREY, linewidth=0.8)
    axes.set(
        xlabel=f"{view.quantity} [{unit}]",
        ylabel="amplitude [N]" if view.quantity in SPECTRAL else "residual force [N]",
    )
    if view.quantity in SPECTRAL and x.size and x[0] > 0:
        axes.set_xscale("log")
        axes.xaxis.set_major_formatter("{x:g}")  # 10 rather than a power, which needs mathematical type
        axes.xaxis.set_minor_formatter("{x:g}" if x[-1] < DECADE * x[0] else "")
    if view.title:
        axes.set_title(view.title)
    axes.margins(x=0.01)


def before_after_figure(diagnosis: Any) -> Figure:
    """Draw the held-out or training record: force measured and simulated, and the residual of each model."""
    trace = diagnosis.trace
    t = np.asarray(trace.t)
    used = np.asarray(trace.used)
    residual = np.where(used, np.asarray(trace.measured) - np.asarray(trace.baseline), 0.0)
    low, high = trace.window or _window(t, residual)
    inside = (t >= low) & (t <= high)
    models = [(trace.baseline, RED, "baseline model"), (trace.extended, BLUE, "extended model")]
    if np.array_equal(trace.baseline, trace.extended):
        models = models[:1]
    forces: list[Any] = [Curve(*thin(t[inside], trace.measured[inside]), "measured", BLACK, width=1.9)]
    errors: list[Any] = [Level("y", 0.0), Band("x", low, high, YELLOW, 0.3)]
    for y, color, label in models:
        forces.append(Curve(*thin(t[inside], np.asarray(y)[inside]), label, color, width=1.2))
        error = np.asarray(trace.measured) - np.asarray(y)
        errors.append(Curve(*thin(t[used], error[used]), label, color, width=0.9))
    named: dict[str, Any] = {"legend": "upper right", "room": 0.22}
    title = f"Force, {low:.3g} s to {high:.3g} s"
    top = Axes(tuple(forces), "time [s]", "motor force [N]", title, columns=3, **named)
    bottom = Axes(tuple(errors), "time [s]", "measured − simulated [N]", "Residual of each model", columns=2, **named)
    return drawn(Grid.of(top, bottom, height=5.0, share_x=False))


def _window(t: np.ndarray, error: np.ndarray) -> tuple[float, float]:
    """Return start and end [s] of the tenth of the record with the largest mean square ``error``."""
    length = max(2, t.size // 10)
    energy = np.concatenate([[0.0], np.cumsum(np.square(error))])
    start = int(np.argmax(energy[length:] - energy[:-length]))
    return float(t[start]), float(t[min(start + length, t.size - 1)])


def candidates_figure(candidates: Sequence[Mapping[str, Any]], gap: Mapping[str, Any]) -> Figure:
    """Draw the force error of each of the best twelve candidates, or their statistics if none was fitted."""
    fitted = [c for c in candidates if c.get("gap") is not None]
    if not fitted:
        leading = [c for c in candidates if c.get("statistic") is not None][:12]
        threshold = max((c["threshold"] for c in leading if c.get("threshold") is not None), default=None)
        lines = [(threshold, RED, "--", "threshold")]
        return _bars(leading, [c["statistic"] for c in leading], "statistic of the first estimate", "", None, lines)
    shown, baseline = fitted[:12], (gap.get("train") or {}).get("baseline")
    limit = 1.5 * max([baseline or 0.0, *(c["gap"] for c in shown if c.get("accepted"))]) or None
    lines = [(baseline, RED, "--", "original model"), (gap.get("floor"), GREY, ":", "noise floor")]
    return _bars(shown, [c["gap"] for c in shown], "force error [N rms]", f" {gap.get('unit', 'N')}", limit, lines)


def _bars(
    shown: Sequence[Mapping[str, Any]],
    values: Sequence[float],
    axis_label: str,
    unit: str,
    limit: float | None,
    lines: Sequence[tuple[float | None, str, str, str]],
) -> Figure:
    """Draw bars with their values, cut at ``limit``, and vertical lines (where, colour, style, label)."""
    bars = [min(value, limit) if limit else value for value in values]
    with look():
        figure, axes = plain_subplots(height=1.0 + 0.27 * max(len(shown), 2), above=18.0)
        colors = [BLUE if c.get("accepted") else "#B8BFC9" for c in shown]
        axes.barh(range(len(shown)), bars, color=colors, height=0.68, zorder=2)
        axes.set_yticks(range(len(shown)), [c.get("label") or words(c["effect"]) for c in shown])
        axes.invert_yaxis()
        for row, (bar, value) in enumerate(zip(bars, values, strict=True)):
            text = f"{value:.3g}{unit}" + (" (bar cut)" if bar < value else "")
            axes.annotate(text, (bar, row), xytext=(4, 0), textcoords="offset points", va="center", fontsize=8.5)
        for where, color, style, label in lines:
            if where is not None:
                axes.axvline(where, color=color, linestyle=style, linewidth=1.4, label=label)
        axes.grid(axis="y", visible=False)
        axes.set_xlabel(axis_label)
        axes.margins(x=0.12)
        axes.set_xlim(left=0)
        if axes.get_legend_handles_labels()[0]:
            axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=2, borderaxespad=0.0)
    return figure


def _label(finding: Mapping[str, Any]) -> str:
    return finding.get("label") or words(finding["effect"])


def _base_unit(finding: Mapping[str, Any], name: str, entry: Mapping[str, Any]) -> str:
    """The unit of a parameter on a linear axis, from which the page chooses a readable one."""
    try:
        parameters = get_effect(kind_of(finding["effect"])).parameters
    except EmpsError:  # the effect is not registered here
        return str(entry.get("unit", ""))
    return next((parameter.unit for parameter in parameters if parameter.name == name), str(entry.get("unit", "")))


def in_plain_words(document: Mapping[str, Any]) -> str:
    """Return the result for readers who are not control engineers: what was found, and how much it explains."""
    findings, unexplained = document["findings"], document.get("unexplained")
    gap = document["gap"].get("holdout") or document["gap"]["train"]
    before, after, floor = gap.get("baseline"), gap.get("extended"), document["gap"].get("floor")
    if document["verdict"] in ("nothing-missing", "parameters-only"):
        return "The machine behaves as its model predicts, except for noise; nothing has to be added to the model."
    if not findings:
        return (
            "The machine does not behave as its model predicts, and none of the tested causes explains the difference. "
            "More measurements are needed before anything is changed."
        )
    names = [inside(_label(finding)) for finding in findings]
    listed = names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
    whom = "it" if len(names) == 1 else "them"
    closed = ""
    if None not in (before, after, floor) and before > max(floor, after):
        share = closed_share(before, after, floor)  # the refitted baseline contributes as well
        closed = f" With {whom} the corrected model explains {share} of the difference."
    cause = "one cause has" if len(names) == 1 else f"{len(names)} causes have"
    rest = " No known cause explains the rest; it needs another measurement." if unexplained else ""
    other = "A second record" if document.get("held_out", {}).get("time") is None else "A part of the record"
    confirmed = all(finding.get("confirmed") for finding in findings)
    agreement = f" {other} that was not used to find {whom} agrees." if confirmed else ""
    return (
        f"The machine does not behave exactly as its model predicts, and {cause} been found: "
        f"{listed}.{closed}{agreement}{rest}"
    )


def closed_share(before: float, after: float, floor: float) -> str:
    """Return the share of a gap that is closed, in words; an error below the noise floor closes all of it.

    >>> closed_share(2.0, 0.9, 1.0), closed_share(2.0, 1.5, 1.0)
    ('100 %', '58 %')
    """
    return f"{100 * min(explained(before, after, floor), 1.0):.0f} %"


def findings_section(findings: Sequence[Mapping[str, Any]], units: Units) -> Section | None:
    """Return the section on the effects found: the evidence for each, and their parameters."""
    if not findings:
        return None
    force, newton = units.word("force"), units.unit("N")
    evidence = [
        [
            _label(finding),
            probability(finding.get("p_value")),
            finding.get("where", {}).get("channel", "plant"),
            number(finding.get("where", {}).get("force", {}).get("value")),
            finding.get("note", ""),
        ]
        for finding in findings
    ]
    rows = [
        [
            _label(finding),
            units.words(words(name)),
            with_std(entry.get("value"), entry.get("std"), _base_unit(finding, name, entry), units),
            interval(entry.get("value"), entry.get("std"), _base_unit(finding, name, entry), units),
            finding.get("where", {}).get("record", "this record") if entry.get("per_record") else "the machine",
        ]
        for finding in findings
        for name, entry in finding.get("parameters", {}).items()
    ]
    return Section(
        "What is missing",
        Table(
            ["effect", "p-value", "acts in the", f"{force} up to [{newton}]", "remark"],
            evidence,
            f"Evidence, in the order of the findings; the {force} is that of the effect itself.",
        ),
        Table(
            ["effect", "parameter", "value ± std", "95 % interval", "belongs to"],
            rows,
            "Parameters of the effects found. A parameter that belongs to one record (the phase of a ripple, the time "
            "of an event) is fitted again on every other record.",
        )
        if rows
        else None,
    )


def unexplained_section(document: Mapping[str, Any], units: Units) -> Section | None:
    """Return the section on the force that no effect explains, over position and velocity."""
    missing = document.get("unexplained")
    if not missing:
        return None
    return Section(
        "What no effect explains",
        Picture(
            map_figure(missing["map"]),
            f"Mean {units.word('force')} that the model lacks, over position and velocity, away from reversals; white "
            f"where there are no samples. {sentence_of(missing['text'])} Equal rows mean that it depends on position, "
            "equal columns on velocity.",
            f"The missing {units.word('force')}",
        ),
    )


def closest_section(document: Mapping[str, Any], units: Units) -> Section | None:
    """Return the section that compares the force error of the closest model with that of the named one."""
    closest = document.get("closest")
    if not closest:
        return None
    blocks: list[Any] = []
    if "gap" in closest:
        rows = [
            [
                word,
                record,
                *map(
                    number,
                    (document[key][part]["extended"], closest[key][part]["extended"], document[key].get("floor")),
                ),
            ]
            for key, word in (("gap", document["simulation"]), ("gap_inverse_60hz", "inverse model, 60 Hz"))
            for part, record in (("train", "training"), ("holdout", "held out"))
            if part in closest[key]
        ]
        caption = "Use this model for accurate simulation or feed-forward; the named model above for causes."
        newton = units.unit("N")
        models = (f"{name} [{newton} rms]" for name in ("named model", "closest model", "floor"))
        headers = [f"{units.word('force')} error", "record", *models]
        blocks.append(Table(headers, rows, caption))
    if closest.get("model_file"):
        blocks.append(Line(html("Its axis file: <code>{}</code>.", closest["model_file"])))
    return Section("The closest model", *blocks) if blocks else None


def candidates_section(diagnosis: Diagnosis, candidates: Sequence[Mapping[str, Any]], units: Units) -> Section | None:
    """Return the section on the candidates and the force error of each."""
    if not candidates:
        return None
    rows = [
        [
            c.get("label") or words(c["effect"]),
            "accepted" if c.get("accepted") else "rejected",
            *(number(c.get(name)) for name in ("gap", "statistic", "threshold")),
            c.get("note", ""),
        ]
        for c in candidates
    ]
    document = diagnosis.to_dict()
    refitted = (
        "refitted in closed loop on the fitting part; the statistic must exceed the threshold: the largest value "
    )
    refitted += "on healthy records, or the required share of the cost"
    if "band_hz" in document:
        refitted = "on held-out strokes; the statistic is the ratio of the error without the effect to that with it"
    return Section(
        "Candidates",
        Picture(
            candidates_figure(candidates, document["gap"]),
            _candidates_caption(
                candidates, "in predictions of held-out data" if "band_hz" in document else IN_LOOP, units.word("force")
            ),
            "Candidates",
        ),
        Table(
            ["candidate", "decision", f"gap [{units.unit('N')}]", "statistic", "threshold", "remark"],
            rows,
            f"The best candidates, {refitted}.",
        ),
    )


def _candidates_caption(candidates: Sequence[Mapping[str, Any]], how: str, force: str) -> str:
    if all(candidate.get("gap") is None for candidate in candidates):
        return (
            "No candidate explained enough to be fitted. The bars are the statistics of the first estimates; the "
            "dashed line is the threshold."
        )
    return (
        f"{force.capitalize()} error with each candidate {how}; shorter is better. The dashed line is the original "
        "model, the dotted line the noise floor. A candidate near the dashed line explains nothing."
    )


def parameters_section(document: Mapping[str, Any], units: Units) -> Section | None:
    """Return the section on the parameters of the baseline before and after."""
    parameters = document.get("parameters") or {}
    if not parameters:
        return None

    def shown(entry: Mapping[str, Any] | None, unit: str) -> str:
        return with_std(entry.get("value"), entry.get("std"), unit, units) if entry else NOTHING

    return Section(
        "Baseline parameters",
        Table(
            ["parameter", "axis file", "refitted alone", "refitted with the effects"],
            [
                [
                    units.words(words(name)),
                    quantity(entry.get("axis"), entry["unit"], 4, units),
                    shown(entry.get("baseline"), entry["unit"]),
                    shown(entry.get("extended"), entry["unit"]),
                ]
                for name, entry in parameters.items()
            ],
            "The baseline parameters before and after: a missing effect biases the parameters that compensate for it.",
        ),
    )


def gap_section(document: Mapping[str, Any], units: Units) -> Section:
    """Return the section on the force error of both models on every record, with intervals."""
    rows, newton = [], units.unit("N")
    simulated = document.get("simulation", "closed loop")

    def shown(values: Mapping[str, Any], name: str) -> str:
        low, high = values.get(f"{name}_interval") or (None, None)
        value = NOTHING if values.get(name) is None else f"{values[name]:.3g}"
        return value if low is None else f"{value} ({low:.3g} to {high:.3g})"

    compared = [("gap", f"{simulated}, unfiltered"), ("gap_inverse_60hz", "inverse model, 60 Hz")]
    if "band_hz" in document:  # both are the same
        compared = [("gap", f"{simulated}, below {document['band_hz']:.2g} Hz")]
    for key, word in compared:
        gap = document.get(key)
        for part, name in (("train", "training"), ("holdout", "held out")):
            if gap and gap.get(part):
                values = gap[part]
                rows.append([word, name, shown(values, "baseline"), shown(values, "extended"), shown(gap, "floor")])
    return Section(
        "The gap in numbers",
        Table(
            [
                f"{units.word('force')} error",
                "record",
                *(f"{name} [{newton} rms]" for name in ("baseline", "extended", "floor")),
            ],
            rows,
            "Both models have baseline parameters refitted to the training record; held-out data are never fitted. In "
            "brackets 95 % intervals, by a block bootstrap of each error.",
        ),
    )


def views_section(diagnosis: Diagnosis, units: Units) -> Section | None:
    """Return the section on the residual over each quantity, and its spectrum over time."""
    if len(diagnosis.views) < 2:
        return None
    spectrum = diagnosis.to_dict().get("spectrum_over_time")
    band = any(view.band is not None for view in diagnosis.views)
    caption = (
        "Residual of the original model, by frequency and time. A horizontal line is a hum, a line that follows the "
        "speed a ripple over position, a column an event."
    )
    blocks = [Picture(spectrum_figure(spectrum), caption, "Spectrum over time")] if spectrum else []
    return Section(
        "Residual over every quantity",
        Picture(
            views_figure(diagnosis.views),
            f"Mean residual {units.word('force')} of the original model and, with findings, of the extended one"
            + ("; the grey band is that of a healthy record. Values outside it are unexplained." if band else "."),
            "Residual over every quantity",
        ),
        *blocks,
    )


def limits_section(document: Mapping[str, Any]) -> Section | None:
    """Return the section on effects that may be present undetected, and their largest size."""
    limits = document.get("not_excluded") or ()
    if not limits:
        return None
    rows = [[entry.get("label") or words(entry["effect"]), entry["text"]] for entry in limits]
    return Section(
        "Effects that cannot be excluded",
        Table(
            ["effect", "would have been found from"],
            rows,
            "Each effect alone, at the median of the tested shapes; weaker effects may be present.",
        ),
    )


def model_file(document: Mapping[str, Any]) -> list[Line]:
    """Return a line that names the file of the model, if there is one."""
    if not document.get("model_file"):
        return []
    model = "with the effects found" if document["findings"] else "refitted to the records, without effects"
    return [Line(html("The model {}: <code>{}</code>. Every command accepts it.", model, document["model_file"]))]


def method_section(document: Mapping[str, Any], units: Units) -> Section:
    """Return the section on method, assumptions, warnings and inputs."""
    inputs = dict(document.get("inputs") or {r["name"]: r.get("sha256") for r in document.get("records", ())})
    return Section(
        "Method, warnings and inputs",
        Line(document["calibration"]) if document.get("calibration") else None,
        *(Line(assumption, "point") for assumption in document.get("assumptions", ())),
        *(Line(warning, "note") for warning in document.get("warnings", ())),
        inputs_table(inputs) if inputs else None,
        Line(versions()),
    )
