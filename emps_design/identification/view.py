"""What identifications and observations show: parameters with what they are worth, and the smallest force seen.

Each view is made from the document of its result.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from emps_design.effects.terms import TERMS
from emps_design.identification.chains import DEFAULT_CHAIN
from emps_design.quantities import decimals, rounded
from emps_design.units import Units
from emps_design.view import Line, Table, View

Document = Mapping[str, Any]  # of a result, or a part of it

MOST_PLACES = 6  # behind the point, in a column of the table


def identification_view(document: Document, units: Units) -> View:
    """Parameters of one record with their deviations, what these hold, and how the record was read."""
    return (
        _parameters(document, units),
        *_proposed(document["proposed"]),
        *_further_deviations(document, units),
        *_fit(document, units),
        *_held_in_intervals(document, units),
        Line(f"filter {document['filter']['chain']}: {document['filter']['text']}"),
        *_judged(document, units),
    )


def several_view(document: Document, units: Units) -> View:
    """Means over several records, their spread and drift, and the force error of each record's parameters on each."""
    own, names = _names_of(document["proposed"]), document["records"]
    rows = []
    for name, row in document["parameters"].items():
        places = decimals(max(abs(row["mean"]), row["std"]))
        mean, spread, std = (f"{row[key]:.{places}f}" for key in ("mean", "spread", "std"))
        mark = " **" if row["drift_significant"] else ""
        drift = None if row["drift"] is None else f"{row['drift']:+.{places}f}{mark}"
        rows.append((_label(name, own, units), mean, spread, std, drift, row["unit"]))
    judged = [
        (f"{number} {name}", *(f"{error:.3f}" for error in errors))
        for number, (name, errors) in enumerate(zip(names, document["cross_validation"], strict=True), 1)
    ]
    unit = document["cross_validation_unit"]
    return (
        Table(
            ("parameter", "mean", "spread", "std *", "drift/record", "unit"),
            rows,
            f"{len(names)} records, {document['model']} model, {document['estimator'].replace('_', ' ')}",
        ),
        *_proposed(document["proposed"]),
        Line(
            "spread: std between records; std *: mean within one, for a correlated residual; drift **: p < 1 % over "
            "all parameters together"
        ),
        Table(
            ("", *(str(number) for number in range(1, len(names) + 1))),
            judged,
            f"{units.words('force')} error [{unit} rms]: identified on the row's record, judged on the column's",
        ),
    )


def observation_view(document: Document, units: Units) -> View:
    """Delay of each method, its errors against a known force, and the smallest force that it shows."""
    methods = {name: part for name, part in document.items() if isinstance(part, Mapping)}
    force, unit = units.words("force"), units.unit("N")
    first = next(iter(methods.values()))
    known, least = first["rms_error"] is not None, first["smallest_observable_force"]
    judged = (f"rms error [{unit}]", f"away from edges [{unit}]", "rise [ms]", "plateau") if known else ()
    rows = [
        (name, f"{1e3 * result['delay']:.2f}", *(_errors(result) if known else ())) for name, result in methods.items()
    ]
    spans = (f"{name} {part['reliable_from']:.3f} to {part['reliable_to']:.3f} s" for name, part in methods.items())
    against = (
        f"errors: from {first['judged_from']:.2f} to {first['judged_to']:.2f} s, against the {force} of the moment"
    )
    return (
        Table(
            ("method", "delay [ms]", *judged),
            rows,
            f"External {force} of {document['record']}, axis {document['axis']}",
        ),
        Line(f"known from and to, filters settle before and after: {', '.join(spans)}"),
        *([Line(against)] if known else []),
        Table(
            ("method", force, "set by", *map(_word, least["bounds"])),
            [(name, *_smallest(part["smallest_observable_force"])) for name, part in methods.items()],
            f"Smallest observable {force} [{unit}], and what bounds it",
            words=("set by",),
        ),
        *(Line(f"{_word(bound)}: {reason}") for bound, reason in least["reasons"].items()),
    )


