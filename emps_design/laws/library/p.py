"""Proportional law of a position servo: ``u = kp (r - q)``, then the limit.

Source: the firmware of small servos; the gain may come from the record, ``kp = { record = "kp", scale = 1.0 }``.
"""

from emps_design.laws.law import FromRecord, Gain, LawKind, LawTable
from emps_design.tables import parameter


def p(k, reference, q, f_ext, limit, gains, memory):
    """Gains: kp. No memory."""
    return min(max(gains[0] * (reference - q), -limit), limit)


class Table(LawTable):
    kp: Gain = parameter("position gain", "V/m")


def gains(p, axis, period):
    return (p.kp,)


def equations(p, axis, period):
    limit = f"{axis.drive.command_limit:.10g}"
    kp = f"{p.kp.scale:.10g} * {p.kp.record}[k]" if isinstance(p.kp, FromRecord) else f"{p.kp:.10g}"
    return (
        f"u[k] = {kp} * (q_ref[k] - q[k])",
        f"if u[k] >  {limit}: u[k] =  {limit}",
        f"if u[k] < -{limit}: u[k] = -{limit}",
    )


LAW = LawKind(
    name="p",
    label="proportional position law",
    source="firmware of small servos",
    table=Table,
    kernel=p,
    gains=gains,
    memory=0,
    equations=equations,
    gain="kp",
)
