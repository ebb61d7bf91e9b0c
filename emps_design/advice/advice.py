"""The parts of an advice: its levels, the command that was asked and the ones to run next, what a warning means."""

from __future__ import annotations

import re
import shlex
from collections.abc import Mapping
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
class Asked:
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

        >>> Asked(("gains", "a b.toml", "--crossover", "90", "--json"), "a b.toml").again(crossover=60.0, retune=True)
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


def nearest_command(found: Mapping[str, Any] | None, asked: Asked) -> str | None:
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
