"""The parts of an advice: its levels, the command that was asked and the ones to run next, what a warning means.

The advice on what was found in a record: nothing speaks against it, or what does and what to do about that.

The advice on a design: on the loops of a controller, on an impedance law, and on what a simulation made of them.

When a loop is safe, and the machines that it was tried on, in words.
"""

from __future__ import annotations

import math
import re
import shlex
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

SAFE, CAUTION, DO_NOT_RUN = LEVELS = ("safe", "caution", "do-not-run")
GRAVE = re.compile(  # words of a warning beside which no design is safe
    r"\bunstable\b|\bcreep|limit cycle|\bkeeps? (?:on )?(?:swinging|oscillating)|\bhunt\b|\bsinks\b|\bdiverg"
    r"|barely stable|unexplained|structure is left|apparent damping is not positive|steady motion at .* takes",
    re.IGNORECASE,
)
HARMLESS = re.compile(  # warnings about a record that speak against nothing that was found in it
    r"f_ext acts on the simulated carriage|by output error, for the measured motion is noise|lines left out"
    r"|no Kalman observer|simulated in open loop from the recorded|fitted anew on the confirming record"
    r"|Nothing above .* can be told"
)
WORST_FIRST = (  # words of warnings about a record, by what they do to what was found in it; others come last
    r"may be wrong by more than it says",
    r"^no axis has|has the wrong sign",
    r"^far from the axis",
    r"unexplained|structure is left",
    r"is not determined|cannot be told",
)
PROPOSED = {  # what `nearest` proposes -> the option that asks for it
    "crossover": "crossover", "bandwidth": "bandwidth", "phase_margin_deg": "phase_margin",
    "position_kp": "position_kp", "k_e1": "k_e1", "mass": "mass", "damping": "damping", "filter": "filter",
}  # fmt: skip
LEFT_OUT = {"json": 0, "debug": 0, "plot": 1}  # options that are not asked for again, and the words behind each

PAGE = "design.html"
FOLDER, RESPONSE, CONTROLLER, IDENTIFIED = "diagnosis", "response.csv", "controller.toml", "identified.toml"

SAFE_PHASE_MARGIN_DEG, SAFE_GAIN_MARGIN = 30.0, 2.0

FOLLOWED = 2.0  # % of the force by which a replay may miss that of the record and follow it
COMES_TO_REST = ("stable", "dead_band")  # verdicts on a carriage that is let go
SWINGS = ("limit_cycle", "unstable")
DESIGN, CODE, COMPENSATED = "design.toml", "code", "compensated"  # what is proposed to write


