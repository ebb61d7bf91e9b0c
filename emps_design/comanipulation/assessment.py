"""Assess an impedance law: apparent impedance derived and as printed, sampled stability, mismatch, contact.

The assessment gives one verdict, the warnings, and the nearest stable law if this one is not.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from copy import deepcopy
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from emps_design.axis import Axis
from emps_design.comanipulation.run import run_many, run_task
from emps_design.comanipulation.study import (
    CALM,
    PLANTS,
    SEED,
    TWO_QUADRANT,
    WORKERS,
    MismatchStudy,
    box_of,
    mismatch_study,
    with_errors,
)
from emps_design.comanipulation.task import fitted_task
from emps_design.comanipulation.wall import WallLimit, wall_limit
from emps_design.control.impedance.law import (
    LOW_FREQUENCY,
    PRINTED,
    ApparentImpedance,
    FrictionModel,
    ImpedanceLaw,
    equivalent_loop,
    impedance_law,
    safety_words,
)
from emps_design.control.impedance.passivity import (
    Clock,
    SampledLoop,
    extended_loop,
    largest_wall,
    passivity,
    recursion_poles,
    relay_oscillations,
    sampled_loop,
)
from emps_design.control.impedance.robustness import (
    SPEED,
    VERDICTS,
    break_away,
    corner_errors,
    coulomb_factor_without_creep,
    creep_speed,
    dead_band,
    drift_threshold,
    extended_radius,
    impedance_loops,
    nearest_stable,
    sinking_force,
    smallest_mass,
    verdict,
    worst_radius,
)
from emps_design.control.margins import HERTZ
from emps_design.control.sampled import MARGINAL, NestedLoop, worst_loop
from emps_design.control.view import number
from emps_design.errors import SpecificationError
from emps_design.laws.law import PARAMETERS, left_out
from emps_design.messages import Message, grave, note, warning
from emps_design.request import Request, option, takes
from emps_design.units import Units
from emps_design.view import Line, Table, View, Viewed

FIRST = (1, 9, 41)  # where the estimates of a proposed law are split into batches, simulated in turn
DRAWN, FEW = 200, 4  # random estimates of a proposed law; on an axis with effects, which takes longer to simulate
LITTLE = 1e-3  # relative error of these estimates if there is no mismatch
SWINGS = ("limit_cycle", "unstable")  # verdicts on an unusable law
# Motion of the released carriage, by verdict.
DOES = {
    "stable": "comes to rest",
    "dead_band": "comes to rest",
    "no_motion": "was at rest at the release, so its motion is unknown",
    "creeping": "creeps on",
    "limit_cycle": "keeps oscillating",
    "unstable": "diverges or oscillates between the limits",
}
SHARES = (
    "stable_share", "stable_share_interval", "bounded_share", "bounded_share_interval", "verdicts", "plants", "seed",
    "task", "varied", "not_varied", "beyond",
)  # fmt: skip


def cautions_of(assessment: ImpedanceAssessment, document: dict[str, Any]) -> list[Message]:
    """Return the messages on ``assessment``, whose other results are in ``document``."""
    axis, law, units = assessment.axis, assessment.law, assessment.axis.units
    force, carriage, shown = units.word("force"), units.word("carriage"), units.quantity
    messages = [] if assessment.stable else [grave("not-to-run", assessment.reason)]
    if law.at_singularity(PRINTED):
        text = "printed is undefined: with M_a = 2 M the current cancels in (30) as printed; derived is defined"
        messages.append(note("printed-undefined", text))
    sinking = sinking_force(assessment.plant)
    if sinking > 0.0:
        text = (
            f"the constant {force} exceeds dry friction by {shown(sinking, 'N', '.3g')}, and this law does not hold "
            f"the axis at rest: it sinks; compensate that {force} separately"
        )
        messages.append(grave("sinks", text, force=sinking))
    for kind in left_out(axis):
        text = (
            f"effect {kind} is included in the simulated plants and, linearised, in the poles, but not in the apparent "
            "impedance and in contact"
        )
        messages.append(note("effect-in-plants-only", text, effect=kind))
    messages += safety_words(axis, law.mass, law.damping, assessment.mismatch or 0.0)
    if document["smallest_safe_mass"] is None:
        text = (
            "smallest_safe_mass is undefined: with this filter and damping the law is unstable or in a limit cycle "
            "even for M_a = M"
        )
        messages.append(grave("no-safe-mass", text))
    if law.damping == 0.0:
        messages.append(warning("no-damping", f"damping B is 0: the released {carriage} does not come to rest"))
    oscillation = document["coulomb_oscillation"]
    if oscillation is not None and oscillation["speed"] > 2.0 * assessment.slowest_drift:
        text = (
            f"the Coulomb compensation may cause hunting, at {shown(oscillation['speed'], 'mm/s', '.2g')} or more and "
            f"below {oscillation['frequency']:.2g} rad/s (describing function); reduce the Coulomb factor, or use a "
            "faster filter if the loop remains stable"
        )
        messages.append(grave("limit-cycle", text, **oscillation))
    contact = document["passivity"]
    if contact is None:
        text = "passivity and largest_wall_stiffness are undefined: the loop is unstable without contact"
        messages.append(grave("unstable-without-contact", text))
    elif any(high is None for _, high in contact["continuous"]["active_bands"]):
        messages.append(note("active-band-unbounded", "passivity.continuous: the active band is unbounded above"))
    if contact is not None and not contact["sampled"]["passive"]:
        low = contact["sampled"]["active_bands"][0][0]
        wall = document["largest_wall_stiffness"]
        text = f"not passive from {low:.3g} rad/s on"
        if wall is not None:
            text += f"; by the poles the loop is stable against an undamped wall of up to {shown(wall, 'N/m', '.3g')}"
        messages.append(warning("not-passive", text, frequency=low, wall=wall))
    for name, limit in assessment.walls.items():
        which = "exact estimates" if name == "exact" else f"estimates off by +-{100 * (assessment.mismatch or 0.0):g} %"
        text = (
            f"{which}: pressed against a wall of up to {shown(limit.simulated, 'N/m', '.3g')} the {carriage} comes to "
            "rest; against a stiffer one the Coulomb compensation may keep it oscillating (simulated with pushes "
            f"around {shown(limit.push, 'N', '.3g')}; by the poles the limit is {shown(limit.linear, 'N/m', '.3g')})"
        )
        messages.append(warning("wall-limit", text, simulated=limit.simulated, linear=limit.linear))
    if contact is not None and document["largest_wall_stiffness"] is None:
        text = f"largest_wall_stiffness is unbounded: stable up to 1 G{units.unit('N/m')}"
        messages.append(note("wall-unbounded", text))
    mismatch = document.get("mismatch")
    if mismatch is not None and assessment.study is not None:
        messages += assessment.study.warnings
        if math.isinf(mismatch["creep_speed"]):
            text = "mismatch.creep_speed is unbounded: at a corner the apparent damping is not positive"
            messages.append(grave("creep-unbounded", text))
        elif mismatch["creep_speed"] > 0.0:
            factor = mismatch["coulomb_factor_without_creep"]
            cure = "no Coulomb factor" if factor is None else f"a Coulomb factor of {factor:.4g}"
            text = (
                f"overestimated friction makes the released {carriage} creep at up to "
                f"{shown(mismatch['creep_speed'], 'mm/s', '.3g')}; {cure} prevents it"
            )
            messages.append(grave("creep", text, speed=mismatch["creep_speed"], coulomb_factor=factor))
        if mismatch["worst"]["peak_voltage"] >= axis.drive.command_limit:
            text = f"the {units.word('voltage')} limit is reached in the task"
            messages.append(warning("limit-in-task", text))
    return messages


@dataclass(frozen=True)
class ImpedanceAssessment(Viewed):
    """Result of :func:`assess_impedance`; ``study`` is None without a mismatch."""

    axis: Axis
    law: ImpedanceLaw
    mismatch: float | None
    study: MismatchStudy | None

    @property
    def plant(self) -> FrictionModel:
        """The friction model of the axis."""
        return FrictionModel.of(self.axis)

    @property
    def clock(self) -> Clock:
        """Sampling period and delays of the axis."""
        return Clock.of(self.axis)

    @cached_property
    def worst_radius(self) -> float:
        """Largest pole modulus over the corners of the mismatch, sliding and sticking, with the axis's effects."""
        mismatch = self.mismatch or 0.0
        radius = float(worst_radius(self.law, self.plant, self.clock, mismatch))
        return radius if self.extended is None else max(radius, float(extended_radius(self.axis, self.law, mismatch)))

    @cached_property
    def extended(self) -> SampledLoop | None:
        """The loop with the linearised effects that the friction model lacks; None without such effects."""
        if not left_out(self.axis):
            return None
        speeds = [direction * SPEED for direction in self.plant.directions]
        return max((extended_loop(self.axis, self.law, v) for v in speeds), key=lambda loop: loop.radius)

    @cached_property
    def loops(self) -> tuple[NestedLoop, ...]:
        """The loop at the plant input in every direction, and at the corners of the mismatch."""
        return impedance_loops(self.axis, self.law, self.mismatch or 0.0)

    @cached_property
    def loop(self) -> SampledLoop:
        """The sampled loop on the friction model, in the less stable direction of motion."""
        loops = [sampled_loop(self.law, self.plant, self.clock, direction) for direction in self.plant.directions]
        return max(loops, key=lambda loop: loop.radius)

    @cached_property
    def simulated(self) -> str:
        """The verdict on the simulated axis, with encoder and limit, guided and released with exact estimates."""
        return run_task(self.axis, self.law, fitted_task(self.axis, self.law)).verdict

    @cached_property
    def walls(self) -> dict[str, WallLimit]:
        """The stiffest wall with exact estimates and at the worst corner of the mismatch; without unbounded ones."""
        if not self.stable:
            return {}
        limits = {"exact": wall_limit(self.axis, self.law)}
        if self.mismatch:
            limits["mismatch"] = wall_limit(self.axis, self.law, self.mismatch)
        return {name: limit for name, limit in limits.items() if limit is not None}

    @property
    def slowest_drift(self) -> float:
        """Speed [m/s] below which encoder quantisation stops a creep."""
        resolution = self.axis.sampling.encoder_resolution
        return drift_threshold(self.clock.period, resolution, self.law.velocity_estimator)

    @property
    def poles_stable(self) -> bool:
        """Whether the sampled loop is stable, at every corner of the mismatch, and with the axis's effects."""
        return self.worst_radius <= 1.0 + MARGINAL

    @cached_property
    def verdict(self) -> str:
        """The worst verdict: by the poles, simulated with exact estimates, and of every plant within the mismatch."""
        verdicts = [self.simulated, *([] if self.poles_stable else ["unstable"])]
        verdicts += [] if self.study is None else [VERDICTS[self.study.verdict.max()]]
        return max(verdicts, key=VERDICTS.index)

    @property
    def stable(self) -> bool:
        """Whether no pole is unstable, and no simulated plant diverges or is in a limit cycle."""
        return self.verdict not in SWINGS

    @property
    def headline(self) -> str:
        """The verdict and the number of simulated plants with it, in one sentence."""
        name, study = self.verdict.replace("_", " "), self.study
        outcomes = [self.simulated] if study is None else [VERDICTS[place] for place in study.verdict]
        count = sum(DOES[outcome] == DOES[self.verdict] for outcome in outcomes)
        if not count and self.simulated != self.verdict:
            return f"{name}: the sampled loop has a pole outside the unit circle"
        where = f" in {count} of {len(outcomes)} plants simulated within +-{100 * (self.mismatch or 0.0):g} %"
        where = " with exact estimates" if study is None or not count else where
        creep, units = study.creep if study is not None and self.verdict == "creeping" else 0.0, self.axis.units
        speed = f", at up to {units.quantity(creep, 'mm/s', '.3g')}" if creep else ""
        return f"{name}: the released {units.word('carriage')} {DOES[self.verdict]}{where}{speed}"

    def _calm(self, law: ImpedanceLaw) -> bool:
        """Whether the guided and released carriage has no limit cycle under ``law`` for estimates within the mismatch.

        Without a mismatch the estimates get small errors, since a law near a limit cycle may come to rest by chance.
        """
        size, task = self.mismatch or LITTLE, fitted_task(self.axis, law, self.mismatch or 0.0)
        split = self.plant.two_quadrant or (self.study is not None and self.study.split)
        corners = box_of(corner_errors(size, split))
        drawn = np.random.default_rng(0).uniform(
            -size, size, (DRAWN if self.extended is None else FEW, len(PARAMETERS))
        )
        errors = np.vstack([np.zeros(len(PARAMETERS)), corners, drawn])
        for batch in np.split(errors, FIRST):  # a small batch finds most limit cycles
            laws = with_errors(law, batch)
            for run in (task, task.reversed) if split else (task,):
                if len(batch) and any(VERDICTS[place] in SWINGS for place in run_many(self.axis, [laws], run).verdict):
                    return False
        return True

    @cached_property
    def nearest(self) -> dict[str, float] | None:
        """The nearest stable law without a limit cycle (mass, damping, filter); None if this one is or none exists."""
        if self.stable:
            return None

        mismatch = self.mismatch or 0.0

        def accept(laws: ImpedanceLaw) -> np.ndarray:
            return extended_radius(self.axis, laws, mismatch) <= 1.0 + MARGINAL

        extended = None if self.extended is None else accept
        return nearest_stable(self.law, self.plant, self.clock, mismatch, extended, self._calm)

    @property
    def reason(self) -> str:
        """The reason why the law must not run, in one line; empty if it is stable."""
        if self.stable:
            return ""
        if self.poles_stable:
            return (
                f"{self.headline}: the poles are stable, but the simulated {self.axis.units.word('carriage')} keeps "
                "oscillating, due to encoder quantisation, the command limit and friction: use a finer encoder or "
                f"another law; {self._proposal}"
            )
        loop = self.loop
        recursion = abs(recursion_poles(self.law, self.clock)[0])
        if not loop.stable:
            what = f"the sampled loop has a pole of modulus {loop.radius:.5g}"
        elif self.extended is not None and not self.extended.stable:
            what = f"with the axis's effects the sampled loop has a pole of modulus {self.extended.radius:.5g}"
        elif recursion > 1.0 + MARGINAL:
            what = f"at rest the recursion in the law's own current has a pole of modulus {recursion:.5g}"
        else:
            what = f"at a corner of +-{100 * (self.mismatch or 0):g} % a pole reaches modulus {self.worst_radius:.5g}"
        return f"unstable: {what}; {self._proposal}"

    @property
    def _proposal(self) -> str:
        if self.nearest is None:
            return "no stable law without a limit cycle was found nearby"
        units = self.axis.units
        return (
            f"nearest stable: {units.word('mass')} {units.quantity(self.nearest['mass'], 'kg')}, damping "
            f"{units.quantity(self.nearest['damping'], 'N/(m/s)')}, "
            f"filter {self.nearest['filter']:.4g} rad/s on both signals"
        )

    def to_dict(self) -> dict[str, Any]:
        """The JSON document: apparent impedance, sampled loop, passivity, contact, mismatch, and smallest safe M_a."""
        return deepcopy(self._document)

    @cached_property
    def _document(self) -> dict[str, Any]:
        law, plant, clock = self.law, self.plant, self.clock
        loop = self.loop
        nominal = loop.stable and abs(recursion_poles(law, clock)[0]) <= 1.0 + MARGINAL
        nominal = nominal and (self.extended is None or self.extended.stable)
        (oscillation,) = relay_oscillations(law, plant, clock)
        ideal = replace(law, force_sensor=False, current_factor=1.0)
        document: dict[str, Any] = {
            "axis": self.axis.name,
            "verdict": self.verdict,
            "headline": self.headline,
            "worst_loop": worst_loop(self.loops).to_dict(),
            "law": law.to_dict(),
            "derived": self._felt(ideal).to_dict(),
            "felt": self._felt(law).to_dict(),
            "printed": self._printed(ideal),
            "sampled": {
                "stable": nominal,
                "poles": list((self.extended or loop).poles),
                "recursion_gain": law.recursion_gain,
                "recursion_poles": list(recursion_poles(law, clock)),
                "verdict": verdict(law, plant, clock, self.axis.sampling.encoder_resolution),
                "simulated": self.simulated,
            },
            "break_away": break_away(law, plant),
            "coulomb_oscillation": None
            if oscillation is None
            else {"frequency": oscillation[0], "speed": oscillation[1]},
            "passivity": passivity(law, plant, clock).to_dict() if nominal else None,
            "largest_wall_stiffness": largest_wall(law, plant, clock) if nominal else None,
            "wall_limit": {name: limit.to_dict() for name, limit in self.walls.items()},
            "smallest_safe_mass": smallest_mass(law, plant, clock, self.mismatch or 0.0, self._calm),
        }
        try:
            document["equivalent_loop"] = equivalent_loop(
                self.axis, law.mass, law.damping, LOW_FREQUENCY, mismatch=self.mismatch or 0.0
            ).to_dict()
        except SpecificationError as error:
            refused = grave("no-equivalent-loop", str(error))
            document["equivalent_loop"] = {"k_e1": None, "criterion": LOW_FREQUENCY, "warnings": [refused]}
        if self.study is not None and self.mismatch is not None:
            document["mismatch"] = self._under_mismatch(self.study, self.mismatch)
        if not self.stable:
            document |= {"reason": self.reason, "nearest": self.nearest}
        document["warnings"] = cautions_of(self, document)
        return document

    def view(self) -> View:
        """The lines and tables of the command ``impedance``."""
        return tuple(_parts(self.to_dict(), self.axis.units))

    def _felt(self, law: ImpedanceLaw) -> ApparentImpedance:
        """Apparent impedance in the direction with the larger remaining Coulomb force, by magnitude."""
        each = [law.apparent(self.plant, direction) for direction in self.plant.directions]
        return max(each, key=lambda felt: abs(felt.coulomb_left))

    def _printed(self, ideal: ImpedanceLaw) -> dict[str, float | None]:
        """Apparent impedance by (30) as printed; None for each number if that has no solution."""
        if ideal.at_singularity(PRINTED):
            return dict.fromkeys(("apparent_mass", "apparent_damping", "coulomb_left"))
        return {**self._felt(replace(ideal, current_factor=PRINTED)).to_dict()}

    def _under_mismatch(self, study: MismatchStudy, mismatch: float) -> dict[str, Any]:
        corners = [self.law.with_errors(errors) for errors in corner_errors(mismatch, self.plant.two_quadrant)]
        summary = study.to_dict()
        if not self.poles_stable and summary["worst"]["verdict"] not in SWINGS:
            # The unstable poles belong to the carriage at rest or to linearised effects, not to the simulated plants.
            summary["worst"] = {**summary["worst"], "verdict": "unstable"}
        creep = max(creep_speed(law, self.plant) for law in corners)
        return {
            "mismatch": mismatch,
            "creep_speed": creep if creep > self.slowest_drift else 0.0,
            "creep_speed_exact_encoder": creep,
            "dead_band": max(dead_band(law, self.plant) for law in corners),
            "coulomb_factor_without_creep": coulomb_factor_without_creep(self.law, self.plant, mismatch),
            "largest_pole": self.worst_radius,
            "worst": summary["worst"],
            **{key: summary[key] for key in SHARES},
            "ranges": summary["ranges"],
            "corners": summary["corners"],
        }


