"""From records and an axis to a diagnosis: check, fit the baseline, calibrate, search, decide, confirm."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from itertools import combinations

import numpy as np

from emps_design.axis import Axis
from emps_design.discrepancy.checks.controller_law import LawCheck, check_law
from emps_design.discrepancy.checks.requirements import check_records, check_same_drive, same_run
from emps_design.discrepancy.experiment.discrimination import experiment
from emps_design.discrepancy.explain import details as describe
from emps_design.discrepancy.explain.findings import findings as accepted_findings
from emps_design.discrepancy.model.candidate import Candidate
from emps_design.discrepancy.model.missing_force import missing_force
from emps_design.discrepancy.model.partition import split
from emps_design.discrepancy.model.problem import Fit, Problem, Whitening, evaluate, fit
from emps_design.discrepancy.result import Diagnosis
from emps_design.discrepancy.search.acceptance import Judge, explained, force_rms
from emps_design.discrepancy.search.beam_search import screen, search
from emps_design.discrepancy.search.cross_validated_noise import unpredicted
from emps_design.discrepancy.search.noise_floor import LEFT, STROKES, Floor, floor_of_laps, floor_of_residual
from emps_design.discrepancy.search.null_distribution import healthy_reference
from emps_design.discrepancy.search.outcome import Confirmation, Work
from emps_design.discrepancy.search.simulated_null import healthy_runs
from emps_design.discrepancy.search.starts import tangent
from emps_design.discrepancy.validation.holdout import (
    Confirming,
    between,
    confirm,
    confirming_gap,
    confirming_on,
    gap_on,
    most_missed,
)
from emps_design.effects import Effect, known_effects
from emps_design.errors import InputError
from emps_design.records import Record

Progress = Callable[[str, float], None]
LEAST_CONFIRMING = 500  # samples
FINER = 0.95  # of the floor: a model that leaves less than this share shows that it was no noise
FINER_THAN_LAPS = 0.7  # the same where laps repeat, which tells noise better than any model
SEARCHES = ((0.0, 0.6), (0.6, 0.25), (0.85, 0.15))  # start and share of the progress; noise taken again in between
LOST = 0.05  # of what the model explained; if refuted effects carried more, the rest is doubtful too
HELD = 0.8  # of the share explained on the training record must be explained on the confirming one


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
) -> Diagnosis:
    """Find where the closed-loop simulation of ``axis`` and ``records`` disagree, and which effect is missing.

    ``records`` of one axis are explained together; ``holdout``, or ``confirm_time`` (start, stop) [s] of the first
    record, is opened once, at the end. ``fit_time`` [s] limits what is fitted. ``library`` defaults to every known
    effect. ``searches`` healthy records are simulated and searched like this one, for the gain that chance alone
    reaches; 0 takes a linearisation of that. ``searched`` hears the model with which the search ended, before it is
    confirmed and described. Raises :class:`InputError` for records that cannot be judged, and where
    the controller of ``axis`` is not the one that made them.
    """
    from threadpoolctl import threadpool_limits

    report = progress or (lambda stage, fraction: None)
    records = (records,) if isinstance(records, Record) else tuple(records)
    library = tuple(known_effects().values()) if library is None else tuple(library)
    # The matrices here are tall and thin: BLAS threads would only spin, and the fits run side by side already.
    with threadpool_limits(1):
        given = (holdout, fit_time, confirm_time, seed, searches)
        dropped = [one.effect.name for one in axis.effects]
        work = _explain(records, axis.replace(effects=[]), library, *given, report, dropped)
        if searched is not None:
            searched(work.found.best.model.to_axis(axis))
        report("confirming on data not used so far", 0.9)
        return _conclude(work, confirming_on(work, holdout, confirm_time))


def _explain(
    records: tuple[Record, ...],
    axis: Axis,
    library: tuple[Effect, ...],
    holdout: Record | None,
    fit_time: tuple[float, float] | None,
    confirm_time: tuple[float, float] | None,
    seed: int,
    searches: int,
    report: Progress,
    dropped: Sequence[str] = (),
) -> Work:
    """Check, fit the baseline, calibrate and search; the confirming data stay closed."""
    warnings = check_records(records, axis)
    if dropped:
        warnings.append(f"the axis's own effects are left out and looked for again: {', '.join(dropped)}")
    for other in (*records[1:], holdout):
        if other is not None:
            check_same_drive(records[0], other)
    for one, other in combinations(records, 2):
        if same_run(one, other):
            raise InputError(f"{other.name}: is the record {one.name} again; give each record once")
    known = axis.controller.kind != "none"
    law = None
    if holdout is not None:
        if any(same_run(holdout, record) for record in records):
            raise InputError(f"{holdout.name}: is a training record too; confirm on one that nothing was fitted to")
        warnings += check_records((holdout,), axis)
        # A foreign controller is to be refused before the search; the law says nothing of the plant.
        law = check_law(holdout, axis, library) if known else None

    report("checking the controller's law", 0.02)
    checks = tuple(check_law(record, axis, library) for record in records if known)
    problem, start = _problem(records, axis, fit_time, confirm_time, checks)

    report("fitting the baseline", 0.05)
    candidates = tuple(effect for effect in library if effect.channel != "controller")
    problem, baseline, floor = _baseline(problem, start, candidates)
    stages = [partial(_stage, report, *part) for part in SEARCHES]
    work = _searched(problem, baseline, floor, candidates, checks, seed, searches, stages[0])
    for stage in stages[1:]:
        finer = _finer(work)
        if finer is None or work.found.interrupted:
            break
        try:
            problem = work.problem.with_whitening(finer.whitening)
            baseline = fit(problem, work.found.path[0].model, steps=20)
            searches = searches if work.healthy.searched else 0  # an interrupt ended the calibration for good
            again = _searched(problem, baseline, finer, candidates, checks, seed, searches, stage)
        except KeyboardInterrupt:
            again = None
        if again is None or again.found.interrupted:
            warnings.append("interrupted: the search was not repeated on the noise that its model left")
            break
        warnings += work.warnings
        work = again
    else:
        if _finer(work) is not None:
            warnings.append("the model leaves less than the noise it was judged by: more may be there than was found")
    return replace(work, warnings=(*warnings, *work.warnings), holdout_law=law)


def _finer(work: Work) -> Floor | None:
    """The noise that the best model of ``work`` leaves, where that is clearly less than the noise it was judged by.

    The noise was taken from what no model followed yet, or from laps that are not alike; a model that follows shows
    how much of it was noise.
    """
    floor = work.floor
    finer = floor_of_residual(work.problem.left(work.found.best.model), work.problem.period, LEFT)
    least = FINER_THAN_LAPS if floor.from_laps else FINER
    pays = finer.force < least * floor.force or finer.force_60hz < least * floor.force_60hz
    return finer if pays else None


def _searched(
    problem: Problem,
    baseline: Fit,
    floor: Floor,
    candidates: tuple[Effect, ...],
    checks: tuple[LawCheck, ...],
    seed: int,
    searches: int,
    report: Progress,
) -> Work:
    """Calibrate on healthy records, and search."""
    report("healthy reference", 0.0)
    absorbed, warnings = tangent(problem, baseline), []
    screened = screen(problem, baseline, candidates, absorbed)
    healthy = healthy_reference(screened, absorbed, floor.draws, seed)
    if searches:
        tell = partial(report, "healthy records, each searched")
        try:
            healthy = healthy_runs(problem, baseline, candidates, floor, searches, seed, tell)
        except KeyboardInterrupt:
            warnings.append("interrupted: calibrated on resampled noise, not on healthy records searched")
    judge = Judge(problem, healthy, floor)
    found = search(
        problem, baseline, candidates, screened, judge.accepts, lambda at, done: report(at, 0.1 + 0.9 * done)
    )
    if found.interrupted:
        warnings.append("interrupted: the search was not finished, what follows is what was known by then")
    return Work(problem, judge, found, floor, checks, healthy, screened, tuple(warnings), candidates)


def _stage(report: Progress, start: float, share: float, stage: str, done: float) -> None:
    """Report ``done`` of a search that is ``share`` of all searching, after ``start`` of it."""
    report(stage, 0.1 + 0.8 * (start + share * done))


def _problem(
    records: tuple[Record, ...],
    axis: Axis,
    fit_time: tuple[float, float] | None,
    confirm_time: tuple[float, float] | None,
    checks: tuple[LawCheck, ...],
) -> tuple[Problem, Candidate]:
    """The problem on what may be fitted, and the axis's own numbers with what the controller's law needs."""
    allowed = [np.ones(len(r), bool) for r in records]
    for record, mask in zip(records, allowed, strict=True):
        if fit_time is not None:
            mask &= between(record, fit_time, "--fit-time")
    if confirm_time is not None:
        kept = between(records[0], confirm_time, "--confirm-time")
        if kept.sum() < LEAST_CONFIRMING:
            raise InputError(
                f"--confirm-time: found {kept.sum()} samples of {records[0].name}, expected at least {LEAST_CONFIRMING}"
            )
        allowed[0] &= ~kept
    splits = tuple(split(r, mask) for r, mask in zip(records, allowed, strict=True))
    for record, made in zip(records, splits, strict=True):
        if made.fit.sum() < 500 or made.select.sum() < 200:
            raise InputError(
                f"{record.name}: found {made.used.sum()} samples to fit, in {len(made.strokes)} strokes; expected at "
                "least two strokes to fit and one to select from: record two reversals or more (identify needs none)"
            )
    start = Candidate(axis.mechanics.array())
    named = [check for check in checks if check.effect is not None]
    if named:
        effect = named[0].effect
        # A record without the disturbance has none of it, whatever its rhythm elsewhere.
        idle = np.where([p.unit == "V" for p in effect.parameters], 0.0, named[0].values)
        rows = [check.values if check.effect is effect else idle for check in checks]
        start = start.with_effect(effect, np.array(rows))
    return Problem(axis, records, splits, Whitening(np.array([1.0]), 1.0)), start


def _baseline(problem: Problem, start: Candidate, candidates: tuple[Effect, ...]) -> tuple[Problem, Fit, Floor]:
    """Refit the baseline: plain least squares for a start, then whitened by the floor's noise."""
    rough = fit(problem, start, steps=20)
    floor = floor_of_laps(problem.residuals(rough.model), problem.splits, problem.period)
    if floor is None:
        floor = floor_of_residual(unpredicted(problem, rough, candidates), problem.period, STROKES)
    problem = problem.with_whitening(floor.whitening)
    return problem, fit(problem, rough.model, steps=20), floor