@dataclass(frozen=True)
class Advice:
    """One of :data:`LEVELS`, one sentence why, and the command to run next, None where there is none.

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
    """A command as it was asked: its ``words`` from its name on, and the files ``axis`` and ``records`` among them."""

    words: tuple[str, ...]
    axis: str
    records: tuple[str, ...] = ()

    @property
    def out(self) -> str | None:
        """The file or folder that it was asked to write."""
        for word, after in zip(self.words, (*self.words[1:], None), strict=True):
            name, equals, value = word.partition("=")
            if name == flag_of("out"):
                return value if equals else after
        return None

    def again(self, **options: Any) -> str:
        """The same command with other ``options``; True: one without a value, None: left out.

        >>> command = CommandLine(("gains", "a b.toml", "--crossover", "90", "--json"), "a b.toml")
        >>> command.again(crossover=60.0, retune=True)
        "emps-design gains 'a b.toml' --crossover 60 --retune"
        """
        gone = {flag_of(name): behind for name, behind in LEFT_OUT.items()}
        gone |= {flag_of(name): int(value is not True) for name, value in options.items()}
        words, rest = [], iter(self.words)
        for word in rest:
            name, equals, _ = word.partition("=")
            if name not in gone:
                words.append(word)
            elif gone[name] and not equals:
                next(rest, None)
        return command(*words, **options)


def flag_of(option: str) -> str:
    """The flag of an option of the command line.

    >>> flag_of("phase_margin")
    '--phase-margin'
    """
    return f"--{option.replace('_', '-')}"


def command(*words: str, **options: Any) -> str:
    """A command line of this program, quoted for a shell; an option that is True has no value, None leaves it out.

    >>> command("margins", "my axis.toml", mismatch=0.02)
    "emps-design margins 'my axis.toml' --mismatch 0.02"
    """
    line = ["emps-design", *words]
    for name, value in options.items():
        line += [] if value is None else [flag_of(name)] if value is True else [flag_of(name), written(value)]
    return shlex.join(line)


def written(value: Any) -> str:
    """A value as an option takes it, a number in six digits."""
    return f"{value:.6g}" if isinstance(value, float) else str(value)


def sentence(text: str) -> str:
    """``text`` as the words of an advice: one line, capitals and full stop left to who prints it."""
    return " ".join(text.split()).rstrip(".")


def nearest_command(found: Mapping[str, Any] | None, asked: CommandLine) -> str | None:
    """The same command with the nearest that works; None where that is nothing that the command can be asked for."""
    given = {name: value for name, value in (found or {}).items() if name != "or" and value is not None}
    if not given or not given.keys() <= PROPOSED.keys():
        return None
    return asked.again(**{PROPOSED[name]: float(value) for name, value in given.items()})


def grave(document: Mapping[str, Any]) -> str:
    """The first warning beside which no design is safe, "" for none."""
    return next((sentence(text) for text in document.get("warnings", ()) if GRAVE.search(text)), "")


def against(document: Mapping[str, Any]) -> str:
    """The gravest warning that speaks against what was found in a record, of several alike the first, "" for none.

    >>> against({"warnings": ["a gap of 2 ms", "the model leaves 30 % of the force unexplained", "a rest of 3 s"]})
    'the model leaves 30 % of the force unexplained'
    """
    said = [sentence(text) for text in document.get("warnings", ()) if not HARMLESS.search(text)]
    return min(said, key=_rank, default="")


def _rank(text: str) -> int:
    """The place of a warning in :data:`WORST_FIRST`."""
    return next((i for i, words in enumerate(WORST_FIRST) if re.search(words, text)), len(WORST_FIRST))


def identify(document: Mapping[str, Any], asked: CommandLine) -> Advice:
    """The advice on identified parameters."""
    diagnose = command("diagnose", *asked.records, axis=asked.axis)
    unknown = [name for name, one in document["parameters"].items() if one.get("value", one.get("mean")) is None]
    if against(document) or unknown:
        text = against(document) or f"{', '.join(unknown)} cannot be told from this record"
        return Advice(CAUTION, text, diagnose)
    out = asked.out
    onward = command("report", out) if out else asked.again(out=IDENTIFIED)
    if out:
        onward = command("report", out, out=PAGE)
    return Advice(SAFE, "nothing in the record speaks against the model and its intervals", onward)


def _law(document: Mapping[str, Any], asked: CommandLine) -> Advice:
    if document.get("controller") is None:
        return Advice(CAUTION, sentence(document.get("reason") or "the law cannot be told from this record"), None)
    equivalents, reason = document.get("equivalents"), document.get("reason")
    if equivalents or reason or document.get("verdict") not in (None, "told") or against(document):
        text = against(document) or reason or "another law explains the record as well"
        return Advice(CAUTION, sentence(text), None)
    onward = command("identify", *asked.records, axis=asked.axis)
    return Advice(
        SAFE,
        "what is left of the command is the record's own noise and resolution",
        onward if asked.out else asked.again(out=CONTROLLER),
    )


def _frf(document: Mapping[str, Any], asked: CommandLine) -> Advice:
    if against(document):
        return Advice(CAUTION, against(document), None)
    out = asked.out
    onward = command("report", asked.axis, frf=out, out=PAGE) if out else asked.again(out=RESPONSE)
    return Advice(SAFE, "coherence and deviations are those of a plant that answers as a linear one", onward)


def _observe(document: Mapping[str, Any], asked: CommandLine) -> Advice:
    if against(document):
        return Advice(CAUTION, against(document), command("identify", *asked.records, axis=asked.axis))
    least = document.get("online", document.get("offline"))["smallest_observable_force"]["value"]
    return Advice(SAFE, f"forces of more than {least:.3g} N are seen with this model", None)


def _diagnose(document: Mapping[str, Any], asked: CommandLine) -> Advice:
    verdict, findings = document["verdict"], document["findings"]
    folder = asked.out
    experiment = document.get("experiment") or {}
    onward = asked.again(out=FOLDER)
    if folder:
        onward = command("report", f"{folder}/model.toml", out=PAGE)
    tried = onward
    if folder and experiment.get("file"):
        tried = command("simulate", f"{folder}/model.toml", reference=f"{folder}/{experiment['file']}")
    said = {
        "unnamed": "something is missing from the model that no effect of the library explains",
        "partly-named": "beside what has a name something is missing that no effect explains",
        "ambiguous": "the record cannot tell which of several effects is missing",
    }
    if verdict in said or document.get("unexplained") or document.get("interrupted"):
        return Advice(CAUTION, said.get(verdict, "structure is left that no effect explains"), tried)
    if against(document):
        return Advice(CAUTION, against(document), tried)
    if findings and not all(finding.get("confirmed") for finding in findings):
        return Advice(CAUTION, "not every effect was confirmed on data that did not find it; hold a record out", tried)
    names = ", ".join(finding["label"] for finding in findings)
    text = (
        f"what was missing has a name and was confirmed: {names}" if findings else "nothing is missing from the model"
    )
    return Advice(SAFE, text, onward)


RECORDS: dict[str, Callable[[Mapping[str, Any], CommandLine], Advice]] = {
    "identify": identify,
    "observe": _observe,
    "law": _law,
    "frf": _frf,
    "diagnose": _diagnose,
}


def where_in_words(where: Mapping[str, Any]) -> str:
    """Say on which machine a loop is, from what that has different from the axis; empty for the axis as it is.

    ``inertia`` and ``compliance`` are factors, ``delay`` [s] comes on top, ``velocity`` [m/s] is where the effects are
    linearised, ``response`` the name of a measured one; any other is the relative error of a parameter.

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
            places.append(f"at {value:g} m/s")
        elif name == "response":
            places.append(f"on the measured plant {value}")
        else:
            parts.append(f"{name.replace('_', ' ')} {100.0 * value:+.3g} %")
    listed = " and ".join([", ".join(parts[:-1]), parts[-1]] if len(parts) > 1 else parts)
    return " ".join([*([f"with {listed}"] if listed else []), *places])


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
    document: Mapping[str, Any], asked: CommandLine, better: Callable[[], str | None], onward: Callable[[], str | None]
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


