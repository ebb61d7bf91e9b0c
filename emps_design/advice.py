"""Advice on a result: use it, take care, or do not run it; the reason in one sentence; and the command to run next.

It is made from the document of a command alone, for the terminal, the page, the studio and Python; ``warnings`` in it
are messages, whose severity counts (a document read from a file has its own advice). A design is
``do-not-run`` if its document has a ``reason``, with which the command ends with exit status 4. It is ``safe`` with at
least 30 deg of phase margin and a gain margin of 2 in its worst loop, on every machine of the specification, if no
message is grave, such as on instability or creep; ``caution`` otherwise. The advice on a record is ``safe`` without
warnings, else ``caution``.

An advice has a level, a reason and the command to run next.
"""

from __future__ import annotations

import math
import shlex
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from emps_design.messages import Severity, severity_of
from emps_design.units import LINEAR, Units

SAFE, CAUTION, DO_NOT_RUN = LEVELS = ("safe", "caution", "do-not-run")
PROPOSED = {  # key of `nearest` -> option of the command line
    "crossover": "crossover", "bandwidth": "bandwidth", "phase_margin_deg": "phase_margin",
    "position_kp": "position_kp", "k_e1": "k_e1", "mass": "mass", "damping": "damping", "filter": "filter",
}  # fmt: skip
LEFT_OUT = {"json": 0, "debug": 0, "plot": 1}  # options that are not repeated, and the number of words after each

PAGE = "design.html"
FOLDER, RESPONSE, CONTROLLER, IDENTIFIED = "diagnosis", "response.csv", "controller.toml", "identified.toml"

SAFE_PHASE_MARGIN_DEG, SAFE_GAIN_MARGIN = 30.0, 2.0

FOLLOWED = 2.0  # % of the force, largest error of a replay that follows the record
COMES_TO_REST = ("stable", "dead_band")  # verdicts on a released carriage
DESIGN, CODE, COMPENSATED = "design.toml", "code", "compensated"  # what is proposed to write


@dataclass(frozen=True)
class Advice:
    """One of :data:`LEVELS`, the reason in one sentence, and the command to run next or None.

    >>> print(Advice("caution", "the whole loop has 21.0 deg of phase margin only", "emps-design gains --crossover 60"))
    caution: the whole loop has 21.0 deg of phase margin only. Next: emps-design gains --crossover 60
    """

    level: str
    text: str
    next: str | None = None

    def to_dict(self) -> dict[str, str | None]:
        """The contract's entry ``advice``."""
        return {"level": self.level, "text": self.text, "next": self.next}

    def __str__(self) -> str:
        return f"{self.level}: {self.text.rstrip('.')}." + (f" Next: {self.next}" if self.next else "")


@dataclass(frozen=True)
class CommandLine:
    """A command line: its ``words`` from the command's name on, the files ``axis`` and ``records`` among them.

    ``units`` are those of the axis, for the sentences of the advice.
    """

    words: tuple[str, ...]
    axis: str
    records: tuple[str, ...] = ()
    units: Units = LINEAR

    @property
    def out(self) -> str | None:
        """The file or folder of its option ``--out``, or None."""
        for word, after in zip(self.words, (*self.words[1:], None), strict=True):
            name, equals, value = word.partition("=")
            if name == flag_of("out"):
                return value if equals else after
        return None

    def again(self, **options: Any) -> str:
        """Return the command with ``options`` changed: True for one without a value, None to leave it out.

        >>> command = CommandLine(("gains", "a b.toml", "--crossover", "90", "--json"), "a b.toml")
        >>> command.again(crossover=60.0, retune=True)
        "emps-design gains 'a b.toml' --crossover 60 --retune"
        """
        dropped = {flag_of(name): words_after for name, words_after in LEFT_OUT.items()}
        dropped |= {flag_of(name): int(value is not True) for name, value in options.items()}
        words, rest = [], iter(self.words)
        for word in rest:
            name, equals, _ = word.partition("=")
            if name not in dropped:
                words.append(word)
            elif dropped[name] and not equals:
                next(rest, None)
        return command(*words, **options)


def flag_of(option: str) -> str:
    """Return the flag of an option of the command line.

    >>> flag_of("phase_margin")
    '--phase-margin'
    """
    return f"--{option.replace('_', '-')}"


