"""Options and result of an identification, and what the result shows.

:class:`IdentificationRequest` holds the options of :func:`.identify` and of the command; :class:`Identification` the
parameters with their deviations, and the axis that they make. Its view is made from its document.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from emps_design.advice import advised
from emps_design.axis import Axis, Mechanics
from emps_design.effects.terms import TERMS
from emps_design.errors import AxisError, InputError, nearest_name
from emps_design.identification.chains import CHAINS, DEFAULT_CHAIN
from emps_design.identification.excitation import KNOWN, REFUSE
from emps_design.identification.model import MODELS, Model, identified_effects
from emps_design.identification.statistics import LongRun
from emps_design.messages import Message
from emps_design.quantities import Quantity, decimals, rounded
from emps_design.records import Record
from emps_design.request import HERTZ, Request, option
from emps_design.units import Units
from emps_design.view import Line, Table, View, Viewed

AUTO, BY_LEAST_SQUARES, BY_INSTRUMENTS, BY_OUTPUT_ERROR = "auto", "ls", "iv", "oe"
NO_TERMS = "none"
ESTIMATORS = (AUTO, BY_LEAST_SQUARES, BY_INSTRUMENTS, BY_OUTPUT_ERROR)
MOST_PLACES = 6  # behind the point, in a column of the table
HOLDOUT = "validate the fit on this record; by default on the last third, with a fit to the rest"


@dataclass(frozen=True)
class IdentificationRequest(Request):
    """The options of :func:`.identify`; raises :class:`InputError` for unknown or incompatible ones.

    >>> IdentificationRequest(estimator="iv", bootstrap=100)  # doctest: +ELLIPSIS
    Traceback (most recent call last):
    ...
    emps_design.errors.InputError: `bootstrap`: requires `estimator='ls'`, found iv, which filters as hold does ...
    """

    model: str = option("symmetric", "friction: equal in both directions, or by direction", choices=tuple(MODELS))
    estimator: str = option(
        AUTO,
        "auto: ls, iv where ls is biased or does not determine a parameter because of noise, oe where iv does not "
        "either; ls: least squares; iv: instrumental variables; oe: closed-loop output error",
        choices=ESTIMATORS,
    )
    filter: str = option(
        DEFAULT_CHAIN,
        "hold: models the hold of the drive, excludes rests, cut-off from the data; report: 100 Hz low-pass of the "
        "2019 report; paper: median and decimation of the 2018 paper",
        choices=tuple(CHAINS),
    )
    cutoff: float | None = option(
        None,
        "low-pass [Hz, or e.g. 370rad/s] instead of the filter's; the cut-off from the data is shown too",
        **HERTZ,
    )
    external_force: str = option(
        REFUSE,
        "refuse: reject a record with an external force; known: include the measured force, as in (21)",
        choices=(REFUSE, KNOWN),
    )
    holdout: Record | None = option(None, HOLDOUT)
    bootstrap: int = option(0, "number of bootstrap draws of the residual, 0: none", limits=(0, 100_000))
    seed: int = option(0, "seed of the bootstrap", limits=(0, None))
    with_: str | Sequence[str] = option(
        AUTO,
        "terms besides mass and friction, separated by commas: gravity (a weight on a rotary axis), asymmetric-viscous "
        "(viscous friction by direction), bent-viscous (viscous |v|^viscous_exponent); auto: terms that reduce the "
        "error of held-out strokes; none",
        typed=str,
    )

    def __post_init__(self) -> None:
        super().__post_init__()
        for term in self.terms or ():
            if term not in TERMS:
                known = [*TERMS, NO_TERMS]
                expected = f"{', '.join(known[:-1])}, {NO_TERMS} alone, or {AUTO}"
                raise InputError(f"`with_`: found {term!r}, expected {expected}{nearest_name(term, known)}")
            if TERMS[term].symmetric and self.model == "asymmetric":
                raise InputError(f"`with_`: {term} requires `model='symmetric'`, found {self.model!r}")
        if not self.bootstrap:
            self.refuse(["seed"], "requires `bootstrap`; nothing else is random")
        if self.estimator not in (AUTO, BY_LEAST_SQUARES):
            self.refuse(
                ["filter", "bootstrap", "holdout"],
                f"requires `estimator='ls'`, found {self.estimator}, which filters as hold does and has intervals of "
                "its own",
            )

    @property
    def terms(self) -> tuple[str, ...] | None:
        """The requested terms beside the friction model, in the order of :data:`TERMS`; None: the record decides.

        >>> asked = ("bent-viscous, gravity", "none", "auto")
        >>> tuple(IdentificationRequest(with_=terms).terms for terms in asked)
        (('gravity', 'bent-viscous'), (), None)
        """
        if self.with_ == AUTO:
            return None
        listed = self.with_.split(",") if isinstance(self.with_, str) else self.with_
        terms = [term.strip() for term in listed if term.strip()]
        terms = [] if terms == [NO_TERMS] else terms
        return tuple(sorted(dict.fromkeys(terms), key=lambda term: [*TERMS, term].index(term)))

    @property
    def simulates(self) -> bool:
        """Whether one of the estimators simulates the record with its controller."""
        return self.estimator != BY_LEAST_SQUARES and self.filter == DEFAULT_CHAIN and not self.bootstrap


DEFAULTS = IdentificationRequest()

Document = Mapping[str, Any]  # of a result, or a part of it


@dataclass(frozen=True)
class Estimate:
    """One identified parameter: ``value``, ``std`` by (15), ``relative_std_percent`` by (16), and realistic bounds.

    ``std_long_run`` and ``interval_95`` allow for a correlated residual with structure; ``std_hac`` is the HAC
    deviation. Four further errors are part of the interval: ``systematic``, the error of a chain that models neither
    hold nor rest, against the one that does; ``encoder``, the rms error by the encoder's steps, simulated, 0 where the
    residual already shows more; ``cutoff``, how far half and twice the cut-off move the value beyond chance; ``hold``,
    how far a drive would that is faster than the record, where this does not tell.
    All are None where the record does not determine the parameter; ``reliability`` is the share of its column that is
    motion rather than noise.
    """

    quantity: Quantity
    value: float | None
    std: float | None
    std_long_run: float | None = None
    interval_95: tuple[float, float] | None = None
    std_hac: float | None = None
    std_bootstrap: float | None = None
    interval_95_bootstrap: tuple[float, float] | None = None
    systematic: float | None = None
    encoder: float | None = None
    cutoff: float | None = None
    hold: float | None = None
    reliability: float | None = None

    @property
    def determined(self) -> bool:
        """Whether the record determines the parameter."""
        return self.value is not None

    @property
    def relative_std_percent(self) -> float | None:
        """100 |std / value| [%], (16); the tables of the 2018 paper print twice this."""
        return abs(100.0 * self.std / self.value) if self.value and self.std is not None else None

    def to_dict(self) -> dict[str, Any]:
        """Plain data, SI."""
        return {
            **{name: value for name, value in vars(self).items() if name != "quantity"},
            "relative_std_percent": self.relative_std_percent,
            "unit": self.quantity.unit,
            "symbol": self.quantity.symbol,
            "determined": self.determined,
        }


@dataclass(frozen=True)
class Identification(Viewed):
    """Parameters of one record with their deviations, and how they were estimated.

    ``fitted`` is the identified model: friction model and terms beside it, of which ``proposed`` are those that the
    record itself called for.
    """

    record: str
    sha256: str
    fitted: Model
    estimator: str
    chain: str
    filter_text: str
    cutoff_hz: float | None
    parameters: dict[str, Estimate]
    rms_error: float
    relative_error_percent: float
    condition_number: float
    samples: int
    residual: LongRun
    hac_lag: float
    warnings: tuple[Message, ...]
    axis: Axis = field(repr=False)
    period: float = field(repr=False)
    series: dict[str, np.ndarray] = field(repr=False, compare=False)
    extra: dict[str, Any] = field(default_factory=dict, repr=False, compare=False)
    proposed: tuple[str, ...] = ()

    @property
    def model(self) -> str:
        """The friction model."""
        return self.fitted.friction

    def values(self) -> np.ndarray:
        """The parameters in the order of the model, NaN where not determined."""
        return np.array([np.nan if e.value is None else e.value for e in self.parameters.values()])

    def solution(self, model: Model | None = None) -> np.ndarray:
        """Coefficients (p,) of the columns of ``model`` (default :attr:`fitted`), NaN where not determined."""
        by_name = dict(zip(self.parameters, self.values().tolist(), strict=True))
        return (model or self.fitted).solution(by_name)

    def baseline(self) -> np.ndarray:
        """Mass, viscous, coulomb, offset; of an asymmetric model the means; raises where one is not determined."""
        return self.fitted.baseline(self._determined("the axis"))

    def to_axis(self, name: str | None = None) -> Axis:
        """The axis with the identified mechanics and its known effects; identified terms become effects too."""
        data = self.axis.to_dict()
        tables = identified_effects(self.fitted, self._determined("the axis"))
        rounded = [{k: x if k == "kind" else float(f"{x:.10g}") for k, x in effect.items()} for effect in tables]
        data["effects"] = [*rounded, *data.get("effects", [])]
        data["name"] = name or self.axis.name
        data["mechanics"] = Mechanics.table([float(f"{x:.10g}") for x in self.baseline()])
        data["sampling"] = {**data["sampling"], "period": self.period}
        try:
            return Axis.from_dict(data, f"identified from {self.record}")
        except InputError as error:
            force = self.axis.units.word("force")
            raise InputError(
                f"{error}; no machine can have such parameters: a {force} that the model lacks, such as a weight or a "
                "spring, biases them; next: diagnose"
            ) from error

    def to_dict(self) -> dict[str, Any]:
        """The contract's ``identify --json``, with some more keys."""
        document = {
            "record": self.record,
            "sha256": self.sha256,
            "axis": self.axis.name,
            "model": self.model,
            "estimator": self.estimator,
            "proposed": list(self.proposed),
            "parameters": {name: estimate.to_dict() for name, estimate in self.parameters.items()},
            "rms_error": self.rms_error,
            "relative_error_percent": self.relative_error_percent,
            "condition_number": self.condition_number,
            "samples": self.samples,
            "filter": {"chain": self.chain, "cutoff_hz": self.cutoff_hz, "text": self.filter_text},
            "residual": {**self.residual.to_dict(), "hac_lag": self.hac_lag},
            **self.extra,
            "warnings": list(self.warnings),
        }
        return advised("identify", document, self.axis.units)

    def view(self) -> View:
        """Parameters of one record with their deviations, what these hold, and how the record was read."""
        document, units = self.to_dict(), self.axis.units
        return (
            _parameters(document, units),
            *proposed_line(document["proposed"]),
            *_further_deviations(document, units),
            *_fit(document, units),
            *_held_in_intervals(document, units),
            Line(f"filter {document['filter']['chain']}: {document['filter']['text']}"),
            *_judged(document, units),
        )

    def _determined(self, purpose: str) -> dict[str, float]:
        """Every parameter as a number; :class:`AxisError` names those that the record does not determine."""
        values = {name: estimate.value for name, estimate in self.parameters.items() if estimate.value is not None}
        missing = [name for name in self.parameters if name not in values]
        if missing:
            listed = ", ".join(map(self.axis.units.word, missing))
            raise AxisError(
                f"{self.record}: {listed} not determined by the record, {purpose} needs all; record motion "
                "that excites them"
            )
        return values


