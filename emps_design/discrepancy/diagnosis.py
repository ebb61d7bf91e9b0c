"""From records and an axis to a diagnosis: prepare, calibrate, search, validate, explain."""

from __future__ import annotations

from dataclasses import replace

from emps_design.discrepancy import rules
from emps_design.discrepancy.along_motion import diagnose_along_motion, too_slow
from emps_design.discrepancy.beam_search import UNFINISHED, past_the_kind, search_or_kind
from emps_design.discrepancy.calibration import Outcome, calibrate, first_noise
from emps_design.discrepancy.closest import closest_of
from emps_design.discrepancy.explanation import explain
from emps_design.discrepancy.long_records import beginnings, check_the_rest
from emps_design.discrepancy.noise_floor import LEFT, Floor, floor_of_laps, floor_of_residual
from emps_design.discrepancy.preparation import Confirming, Preparation, prepare
from emps_design.discrepancy.request import DiagnosisRequest
from emps_design.discrepancy.result import Diagnosis
from emps_design.discrepancy.starts import at_first_sight, suspects_text
from emps_design.discrepancy.verdict import Validation, validate
from emps_design.effects import known_effects
from emps_design.errors import EmpsError, InputError, RecordError, SimulationError
from emps_design.laws import NONE
from emps_design.messages import warning
from emps_design.progress import Progress, of_part
from emps_design.records import Record
from emps_design.request import takes

NOT_REPEATED = warning(
    "repeat-interrupted", "interrupted: the search was not repeated on the noise that its model left"
)
STILL_FINER = warning(
    "noise-too-large", "the model leaves less than the noise it was judged by: more may be there than was found"
)


@takes(DiagnosisRequest)
def diagnose(request: DiagnosisRequest) -> Diagnosis:
    """Find where the closed-loop simulation of the axis and records disagree, and which effect is missing.

    Records of one axis are explained together; ``holdout``, or ``confirm_time`` (start, stop) [s] of the first record,
    is opened once, at the end. Without either it is the first lap, or the last third, of a single record, where enough
    is left to fit. ``fit_time`` [s] limits what is fitted. ``library`` defaults to every known effect; its starts and
    bounds are scaled to the axis. ``searches`` healthy records are simulated and searched like this one, for the gain
    that chance alone reaches; 0 linearises that. ``progress(stage, share)`` reports progress, ``searched(axis)`` the
    model at the end of each search, before it is confirmed. Of records too long to be searched whole only the beginning
    is searched, and a warning says what its model leaves of the rest. With ``closest`` the answer also has the model
    that follows the records most closely, whatever its effects mean. Raises :class:`InputError` for records that cannot
    be judged, and where the controller of ``axis`` did not make them.
    """
    from threadpoolctl import threadpool_limits

    request = _complete(request)
    # The matrices here are tall and thin: BLAS threads would only spin, and the fits run side by side already.
    with threadpool_limits(1):
        if too_slow(request.records):
            return diagnose_along_motion(request)
        try:
            return _by_simulation(request)
        except (SimulationError, RecordError) as error:
            if request.axis.controller.kind != NONE:
                raise
            try:
                return diagnose_along_motion(request)
            except EmpsError:
                raise error from None


def _complete(request: DiagnosisRequest) -> DiagnosisRequest:
    """``request`` with a library, and progress that never decreases."""
    if not request.records:
        raise InputError("records: found none, expected at least one")
    library = known_effects().values() if request.library is None else request.library
    return replace(request, library=tuple(library), progress=_forward(request.progress))


def _prepared(request: DiagnosisRequest, parts: tuple[Record, ...], opened: Confirming | None = None) -> Preparation:
    """The first stage on ``parts`` of the records; with ``opened`` all is fitted and nothing held out."""
    windows = (request.holdout, request.fit_time, request.confirm_time)
    confirms = windows if opened is None else (None, request.fit_time, None)
    return prepare(parts, request.axis, tuple(request.library or ()), *confirms, opened)