def command(*words: str, **options: Any) -> str:
    """Return a command line of this program, quoted for a shell; an option of True has no value, None leaves it out.

    >>> command("margins", "my axis.toml", mismatch=0.02)
    "emps-design margins 'my axis.toml' --mismatch 0.02"
    """
    line = ["emps-design", *words]
    for name, value in options.items():
        line += [] if value is None else [flag_of(name)] if value is True else [flag_of(name), written(value)]
    return shlex.join(line)


def written(value: Any) -> str:
    """Return a value as text for an option, a float with six digits."""
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def sentence(text: str) -> str:
    """Return ``text`` as the reason of an advice: on one line, without the full stop."""
    return " ".join(text.split()).rstrip(".")


def nearest_command(nearest: Mapping[str, Any] | None, command_line: CommandLine) -> str | None:
    """Return the command with the ``nearest`` values that work, or None if it has no options for them."""
    proposals = {name: value for name, value in (nearest or {}).items() if name != "or" and value is not None}
    if not proposals or not proposals.keys() <= PROPOSED.keys():
        return None
    return command_line.again(**{PROPOSED[name]: float(value) for name, value in proposals.items()})


def grave_warning(document: Mapping[str, Any]) -> str:
    """Return the most severe message with which no design is safe, or ""."""
    return _worst(document.get("warnings", ()), Severity.GRAVE)


def objection(document: Mapping[str, Any]) -> str:
    """Return the most severe message that affects the result from a record, the first of equal ones, or "".

    >>> from emps_design.messages import note, warning, wrong
    >>> gap, rest = warning("gap", "a gap of 2 ms"), note("rest", "a rest of 3 s")
    >>> objection({"warnings": [rest, gap, wrong("structure", "the model does not explain 30 % of the force")]})
    'the model does not explain 30 % of the force'
    """
    return _worst(document.get("warnings", ()), Severity.WARNING)


def _worst(messages: Iterable[str], least: Severity) -> str:
    """Return the most severe of ``messages``, the first of equal ones; "" if none is as severe as ``least``.

    They are plain text in a document that was read from a file.
    """
    return sentence(max((text for text in messages if severity_of(text) >= least), key=severity_of, default=""))


def identify(document: Mapping[str, Any], command_line: CommandLine) -> Advice:
    """Return the advice on identified parameters."""
    diagnose = command("diagnose", *command_line.records, axis=command_line.axis)
    parameters = document["parameters"].items()
    unknown = [name for name, entry in parameters if entry.get("value", entry.get("mean")) is None]
    if objection(document) or unknown:
        text = objection(document) or f"this record does not determine {', '.join(unknown)}"
        return Advice(CAUTION, text, diagnose)
    out = command_line.out
    next_step = command("report", out, out=PAGE) if out else command_line.again(out=IDENTIFIED)
    return Advice(SAFE, "nothing in the record contradicts the model and its intervals", next_step)


def _law(document: Mapping[str, Any], command_line: CommandLine) -> Advice:
    if document.get("controller") is None:
        return Advice(CAUTION, sentence(document.get("reason") or "this record does not determine the law"), None)
    equivalents, reason = document.get("equivalents"), document.get("reason")
    if equivalents or reason or document.get("verdict") not in (None, "told") or objection(document):
        text = objection(document) or reason or "another law explains the record as well"
        return Advice(CAUTION, sentence(text), None)
    next_step = command("identify", *command_line.records, axis=command_line.axis)
    return Advice(
        SAFE,
        "the residual of the command is noise and resolution of the record",
        next_step if command_line.out else command_line.again(out=CONTROLLER),
    )


def _frf(document: Mapping[str, Any], command_line: CommandLine) -> Advice:
    if objection(document):
        return Advice(CAUTION, objection(document), None)
    out = command_line.out
    next_step = command("report", command_line.axis, frf=out, out=PAGE) if out else command_line.again(out=RESPONSE)
    return Advice(SAFE, "coherence and standard deviations are those of a linear plant", next_step)


def _observe(document: Mapping[str, Any], command_line: CommandLine) -> Advice:
    if objection(document):
        return Advice(CAUTION, objection(document), command("identify", *command_line.records, axis=command_line.axis))
    least = document.get("online", document.get("offline"))["smallest_observable_force"]["value"]
    units = command_line.units
    forces, size = units.word("forces"), units.quantity(least, "N", ".3g")
    return Advice(SAFE, f"{forces} of more than {size} can be observed with this model", None)


