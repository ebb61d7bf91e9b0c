"""What is said of a law beside its table: the structures that were compared, and what no table holds.

What a record tells of the controller that made it.

Whether a law is told: what it leaves of the command against what the record allows, and the same numbers in parts.

What a law leaves is the record's own if nothing that the controller saw explains it: noise and rounding know nothing of
the motion, while a wrong structure leaves a function of reference and position. So what is left is regressed, behind
the filter that makes it white, on what the controller saw now and a few samples before; what remains after that is what
the record allows. A law that leaves several times as much is near the true one at best. And a law is the same in every
part of its record: fitted to one part alone, its numbers agree within their deviations with those of another part.

A fit as the ``[controller]`` table of an axis file: kind, numbers by name, and what no kind of law here has.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from emps_design.identification.controller.best_law import AS_GOOD, BestLaw, command_of
from emps_design.identification.controller.fit import LawFit, covariance, fit, with_deviations
from emps_design.identification.controller.regressors import (
    ControllerSignals,
    regressors,
    sought,
    table_of as estimator_table,
)
from emps_design.laws import leaves
from emps_design.laws.estimators import NUMBERS, Estimator, estimator_in_words
from emps_design.records import Record

TOLD, AMBIGUOUS, NOT_TOLD = "told", "ambiguous", "not told"

TIMES = 2.0  # as much left as the record allows: beyond, the law is not the record's
PAST = 8  # increments of the position that what is left may be a function of
PAST_REFERENCE = 3  # of the reference: more would explain the rounding of the reference itself
APART = 6.0  # deviations between the numbers of two parts
FEWEST = 200  # samples of a part
ROUNDING = 1e-12  # of the command, or of a number: what terms added in another order may change

Numbers = dict[str, tuple[float, float]]

DISTINCT = 3.0  # deviations, those of two laws added, beyond which their numbers are two
# Twice the logarithm of the odds of the true law against one D^0.5 deviations apart is normal about D, with variance
# 4 D: from here on it passes what counts as alike in 39 of 40 records.
SURE = 2.0 + (4.0 + AS_GOOD) ** 0.5

AHEAD = ("velocity", "acceleration", "coulomb")  # the feed-forward, in the order of the table


@dataclass(frozen=True)
class LawEstimate:
    """The controller that made a record, as the ``[controller]`` table of an axis file, or why it cannot be told.

    ``verdict`` is "told"; "ambiguous", where ``equivalents`` explain the record as well; or "not told", with the
    ``reason`` and no ``controller``: ``closest`` is then the law that came nearest, if one came near, and is not the
    machine's. ``std`` has the standard deviations in the shape of the table.
    ``residual_rms`` [command unit] is what the law leaves of the command, ``residual_share`` the same over the
    command's standard deviation, and ``allowed_rms`` what the record's own noise and resolution would leave.
    ``limit`` [command unit] is None where it never acts; ``delay`` [samples] lies between a measurement and its
    command; ``tried`` has the structures that were compared, with what each leaves; ``notes`` say what a table cannot
    hold.
    """

    record: str
    verdict: str
    reason: str
    controller: dict[str, Any] | None
    std: dict[str, Any]
    residual_rms: float | None
    residual_share: float | None
    command_unit: str
    delay: int = 0
    limit: float | None = None
    limited_samples: int = 0
    equivalents: tuple[dict[str, Any], ...] = ()
    tried: tuple[dict[str, Any], ...] = ()
    notes: tuple[str, ...] = ()
    closest: dict[str, Any] | None = None
    allowed_rms: float | None = None
    warnings: tuple[str, ...] = field(default=())

    def to_dict(self) -> dict[str, Any]:
        """Everything as plain data."""
        return {
            "record": self.record,
            "verdict": self.verdict,
            "reason": self.reason,
            "controller": self.controller,
            "std": self.std,
            "closest": self.closest,
            "residual": {
                "rms": self.residual_rms,
                "share": self.residual_share,
                "allowed": self.allowed_rms,
                "unit": self.command_unit,
            },
            "delay": self.delay,
            "limit": {"value": self.limit, "samples": self.limited_samples, "unit": self.command_unit},
            "equivalents": list(self.equivalents),
            "tried": list(self.tried),
            "notes": list(self.notes),
            "warnings": list(self.warnings),
        }

    @property
    def in_words(self) -> str:
        """The controller in one line, its numbers to five digits; "" where it is not told.

        >>> LawEstimate("r", TOLD, "", {"kind": "p", "kp": 2.0000001}, {}, 0.0, 0.0, "V").in_words
        'p with kp = 2'
        """
        return "" if self.controller is None else self._said(self.controller)

    @property
    def closest_in_words(self) -> str:
        """The law that came nearest, in one line likewise; "" where none did, or the controller is told.

        >>> LawEstimate("r", NOT_TOLD, "", None, {}, 0.0, 0.0, "V", closest={"kind": "p", "kp": 2.0}).closest_in_words
        'p with kp = 2'
        """
        return "" if self.closest is None else self._said(self.closest)

    @staticmethod
    def _said(table: dict[str, Any]) -> str:
        kind, *rest = table.items()
        return f"{kind[1]} with {', '.join(f'{name} = {_inline(value, 5)}' for name, value in rest)}"

    @property
    def numbers(self) -> list[tuple[str, float, float]]:
        """The numbers of the table that have a deviation: place in it, value and standard deviation.

        >>> table, std = {"kind": "cascade", "velocity": {"kp": 2.0}}, {"velocity": {"kp": 0.1}}
        >>> LawEstimate("r", TOLD, "", table, std, 0.0, 0.0, "V").numbers
        [('velocity.kp', 2.0, 0.1)]
        """
        return [] if self.controller is None else _rows(self.controller, self.std)

    def to_toml(self) -> str:
        """The ``[controller]`` table alone, ready to paste into an axis file; raises ``ValueError`` where none is told.

        >>> LawEstimate("r", TOLD, "", {"kind": "p", "kp": 2.0}, {}, 0.0, 0.0, "V").to_toml()
        '[controller]\\nkind = "p"\\nkp = 2.0\\n'
        """
        if self.controller is None:
            raise ValueError(f"{self.record}: {self.reason}")
        return "[controller]\n" + "".join(f"{name} = {_inline(value)}\n" for name, value in self.controller.items())


def _rows(table: Any, std: Any, name: str = "") -> list[tuple[str, float, float]]:
    """The numbers of a ``table`` that have one in ``std``, by their place in it."""
    if isinstance(std, dict):
        pairs = [(f"{name}.{key}" if name else key, table[key], one) for key, one in std.items()]
    elif isinstance(std, list):
        pairs = [(f"{name}[{i}]", table[i], one) for i, one in enumerate(std)]
    else:
        return [(name, table, std)]
    return [row for key, value, one in pairs for row in _rows(value, one, key)]


def _inline(value: Any, digits: int = 0) -> str:
    """A value on one line of TOML, numbers to so many ``digits``, 0: as they are."""
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{name} = {_inline(one, digits)}" for name, one in value.items()) + " }"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_inline(one, digits) for one in value) + "]"
    if isinstance(value, str):
        return f'"{value}"'
    return f"{value:.{digits}g}" if digits else repr(value)


@dataclass(frozen=True)
class Disagreement:
    """A number that two parts of the records tell otherwise: its name, and value and deviation in each."""

    name: str
    one: tuple[float, float]
    other: tuple[float, float]
    parts: tuple[int, int]

    @property
    def apart(self) -> float:
        """Deviations between the two."""
        spread = float(np.hypot(self.one[1], self.other[1]))
        return abs(self.one[0] - self.other[0]) / max(spread, 1e3 * ROUNDING * abs(self.one[0]), 1e-300)


def times_allowed(found: BestLaw) -> float:
    """What the law leaves over what the record allows, rms over rms, at least 1 but for chance."""
    signals, law = found.signals, found.fit
    if signals.times is not None:
        return 1.0
    left = signals.counted(signals.command - command_of(signals, law, found.held))
    columns = signals.counted(_seen(found))
    norms = np.linalg.norm(columns, axis=0)
    columns = columns[:, norms > 0.0] / norms[norms > 0.0]
    if left.size < 2 * columns.shape[1]:
        return 1.0
    gains, _, rank, _ = np.linalg.lstsq(columns, left, rcond=1e-10)
    rest = left - columns @ gains
    allowed = float(rest @ rest) / max(left.size - int(rank), 1)
    mean = float(left @ left) / max(left.size - law.size, 1)
    allowed = max(allowed, (ROUNDING * float(np.abs(signals.command).max())) ** 2)
    return float(np.sqrt(mean / allowed)) if allowed > 0.0 else 1.0


def _seen(found: BestLaw) -> np.ndarray:
    """What the controller saw (n, ...): the terms of a law with either source, increments of position and reference."""
    signals, timing = found.signals, found.fit.timing
    columns = [regressors(signals, replace(timing, profile=profile), found.held) for profile in (False, True)]
    if signals.velocity_reference:
        columns = columns[:1]
    for x, count in ((signals.position, PAST), (signals.reference, PAST_REFERENCE)):
        steps = np.diff(x, prepend=x[:1])
        columns += [np.concatenate([np.zeros(late), steps[: steps.size - late]])[:, None] for late in range(count)]
    return np.column_stack(columns)


def disagreement(
    found: BestLaw, parts: Sequence[np.ndarray], numbers: Callable[..., dict[str, float]]
) -> Disagreement | None:
    """The number that two of the ``parts`` (n,) of the samples tell most unlike; None where all agree."""
    told: list[tuple[int, Numbers]] = []
    for place, part in enumerate(parts):
        used = found.signals.used & part
        if used.sum() >= FEWEST:
            told.append((place, _numbers(replace(found.signals, used=used), found, numbers)))
    worst: Disagreement | None = None
    for i, (place, one) in enumerate(told):
        for other_place, other in told[i + 1 :]:
            for name in one.keys() & other.keys():
                pair = Disagreement(name, one[name], other[name], (place, other_place))
                if pair.apart > (APART if worst is None else worst.apart):
                    worst = pair
    return worst


def halves(signals: ControllerSignals) -> list[np.ndarray]:
    """The first and the second half (n,) of the samples that count."""
    count = np.cumsum(signals.used)
    first = count <= count[-1] // 2
    return [first, ~first]


def _numbers(part: ControllerSignals, found: BestLaw, numbers: Callable[..., dict[str, float]]) -> Numbers:
    """The numbers of the law fitted to a part alone, with their deviations."""
    one = fit(part, found.fit, found.held)
    return with_deviations(one, covariance(part, one, found.held), numbers)


def described(one: LawFit, found: BestLaw) -> dict[str, Any]:
    """A structure that was compared, as plain data."""
    s, timing = one.structure, one.timing
    terms = [f"{s.form or 'p'} velocity loop" if s.velocity else "no velocity loop"]
    if s.position:
        terms.append(f"position loop every {timing.every}" + (f" from {timing.phase}" if timing.phase else ""))
    if s.velocity and s.share != 0:
        of = "profile's" if timing.profile else "reference"
        terms.append(f"all of the {of} velocity" if s.share == 1 else f"a share of the {of} velocity")
    terms += [name for name in ("acceleration", "coulomb", "force", "offset") if getattr(s, name)]
    terms += [estimator_in_words(timing.velocity_estimator), f"delay {timing.delay}"]
    terms += [f"{f.kind} {f.frequency:.4g} Hz" for f in one.filters]
    return {
        "terms": ", ".join(terms),
        "residual_rms": float(np.sqrt(one.cost / one.samples)),
        "criterion": one.criterion - found.fit.criterion,
        "apart": found.apart(one),
    }


def short(table: dict[str, Any]) -> str:
    """A table's structure in a few words."""
    every = table.get("position", {}).get("every")
    form = table.get("velocity", {}).get("form")
    source = table.get("feedforward", {}).get("source")
    parts = [table["kind"], f"form {form}" if form else "", f"every {every}" if every else "", source or ""]
    estimator = table.get("velocity_estimator", "")
    own = estimator if isinstance(estimator, str) else estimator_in_words(estimator)
    return " ".join(part for part in [*parts, own] if part)


