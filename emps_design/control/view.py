"""Views of loop designs: the verdict, gains, margins at each place, limits and structures.

They also show a suggested filter, the position loop around a velocity loop, the range of loads, the margins on measured
responses with their 95 % bands, and the force loop.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import Any

from emps_design.advice import where_in_words
from emps_design.control.margins import HERTZ, MARGINS, Row
from emps_design.units import Units
from emps_design.view import Cell, Line, Table, View

MEASURED: tuple[Row, ...] = (
    ("phase margin", "phase_margin_deg", "deg", 1.0),
    ("crossover", "crossover", "rad/s", 1.0),
    ("delay margin", "delay_margin", "ms", 1e3),
    ("gain margin", "gain_margin", "ratio", 1.0),
    ("disk margin", "disk_margin", "", 1.0),
    ("largest sensitivity, below", "sensitivity_peak_below", "ratio", 1.0),
    ("largest sensitivity, above", "sensitivity_peak_above", "ratio", 1.0),
)
CLOSED: tuple[Row, ...] = (
    ("bandwidth, -3 dB", "bandwidth", "rad/s", 1.0),
    ("", "bandwidth", "Hz", 1.0 / HERTZ),
)
UNDER_MISMATCH: tuple[Row, ...] = (
    ("phase margin", "phase_margin_deg", "deg", 1.0),
    ("crossover", "crossover", "rad/s", 1.0),
    ("", "crossover", "Hz", 1.0 / HERTZ),
    ("delay margin", "delay_margin", "ms", 1e3),
    ("gain margin", "gain_margin", "ratio", 1.0),
    *CLOSED,
)


def number(value: float | None, digits: int = 4, nothing: str = "unbounded") -> str:
    """A number with ``digits`` significant digits, ``nothing`` for None.

    >>> number(556.7656), number(None)
    ('556.8', 'unbounded')
    """
    return nothing if value is None else f"{value:.{digits}g}"


def gains_view(document: dict[str, Any], units: Units) -> View:
    """The view of the document of ``gains``."""
    return (
        verdict_line(document["stable"], what_is_judged(document)),
        Line(worst_in_words(document["worst_loop"], units)),
        _gains(document, units),
        *_margins(document),
        *_notes(document, units),
        *(mismatch_view(document["mismatch"], units) if "mismatch" in document else ()),
        Line("difference equation, every sample:"),
        *(Line(f"    {line}", "code") for line in document["difference_equation"]["lines"]),
        *([Line(f"axis file with this controller: {document['out']}", "code")] if "out" in document else []),
        *warning_lines(document["warnings"]),
        *(_suggestion(document["suggestion"], units) if "suggestion" in document else ()),
        *(_position_loop(document["position_loop"], units) if "position_loop" in document else ()),
        *(_kept_loops(document["kept_position_loop"]["loops"]) if "kept_position_loop" in document else ()),
        *(_load_range(document["load_range"], units) if "load_range" in document else ()),
        *_on_measured_plants(document.get("measured")),
    )


def velocity_loop_view(document: dict[str, Any], units: Units) -> View:
    """The view of the document of a velocity loop: stability, gains and margins."""
    return (
        verdict_line(document["sampled"]["stable"], what_is_judged(document)),
        _gains(document, units),
        *_margins(document),
        *warning_lines(document["warnings"]),
    )


def verdict_line(stable: bool, what: str) -> Line:
    """A line that says whether ``what`` is stable."""
    return Line(f"{what} is stable", "good") if stable else Line(f"{what} is UNSTABLE", "bad")


def warning_lines(warnings: list[str]) -> list[Line]:
    """One line for each of the ``warnings``."""
    return [Line(warning, "note") for warning in warnings]


def _gains(document: dict[str, Any], units: Units) -> Table:
    ideal = {} if document["retuned"] else document["requested"]
    rows: list[tuple[Cell, ...]] = [
        (label, number(scale * document[key], 6), units.unit(unit), "")
        for label, key, unit, scale in (
            ("k_v1, kp of a drive", "k_v1", "V/(m/s)", 1.0),
            ("t_v, Tn of a drive", "t_v", "ms", 1e3),
            ("K_v = k_v1 G_tau / t_v", "K_v", "N/m", 1.0),
        )
    ]
    lagged = [("with lags", document["continuous_with_lags"])] if len(document["closed_forms_leave_out"]) > 1 else []
    for words, reading in (("sampled", document["sampled"]["velocity_error"]), *lagged, ("ideal", document)):
        for label, key, unit in (("crossover", "crossover", "rad/s"), ("phase margin", "phase_margin_deg", "deg")):
            requested = number(ideal[key]) if key in ideal else ""
            missing = "unbounded" if reading.get("stable", True) else "unstable"
            rows.append((f"{label} of T_vo, {words}", number(reading[key], 6, missing), unit, requested))
    rows += [
        (label, number(scale * document[key], 6), unit, number(ideal[key]) if key in ideal else "")
        for label, key, unit, scale in (
            ("bandwidth of T_vc, ideal, -3 dB", "bandwidth", "rad/s", 1.0),
            ("natural frequency w_0v, ideal", "omega_0v", "rad/s", 1.0),
            ("", "omega_0v", "Hz", 1.0 / HERTZ),
            ("damping ratio z_v, ideal", "z_v", "", 1.0),
        )
    ]
    gains = "gains retuned for the sampled loop" if document["retuned"] else "gains by (7)"
    return Table(("", "value", "unit", "requested"), rows, f"Velocity loop, {gains}; ideal: closed forms")


def _margins(document: dict[str, Any]) -> list[Table]:
    """Margins at each place where the loop is broken, and the closed-loop bandwidth."""
    sampled, lagged = document["sampled"], document["continuous_with_lags"]
    lags = {"with lags": lagged} if len(document["closed_forms_leave_out"]) > 1 else {}
    at_error = {"sampled": sampled["velocity_error"], **lags, "ideal": document["velocity_error"]}
    at_plant = {"sampled": sampled, "ideal": document["plant_input"]}
    limits = document["requested"] if document["retuned"] else {}

    def limit(key: str, scale: float) -> list[str]:
        return [number(scale * limits[key]) if key in limits else ""] if limits else []

    def cell(place: dict[str, Any], key: str, scale: float) -> str:
        if key not in place:
            return ""
        unbounded = "none" if key == "gain_reduction_margin" else "unbounded"
        return _scaled(place[key], scale, unbounded if place["stable"] else "undefined")

    def table(broken: str, places: dict[str, dict[str, Any]], more: Iterable[Row] = ()) -> Table:
        rows = [
            (label, *(cell(place, key, scale) for place in places.values()), *limit(key, scale), unit)
            for label, key, unit, scale in (*MARGINS, *more)
            if key != "gain_reduction_margin" or any(place[key] is not None for place in places.values())
        ]
        return Table(("", *places, *(["requested"] if limits else []), "unit"), rows, f"Broken at the {broken}")

    at_plant["ideal"] = {**at_plant["ideal"], "bandwidth": document["bandwidth"]}
    return [table("plant input", at_plant, CLOSED), table("velocity error", at_error)]


def _scaled(value: float | None, scale: float, nothing: str, digits: int = 4) -> str:
    return nothing if value is None else number(scale * value, digits)


def _cell(value: float | None, scale: float = 1.0) -> str:
    return _scaled(value, scale, "-", 5)


def _notes(document: dict[str, Any], units: Units) -> Iterator[Line | Table]:
    """The assumptions of the columns, the structures, and the limits of margin, step and noise."""
    left_out = document["closed_forms_leave_out"]
    yield Line("sampled: the complete model" + "; with lags: without the sampling" * (len(left_out) > 1))
    yield Line(f"ideal: without {', '.join(left_out)}")
    yield _structures(document)
    if not document["retuned"]:  # the range is that of the gains of (7)
        low, high = document["feasible_phase_margin_deg"]
        yield Line(f"feasible phase margin at this crossover: {low:.4g} to {high:.4g} deg (open interval)")
    step, noise = document["largest_velocity_step"], document["encoder_voltage_noise"]
    if not step or not noise:
        return
    limit, per_unit, friction = (
        units.quantity(step[key], "V", spec)
        for key, spec in (("voltage_limit", "g"), ("peak_voltage_per_unit", ".4g"), ("dry_friction_voltage", ".3g"))
    )
    yield Line(
        f"largest velocity step before {limit}: {units.quantity(step['value'], 'm/s')} "
        f"({per_unit} per {units.unit('m/s')}, dry friction needs {friction})"
    )
    rms, one = (units.quantity(noise[key], "mV", ".3g") for key in ("rms", "one_step"))
    yield Line(f"{units.word('voltage')} noise due to the encoder: {rms} rms, {one} per step")


def what_is_judged(document: dict[str, Any]) -> str:
    """The subject of the verdict of ``gains``: the loops, and the plants on which they run."""
    parts = [f"{document['axis']}: sampled velocity loop, {structure_in_words(document)}"]
    if "position_loop" in document:
        parts.append("with the position loop around it")
    if "kept_position_loop" in document:
        parts.append("with the axis file's position loop around it")
    over = {"load_range": "the range of loads", "mismatch": "the mismatch"}
    parts += [f"over {words}" for key, words in over.items() if key in document]
    parts += ["on the measured plant"] if "measured" in document else []
    return f"{', '.join(parts)},"


def worst_in_words(worst: dict[str, Any], units: Units) -> str:
    """The worst loop of a design in words: its name, its plant, and its margins."""
    has = "unstable"
    if worst["stable"]:
        gain = number(worst["gain_margin"], 3)
        has = f"phase margin {number(worst['phase_margin_deg'], 3)} deg, gain margin {gain}"
    loop = (units.words(worst["name"]), where_in_words(worst.get("where", {}), units))
    return f"worst: {' '.join(filter(None, loop))}: {has}"


def structure_in_words(document: dict[str, Any]) -> str:
    """Structure and filters of a velocity loop in words.

    >>> filters = [{"kind": "lowpass", "frequency": 350.0}]
    >>> structure_in_words({"structure": "pi", "reference_filter": False, "filters": filters})
    'PI with lowpass 350 Hz'
    """
    parts = ["reference filter"] if document["reference_filter"] else []
    for table in document["filters"]:
        shape = f" (damping {table['damping']:g}, depth {table['depth']:g})" if table["kind"] == "notch" else ""
        parts.append(f"{table['kind']} {table['frequency']:g} Hz{shape}")
    return document["structure"].upper() + (f" with {', '.join(parts)}" if parts else "")


def _structures(document: dict[str, Any]) -> Table:
    """Bandwidth and overshoot of the same gains in each structure; > marks that of the design."""
    rows = []
    for row in document["structures"]:
        chosen = (row["structure"], row["reference_filter"]) == (document["structure"], document["reference_filter"])
        sampled = row["sampled"]
        cells = [f"{row['bandwidth'] / HERTZ:.4g} Hz", f"{row['overshoot_percent']:.3g} %"]
        if sampled:
            bandwidth = sampled["bandwidth"]
            cells.append("undefined" if bandwidth is None else f"{bandwidth / HERTZ:.4g} Hz")
            cells.append(f"{sampled['overshoot_percent']:.3g} %")
        else:
            cells += ["unstable"] * 2
        rows.append((f"{'>' if chosen else ' '} {row['label']}", *cells))
    return Table(("", "-3 dB", "overshoot", "sampled", "overshoot"), rows, "The same gains in each structure")


def mismatch_view(study: dict[str, Any], units: Units) -> View:
    """The margins of the same gains, and the gains by (7), over the corners of a mismatch."""
    named = {" ".join(map(units.word, name.split("_"))): share for name, share in study["errors"].items()}
    errors = ", ".join(f"{name} +-{100 * share:.3g} %" for name, share in named.items())
    rows = [
        (label, *(number(scale * value) for value in study[key]), unit)
        for label, key, unit, scale in UNDER_MISMATCH
        if study[key]
    ]
    if study["gains"]:
        rows.append(("k_v1 by (7)", *(number(value, 5) for value in study["gains"]["k_v1"]), units.unit("V/(m/s)")))
        rows.append(("t_v by (7)", *(number(1e3 * value, 5) for value in study["gains"]["t_v"]), "ms"))
    headings = ("sampled loop, same gains", "least", "most", "unit")
    worst = f"; {worst_in_words(study['worst_loop'], units)}" if "worst_loop" in study else ""
    return (
        Table(headings, rows, f"Mismatch: {errors}; {study['corners']} corners"),
        Line(f"stable at {100 * study['stable_share']:.4g} % of the corners{worst}"),
    )


def _suggestion(suggestion: dict[str, Any], units: Units) -> Iterator[Line | Table]:
    """The fastest loop with the same margins, without and with the suggested filter."""
    table_of_filter, sides = suggestion["filter"], [("without", suggestion["without"])]
    if table_of_filter is not None:
        loop = {"structure": "", "reference_filter": False, "filters": [table_of_filter]}
        words = structure_in_words(loop).removeprefix(" with ")
        sides += [(f"{words}, equal margins", suggestion["with_equal_margins"]), (words, suggestion["with"])]

    def row(label: str, unit: str, cell: Callable[[dict[str, Any]], str]) -> tuple[str, ...]:
        return (label, *(cell(side) for _, side in sides), unit)

    rows = [
        row(label, units.unit(unit), lambda side, key=key, scale=scale: _cell(side[key], scale))  # type: ignore[misc]
        for label, key, unit, scale in (
            ("crossover", "crossover", "Hz", 1.0 / HERTZ),
            ("", "crossover", "rad/s", 1.0),
            ("k_v1, kp of a drive", "k_v1", "V/(m/s)", 1.0),
            ("t_v, Tn of a drive", "t_v", "s", 1.0),
            ("bandwidth, -3 dB", "bandwidth", "rad/s", 1.0),
            ("noise of the command, rms", "command_noise", "V", 1.0),
        )
    ]
    for label, key in (("gain margin", "gain_margin"), ("disk margin", "disk_margin")):
        rows.append(row(label, "ratio", lambda side, key=key: _cell(side["margins"] and side["margins"][key])))  # type: ignore[misc]
    if "model" in suggestion:
        for label, key, unit in (
            ("on the data: phase margin", "phase_margin_deg", "deg"),
            ("gain margin", "gain_margin", "ratio"),
            ("disk margin", "disk_margin", "ratio"),
        ):
            rows.append(row(label, unit, lambda side, key=key: _on_data(side, key)))  # type: ignore[misc]
    margin, least = number(suggestion["phase_margin_deg"]), number(suggestion["gain_margin_at_least"])
    title = f"Fastest loop with {margin} deg and a gain margin of {least} or more"
    yield Table(("", *(name for name, _ in sides), "unit"), rows, title)
    if "model" in suggestion:
        yield Line(f"designed on {suggestion['model']}, then checked on the data")
    for name, side in sides:
        yield Line(f"binding limit, {name}: {side['limits']['binding']}")
    if suggestion.get("these_gains"):
        yield Line(suggestion["these_gains"])
    if table_of_filter is None:
        yield Line("no notch or low-pass increases the crossover by 10 %")


def _on_data(side: dict[str, Any], key: str) -> str:
    measured = side.get("measured")
    return "-" if measured is None else _cell(measured[key]) if measured["stable"] else "UNSTABLE"


def _position_loop(design: dict[str, Any], units: Units) -> Iterator[Line | Table]:
    """The position loop around the velocity loop, and its following errors."""
    ((requested, value),) = design["requested"].items()
    rate = "sample" if design["every"] == 1 else f"{design['every']} samples"
    rows: list[tuple[Cell, ...]] = [("kp", number(design["kp"], 6), "1/s", "")]
    for label, key, name, unit in (
        ("overshoot of a step", "overshoot_percent", "overshoot", "%"),
        ("bandwidth, -3 dB", "bandwidth", "bandwidth", "rad/s"),
        (f"stiffness against a {units.word('force')} step", "stiffness", "stiffness", units.unit("N/m")),
    ):
        rows.append((label, _cell(design[key]), unit, number(value) if name == requested else ""))
    for loop in design["loops"]:
        cells = [_cell(loop[key]) if loop["stable"] else "unstable" for key in ("phase_margin_deg", "gain_margin")]
        rows.append((f"{loop['name']}: phase margin", cells[0], "deg", ""))
        rows.append(("    gain margin", cells[1], "ratio", ""))
    yield Table(("", "value", "unit", "requested"), rows, f"Position loop, once every {rate}")
    if design["following_error"] is None:
        return
    headings = ("feed-forward", "along a velocity [s]", "an acceleration [s^2]", "a jerk [s^3]")
    errors = [
        (name, *(f"{error[key]:.3g}" for key in ("velocity", "acceleration", "jerk")))
        for name, error in design["following_error"].items()
    ]
    yield Table(headings, errors, "Following error")


def _kept_loops(loops: list[dict[str, Any]]) -> View:
    """The loops with the axis file's position loop."""
    rows = []
    shown = (("crossover", 1.0), ("phase_margin_deg", 1.0), ("gain_margin", 1.0), ("delay_margin", 1e3))
    for loop in loops:
        cells = [_cell(loop[key], scale) for key, scale in shown] if loop["stable"] else ["unstable", "", "", ""]
        rows.append((loop["name"], loop["broken"], *cells))
    headings = ("", "broken at the", "crossover [rad/s]", "phase [deg]", "gain", "delay [ms]")
    return (Table(headings, rows, "With the axis file's position loop around it"),)


