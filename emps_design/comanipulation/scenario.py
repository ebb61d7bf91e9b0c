"""The co-manipulation scenario: an operator guides the carriage under the impedance law, then releases it.

:func:`compare_sensors` shows the result of the paper: without a force sensor the operator needs a larger force.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from emps_design.axis import Axis
from emps_design.comanipulation.assessment import ImpedanceAssessment
from emps_design.comanipulation.run import TaskRun, run_task
from emps_design.comanipulation.study import PLANTS, SEED, TWO_QUADRANT, WORKERS, MismatchStudy, mismatch_study
from emps_design.comanipulation.task import Task, fitted_task, guided_task, pushed_task, usual_scale
from emps_design.control.impedance.law import FrictionModel, ImpedanceLaw, equivalent_impedance, impedance_law
from emps_design.control.impedance.robustness import break_away
from emps_design.control.sampled import worst_loop
from emps_design.laws.library import ip_velocity
from emps_design.messages import Message, note, warning
from emps_design.quantities import one_two_five
from emps_design.request import Request, option, takes
from emps_design.simulation.scenarios import scenario_view
from emps_design.units import Units
from emps_design.view import View, Viewed

MASS, DAMPING = 50.0, 100.0  # M_a [kg] and B [N/(m/s)] of the paper's experiments, section IV-B
OF_MASS = 115.7315  # kg, mass of the carriage in these experiments
GOOD_FIT = 0.95  # least r2 of the force fitted by mass and damping without a warning

NO_SENSOR, SENSOR, CASCADE = "impedance, no sensor", "impedance, force sensor", "cascade, force sensor"


@dataclass(frozen=True)
class Comanipulation(Viewed):
    """Result of :func:`run_comanipulation`: the worst plant's verdict, and the transparency of the exact law.

    ``nominal`` has no mismatch. Every plant is simulated with all effects of the axis. ``assumed`` are messages on the
    parameters of the law that are defaults.
    """

    assessment: ImpedanceAssessment
    nominal: MismatchStudy
    study: MismatchStudy
    assumed: tuple[Message, ...] = ()

    @property
    def law(self) -> ImpedanceLaw:
        """The simulated law."""
        return self.assessment.law

    def to_dict(self) -> dict[str, Any]:
        """Keys of the contract, and under ``study`` all of the mismatch study.

        ``verdict`` is that of the worst plant, ``nominal_verdict`` that without mismatch. ``transparency`` is that of
        the law without mismatch: apparent mass [kg] and damping [N/(m/s)] from force over velocity at the frequencies
        of the task (:mod:`.task`), r2 about zero, and error, the rms relative error of the impedance over 0-20 rad/s. A
        law that is unstable or in a limit cycle has reason and nearest too. ``asked`` holds M_a and B of the law.
        """
        exact = self.nominal.plant(0)
        nominal = [message for message in self.nominal.warnings if message.code != "no-plants"]
        assessment = self.assessment
        messages = [*self.assumed, *_poor_fit(exact, assessment.axis.units)]
        unit = assessment.axis.units.unit
        return {
            **({} if assessment.stable else {"reason": assessment.reason, "nearest": assessment.nearest}),
            "scenario": "comanipulation",
            "axis": assessment.axis.name,
            "verdict": assessment.verdict,
            "headline": assessment.headline,
            "nominal_verdict": exact["verdict"],
            "worst_loop": worst_loop(assessment.loops).to_dict(),
            "asked": {"apparent_mass": self.law.mass, "apparent_damping": self.law.damping},
            "transparency": {name: exact[name] for name in ("apparent_mass", "apparent_damping", "r2", "error")},
            "peak_voltage": exact["peak_voltage"],
            "effort": exact["effort"],
            "units": {"apparent_mass": unit("kg"), "apparent_damping": unit("N/(m/s)"), "peak_voltage": unit("V")},
            "seed": self.study.seed,
            "plants": self.study.plants,
            "mismatch": self.study.mismatch,
            "task": self.study.task.name,
            "law": self.law.to_dict(),
            "study": self.study.to_dict(),
            "warnings": [*messages, *dict.fromkeys((*nominal, *self.study.warnings))],
        }

    def view(self) -> View:
        """The verdict, and the apparent impedance at the operator's hand."""
        return scenario_view(self.to_dict(), self.assessment.axis.units)


