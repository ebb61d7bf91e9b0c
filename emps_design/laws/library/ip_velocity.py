"""Velocity law of Fig. 4: integral of the velocity error, proportional on the measured velocity.

``u = I - k_v1 v``, ``I += (k_v1 T / t_v) (v_ref + k_e1 f_ext - v)``; where the voltage limit cuts ``u``, ``I`` is set
back to the value that just reaches the limit. With ``k_e1`` the measured force sets the velocity, (10) and (11).
Source: section II-C of the paper, (6) to (9).
"""

from emps_design.laws.estimators import TWO_TAP, coefficients, states, taps
from emps_design.laws.law import LawKind, LawTable, velocity_in_words
from emps_design.tables import Positive, parameter

COEFFICIENTS, STATES = 5, 3  # places of a velocity estimator that filters, in gains and memory


def ip_velocity(k, reference, q, f_ext, limit, gains, memory):
    """Gains: k_v1, k_v1 T / t_v, k_e1, 1/T, :func:`~.taps`, :func:`~.coefficients`.

    Memory: q[k-1], q[k-2], I, states of the latter.
    """
    if k == 0:
        memory[0] = q
        memory[1] = q
        memory[2] = 0.0
    if gains[4] > 0.0:
        v = 0.5 * (q - memory[1]) * gains[3]
    elif gains[4] < 0.0:
        order = int(-gains[4])
        step = (q - memory[0]) * gains[3]
        v = gains[COEFFICIENTS] * step + memory[STATES]
        for i in range(order):
            at = COEFFICIENTS + 1 + i
            memory[STATES + i] = gains[at] * step - gains[at + order] * v + memory[STATES + i + 1]
    else:
        v = (q - memory[0]) * gains[3]
    memory[1] = memory[0]
    memory[0] = q
    memory[2] += gains[1] * (reference + gains[2] * f_ext - v)
    u = memory[2] - gains[0] * v
    if u > limit:
        memory[2] = limit + gains[0] * v
        u = limit
    elif u < -limit:
        memory[2] = -limit + gains[0] * v
        u = -limit
    return u


class Table(LawTable):
    k_v1: Positive = parameter("velocity-loop gain", "V/(m/s)")
    t_v: Positive = parameter("integral time of the velocity loop", "s")
    k_e1: Positive | None = parameter("force-loop gain", "(m/s)/N", None)


def gains_of(k_v1, t_v, k_e1, period, velocity_estimator=TWO_TAP):
    """Gains of the kernel; numbers or arrays (m,) for as many laws."""
    constants = taps(velocity_estimator), *coefficients(velocity_estimator, period)
    return k_v1, k_v1 * period / t_v, k_e1, 1.0 / period, *constants


def gains(p, axis, period):
    return gains_of(p.k_v1, p.t_v, p.k_e1 or 0.0, period, p.velocity_estimator)


def equations(p, axis, period):
    gain, limit = f"{p.k_v1:.10g}", f"{axis.drive.command_limit:.10g}"
    force = f" + {p.k_e1:.10g} * f_ext[k]" if p.k_e1 else ""
    return (
        velocity_in_words(p, period),
        f"i[k] = i[k-1] + {gains(p, axis, period)[1]:.10g} * (v_ref[k]{force} - v[k])",
        f"u[k] = i[k] - {gain} * v[k]",
        f"if u[k] >  {limit}: u[k] =  {limit}; i[k] =  {limit} + {gain} * v[k]",
        f"if u[k] < -{limit}: u[k] = -{limit}; i[k] = -{limit} + {gain} * v[k]",
    )


LAW: LawKind[object] = LawKind(
    name="ip_velocity",
    label="velocity law, integral on the error, proportional on the velocity",
    source="paper, section II-C, (6) to (9)",
    table=Table,
    kernel=ip_velocity,
    gains=gains,
    memory=lambda p, axis: STATES + states(taps(p.velocity_estimator)),
    equations=equations,
    follows="velocity",
    gain="k_v1",
    integral=2,
)