def how_far_apart(close: Sequence[LawFit], found: BestLaw) -> str:
    """How far the nearest of the ``close`` laws is from the one given, and what would tell it."""
    apart = max(min(map(found.apart, close)), 1e-6)
    return (
        f"the nearest of them is {apart:.2g} standard deviations of the noise apart, over all samples; to tell it "
        f"takes {SURE:.2g}: about {(SURE / apart) ** 2:.2g} times as much of such motion, all given to law"
    )


def notes_of(several: Sequence[Record], unit: str, found: BestLaw, steps: np.ndarray | None) -> tuple[str, ...]:
    """What the reader has to know and the table does not say."""
    timing, s = found.fit.timing, found.fit.structure
    notes = []
    if timing.delay:
        notes.append(f"the command in the record is {timing.delay} samples behind the position it follows from")
    if s.skew:
        part = dict(zip(s.linear, found.fit.linear, strict=True))
        ahead = -1e3 * float(part["skew"] / part["position"])
        when = "before" if ahead > 0.0 else "after"
        other = ", or the law damps velocity as much" if ahead > 0.0 else ""
        notes.append(f"the position is recorded {abs(ahead):.2g} ms {when} the one that the command follows{other}")
    if timing.phase:
        notes.append(f"the position loop runs first at sample {timing.phase}: leave out as many at the start")
    if s.offset:
        offset = float(found.fit.linear[s.linear.index("offset")])
        what = "the integral starts at" if s.form else "the command carries a constant"
        notes.append(f"{what} {f'{offset:.4g} {unit}'.rstrip()}, which no table holds")
    if found.limit is not None:
        notes.append(f"the limit of {f'{found.limit:.6g} {unit}'.rstrip()} acts: command_limit of [drive]")
        if found.holds is None and s.form:
            notes.append("what the integral does at the limit is not told: anti_windup is the default")
    if steps is not None:
        notes.append(f"steps of {np.std(steps):.3g} {unit} rms, added to the controller's output, were taken off first")
    if any(one.enable is not None and np.any(one.enable <= 0.0) for one in several):
        notes.append("samples with the motor switched off were left out")
    if not np.ptp(found.signals.reference[found.signals.used]) > 0.0:
        notes.append("the reference stands still, so feed-forward is not told")
    return tuple(notes)


