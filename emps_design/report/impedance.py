"""The section on the impedance law: what is felt, where it is stable, what a wrong model does, Fig. 12."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from emps_design.report.diagrams import impedance_law_diagram
from emps_design.report.display import NOTHING, frequency, number, quantity, sentence_of, symbol
from emps_design.report.impedance_figures import (
    apparent_impedance_figure,
    contact_map_figure,
    mismatch_figure,
    stability_map_figure,
    task_figure,
)
from emps_design.report.page import Callout, Html, Picture, Section, Table, Text, html

if TYPE_CHECKING:
    from emps_design.comanipulation.assessment import ImpedanceAssessment
    from emps_design.comanipulation.study import MismatchStudy

OMEGA = np.geomspace(0.2, 300.0, 300)  # rad/s
BAND = 20.0  # rad/s, the operator's range in section II-C of the paper


def impedance_section(found: ImpedanceAssessment) -> Section:
    """Return the section on ``found``."""
    document = found.to_dict()
    law = found.law
    blocks: list[Any] = [
        Text(
            f"Without a force sensor the law makes the carriage feel like {quantity(law.mass, 'kg')} and "
            f"{quantity(law.damping, 'N/(m/s)')}. Acceleration and current pass the "
            f"same low-pass of {frequency(law.filter) if np.isfinite(law.filter) else 'no limit'}."
        ),
        _verdict(found),
        Picture(
            impedance_law_diagram(),
            "(a) The law sees motion and motor current, no force. (b) The impedance it aims at; in co-manipulation K "
            "and the reference velocity are zero.",
            "Impedance control, after Fig. 11 of the paper",
        ),
        _felt_table(document),
        _impedance_picture(found),
        _sampled_table(document),
        *_maps(found),
    ]
    if found.study is not None:
        blocks += _mismatch_blocks(found, found.study, document["mismatch"])
    blocks.append(_errata_table())
    if document["warnings"]:
        blocks.append(Callout("warning", "To read with the numbers", items=tuple(document["warnings"])))
    return Section("Impedance law", *blocks)


def refusal(found: ImpedanceAssessment) -> str:
    """Why the law is not to be run, as a statement on it; empty where no simulated plant swings."""
    words = {"unstable": "is unstable", "limit_cycle": "ends in a limit cycle"}.get(found.verdict)
    return f"the impedance law {words}: {found.reason.partition(': ')[2]}" if words else ""


def _verdict(found: ImpedanceAssessment) -> Callout:
    from emps_design.comanipulation.study import CALM

    if not found.stable:
        title, _, body = refusal(found).partition(": ")
        return Callout("stop", f"{title}.", body)
    tried = "" if found.study is not None else " Errors of the estimates were not tried."
    return Callout("good" if found.verdict in CALM else "warning", sentence_of(found.headline) + tried)


def _felt_table(document: Mapping[str, Any]) -> Table:
    rows = [
        [
            label,
            quantity(document[key]["apparent_mass"], "kg"),
            quantity(document[key]["apparent_damping"], "N/(m/s)"),
            quantity(document[key]["coulomb_left"], "N"),
        ]
        for key, label in (("derived", "law as derived"), ("printed", "(30) as printed"))
    ]
    return Table(
        ["", "apparent mass", "apparent damping", "Coulomb friction left"],
        rows,
        "What the hand feels with exact estimates and an ideal current loop. As printed, (30) has a factor 2 that does "
        "not follow from (28) and (29); this is what it costs.",
    )


def _impedance_picture(found: ImpedanceAssessment) -> Picture:
    from emps_design.control.impedance.equivalence import LOW_FREQUENCY, equivalent_loop
    from emps_design.control.impedance.response import impedance_response
    from emps_design.control.impedance.sampled import numbers
    from emps_design.errors import SpecificationError

    law = found.law
    below = OMEGA[np.pi / found.clock.period > OMEGA]

    def felt(one: Any) -> np.ndarray:
        options = {"velocity_estimator": one.velocity_estimator, "force_sensor": one.force_sensor}
        return impedance_response(numbers(one, found.plant), found.clock, below, **options)[0]

    curves = {"sampled law": felt(law)}
    if found.mismatch:
        e = found.mismatch
        for sign, word in ((1.0, "over"), (-1.0, "under")):
            off = law.with_errors({name: sign * e for name in ("mass", "viscous", "coulomb")})
            curves[f"estimates {100 * e:g} % {word}"] = felt(off)
    with suppress(SpecificationError):  # where no such loop exists the section's warnings say so
        loop = equivalent_loop(found.axis, law.mass, law.damping, LOW_FREQUENCY, mismatch=found.mismatch or 0.0)
        curves["equivalent force loop"] = loop.impedance(below)
    target = 1j * below * law.mass + law.damping
    return Picture(
        apparent_impedance_figure(below, curves, target),
        f"Force over velocity at the hand. In the shaded band, below {BAND:g} rad/s, where an operator moves, "
        "the curves should lie on the dashed target; above it the filters and the hold let the real mass through.",
        "Apparent impedance",
    )


def _sampled_table(document: Mapping[str, Any]) -> Table:
    sampled, contact, loop = document["sampled"], document["passivity"], document["equivalent_loop"]
    bands = contact["sampled"]["active_bands"] if contact else []
    active = "; ".join(
        f"{number(low)} to {number(high)} rad/s" if high is not None else f"from {number(low)} rad/s"
        for low, high in bands
    )
    wall = document["largest_wall_stiffness"]
    largest = max((abs(complex(p)) for p in sampled["poles"]), default=None)
    rows = [
        ["largest pole, sliding", number(largest, 5), "inside the unit circle below 1"],
        [
            "gain of the recursion in its own current",
            number(sampled["recursion_gain"]),
            "held stable by the acceleration",
        ],
        ["force to break away", quantity(document["break_away"], "N"), "at rest the law compensates no dry friction"],
        [
            "smallest safe apparent mass",
            quantity(document["smallest_safe_mass"], "kg"),
            "stable at every corner of the mismatch, and not swinging in the simulation",
        ],
        ["takes energy from the hand", active or "nowhere", "bands in which the sampled law is not passive"],
        *(
            [
                f"stiffest wall, {'exact estimates' if name == 'exact' else 'worst corner of the mismatch'}",
                f"{number(limit['simulated'] / 1e3)} N/mm",
                f"pressed against it the carriage comes to rest; simulated, pushes around {limit['push']:.3g} N",
            ]
            for name, limit in document["wall_limit"].items()
        ),
        [
            "stiffest undamped wall by the poles",
            "unbounded" if wall is None and contact else f"{number(wall / 1e3)} N/mm" if wall is not None else NOTHING,
            "without friction, its compensation and the encoder",
        ],
        [
            Html("equivalent force loop " + symbol("k_e1")),
            "none" if loop["k_e1"] is None else f"{number(loop['k_e1'])} (m/s)/N",
            f"{loop['criterion'].replace('_', ' ')} match"
            + ("" if loop["k_e1"] is None or loop["sampled"]["stable"] else "; unstable on this drive"),
        ],
    ]
    return Table(["quantity", "value", "meaning"], rows, "The law as implemented, on the sampled drive.")


def _maps(found: ImpedanceAssessment) -> list[Picture]:
    from emps_design.control.impedance.passivity import contact_map
    from emps_design.control.impedance.robustness import stability_map

    mismatches = tuple(dict.fromkeys((0.0, found.mismatch or 0.02, 0.05)))
    pictures = [
        Picture(
            stability_map_figure(
                stability_map(found.law, found.plant, found.clock, mismatches=mismatches),
                found.law.mass,
                found.law.filter,
            ),
            "Shaded: unstable at some corner of the mismatch, sliding or sticking. The point must stay clear of the "
            "line of the mismatch that is to be expected.",
            "Where the law is stable",
        )
    ]
    if found.stable:
        pictures.append(
            Picture(
                contact_map_figure(contact_map(found.law, found.plant, found.clock)),
                "Shaded: the law and this contact together are unstable. A hand is soft and damped (left), a wall is "
                "stiff (right); damping in the contact helps.",
                "In contact with a hand or a wall",
            )
        )
    return pictures


def _mismatch_blocks(found: ImpedanceAssessment, study: MismatchStudy, mismatch: Mapping[str, Any]) -> list[Any]:
    from emps_design.comanipulation.run import run_task
    from emps_design.comanipulation.study import run_worst

    worst = mismatch["worst"]
    percent = f"±{100 * mismatch['mismatch']:g} %"
    task = study.task
    law = found.law
    runs = {
        "exact estimates": run_task(found.axis, law, task),
        f"worst within {percent}": run_worst(found.axis, study),
        "with a force sensor": run_task(found.axis, replace(law, force_sensor=True), task),
    }
    share = f"{100 * mismatch['stable_share']:.4g} %"
    rows = [
        ["verdict of the worst plant", worst["verdict"].replace("_", " ")],
        ["its estimates are off by", _errors(worst["errors"])],
        ["come to rest when let go", f"{share}{_interval(mismatch['stable_share_interval'])}"],
        [
            "neither unstable nor in a limit cycle",
            f"{100 * mismatch['bounded_share']:.4g} %{_interval(mismatch['bounded_share_interval'])}",
        ],
        *([f"with {one['what']}", one["verdict"].replace("_", " ")] for one in mismatch["beyond"]),
        ["creep after release, at most", quantity(mismatch["creep_speed"], "m/s")],
        ["dead band, at most", quantity(mismatch["dead_band"], "N")],
        ["Coulomb factor that rules creep out", number(mismatch["coulomb_factor_without_creep"])],
        ["largest pole over the corners", number(mismatch["largest_pole"], 5)],
    ]
    ranges = mismatch["ranges"]
    units = {"apparent_mass": "kg", "apparent_damping": "N/(m/s)", "peak_voltage": "V", "rms_force": "N", "work": "J"}
    spread = [
        [name.replace("_", " "), *(quantity(ranges[name][key], unit) for key in ("low", "median", "high"))]
        for name, unit in units.items()
        if name in ranges
    ]
    if "r2" in ranges:
        spread.append(["R², force on motion", *(number(ranges["r2"][key]) for key in ("low", "median", "high"))])
    return [
        Table(
            ["", "value"],
            rows,
            f"Mass, viscous and Coulomb friction of the law off by up to {percent}: {study.corners} corners and "
            f"{study.plants} random plants, seed {study.seed}. Not varied there: the force gain, which scales all "
            "three and is inside the box, and the filter of the law. With: the corners on a machine changed in that.",
        ),
        Table(
            ["", "5 %", "median", "95 %"], spread, "The random plants: transparency, voltage and the operator's effort."
        ),
        Picture(
            mismatch_figure(study),
            "Left: what the hand feels on each plant; squares are the corners. Right: what the released carriage does. "
            "Creeping means that over-estimated friction drives it on for ever.",
            f"Mismatch of {percent}",
        ),
        Picture(
            task_figure(runs, task),
            "The hand guides the carriage for 5 s and lets go while it moves. Look at the velocity after the release, "
            "which must come to rest, and at the position, which must not run away.",
            "Force, velocity and position, after Fig. 12 of the paper",
        ),
        _effort_table(found, runs),
    ]


def _interval(bounds: tuple[float, float]) -> str:
    low, high = bounds
    return "" if np.isnan(low) else f" (95 %: {100 * low:.2f} to {100 * high:.2f} %)"


def _errors(errors: Mapping[str, float]) -> str:
    return ", ".join(f"{name.replace('_', ' ')} {100 * e:+.2g} %".replace("-", "−") for name, e in errors.items())


def _effort_table(found: ImpedanceAssessment, runs: Mapping[str, Any]) -> Table:
    from emps_design.control.impedance.robustness import break_away

    rows = []
    for name, one in runs.items():
        effort = {key: float(values[0]) for key, values in one.measures.effort.items()}
        start = break_away(replace(found.law, force_sensor="sensor" in name), found.plant)
        rows.append(
            [
                name,
                one.verdict.replace("_", " "),
                quantity(start, "N"),
                *(
                    quantity(effort[key], unit)
                    for key, unit in (("rms_force", "N"), ("peak_force", "N"), ("work", "J"))
                ),
            ]
        )
    return Table(
        ["", "after release", "force to break away", "rms force", "peak force", "work"],
        rows,
        "The operator's effort in the task. Without a force sensor all of the dry friction has to be overcome by hand "
        "before the carriage starts.",
    )


def _errata_table() -> Table:
    from emps_design.paper.errata import find_errata

    return Table(
        ["place", "about", "what differs"],
        [
            [html('<span translate="no">{}</span>', words) for words in (one.place, one.title, one.text)]
            for one in find_errata()
        ],
        "Where the paper differs from what follows by derivation; emps-design derive shows every step.",
    )