@dataclass(frozen=True)
class AssessmentRequest(Request):
    """Options of :func:`assess_impedance` in addition to axis, apparent mass and damping."""

    mismatch: float | None = option(
        None, "relative error of the estimates for the study of section IV-B, None: no study"
    )
    filter: float | None = option(None, "low-pass of acceleration and current [rad/s], see impedance_law")
    plants: int = option(200, **PLANTS)
    seed: int = option(0, **SEED)
    two_quadrant: bool | None = option(None, **TWO_QUADRANT)
    workers: int = option(1, **WORKERS)


@takes(AssessmentRequest)
def assess_impedance(
    axis: Axis, mass: float, damping: float, request: AssessmentRequest, **options: Any
) -> ImpedanceAssessment:
    """Assess the law with M_a = ``mass`` [kg], B = ``damping`` [N/(m/s)] on ``axis``; see :class:`ImpedanceAssessment`.

    ``options`` go to :class:`ImpedanceLaw`. Raises :class:`InputError` for numbers out of range.

    >>> from emps_design.machines import machine
    >>> document = assess_impedance(machine("emps2018"), 50.0, 100.0).to_dict()
    >>> {name: round(value, 1) for name, value in document["printed"].items()}
    {'apparent_mass': 73.8, 'apparent_damping': 235.8, 'coulomb_left': 6.3}
    """
    law, mismatch, study = impedance_law(axis, mass, damping, request.filter, **options), request.mismatch, None
    if mismatch is not None:
        study = mismatch_study(
            axis,
            law,
            mismatch,
            request.plants,
            request.seed,
            request.two_quadrant,
            workers=request.workers,
            progress=request.progress,
        )
    return ImpedanceAssessment(axis, law, mismatch, study)


