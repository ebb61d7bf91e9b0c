"""The result of the identification of a controller, and the tests that it must pass.

:class:`LawEstimate` is the result: the ``[controller]`` table of an axis file with deviations, the compared structures,
and notes on what no table holds.

A law must leave no more than the record allows. Noise and rounding are independent of the motion, while a wrong
structure leaves a function of reference and position. So the whitened residual is regressed on the controller's inputs
now and a few samples before, and the remainder is what the record allows. A law with several times that residual is at
best close to the true one. And a law must be the same in every part of its record: fitted to two parts alone, its
numbers agree within their deviations.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from emps_design.advice import advised
from emps_design.identification.controller.best_law import AS_GOOD, BestLaw, command_of
from emps_design.identification.controller.fit import LawFit, covariance, fit, with_deviations
from emps_design.identification.controller.regressors import ControllerSignals, estimator_table, regressors, sought
from emps_design.laws import leaves
from emps_design.laws.estimators import NUMBERS, Estimator, estimator_in_words
from emps_design.records import Record
from emps_design.units import Units
from emps_design.view import Line, Table, View, Viewed

TOLD, AMBIGUOUS, NOT_TOLD = "told", "ambiguous", "not told"

TIMES = 2.0  # as much left as the record allows: beyond, the law is not the record's
PAST = 8  # increments of the position on which the residual is regressed
PAST_REFERENCE = 3  # of the reference: more would explain the rounding of the reference itself
APART = 6.0  # deviations between the numbers of two parts
FEWEST = 200  # samples of a part
ROUNDING = 1e-12  # of the command, or of a number: rounding by another order of summation

Numbers = dict[str, tuple[float, float]]

DISTINCT = 3.0  # deviations, those of two laws added, beyond which their numbers differ
# Twice the log odds of the true law against one that is D^0.5 deviations apart is normal about D with variance 4 D:
# from this distance on it exceeds AS_GOOD in 39 of 40 records.
SURE = 2.0 + (4.0 + AS_GOOD) ** 0.5

AHEAD = ("velocity", "acceleration", "coulomb")  # the feed-forward, in the order of the table


@dataclass(frozen=True)
class LawEstimate(Viewed):
    """The controller that made a record, as the ``[controller]`` table of an axis file, or why it is not identified.

    ``verdict`` is "told"; "ambiguous", where ``equivalents`` explain the record as well; or "not told", with the
    ``reason`` and no ``controller``: ``closest`` is then the nearest law, if one came close, which is not the machine's
    own. ``std`` holds the standard deviations in the shape of the table. ``residual_rms`` [command unit] is the rms
    residual of the command, ``residual_share`` the same over the command's standard deviation, and ``allowed_rms`` the
    rms of the record's own noise and resolution. ``limit`` [command unit] is None where it never acts; ``delay``
    [samples] lies between a measurement and its command; ``tried`` lists the compared structures with their residuals;
    ``notes`` say what a table cannot hold.
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

    def to_dict(self) -> dict[str, Any]:
        """Everything as plain data."""
        document = {
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
            "warnings": [],
        }
        return advised("law", document)

    def view(self) -> View:
        """What a terminal and a notebook show: the verdict, the table, its numbers, and the compared structures."""
        return tuple(self._shown())

    def _shown(self) -> Iterator[Line | Table]:
        yield Line(self.verdict + (f": {self.reason}" if self.reason else ""), "strong")
        if self.controller is not None:
            for line in ("", *self.to_toml().splitlines(), ""):
                yield Line(line, "code")
            rows = [
                (name, f"{value:.7g}", f"{std:.2g}", f"{abs(100 * std / value):.2g}" if value else "")
                for name, value, std in self.numbers
            ]
            yield Table(("number", "value", "std", "std [%]"), rows)
        elif self.closest is not None:
            yield Line(f"the closest law, which differs from the machine's: {self.closest_in_words}")
        if self.residual_rms is not None and self.residual_share is not None:
            rms = f"{self.residual_rms:.4g} {self.command_unit}".rstrip()
            own = f"; noise and resolution account for {self.allowed_rms:.4g}" if self.allowed_rms is not None else ""
            yield Line(f"residual {rms} rms, {100 * self.residual_share:.3g} % of the command's deviation{own}")
        for note in self.notes:
            yield Line(note)
        if len(self.tried) > 1:
            compared = [
                (row["terms"], f"{row['residual_rms']:.4g}", f"{row['criterion']:+.1f}", f"{row['apart']:.1f}")
                for row in self.tried
            ]
            unit = f" [{self.command_unit}]" if self.command_unit else ""
            yield Table(("structure", f"left, whitened{unit}", "criterion", "apart [std]"), compared, "tried")

    @property
    def in_words(self) -> str:
        """The controller in one line, its numbers to five digits; "" where it is not told.

        >>> LawEstimate("r", TOLD, "", {"kind": "p", "kp": 2.0000001}, {}, 0.0, 0.0, "V").in_words
        'p with kp = 2'
        """
        return "" if self.controller is None else self._line(self.controller)

    @property
    def closest_in_words(self) -> str:
        """The nearest law in one line; "" where none came close, or the controller is told.

        >>> LawEstimate("r", NOT_TOLD, "", None, {}, 0.0, 0.0, "V", closest={"kind": "p", "kp": 2.0}).closest_in_words
        'p with kp = 2'
        """
        return "" if self.closest is None else self._line(self.closest)

    @staticmethod
    def _line(table: dict[str, Any]) -> str:
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
        """The ``[controller]`` table, ready to paste into an axis file; raises ``ValueError`` where none is told.

        >>> LawEstimate("r", TOLD, "", {"kind": "p", "kp": 2.0}, {}, 0.0, 0.0, "V").to_toml()
        '[controller]\\nkind = "p"\\nkp = 2.0\\n'
        """
        if self.controller is None:
            raise ValueError(f"{self.record}: {self.reason}")
        return "[controller]\n" + "".join(f"{name} = {_inline(value)}\n" for name, value in self.controller.items())


