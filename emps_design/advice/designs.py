"""The advice on a design: on the loops of a controller, on an impedance law, and on what a simulation made of them."""

from __future__ import annotations

import math
import shlex
from collections.abc import Callable, Mapping
from typing import Any

from emps_design.advice.advice import (
    CAUTION,
    DO_NOT_RUN,
    SAFE,
    Advice,
    Asked,
    against,
    command,
    grave,
    nearest_command,
    sentence,
)
from emps_design.advice.loops import SAFE_GAIN_MARGIN, SAFE_PHASE_MARGIN_DEG, where_in_words

FOLLOWED = 2.0  # % of the force by which a replay may miss that of the record and follow it
COMES_TO_REST = ("stable", "dead_band")  # verdicts on a carriage that is let go
SWINGS = ("limit_cycle", "unstable")
DESIGN, CODE, COMPENSATED = "design.toml", "code", "compensated"  # what is proposed to write


def _unsafe(worst: Mapping[str, Any] | None) -> str:
    """What is less than safe in the worst loop, "" for nothing."""
    if worst is None:
        return ""
    phase, gain = worst["phase_margin_deg"], worst["gain_margin"]
    short = []
    if phase is not None and phase < SAFE_PHASE_MARGIN_DEG:
        short.append(f"{phase:.3g} deg of phase margin, less than {SAFE_PHASE_MARGIN_DEG:g}")
    if gain is not None and gain < SAFE_GAIN_MARGIN:
        short.append(f"a gain margin of {gain:.3g}, less than {SAFE_GAIN_MARGIN:g}")
    return f"the {_loop(worst)} has {' and '.join(short)}" if short else ""


def _loop(worst: Mapping[str, Any]) -> str:
    where = {name: value for name, value in worst.get("where", {}).items()}
    return " ".join(filter(None, (worst["name"], where_in_words(where))))


def _has(worst: Mapping[str, Any]) -> str:
    """The margins of the worst loop of a design that is safe."""
    phase, gain = worst["phase_margin_deg"], worst["gain_margin"]
    has = "an unbounded phase margin" if phase is None else f"{phase:.3g} deg of phase margin"
    more = "an unbounded gain margin" if gain is None else f"a gain margin of {gain:.3g}"
    return f"the worst loop, the {_loop(worst)}, has {has} and {more}"


def _design(
    document: Mapping[str, Any], asked: Asked, better: Callable[[], str | None], onward: Callable[[], str | None]
) -> Advice:
    """The advice on loops: ``better`` is the next command where they are less than safe, ``onward`` where they are."""
    if document.get("reason"):
        return Advice(
            DO_NOT_RUN, sentence(document["reason"]), nearest_command(document.get("nearest"), asked) or better()
        )
    short = _unsafe(document.get("worst_loop"))
    if short or grave(document):
        return Advice(CAUTION, short or grave(document), better())
    worst = document.get("worst_loop")
    return Advice(SAFE, _has(worst) if worst else "every loop is stable", onward())


def gains(document: Mapping[str, Any], asked: Asked) -> Advice:
    """The advice on a velocity loop and what is around it."""
    worst, requested = document.get("worst_loop", {}), document.get("requested", {})
    name = "crossover" if "crossover" in requested else "bandwidth"

    def better() -> str | None:
        if worst.get("name") == "position loop" and not worst.get("where"):
            return asked.again(position_bandwidth=None, position_stiffness=None, position_kp=None, position_overshoot=5)
        plainly = worst.get("stable", True) and not document.get("retuned") and not worst.get("where")
        if plainly and requested.get("phase_margin_deg", 0.0) >= SAFE_PHASE_MARGIN_DEG:
            return asked.again(retune=True)
        return asked.again(**{name: 0.7 * requested[name]}) if name in requested else None

    def onward() -> str | None:
        out = document.get("out")
        return command("compensate", str(out)) if out else asked.again(out=DESIGN)

    return _design(document, asked, better, onward)


def margins(document: Mapping[str, Any], asked: Asked) -> Advice:
    """The advice on the controller of an axis file."""

    def better() -> str | None:
        return command("gains", asked.axis, crossover=_tenth(document), retune=True)

    return _design(document, asked, better, lambda: command("compensate", asked.axis))


def _tenth(document: Mapping[str, Any]) -> float:
    """A crossover [rad/s] to begin a design with: two thirds of that of the loops there are, or 100 rad/s at 1 kHz."""
    loops = [loop for loop in document.get("loops", {}).values() if loop]
    known = [loop["crossover"] for loop in loops if loop.get("crossover")]
    return float(f"{min(known) / 1.5:.2g}") if known else 100.0


def force(document: Mapping[str, Any], asked: Asked) -> Advice:
    """The advice on a force loop."""
    limit = document["k_e1_max"]["sampled"]

    def better() -> str | None:
        slower = [document["k_e1"], *([limit] if limit else [])]
        return asked.again(k_e1=float(f"{0.5 * min(slower):.3g}"))

    def onward() -> str | None:
        out = document.get("out")
        if out:
            return command("export", str(out), to="c", out=CODE)
        plain = document["structure"] == "ip" and not document["filters"]
        return asked.again(out=DESIGN) if plain else None

    return _design(document, asked, better, onward)


