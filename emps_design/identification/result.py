"""Options and result of an identification.

:class:`IdentificationRequest` holds the options of :func:`.identify` and of the command; :class:`Identification` the
parameters with their deviations, and the axis that they make.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from emps_design.axis import Axis, Mechanics
from emps_design.effects.terms import TERMS
from emps_design.errors import AxisError, InputError, nearest_name
from emps_design.identification.chains import CHAINS, DEFAULT_CHAIN
from emps_design.identification.excitation import KNOWN, REFUSE
from emps_design.identification.model import MODELS, Model
from emps_design.identification.problem import identified_effects
from emps_design.identification.statistics import LongRun
from emps_design.identification.view import identification_view
from emps_design.messages import Message
from emps_design.quantities import Quantity
from emps_design.records import Record
from emps_design.request import HERTZ, Request, option
from emps_design.view import View, Viewed

AUTO, BY_LEAST_SQUARES, BY_INSTRUMENTS, BY_OUTPUT_ERROR = "auto", "ls", "iv", "oe"
NO_TERMS = "none"
ESTIMATORS = (AUTO, BY_LEAST_SQUARES, BY_INSTRUMENTS, BY_OUTPUT_ERROR)
HOLDOUT = "judge the fit on this record; without it on the last third, fitted to the rest"


@dataclass(frozen=True)
class IdentificationRequest(Request):
    """The options of :func:`.identify`; raises :class:`InputError` for unknown or incompatible ones.

    >>> IdentificationRequest(estimator="iv", bootstrap=100)  # doctest: +ELLIPSIS
    Traceback (most recent call last):
    ...
    emps_design.errors.InputError: `bootstrap`: goes with `estimator='ls'`, found iv, which filters as hold does ...
    """

    model: str = option("symmetric", "friction: the same both ways, or by direction", choices=tuple(MODELS))
    estimator: str = option(
        AUTO,
        "auto: ls, or iv where ls is biased or noise hides a parameter from it, or oe where from both; ls: least "
        "squares; iv: instruments; oe: closed-loop output error",
        choices=ESTIMATORS,
    )
    filter: str = option(
        DEFAULT_CHAIN,
        "hold: models the hold of the drive, leaves rests out, cut-off from the data; report: 100 Hz low-pass, of the "
        "2019 report; paper: median and decimation, of the 2018 paper",
        choices=tuple(CHAINS),
    )
    cutoff: float | None = option(
        None,
        "low-pass [Hz, or such as 370rad/s] instead of the filter's own; what the data say is shown too",
        **HERTZ,
    )
    external_force: str = option(
        REFUSE,
        "refuse a record with one, or known: let the measured force take part, as in (21)",
        choices=(REFUSE, KNOWN),
    )
    holdout: Record | None = option(None, HOLDOUT)
    bootstrap: int = option(0, "draws of a bootstrap of the residual, 0: none", limits=(0, 100_000))
    seed: int = option(0, "seed of the bootstrap", limits=(0, None))
    with_: str | Sequence[str] = option(
        AUTO,
        "terms beside mass and friction, with commas: gravity (a weight on an axis that turns), asymmetric-viscous "
        "(viscous friction by direction), bent-viscous (viscous |v|^viscous_exponent); auto: what held-out strokes of "
        "the record call for; none",
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
                raise InputError(f"`with_`: {term} goes with `model='symmetric'`, found {self.model!r}")
        if not self.bootstrap:
            self.refuse(["seed"], "goes with `bootstrap`; nothing else is drawn")
        if self.estimator not in (AUTO, BY_LEAST_SQUARES):
            self.refuse(
                ["filter", "bootstrap", "holdout"],
                f"goes with `estimator='ls'`, found {self.estimator}, which filters as hold does and has intervals of "
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


@dataclass(frozen=True)
class Estimate:
    """One identified parameter: ``value``, ``std`` by (15), ``relative_std_percent`` by (16), and realistic bounds.

    ``std_long_run`` and ``interval_95`` allow for a correlated residual with structure; ``std_hac`` is the HAC
    deviation. Three further errors are part of the interval: ``systematic``, the error of a chain that models neither
    hold nor rest, against the one that does; ``encoder``, the rms error by the encoder's steps, simulated, 0 where the
    residual already shows more; ``cutoff``, how far half and twice the cut-off move the value beyond chance.
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
                f"{error}; no machine has such parameters: a {force} that the model lacks, such as a weight or a "
                "spring, biases them, and diagnose names it"
            ) from error

    def to_dict(self) -> dict[str, Any]:
        """The contract's ``identify --json``, with some more keys."""
        return {
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

    def view(self) -> View:
        """What a terminal and a notebook show of it."""
        return identification_view(self.to_dict(), self.axis.units)

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