def _diagnose(document: Mapping[str, Any], command_line: CommandLine) -> Advice:
    verdict, findings = document["verdict"], document["findings"]
    folder = command_line.out
    experiment = document.get("experiment") or {}
    next_step = command_line.again(out=FOLDER)
    if folder:
        next_step = command("report", f"{folder}/model.toml", out=PAGE)
    trial = next_step
    if folder and experiment.get("file"):
        trial = command("simulate", f"{folder}/model.toml", reference=f"{folder}/{experiment['file']}")
    sentences = {
        "unnamed": "the model lacks something that no effect of the library explains",
        "partly-named": "the named effects do not explain everything that the model lacks",
        "ambiguous": "the record cannot tell which of several effects is missing",
    }
    if verdict in sentences or document.get("unexplained") or document.get("interrupted"):
        return Advice(CAUTION, sentences.get(verdict, "no effect explains the rest of the gap"), trial)
    if objection(document):
        return Advice(CAUTION, objection(document), trial)
    if findings and not all(finding.get("confirmed") for finding in findings):
        return Advice(CAUTION, "not every effect was confirmed on held-out data; hold out a record", trial)
    names = ", ".join(finding["label"] for finding in findings)
    text = f"the missing effects were found and confirmed: {names}" if findings else "nothing is missing from the model"
    return Advice(SAFE, text, next_step)


RECORDS: dict[str, Callable[[Mapping[str, Any], CommandLine], Advice]] = {
    "identify": identify,
    "observe": _observe,
    "law": _law,
    "frf": _frf,
    "diagnose": _diagnose,
}


def where_in_words(where: Mapping[str, Any], units: Units = LINEAR) -> str:
    """Return in words how the machine of a loop differs from the axis, or "" for the axis itself.

    ``inertia`` and ``compliance`` are factors, ``delay`` [s] is additional, ``velocity`` [m/s] is where the effects are
    linearised, ``response`` is the name of a measured one; any other key is the relative error of a parameter.

    >>> where_in_words({"inertia": 3.0, "delay": 1e-3})
    'with 3 times the inertia and 1 ms more delay'
    >>> where_in_words({"mass": -0.02, "force_gain": 0.02})
    'with mass -2 % and force gain +2 %'
    """
    parts, places = [], []
    for name, value in where.items():
        if name in ("inertia", "compliance"):
            parts.append(f"{value:.4g} times the {name}")
        elif name == "delay":
            parts.append(f"{1e3 * value:.4g} ms more delay")
        elif name == "velocity":
            places.append(f"at {units.quantity(value, 'm/s', 'g')}")
        elif name == "response":
            places.append(f"on the measured plant {value}")
        else:
            parts.append(f"{' '.join(map(units.word, name.split('_')))} {100.0 * value:+.3g} %")
    listed = " and ".join([", ".join(parts[:-1]), parts[-1]] if len(parts) > 1 else parts)
    return " ".join([*([f"with {listed}"] if listed else []), *places])


def _unsafe(worst: Mapping[str, Any] | None, units: Units) -> str:
    """Return in words that the worst loop is unstable, or which of its margins are too small, or ""."""
    if worst is None:
        return ""
    if not worst["stable"]:
        return f"the {_loop(worst, units)} is unstable"
    phase, gain = worst["phase_margin_deg"], worst["gain_margin"]
    short = []
    if phase is not None and phase < SAFE_PHASE_MARGIN_DEG:
        short.append(f"{phase:.3g} deg of phase margin, less than {SAFE_PHASE_MARGIN_DEG:g}")
    if gain is not None and gain < SAFE_GAIN_MARGIN:
        short.append(f"a gain margin of {gain:.3g}, less than {SAFE_GAIN_MARGIN:g}")
    return f"the {_loop(worst, units)} has {' and '.join(short)}" if short else ""


def _loop(worst: Mapping[str, Any], units: Units) -> str:
    return " ".join(filter(None, (units.words(worst["name"]), where_in_words(worst.get("where", {}), units))))