def _load_range(load_range: dict[str, Any], units: Units) -> View:
    """Margins of the gains over the range of loads, and gains that meet the specification over it."""
    at, points = load_range["at"].replace("-", " "), load_range["points"]
    columns: list[tuple[str, str, Callable[[dict[str, Any]], dict[str, Any]]]] = [
        (f"{at}: phase", "phase_margin_deg", lambda point: point),
        ("crossover", "crossover", lambda point: point),
    ]
    if at != "plant input":
        columns.append(("plant input: phase", "phase_margin_deg", lambda point: point["plant_input"]))
    columns.append(("gain", "gain_margin", lambda point: point["plant_input"]))
    for place, loop in list(enumerate(points[0]["loops"]))[1:]:
        columns.append((f"{loop['name']}: phase", "phase_margin_deg", lambda p, place=place: p["loops"][place]))  # type: ignore[misc]
    several = [name for name in ("inertia", "compliance", "delay") if len({point[name] for point in points}) > 1]
    vary, rows = several or ["inertia"], []
    for point in points:
        margins = [(margins_of(point), key) for _, key, margins_of in columns]
        cells = [_cell(loop[key]) if loop["stable"] else "unstable" for loop, key in margins]
        values = {"inertia": number(point["inertia"]), "compliance": number(point["compliance"])}
        values["delay"] = f"{1e3 * point['delay']:.3g} ms"
        rows.append((*(values[name] for name in vary), *cells))
    schedule = [(number(step["inertia"]), step["gains"]) for step in load_range["schedule"]]
    holding = [
        (name, *([number(gains[key], 5) for key in ("k_v1", "t_v", "slowest_crossover")] if gains else ["none"] * 3))
        for name, gains in [("all", load_range["one"]), *schedule]
    ]
    headings = (
        "inertia",
        f"k_v1, kp [{units.unit('V/(m/s)')}]",
        "t_v, Tn [s]",
        f"slowest crossover at the {at} [rad/s]",
    )
    return (
        Table((*vary, *(name for name, _, _ in columns)), rows, "Margins of these gains over the range, sampled"),
        Table(headings, holding, "Gains that meet the specification"),
        Line(load_range["text"]),
    )