def _parts(document: dict[str, Any], units: Units) -> Iterator[Line | Table]:
    """The verdict, the law, the apparent impedance, the sampled law, and the mismatch of an assessment's document."""
    sampled, study = document["sampled"], document.get("mismatch")
    name, _, why = document["headline"].partition(": ")
    calm, swings = document["verdict"] in CALM, document["verdict"] in ("unstable", "limit_cycle")
    yield Line(f"{name if calm else name.upper()}: {why}", "good" if calm else "bad" if swings else "warning")
    yield Line(f"{document['axis']}: impedance law {law_in_words(document['law'], units)}")
    yield Line(f"exact estimates: poles of the sampled loop {'stable' if sampled['stable'] else 'UNSTABLE'}")
    released, simulated = (_spaced(sampled[key]) for key in ("verdict", "simulated"))
    yield Line(f"released: {released}; simulated with encoder and limit: {simulated}")
    yield _felt(document, units)
    yield _as_implemented(document, units)
    if study is None:
        yield Line("errors of the estimates were not simulated")
    else:
        yield from _under_mismatch(study, units)
    loop = document["equivalent_loop"]
    if loop["k_e1"] is not None:
        stable = "stable" if loop["sampled"]["stable"] else "UNSTABLE"
        gain = f"k_e1 = {loop['k_e1']:g} {units.unit('(m/s)/N')}"
        yield Line(f"equivalent cascaded loop, sampled: {stable} ({_spaced(loop['criterion'])}), {gain}")
        for warning in loop["warnings"]:
            if warning not in document["warnings"]:
                yield Line(warning, "note")
    for warning in document["warnings"]:
        yield Line(warning, "note")


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
    rows = [
        (label, *(number(document[place][key], nothing="undefined") for key in columns))
        for label, place in places.items()
    ]
    return Table(("", *map(units.label, columns.values())), rows, "Apparent impedance, ideal current loop")


