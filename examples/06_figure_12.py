"""Fig. 12: external force, velocity and position of sensor-less co-manipulation.

The paper takes M_a and B of its figure from an equivalence with the cascaded loop and prints neither. Simulated are the
50 kg and 100 N/(m/s) of its experiments, and equivalents of a 100 rad/s, 60 deg velocity loop at three gains k_e1. The
estimates are 2 % too low, exact, and 2 % too high. Run: python examples/06_figure_12.py [figure.png]
"""

import sys

from emps_design.comanipulation import pushed_task, run_task
from emps_design.control import equivalent_impedance, impedance_law
from emps_design.machines import machine

axis = machine("emps2018")
task = pushed_task(axis.sampling.period, force=40.0)
pairs = [("of the experiments", 50.0, 100.0)]
for k_e1 in (0.01, 0.001, 0.0003):
    loop = equivalent_impedance(axis, k_e1, 100.0, 60.0)
    pairs.append((f"equivalent to k_e1 = {k_e1:g} (m/s)/N", loop.mass, loop.damping))
runs = {}
for title, mass, damping in pairs:
    print(f"M_a = {mass:.2f} kg, B = {damping:.0f} N/(m/s), {title}")
    for error in (-0.02, 0.0, 0.02):
        law = impedance_law(axis, mass, damping).with_errors({"mass": error, "viscous": error, "coulomb": error})
        found = run_task(axis, law, task)
        if title == "of the experiments":
            runs[error] = found
        words = f"peak {found.measures.peak_u[0]:.2f} V"
        if found.verdict != "unstable":
            felt_mass, felt_damping, r2 = (float(values[0]) for values in found.measures.fit)
            words += f", felt {felt_mass:.1f} kg, {felt_damping:.1f} N/(m/s), R^2 {r2:.4f}, "
            words += f"at the end {1e3 * found.v[-1]:.2f} mm/s"
        print(f"  estimates {100 * error:+.0f} %: {found.verdict}; {words}")

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
