"""What an engineer asks once the gains are there: the code to paste, the room below the voltage limit, the noise."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from emps_design.axis import Axis
from emps_design.control.plant.actuator import ActuatorMap
from emps_design.control.velocity.sampled import SampledVelocityLoop, velocity_table
from emps_design.control.velocity.structure import IP, Structure
from emps_design.laws import LawKind
from emps_design.laws.estimators import estimator_response, polynomials
from emps_design.laws.library.cascade import Filter, filter_polynomials

CONSTANT = 1e-9  # a pole nearer than this to the unit circle belongs to something that stays as it is


@dataclass(frozen=True)
class DifferenceEquation:
    """The velocity law as it is computed at each sample: its ``kind`` and ``table`` on ``axis``, ready to paste."""

    axis: Axis
    kind: LawKind
    table: Any
    k_v1: float
    t_v: float

    @property
    def lines(self) -> tuple[str, ...]:
        """One assignment a line; where the limit cuts u, the integral does not wind up."""
        return self.kind.equations(self.table, self.axis, self.axis.sampling.period)

    def to_dict(self) -> dict[str, Any]:
        """The lines and the numbers in them; integral_gain is k_v1 T / t_v [V/(m/s)]."""
        period = self.axis.sampling.period
        return {
            "lines": list(self.lines),
            "k_v1": self.k_v1,
            "integral_gain": self.k_v1 * period / self.t_v,
            "period": period,
            "velocity_estimator": self.table.model_dump(exclude_none=True)["velocity_estimator"],
            "voltage_limit": self.axis.drive.command_limit,
        }


def difference_equation(
    axis: Axis, k_v1: float, t_v: float, structure: Structure = IP, filters: tuple[Filter, ...] = ()
) -> DifferenceEquation:
    """Return the law of the loop with ``k_v1`` [V/(m/s)] and ``t_v`` [s] at the period of ``axis``.

    >>> from emps_design.machines import machine
    >>> print(difference_equation(machine("emps2018"), 556.766, 8.45505e-3).lines[1])
    i[k] = i[k-1] + 65.85011325 * (v_ref[k] - v[k])
    """
    kind, table = velocity_table(k_v1, t_v, structure, filters, axis.controller.velocity_estimator)
    return DifferenceEquation(axis, kind, table, k_v1, t_v)


def largest_velocity_step(axis: Axis, loop: SampledVelocityLoop) -> dict[str, float]:
    """Return the largest step of the velocity reference [m/s] from rest that keeps the voltage within its limit.

    The voltage's peak is that of the sampled linear loop [V per m/s] plus what dry friction and the constant force
    take, in the worse direction [V]; behind an actuator that saturates or has a dead zone the limit is what still acts.
    ``window`` [s] is how long the loop is watched, until its motion has died away: a spring goes on asking for more
    as the carriage travels. ``loop`` has to be stable.

    >>> from emps_design.control.plant.discretisation import sample_axis
    >>> from emps_design.machines import machine
    >>> axis = machine("emps2018")
    >>> step = largest_velocity_step(axis, SampledVelocityLoop(sample_axis(axis), 556.766, 8.45505e-3))
    >>> round(step["value"], 4), round(step["dry_friction_voltage"], 3)
    (0.0319, 0.494)
    """
    sizes = np.abs(loop.poles)
    dying = sizes[sizes < 1.0 - CONSTANT]  # a pole on z = 1 (a spring's, a load's in its play) does not die away
    slowest = float(np.max(dying, initial=1e-3))
    samples = 10 + math.ceil(math.log(1e-4) / math.log(slowest))
    _, _, voltage = loop.step_response(samples)
    peak = float(np.max(np.abs(voltage)))
    dry = (axis.mechanics.coulomb + abs(axis.mechanics.offset)) / axis.drive.gain
    actuator = ActuatorMap.of(axis)
    largest = min(abs(actuator.command(actuator.acting(side * axis.drive.command_limit))) for side in (1.0, -1.0))
    needed = max(abs(actuator.command(side * dry)) for side in (1.0, -1.0))
    return {
        "value": max(0.0, largest - needed) / peak,
        "peak_voltage_per_unit": peak,
        "dry_friction_voltage": dry,
        "voltage_limit": largest,
        "window": samples * loop.plant.period,
    }


def command_in_a_step(axis: Axis, loop: SampledVelocityLoop, velocity: float) -> float:
    """Largest command [V] in a step of the reference by ``velocity`` [m/s], with what dry friction takes.

    It is sought in the first two periods of the crossover. ``loop`` has to be stable.
    """
    samples = max(20, round(4.0 * math.pi / ((loop.margins.crossover or 1.0) * loop.plant.period)))
    dry = (axis.mechanics.coulomb + abs(axis.mechanics.offset)) / axis.drive.gain
    return dry + velocity * float(np.max(np.abs(loop.step_response(samples)[2])))


def encoder_voltage_noise(axis: Axis, loop: SampledVelocityLoop) -> dict[str, float]:
    """Return the voltage [V] that the encoder's quantisation makes: rms in closed loop, and for one step of it.

    Quantisation is taken as white noise of variance resolution^2/12, which holds in motion; ``one_step`` is the jump of
    u when the reading moves by one step. ``loop`` has to be stable.

    >>> from emps_design.control.plant.discretisation import sample_axis
    >>> from emps_design.machines import machine
    >>> axis = machine("emps2018")
    >>> noise = encoder_voltage_noise(axis, SampledVelocityLoop(sample_axis(axis), 556.766, 8.45505e-3))
    >>> round(1e3 * noise["rms"], 2), round(1e3 * noise["one_step"], 2)  # mV
    (6.44, 15.57)
    """
    plant, resolution = loop.plant, axis.sampling.encoder_resolution
    count = 1 << 14
    w = (np.arange(count) + 0.5) * math.pi / (count * plant.period)
    back = np.exp(-1j * w * plant.period)
    estimate = estimator_response(plant.estimator, w, plant.period) * (1.0 - back) / plant.period
    law = loop.controller_response(w) * plant.filter_response(w)
    noise = law * estimate / (1.0 + loop.plant_input_response(w))
    rms = resolution / math.sqrt(12.0) * math.sqrt(float(np.mean(np.abs(noise) ** 2)))
    first = math.prod(filter_polynomials(one, plant.period)[0][0] for one in plant.filters)  # what passes at once
    newest = polynomials(plant.estimator, plant.period)[0][0]
    one_step = first * loop.k_v1 * (1.0 + plant.period / loop.t_v) * newest / plant.period * resolution
    return {"rms": rms, "one_step": one_step, "resolution": resolution}
