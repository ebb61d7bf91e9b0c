"""Estimators that simulate the record in closed loop: instrumental variables and output error.

Instruments (IDIM-IV): in a closed loop the force noise moves the carriage, so it enters the columns of W and least
squares is biased. The instruments are the same columns from a simulation driven by the reference alone: they are
correlated with the motion, not with the noise (A. Janot, P.-O. Vandanjon, M. Gautier, 2014).

Output error: the parameters with which a simulation from ``q_ref`` reproduces the measured force. No measured signal is
differentiated, and the simulation includes the hold. The controller computes the voltage from reference and position,
so a position error shows in the force too and counts once. Slow forces on a resting carriage are no force error of a
moving one, so rests are left out as in the ``hold`` chain, unless too little else remains. The search is Gauss-Newton
with a line search.

The same closed-loop simulation gives the error by the encoder's steps. At constant speed the steps are too fast for
the filters to pass; while the axis starts and stops they are not. They disturb the motion just where it determines the
mass, which statistics of a stationary residual cannot show.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy

from emps_design.axis import Axis, Mechanics
from emps_design.errors import AxisError, EmpsError, InputError, RankError, RecordError, SimulationError
from emps_design.identification.assemble import Errors, Solution, assemble, cutoff_sensitivity, implausible
from emps_design.identification.chains import chosen_cutoff, first_part, hold_chain
from emps_design.identification.excitation import REFUSE, check_record
from emps_design.identification.filters import low_pass
from emps_design.identification.inverse_model import LeastSquares, Regression, least_squares, notes, regression, settled
from emps_design.identification.model import Model, identified_effects, known_part
from emps_design.identification.result import Identification
from emps_design.identification.statistics import long_run
from emps_design.laws import NONE
from emps_design.messages import Message, warning
from emps_design.observer import motor_force, with_acting_command
from emps_design.records import Record
from emps_design.simulation import Plant, Run
from emps_design.simulation.run import ClosedLoopRun, driven_by

ITERATIONS = 8
WEAK_INSTRUMENT = 0.1  # share of a column explained by its instrument, below which the instrument is useless
SETTLED = 0.02  # of a standard deviation: an iteration that changes less is the last

PHASES = 8  # positions of the encoder's steps against the motion that are simulated
STRIDE = 3  # phases, from one run to the next, by which the position at first within a step changes

SEARCH_STEPS = 12
STEP = 1e-3  # of a parameter, for the derivatives
CONVERGED = 1e-6  # relative fall of the criterion


def _checked(record: Record, axis: Axis, model: str | Model, external_force: str, needs: str) -> tuple[Record, Axis]:
    """The record that identifies ``axis``, and the axis with its supply and without what ``model`` identifies."""
    if axis.controller.kind == NONE:
        raise AxisError(f"{axis.name}: {needs} the controller of the record; add [controller] to the axis file")
    axis = axis.supplied_by(record)
    return check_record(record, axis, external_force), known_part(axis, model)


def simulate(record: Record, axis: Axis, model: Model, value: np.ndarray, quantise: bool = False) -> Run:
    """Closed-loop run of ``record`` from its reference and measured external force with the solution ``value`` (p,).

    The encoder is exact, or that of ``axis`` with ``quantise``. Raises :class:`RecordError` where mass or friction in
    ``value`` is not positive, and where the simulation with the controller of ``axis`` fails.
    """
    p = model.natural(value)
    mechanics = Mechanics.table(model.baseline(p))
    start = {**mechanics, "viscous": p.get("viscous", mechanics["viscous"])}
    for name in ("mass", "viscous", "coulomb"):
        if not start[name] > 0:
            why: list[str] = [*implausible(p, axis)] or [
                "the record does not determine it: record several constant speeds in both directions, with "
                "acceleration between them"
            ]
            raise RecordError(
                f"{record.name}: {axis.units.word(name)} was identified as {start[name]:.4g}, which cannot be "
                f"simulated; {why[0]}"
            )
    effects = [*identified_effects(model, p), *known_part(axis, model).effects]
    machine = axis.replace(mechanics=mechanics, effects=effects, sampling={"period": record.period})
    try:
        return Plant.of(machine).closed_loop(ClosedLoopRun(**driven_by(machine, record), quantise=quantise))
    except SimulationError as error:
        raise RecordError(
            f"{record.name}: the simulation with the controller of {axis.name} at {1 / record.period:g} Hz fails "
            f"({error}), so the record was made with another one; put its controller into the axis file, or use "
            "`identify`"
        ) from error


def error_of_steps(
    record: Record, axis: Axis, model: Model, value: np.ndarray, estimate: Callable[[Record, Record], np.ndarray]
) -> np.ndarray | None:
    """Rms change (p,) of ``estimate`` by the steps of the encoder, over several of their phases.

    ``estimate`` gives the parameters (p,) of a simulated record, and takes also the same record by an exact encoder;
    the simulation has the parameters ``value`` (p,). None without a resolution or a controller in ``axis``, without a
    recorded reference, and where the simulation fails.
    """
    resolution = axis.sampling.encoder_resolution
    if not resolution or axis.controller.kind == NONE or not record.has_reference:
        return None
    try:
        exact = _as_record(record, axis, model, value)
        right, errors = estimate(exact, exact), []
        for phase in range(PHASES):
            moved, stood = (resolution * (i % PHASES) / PHASES for i in (phase, STRIDE * phase))
            rounded = _as_record(record, axis, model, value, moved, stood - 0.5 * resolution)
            errors.append(estimate(rounded, exact) - right)
        return np.sqrt(np.mean(np.square(errors), axis=0))
    except (EmpsError, np.linalg.LinAlgError):
        return None


def _as_record(
    record: Record, axis: Axis, model: Model, value: np.ndarray, moved: float = 0.0, stood: float | None = None
) -> Record:
    """``record`` simulated with the solution ``value`` (p,); the encoder is exact where ``stood`` is None.

    ``moved`` [m] shifts the whole motion against the encoder's steps; ``stood`` [m] is the initial distance of the axis
    from the encoder's reading.
    """
    start = replace(record, q_ref=record.q_ref + moved, q=record.q + moved + (stood or 0.0))
    run = simulate(start, axis, model, value, quantise=stood is not None)
    return replace(record, q=run.q - moved, u=run.u)


@dataclass(frozen=True)
class HausmanTest:
    """Durbin-Wu-Hausman test: does the part of W that the instruments miss explain the residual?

    ``statistic`` is chi-squared with ``degrees`` of freedom where least squares is unbiased; its covariance allows for
    a correlated residual. ``shift`` is the largest difference between the two estimates, in standard deviations: a
    significant bias may still be too small to matter.
    """

    statistic: float
    degrees: int
    p_value: float
    shift: float

    @property
    def biased(self) -> bool:
        """Whether least squares is biased, at 1 %."""
        return self.p_value < 0.01

    @property
    def matters(self) -> bool:
        """Whether the bias is significant and at least half a standard deviation of a parameter."""
        return self.biased and self.shift >= 0.5

    def to_dict(self) -> dict[str, Any]:
        """Plain data."""
        return {
            "statistic": self.statistic,
            "degrees": self.degrees,
            "p_value": self.p_value,
            "least_squares_biased": self.biased,
            "shift_in_std": self.shift,
            "bias_matters": self.matters,
        }


@dataclass(frozen=True)
class InstrumentalFit:
    """The ``solution`` by instruments from the record ``simulated`` from the reference; ``start``: least squares.

    The test costs little; deviations and intervals are computed by :meth:`identification` only.
    """

    solution: Solution
    start: LeastSquares
    simulated: Record
    test: HausmanTest

    def identification(self) -> Identification:
        """The fit with its statistics, and its sensitivity to the encoder's steps and to the cut-off."""
        problem = self.solution.problem
        record, axis, model = problem.record, problem.axis, problem.model

        def of_steps(rounded: Record, exact: Record) -> np.ndarray:
            again = problem.alike(rounded)
            return _solved(_columns(exact, again), again).fit.value

        def at(frequency: float) -> Solution:
            other = Regression.of(record, axis, model, cutoff=frequency)
            return _solved(_columns(self.simulated, other), other)

        errors = Errors(
            encoder=error_of_steps(first_part(record), axis, model, self.solution.fit.value, of_steps),
            cutoff=cutoff_sensitivity(self.solution, at),
        )
        extra = {
            "least_squares": model.natural(self.start.value),
            "hausman_test": self.test.to_dict(),
        }
        return assemble(self.solution, "instrumental_variables", errors, notes(axis), extra, WEAK_INSTRUMENT)