def _rows(table: Any, std: Any, name: str = "") -> list[tuple[str, float, float]]:
    """The numbers of ``table`` that have a deviation in ``std``: (place, number, deviation)."""
    if isinstance(std, dict):
        pairs = [(f"{name}.{key}" if name else key, table[key], deviation) for key, deviation in std.items()]
    elif isinstance(std, list):
        pairs = [(f"{name}[{i}]", table[i], deviation) for i, deviation in enumerate(std)]
    else:
        return [(name, table, std)]
    return [row for key, value, deviation in pairs for row in _rows(value, deviation, key)]


def _inline(value: Any, digits: int = 0) -> str:
    """A value on one line of TOML; numbers with ``digits`` digits, or unrounded with 0."""
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{name} = {_inline(element, digits)}" for name, element in value.items()) + " }"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_inline(element, digits) for element in value) + "]"
    if isinstance(value, str):
        return f'"{value}"'
    return f"{value:.{digits}g}" if digits else repr(value)


@dataclass(frozen=True)
class Disagreement:
    """A number that differs between two parts of the records: its name, and (value, deviation) in each."""

    name: str
    first: tuple[float, float]
    second: tuple[float, float]
    parts: tuple[int, int]

    @property
    def apart(self) -> float:
        """Distance of the two values in deviations."""
        spread = float(np.hypot(self.first[1], self.second[1]))
        return abs(self.first[0] - self.second[0]) / max(spread, 1e3 * ROUNDING * abs(self.first[0]), 1e-300)


def times_allowed(best: BestLaw) -> float:
    """Residual of the law over the one that the record allows, rms over rms; at least 1 but for chance."""
    signals, law = best.signals, best.fit
    if signals.times is not None:
        return 1.0
    residual = signals.counted(signals.command - command_of(signals, law, best.held))
    columns = signals.counted(_inputs(best))
    norms = np.linalg.norm(columns, axis=0)
    columns = columns[:, norms > 0.0] / norms[norms > 0.0]
    if residual.size < 2 * columns.shape[1]:
        return 1.0
    gains, _, rank, _ = np.linalg.lstsq(columns, residual, rcond=1e-10)
    rest = residual - columns @ gains
    allowed = float(rest @ rest) / max(residual.size - int(rank), 1)
    mean = float(residual @ residual) / max(residual.size - law.size, 1)
    allowed = max(allowed, (ROUNDING * float(np.abs(signals.command).max())) ** 2)
    return float(np.sqrt(mean / allowed)) if allowed > 0.0 else 1.0