def gains(document: Mapping[str, Any], asked: CommandLine) -> Advice:
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


def margins(document: Mapping[str, Any], asked: CommandLine) -> Advice:
    """The advice on the controller of an axis file."""

    def better() -> str | None:
        return command("gains", asked.axis, crossover=_tenth(document), retune=True)

    return _design(document, asked, better, lambda: command("compensate", asked.axis))


def _tenth(document: Mapping[str, Any]) -> float:
    """A crossover [rad/s] to begin a design with: two thirds of that of the loops there are, or 100 rad/s at 1 kHz."""
    loops = [loop for loop in document.get("loops", {}).values() if loop]
    known = [loop["crossover"] for loop in loops if loop.get("crossover")]
    return float(f"{min(known) / 1.5:.2g}") if known else 100.0


def force(document: Mapping[str, Any], asked: CommandLine) -> Advice:
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


def impedance(document: Mapping[str, Any], asked: CommandLine) -> Advice:
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


def simulate(document: Mapping[str, Any], asked: CommandLine) -> Advice:
    """The advice on a simulation, by its scenario."""
    return SCENARIOS[document.get("scenario", "bench")](document, asked)


def _comanipulation(document: Mapping[str, Any], asked: CommandLine) -> Advice:
    verdict, law = document["verdict"], document["law"]
    numbers = {"mass": law["mass"], "damping": law["damping"], "mismatch": document["mismatch"]}
    judge = command(impedance.__name__, asked.axis, **numbers)
    if document.get("reason"):
        better = nearest_command(document.get("nearest"), CommandLine(tuple(shlex.split(judge)[1:]), asked.axis))
        return Advice(DO_NOT_RUN, sentence(document["reason"]), better or judge)
    within = f"with estimates off by up to {100 * document['mismatch']:g} %"
    if verdict not in COMES_TO_REST:
        said = {"creeping": "the released carriage creeps on", "no_motion": "the hand does not move the carriage"}
        return Advice(CAUTION, f"{said.get(verdict, 'the released carriage keeps swinging')} {within}", judge)
    if _unsafe(document.get("worst_loop")) or grave(document):
        return Advice(CAUTION, _unsafe(document.get("worst_loop")) or grave(document), judge)
    return Advice(SAFE, f"the released carriage comes to rest {within}", judge)


def _replay(document: Mapping[str, Any], asked: CommandLine) -> Advice:
    missed = document["relative_error_percent"]["force"]
    next_one = command("diagnose", asked.records[0], axis=asked.axis)
    if missed is None or math.isnan(missed):
        return Advice(CAUTION, "the record has no force to compare with", next_one)
    if missed > FOLLOWED or against(document):
        text = against(document) or f"simulation and record differ by {missed:.3g} % of the force: noise, or physics"
        return Advice(CAUTION, text if against(document) else f"{text} that the model lacks", next_one)
    return Advice(SAFE, f"the simulation follows the record to {missed:.2g} % of the force", None)


def _reference(document: Mapping[str, Any], asked: CommandLine) -> Advice:
    share = document["saturated_share"]
    design = _design(document, asked, lambda: command("margins", asked.axis), lambda: command("compensate", asked.axis))
    if design.level == SAFE and share > 0.0:
        return Advice(CAUTION, f"the command is at its limit {100 * share:.2g} % of the time", design.next)
    return design


def _only_said(document: Mapping[str, Any], asked: CommandLine) -> Advice:
    text = against(document)
    if text:
        return Advice(CAUTION, text, None)
    return Advice(SAFE, "nothing of this runs on a drive", None)


def compensate(document: Mapping[str, Any], asked: CommandLine) -> Advice:
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


SCENARIOS: dict[str, Callable[[Mapping[str, Any], CommandLine], Advice]] = {
    "comanipulation": _comanipulation,
    "replay": _replay,
    "reference": _reference,
    "breakaway": _only_said,
    "bench": _only_said,
}
DESIGNS: dict[str, Callable[[Mapping[str, Any], CommandLine], Advice]] = {
    judge.__name__: judge for judge in (gains, margins, force, impedance, simulate, compensate)
}