def identify_with_instruments(
    record: Record,
    axis: Axis,
    model: str | Model = "symmetric",
    cutoff: float | None = None,
    external_force: str = REFUSE,
) -> Identification:
    """Identify ``axis`` from ``record`` by IDIM-IV on the ``hold`` chain, with the Durbin-Wu-Hausman test.

    The axis needs its controller (the simulation follows ``q_ref``); :class:`AxisError` otherwise. The least-squares
    values stand in ``extra`` beside the test.

    >>> from emps_design.machines import machine
    >>> from emps_design.simulation.synthetic import synthetic_record
    >>> axis = machine("emps2019")
    >>> identification = identify_with_instruments(synthetic_record(axis, laps=1), axis)
    >>> round(identification.parameters["mass"].value, 0), identification.extra["hausman_test"]["bias_matters"]
    (95.0, False)
    """
    return solve_with_instruments(record, axis, model, cutoff, external_force).identification()


def solve_with_instruments(
    record: Record, axis: Axis, model: str | Model, cutoff: float | None, external_force: str
) -> InstrumentalFit:
    """Iterate simulation and instruments until they converge; arguments as in :func:`identify_with_instruments`."""
    record, axis = _checked(record, axis, model, external_force, "instruments need")
    problem = Regression.of(record, axis, model, cutoff=cutoff)
    start = Solution.of(problem)
    std, first, value = start.spread.std, start.fit, start.fit.value
    for _ in range(ITERATIONS):
        run = simulate(record, axis, problem.model, value)
        simulated = replace(record, q=run.position, u=run.u)
        solution = _solved(_columns(simulated, problem), problem)
        change = np.max(np.abs(solution.fit.value - value) / std)
        value = solution.fit.value
        if change < SETTLED:
            break
    test = hausman_test(solution, float(np.max(np.abs(value - first.value) / std)))
    return InstrumentalFit(solution, first, simulated, test)


