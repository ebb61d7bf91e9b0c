"""Fig. 12: external force, velocity and position of sensor-less co-manipulation, with 50 kg and 100 N/(m/s).

The paper plots its figure with M_a and B from an equivalence whose value (0.87 kg) lies inside the error of M; the
50 kg and 100 N/(m/s) here are those of its experiments. Estimates are 2 % off. Run: python examples/06_figure_12.py
[figure.png]
"""

import sys

from emps_design.comanipulation import pushed_task, run_task
from emps_design.control import impedance_law
from emps_design.machines import machine

axis = machine("emps2018")
task = pushed_task(axis.sampling.period, force=40.0)
runs = {}
for error in (-0.02, 0.0, 0.02):
    law = impedance_law(axis, 50.0, 100.0).with_errors({"mass": error, "viscous": error, "coulomb": error})
    runs[error] = found = run_task(axis, law, task)
    mass, damping, r2 = (float(values[0]) for values in found.measures.fit)
    print(
        f"estimates {100 * error:+.0f} %: {found.verdict:9}  felt {mass:.1f} kg, {damping:.1f} N/(m/s), R^2 {r2:.4f}; "
        f"peak {found.measures.peak_u[0]:.2f} V, at the end {1e3 * found.v[-1]:.2f} mm/s"
    )

if len(sys.argv) > 1:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, (force, velocity, position) = plt.subplots(3, 1, figsize=(8, 7), sharex=True, layout="constrained")
    force.plot(task.time, runs[0.0].tau_e, "k")
    for error, found in runs.items():
        velocity.plot(found.t, found.v, label=f"estimates {100 * error:+.0f} %: {found.verdict.replace('_', ' ')}")
        position.plot(found.t, found.q)
    velocity.plot(task.time, runs[0.0].tau_e / 100.0, "k:", lw=1, label=r"$\tau_e / B$")
    force.set(ylabel=r"external force $\tau_e$ [N]", title="Co-manipulation without force sensor, 50 kg, 100 N/(m/s)")
    velocity.set(ylabel=r"velocity $\dot q$ [m/s]")
    position.set(ylabel="position $q$ [m]", xlabel="time [s]")
    velocity.legend()
    figure.savefig(sys.argv[1], dpi=120)
