"""What the assessment of an impedance law shows: the verdict first, then the law, what is felt, and the mismatch."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from emps_design.comanipulation.study import CALM
from emps_design.units import Units
from emps_design.view import Line, Table, View


def impedance_view(document: dict[str, Any], units: Units) -> View:
    """What the document of ``impedance`` shows."""
    return tuple(_parts(document, units))


def _parts(document: dict[str, Any], units: Units) -> Iterator[Line | Table]:
    sampled, study = document["sampled"], document.get("mismatch")
    name, _, why = document["headline"].partition(": ")
    yield Line(f"{name if document['verdict'] in CALM else name.upper()}: {why}")
    yield Line(f"{document['axis']}: impedance law {law_in_words(document['law'], units)}")
    yield Line(f"exact estimates: poles of the sampled loop {'stable' if sampled['stable'] else 'UNSTABLE'}")
    released, simulated = (_spaced(sampled[key]) for key in ("verdict", "simulated"))
    yield Line(f"released: {released}; simulated with encoder and limit: {simulated}")
    yield _felt(document, units)
    if study is not None:
        yield from _under_mismatch(study, units)
    loop = document["equivalent_loop"]
    if loop["k_e1"] is not None:
        stable = "stable" if loop["sampled"]["stable"] else "UNSTABLE"
        gain = f"k_e1 = {loop['k_e1']:g} {units.unit('(m/s)/N')}"
        yield Line(f"equivalent cascaded loop, {stable} when sampled ({_spaced(loop['criterion'])}): {gain}")
        for warning in loop["warnings"]:
            if warning not in document["warnings"]:
                yield Line(f"- {warning}")
    for warning in document["warnings"]:
        yield Line(f"- {warning}")


def _felt(document: dict[str, Any], units: Units) -> Table:
    """Apparent mass, damping and Coulomb friction with an ideal current loop."""
    columns = {
        "apparent_mass": "mass [kg]",
        "apparent_damping": "damping [N/(m/s)]",
        "coulomb_left": "Coulomb left [N]",
    }
    places = {"derived": "derived", "(30) as printed": "printed"}
    if document["law"]["force_sensor"]:
        places = {f"(28), measured {units.word('force')}": "felt"}
    rows = [(label, *(_three_digits(document[place][key]) for key in columns)) for label, place in places.items()]
    return Table(("", *map(units.label, columns.values())), rows, "Felt, with an ideal current loop")


def _under_mismatch(study: dict[str, Any], units: Units) -> Iterator[Line | Table]:
    """What the simulated plants do whose estimates are wrong."""
    speed, factor = units.read("mm/s")
    creep, free = (1e3 * factor * study[key] for key in ("creep_speed", "creep_speed_exact_encoder"))
    ended = f" (the encoder ends one of {free:.3g})" if free > creep else ""
    coulomb = study["coulomb_factor_without_creep"]
    low, high = study["stable_share_interval"]
    interval = "" if math.isnan(low) else f" (95 %: {100 * low:.2f} to {100 * high:.2f} %)"
    worst = study["worst"]
    errors = ", ".join(f"{units.words(name)} {100 * value:+.2f} %" for name, value in worst["errors"].items())
    heading = f"+-{100 * study['mismatch']:g} %"
    rows = [
        (f"creep speed, {speed}", "unbounded" if math.isinf(creep) else f"{creep:.3f}{ended}"),
        (f"dead band, {units.unit('N')}", f"{study['dead_band']:.4g}"),
        ("Coulomb factor without creep", "none" if coulomb is None else f"{coulomb:.4f}"),
        ("plants that come to rest", f"{100 * study['stable_share']:.2f} %{interval}"),
        ("neither unstable nor cycling", f"{100 * study['bounded_share']:.2f} %"),
    ]
    verdicts = ", ".join(f"{count} {_spaced(name)}" for name, count in study["verdicts"].items() if count)
    yield Table(("mismatch", heading), rows, words=(heading,))
    beyond = [(case["what"], _spaced(case["verdict"])) for case in study["beyond"]]
    if beyond:
        yield Table(("the corners, with", "worst verdict"), beyond, words=("worst verdict",))
    yield Line(f"verdicts: {verdicts}")
    yield Line(f"worst: {_spaced(worst['verdict'])} at {errors}")


def law_in_words(law: dict[str, Any], units: Units) -> str:
    """The parameters of an impedance law in words; a parameter at its default is left out.

    >>> usual = {"filter": 500.0, "current_filter": 500.0, "stiffness": 0.0, "coulomb_factor": 1.0}
    >>> law_in_words({"mass": 50.0, "damping": 100.0, "force_sensor": False, **usual}, Units())
    'M_a = 50 kg, B = 100 N/(m/s), filter 500 rad/s'
    """
    words = [f"M_a = {law['mass']:g} {units.unit('kg')}", f"B = {law['damping']:g} {units.unit('N/(m/s)')}"]
    words += [f"K = {law['stiffness']:g} {units.unit('N/m')}"] if law["stiffness"] else []
    words.append("filter unfiltered" if law["filter"] is None else f"filter {law['filter']:g} rad/s")
    if law["force_sensor"]:
        words.append(f"with a {units.words('force')} sensor, (28)")
    elif law["current_filter"] is None and law["filter"] is not None:
        words.append("current unfiltered")
    words += [f"Coulomb factor {law['coulomb_factor']:g}"] if law["coulomb_factor"] != 1.0 else []
    return ", ".join(words)


def _spaced(name: str) -> str:
    return name.replace("_", " ")


def _three_digits(value: float | None) -> str:
    """``value`` with three significant digits, or with one decimal from 100 on.

    >>> _three_digits(0.15), _three_digits(235.82), _three_digits(73.777), _three_digits(None)
    ('0.15', '235.8', '73.8', 'undefined')
    """
    if value is None:
        return "undefined"
    return f"{value:.1f}" if abs(value) >= 100.0 else f"{value:.3g}"
