"""How much force gain an operator, a wall and a late sensor allow.

Run it: python examples/02_force_loop.py [figure.svg]
"""

import sys

import numpy as np

from emps_design.control import design_force_loop, design_velocity_loop
from emps_design.machines import machine

loop = design_velocity_loop(machine("emps2018"), crossover=100.0, phase_margin_deg=60.0)


def words(limit):
    return "no limit" if limit is None else f"{limit:.5f}"


# The operator's force answers the motion: tau_e = -k_h qd (hand), tau_e = -K_env q (wall); k_e1 in (m/s)/N.
print("operator                        continuous  sampled")
for name, operator in (
    ("hand, 100 N/(m/s)", {"hand": 100.0}),
    ("wall, 10 N/mm", {"environment": 1e4}),
    ("wall, 100 N/mm", {"environment": 1e5}),
    ("wall, 100 N/mm, on sensor only", {"environment": 1e5, "on_carriage": False}),
    ("wall, 100 N/mm, 2 samples late", {"environment": 1e5, "sensor_delay": 2}),
):
    design = design_force_loop(loop, k_e1=1e-3, **operator)
    print(f"{name:<30}  {words(design.k_e1_max_continuous):>10}  {words(design.k_e1_max_sampled):>8}")

# One choice: what the operator feels, and how far instability is.
design = design_force_loop(loop, k_e1=0.01, environment=1e4)
print(
    f"k_e1 = {design.k_e1} (m/s)/N against 10 N/mm: stable {design.stable}, gain margin "
    f"{design.margins.gain_margin:.2f}, felt {design.k_c:.0f} N/(m/s) and {design.apparent_mass:.2f} kg"
)
print(f"the paper's own reading has the poles {[re for re, _ in design.paper_reading['poles']]} rad/s")

if len(sys.argv) > 1:
    import matplotlib.pyplot as plt

    stiffness = np.geomspace(1e3, 1e6, 40)
    figure, axes = plt.subplots(figsize=(7, 5), layout="constrained")
    for late in (0, 1, 3):
        limits = [design_force_loop(loop, 1e-3, environment=K, sensor_delay=late).k_e1_max_sampled for K in stiffness]
        axes.loglog(stiffness, limits, label=f"sampled, sensor {late} ms late")
    closed = [design_force_loop(loop, 1e-3, environment=K).k_e1_max_continuous for K in stiffness]
    axes.loglog(stiffness, closed, "k--", label="continuous, closed form")
    axes.set(xlabel="stiffness of the wall [N/m]", ylabel="largest k_e1 [(m/s)/N]", title="Stable below the line")
    axes.grid(True, which="both", alpha=0.3)
    axes.legend()
    figure.savefig(sys.argv[1])
    print(f"figure: {sys.argv[1]}")
