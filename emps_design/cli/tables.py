"""Text output of the design commands: tables with units, the specification beside what is achieved.

It covers the velocity loop, a suggested filter, the position loop around it, the range of loads, the force loop, and
the margins on measured responses with their 95 % bands.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from rich.table import Table
from rich.text import Text

from emps_design.cli.output import new_console
from emps_design.errors import one_line

if TYPE_CHECKING:
    from rich.console import Console

HERTZ = 2.0 * math.pi

ROWS = (
    ("phase margin", "phase_margin_deg", "deg", 1.0),
    ("crossover", "crossover", "rad/s", 1.0),
    ("delay margin", "delay_margin", "ms", 1e3),
    ("gain margin", "gain_margin", "ratio", 1.0),
    ("disk margin", "disk_margin", "", 1.0),
    ("largest sensitivity, below", "sensitivity_peak_below", "ratio", 1.0),
    ("largest sensitivity, above", "sensitivity_peak_above", "ratio", 1.0),
)


def number(value: float | None, digits: int = 4, nothing: str = "unbounded") -> str:
    """Return a number with ``digits`` significant digits, ``nothing`` for None.

    >>> number(556.7656), number(None)
    ('556.8', 'unbounded')
    """
    return nothing if value is None else f"{value:.{digits}g}"


def print_gains(document: dict[str, Any]) -> None:
    """Print the document of ``gains``: the verdict first, then gains, margins at each place, limits and structures."""
    console = new_console()
    sampled = document["sampled"]
    console.print(_verdict(document["stable"], what_is_judged(document)), soft_wrap=True)
    console.print(worst_in_words(document["worst_loop"]), highlight=False, soft_wrap=True)

    left_out, lagged = document["closed_forms_leave_out"], document["continuous_with_lags"]
    places = [("sampled,\nplant\ninput", sampled)]
    places += [("with lags,\nvelocity\nerror", lagged)] if len(left_out) > 1 else []
    places += [
        ("ideal,\nvelocity\nerror", document["velocity_error"]),
        ("ideal,\nplant\ninput", document["plant_input"]),
    ]

    gains = new_table("Velocity loop; ideal: closed forms", "", "value", "unit", "requested")
    ideal = {} if document["retuned"] else document["requested"]
    for label, key, unit in (
        ("k_v1, kp of a drive", "k_v1", "V/(m/s)"),
        ("t_v, Tn of a drive", "t_v", "s"),
        ("K_v = k_v1 G_tau / t_v", "K_v", "N/m"),
    ):
        gains.add_row(label, number(document[key], 6), unit, "")
    readings = [("sampled", sampled["velocity_error"]), *([("with lags", lagged)] if len(left_out) > 1 else [])]
    for words, reading in (*readings, ("ideal", document)):
        for label, key, unit in (("crossover", "crossover", "rad/s"), ("phase margin", "phase_margin_deg", "deg")):
            requested = number(ideal[key]) if key in ideal else ""
            missing = "unbounded" if reading.get("stable", True) else "unstable"
            gains.add_row(f"{label} of T_vo, {words}", number(reading[key], 6, missing), unit, requested)
    for label, key, unit in (
        ("bandwidth of T_vc, ideal, -3 dB", "bandwidth", "rad/s"),
        ("natural frequency w_0v, ideal", "omega_0v", "rad/s"),
        ("damping ratio z_v, ideal", "z_v", ""),
    ):
        gains.add_row(label, number(document[key], 6), unit, number(ideal[key]) if key in ideal else "")
    console.print(gains)

    sampled_limits = document["requested"] if document["retuned"] else {}
    heading = ["asked"] if sampled_limits else []
    margins = new_table("Margins of the velocity loop", "", *(name for name, _ in places), *heading, "unit")
    margins.columns[0].no_wrap = True
    unlimited = {"gain_reduction_margin": "none"}
    for label, key, unit, scale in (
        ("phase margin", "phase_margin_deg", "deg", 1.0),
        ("crossover", "crossover", "rad/s", 1.0),
        ("", "crossover", "Hz", 0.5 / math.pi),
        ("delay margin", "delay_margin", "ms", 1e3),
        ("", "delay_margin_samples", "samples", 1.0),
        ("gain margin", "gain_margin", "ratio", 1.0),
        ("", "gain_margin_db", "dB", 1.0),
        ("least stable gain", "gain_reduction_margin", "ratio", 1.0),
        ("disk margin", "disk_margin", "", 1.0),
    ):
        cells = [
            ""
            if key not in place
            else number(
                None if place[key] is None else scale * place[key],
                nothing=unlimited.get(key, "unbounded") if place["stable"] else "undefined",
            )
            for _, place in places
        ]
        if key != "gain_reduction_margin" or any(place[key] is not None for _, place in places):
            limit = [number(scale * sampled_limits[key]) if key in sampled_limits else ""] if sampled_limits else []
            margins.add_row(label, *cells, *limit, unit)
    for unit, scale in (("rad/s", 1.0), ("Hz", 0.5 / math.pi)):
        bandwidth = sampled["bandwidth"]
        own = number(bandwidth and scale * bandwidth, nothing="unbounded" if sampled["stable"] else "undefined")
        cells = [own, *[""] * (len(places) - 3), number(scale * document["bandwidth"]), ""]
        limit = [number(scale * sampled_limits["bandwidth"]) if "bandwidth" in sampled_limits else ""]
        cells += limit if sampled_limits else []
        margins.add_row("bandwidth, -3 dB" if unit == "rad/s" else "", *cells, unit)
    console.print(margins)
    console.print("sampled: everything is in it" + "; with lags: without the sampling" * (len(left_out) > 1))
    console.print(f"ideal: without {', '.join(left_out)}", highlight=False, soft_wrap=True)
    _print_structures(console, document)
    low, high = document["feasible_phase_margin_deg"]
    console.print(f"feasible phase margin at this crossover: {low:.4g} to {high:.4g} deg (open interval)")

    step, noise = document["largest_velocity_step"], document["encoder_voltage_noise"]
    if step and noise:
        console.print(
            f"largest velocity step before {step['voltage_limit']:g} V: {number(step['value'])} m/s "
            f"({number(step['peak_voltage_per_unit'])} V per m/s, dry friction takes "
            f"{number(step['dry_friction_voltage'], 3)} V)"
        )
        console.print(
            f"voltage noise of the encoder: {number(1e3 * noise['rms'], 3)} mV rms, "
            f"{number(1e3 * noise['one_step'], 3)} mV per step"
        )
    if "mismatch" in document:
        _print_mismatch(console, document["mismatch"])
    console.print("\ndifference equation, every sample:")
    for line in document["difference_equation"]["lines"]:
        console.print(f"    {line}", highlight=False)
    if "out" in document:
        console.print(f"axis file with this controller: {document['out']}", soft_wrap=True)
    _print_warnings(console, document["warnings"])


def what_is_judged(document: dict[str, Any]) -> str:
    """Return the subject of the verdict of ``gains``: the loops, and the machines on which they run."""
    parts = [f"{document['axis']}: sampled velocity loop, {loop_in_words(document)}"]
    if "position_loop" in document:
        parts.append("with the position loop around it")
    if "kept_position_loop" in document:
        parts.append("with the axis file's position loop around it")
    over = {"load_range": "the range of loads", "mismatch": "the mismatch"}
    parts += [f"over {words}" for key, words in over.items() if key in document]
    parts += ["on the measured plant"] if "measured" in document else []
    return f"{', '.join(parts)},"


def worst_in_words(worst: dict[str, Any]) -> str:
    """Return the worst loop of a design in words: its name, the machine it is on, and its margins."""
    from emps_design.control.nested_loops import where_in_words

    has = "unstable"
    if worst["stable"]:
        gain = number(worst["gain_margin"], 3)
        has = f"phase margin {number(worst['phase_margin_deg'], 3)} deg, gain margin {gain}"
    return f"worst: {' '.join(filter(None, (worst['name'], where_in_words(worst.get('where', {})))))}: {has}"


def loop_in_words(document: dict[str, Any]) -> str:
    """Return structure and filters of a velocity loop in words.

    >>> filters = [{"kind": "lowpass", "frequency": 350.0}]
    >>> loop_in_words({"structure": "pi", "reference_filter": False, "filters": filters})
    'PI with lowpass 350 Hz'
    """
    parts = ["reference filter"] if document["reference_filter"] else []
    for table in document["filters"]:
        shape = f" (damping {table['damping']:g}, depth {table['depth']:g})" if table["kind"] == "notch" else ""
        parts.append(f"{table['kind']} {table['frequency']:g} Hz{shape}")
    return document["structure"].upper() + (f" with {', '.join(parts)}" if parts else "")


def _print_structures(console: Console, document: dict[str, Any]) -> None:
    """Print bandwidth and overshoot of the same gains in each structure, with a mark at that of the design."""
    table = new_table("The same gains in each structure", "", "-3 dB", "overshoot", "sampled", "overshoot")
    for row in document["structures"]:
        own = (row["structure"], row["reference_filter"]) == (document["structure"], document["reference_filter"])
        sampled = row["sampled"]
        cells = [f"{row['bandwidth'] / (2.0 * math.pi):.4g} Hz", f"{row['overshoot_percent']:.3g} %"]
        if sampled:
            bandwidth = sampled["bandwidth"]
            cells.append("undefined" if bandwidth is None else f"{bandwidth / (2.0 * math.pi):.4g} Hz")
            cells.append(f"{sampled['overshoot_percent']:.3g} %")
        else:
            cells += ["unstable"] * 2
        table.add_row(f"{'>' if own else ' '} {row['label']}", *cells)
    console.print(table)


def _print_mismatch(console: Console, study: dict[str, Any]) -> None:
    errors = ", ".join(f"{name} +-{100 * share:.3g} %" for name, share in study["errors"].items())
    table = new_table(
        f"Mismatch: {errors}; {study['corners']} corners", "sampled loop, same gains", "least", "most", "unit"
    )
    for label, key, unit, scale in (
        ("phase margin", "phase_margin_deg", "deg", 1.0),
        ("crossover", "crossover", "rad/s", 1.0),
        ("delay margin", "delay_margin", "ms", 1e3),
        ("gain margin", "gain_margin", "ratio", 1.0),
        ("bandwidth, -3 dB", "bandwidth", "rad/s", 1.0),
    ):
        if study[key]:
            table.add_row(label, *(number(scale * value) for value in study[key]), unit)
    if study["gains"]:
        table.add_row("k_v1 by (7)", *(number(value, 5) for value in study["gains"]["k_v1"]), "V/(m/s)")
        table.add_row("t_v by (7)", *(number(1e3 * value, 5) for value in study["gains"]["t_v"]), "ms")
    console.print(table)
    console.print(
        f"stable at {100 * study['stable_share']:.4g} % of the corners; {worst_in_words(study['worst_loop'])}"
    )


def _verdict(stable: bool, what: str) -> Text:
    state, colour = ("stable", "green") if stable else ("UNSTABLE", "red")
    return Text(f"{one_line(what)} is {state}", f"bold {colour}")


def new_table(title: str, *columns: str) -> Table:
    """Return a table with numbers in all columns but the first and the units."""
    table = Table(title=title, min_width=len(title), title_justify="left", title_style="bold", header_style="")
    for place, column in enumerate(columns):
        numeric = place > 0 and column not in ("unit",)
        table.add_column(column, justify="right" if numeric else "left")
    return table


def _print_warnings(console: Console, warnings: list[str]) -> None:
    for warning in warnings:
        console.print(f"note: {warning}", highlight=False, soft_wrap=True)


def print_around(document: dict[str, Any]) -> None:
    """Print the parts of the document of ``gains`` beyond the velocity loop, as far as they were requested."""
    if "suggestion" in document:
        _print_suggestion(document["suggestion"])
    if "position_loop" in document:
        _print_position_loop(document["position_loop"])
    if "kept_position_loop" in document:
        _print_kept_loops(document["kept_position_loop"]["loops"])
    if "load_range" in document:
        _print_load_range(document["load_range"])


def _print_suggestion(suggestion: dict[str, Any]) -> None:
    console = new_console()
    table_of_filter, sides = suggestion["filter"], [("without", suggestion["without"])]
    if table_of_filter is not None:
        loop = {"structure": "", "reference_filter": False, "filters": [table_of_filter]}
        words = loop_in_words(loop).removeprefix(" with ")
        sides += [(f"{words}, equal margins", suggestion["with_equal_margins"]), (words, suggestion["with"])]
    least = number(suggestion["gain_margin_at_least"])
    title = f"Fastest loop with {number(suggestion['phase_margin_deg'])} deg and a gain margin of {least} or more"
    table = new_table(title, "", *(name for name, _ in sides), "unit")
    for label, key, unit, scale in (
        ("crossover", "crossover", "Hz", 1.0 / HERTZ),
        ("", "crossover", "rad/s", 1.0),
        ("k_v1, kp of a drive", "k_v1", "V/(m/s)", 1.0),
        ("t_v, Tn of a drive", "t_v", "s", 1.0),
        ("bandwidth, -3 dB", "bandwidth", "rad/s", 1.0),
        ("noise of the command, rms", "command_noise", "V", 1.0),
    ):
        table.add_row(label, *(_cell(side[key], scale) for _, side in sides), unit)
    for label, key in (("gain margin", "gain_margin"), ("disk margin", "disk_margin")):
        table.add_row(label, *(_cell(side["margins"] and side["margins"][key], 1.0) for _, side in sides), "ratio")
    if "model" in suggestion:
        for label, key, unit in (
            ("on the data: phase margin", "phase_margin_deg", "deg"),
            ("gain margin", "gain_margin", "ratio"),
            ("disk margin", "disk_margin", "ratio"),
        ):
            table.add_row(label, *(_on_data(side, key) for _, side in sides), unit)
    console.print(table)
    if "model" in suggestion:
        console.print(f"found on {suggestion['model']}, then tried on the data", highlight=False, soft_wrap=True)
    for name, side in sides:
        console.print(f"what binds first, {name}: {side['limits']['binding']}", highlight=False, soft_wrap=True)
    if suggestion.get("these_gains"):
        console.print(suggestion["these_gains"], highlight=False, soft_wrap=True)
    if table_of_filter is None:
        console.print("no notch or low-pass makes it a tenth faster")


def _on_data(side: dict[str, Any], key: str) -> str:
    measured = side.get("measured")
    return "-" if measured is None else _cell(measured[key], 1.0) if measured["stable"] else "UNSTABLE"


def _print_position_loop(design: dict[str, Any]) -> None:
    console = new_console()
    ((requested, value),) = design["requested"].items()
    rate = "sample" if design["every"] == 1 else f"{design['every']} samples"
    table = new_table(f"Position loop, once every {rate}", "", "value", "unit", "requested")
    table.add_row("kp", number(design["kp"], 6), "1/s", "")
    for label, key, name, unit in (
        ("overshoot of a step", "overshoot_percent", "overshoot", "%"),
        ("bandwidth, -3 dB", "bandwidth", "bandwidth", "rad/s"),
        ("step of force over displacement", "stiffness", "stiffness", "N/m"),
    ):
        table.add_row(label, _cell(design[key], 1.0), unit, number(value) if name == requested else "")
    for loop in design["loops"]:
        cells = [_cell(loop[key], 1.0) if loop["stable"] else "unstable" for key in ("phase_margin_deg", "gain_margin")]
        table.add_row(f"{loop['name']}: phase margin", cells[0], "deg", "")
        table.add_row("    gain margin", cells[1], "ratio", "")
    console.print(table)
    if design["following_error"] is None:
        return
    errors = new_table(
        "Following error", "feed-forward", "along a velocity [s]", "an acceleration [s^2]", "a jerk [s^3]"
    )
    for name, error in design["following_error"].items():
        errors.add_row(name, *(f"{error[key]:.3g}" for key in ("velocity", "acceleration", "jerk")))
    console.print(errors)


def _print_kept_loops(loops: list[dict[str, Any]]) -> None:
    headings = ("", "broken at the", "phase [deg]", "gain", "delay [ms]")
    table = new_table("With the axis file's position loop around it", *headings)
    for loop in loops:
        shown = (("phase_margin_deg", 1.0), ("gain_margin", 1.0), ("delay_margin", 1e3))
        cells = [_cell(loop[key], scale) for key, scale in shown] if loop["stable"] else ["unstable", "", ""]
        table.add_row(loop["name"], loop["broken"], *cells)
    new_console().print(table)


def _print_load_range(load_range: dict[str, Any]) -> None:
    console, at, points = new_console(), load_range["at"].replace("-", " "), load_range["points"]
    columns = [
        (f"{at}: phase", "phase_margin_deg", lambda point: point),
        ("crossover", "crossover", lambda point: point),
        *([] if at == "plant input" else [("plant input: phase", "phase_margin_deg", lambda p: p["plant_input"])]),
        ("gain", "gain_margin", lambda point: point["plant_input"]),
        *[
            (f"{loop['name']}: phase", "phase_margin_deg", lambda point, place=place: point["loops"][place])
            for place, loop in enumerate(points[0]["loops"])
            if place > 0
        ],
    ]
    title = "Margins of these gains over the range, sampled"
    vary = [name for name in ("inertia", "compliance", "delay") if len({point[name] for point in points}) > 1]
    table = new_table(title, *(vary or ["inertia"]), *(name for name, _, _ in columns))
    for point in points:
        margins = [(margins_of(point), key) for _, key, margins_of in columns]
        cells = [_cell(loop[key], 1.0) if loop["stable"] else "unstable" for loop, key in margins]
        values = {"inertia": number(point["inertia"]), "compliance": number(point["compliance"])}
        values["delay"] = f"{1e3 * point['delay']:.3g} ms"
        table.add_row(*(values[name] for name in vary or ["inertia"]), *cells)
    console.print(table)
    crossover = f"slowest crossover at the {at} [rad/s]"
    table = new_table("Gains that hold", "inertia", "k_v1, kp [V/(m/s)]", "t_v, Tn [s]", crossover)
    schedule = [(number(step["inertia"]), step["gains"]) for step in load_range["schedule"]]
    for name, gains in [("all", load_range["one"]), *schedule]:
        cells = [number(gains[key], 5) for key in ("k_v1", "t_v", "slowest_crossover")] if gains else ["none"] * 3
        table.add_row(name, *cells)
    console.print(table)
    console.print(load_range["text"], highlight=False, soft_wrap=True)


def _cell(value: float | None, scale: float) -> str:
    return "-" if value is None else number(scale * value, 5)


def print_measured(measured: dict[str, Any], loop: str = "velocity loop") -> None:
    """Print the margins of ``loop`` on measured responses: ``measured`` is the document of ``gains`` on them."""
    from rich import box

    console = new_console()
    title = f"On the measured plant, {loop} at the plant input"
    table = Table(title=title, title_justify="left", box=box.SIMPLE)
    table.add_column("")
    responses = measured["responses"]
    for response in responses:
        table.add_column(response["name"] if response["stable"] else f"{response['name']}: UNSTABLE", justify="right")
    if len(responses) > 1:
        table.add_column("worst", justify="right")
    table.add_column("unit")
    limits = measured.get("requested", {})
    if limits:
        table.add_column("asked for", justify="right")
    for label, key, unit, scale in ROWS:
        if key not in limits and all(response[key] is None for response in responses):
            continue
        cells = [_with_band(response[key], response["bands"][key], scale) for response in responses]
        worst = [_with_band(measured[key], None, scale)] if len(responses) > 1 else []
        limit = [f"at most {limits[key]:.4g}" if key in limits else ""] if limits else []
        table.add_row(label, *cells, *worst, unit, *limit)
    console.print(table)
    console.print("in brackets: 95 % band from the data's deviations; below, above: the first antiresonance")


def _with_band(value: float | None, band: list[float] | None, scale: float) -> str:
    if value is None:
        return "-"
    return f"{scale * value:.4g}" + (f" [{scale * band[0]:.4g}, {scale * band[1]:.4g}]" if band else "")
