"""The paper's point, side by side: without a force sensor the operator pushes harder."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

from emps_design.axis import Axis
from emps_design.comanipulation.run import TaskRun, run_task
from emps_design.comanipulation.task import guided_task
from emps_design.control.impedance.equivalence import equivalent_impedance
from emps_design.control.impedance.law import FrictionModel, ImpedanceLaw
from emps_design.control.impedance.robustness import break_away
from emps_design.laws.library import ip_velocity

NO_SENSOR, SENSOR, CASCADE = "impedance, no sensor", "impedance, force sensor", "cascade, force sensor"


@dataclass(frozen=True)
class SensorComparison:
    """The same hand on the same plant under three laws; ``runs[law][scale]``.

    ``scale`` 1 is a movement over +-120 mm, 0.1 a fine one over +-12 mm. ``break_away`` [N] is what sets a resting
    carriage in motion: nothing definite for the cascade, whose integral breaks it away in time.
    """

    runs: dict[str, dict[float, TaskRun]]
    break_away: dict[str, float | None]

    def to_dict(self) -> dict[str, Any]:
        """Per law the break-away force [N], and per movement effort, tracking error and what was felt."""
        found: dict[str, Any] = {}
        for name, by_scale in self.runs.items():
            moves = []
            for scale, one in by_scale.items():
                mass, damping, r2 = (float(values[0]) for values in one.measures.fit)
                moves.append(
                    {
                        "amplitude": 0.12 * scale,
                        "verdict": one.verdict,
                        "peak_voltage": float(one.measures.peak_u[0]),
                        "apparent_mass": mass,
                        "apparent_damping": damping,
                        "r2": r2,
                        **{key: float(values[0]) for key, values in one.measures.effort.items()},
                    }
                )
            found[name] = {"break_away": self.break_away[name], "movements": moves}
        return found


def compare_sensors(
    axis: Axis,
    law: ImpedanceLaw,
    crossover: float = 100.0,
    phase_margin_deg: float = 60.0,
    scales: tuple[float, ...] = (1.0, 0.1),
) -> SensorComparison:
    """Run ``law`` without and with a force sensor, and the cascade of section II-C with ``k_e1 = 1/B`` beside them.

    The cascade has crossover [rad/s] and phase margin [deg] of the paper's velocity loop; it is left out for B = 0.

    >>> from emps_design.machines import machine
    >>> from emps_design.control.impedance.law import impedance_law
    >>> axis = machine("emps2018")
    >>> found = compare_sensors(axis, impedance_law(axis, 50.0, 100.0), scales=(0.1,)).to_dict()
    >>> found[SENSOR]["movements"][0]["rms_force"] < found[NO_SENSOR]["movements"][0]["rms_force"]
    True
    """
    plant = FrictionModel.of(axis)
    laws: dict[str, Any] = {
        NO_SENSOR: replace(law, force_sensor=False),
        SENSOR: replace(law, force_sensor=True),
    }
    forces: dict[str, float | None] = {name: break_away(one, plant) for name, one in laws.items()}
    if law.damping > 0.0:
        loop = equivalent_impedance(axis, 1.0 / law.damping, crossover, phase_margin_deg)
        if loop.k_v1 is not None and loop.t_v is not None:
            laws[CASCADE] = ip_velocity.Table(
                k_e1=loop.k_e1, k_v1=loop.k_v1, t_v=loop.t_v, velocity_estimator=law.velocity_estimator
            )
            forces[CASCADE] = None
    tasks = {scale: guided_task(axis.sampling.period, scale=scale) for scale in scales}
    runs = {name: {scale: run_task(axis, one, task) for scale, task in tasks.items()} for name, one in laws.items()}
    return SensorComparison(runs, forces)