def _errors(result: Document) -> tuple[str, str, str, str]:
    """The errors of a method against a known force; "" where there are none."""
    steps = result["steps"]
    return (
        rounded(result["rms_error"]),
        "" if steps is None else rounded(steps["rms_error_away_from_edges"]),
        "" if steps is None or steps["rise_time"] is None else f"{1e3 * steps['rise_time']:.1f}",
        "" if steps is None else f"{steps['plateau_error_percent']:+.2f} %",
    )


def _smallest(least: Document) -> tuple[str, ...]:
    """The smallest force, the name of what sets it, and every bound."""
    return (rounded(least["value"]), _word(least["bound"]), *map(rounded, least["bounds"].values()))


def _word(bound: str) -> str:
    return bound.replace("_", "-")


def _parameters(document: Document, units: Units) -> Table:
    own = _names_of(document["proposed"])
    rows = [
        (_label(name, own, units), *_cells(estimate), estimate["unit"])
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
        _written(estimate["value"], places),
        _written(estimate["std"], places, 3),
        "" if percent is None else f"{percent:.2f}",
        _written(estimate["std_long_run"], places, 3),
        _written(0.5 * (high - low), places, 3),
    )


def _written(number: float | None, places: int, digits: int = 4) -> str:
    """``number`` with ``places`` decimals, or ``digits`` and an exponent if it is too long or would show as 0.

    >>> _written(95.1089, 4), _written(3.001e-05, 9), _written(2e-08, 6, 3)
    ('95.1089', '3.001e-05', '2.00e-08')
    """
    if number is None:
        return ""
    lost = 0.0 < abs(number) < 0.5 * 10.0**-places
    return f"{number:.{digits - 1}e}" if lost or places > MOST_PLACES else f"{number:.{places}f}"


def _label(name: str, proposed: set[str], units: Units) -> str:
    return units.words(name.replace("_and_", " + ")) + (" +" if name in proposed else "")


def _names_of(terms: Sequence[str]) -> set[str]:
    """The names of the parameters of ``terms``."""
    return {quantity.name for term in terms for quantity in TERMS[term].quantities}


def _proposed(terms: Sequence[str]) -> list[Line]:
    """Which terms the record called for, why, and how to leave them out."""
    why = "without it strokes that took no part in the fit are predicted with at least twice the error"
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
    """Errors beside chance that the intervals hold: by the cut-off, the filter and the encoder."""
    estimates = document["parameters"]
    if document["cutoff_sensitivity"] is not None:
        yield Line(_moved_by_cutoff(document, units))
    if any(estimate["systematic"] for estimate in estimates.values()):
        yield Line(f"95 % ± holds what this filter is off by as well, judged by `filter='{DEFAULT_CHAIN}'`")
    stepped = {name: estimate["encoder"] for name, estimate in estimates.items() if estimate["encoder"]}
    if stepped:
        each = _each(stepped, units)
        yield Line(f"95 % ± holds what the steps of the encoder do as well, by simulation: {each} rms")


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
    held = "; 95 % ± holds what is beyond chance" if beyond else ", no more than chance"
    if not tried:
        return "no other cut-off leaves enough of the record"
    return f"cut-offs of {tried} Hz change {moved or 'no parameter that is determined'}{held if moved else ''}"


def _judged(document: Document, units: Units) -> Iterator[Line]:
    """Held-out data, the cut-off that the record suggests, the test for bias, and the simulated closed loop."""
    unit, own = units.unit("N"), document["filter"]
    if document.get("held_out"):
        judged = document["held_out"]
        share = judged["relative_error_percent"]
        nothing = f"where there is no {units.words('force')} to compare it with"
        compared = f"{share:.4f} %" if math.isfinite(share) else nothing
        yield Line(f"held out, {judged['on']}: {rounded(judged['rms_error'], 4)} {unit} rms, {compared}")
    if "cutoff_from_data" in document:
        chosen = document["cutoff_from_data"]["cutoff_hz"]
        if own["chain"] != DEFAULT_CHAIN:
            yield Line(f"`filter='{DEFAULT_CHAIN}'` would cut off at {chosen:g} Hz")
        elif own["cutoff_hz"] != chosen:
            yield Line(f"motion and encoder of this record would have a cut-off of {chosen:g} Hz")
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
