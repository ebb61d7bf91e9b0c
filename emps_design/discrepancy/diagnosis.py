"""From records and an axis to a diagnosis: prepare, calibrate, search, validate, explain."""

from __future__ import annotations

from dataclasses import replace

from emps_design.discrepancy import rules
from emps_design.discrepancy.along_motion import diagnose_along_motion, too_slow
from emps_design.discrepancy.beam_search import UNFINISHED, finish_stopped, search_with_unknown_force
from emps_design.discrepancy.calibration import Outcome, calibrate, first_noise
from emps_design.discrepancy.closest import closest_of
from emps_design.discrepancy.explanation import explain
from emps_design.discrepancy.long_records import beginnings, check_the_rest
from emps_design.discrepancy.noise_floor import RESIDUAL, Floor, floor_of_laps, floor_of_residual
from emps_design.discrepancy.preparation import HoldOut, Preparation, prepare
from emps_design.discrepancy.request import DiagnosisRequest
from emps_design.discrepancy.result import Diagnosis
from emps_design.discrepancy.starts import quick_suspects, suspects_text
from emps_design.discrepancy.verdict import Validation, validate
from emps_design.effects import known_effects
from emps_design.errors import EmpsError, InputError, RecordError, SimulationError
from emps_design.laws import NONE
from emps_design.messages import warning
from emps_design.progress import Progress, of_part
from emps_design.records import Record
from emps_design.request import takes
from emps_design.threads import one_thread

NOT_REPEATED = warning(
    "repeat-interrupted", "interrupted: the search was not repeated with the noise level of its own residual"
)
STILL_FINER = warning(
    "noise-too-large", "the residual is smaller than the noise level it was judged by: further effects may be present"
)


@takes(DiagnosisRequest)
def diagnose(request: DiagnosisRequest) -> Diagnosis:
    """Find where the closed-loop simulation of the axis and the records disagree, and which effect is missing.

    All records of the axis are fitted together. ``holdout``, or ``confirm_time`` (start, stop) [s] of the first record,
    is used once, at the end. Without either, the first lap or the last third of a single record is held out if enough
    data remain to fit. ``fit_time`` [s] limits the fitted data. ``library`` defaults to every known effect; starting
    values and bounds are scaled to the axis. The gain that chance alone reaches comes from ``searches`` simulated
    healthy records, each searched like the measured ones; 0 uses a linear approximation. ``progress(stage, share)``
    reports progress; ``searched(axis)`` receives the model at the end of each search, before it is confirmed. Of a very
    long record only the beginning is searched; a warning gives the residual of its model on the rest. With ``closest``
    the result also has the model that follows the records most closely, whatever its effects mean. Raises
    :class:`InputError` for records that cannot be judged or that the controller of ``axis`` did not make.
    """
    request = _with_defaults(request)
    with one_thread():  # the fits already run in parallel
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


def _with_defaults(request: DiagnosisRequest) -> DiagnosisRequest:
    """``request`` with the default library, and progress that never decreases."""
    if not request.records:
        raise InputError("records: found none, expected at least one")
    library = known_effects().values() if request.library is None else request.library
    return replace(request, library=tuple(library), progress=_monotonic(request.progress))


def _prepare(request: DiagnosisRequest, parts: tuple[Record, ...], opened: HoldOut | None = None) -> Preparation:
    """The first stage on ``parts`` of the records; with ``opened`` all samples are fitted and none held out."""
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
        suspects = suspects_text(quick_suspects(preparation.start, preparation.library))
        report(f"fitting the baseline{suspects}", 0.05)
        rough, floor = first_noise(preparation)
        part = _progress_of_search(searching, 0)
        outcome = search_with_unknown_force(calibrate(preparation, rough, floor, seed, searches, part), part)
        request.keep(outcome.best.model.to_axis(request.axis))
        outcome = _repeat_with_finer_noise(outcome, seed, searches, searching)
        request.keep(outcome.best.model.to_axis(request.axis))
        report("confirming on held-out data", 0.9)
        return validate(outcome, _progress_of_search(searching, rules.IN_TURN))

    preparation = _prepare(request, parts)
    validation = validated(preparation)
    if preparation.hold_out.chosen == "kept" and _held_out_differs(validation):
        whole = validated(_prepare(request, parts, preparation.hold_out.opened))
        if whole.extended.model.names:
            preparation, validation = whole.outcome.preparation, whole
    rest, fails = check_the_rest(request.records, parts, preparation.laws, validation.extended)
    if request.closest:
        report("looking for the model that follows the records most closely", 0.95)
    following = closest_of(validation) if request.closest else None
    return explain(validation.beside_something_unknown() if fails else validation, rest, following)


def _held_out_differs(validation: Validation) -> bool:
    """Whether the held-out part shows an effect that the fitted part does not, such as a drift that fades."""
    if validation.held_out is None or validation.outcome.interrupted:
        return False
    floor = validation.outcome.floor.force
    return validation.held_out.gap.extended > rules.QUIET * max(floor, validation.train.gap.extended)


def _repeat_with_finer_noise(outcome: Outcome, seed: int, searches: int, searching: Progress) -> Outcome:
    """Calibrate and search again while the residual is clearly below the noise level in use, at most twice.

    A search that stopped at an unknown force is finished with the last noise estimate only, as that takes longest.
    """
    part = _progress_of_search(searching, 0)
    for turn in range(1, rules.IN_TURN):
        floor = _finer_floor(outcome)
        if floor is None or outcome.interrupted:
            break
        part = _progress_of_search(searching, turn)
        runs = searches if outcome.healthy.searched else 0  # an interrupt ended the calibration for good
        try:
            started = calibrate(outcome.preparation, outcome.baseline, floor, seed, runs, part)
            again = search_with_unknown_force(started, part, outcome)
        except KeyboardInterrupt:
            again = None
        if again is None or again.interrupted:
            remarks = (NOT_REPEATED, UNFINISHED) if outcome.stopped else (NOT_REPEATED,)
            return replace(outcome, warnings=(*outcome.warnings, *remarks), interrupted=outcome.stopped)
        outcome = replace(again, warnings=(*outcome.warnings, *again.warnings))
    outcome = finish_stopped(outcome, part)
    if not outcome.interrupted and _finer_floor(outcome) is not None:
        outcome = replace(outcome, warnings=(*outcome.warnings, STILL_FINER))
    return outcome


def _progress_of_search(searching: Progress, number: int) -> Progress:
    """Progress of the search with noise estimate ``number``; each takes half of the remaining range."""
    return of_part(searching, 1.0 - 0.5**number, 0.5 ** (number + 1))


def _finer_floor(outcome: Outcome) -> Floor | None:
    """Noise estimated from the residual of the best model, if clearly below the one in use; else None.

    The noise in use may contain structure that the baseline did not explain, or differences between laps that the
    model explains. The part that an unknown force of one kind explains is not noise either.
    """
    floor, force = outcome.floor, outcome.unknown_force
    best = outcome.best if force is None else force.fitted
    splits, period = best.problem.splits, best.problem.period
    of_laps = floor_of_laps(best.residuals(), splits, period) if floor.from_laps else None
    finer = of_laps or floor_of_residual(best.remaining_force(), period, RESIDUAL)
    lower = finer.force < rules.FINER * floor.force or finer.force_60hz < rules.FINER * floor.force_60hz
    return finer if lower else None


def _monotonic(progress: Progress) -> Progress:
    """``progress`` that never decreases, even if a search continues from an earlier round."""
    reached = 0.0

    def report(stage: str, share: float) -> None:
        nonlocal reached
        reached = max(reached, share)
        progress(stage, reached)

    return report
