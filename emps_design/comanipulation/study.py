"""The mismatch study of section IV-B: the law's estimates of M, F_v and F_c are wrong by up to a few percent.

The study simulates all corners of the box of errors and uniform, seeded Monte-Carlo errors within it. For each it gives
a verdict, the transparency, the peak voltage and the operator's effort. The plant is the axis; the estimate of the law
is ``1 + error`` times the plant's parameter.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import scipy

from emps_design.axis import Axis
from emps_design.comanipulation.run import TaskRun, in_threads, run_many, run_task
from emps_design.comanipulation.task import Measures, Task, fitted_task
from emps_design.control.impedance.law import FrictionModel, ImpedanceLaw
from emps_design.control.impedance.passivity import Clock, impedance_error, sampled_loop
from emps_design.control.impedance.robustness import VERDICTS, check_mismatch, corner_errors
from emps_design.control.sampled import MARGINAL
from emps_design.laws.law import PARAMETERS
from emps_design.messages import Message, grave, note, warning
from emps_design.request import Request, option, takes
from emps_design.units import Units

MOST = 1_000_000  # plants, for the memory
TOGETHER = 2_500  # plants per computation of poles, which cannot be interrupted
CALM = ("stable", "dead_band")  # verdicts of a carriage that comes to rest
ALIKE = [0, 1, 1, 2, 2]  # columns of errors that are equal in both directions: mass, viscous, Coulomb
BOUNDED = (*CALM, "creeping")  # neither a limit cycle nor unstable

# Options of a study.
PLANTS: dict[str, Any] = {"help": "Monte-Carlo plants in addition to the corners", "limits": (0, MOST)}
SEED: dict[str, Any] = {"help": "seed of the Monte-Carlo plants", "limits": (0, 2**63)}
WORKERS: dict[str, Any] = {"help": "number of threads; no influence on the results", "limits": (1, 256)}
TWO_QUADRANT: dict[str, Any] = {
    "help": "independent errors of the five parameters of (5), None: if the axis's friction differs by direction"
}


@dataclass(frozen=True)
class MismatchStudy:
    """Verdict, transparency and effort of every simulated plant; the first ``corners`` rows are the corners.

    ``errors`` (m, 5) are relative, in the order of ``PARAMETERS``; ``error`` (m,) is the rms relative error of the
    apparent impedance over 0-20 rad/s (nan if the poles are unstable); ``radius`` (m,) is the largest pole modulus.
    ``beyond`` has further changes of the machine, one at a time, with the worst verdict of the corners.
    """

    axis: Axis
    law: ImpedanceLaw
    mismatch: float
    seed: int
    task: Task
    corners: int
    errors: np.ndarray
    error: np.ndarray
    radius: np.ndarray
    measures: Measures
    beyond: tuple[dict[str, str], ...] = ()

    @cached_property
    def verdict(self) -> np.ndarray:
        """Indices into ``VERDICTS`` (m,): as simulated, or unstable if the poles are."""
        return np.where(self.radius > 1.0 + MARGINAL, VERDICTS.index("unstable"), self.measures.verdict)

    @property
    def plants(self) -> int:
        """Number of Monte-Carlo plants."""
        return len(self.errors) - self.corners

    @property
    def split(self) -> bool:
        """Whether the friction errors of the two directions are independent."""
        return self.corners > 8

    @property
    def creep(self) -> float:
        """Largest creep speed [m/s] of a plant; 0 if none creeps."""
        creeping = self.verdict == VERDICTS.index("creeping")
        return float(self.measures.tends_to[creeping].max(initial=0.0))

    @property
    def worst(self) -> int:
        """Row of the worst plant: by verdict, then by the error of the apparent impedance."""
        return int(np.lexsort((np.nan_to_num(self.error, nan=np.inf), self.verdict))[-1])

    @property
    def stable_share(self) -> tuple[float, float, float]:
        """Share of plants that come to rest after the release, with its 95 % Clopper-Pearson interval.

        These are neither unstable nor in a limit cycle nor creeping; a plant that never moved does not count. The share
        is that of the Monte-Carlo plants, or if there are none that of the corners, without an interval.
        """
        return self._share(CALM)

    @property
    def bounded_share(self) -> tuple[float, float, float]:
        """As :attr:`stable_share`, for plants that are neither unstable nor in a limit cycle but may creep."""
        return self._share(BOUNDED)

    def _share(self, verdicts: tuple[str, ...]) -> tuple[float, float, float]:
        good = np.isin(self.verdict, [VERDICTS.index(name) for name in verdicts])
        if not self.plants:
            return float(good.mean()), float("nan"), float("nan")
        n, k = self.plants, int(good[self.corners :].sum())
        low = float(scipy.special.betaincinv(k, n - k + 1, 0.025)) if k else 0.0
        high = float(scipy.special.betaincinv(k + 1, n - k, 0.975)) if k < n else 1.0
        return k / n, low, high

    def plant(self, row: int) -> dict[str, Any]:
        """Errors, estimates, verdict, transparency, peak voltage and effort of the plant in ``row``."""
        errors = {name: float(e) for name, e in zip(PARAMETERS, self.errors[row], strict=True)}
        estimate = self.law.estimate.with_errors(errors).to_dict()
        if not self.law.estimate.two_quadrant:
            errors, estimate = _one_quadrant(errors), _one_quadrant(estimate)
        mass, damping, r2 = (float(x[row]) for x in self.measures.fit)
        return {
            "parameters": estimate,
            "errors": errors,
            "verdict": VERDICTS[self.verdict[row]],
            "apparent_mass": mass,
            "apparent_damping": damping,
            "r2": r2,
            "error": float(self.error[row]),
            "drift_speed": float(self.measures.drift[row]),
            "peak_voltage": float(self.measures.peak_u[row]),
            "largest_pole": float(self.radius[row]),
            "effort": {name: float(values[row]) for name, values in self.measures.effort.items()},
        }

    @property
    def warnings(self) -> tuple[Message, ...]:
        """Messages on undefined numbers in :meth:`to_dict`, and on worse verdicts beyond the mismatch."""
        messages, units = list(self.task.warnings), self.axis.units
        carriage = units.word("carriage")
        if not self.plants:
            text = "stable_share_interval is undefined: without random plants, stable_share is that of the corners"
            messages.append(note("no-plants", text))
        if np.isnan(self.error).any():
            messages.append(grave("unstable-plants", "error is undefined for plants whose sampled loop is unstable"))
        still = int(np.sum(self.verdict == VERDICTS.index("no_motion")))
        if still:
            text = (
                f"no verdict for {still} of {len(self.errors)} plants: the {carriage} was at rest at the release; the "
                f"apparent impedance ({units.word('mass')}, damping, r2, force_per_speed) is undefined for plants that "
                "never moved"
            )
            messages.append(warning("no-verdict", text, count=still))
        if np.any(self.measures.diverged > 0):
            text = "the apparent impedance is undefined for plants whose simulation stopped because the loop diverged"
            messages.append(grave("ran-away", text))
        wanders = self.measures.wanders & np.isin(self.verdict, [VERDICTS.index(name) for name in CALM])
        if wanders.any():
            drift = float(self.measures.drift[wanders].max())
            many = f"{int(wanders.sum())} of {len(self.errors)} plants drift"
            text = (
                f"{many if self.mismatch else f'the {carriage} drifts'} at up to "
                f"{units.quantity(drift, 'mm/s', '.2g')}, one or two encoder steps per period: encoder quantisation "
                "causes it, not friction"
            )
            messages.append(warning("wanders", text, speed=drift))
        here = int(self.verdict.max())
        worse = [change for change in self.beyond if VERDICTS.index(change["verdict"]) > here]
        if worse:
            changes = "; ".join(f"{change['what']}: {change['verdict']}" for change in worse)
            text = f"worse than within the mismatch, with one change of the machine at a time: {changes}"
            verdicts = [change["verdict"] for change in worse]
            if set(verdicts) <= {*CALM, "no_motion"}:
                messages.append(warning("other-beyond-mismatch", text, verdicts=verdicts))
            else:
                messages.append(grave("worse-beyond-mismatch", text, verdicts=verdicts))
        return tuple(messages)

    def to_dict(self) -> dict[str, Any]:
        """Counts, shares with intervals, medians and 5-95 % ranges over the plants, the corners, and the worst case."""
        share, low, high = self.stable_share
        bounded, bounded_low, bounded_high = self.bounded_share
        drawn = slice(self.corners, None) if self.plants else slice(None)
        mass, damping, r2 = self.measures.fit
        columns = {
            "apparent_mass": mass,
            "apparent_damping": damping,
            "r2": r2,
            "error": self.error,
            "peak_voltage": self.measures.peak_u,
            **self.measures.effort,
        }
        return {
            "axis": self.axis.name,
            "law": self.law.to_dict(),
            "mismatch": self.mismatch,
            "seed": self.seed,
            "plants": self.plants,
            "task": self.task.to_dict(),
            "varied": list(PARAMETERS if self.split else ("mass", "viscous", "coulomb")),
            "not_varied": _not_varied(self.axis.units),
            "beyond": list(self.beyond),
            "stable_share": share,
            "stable_share_interval": [low, high],
            "bounded_share": bounded,
            "bounded_share_interval": [bounded_low, bounded_high],
            "verdicts": {name: int(np.sum(self.verdict[drawn] == place)) for place, name in enumerate(VERDICTS)},
            "ranges": {
                name: dict(zip(("low", "median", "high"), _quantiles(values[drawn]), strict=True))
                for name, values in columns.items()
            },
            "corners": [self.plant(row) for row in range(self.corners)],
            "worst": self.plant(self.worst),
        }


@dataclass(frozen=True)
class StudyRequest(Request):
    """Options of :func:`mismatch_study` in addition to axis and law."""

    mismatch: float = option(0.02, "largest relative error of an estimate")
    plants: int = option(1000, **PLANTS)
    seed: int = option(0, **SEED)
    two_quadrant: bool | None = option(None, **TWO_QUADRANT)
    task: Task | None = option(None, "task of the operator, None: fitted_task")
    workers: int = option(1, **WORKERS)


@takes(StudyRequest)
def mismatch_study(axis: Axis, law: ImpedanceLaw, request: StudyRequest) -> MismatchStudy:
    """Simulate ``law`` with errors of its estimates up to ``mismatch``: every corner, and ``plants`` random errors.

    With ``two_quadrant`` plants are released in both directions, and the worse of the two runs counts.
    Raises :class:`InputError` for a number out of range.

    >>> from emps_design.machines import machine
    >>> from emps_design.control.impedance.law import impedance_law
    >>> axis = machine("emps2018")
    >>> study = mismatch_study(axis, impedance_law(axis, 50.0, 100.0), 0.02, plants=0)
    >>> study.to_dict()["worst"]["verdict"]
    'creeping'
    """
    mismatch, seed, workers, progress = request.mismatch, request.seed, request.workers, request.progress
    check_mismatch(mismatch)
    plant = FrictionModel.of(axis)
    split = plant.two_quadrant if request.two_quadrant is None else request.two_quadrant
    corners = box_of(corner_errors(mismatch, split))
    drawn = np.random.default_rng(seed).uniform(-mismatch, mismatch, (request.plants, 5 if split else 3))
    errors = np.vstack([corners, drawn if split else drawn[:, ALIKE]])

    laws = with_errors(law, errors)
    directions = (1, -1) if split or plant.two_quadrant else (1,)
    parts = [errors[start : start + TOGETHER] for start in range(0, len(errors), TOGETHER)]

    def error_and_radius(part: np.ndarray) -> np.ndarray:
        return _error_and_radius(axis, with_errors(law, part), directions)

    error, radius = np.hstack(list(in_threads(error_and_radius, parts, workers)))
    error[radius > 1.0 + MARGINAL] = np.nan
    task = fitted_task(axis, law, mismatch) if request.task is None else request.task
    measures = run_many(axis, [laws], task, workers, progress)
    if split or plant.two_quadrant:  # also release in the other direction; the worse one counts
        other = run_many(axis, [laws], task.reversed, workers, progress)
        worse = other.verdict > measures.verdict
        measures = replace(measures, raw=np.where(worse[:, None], other.raw, measures.raw))
    beyond = _verdicts_beyond(axis, with_errors(law, errors[: len(corners)]), task)
    return MismatchStudy(axis, law, mismatch, seed, task, len(corners), errors, error, radius, measures, beyond)


def run_worst(axis: Axis, study: MismatchStudy) -> TaskRun:
    """Return the run of the worst plant of a ``study`` of ``axis``, in the direction that decided its verdict.

    If only its poles are unstable, the instability may not be visible within the run.

    >>> from emps_design.machines import machine
    >>> from emps_design.control.impedance.law import impedance_law
    >>> axis = machine("emps2018")
    >>> run_worst(axis, mismatch_study(axis, impedance_law(axis, 50.0, 100.0), 0.02, plants=0)).verdict
    'creeping'
    """
    law = study.law.with_errors(study.plant(study.worst)["errors"])
    run = run_task(axis, law, study.task)
    if run.verdict == VERDICTS[study.measures.verdict[study.worst]]:
        return run
    other = run_task(axis, law, study.task.reversed)
    return max(run, other, key=lambda run: VERDICTS.index(run.verdict))


def _error_and_radius(axis: Axis, laws: ImpedanceLaw, directions: tuple[int, ...]) -> np.ndarray:
    """Error of the apparent impedance and largest pole modulus of ``laws``, (2, m), in the worse direction."""
    clock, plant = Clock.of(axis), FrictionModel.of(axis)
    rows = []
    for direction in directions:
        loops = sampled_loop(laws, plant, clock, direction)
        rows.append([impedance_error(loops, laws), loops.radius])
    return np.max(rows, axis=0)


def box_of(corners: list[dict[str, float]]) -> np.ndarray:
    """Corners of :func:`corner_errors` as rows (m, 5), in the order of ``PARAMETERS``."""
    rows = np.array([list(corner.values()) for corner in corners])
    return rows if rows.shape[1] == len(PARAMETERS) else rows[:, ALIKE]


def with_errors(law: ImpedanceLaw, errors: np.ndarray) -> ImpedanceLaw:
    """Return ``law`` as m laws, one per row of relative ``errors`` (m, 5), in the order of ``PARAMETERS``."""
    return law.with_errors(dict(zip(PARAMETERS, errors.T, strict=True)))


def _verdicts_beyond(axis: Axis, laws: ImpedanceLaw, task: Task) -> tuple[dict[str, str], ...]:
    """Worst verdict of ``laws`` on machines that differ from ``axis`` in one property that the law does not know."""
    drive, sampling = axis.drive, axis.sampling
    lag = drive.current_time_constant
    lagged = {"drive": {"current_time_constant": 2.0 * lag if lag > 0.0 else 0.5 * sampling.period}}
    changes: dict[str, dict[str, Any]] = {
        "current loop of twice the time constant" if lag > 0.0 else "current loop of half a period": lagged,
        "one more sample of delay": {"sampling": {"computation_delay": sampling.computation_delay + 1}},
        "encoder steps ten times as large": {"sampling": {"encoder_resolution": 10.0 * sampling.encoder_resolution}},
    }
    outcomes = []
    for what, change in changes.items():
        verdicts = run_many(axis, [laws], task, machine=axis.replace(**change)).verdict
        outcomes.append({"what": what, "verdict": VERDICTS[int(verdicts.max())]})
    return tuple(outcomes)


def _not_varied(units: Units) -> dict[str, str]:
    """The parameters that a study does not vary, with the reason."""
    return {
        "force_gain": f"scales {units.word('mass')} and friction equally, which are identified through it: the box "
        "of errors contains its error",
        "filter": "part of the law and known exactly",
        "current loop, computation_delay, encoder": "changed one at a time, see beyond",
        "static friction, other effects": "as in the axis file, in every plant; effects can be added there",
    }


def _one_quadrant(values: dict[str, float]) -> dict[str, float]:
    return {
        "mass": values["mass"],
        "viscous": values["viscous_positive"],
        "coulomb": values["coulomb_positive"],
    }


def _quantiles(values: np.ndarray) -> list[float]:
    finite = values[np.isfinite(values)]
    return [float(x) for x in np.quantile(finite, (0.05, 0.5, 0.95))] if len(finite) else [float("nan")] * 3