def _has(worst: Mapping[str, Any], units: Units) -> str:
    """Return the margins of the worst loop of a safe design in words."""
    phase, gain = worst["phase_margin_deg"], worst["gain_margin"]
    has = "an unbounded phase margin" if phase is None else f"{phase:.3g} deg of phase margin"
    more = "an unbounded gain margin" if gain is None else f"a gain margin of {gain:.3g}"
    return f"the worst loop, the {_loop(worst, units)}, has {has} and {more}"


def _design(
    document: Mapping[str, Any],
    command_line: CommandLine,
    better: Callable[[], str | None],
    next_step: Callable[[], str | None],
) -> Advice:
    """Return the advice on loops; its command is ``next_step()`` if they are safe, else ``better()``."""
    if document.get("reason"):
        return Advice(
            DO_NOT_RUN, sentence(document["reason"]), nearest_command(document.get("nearest"), command_line) or better()
        )
    short = _unsafe(document.get("worst_loop"), command_line.units)
    if short or grave_warning(document):
        return Advice(CAUTION, short or grave_warning(document), better())
    worst = document.get("worst_loop")
    return Advice(SAFE, _has(worst, command_line.units) if worst else "every loop is stable", next_step())


def gains(document: Mapping[str, Any], command_line: CommandLine) -> Advice:
    """Return the advice on a velocity loop and the loops around it."""
    worst, requested = document.get("worst_loop", {}), document.get("requested", {})
    name = "crossover" if "crossover" in requested else "bandwidth"

    def better() -> str | None:
        if worst.get("name") == "position loop" and not worst.get("where"):
            others = dict.fromkeys(("position_bandwidth", "position_stiffness", "position_kp"))
            return command_line.again(**others, position_overshoot=5)
        on_axis = worst.get("stable", True) and not document.get("retuned") and not worst.get("where")
        if on_axis and requested.get("phase_margin_deg", 0.0) >= SAFE_PHASE_MARGIN_DEG:
            return command_line.again(retune=True)
        return command_line.again(**{name: 0.7 * requested[name]}) if name in requested else None

    def next_step() -> str | None:
        out = document.get("out")
        return command("compensate", str(out)) if out else command_line.again(out=DESIGN)

    return _design(document, command_line, better, next_step)


def margins(document: Mapping[str, Any], command_line: CommandLine) -> Advice:
    """Return the advice on the controller of an axis file."""

    def better() -> str | None:
        return command("gains", command_line.axis, crossover=_first_crossover(document), retune=True)

    return _design(document, command_line, better, lambda: command("compensate", command_line.axis))


def _first_crossover(document: Mapping[str, Any]) -> float:
    """Return a crossover [rad/s] to start a design with: two thirds of the lowest in ``document``, else 100 rad/s."""
    loops = [loop for loop in document.get("loops", {}).values() if loop]
    known = [loop["crossover"] for loop in loops if loop.get("crossover")]
    return float(f"{min(known) / 1.5:.2g}") if known else 100.0


def force(document: Mapping[str, Any], command_line: CommandLine) -> Advice:
    """Return the advice on a force loop."""
    limit = document["k_e1_max"]["sampled"]

    def better() -> str | None:
        slower = [document["k_e1"], *([limit] if limit else [])]
        return command_line.again(k_e1=float(f"{0.5 * min(slower):.3g}"))

    def next_step() -> str | None:
        out = document.get("out")
        if out:
            return command("export", str(out), to="c", out=CODE)
        ideal = document["structure"] == "ip" and not document["filters"]
        return command_line.again(out=DESIGN) if ideal else None

    return _design(document, command_line, better, next_step)


def impedance(document: Mapping[str, Any], command_line: CommandLine) -> Advice:
    """Return the advice on an impedance law."""
    law, study, carriage = document["law"], document.get("mismatch"), command_line.units.word("carriage")
    try_it = command("simulate", command_line.axis, scenario="comanipulation", mass=law["mass"], damping=law["damping"])
    if document.get("reason"):
        return Advice(DO_NOT_RUN, sentence(document["reason"]), nearest_command(document.get("nearest"), command_line))
    worst = document["sampled"]["simulated"] if study is None else study["worst"]["verdict"]
    verdict = document.get("verdict", worst)
    if verdict not in COMES_TO_REST:
        factor = study and study.get("coulomb_factor_without_creep")
        below = math.floor(1e3 * (factor or 0.0)) / 1e3
        less = command_line.again(coulomb_factor=below) if below and verdict == "creeping" else None
        text = grave_warning(document) or f"the released {carriage} is {verdict.replace('_', ' ')}"
        return Advice(CAUTION, text, less or nearest_command(document.get("nearest"), command_line))
    short = _unsafe(document.get("worst_loop"), command_line.units) or grave_warning(document)
    if short:
        return Advice(CAUTION, short, try_it)
    if study is None:
        return Advice(CAUTION, "only exact estimates were tried", command_line.again(mismatch=0.02))
    share = 100.0 * study["mismatch"]
    return Advice(SAFE, f"the released {carriage} comes to rest with all estimates within {share:g} %", try_it)


