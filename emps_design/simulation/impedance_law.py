"""The impedance law as a controller of any simulated axis, with whatever effects the axis carries.

The drive's current is not wired to the controller: the law takes it from the current loop's own model,
``tau_{k+1} = e tau_k + (1 - e) c_k`` with ``e = exp(-T/T_c)``, which is exact as long as the drive does what it is
told. What the axis follows is q_0, of use only with a stiffness.
"""

from __future__ import annotations

import math

import numpy as np

from emps_design.axis import Axis
from emps_design.control.impedance import law as impedance
from emps_design.control.impedance.law import ImpedanceLaw
from emps_design.errors import AxisError
from emps_design.simulation.laws import Law


def impedance_voltage(k, reference, q, f_ext, limit, gains, memory):
    """Voltage of the law at sample k; gains and memory as laid out in :func:`law_for`."""
    if k == 0:
        memory[0] = memory[1] = memory[2] = q
        memory[3] = memory[4] = memory[5] = 0.0
    if gains[17] > 0.0:
        v = 0.5 * (q - memory[1]) * gains[16]
        a = 0.5 * (q - memory[0] - memory[1] + memory[2]) * gains[16] * gains[16]
    else:
        v = (q - memory[0]) * gains[16]
        a = (q - 2.0 * memory[0] + memory[1]) * gains[16] * gains[16]
    memory[2] = memory[1]
    memory[1] = memory[0]
    memory[0] = q
    viscous = 0.0
    coulomb = 0.0
    if v > 0.0:
        viscous = gains[3]
        coulomb = gains[5]
    elif v < 0.0:
        viscous = gains[4]
        coulomb = -gains[6]
    if gains[15] > 0.0:
        observed = f_ext
    else:
        memory[3] = gains[10] * memory[3] + (1.0 - gains[10]) * a
        memory[4] = gains[11] * memory[4] + (1.0 - gains[11]) * memory[5]
        observed = gains[1] * memory[3] + viscous * v + coulomb - gains[12] * memory[4]
    ratio = gains[0]
    command = (ratio - 1.0) * observed + (viscous - ratio * gains[2]) * v + coulomb - ratio * gains[7] * (q - reference)
    u = min(max(command / gains[13], -limit), limit)
    # The model of the current loop runs on what reaches it: this voltage, or that of some samples ago.
    arriving = u
    delay = int(gains[9])
    if delay > 0:
        arriving = memory[6 + delay - 1]
        for i in range(delay - 1, 0, -1):
            memory[6 + i] = memory[6 + i - 1]
        memory[6] = u
    memory[5] = gains[14] * memory[5] + (1.0 - gains[14]) * gains[13] * arriving
    return u


def impedance_law(axis: Axis, period: float) -> Law:
    """The law that an axis with ``controller.kind = "impedance"`` asks for, at a sampling ``period`` [s]."""
    controller = axis.controller
    if controller.mass is None or controller.damping is None:
        raise AxisError("controller: found no mass and damping, expected kind 'impedance' with both")
    return law_for(axis, impedance.impedance_law(axis, controller.mass, controller.damping), period)


def law_for(axis: Axis, law: ImpedanceLaw, period: float) -> Law:
    """``law`` as a controller of ``axis`` at a sampling ``period`` [s], for ``Plant.closed_loop(law=...)``.

    >>> from emps_design.machines import machine
    >>> from emps_design.simulation.plant import Plant
    >>> axis = machine("emps2018")
    >>> law = law_for(axis, impedance.impedance_law(axis, 50.0, 100.0), 1e-3)
    >>> run = Plant.of(axis).closed_loop(np.zeros(500), disturbance=np.full(500, 40.0), law=law)
    >>> 0.2 < float(run.v[-1]) < 0.3
    True
    """
    law.check_period(period)
    lag, delay = axis.drive.current_time_constant, axis.sampling.computation_delay
    e, (slow_a, slow_tau) = law.estimate, law.filters
    gains = [
        law.ratio,
        e.mass,
        law.damping,
        *e.viscous,
        law.coulomb_factor * e.coulomb_positive,
        law.coulomb_factor * e.coulomb_negative,
        law.stiffness,
        law.rest_position,
        delay,
        math.exp(-slow_a * period),
        math.exp(-slow_tau * period),
        law.current_factor,
        axis.drive.force_gain,
        math.exp(-period / lag) if lag > 0.0 else 0.0,
        law.force_sensor,
        1.0 / period,
        law.velocity_estimator == "two_tap",
    ]
    # Memory: three encoder readings, filtered acceleration and force, modelled force, voltages on their way.
    return Law(impedance_voltage, np.array(gains, dtype=float), 6 + delay)