def _columns(simulated: Record, problem: Regression) -> np.ndarray:
    """Columns (n, p) of a record ``simulated`` from the reference, filtered as in ``problem``."""
    Z, _ = regression(hold_chain(simulated, problem.axis.drive.gain, problem.filtered.cutoff_hz), problem.model)
    return Z * problem.used[:, None]


def hausman_test(solution: Solution, shift: float) -> HausmanTest:
    """Durbin-Wu-Hausman test by the augmented regression: W and the part of it that the instruments miss.

    ``shift`` is the largest difference between the two estimates, in standard deviations.
    """
    problem = solution.problem
    # Only rows as far apart as the band resolves: those between them are no independent evidence.
    steps = problem.filtered.resolved_steps
    W, Y, Z, used = (array[::steps] for array in (problem.W, problem.Y, solution.instruments, problem.used))
    basis = np.linalg.qr(Z)[0]
    missed = W - basis @ (basis.T @ W)
    kept = np.linalg.norm(missed, axis=0) > 1e-3 * np.linalg.norm(W, axis=0)
    # Columns of the missed part may repeat each other; keep independent ones.
    missed = missed[:, kept]
    while missed.shape[1] > 1:
        scaled = missed / np.linalg.norm(missed, axis=0)
        singular, right = np.linalg.svd(scaled, full_matrices=False)[1:]
        if singular[-1] > 1e-3 * singular[0]:
            break
        missed = np.delete(missed, int(np.argmax(np.abs(right[-1]))), axis=1)
    if missed.shape[1] == 0:
        return HausmanTest(0.0, 0, 1.0, shift)
    both = np.column_stack([W, missed])
    names = tuple(f"column {i}" for i in range(both.shape[1]))
    fit = least_squares(both, Y, names, used)
    spread = long_run(both, fit.residual, used, problem.filtered.period * steps)
    extra = slice(W.shape[1], None)
    statistic = float(fit.value[extra] @ np.linalg.solve(spread.covariance[extra, extra], fit.value[extra]))
    return HausmanTest(statistic, missed.shape[1], float(scipy.stats.chi2.sf(statistic, missed.shape[1])), shift)