@dataclass(frozen=True)
class ComanipulationRequest(Request):
    """Options of :func:`run_comanipulation` in addition to the axis."""

    mismatch: float = option(0.02, "largest relative error of an estimate")
    seed: int = option(0, **SEED)
    plants: int = option(200, **PLANTS)
    mass: float | None = option(None, "M_a [kg], None: of the axis's impedance controller, else of usual_law")
    damping: float | None = option(None, "B [N/(m/s)], None: of the axis's impedance controller, else of usual_law")
    filter: float | None = option(None, "low-pass of acceleration and current [rad/s], see impedance_law")
    force: float | None = option(None, "force of alternating pushes [N], None: a compliant hand guides the carriage")
    duration: float | None = option(None, "duration of the task [s], None: by the slowest mode, see fitted_task")
    two_quadrant: bool | None = option(None, **TWO_QUADRANT)
    workers: int = option(1, **WORKERS)


@takes(ComanipulationRequest)
def run_comanipulation(axis: Axis, request: ComanipulationRequest, **options: Any) -> Comanipulation:
    """Simulate the co-manipulation task on ``axis`` with errors of the estimates up to ``mismatch``.

    A message names the parameters that are taken from :func:`usual_law`. ``options`` go to :class:`ImpedanceLaw`
    (force_sensor, coulomb_factor, ...).

    >>> from emps_design.machines import machine
    >>> document = run_comanipulation(machine("emps2018"), mismatch=0.02, plants=0).to_dict()
    >>> document["verdict"], round(document["transparency"]["apparent_mass"])
    ('creeping', 50)
    """
    mismatch, seed = request.mismatch, request.seed
    controller, (usual_mass, usual_damping) = axis.controller, usual_law(axis)
    defaults = []
    mass = controller.mass if request.mass is None else request.mass
    if mass is None:
        mass = usual_mass
        defaults.append(f"M_a = {axis.units.quantity(mass, 'kg', 'g')}")
    damping = controller.damping if request.damping is None else request.damping
    if damping is None:
        damping = usual_damping
        defaults.append(f"B = {axis.units.quantity(damping, 'N/(m/s)', 'g')}")
    law = impedance_law(axis, mass, damping, request.filter, **options)
    task = _task(axis, law, request)
    nominal = mismatch_study(axis, law, 0.0, 0, seed, False, task)
    study = mismatch_study(
        axis,
        law,
        mismatch,
        request.plants,
        seed,
        request.two_quadrant,
        task,
        request.workers,
        progress=request.progress,
    )
    source = f"default of the paper's experiments, in proportion to the {axis.units.word('mass')}"
    text = f"{' and '.join(defaults)}: {source}"
    assumed = (note("usual-law", text, mass=mass, damping=damping),) if defaults else ()
    return Comanipulation(ImpedanceAssessment(axis, law, mismatch, study), nominal, study, assumed)


def _task(axis: Axis, law: ImpedanceLaw, request: ComanipulationRequest) -> Task:
    """The task of the request."""
    period, force, duration = axis.sampling.period, request.force, request.duration
    if duration is None:
        return fitted_task(axis, law, request.mismatch, force)
    if force is None:
        return guided_task(period, duration, scale=usual_scale(axis))
    return pushed_task(period, duration, force)


def usual_law(axis: Axis) -> tuple[float, float]:
    """Return default M_a [kg] and B [N/(m/s)]: those of the paper's experiments, scaled with the mass of ``axis``.

    >>> from emps_design.machines import machine
    >>> usual_law(machine("emps2018")), usual_law(machine("emps2018").replace(mechanics={"mass": 0.3}))
    ((50.0, 100.0), (0.1, 0.2))
    """
    size = one_two_five(axis.mechanics.mass / OF_MASS)
    return float(f"{MASS * size:.12g}"), float(f"{DAMPING * size:.12g}")