def _inputs(best: BestLaw) -> np.ndarray:
    """The controller's inputs (n, ...): terms with either source, past increments of position and reference."""
    signals, timing = best.signals, best.fit.timing
    columns = [regressors(signals, replace(timing, profile=profile), best.held) for profile in (False, True)]
    if signals.velocity_reference:
        columns = columns[:1]
    for x, count in ((signals.position, PAST), (signals.reference, PAST_REFERENCE)):
        steps = np.diff(x, prepend=x[:1])
        columns += [np.concatenate([np.zeros(late), steps[: steps.size - late]])[:, None] for late in range(count)]
    return np.column_stack(columns)


def disagreement(
    best: BestLaw, parts: Sequence[np.ndarray], numbers: Callable[..., dict[str, float]]
) -> Disagreement | None:
    """The number that differs most between two of the ``parts``, masks (n,); None where all agree."""
    estimates: list[tuple[int, Numbers]] = []
    for place, part in enumerate(parts):
        used = best.signals.used & part
        if used.sum() >= FEWEST:
            estimates.append((place, _numbers(replace(best.signals, used=used), best, numbers)))
    worst: Disagreement | None = None
    for i, (place, first) in enumerate(estimates):
        for other_place, other in estimates[i + 1 :]:
            for name in first.keys() & other.keys():
                pair = Disagreement(name, first[name], other[name], (place, other_place))
                if pair.apart > (APART if worst is None else worst.apart):
                    worst = pair
    return worst


def halves(signals: ControllerSignals) -> list[np.ndarray]:
    """Masks (n,) of the first and the second half of the samples that count."""
    count = np.cumsum(signals.used)
    first = count <= count[-1] // 2
    return [first, ~first]


def _numbers(part: ControllerSignals, best: BestLaw, numbers: Callable[..., dict[str, float]]) -> Numbers:
    """The numbers of the law fitted to one part, with their deviations."""
    law = fit(part, best.fit, best.held)
    return with_deviations(law, covariance(part, law, best.held), numbers)


def described(law: LawFit, best: BestLaw, units: Units) -> dict[str, Any]:
    """A compared structure as plain data, in the words of ``units``."""
    s, timing = law.structure, law.timing
    terms = [f"{s.form or 'p'} velocity loop" if s.velocity else "no velocity loop"]
    if s.position:
        terms.append(f"position loop every {timing.every}" + (f" from {timing.phase}" if timing.phase else ""))
    if s.velocity and s.share != 0:
        of = "profile's" if timing.profile else "reference"
        terms.append(f"all of the {of} velocity" if s.share == 1 else f"a share of the {of} velocity")
    terms += [units.word(name) for name in ("acceleration", "coulomb", "force", "offset") if getattr(s, name)]
    terms += [estimator_in_words(timing.velocity_estimator), f"delay {timing.delay}"]
    terms += [f"{f.kind} {f.frequency:.4g} Hz" for f in law.filters]
    return {
        "terms": ", ".join(terms),
        "residual_rms": float(np.sqrt(law.cost / law.samples)),
        "criterion": law.criterion - best.fit.criterion,
        "apart": best.apart(law),
    }


def short(table: dict[str, Any]) -> str:
    """The structure of a controller table in a few words."""
    every = table.get("position", {}).get("every")
    form = table.get("velocity", {}).get("form")
    source = table.get("feedforward", {}).get("source")
    parts = [table["kind"], f"form {form}" if form else "", f"every {every}" if every else "", source or ""]
    estimator = table.get("velocity_estimator", "")
    own = estimator if isinstance(estimator, str) else estimator_in_words(estimator)
    return " ".join(part for part in [*parts, own] if part)


def how_far_apart(close: Sequence[LawFit], best: BestLaw) -> str:
    """A note on how far the nearest of the ``close`` laws is, and how much more motion would separate them."""
    apart = max(min(map(best.apart, close)), 1e-6)
    return (
        f"the nearest of them is {apart:.2g} standard deviations of the noise apart, over all samples; separating them "
        f"requires {SURE:.2g}: about {(SURE / apart) ** 2:.2g} times as much of such motion, in one or several records"
    )