def _as_implemented(document: dict[str, Any], units: Units) -> Table:
    """Poles, passivity, walls and break-away force of the sampled law."""
    sampled, contact, wall = document["sampled"], document["passivity"], document["largest_wall_stiffness"]
    largest = max((abs(complex(pole)) for pole in sampled["poles"]), default=None)
    active = ["undefined"]
    if contact:
        bands = contact["sampled"]["active_bands"]
        each = [f"from {low:.4g}" if high is None else f"{low:.4g} to {high:.4g}" for low, high in bands]
        active = each or ["nowhere"]
    stiffness, low_pass = units.unit("N/mm"), document["law"]["filter"]
    rows = [
        *([] if low_pass is None else [("low-pass of the law", number(low_pass / HERTZ), "Hz")]),
        ("largest pole, in motion", number(largest, 5), ""),
        ("gain of the recursion in the law's current", number(sampled["recursion_gain"]), ""),
        (f"break-away {units.word('force')}, at rest", number(document["break_away"]), units.unit("N")),
        (
            f"smallest safe apparent {units.word('mass')}",
            number(document["smallest_safe_mass"], nothing="undefined"),
            units.unit("kg"),
        ),
        *(
            ("" if row else "not passive, supplies energy to the hand", band, "rad/s")
            for row, band in enumerate(active)
        ),
        *(
            (
                f"stiffest wall, {'exact estimates' if name == 'exact' else 'worst corner'}, pushed with "
                f"{units.quantity(limit['push'], 'N', '.3g')}",
                number(limit["simulated"] / 1e3),
                stiffness,
            )
            for name, limit in document["wall_limit"].items()
        ),
        (
            "stiffest undamped wall, by the poles",
            number(wall / 1e3) if wall is not None else "unbounded" if contact else "undefined",
            stiffness,
        ),
    ]
    return Table(("", "value", "unit"), rows, "As implemented, sampled")


