"""Position law of the 2019 data set: ``u = kp kv (q_ref - q) - kv v``, v from the encoder.

Source: the data set's own description (data/emps/README.md); the voltage is limited by the drive.
"""

import numpy as np

from emps_design.laws.estimators import coefficients, states, taps
from emps_design.laws.law import LawKind, LawTable, velocity_in_words
from emps_design.tables import Positive, parameter

COEFFICIENTS, STATES = 4, 2  # places of a velocity estimator that filters, in gains and memory


def position_pd(k, reference, q, f_ext, limit, gains, memory):
    """Gains: kp kv, kv, 1/T, :func:`~.taps`, :func:`~.coefficients`. Memory: q[k-1], q[k-2], states of the latter."""
    if k == 0:
        memory[0] = q
        memory[1] = q
    if gains[3] > 0.0:
        v = 0.5 * (q - memory[1]) * gains[2]
    elif gains[3] < 0.0:
        order = int(-gains[3])
        step = (q - memory[0]) * gains[2]
        v = gains[COEFFICIENTS] * step + memory[STATES]
        for i in range(order):
            at = COEFFICIENTS + 1 + i
            memory[STATES + i] = gains[at] * step - gains[at + order] * v + memory[STATES + i + 1]
    else:
        v = (q - memory[0]) * gains[2]
    memory[1] = memory[0]
    memory[0] = q
    return gains[0] * (reference - q) - gains[1] * v


class Table(LawTable):
    kp: Positive = parameter("position gain", "1/s")
    kv: Positive = parameter("velocity gain", "V/(m/s)")


def gains(p, axis, period):
    estimator = p.velocity_estimator
    return p.kp * p.kv, p.kv, 1.0 / period, taps(estimator), *coefficients(estimator, period)


def equations(p, axis, period):
    limit = f"{axis.drive.command_limit:.10g}"
    return (
        velocity_in_words(p, period),
        f"u[k] = {p.kp * p.kv:.10g} * (q_ref[k] - q[k]) - {p.kv:.10g} * v[k]",
        f"if u[k] >  {limit}: u[k] =  {limit}",
        f"if u[k] < -{limit}: u[k] = -{limit}",
    )


def propose(reference, q, u, p, period):
    """Least squares: the voltage is linear in kp kv and kv."""
    fitted = np.isfinite(u)
    memory = [0.0] * (STATES + states(taps(p.velocity_estimator)))
    unit = gains(Table(kp=1.0, kv=1.0, velocity_estimator=p.velocity_estimator), None, period)
    braking = [position_pd(k, at, at, 0.0, np.inf, unit, memory) for k, at in enumerate(q)]
    columns = np.column_stack([reference - q, braking])[fitted]
    position, velocity = np.linalg.lstsq(columns, u[fitted], rcond=None)[0].tolist()
    return {"kp": position / velocity, "kv": velocity} if position > 0.0 and velocity > 0.0 else None


LAW = LawKind(
    name="position_pd",
    label="position law with velocity feedback",
    source="data set of 2019",
    table=Table,
    kernel=position_pd,
    gains=gains,
    memory=lambda p, axis: STATES + states(taps(p.velocity_estimator)),
    equations=equations,
    state_feedback=True,
    gain="kv",
    propose=propose,
)