def _solved(Z: np.ndarray, problem: Regression) -> Solution:
    """(Z^T W)^-1 Z^T Y in the shape of a least-squares fit, with the deviations for independent errors."""
    W, Y = problem.W, problem.Y
    bread = np.linalg.inv(Z.T @ W)
    value = bread @ (Z.T @ Y)
    condition, rows = float(np.linalg.cond(Z.T @ W) ** 0.5), int(problem.used.sum())
    spread = bread @ (Z.T @ Z) @ bread.T
    return Solution(problem, LeastSquares.of(problem.names, value, spread, Y - W @ value, Y, rows, condition), Z)


def identify_by_output_error(
    record: Record,
    axis: Axis,
    model: str | Model = "symmetric",
    cutoff: float | None = None,
    external_force: str = REFUSE,
) -> Identification:
    """Identify ``axis`` from ``record`` by closed-loop output error on the motor force.

    Starts at the least-squares estimate of the ``hold`` chain or, where that leaves too few rows, at the mechanics of
    ``axis``; ``cutoff`` [Hz] low-passes the residual. ``extra`` holds the rms errors in position [m] and force [N].
    Raises :class:`AxisError` without a controller, :class:`InputError` where the search does not converge.

    >>> from emps_design.machines import machine
    >>> from emps_design.simulation.synthetic import synthetic_record
    >>> axis = machine("emps2019")
    >>> identification = identify_by_output_error(synthetic_record(axis, laps=1), axis)
    >>> loop = identification.extra["closed_loop"]
    >>> round(identification.parameters["viscous"].value, -1), loop["position_rms_error"] < 1e-6
    (200.0, True)
    """
    model = Model.of(model)
    record, axis = _checked(record, axis, model, external_force, "output error needs")
    if cutoff is None:
        cutoff = chosen_cutoff(with_acting_command(axis, record)[0])
    problem, start, remarks = _problem(record, axis, model, cutoff)
    model = problem.model
    measured = motor_force(axis, record)

    def force_error(parameters: np.ndarray) -> np.ndarray:
        return measured - simulate(record, axis, model, parameters).force

    def filtered_error(parameters: np.ndarray) -> np.ndarray:
        return _rows(force_error(parameters), problem)

    value, residual, jacobian = _minimise(filtered_error, start, model, record.name)
    solution = _linear(problem, jacobian, residual, value)
    problem, fit = solution.problem, solution.fit
    off = low_pass(record.q - simulate(record, axis, model, value).position, cutoff, record.period)
    edge = int(1.0 / (cutoff * record.period))  # samples at each end in which the filter extrapolates
    extra = {
        "closed_loop": {
            "position_rms_error": float(np.sqrt(np.mean(off[edge : len(record) - edge] ** 2))),
            "force_rms_error": fit.rms_error,
            "force_relative_error_percent": fit.relative_error_percent,
        }
    }

    def of_steps(rounded: Record, exact: Record) -> np.ndarray:
        off = _rows(motor_force(axis, rounded) - motor_force(axis, exact), problem)
        return least_squares(jacobian, off, problem.names, problem.used, axis.units).value

    error = force_error(value)
    slopes = _jacobian(force_error, value, error, model).T

    def at(frequency: float) -> Solution:
        """One Gauss-Newton step from the estimate; error and derivatives filtered at ``frequency`` [Hz]."""
        other, _, _ = _problem(record, axis, model, frequency)
        columns, target = np.column_stack([_rows(slope, other) for slope in slopes]), _rows(error, other)
        step = least_squares(columns, target, other.names, other.used, axis.units)
        return _linear(other, columns, step.residual, value + step.value)

    errors = Errors(
        encoder=error_of_steps(record, axis, model, value, of_steps),
        cutoff=cutoff_sensitivity(solution, at),
    )
    identification = assemble(solution, "output_error", errors, remarks, extra, weakest=0.0)
    return replace(
        identification, series={**identification.series, "measured": problem.Y, "model": problem.Y - residual}
    )