def too_much_left(found: BestLaw, times: float, unit: str) -> str:
    """Why a law is none although it leaves little: how close it came, and what is left."""
    left = f"{found.rms:.3g} {unit}".rstrip()
    return (
        f"the closest law leaves {left} rms, {100 * found.share:.3g} % of the command's deviation, {times:.3g} times "
        "what the record's own noise and resolution would: it has another structure, filter or velocity estimator"
    )


def in_parts(apart: Disagreement, several: Sequence[Record]) -> str:
    """Which number two parts of a record, or two records, tell otherwise."""
    (one, one_std), (other, other_std) = apart.one, apart.other
    said = f"{apart.name} is {one:.5g} +- {one_std:.2g}"
    if len(several) > 1:
        first, second = (several[place].name for place in apart.parts)
        return f"the records disagree: {said} in {first}, {other:.5g} +- {other_std:.2g} in {second}"
    return f"its halves disagree: {said} in the first, {other:.5g} +- {other_std:.2g} in the second"


def unlike(together: LawEstimate, alone: Sequence[LawEstimate]) -> LawEstimate:
    """What no one law made, with what the records say alone: which disagree, and on what."""
    known = [one for one in alone if one.controller is not None]
    if len(known) < 2:
        return together
    first, *rest = known
    for other in rest:
        differ = _differences(first, other)
        if differ:
            reason = f"the records disagree, {first.record} and {other.record}: {'; '.join(differ)}"
            return replace(together, reason=reason, closest=None)
    return together


