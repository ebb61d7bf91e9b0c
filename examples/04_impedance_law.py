"""The impedance law: derived, compared with the printed equations, sampled, and mapped.

Run: python examples/04_impedance_law.py [figure.png]
"""

import sys

import numpy as np

from emps_design.control import (
    Clock,
    FrictionModel,
    contact_map,
    equivalent_impedance,
    equivalent_loop,
    impedance_law,
    largest_wall,
    passivity,
    recursion_poles,
    sampled_loop,
    smallest_mass,
    stability_map,
)
from emps_design.machines import machine
from emps_design.paper import cost_of_printed, find_errata

axis = machine("emps2018")
plant, clock = FrictionModel.of(axis), Clock.of(axis)

# 1. The derivation, and where the paper prints something else.
for one in find_errata():
    print(f"{one.place} {one.title}: {one.text}")
for name, felt in cost_of_printed(plant, 50.0, 100.0).items():
    print(f"(30) {name:8}", ", ".join(f"{key} {value:.1f}" for key, value in felt.items()))

# 2. The law on the sampled drive: same filter on acceleration and current, or on the acceleration alone.
for label, options in (("both filtered", {}), ("current unfiltered", {"current_filter": np.inf})):
    for error in (-0.02, 0.0, 0.02):
        law = impedance_law(axis, 50.0, 100.0, 200.0, **options)
        law = law.with_errors({"mass": error, "viscous": error, "coulomb": error})
        loop = sampled_loop(law, plant, clock)
        print(
            f"200 rad/s, {label}, {100 * error:+.0f} %: largest pole {loop.radius:.4f}, recursion at rest "
            f"{abs(recursion_poles(law, clock)[0]):.4f}, {'stable' if loop.stable else 'UNSTABLE'}"
        )

# 3. The cascade that feels the same, and the impedance of the paper's own cascade.
same = equivalent_loop(axis, 50.0, 100.0)
print(f"50 kg, 100 N/(m/s): k_e1 = {same.k_e1:g}, k_v1 = {same.k_v1:.4g}, t_v = {same.t_v:.4g} ({same.criterion})")
own = equivalent_impedance(axis, 0.01, 100.0, 60.0)
print(f"100 rad/s, 60 deg, k_e1 = 0.01: M_a = {own.mass:.2f} kg; {own.warnings[0]}")

# 4. Contact.
law = impedance_law(axis, 50.0, 100.0)
found = passivity(law, plant, clock)
print(
    f"not passive from {found.sampled_bands[0][0]:.1f} rad/s on; wall up to {largest_wall(law, plant, clock):.3g} N/m"
)
print(f"smallest safe M_a at 2 %: {smallest_mass(law, plant, clock, 0.02):.1f} kg with a 500 rad/s filter")

if len(sys.argv) > 1:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    masses, filters = np.geomspace(1.0, 150.0, 90), np.geomspace(10.0, 3100.0, 70)
    stable = stability_map(law, plant, clock, masses, filters, (0.0, 0.02, 0.05))
    contact = contact_map(law, plant, clock)
    figure, (left, right) = plt.subplots(1, 2, figsize=(11, 4.2), layout="constrained")
    for mismatch, radius, colour in zip(stable.mismatches, stable.radius, ("C0", "C1", "C3"), strict=True):
        left.contour(stable.masses, stable.filters, radius > 1.0 + 1e-9, levels=[0.5], colors=colour)
        left.plot([], [], colour, label=f"limit at ±{100 * mismatch:g} %")
    left.plot(50.0, 500.0, "k*", label="50 kg, 500 rad/s")
    left.set(xscale="log", yscale="log", xlabel="apparent mass $M_a$ [kg]", ylabel="filter [rad/s]")
    left.set_title("Stable to the right of each line, B = 100 N/(m/s)")
    left.legend(loc="upper left")
    shown = right.pcolormesh(contact.stiffness[1:], contact.damping[1:], contact.stable[1:, 1:], cmap="RdYlBu")
    right.set(xscale="log", yscale="log", xlabel="wall or hand stiffness [N/m]", ylabel="its damping [N/(m/s)]")
    right.set_title("Coupled stability (blue: stable)")
    figure.savefig(sys.argv[1], dpi=120)