def _problem(record: Record, axis: Axis, model: Model, cutoff: float) -> tuple[Regression, np.ndarray, list[Message]]:
    """The regression at this ``cutoff`` [Hz], the start (p,) of the search, and messages.

    The start is the least-squares solution. Where too little of the record is away from rest, rests take part and the
    mechanics of ``axis`` are the start.
    """
    remarks = notes(axis, simulated=True)
    try:
        problem = Regression.of(record, axis, model, cutoff=cutoff)
        return problem, problem.solved().value, remarks
    except (RecordError, RankError):
        filtered = hold_chain(record, axis.drive.gain, cutoff, fewest_rows=0)
        filtered = replace(filtered, used=np.ones_like(filtered.used))
        model = settled(filtered, model)
        W, Y = regression(filtered, model)
        force, carriage = axis.units.word("force"), axis.units.word("carriage")
        text = (
            f"too little of the record is in motion, so rests are included: a slow {force} that acts on the {carriage} "
            "at rest biases its friction"
        )
        remarks.append(warning("rests-take-part", text))
        return Regression(record, axis, model, filtered, W, Y), _mechanics(axis, model), remarks


def _linear(problem: Regression, jacobian: np.ndarray, residual: np.ndarray, value: np.ndarray) -> Solution:
    """The ``problem`` with the derivatives (n, p) as its columns, and its solution ``value`` (p,)."""
    spread, condition = np.linalg.inv(jacobian.T @ jacobian), float(np.linalg.cond(jacobian))
    force, rows = problem.filtered.force * problem.used, int(problem.used.sum())
    fit = LeastSquares.of(problem.names, value, spread, residual, force, rows, condition)
    return Solution(replace(problem, W=jacobian, Y=force), fit)


def _rows(force: np.ndarray, problem: Regression) -> np.ndarray:
    """A ``force`` [N] of the record's rate, filtered to the rows of the ``problem``."""
    smooth = low_pass(force, problem.filtered.band_hz, problem.record.period)
    return problem.filtered.reduce(smooth) * problem.used


def _mechanics(axis: Axis, model: Model) -> np.ndarray:
    """Solution (p,) of ``model`` by the mechanics of the axis file; terms beside it from the model's point, or 0."""
    own = axis.mechanics.parameters
    own |= {f"viscous_{way}": own["viscous"] for way in ("positive", "negative")}
    own |= {
        "coulomb_positive": own["coulomb"] + own["constant_force"],
        "coulomb_negative": own["coulomb"] - own["constant_force"],
    }
    return model.solution({name: model.point.get(name, own.get(name, 0.0)) for name in model.names})


def _minimise(
    error: Callable[[np.ndarray], np.ndarray], value: np.ndarray, model: Model, name: str
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Possible parameters (p,) with the least sum of squares, their error (n,) and its derivatives (n, p)."""
    residual = error(value)
    best = float(residual @ residual)
    jacobian = _jacobian(error, value, residual, model)
    for _ in range(SEARCH_STEPS):
        step = np.linalg.lstsq(jacobian, residual, rcond=None)[0]
        for share in (1.0, 0.5, 0.25, 0.1):
            trial = value + share * step
            if not model.possible(trial):
                continue
            attempt = error(trial)
            criterion = float(attempt @ attempt)
            if criterion < best:
                break
        else:
            return value, residual, jacobian
        fall, value, residual, best = (best - criterion) / best, trial, attempt, criterion
        jacobian = _jacobian(error, value, residual, model)
        if fall < CONVERGED:
            return value, residual, jacobian
    raise InputError(f"{name}: output error did not converge in {SEARCH_STEPS} steps; use a lower `cutoff`")


def _jacobian(
    error: Callable[[np.ndarray], np.ndarray], value: np.ndarray, residual: np.ndarray, model: Model
) -> np.ndarray:
    """Derivatives of the simulated force with respect to each parameter, shape (n, p)."""
    columns = []
    sizes = np.where(model.curved, 1.0, np.maximum(np.abs(value), STEP))  # angle and exponent are differences, maybe 0
    for i, size in enumerate(sizes.tolist()):
        moved = value.copy()
        moved[i] += STEP * size
        columns.append((residual - error(moved)) / (moved[i] - value[i]))
    return np.stack(columns, axis=-1)
