"""The mismatch study of section IV-B: estimates off by 2 %, corners and Monte-Carlo, with and without force sensor.

Run: python examples/05_mismatch_study.py [figure.png]
"""

import sys

from emps_design.comanipulation import compare_sensors, mismatch_study
from emps_design.control import VERDICTS, FrictionModel, coulomb_factor_without_creep, impedance_law
from emps_design.machines import machine

axis = machine("emps2018")
plant = FrictionModel.of(axis)
law = impedance_law(axis, 50.0, 100.0)

# 1. Every corner and 1000 plants, as asked and with a Coulomb factor that rules creep out.
factor = coulomb_factor_without_creep(law, plant, 0.02)
study = mismatch_study(axis, law, 0.02, plants=1000, seed=0)
careful = mismatch_study(axis, impedance_law(axis, 50.0, 100.0, coulomb_factor=factor), 0.02, plants=1000, seed=0)
for label, found in (("c = 1", study), (f"c = {factor:.4f}", careful)):
    summary = found.to_dict()
    low, high = summary["stable_share_interval"]
    print(f"{label}: {summary['verdicts']}, stable {100 * summary['stable_share']:.1f} % ({low:.4f} to {high:.4f})")
    worst = summary["worst"]
    errors = ", ".join(f"{name} {100 * value:+.2f} %" for name, value in worst["errors"].items())
    print(f"  worst: {worst['verdict']} at {errors}, drift {1e3 * worst['drift_speed']:.2f} mm/s")

# 2. With and without force sensor: the same hand, a wide and a fine movement.
for name, found in compare_sensors(axis, law).to_dict().items():
    first = "" if found["break_away"] is None else f", break-away from rest {found['break_away']:.1f} N"
    print(f"{name}{first}")
    for move in found["movements"]:
        print(
            f"  ±{1e3 * move['amplitude']:.0f} mm: rms force {move['rms_force']:.2f} N, tracking error "
            f"{1e3 * move['tracking_error']:.2f} mm"
        )

if len(sys.argv) > 1:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(11, 4.2), layout="constrained")
    mass, damping, _ = study.measures.fit
    for place, name in enumerate(VERDICTS):
        here = study.verdict == place
        if here.any():
            axes[0].plot(mass[here], damping[here], ".", label=name.replace("_", " "))
            axes[1].plot(100 * study.errors[here, 3], 1e3 * study.measures.drift[here], ".", label=name)
    axes[0].set(xlabel="apparent mass [kg]", ylabel="apparent damping [N/(m/s)]", title="Felt under ±2 % mismatch")
    axes[1].set(xlabel="error of Coulomb friction [%]", ylabel="speed that free motion tends to [mm/s]")
    axes[1].set_title("Above zero it creeps, below zero it stops")
    axes[0].legend()
    figure.savefig(sys.argv[1], dpi=120)
