"""Least squares, or what the record asks for in its place: what is done unless told otherwise.

Noise of the force moves the carriage, the more the lighter it is and the faster its loop, and least squares then takes
the mass too small: instruments are taken where a test says so. Where the measured acceleration is noise neither
determines the mass, but output error may, which takes it from its simulation. Both need the controller, so a record of
one that is not known, or that has no reference, stays with least squares; so does a record of an hour, for its memory.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from emps_design.axis import Axis
from emps_design.errors import EmpsError
from emps_design.identification.chains import DEFAULT_CHAIN, LONG
from emps_design.identification.excitation import WEAK_RELIABILITY
from emps_design.identification.identify import held_out_on, identify
from emps_design.identification.result import Identification
from emps_design.records import Record

UNTESTED = "whether least squares is biased was not tested"


def identify_tested(
    record: Record,
    axis: Axis,
    chain: str = DEFAULT_CHAIN,
    bootstrap: int = 0,
    seed: int = 0,
    holdout: Record | None = None,
    **both: Any,
) -> Identification:
    """Identify ``axis`` from ``record`` by least squares, instruments where that is biased, or output error.

    Biased is what the Durbin-Wu-Hausman test says at 1 %, and by half a standard deviation or more. Output error is
    taken where noise leaves neither to determine a parameter, it does, and all agree on the others. Arguments and
    errors are those of :func:`~emps_design.identification.identify`; those that ``both`` estimators take are ``model``,
    ``cutoff_hz`` and ``external_force_known``. Other chains than ``hold`` and a ``bootstrap`` are least squares.

    >>> from emps_design.machines import machine
    >>> from emps_design.simulation.synthetic import synthetic_record
    >>> axis = machine("emps2019")
    >>> found = identify_tested(synthetic_record(axis, laps=1), axis)
    >>> found.estimator, found.extra["hausman_test"]["bias_matters"]
    ('least_squares', False)
    """
    plain = identify(record, axis, chain=chain, bootstrap=bootstrap, seed=seed, holdout=holdout, **both)
    if chain != "hold" or axis.controller.kind == "none" or not record.has_reference:
        return plain
    if bootstrap:
        said = f"{UNTESTED}: a bootstrap is one of least squares"
        return replace(plain, warnings=(*plain.warnings, said))
    if len(record) > LONG:
        said = f"{LONG} samples are the most that least squares is tested on; a part of the record says if it is biased"
        return replace(plain, warnings=(*plain.warnings, said))
    # Imported here: beside a long record's regression the modules of a simulation are a tenth of its memory.
    from emps_design.identification.instruments import identify_with_instruments

    try:
        led = identify_with_instruments(record, axis, **both)
    except (EmpsError, np.linalg.LinAlgError) as error:  # no simulation with this controller follows the record
        return replace(plain, warnings=(*plain.warnings, f"{UNTESTED}: {error}"))
    tried = _by_output_error(record, axis, plain, led, **both)
    if tried is not None:
        return _held_out(tried, holdout, **both)
    weaker = any(one.determined and not led.parameters[name].determined for name, one in plain.parameters.items())
    if weaker or not led.extra["hausman_test"]["bias_matters"]:
        return replace(plain, extra=plain.extra | {"hausman_test": led.extra["hausman_test"]})
    led = replace(led, warnings=(*led.warnings, *_weakly_led(led)))
    return _held_out(led, holdout, **both)


def _held_out(found: Identification, holdout: Record | None, external_force_known: bool = False, **_: Any) -> Any:
    """``found`` with what it is worth on ``holdout``."""
    if holdout is None:
        return found
    judged = held_out_on(holdout, found.axis, found.model, found.values(), found, external_force_known)
    return replace(found, extra=found.extra | {"held_out": judged})


def _by_output_error(
    record: Record, axis: Axis, plain: Identification, led: Identification, **both: Any
) -> Identification | None:
    """Output error where it alone determines what noise hides, and agrees with ``led`` on the rest; else None."""
    hidden = [name for name in led.parameters if _by_noise(plain, name) and _by_noise(led, name)]
    if not hidden:
        return None
    from emps_design.identification.output_error import identify_by_output_error

    try:
        found = identify_by_output_error(record, axis, **both)
    except EmpsError:
        return None
    ends = {name: one.interval_95 for name, one in found.parameters.items() if one.interval_95 is not None}
    others = {name: one.interval_95 for name, one in led.parameters.items() if one.interval_95 is not None}
    told = all(name in ends and ends[name][0] * ends[name][1] > 0.0 for name in hidden)
    if not told or any(ends[name][0] > high or ends[name][1] < low for name, (low, high) in others.items()):
        return None
    said = (
        f"{', '.join(hidden)}: by output error, for the measured motion is noise there, and least squares and "
        "instruments do not determine it"
    )
    extra = found.extra | {"hausman_test": led.extra["hausman_test"]}
    return replace(found, extra=extra, warnings=(*found.warnings, said))


def _by_noise(found: Identification, name: str) -> bool:
    one = found.parameters[name]
    return not one.determined and one.reliability is not None and one.reliability < WEAK_RELIABILITY


def _weakly_led(found: Identification) -> list[str]:
    """Of what instruments alone determine: least squares would not, and they may be off by more than they say."""
    shares = {name: one.reliability for name, one in found.parameters.items() if one.determined}
    return [
        f"{name}: the reference explains {100.0 * share:.2g} % of its column, least squares would not determine it; "
        "compare output error (oe), or record more acceleration"
        for name, share in shares.items()
        if share is not None and share < WEAK_RELIABILITY
    ]