def _conclude(work: Work, confirming: Confirming | None) -> Diagnosis:
    """Refit the search's best model on everything, open the confirming data, and say what it all means."""
    problem, found, floor = work.problem, work.found, work.floor
    start = fit(problem, found.path[0].model, part="used")
    # The baseline knows nothing of the controller's disturbance, which the search took as known from the law.
    baseline = start
    if start.model.names:
        baseline = evaluate(problem, replace(start.model, effects=(), values=()), start.slots, start.covariance)
    extended = work.judge.refitted(found.best.model) if len(found.path) > 1 else start
    judged, refuted, lost = None, (), 0.0
    if confirming is not None:
        learnt = start.cost - extended.cost
        judged, extended, refuted = confirm(work, confirming, baseline, extended)
        lost = 1 - (start.cost - extended.cost) / learnt if refuted else 0.0
    train = gap_on(problem, baseline.model, extended.model)

    # What the plant's effects explain, beside a disturbance of the controller that is known from its law.
    shares = [explained(force_rms(problem, start), force_rms(problem, extended), floor.force)]
    if confirming is not None:
        against = judged if start is baseline else confirming_gap(confirming, start.model, extended.model)
        shares.append(explained(against.gap.baseline, against.gap.extended, floor.force))
    equivalents = {n: others for n, others in work.judge.equivalents(found).items() if n in extended.model.names}
    verdict = work.judge.verdict(extended, start, equivalents, shares[-1])
    # A gap closed on its own record only was not understood; nor was one of which a good part was refuted.
    searched = extended.model.names != start.model.names
    forgotten = searched and shares[-1] < HELD * shares[0]
    if work.unnamed_law or forgotten or (lost > LOST and not work.judge.at_floor(extended)):
        verdict = "unnamed"
    if found.interrupted and not extended.model.names:
        verdict = "unnamed"
    given_up = extended.model.names if verdict == "unnamed" and searched else ()
    if given_up:
        extended = start
        train = gap_on(problem, baseline.model, start.model)
        judged = None if confirming is None else confirming_gap(confirming, baseline.model, start.model)

    confirmation = None
    if confirming is not None:
        own = "" if confirming.added in extended.model.names else confirming.added
        record = confirming.problem.records[0]
        confirmation = Confirmation(record, judged.refitted, refuted, own, confirming.unnamed_law)
    shown = judged or train
    findings = accepted_findings(work, extended, equivalents)
    most = most_missed(problem, baseline.model)
    before, after = (missing_force(problem, f.model)[most] for f in (baseline, extended))
    return Diagnosis(
        verdict=verdict,
        findings=findings,
        axis=shown.extended.to_axis(problem.axis),
        noise=floor,
        train=train.gap,
        holdout=None if judged is None else judged.gap,
        prediction=shown.prediction,
        views=describe.marked_views(before, after, problem.splits[most].used, work, findings),
        details=describe.details(work, verdict, baseline, extended, before, confirmation, (given_up, shares[-1])),
        stretch=None if confirming is None else confirming.stretch,
        experiment=experiment(problem, found, extended.model.names, equivalents, work.judge.healthy.threshold),
    )