def _differences(one: LawEstimate, other: LawEstimate) -> list[str]:
    """What the tables of two laws have different, numbers beyond their deviations."""
    tables = [dict(leaves(_of_unlike_estimators(own, against))) for own, against in ((one, other), (other, one))]
    stds = [dict(leaves(estimate.std)) for estimate in (one, other)]
    found = []
    for path in dict.fromkeys([*tables[0], *tables[1]]):
        a, b = (table.get(path) for table in tables)
        spread = sum(std.get(path, 0.0) for std in stds)
        alike = isinstance(a, float) and isinstance(b, float) and abs(a - b) <= DISTINCT * spread
        if a != b and not alike:
            found.append(f"{'.'.join(path)} {_shown(a)} and {_shown(b)}")
    return found


def _of_unlike_estimators(own: LawEstimate, against: LawEstimate) -> dict[str, Any]:
    """The table of ``own``, its velocity estimator in words where the other's is of another kind."""
    table = own.controller or {}
    mine, other = table.get("velocity_estimator"), (against.controller or {}).get("velocity_estimator")
    kinds = [one.get("kind") if isinstance(one, dict) else one for one in (mine, other)]
    if mine is None or other is None or kinds[0] == kinds[1]:
        return table
    return {**table, "velocity_estimator": estimator_in_words(mine)}


def _shown(value: Any) -> str:
    return f"{value:.5g}" if isinstance(value, float) else "none" if value is None else str(value)


def kind_of(found: LawFit, velocity_reference: bool) -> str:
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


def numbers_of(found: LawFit, velocity_reference: bool) -> dict[str, float]:
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


def table_of(found: LawFit, velocity_reference: bool, numbers: dict[str, float], holds: bool) -> dict[str, Any]:
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


def deviations_of(found: LawFit, stds: dict[str, float]) -> dict[str, Any]:
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