def notes_of(several: Sequence[Record], unit: str, best: BestLaw, steps: np.ndarray | None) -> tuple[str, ...]:
    """Notes for the user on what the table does not say."""
    timing, s = best.fit.timing, best.fit.structure
    notes = []
    if timing.delay:
        notes.append(
            f"the command in the record is {timing.delay} samples later than the position from which it is computed"
        )
    if s.skew:
        ahead = -1e3 * (best.fit.part["skew"] / best.fit.part["position"])
        when = "before" if ahead > 0.0 else "after"
        other = ", or the law has equivalent velocity damping" if ahead > 0.0 else ""
        notes.append(f"the position is recorded {abs(ahead):.2g} ms {when} the one that the controller used{other}")
    if timing.phase:
        notes.append(f"the position loop runs first at sample {timing.phase}: cut this number of samples at the start")
    if s.offset:
        what = "the integral starts at" if s.form else "the command contains a constant"
        constant = f"{best.fit.part['offset']:.4g} {unit}".rstrip()
        notes.append(f"{what} {constant}, which no axis file can hold")
    if best.limit is not None:
        notes.append(f"the limit of {f'{best.limit:.6g} {unit}'.rstrip()} acts: command_limit of [drive]")
        if best.holds is None and s.form:
            notes.append("the record does not determine the anti-windup: anti_windup is the default")
    if steps is not None:
        notes.append(
            f"steps of {np.std(steps):.3g} {unit} rms, added to the controller's output, were subtracted first"
        )
    if any(record.enable is not None and np.any(record.enable <= 0.0) for record in several):
        notes.append("samples with the motor switched off were left out")
    if not np.ptp(best.signals.reference[best.signals.used]) > 0.0:
        notes.append("the reference is constant, so the feed-forward is not determined")
    return tuple(notes)


def too_much_left(best: BestLaw, times: float, unit: str) -> str:
    """The reason to reject a law with a small residual that is still larger than the record allows."""
    rms = f"{best.rms:.3g} {unit}".rstrip()
    return (
        f"the closest law leaves {rms} rms, {100 * best.share:.3g} % of the command's deviation, {times:.3g} times "
        "what noise and resolution of the record explain: the machine has another structure, filter or velocity "
        "estimator"
    )


def in_parts(apart: Disagreement, several: Sequence[Record]) -> str:
    """A message on the number that differs between two parts of a record, or between two records."""
    (value, std), (other, other_std) = apart.first, apart.second
    statement = f"{apart.name} is {value:.5g} +- {std:.2g}"
    if len(several) > 1:
        first, second = (several[place].name for place in apart.parts)
        return f"the records disagree: {statement} in {first}, {other:.5g} +- {other_std:.2g} in {second}"
    return f"its halves disagree: {statement} in the first, {other:.5g} +- {other_std:.2g} in the second"


def unlike(together: LawEstimate, alone: Sequence[LawEstimate]) -> LawEstimate:
    """The estimate ``together``, its reason replaced by how the estimates from each record ``alone`` differ."""
    known = [estimate for estimate in alone if estimate.controller is not None]
    if len(known) < 2:
        return together
    first, *rest = known
    for other in rest:
        differ = _differences(first, other)
        if differ:
            reason = f"the records disagree, {first.record} and {other.record}: {'; '.join(differ)}"
            return replace(together, reason=reason, closest=None)
    return together


def _differences(first: LawEstimate, other: LawEstimate) -> list[str]:
    """Differences between the tables of two laws; of numbers only those beyond their deviations."""
    tables = [dict(leaves(_comparable_table(own, against))) for own, against in ((first, other), (other, first))]
    stds = [dict(leaves(estimate.std)) for estimate in (first, other)]
    differences = []
    for path in dict.fromkeys([*tables[0], *tables[1]]):
        a, b = (table.get(path) for table in tables)
        spread = sum(std.get(path, 0.0) for std in stds)
        alike = isinstance(a, float) and isinstance(b, float) and abs(a - b) <= DISTINCT * spread
        if a != b and not alike:
            differences.append(f"{'.'.join(path)} {_value_text(a)} and {_value_text(b)}")
    return differences


def _comparable_table(own: LawEstimate, against: LawEstimate) -> dict[str, Any]:
    """The table of ``own``, with its velocity estimator in words where that of ``against`` is of another kind."""
    table = own.controller or {}
    estimator, other = table.get("velocity_estimator"), (against.controller or {}).get("velocity_estimator")
    kinds = [entry.get("kind") if isinstance(entry, dict) else entry for entry in (estimator, other)]
    if estimator is None or other is None or kinds[0] == kinds[1]:
        return table
    return {**table, "velocity_estimator": estimator_in_words(estimator)}


def _value_text(value: Any) -> str:
    return f"{value:.5g}" if isinstance(value, float) else "none" if value is None else str(value)