def _under_mismatch(study: dict[str, Any], units: Units) -> Iterator[Line | Table]:
    """Results of the simulated plants with wrong estimates."""
    speed, factor = units.read("mm/s")
    creep, free = (1e3 * factor * study[key] for key in ("creep_speed", "creep_speed_exact_encoder"))
    stopped = f" (the encoder stops one of {free:.3g})" if free > creep else ""
    coulomb = study["coulomb_factor_without_creep"]
    worst = study["worst"]
    errors = ", ".join(f"{units.words(name)} {100 * value:+.2f} %" for name, value in worst["errors"].items())
    heading = f"+-{100 * study['mismatch']:g} %"
    rows = [
        (f"creep speed, {speed}", "unbounded" if math.isinf(creep) else f"{creep:.3f}{stopped}"),
        (f"dead band, {units.unit('N')}", f"{study['dead_band']:.4g}"),
        ("Coulomb factor without creep", "none" if coulomb is None else f"{coulomb:.4f}"),
        ("plants that come to rest", _share(study, "stable_share")),
        ("neither unstable nor in a limit cycle", _share(study, "bounded_share")),
        ("largest pole over the corners", number(study["largest_pole"], 5)),
    ]
    verdicts = ", ".join(f"{count} {_spaced(name)}" for name, count in study["verdicts"].items() if count)
    yield Table(("mismatch", heading), rows, words=(heading,))
    beyond = [(case["what"], _spaced(case["verdict"])) for case in study["beyond"]]
    if beyond:
        yield Table(("the corners, with", "worst verdict"), beyond, words=("worst verdict",))
    yield from _spread(study["ranges"], units)
    yield Line(f"verdicts: {verdicts}")
    yield Line(f"worst: {_spaced(worst['verdict'])} at {errors}")