def _on_measured_plants(measured: dict[str, Any] | None) -> View:
    if measured is None:
        return ()
    loops = [(measured, "velocity loop")]
    loops += [(measured["whole_loop"], "whole loop")] if "whole_loop" in measured else []
    words = "in brackets: 95 % band from the deviations of the data; below, above: of the first antiresonance"
    return tuple(part for of_loop, name in loops for part in (_on_measured(of_loop, name), Line(words)))


def _on_measured(measured: dict[str, Any], loop: str) -> Table:
    """The margins of ``loop`` on measured responses."""
    responses, limits = measured["responses"], measured.get("requested", {})
    names = [response["name"] if response["stable"] else f"{response['name']}: UNSTABLE" for response in responses]
    several, rows = len(responses) > 1, []
    for label, key, unit, scale in MEASURED:
        if key not in limits and all(response[key] is None for response in responses):
            continue
        cells = [_with_band(response[key], response["bands"][key], scale) for response in responses]
        worst = [_with_band(measured[key], None, scale)] if several else []
        limit = [f"at most {limits[key]:.4g}" if key in limits else ""] if limits else []
        rows.append((label, *cells, *worst, unit, *limit))
    headings = ("", *names, *(["worst"] if several else []), "unit", *(["requested"] if limits else []))
    return Table(headings, rows, f"On the measured plant, {loop} at the plant input")


