"""Section III of the paper on the virtual bench: Tables I and II, the RMS ranges, Figs. 3, 5, 6, 8, 9 and 10.

Run: python examples/09_paper_section_3.py [figures.pdf]. The paper's records are not public; the bench is a machine
with its Table I, and numbers chosen so that tables and errors come out alike. It lists which are which;
`make paper` sweeps what makes Table II.
"""

import sys

import numpy as np

from emps_design.effects import Motion
from emps_design.identification import paper_chain
from emps_design.observer import model_force
from emps_design.paper import NUMBERS, PRINTED, bend_of, reproduce_section_3

found = reproduce_section_3(seed=0)

for origin in ("paper", "chosen"):
    names = [f"{name} {number.value:g} {number.unit}" for name, number in NUMBERS.items() if number.origin == origin]
    print(f"{origin}: {', '.join(name.strip() for name in names)}")

for title, table, printed in (
    ("Table I", found.table_1, PRINTED["table_1"]),
    ("Table II", found.table_2, PRINTED["table_2"]),
):
    print(f"\n{title:20}{'value':>10}{'2 sigma':>10}{'% sigma':>10}      printed")
    for name, row in table.items():
        print(f"{name:20}" + "".join(f"{value:10.3f}" for value in row), "   ", *printed[name])

print()
for label, values, printed in (
    ("RMS_1, identification", found.rms_1, PRINTED["rms_1"]),
    ("RMS_2, cross", found.rms_2, PRINTED["rms_2"]),
    ("direct validation", found.rms_direct, PRINTED["rms_direct"]),
):
    print(f"{label:24} {values.min():.2f} to {values.max():.2f} N    printed {printed[0]} to {printed[1]} N")
forth, back = found.bench.break_away
print(f"break-away F_s           {forth:.2f} N forth, {back:.2f} N back    printed {PRINTED['break_away']} N")

if len(sys.argv) > 1:
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt
    from matplotlib.backends.backend_pdf import PdfPages

    gain = found.bench.axis.drive.force_gain
    record = found.bench.identification[0]
    filtered = paper_chain(record, gain)
    first = found.identification.identifications[0]
    seen = found.observed(0)
    with PdfPages(sys.argv[1]) as pages:
        # Fig. 3: classical friction and Stribeck's, as the bench has them.
        v, still = np.linspace(-0.04, 0.04, 4001), np.zeros(4001)
        forth, back = (found.table_1[f"coulomb_{way}"][0] for way in ("positive", "negative"))
        steep, flat = (found.table_1[f"viscous_{way}"][0] for way in ("positive", "negative"))
        classical = np.where(v > 0, steep * v + forth, flat * v - back)
        steady = Motion(t=still, q=still, v=v, a=still, tau=still, period=record.period)
        figure, panel = plt.subplots(layout="constrained")
        panel.plot(v, classical, "r", label="classical, (3), as identified")
        machine = model_force(steady, found.bench.axis, rest_velocity=0.0) + bend_of(v)
        panel.plot(v, machine, "b", label="of the machine, with (4)")
        panel.set(xlabel="velocity [m/s]", ylabel="friction [N]", title="Fig. 3: friction over velocity")
        panel.legend()
        pages.savefig(figure)
        # Fig. 5: measured and filtered.
        figure, panels = plt.subplots(3, 1, sharex=True, layout="constrained")
        velocity = np.diff(record.q, prepend=record.q[0]) / record.period
        raw = (gain * record.u, velocity, np.gradient(velocity, record.period))
        smooth = (filtered.force, *map(filtered.reduce, (filtered.motion.v, filtered.motion.a)))
        units = ("motor force [N]", "velocity [m/s]", "acceleration [m/s²]")
        early, kept_early = record.t <= 5.0, filtered.t <= 5.0
        for panel, measured, kept, unit in zip(panels, raw, smooth, units, strict=True):
            panel.plot(record.t[early], measured[early], "b", lw=0.4, label="measured")
            panel.plot(filtered.t[kept_early], kept[kept_early], "r", lw=0.8, label="filtered")
            panel.set(ylabel=unit)
        panels[0].set_title("Fig. 5: measured and filtered")
        panels[0].legend()
        panels[2].set(xlabel="time [s]")
        pages.savefig(figure)
        # Figs. 6, 8, 9, 10, in the paper's colours; the first 15 s, for 40 s are a hedge.
        series = first.series
        for title, t, curves in (
            (
                "Fig. 6: motor force and model",
                series["t"],
                {r"$\tau_{m1}$": ("b", series["measured"]), r"$W_1 X_1$": ("r", series["model"])},
            ),
            (
                "Fig. 8: cross validation, parameters of the other ten",
                seen["t"],
                {"observed": ("b", seen["cross"]), "sensor": ("r", seen["sensor"])},
            ),
            (
                "Fig. 9: direct validation, its own parameters",
                seen["t"],
                {"observed": ("b", seen["direct"]), "sensor": ("r", seen["sensor"])},
            ),
            (
                "Fig. 10: most of the motor's force moves the machine",
                seen["t"],
                {
                    r"$\tau_m$": ("b", seen["motor"]),
                    r"$W X$": ("r", seen["model"]),
                    r"$\tau_e$": ("k", seen["sensor"]),
                },
            ),
        ):
            figure, panel = plt.subplots(layout="constrained")
            shown = t <= 15.0
            for label, (colour, curve) in curves.items():
                panel.plot(t[shown], curve[shown], colour, lw=0.8, label=label)
            panel.set(xlabel="time [s]", ylabel="force [N]", title=title)
            panel.legend(loc="upper right")
            pages.savefig(figure)
    plt.close("all")