def _poor_fit(exact: dict[str, Any], units: Units) -> list[Message]:
    """Return a message if mass and damping are a poor fit to the guided motion under the exact law."""
    if not exact["r2"] < GOOD_FIT:
        return []
    text = (
        f"apparent {units.word('mass')} and damping are a poor fit to the {units.word('force')} of this motion, "
        f"r2 = {exact['r2']:.3g} at the frequencies of the task: another {units.word('force')} acts there; the error "
        "of the transparency is computed from the impedance itself and does not depend on this fit"
    )
    return [warning("poor-fit", text, r2=exact["r2"])]


@dataclass(frozen=True)
class SensorComparison:
    """The same hand on the same plant under three laws; ``runs[law][scale]``.

    ``scale`` 1 is a motion over +-120 mm, 0.1 a fine motion over +-12 mm. ``break_away`` [N] is the force that starts
    motion from rest; None for the cascade, whose integral breaks away at any force.
    """

    runs: dict[str, dict[float, TaskRun]]
    break_away: dict[str, float | None]

    def to_dict(self) -> dict[str, Any]:
        """Per law the break-away force [N], and per motion the effort, tracking error and apparent impedance."""
        document: dict[str, Any] = {}
        for name, by_scale in self.runs.items():
            moves = []
            for scale, run in by_scale.items():
                mass, damping, r2 = (float(values[0]) for values in run.measures.fit)
                moves.append(
                    {
                        "amplitude": 0.12 * scale,
                        "verdict": run.verdict,
                        "peak_voltage": float(run.measures.peak_u[0]),
                        "apparent_mass": mass,
                        "apparent_damping": damping,
                        "r2": r2,
                        **{key: float(values[0]) for key, values in run.measures.effort.items()},
                    }
                )
            document[name] = {"break_away": self.break_away[name], "movements": moves}
        return document


def compare_sensors(
    axis: Axis,
    law: ImpedanceLaw,
    crossover: float = 100.0,
    phase_margin_deg: float = 60.0,
    scales: tuple[float, ...] = (1.0, 0.1),
) -> SensorComparison:
    """Run ``law`` without and with a force sensor, and for comparison the cascade of section II-C with ``k_e1 = 1/B``.

    By default the velocity loop of the cascade has the paper's crossover [rad/s] and phase margin [deg]. For B = 0
    there is no cascade.

    >>> from emps_design.machines import machine
    >>> from emps_design.control.impedance.law import impedance_law
    >>> axis = machine("emps2018")
    >>> document = compare_sensors(axis, impedance_law(axis, 50.0, 100.0), scales=(0.1,)).to_dict()
    >>> document[SENSOR]["movements"][0]["rms_force"] < document[NO_SENSOR]["movements"][0]["rms_force"]
    True
    """
    plant = FrictionModel.of(axis)
    laws: dict[str, Any] = {
        NO_SENSOR: replace(law, force_sensor=False),
        SENSOR: replace(law, force_sensor=True),
    }
    forces: dict[str, float | None] = {name: break_away(variant, plant) for name, variant in laws.items()}
    if law.damping > 0.0:
        loop = equivalent_impedance(axis, 1.0 / law.damping, crossover, phase_margin_deg)
        if loop.k_v1 is not None and loop.t_v is not None:
            laws[CASCADE] = ip_velocity.Table(
                k_e1=loop.k_e1, k_v1=loop.k_v1, t_v=loop.t_v, velocity_estimator=law.velocity_estimator
            )
            forces[CASCADE] = None
    tasks = {scale: guided_task(axis.sampling.period, scale=scale) for scale in scales}
    runs = {
        name: {scale: run_task(axis, variant, task) for scale, task in tasks.items()} for name, variant in laws.items()
    }
    return SensorComparison(runs, forces)
