"""From records and an axis to a diagnosis: prepare, calibrate, search, validate, explain."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from emps_design.axis import Axis
from emps_design.discrepancy import rules
from emps_design.discrepancy.along_motion import diagnose_along_motion, too_slow
from emps_design.discrepancy.beam_search import UNFINISHED, past_the_kind, search_or_kind
from emps_design.discrepancy.calibration import Outcome, calibrate, first_noise
from emps_design.discrepancy.closest import closest_of
from emps_design.discrepancy.explanation import explain
from emps_design.discrepancy.long_records import beginnings, look_at_the_rest
from emps_design.discrepancy.noise_floor import LEFT, Floor, floor_of_laps, floor_of_residual
from emps_design.discrepancy.preparation import Confirming, Preparation, prepare
from emps_design.discrepancy.result import Diagnosis
from emps_design.discrepancy.starts import at_first_sight, told
from emps_design.discrepancy.verdict import Validation, validate
from emps_design.effects import Effect, known_effects
from emps_design.errors import EmpsError, RecordError, SimulationError
from emps_design.laws import NONE
from emps_design.progress import Progress, no_progress, of_part
from emps_design.records import Record

SEARCHES = ((0.0, 0.6), (0.6, 0.25), (0.85, 0.15))  # start and share of the progress; noise taken again in between
CONFIRMATION = (1.0, 0.05)  # the same, beyond the searches: one that ended early may have to go on
NOT_REPEATED = "interrupted: the search was not repeated on the noise that its model left"
STILL_FINER = "the model leaves less than the noise it was judged by: more may be there than was found"


def diagnose(
    records: Record | Sequence[Record],
    axis: Axis,
    holdout: Record | None = None,
    fit_time: tuple[float, float] | None = None,
    confirm_time: tuple[float, float] | None = None,
    library: Sequence[Effect] | None = None,
    seed: int = 0,
    searches: int = 0,
    progress: Progress | None = None,
    searched: Callable[[Axis], None] | None = None,
    closest: bool = False,
) -> Diagnosis:
    """Find where the closed-loop simulation of ``axis`` and ``records`` disagree, and which effect is missing.

    ``records`` of one axis are explained together; ``holdout``, or ``confirm_time`` (start, stop) [s] of the first
    record, is opened once, at the end. Without either it is the first lap, or the last third, of a single record, where
    enough is left to fit. ``fit_time`` [s] limits what is fitted. ``library`` defaults to every known
    effect; its starts and bounds are sized to the axis. ``searches`` healthy records are simulated and searched like
    this one, for the gain that chance alone reaches; 0 takes a linearisation of that. ``progress(stage, share)``
    hears how far it is, ``searched(model)`` the model with which a search ended, before it is confirmed. Of records
    too long to be searched whole the beginning is, and what its model leaves of the rest is told. With ``closest`` the
    answer also has the model that follows the records most closely, whatever its effects stand for. Raises
    :class:`InputError` for records that cannot be judged, and where the controller of ``axis`` is not the one that
    made them.
    """
    from threadpoolctl import threadpool_limits

    report, hears = _forward(progress or no_progress), searched or (lambda model: None)
    records = (records,) if isinstance(records, Record) else tuple(records)
    library = tuple(known_effects().values() if library is None else library)

    def along_motion() -> Diagnosis:
        return diagnose_along_motion(records, axis, library, holdout, (fit_time, confirm_time), report, hears)

    # The matrices here are tall and thin: BLAS threads would only spin, and the fits run side by side already.
    with threadpool_limits(1):
        if too_slow(records):
            return along_motion()
        try:
            asked = DiagnosisRequest(records, axis, library, holdout, fit_time, confirm_time)
            return _by_simulation(asked, seed, searches, report, hears, closest)
        except (SimulationError, RecordError) as error:
            if axis.controller.kind != NONE:
                raise
            try:
                return along_motion()
            except EmpsError:
                raise error from None


@dataclass(frozen=True)
class DiagnosisRequest:
    """What :func:`diagnose` was asked, but for how."""

    records: tuple[Record, ...]
    axis: Axis
    library: tuple[Effect, ...]
    holdout: Record | None
    fit_time: tuple[float, float] | None
    confirm_time: tuple[float, float] | None

    def prepared(self, parts: tuple[Record, ...], opened: Confirming | None = None) -> Preparation:
        """The first stage on ``parts`` of the records, all of them fitted where what was kept is ``opened``."""
        confirms = (self.holdout, self.fit_time, self.confirm_time) if opened is None else (None, self.fit_time, None)
        return prepare(parts, self.axis, self.library, *confirms, opened)


def _by_simulation(
    asked: DiagnosisRequest, seed: int, searches: int, report: Progress, hears: Callable[[Axis], None], closest: bool
) -> Diagnosis:
    """Diagnose by closed-loop simulations of the records."""
    report("checking the records and the controller's law", 0.02)
    parts = beginnings(asked.records, asked.fit_time, asked.confirm_time)
    searching = of_part(report, 0.1, 0.8)

    def validated(preparation: Preparation) -> Validation:
        seen = told(at_first_sight(preparation.start, preparation.library))
        report(f"fitting the baseline{seen}", 0.05)
        rough, floor = first_noise(preparation)
        part = of_part(searching, *SEARCHES[0])
        outcome = search_or_kind(calibrate(preparation, rough, floor, seed, searches, part), part)
        hears(outcome.best.model.to_axis(asked.axis))
        outcome = _repeated(outcome, seed, searches, searching)
        hears(outcome.best.model.to_axis(asked.axis))
        report("confirming on data not used so far", 0.9)
        return validate(outcome, of_part(searching, *CONFIRMATION))

    preparation = asked.prepared(parts)
    validation = validated(preparation)
    if preparation.confirming.chosen == "kept" and _differs_there(validation):
        whole = validated(asked.prepared(parts, preparation.confirming.opened))
        if whole.extended.model.names:
            preparation, validation = whole.outcome.calibration.preparation, whole
    rest, more = look_at_the_rest(asked.records, parts, preparation.laws, validation.extended)
    if closest:
        report("looking for the model that follows most closely", 0.95)
    following = closest_of(validation) if closest else None
    return explain(validation.beside_something_unknown() if more else validation, rest, following)


def _differs_there(validation: Validation) -> bool:
    """Whether what was kept closed has something that the fitted rest lacks, such as a drift that fades or a change."""
    if validation.held_out is None or validation.outcome.interrupted:
        return False
    floor = validation.outcome.calibration.floor.force
    return validation.held_out.gap.extended > rules.QUIET * max(floor, validation.train.gap.extended)


def _repeated(outcome: Outcome, seed: int, searches: int, searching: Progress) -> Outcome:
    """Calibrate and search again as long as the model leaves less than the noise it was judged by, twice at most.

    A search that stopped at an unknown force of one kind is gone on with under the last noise only: that takes longest.
    """
    part = of_part(searching, *SEARCHES[0])
    for shares in SEARCHES[1:]:
        floor = _finer(outcome)
        if floor is None or outcome.interrupted:
            break
        calibration, part = outcome.calibration, of_part(searching, *shares)
        runs = searches if calibration.healthy.searched else 0  # an interrupt ended the calibration for good
        try:
            calibration = calibrate(calibration.preparation, calibration.baseline, floor, seed, runs, part)
            again = search_or_kind(calibration, part, outcome)
        except KeyboardInterrupt:
            again = None
        if again is None or again.interrupted:
            told = (NOT_REPEATED, UNFINISHED) if outcome.stopped else (NOT_REPEATED,)
            return replace(outcome, warnings=(*outcome.warnings, *told), interrupted=outcome.stopped)
        outcome = replace(again, warnings=(*outcome.warnings, *again.warnings))
    outcome = past_the_kind(outcome, part)
    if not outcome.interrupted and _finer(outcome) is not None:
        outcome = replace(outcome, warnings=(*outcome.warnings, STILL_FINER))
    return outcome


def _finer(outcome: Outcome) -> Floor | None:
    """The noise read again, where that is clearly less than the noise the best model was judged by.

    It was taken from what no model followed yet, or from laps that are not alike: what the model knows of one lap and
    not of another is then no noise. Nor is what an unknown force of one kind explains.
    """
    floor, force = outcome.calibration.floor, outcome.of_a_kind
    best = outcome.best if force is None else force.found
    splits, period = best.problem.splits, best.problem.period
    of_laps = floor_of_laps(best.residuals(), splits, period) if floor.from_laps else None
    finer = of_laps or floor_of_residual(best.left(), period, LEFT)
    pays = finer.force < rules.FINER * floor.force or finer.force_60hz < rules.FINER * floor.force_60hz
    return finer if pays else None


def _forward(progress: Progress) -> Progress:
    """``progress`` that never goes back, where a search goes on from an earlier round."""
    reached = 0.0

    def report(stage: str, share: float) -> None:
        nonlocal reached
        reached = max(reached, share)
        progress(stage, reached)

    return report