def impedance(document: Mapping[str, Any], asked: Asked) -> Advice:
    """The advice on an impedance law."""
    law, study = document["law"], document.get("mismatch")
    try_it = command("simulate", asked.axis, scenario="comanipulation", mass=law["mass"], damping=law["damping"])
    if document.get("reason"):
        return Advice(DO_NOT_RUN, sentence(document["reason"]), nearest_command(document.get("nearest"), asked))
    worst = document["sampled"]["simulated"] if study is None else study["worst"]["verdict"]
    verdict = document.get("verdict", worst)
    if verdict not in COMES_TO_REST:
        factor = study and study.get("coulomb_factor_without_creep")
        below = math.floor(1e3 * (factor or 0.0)) / 1e3
        less = asked.again(coulomb_factor=below) if below and verdict == "creeping" else None
        text = grave(document) or f"let go, the carriage is {verdict.replace('_', ' ')}"
        return Advice(CAUTION, text, less or nearest_command(document.get("nearest"), asked))
    if _unsafe(document.get("worst_loop")) or grave(document):
        return Advice(CAUTION, _unsafe(document.get("worst_loop")) or grave(document), try_it)
    if study is None:
        return Advice(CAUTION, "it was tried with exact estimates alone", asked.again(mismatch=0.02))
    share = 100.0 * study["mismatch"]
    return Advice(SAFE, f"let go, the carriage comes to rest with estimates anywhere within {share:g} %", try_it)


def simulate(document: Mapping[str, Any], asked: Asked) -> Advice:
    """The advice on a simulation, by its scenario."""
    return SCENARIOS[document.get("scenario", "bench")](document, asked)


def _comanipulation(document: Mapping[str, Any], asked: Asked) -> Advice:
    verdict, law = document["verdict"], document["law"]
    numbers = {"mass": law["mass"], "damping": law["damping"], "mismatch": document["mismatch"]}
    judge = command(impedance.__name__, asked.axis, **numbers)
    if document.get("reason"):
        better = nearest_command(document.get("nearest"), Asked(tuple(shlex.split(judge)[1:]), asked.axis))
        return Advice(DO_NOT_RUN, sentence(document["reason"]), better or judge)
    within = f"with estimates off by up to {100 * document['mismatch']:g} %"
    if verdict not in COMES_TO_REST:
        said = {"creeping": "the released carriage creeps on", "no_motion": "the hand does not move the carriage"}
        return Advice(CAUTION, f"{said.get(verdict, 'the released carriage keeps swinging')} {within}", judge)
    if _unsafe(document.get("worst_loop")) or grave(document):
        return Advice(CAUTION, _unsafe(document.get("worst_loop")) or grave(document), judge)
    return Advice(SAFE, f"the released carriage comes to rest {within}", judge)


def _replay(document: Mapping[str, Any], asked: Asked) -> Advice:
    missed = document["relative_error_percent"]["force"]
    next_one = command("diagnose", asked.records[0], axis=asked.axis)
    if missed is None or math.isnan(missed):
        return Advice(CAUTION, "the record has no force to compare with", next_one)
    if missed > FOLLOWED or against(document):
        text = against(document) or f"simulation and record differ by {missed:.3g} % of the force: noise, or physics"
        return Advice(CAUTION, text if against(document) else f"{text} that the model lacks", next_one)
    return Advice(SAFE, f"the simulation follows the record to {missed:.2g} % of the force", None)


def _reference(document: Mapping[str, Any], asked: Asked) -> Advice:
    share = document["saturated_share"]
    design = _design(document, asked, lambda: command("margins", asked.axis), lambda: command("compensate", asked.axis))
    if design.level == SAFE and share > 0.0:
        return Advice(CAUTION, f"the command is at its limit {100 * share:.2g} % of the time", design.next)
    return design


def _only_said(document: Mapping[str, Any], asked: Asked) -> Advice:
    text = against(document)
    if text:
        return Advice(CAUTION, text, None)
    return Advice(SAFE, "nothing of this runs on a drive", None)


def compensate(document: Mapping[str, Any], asked: Asked) -> Advice:
    """The advice on a feed-forward."""
    rms, cures = document["tracking_rms"], document.get("feedback", ())
    better = command("margins", asked.axis)
    design = _design(document, asked, lambda: better, lambda: None)
    if design.level != SAFE:
        return design
    cycle = next((cure["advice"] for cure in cures if cure.get("cure") == "limit of the gain" and _cycles(cure)), "")
    if cycle:
        return Advice(CAUTION, sentence(cycle), better)
    if not document["kept"] or rms["worst"] > rms["without"]:
        wrong = "no term does more good than harm with wrong parameters"
        return Advice(CAUTION, wrong, command("margins", asked.axis))
    limited = document.get("limited_share") or 0.0
    if limited > 0.0:
        return Advice(CAUTION, f"the command is at its limit {100 * limited:.2g} % of the time", asked.again())
    onward = asked.again(out=COMPENSATED)
    if asked.out:
        onward = command("export", f"{asked.out}/axis.toml", to="c", out=CODE)
    share = rms["worst"] / rms["without"] if rms["without"] else 0.0
    off = 100.0 * document["assumed"]["mismatch"]
    text = f"the tracking error falls to {100 * share:.2g} % of that without, with every parameter wrong by {off:g} %"
    return Advice(SAFE, text, onward)


def _cycles(cure: Mapping[str, Any]) -> bool:
    """Whether a play may cycle with the gain as it is."""
    return (cure.get("factor") is None and "no limit cycle" not in cure["advice"]) or (cure.get("factor") or 2.0) < 1.0


SCENARIOS: dict[str, Callable[[Mapping[str, Any], Asked], Advice]] = {
    "comanipulation": _comanipulation,
    "replay": _replay,
    "reference": _reference,
    "breakaway": _only_said,
    "bench": _only_said,
}
DESIGNS: dict[str, Callable[[Mapping[str, Any], Asked], Advice]] = {
    judge.__name__: judge for judge in (gains, margins, force, impedance, simulate, compensate)
}