def _parameters(document: Document, units: Units) -> Table:
    own = parameter_names(document["proposed"])
    rows = [
        (label(name, own, units), *_cells(estimate), estimate["unit"])
        for name, estimate in document["parameters"].items()
    ]
    title = f"{document['record']}, {document['model']} model, {document['estimator'].replace('_', ' ')}"
    return Table(("parameter", "value", "std (15)", "% (16)", "std *", "95 % ± *", "unit"), rows, title)


def _cells(estimate: Document) -> tuple[str | None, ...]:
    """Value, deviations and half the interval of a parameter; a warning says why it is not determined."""
    if estimate["interval_95"] is None:
        return None, "", "", "", ""
    low, high = estimate["interval_95"]
    percent = estimate["relative_std_percent"]
    places = decimals(max(abs(estimate["value"] or 0.0), estimate["std"] or 0.0))
    return (
        written(estimate["value"], places, 4),
        written(estimate["std"], places),
        "" if percent is None else f"{percent:.2f}",
        written(estimate["std_long_run"], places),
        written(0.5 * (high - low), places),
    )


def written(number: float | None, places: int, digits: int = 3) -> str:
    """``number`` with ``places`` decimals, or ``digits`` digits where these leave less than two or are too many.

    >>> written(95.1089, 4), written(0.000218, 4), written(3.001e-05, 9, 4), written(2e-08, 6)
    ('95.1089', '0.000218', '3.001e-05', '2.00e-08')
    """
    if number is None:
        return ""
    lost = 0.0 < abs(number) < 10.0 ** (1 - places)
    return f"{number:#.{digits}g}" if lost or places > MOST_PLACES else f"{number:.{places}f}"


