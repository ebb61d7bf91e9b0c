"""The co-manipulation scenario: an operator guides the carriage under the impedance law, then lets it go."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from emps_design.axis import Axis
from emps_design.comanipulation.assessment import ImpedanceAssessment
from emps_design.comanipulation.study import MismatchStudy, mismatch_study
from emps_design.comanipulation.task import Task, guided_task, pushed_task
from emps_design.control.impedance.law import PARAMETERS, ImpedanceLaw, impedance_law, left_out
from emps_design.control.impedance.robustness import VERDICTS

MASS, DAMPING = 50.0, 100.0  # M_a [kg] and B [N/(m/s)] of the paper's experiments, section IV-B


@dataclass(frozen=True)
class Comanipulation:
    """Result of :func:`run_comanipulation`: the worst plant's verdict, and the transparency of the exact law.

    ``nominal`` has no mismatch, ``extended`` the corners with the axis's effects (None where it has none).
    """

    assessment: ImpedanceAssessment
    nominal: MismatchStudy
    study: MismatchStudy
    extended: MismatchStudy | None
    warnings: tuple[str, ...]

    @property
    def law(self) -> ImpedanceLaw:
        """The law that was simulated."""
        return self.assessment.law

    def to_dict(self) -> dict[str, Any]:
        """Keys of the contract, and under ``study`` all of the mismatch study.

        ``verdict`` is that of the worst plant tried, ``nominal_verdict`` that without mismatch; ``transparency`` is
        the law's without mismatch: apparent mass [kg] and damping [N/(m/s)] from force regressed on acceleration and
        velocity in motion, r2 about zero, and error, the rms relative error of the impedance over 0-20 rad/s. On an
        axis with effects nominal plant and corners are simulated with them; the Monte-Carlo is without. A law with
        unstable poles adds reason and nearest.
        """
        exact = self.nominal.plant(0)
        nominal_words = [word for word in self.nominal.warnings if not word.startswith("stable_share")]
        judged = self.study if self.extended is None else self.extended
        refused = self.assessment
        return {
            **({} if refused.stable else {"reason": refused.reason, "nearest": refused.nearest}),
            "scenario": "comanipulation",
            "axis": refused.axis.name,
            "verdict": VERDICTS[judged.verdict.max()],
            "nominal_verdict": exact["verdict"],
            "transparency": {name: exact[name] for name in ("apparent_mass", "apparent_damping", "r2", "error")},
            "peak_voltage": exact["peak_voltage"],
            "effort": exact["effort"],
            "seed": self.study.seed,
            "plants": self.study.plants,
            "mismatch": self.study.mismatch,
            "task": self.study.task,
            "law": self.law.to_dict(),
            "study": self.study.to_dict(),
            **({} if self.extended is None else {"corners_with_effects": self.extended.to_dict()["corners"]}),
            "warnings": [*self.warnings, *dict.fromkeys((*nominal_words, *self.study.warnings))],
        }


def run_comanipulation(
    axis: Axis,
    mismatch: float = 0.02,
    seed: int = 0,
    plants: int = 200,
    mass: float | None = None,
    damping: float | None = None,
    filter: float | None = None,
    force: float | None = None,
    duration: float = 10.0,
    two_quadrant: bool | None = None,
    workers: int = 1,
    progress: Callable[[str, float], None] | None = None,
    **options: Any,
) -> Comanipulation:
    """Simulate the co-manipulation task on ``axis`` with estimates off by up to ``mismatch``.

    M_a [kg] and B [N/(m/s)] come from the arguments, else from the axis's impedance controller, else they are the 50 kg
    and 100 N/(m/s) of the paper's experiments. A compliant hand guides the carriage; ``force`` [N] pushes it to and fro
    instead. ``options`` go to :class:`ImpedanceLaw` (force_sensor, coulomb_factor, ...).

    >>> from emps_design.machines import machine
    >>> found = run_comanipulation(machine("emps2018"), mismatch=0.02, plants=0).to_dict()
    >>> found["verdict"], round(found["transparency"]["apparent_mass"])
    ('creeping', 50)
    """
    controller = axis.controller
    mass = mass if mass is not None else controller.mass or MASS
    damping = damping if damping is not None else DAMPING if controller.damping is None else controller.damping
    law = impedance_law(axis, mass, damping, filter, **options)
    period = axis.sampling.period
    others = left_out(axis)
    if others and force is None:
        force = max(40.0, 2.5 * axis.mechanics.coulomb)  # the general simulator has no hand that lets go
    task: Task = guided_task(period, duration) if force is None else pushed_task(period, duration, force)
    nominal = mismatch_study(axis, law, 0.0, 0, seed, False, task)
    study = mismatch_study(axis, law, mismatch, plants, seed, two_quadrant, task, workers, progress)
    extended = None
    if others:
        nominal = _with_effects(axis, nominal, task)
        extended = _with_effects(axis, mismatch_study(axis, law, mismatch, 0, seed, two_quadrant, task), task)
    warnings = tuple(
        f"effect {kind} is in the simulated nominal plant and corners, not in the Monte-Carlo" for kind in others
    )
    return Comanipulation(ImpedanceAssessment(axis, law, mismatch, study), nominal, study, extended, warnings)


def _with_effects(axis: Axis, study: MismatchStudy, task: Task) -> MismatchStudy:
    """The corners of ``study`` simulated again on the axis with all its effects."""
    from emps_design.comanipulation.with_effects import diverged, run_extended

    rows = []
    for errors in study.errors[: study.corners]:
        found = run_extended(axis, study.law.with_errors(dict(zip(PARAMETERS, errors, strict=True))), task)
        rows.append((diverged(axis) if found is None else found.measures).raw[0])
    measures = replace(study.measures, raw=np.array(rows), cascade=np.zeros(len(rows), dtype=bool))
    return replace(study, measures=measures)