def simulate(document: Mapping[str, Any], command_line: CommandLine) -> Advice:
    """Return the advice on a simulation, by its scenario."""
    return SCENARIOS[document.get("scenario", "bench")](document, command_line)


def _comanipulation(document: Mapping[str, Any], command_line: CommandLine) -> Advice:
    verdict, law, carriage = document["verdict"], document["law"], command_line.units.word("carriage")
    numbers = {"mass": law["mass"], "damping": law["damping"], "mismatch": document["mismatch"]}
    judge = command(impedance.__name__, command_line.axis, **numbers)
    if document.get("reason"):
        better = nearest_command(document.get("nearest"), CommandLine(tuple(shlex.split(judge)[1:]), command_line.axis))
        return Advice(DO_NOT_RUN, sentence(document["reason"]), better or judge)
    within = f"with estimates off by up to {100 * document['mismatch']:g} %"
    if verdict not in COMES_TO_REST:
        released = f"the released {carriage}"
        sentences = {"creeping": f"{released} creeps on", "no_motion": f"the hand does not move the {carriage}"}
        return Advice(CAUTION, f"{sentences.get(verdict, f'{released} keeps swinging')} {within}", judge)
    short = _unsafe(document.get("worst_loop"), command_line.units) or grave_warning(document)
    if short:
        return Advice(CAUTION, short, judge)
    return Advice(SAFE, f"the released {carriage} comes to rest {within}", judge)


def _replay(document: Mapping[str, Any], command_line: CommandLine) -> Advice:
    errors, force = document["relative_error_percent"]["force"], command_line.units.word("force")
    next_one = command("diagnose", command_line.records[0], axis=command_line.axis)
    if errors is None or math.isnan(errors):
        return Advice(CAUTION, f"the record has no {force} to compare with", next_one)
    if errors > FOLLOWED or objection(document):
        text = (
            objection(document) or f"simulation and record differ by {errors:.3g} % of the {force}: noise, or physics"
        )
        return Advice(CAUTION, text if objection(document) else f"{text} that the model lacks", next_one)
    return Advice(SAFE, f"the simulation follows the record to {errors:.2g} % of the {force}", None)


def _reference(document: Mapping[str, Any], command_line: CommandLine) -> Advice:
    share = document["saturated_share"]
    axis = command_line.axis
    design = _design(document, command_line, lambda: command("margins", axis), lambda: command("compensate", axis))
    if design.level == SAFE and share > 0.0:
        return Advice(CAUTION, f"the command is at its limit {100 * share:.2g} % of the time", design.next)
    return design


def _without_drive(document: Mapping[str, Any], command_line: CommandLine) -> Advice:
    text = objection(document)
    if text:
        return Advice(CAUTION, text, None)
    return Advice(SAFE, "no part of this runs on a drive", None)


def compensate(document: Mapping[str, Any], command_line: CommandLine) -> Advice:
    """Return the advice on a feed-forward."""
    rms, cures = document["tracking_rms"], document.get("feedback", ())
    better = command("margins", command_line.axis)
    design = _design(document, command_line, lambda: better, lambda: None)
    if design.level != SAFE:
        return design
    cycle = _worst((cure["advice"] for cure in cures), Severity.GRAVE)
    if cycle:
        return Advice(CAUTION, cycle, better)
    if not document["kept"] or rms["worst"] > rms["without"]:
        text = "with wrong parameters the feed-forward does more harm than good"
        return Advice(CAUTION, text, command("margins", command_line.axis))
    limited = document.get("limited_share") or 0.0
    if limited > 0.0:
        return Advice(CAUTION, f"the command is at its limit {100 * limited:.2g} % of the time", command_line.again())
    next_step = command_line.again(out=COMPENSATED)
    if command_line.out:
        next_step = command("export", f"{command_line.out}/axis.toml", to="c", out=CODE)
    share = rms["worst"] / rms["without"] if rms["without"] else 0.0
    off = 100.0 * document["assumed"]["mismatch"]
    text = f"with every parameter wrong by {off:g} %, feed-forward reduces the tracking error to {100 * share:.2g} %"
    return Advice(SAFE, text, next_step)