def label(name: str, proposed: set[str], units: Units) -> str:
    """The parameter ``name`` in a table, marked with + where it is one of those ``proposed``."""
    return units.words(name.replace("_and_", " + ")) + (" +" if name in proposed else "")


def parameter_names(terms: Sequence[str]) -> set[str]:
    """The names of the parameters of ``terms``."""
    return {quantity.name for term in terms for quantity in TERMS[term].quantities}


def proposed_line(terms: Sequence[str]) -> list[Line]:
    """Which terms the record called for, why, and how to leave them out."""
    why = "without it the error of held-out strokes is at least twice as large"
    return [Line(f"+ proposed: {', '.join(terms)}; {why}; `with_='none'` leaves it out")] if terms else []


def _further_deviations(document: Document, units: Units) -> Iterator[Line]:
    """Deviations by other estimates."""
    lag = document["residual"]["hac_lag"]
    for label, key in ((f"HAC std, lag {lag:.2f} s", "std_hac"), ("bootstrap std", "std_bootstrap")):
        deviations = {name: estimate[key] for name, estimate in document["parameters"].items()}
        known = {name: std for name, std in deviations.items() if std is not None}
        if known:
            yield Line(f"{label}: {_each(known, units)}")


def _each(numbers: Mapping[str, float], units: Units) -> str:
    return ", ".join(f"{units.words(name)} {rounded(number, 4)}" for name, number in numbers.items())