def law_kind(law: LawFit, velocity_reference: bool) -> str:
    """Kind of the law in an axis file; "" where no law of the package has these terms."""
    s = law.structure
    plain = not (s.acceleration or s.coulomb or law.filters) and law.timing.every == 1
    plain = plain and not law.timing.profile
    if not s.velocity:
        return "p" if plain and not s.form else ""
    if velocity_reference:
        return "" if s.position or s.force else "cascade"
    if s.position:
        return "" if s.force else "position_pd" if plain and not s.form and s.share == 0 else "cascade"
    if s.form != "ip" or not plain or s.share != 1:
        return ""
    # With the backward difference the integral of the velocity error is the position error: one law, two kinds.
    return "position_pd" if law.timing.velocity_estimator == "backward" and not s.force else "ip_velocity"


def numbers_of(law: LawFit, velocity_reference: bool) -> dict[str, float]:
    """The numbers of the law by their place in the table, such as "position.kp"."""
    kind, s = law_kind(law, velocity_reference), law.structure
    part = law.part
    estimated, estimator = {}, law.timing.velocity_estimator
    if s.velocity and isinstance(estimator, Estimator) and sought(estimator):
        estimated = {f"velocity_estimator.{NUMBERS[estimator.kind]}": estimator.number}
    gain, rate = law.gain, law.position_rate
    if kind == "p":
        return {"kp": part["position"]}
    if kind == "position_pd":
        return {"kp": rate if s.position else law.wi, "kv": gain} | estimated
    if kind == "ip_velocity":
        own = {"k_v1": gain, "t_v": 1.0 / law.wi}
        return own | ({"k_e1": part["force"] / gain} if s.force else {}) | estimated
    numbers = {"position.kp": rate} if s.position else {}
    numbers["velocity.kp"] = gain
    if s.form:
        numbers["velocity.ti"] = 1.0 / law.wi
    if s.share is None:
        numbers["feedforward.velocity"] = part["following"] / gain
    numbers |= {f"feedforward.{name}": part[name] for name in ("acceleration", "coulomb") if name in part}
    numbers |= estimated
    for i, stage in enumerate(law.filters):
        numbers |= {f"filters.{i}.{name}": value for name, value in zip(stage.names, stage.values, strict=True)}
    return numbers


def controller_table(law: LawFit, velocity_reference: bool, numbers: dict[str, float], holds: bool) -> dict[str, Any]:
    """The ``[controller]`` table with these ``numbers``; ``holds``: the integral stops at the limit."""
    kind = law_kind(law, velocity_reference)
    table: dict[str, Any] = {"kind": kind}
    if kind == "cascade" and not velocity_reference:
        table["position"] = {"kp": numbers["position.kp"], "every": law.timing.every}
    if kind != "cascade":
        table |= {name: value for name, value in numbers.items() if "." not in name}
    else:
        table["velocity"] = nested(numbers, "velocity")
        if law.structure.form:
            table["velocity"]["form"] = law.structure.form
        ahead = nested(numbers, "feedforward")
        if law.structure.share == 1 and not velocity_reference:
            ahead["velocity"] = 1.0
        if ahead:
            table["feedforward"] = {name: ahead[name] for name in AHEAD if name in ahead}
            if law.timing.profile and "velocity" in ahead:
                table["feedforward"]["source"] = "profile"
        if law.filters:
            filters = enumerate(law.filters)
            table["filters"] = [{"kind": stage.kind, **nested(numbers, f"filters.{i}")} for i, stage in filters]
        if law.structure.form:
            table["anti_windup"] = "hold" if holds else "none"
    if kind not in ("p",):
        estimator = law.timing.velocity_estimator
        (number,) = nested(numbers, "velocity_estimator").values() or (None,)
        table["velocity_estimator"] = estimator_table(estimator, number)
    return table


def deviations_of(law: LawFit, stds: dict[str, float]) -> dict[str, Any]:
    """The deviations ``stds`` by name, in the shape of the table."""
    table: dict[str, Any] = {}
    for name, std in stds.items():
        head, _, rest = name.partition(".")
        if head == "filters":
            i, _, leaf = rest.partition(".")
            table.setdefault("filters", [{} for _ in law.filters])[int(i)][leaf] = std
        elif rest:
            table.setdefault(head, {})[rest] = std
        else:
            table[head] = std
    return table


def nested(numbers: dict[str, float], head: str) -> dict[str, Any]:
    """The numbers whose name starts with ``head.``, by the rest of the name."""
    return {name.removeprefix(f"{head}."): value for name, value in numbers.items() if name.startswith(f"{head}.")}