def _by_simulation(request: DiagnosisRequest) -> Diagnosis:
    """Diagnose by closed-loop simulations of the records."""
    report, seed, searches = request.progress, request.seed, request.searches
    report("checking the records and the controller's law", 0.02)
    parts = beginnings(request.records, request.fit_time, request.confirm_time)
    searching = of_part(report, 0.1, 0.8)

    def validated(preparation: Preparation) -> Validation:
        suspects = suspects_text(at_first_sight(preparation.start, preparation.library))
        report(f"fitting the baseline{suspects}", 0.05)
        rough, floor = first_noise(preparation)
        part = _turn(searching, 0)
        outcome = search_or_kind(calibrate(preparation, rough, floor, seed, searches, part), part)
        request.keep(outcome.best.model.to_axis(request.axis))
        outcome = _repeated(outcome, seed, searches, searching)
        request.keep(outcome.best.model.to_axis(request.axis))
        report("confirming on data not used so far", 0.9)
        return validate(outcome, _turn(searching, rules.IN_TURN))

    preparation = _prepared(request, parts)
    validation = validated(preparation)
    if preparation.confirming.chosen == "kept" and _differs_there(validation):
        whole = validated(_prepared(request, parts, preparation.confirming.opened))
        if whole.extended.model.names:
            preparation, validation = whole.outcome.preparation, whole
    rest, more = check_the_rest(request.records, parts, preparation.laws, validation.extended)
    if request.closest:
        report("looking for the model that follows most closely", 0.95)
    following = closest_of(validation) if request.closest else None
    return explain(validation.beside_something_unknown() if more else validation, rest, following)


def _differs_there(validation: Validation) -> bool:
    """Whether the part held out has something that the fitted rest lacks, such as a drift that fades."""
    if validation.held_out is None or validation.outcome.interrupted:
        return False
    floor = validation.outcome.floor.force
    return validation.held_out.gap.extended > rules.QUIET * max(floor, validation.train.gap.extended)


def _repeated(outcome: Outcome, seed: int, searches: int, searching: Progress) -> Outcome:
    """Calibrate and search again while the model leaves clearly less than the noise it was judged by, twice at most.

    A search that stopped at an unknown force is finished under the last noise only, which takes longest.
    """
    part = _turn(searching, 0)
    for turn in range(1, rules.IN_TURN):
        floor = _finer(outcome)
        if floor is None or outcome.interrupted:
            break
        part = _turn(searching, turn)
        runs = searches if outcome.healthy.searched else 0  # an interrupt ended the calibration for good
        try:
            begun = calibrate(outcome.preparation, outcome.baseline, floor, seed, runs, part)
            again = search_or_kind(begun, part, outcome)
        except KeyboardInterrupt:
            again = None
        if again is None or again.interrupted:
            remarks = (NOT_REPEATED, UNFINISHED) if outcome.stopped else (NOT_REPEATED,)
            return replace(outcome, warnings=(*outcome.warnings, *remarks), interrupted=outcome.stopped)
        outcome = replace(again, warnings=(*outcome.warnings, *again.warnings))
    outcome = past_the_kind(outcome, part)
    if not outcome.interrupted and _finer(outcome) is not None:
        outcome = replace(outcome, warnings=(*outcome.warnings, STILL_FINER))
    return outcome


def _turn(searching: Progress, number: int) -> Progress:
    """The progress of the search under estimate ``number`` of the noise, each half of what is left."""
    return of_part(searching, 1.0 - 0.5**number, 0.5 ** (number + 1))


def _finer(outcome: Outcome) -> Floor | None:
    """The noise estimated from the best model, where clearly less than the one it was judged by; else None.

    The earlier noise contained what the baseline did not follow, or differences of laps that the model explains. The
    part that an unknown force of one kind explains is no noise either.
    """
    floor, force = outcome.floor, outcome.of_a_kind
    best = outcome.best if force is None else force.fitted
    splits, period = best.problem.splits, best.problem.period
    of_laps = floor_of_laps(best.residuals(), splits, period) if floor.from_laps else None
    finer = of_laps or floor_of_residual(best.remaining_force(), period, LEFT)
    pays = finer.force < rules.FINER * floor.force or finer.force_60hz < rules.FINER * floor.force_60hz
    return finer if pays else None


def _forward(progress: Progress) -> Progress:
    """``progress`` that never decreases, even where a search continues from an earlier round."""
    reached = 0.0

    def report(stage: str, share: float) -> None:
        nonlocal reached
        reached = max(reached, share)
        progress(stage, reached)

    return report
