"""A proportional law on the position error alone, as a file of one's own: u = gain (q_ref - q)."""

import numpy as np

from emps_design.laws import LawKind, LawTable, Positive, parameter


def proportional(k, reference, q, f_ext, limit, gains, memory):
    """No damping of its own, and nothing to remember."""
    return gains[0] * (reference - q)


class Table(LawTable):
    gain: Positive = parameter("gain on the position error", "V/m")


LAW = LawKind(
    name="proportional",
    label="proportional law on the position error",
    source="this page",
    table=Table,
    kernel=proportional,
    gains=lambda p, axis, period: (p.gain,),
    memory=0,
    equations=lambda p, axis, period: (f"u[k] = {p.gain:.10g} * (q_ref[k] - q[k])",),
)

if __name__ == "__main__":
    from emps_design import load_axis
    from emps_design.laws import register
    from emps_design.simulation import Plant, trapezoid_laps

    register(LAW)
    theirs = load_axis("emps2019")
    own = theirs.replace(controller={"kind": "proportional", "gain": 2000.0})
    q_ref = trapezoid_laps(theirs.sampling.period, laps=1)
    for axis in (own, theirs):
        run = Plant.of(axis).closed_loop(q_ref)
        print(f"{axis.controller.kind:13} largest position error {1e3 * np.max(np.abs(run.q - q_ref)):.3f} mm")
