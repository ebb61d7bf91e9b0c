"""What is asked of an identification besides record and axis: the options of :func:`.identify` and its command."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TypedDict

from emps_design.effects.terms import TERMS
from emps_design.errors import InputError, nearest_name
from emps_design.identification.chains import DEFAULT_CHAIN
from emps_design.identification.excitation import KNOWN, REFUSE
from emps_design.identification.known import check_chain
from emps_design.identification.model import parameters_of
from emps_design.records import Record

AUTO, BY_LEAST_SQUARES, BY_INSTRUMENTS, BY_OUTPUT_ERROR = "auto", "ls", "iv", "oe"
NO_TERMS = "none"
ESTIMATORS = (AUTO, BY_LEAST_SQUARES, BY_INSTRUMENTS, BY_OUTPUT_ERROR)


class More(TypedDict, total=False):
    """The options of :func:`.identify` that few need."""

    external_force: str
    holdout: Record | None
    bootstrap: int
    seed: int
    with_: str | Sequence[str]


@dataclass(frozen=True)
class Request:
    """The options of :func:`.identify`; raises :class:`InputError` for what is none, or what do not go together.

    >>> Request(estimator="iv", bootstrap=100)  # doctest: +ELLIPSIS
    Traceback (most recent call last):
    ...
    emps_design.errors.InputError: `bootstrap`: goes with `estimator='ls'`, found 'iv', which filters as hold does ...
    """

    model: str = "symmetric"
    estimator: str = AUTO
    filter: str = DEFAULT_CHAIN
    cutoff: float | None = None
    external_force: str = REFUSE
    holdout: Record | None = None
    bootstrap: int = 0
    seed: int = 0
    with_: str | Sequence[str] = AUTO

    def __post_init__(self) -> None:
        parameters_of(self.model)
        check_chain(self.filter)
        for name, found, allowed in (
            ("`estimator`", self.estimator, ESTIMATORS),
            ("`external_force=`", self.external_force, (REFUSE, KNOWN)),
        ):
            if found not in allowed:
                expected = f"{', '.join(allowed[:-1])} or {allowed[-1]}"
                raise InputError(f"{name}: found {found!r}, expected {expected}{nearest_name(found, list(allowed))}")
        for term in self.terms or ():
            if term not in TERMS:
                known = [*TERMS, NO_TERMS]
                expected = f"{', '.join(known[:-1])}, {NO_TERMS} alone, or {AUTO}"
                raise InputError(f"`with_`: found {term!r}, expected {expected}{nearest_name(term, known)}")
            if TERMS[term].symmetric and self.model == "asymmetric":
                raise InputError(f"`with_`: {term} goes with `model='symmetric'`, found {self.model!r}")
        if self.estimator in (AUTO, BY_LEAST_SQUARES):
            return
        for name, given in (
            ("`filter`", self.filter != DEFAULT_CHAIN),
            ("`holdout`", self.holdout is not None),
            ("`bootstrap`", self.bootstrap > 0),
        ):
            if given:
                raise InputError(
                    f"{name}: goes with `estimator='ls'`, found {self.estimator!r}, which filters as hold does and has "
                    "intervals of its own"
                )

    @property
    def terms(self) -> tuple[str, ...] | None:
        """The terms beside the friction model that were asked for, in the order of :data:`TERMS`; None: by the record.

        >>> Request(with_="bent-viscous, gravity").terms, Request(with_="none").terms, Request().terms
        (('gravity', 'bent-viscous'), (), None)
        """
        if self.with_ == AUTO:
            return None
        listed = self.with_.split(",") if isinstance(self.with_, str) else self.with_
        asked = [one.strip() for one in listed if one.strip()]
        asked = [] if asked == [NO_TERMS] else asked
        return tuple(sorted(dict.fromkeys(asked), key=lambda one: [*TERMS, one].index(one)))

    @property
    def simulates(self) -> bool:
        """Whether an estimator takes part that simulates the record with its controller."""
        return self.estimator != BY_LEAST_SQUARES and self.filter == DEFAULT_CHAIN and not self.bootstrap