def _share(study: dict[str, Any], name: str) -> str:
    """A share of the plants, with its interval if it has one."""
    low, high = study[f"{name}_interval"]
    interval = "" if math.isnan(low) else f" (95 %: {100 * low:.2f} to {100 * high:.2f} %)"
    return f"{100 * study[name]:.2f} %{interval}"


def _cell(value: float | None) -> str:
    """A statistic of the random plants, - if no plant has a value."""
    return "-" if value is None or math.isnan(value) else number(value)


def _spread(ranges: dict[str, Any], units: Units) -> Iterator[Table]:
    """Transparency, command and effort of the random plants."""
    bases = {
        "apparent_mass": "kg",
        "apparent_damping": "N/(m/s)",
        "r2": "",
        "peak_voltage": "V",
        "rms_force": "N",
        "work": "J",
    }
    rows = [
        (
            f"r2 of {units.word('force')} on motion" if name == "r2" else units.words(_spaced(name)),
            *(_cell(ranges[name][key]) for key in ("low", "median", "high")),
            units.unit(base),
        )
        for name, base in bases.items()
        if name in ranges
    ]
    if rows:
        yield Table(("", "5 %", "median", "95 %", "unit"), rows, "The random plants")


def law_in_words(law: dict[str, Any], units: Units) -> str:
    """The parameters of an impedance law in words, without those at their defaults.

    >>> defaults = {"filter": 500.0, "current_filter": 500.0, "stiffness": 0.0, "coulomb_factor": 1.0}
    >>> law_in_words({"mass": 50.0, "damping": 100.0, "force_sensor": False, **defaults}, Units())
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