def _with_band(value: float | None, band: list[float] | None, scale: float) -> str:
    if value is None:
        return "-"
    return f"{scale * value:.4g}" + (f" [{scale * band[0]:.4g}, {scale * band[1]:.4g}]" if band else "")


def force_view(document: dict[str, Any], units: Units) -> View:
    """The view of the document of ``force``: stability, gains and operator, the limits of k_e1, margins, poles."""
    operator, limits, reading = document["operator"], document["k_e1_max"], document["paper_reading"]
    force = units.word("force")
    what = f"{document['axis']}: sampled {force} loop, with its velocity loop in contact and without,"
    rows = [
        (units.words(label), number(value, 5), units.unit(unit))
        for label, value, unit in (
            ("k_e1", document["k_e1"], "(m/s)/N"),
            ("k_c = 1/k_e1, apparent damping", document["k_c"], "N/(m/s)"),
            ("apparent mass, low-frequency match", document["apparent_mass"], "kg"),
            ("hand k_h", operator["hand"], "N/(m/s)"),
            ("environment K_env", operator["environment"], "N/m"),
        )
    ]
    by_place = [
        (units.words(label), *(number(limits[key][kind], 5) for kind in ("continuous", "sampled")))
        for label, key in (("sensor only", "sensor_only"), ("sensor and carriage", "sensor_and_carriage"))
    ]
    headings = (units.words("operator's force on"), "continuous, closed form", "sampled, by its poles")
    poles = ", ".join(f"{re:.4g}{im:+.4g}j" for re, im in document["continuous"]["poles"])
    paper = ", ".join(f"{re:.4g}" for re, _ in reading["poles"])
    return (
        verdict_line(document["stable"], what),
        Line(worst_in_words(document["worst_loop"], units)),
        Table(("", "value", "unit"), rows, f"{force.capitalize()} loop around {structure_in_words(document)}"),
        Table(headings, by_place, f"Largest k_e1 [{units.unit('(m/s)/N')}]"),
        Line(f"margins of the sampled {force} loop: {_in_one_line(document['margins'])}"),
        Line(f"continuous poles: {poles} rad/s"),
        Line(f"the paper's formulation, {reading['loop']}: poles {paper} rad/s"),
        Line(reading["text"]),
        Line(f"sign: {operator['sign']}"),
        *([Line(f"axis file with this controller: {document['out']}")] if "out" in document else []),
        *warning_lines(document["warnings"]),
    )


def _in_one_line(margins: dict[str, Any]) -> str:
    """The gain, phase and delay margins of a loop."""
    if not margins["stable"]:
        return "undefined, the loop is unstable"
    phase, crossover = number(margins["phase_margin_deg"]), margins["crossover"]
    at = f"phase {phase}: no crossover" if crossover is None else f"phase {phase} deg at {number(crossover)} rad/s"
    late = _scaled(margins["delay_margin"], 1e3, "unbounded")
    return f"gain {number(margins['gain_margin'])}, {at}, delay {late} ms"
