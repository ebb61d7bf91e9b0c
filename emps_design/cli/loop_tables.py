"""Text output of what stands around a velocity loop: a filter that pays, a position loop, a range of loads."""

from __future__ import annotations

import math
from typing import Any

from emps_design.cli.design_tables import loop_in_words, new_table, number
from emps_design.cli.output import new_console

HERTZ = 2.0 * math.pi


def print_around(document: dict[str, Any]) -> None:
    """Print what ``gains`` found around its velocity loop, where that was asked for."""
    if "suggestion" in document:
        _print_suggestion(document["suggestion"])
    if "position_loop" in document:
        _print_position_loop(document["position_loop"])
    if "kept_position_loop" in document:
        _print_kept_loops(document["kept_position_loop"]["loops"])
    if "load_range" in document:
        _print_load_range(document["load_range"])


def _print_suggestion(found: dict[str, Any]) -> None:
    console = new_console()
    one, sides = found["filter"], [("without", found["without"])]
    if one is not None:
        words = loop_in_words({"structure": "", "reference_filter": False, "filters": [one]}).removeprefix(" with ")
        sides += [(f"{words}, equal margins", found["with_equal_margins"]), (words, found["with"])]
    least = number(found["gain_margin_at_least"])
    title = f"Fastest loop with {number(found['phase_margin_deg'])} deg and a gain margin of {least} or more"
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
    if "model" in found:
        for label, key, unit in (
            ("on the data: phase margin", "phase_margin_deg", "deg"),
            ("gain margin", "gain_margin", "ratio"),
            ("disk margin", "disk_margin", "ratio"),
        ):
            table.add_row(label, *(_on_data(side, key) for _, side in sides), unit)
    console.print(table)
    if "model" in found:
        console.print(f"found on {found['model']}, then tried on the data", highlight=False, soft_wrap=True)
    for name, side in sides:
        console.print(f"what binds first, {name}: {side['limits']['binding']}", highlight=False, soft_wrap=True)
    if found.get("these_gains"):
        console.print(found["these_gains"], highlight=False, soft_wrap=True)
    if one is None:
        console.print("no notch or low-pass makes it a tenth faster")


def _on_data(side: dict[str, Any], key: str) -> str:
    measured = side.get("measured")
    return "-" if measured is None else _cell(measured[key], 1.0) if measured["stable"] else "UNSTABLE"


def _print_position_loop(found: dict[str, Any]) -> None:
    console = new_console()
    ((wanted, value),) = found["requested"].items()
    rate = "sample" if found["every"] == 1 else f"{found['every']} samples"
    table = new_table(f"Position loop, once every {rate}", "", "value", "unit", "requested")
    table.add_row("kp", number(found["kp"], 6), "1/s", "")
    for label, key, name, unit in (
        ("overshoot of a step", "overshoot_percent", "overshoot", "%"),
        ("bandwidth, -3 dB", "bandwidth", "bandwidth", "rad/s"),
        ("step of force over displacement", "stiffness", "stiffness", "N/m"),
    ):
        table.add_row(label, _cell(found[key], 1.0), unit, number(value) if name == wanted else "")
    for one in found["loops"]:
        cells = [_cell(one[key], 1.0) if one["stable"] else "unstable" for key in ("phase_margin_deg", "gain_margin")]
        table.add_row(f"{one['name']}: phase margin", cells[0], "deg", "")
        table.add_row("    gain margin", cells[1], "ratio", "")
    console.print(table)
    if found["following_error"] is None:
        return
    errors = new_table(
        "Following error", "feed-forward", "along a velocity [s]", "an acceleration [s^2]", "a jerk [s^3]"
    )
    for name, one in found["following_error"].items():
        errors.add_row(name, *(f"{one[key]:.3g}" for key in ("velocity", "acceleration", "jerk")))
    console.print(errors)


def _print_kept_loops(loops: list[dict[str, Any]]) -> None:
    headings = ("", "broken at the", "phase [deg]", "gain", "delay [ms]")
    table = new_table("With the axis file's position loop around it", *headings)
    for one in loops:
        shown = (("phase_margin_deg", 1.0), ("gain_margin", 1.0), ("delay_margin", 1e3))
        cells = [_cell(one[key], scale) for key, scale in shown] if one["stable"] else ["unstable", "", ""]
        table.add_row(one["name"], one["broken"], *cells)
    new_console().print(table)


def _print_load_range(found: dict[str, Any]) -> None:
    console, at = new_console(), found["at"].replace("-", " ")
    columns = [
        (f"{at}: phase", "phase_margin_deg", lambda one: one),
        ("crossover", "crossover", lambda one: one),
        *([] if at == "plant input" else [("plant input: phase", "phase_margin_deg", lambda one: one["plant_input"])]),
        ("gain", "gain_margin", lambda one: one["plant_input"]),
        *[
            (f"{loop['name']}: phase", "phase_margin_deg", lambda one, place=place: one["loops"][place])
            for place, loop in enumerate(found["points"][0]["loops"])
            if place > 0
        ],
    ]
    title = "Margins of these gains over the range, sampled"
    vary = [name for name in ("inertia", "compliance", "delay") if len({one[name] for one in found["points"]}) > 1]
    table = new_table(title, *(vary or ["inertia"]), *(name for name, _, _ in columns))
    for one in found["points"]:
        places = [(place(one), key) for _, key, place in columns]
        cells = [_cell(place[key], 1.0) if place["stable"] else "unstable" for place, key in places]
        values = {"inertia": number(one["inertia"]), "compliance": number(one["compliance"])}
        values["delay"] = f"{1e3 * one['delay']:.3g} ms"
        table.add_row(*(values[name] for name in vary or ["inertia"]), *cells)
    console.print(table)
    crossover = f"slowest crossover at the {at} [rad/s]"
    gains = new_table("Gains that hold", "inertia", "k_v1, kp [V/(m/s)]", "t_v, Tn [s]", crossover)
    for name, one in [("all", found["one"]), *((number(step["inertia"]), step["gains"]) for step in found["schedule"])]:
        cells = [number(one[key], 5) for key in ("k_v1", "t_v", "slowest_crossover")] if one else ["none"] * 3
        gains.add_row(name, *cells)
    console.print(gains)
    console.print(found["text"], highlight=False, soft_wrap=True)


def _cell(value: float | None, scale: float) -> str:
    return "-" if value is None else number(scale * value, 5)
