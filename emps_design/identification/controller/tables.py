"""A fit as the ``[controller]`` table of an axis file: kind, numbers by name, and what no kind of law here has."""

from __future__ import annotations

from typing import Any

from emps_design.identification.controller.estimators import sought
from emps_design.identification.controller.estimators import table_of as estimator_table
from emps_design.identification.controller.fit import Fit
from emps_design.laws.estimators import NUMBERS, Estimator

AHEAD = ("velocity", "acceleration", "coulomb")  # the feed-forward, in the order of the table


def kind_of(found: Fit, velocity_reference: bool) -> str:
    """Kind of the law in an axis file, "" where no law of the package has these terms."""
    s = found.structure
    plain = not (s.acceleration or s.coulomb or found.filters) and found.timing.every == 1
    plain = plain and not found.timing.profile
    if not s.velocity:
        return "p" if plain and not s.form else ""
    if velocity_reference:
        return "" if s.position or s.force else "cascade"
    if s.position:
        return "" if s.force else "position_pd" if plain and not s.form and s.share == 0 else "cascade"
    if s.form != "ip" or not plain or s.share != 1:
        return ""
    # With the backward difference the integral of the velocity error is the position error: one law, two kinds.
    return "position_pd" if found.timing.velocity_estimator == "backward" and not s.force else "ip_velocity"


def numbers_of(found: Fit, velocity_reference: bool) -> dict[str, float]:
    """The numbers of the law by their place in the table, such as "position.kp"."""
    kind, s = kind_of(found, velocity_reference), found.structure
    part = dict(zip(s.linear, map(float, found.linear), strict=True))
    estimated, estimator = {}, found.timing.velocity_estimator
    if s.velocity and isinstance(estimator, Estimator) and sought(estimator):
        estimated = {f"velocity_estimator.{NUMBERS[estimator.kind]}": estimator.number}
    gain, rate = found.gain, found.position_rate
    if kind == "p":
        return {"kp": part["position"]}
    if kind == "position_pd":
        return {"kp": rate if s.position else found.wi, "kv": gain} | estimated
    if kind == "ip_velocity":
        own = {"k_v1": gain, "t_v": 1.0 / found.wi}
        return own | ({"k_e1": part["force"] / gain} if s.force else {}) | estimated
    numbers = {"position.kp": rate} if s.position else {}
    numbers["velocity.kp"] = gain
    if s.form:
        numbers["velocity.ti"] = 1.0 / found.wi
    if s.share is None:
        numbers["feedforward.velocity"] = part["following"] / gain
    numbers |= {f"feedforward.{name}": part[name] for name in ("acceleration", "coulomb") if name in part}
    numbers |= estimated
    for i, one in enumerate(found.filters):
        numbers |= {f"filters.{i}.{name}": value for name, value in zip(one.names, one.values, strict=True)}
    return numbers


def table_of(found: Fit, velocity_reference: bool, numbers: dict[str, float], holds: bool) -> dict[str, Any]:
    """The ``[controller]`` table with these ``numbers``; ``holds`` says that the integral holds at the limit."""
    kind = kind_of(found, velocity_reference)
    table: dict[str, Any] = {"kind": kind}
    if kind == "cascade" and not velocity_reference:
        table["position"] = {"kp": numbers["position.kp"], "every": found.timing.every}
    if kind != "cascade":
        table |= {name: value for name, value in numbers.items() if "." not in name}
    else:
        table["velocity"] = nested(numbers, "velocity")
        if found.structure.form:
            table["velocity"]["form"] = found.structure.form
        ahead = nested(numbers, "feedforward")
        if found.structure.share == 1 and not velocity_reference:
            ahead["velocity"] = 1.0
        if ahead:
            table["feedforward"] = {name: ahead[name] for name in AHEAD if name in ahead}
            if found.timing.profile and "velocity" in ahead:
                table["feedforward"]["source"] = "profile"
        if found.filters:
            filters = enumerate(found.filters)
            table["filters"] = [{"kind": one.kind, **nested(numbers, f"filters.{i}")} for i, one in filters]
        if found.structure.form:
            table["anti_windup"] = "hold" if holds else "none"
    if kind not in ("p",):
        estimator = found.timing.velocity_estimator
        (number,) = nested(numbers, "velocity_estimator").values() or (None,)
        table["velocity_estimator"] = estimator_table(estimator, number)
    return table


def deviations_of(found: Fit, stds: dict[str, float]) -> dict[str, Any]:
    """The deviations in the shape of the table."""
    table: dict[str, Any] = {}
    for name, std in stds.items():
        head, _, rest = name.partition(".")
        if head == "filters":
            i, _, leaf = rest.partition(".")
            table.setdefault("filters", [{} for _ in found.filters])[int(i)][leaf] = std
        elif rest:
            table.setdefault(head, {})[rest] = std
        else:
            table[head] = std
    return table


def nested(numbers: dict[str, float], head: str) -> dict[str, Any]:
    """The numbers below ``head``, by the rest of their names."""
    return {name.removeprefix(f"{head}."): value for name, value in numbers.items() if name.startswith(f"{head}.")}