def _fit(document: Document, units: Units) -> Iterator[Line]:
    """Force error, and how many independent rows there are."""
    force, residual = units.words("force"), document["residual"]
    yield Line(
        f"{force} error {rounded(document['rms_error'], 4)} {units.unit('N')} rms, "
        f"{document['relative_error_percent']:.4f} % of the {force}; condition number "
        f"{document['condition_number']:.1f}"
    )
    yield Line(
        f"* {document['samples']} rows count as {residual['effective_samples']:.0f} independent ones (residual "
        f"correlated over {1e3 * residual['correlation_time']:.0f} ms)"
    )


def _held_in_intervals(document: Document, units: Units) -> Iterator[Line]:
    """Systematic errors that the intervals include: by the cut-off, the filter and the encoder."""
    estimates = document["parameters"]
    if document["cutoff_sensitivity"] is not None:
        yield Line(_moved_by_cutoff(document, units))
    if any(estimate["systematic"] for estimate in estimates.values()):
        yield Line(
            f"95 % ± includes the systematic error of this filter, by comparison with `filter='{DEFAULT_CHAIN}'`"
        )
    stepped = {name: estimate["encoder"] for name, estimate in estimates.items() if estimate["encoder"]}
    if stepped:
        each = _each(stepped, units)
        yield Line(f"95 % ± includes the error by encoder quantisation, from a simulation: {each} rms")
    smooth = {name: estimate["hold"] for name, estimate in estimates.items() if estimate["hold"]}
    if smooth:
        yield Line(f"95 % ± includes what the command may do between samples: {_each(smooth, units)}")


def _moved_by_cutoff(document: Document, units: Units) -> str:
    """By how much half and twice the cut-off change the parameters, and whether the intervals cover it."""
    estimates = document["parameters"]
    moved = ", ".join(
        f"{units.words(name)} {100.0 * share:.2g} %"
        for name, share in document["cutoff_sensitivity"].items()
        if share is not None and estimates[name]["determined"]
    )
    tried = " and ".join(f"{frequency:.3g}" for frequency in document["cutoffs_tried"]["cutoff_hz"])
    beyond = any(estimate["cutoff"] for estimate in estimates.values())
    held = "; 95 % ± includes the change beyond chance" if beyond else ", no more than chance"
    if not tried:
        return "with every other cut-off too little of the record remains"
    return f"cut-offs of {tried} Hz change {moved or 'no parameter that is determined'}{held if moved else ''}"


def _judged(document: Document, units: Units) -> Iterator[Line]:
    """Held-out data, the cut-off that the record suggests, the test for bias, and the simulated closed loop."""
    unit, own = units.unit("N"), document["filter"]
    if document.get("held_out"):
        judged = document["held_out"]
        share = judged["relative_error_percent"]
        nothing = f"where the {units.words('force')} is 0"
        compared = f"{share:.4f} %" if math.isfinite(share) else nothing
        yield Line(f"held out, {judged['on']}: {rounded(judged['rms_error'], 4)} {unit} rms, {compared}")
    if "cutoff_from_data" in document:
        chosen = document["cutoff_from_data"]["cutoff_hz"]
        if own["chain"] != DEFAULT_CHAIN:
            yield Line(f"`filter='{DEFAULT_CHAIN}'` would have a cut-off of {chosen:g} Hz")
        elif own["cutoff_hz"] != chosen:
            yield Line(f"cut-off from motion and encoder of this record: {chosen:g} Hz")
    if "hausman_test" in document:
        yield Line(_bias(document["hausman_test"]))
    if "closed_loop" in document:
        loop, (small, factor) = document["closed_loop"], units.read("um")
        yield Line(
            f"closed loop from q_ref: position {1e6 * factor * loop['position_rms_error']:.3f} {small} rms, "
            f"{units.words('force')} {rounded(loop['force_rms_error'], 3)} {unit} rms "
            f"({loop['force_relative_error_percent']:.2f} %)"
        )


def _bias(test: Document) -> str:
    verdict = "biased" if test["least_squares_biased"] else "not shown to be biased"
    little = ", too little to matter" if test["least_squares_biased"] and not test["bias_matters"] else ""
    return (
        f"Durbin-Wu-Hausman: least squares is {verdict} (p = {test['p_value']:.2g}), by at most "
        f"{test['shift_in_std']:.2f} standard deviations{little}"
    )