SCENARIOS: dict[str, Callable[[Mapping[str, Any], CommandLine], Advice]] = {
    "comanipulation": _comanipulation,
    "replay": _replay,
    "reference": _reference,
    "breakaway": _without_drive,
    "bench": _without_drive,
}
DESIGNS: dict[str, Callable[[Mapping[str, Any], CommandLine], Advice]] = {
    judge.__name__: judge for judge in (gains, margins, force, impedance, simulate, compensate)
}

JUDGES: dict[str, Callable[[Mapping[str, Any], CommandLine], Advice]] = {**DESIGNS, **RECORDS}
ADVISED = (*JUDGES, "report")  # the commands whose documents get advice


def advise(
    name: str,
    document: Mapping[str, Any],
    words: Sequence[str] = (),
    axis: str | None = None,
    records: Sequence[str] = (),
    units: Units = LINEAR,
) -> Advice:
    """Return the advice on the ``document`` of the command ``name``.

    ``words`` are the command line from the command's name on, ``axis`` and ``records`` its files; the command to run
    next is made of them, or of the names in the document. ``units`` are those of the axis.

    >>> worst = {"name": "whole loop", "stable": True, "phase_margin_deg": 21.0, "gain_margin": 3.0}
    >>> advise("margins", {"axis": "servo", "worst_loop": worst, "warnings": []}).level
    'caution'
    """
    own = document.get("axis")
    axis = axis or (own if isinstance(own, str) else "AXIS")
    if not records:
        names = document.get("records", document.get("record", ()))
        records = [names] if isinstance(names, str) else [name for name in names if isinstance(name, str)]
        records = records or ["RECORD"]
    command_line = CommandLine(tuple(words) or _usual(name, axis, records), axis, tuple(records), units)
    return (report if name == "report" else JUDGES[name])(document, command_line)


def advised(name: str, document: Mapping[str, Any], units: Units = LINEAR) -> dict[str, Any]:
    """Return the ``document`` of the command ``name`` with its advice, as its result gives it without a command line.

    >>> document = {"axis": "servo", "record": "r", "parameters": {"mass": {"value": 2.0}}, "warnings": []}
    >>> advised("identify", document)["advice"]["next"]
    'emps-design identify r --axis servo --out identified.toml'
    """
    return {**document, "advice": advise(name, document, units=units).to_dict()}


def advise_on_error(
    name: str, status: int, reason: str, nearest: Mapping[str, Any], words: Sequence[str] = ()
) -> Advice:
    """Return the advice if the command ``name`` ends with an error of exit ``status`` 3 or 4.

    >>> advise_on_error("gains", 3, "no gains", {"crossover": 20.0}, ("gains", "--crossover", "99")).next
    'emps-design gains --crossover 20'
    """
    command_line = CommandLine(tuple(words) or (name,), "")
    level = DO_NOT_RUN if status == 4 and name not in RECORDS else CAUTION
    return Advice(level, sentence(reason), nearest_command(nearest, command_line))


def _usual(name: str, axis: str, records: Sequence[str]) -> tuple[str, ...]:
    return (name, *records, flag_of("axis"), axis) if name in RECORDS else (name, axis)


def report(document: Mapping[str, Any], command_line: CommandLine) -> Advice:
    """Return the worst advice on the parts of a report, the first of equal ones."""
    if document.get("reason"):
        return Advice(DO_NOT_RUN, sentence(document["reason"]), None)
    parts = [DESIGNS["gains"]({**document["velocity_loop"], "worst_loop": document.get("worst_loop")}, command_line)]
    for name, judge in DESIGNS.items():
        part = document.get(name, document.get(f"{name}_loop"))
        parts += [] if part is None else [judge(part, command_line)]
    identifications = list(document.get("identification", {}).values())
    parts += [identify(identification, command_line) for identification in identifications[:1]]
    worst = max(parts, key=lambda advice: LEVELS.index(advice.level))
    return Advice(worst.level, worst.text, None)
