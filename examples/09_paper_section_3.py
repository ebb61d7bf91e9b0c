"""Section III of the paper on the virtual bench: Tables I and II, the RMS ranges, Figs. 3, 5, 6, 8, 9 and 10.

Run: python examples/09_paper_section_3.py [figures.pdf]. The paper's records are not public; the bench is a machine
with its Table I, and numbers chosen so that the errors come out alike. It lists which are which.
"""

import sys

import numpy as np

from emps_design.identification.chains import paper_chain
from emps_design.identification.section_3 import PRINTED, section_3
from emps_design.identification.virtual_bench import NUMBERS

found = section_3(seed=0)

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
        v = np.linspace(-0.02, 0.02, 2001)
        m, excess = found.bench.axis.mechanics, NUMBERS["break_away_excess"].value
        classical = m.viscous * v + m.coulomb * np.sign(v) + m.offset
        figure, panel = plt.subplots(layout="constrained")
        panel.plot(v, classical, "r", label="classical, (3)")
        decay = np.exp(-np.abs(v / NUMBERS["stribeck_velocity"].value))
        panel.plot(v, classical + excess * decay * np.sign(v), "b", label="Stribeck, (4)")
        panel.set(xlabel="velocity [m/s]", ylabel="friction [N]", title="Fig. 3: friction over velocity")
        panel.legend()
        pages.savefig(figure)
        # Fig. 5: measured and filtered.
        figure, panels = plt.subplots(3, 1, sharex=True, layout="constrained")
        velocity = np.diff(record.q, prepend=record.q[0]) / record.period
        raw = (gain * record.u, velocity, np.gradient(velocity, record.period))
        smooth = (filtered.force, *map(filtered.reduce, (filtered.motion.v, filtered.motion.a)))
        units = ("motor force [N]", "velocity [m/s]", "acceleration [m/s²]")
        for panel, measured, kept, unit in zip(panels, raw, smooth, units, strict=True):
            panel.plot(record.t, measured, "b", lw=0.4, label="measured")
            panel.plot(filtered.t, kept, "r", lw=0.8, label="filtered")
            panel.set(ylabel=unit)
        panels[0].set_title("Fig. 5: measured and filtered")
        panels[0].legend()
        panels[2].set(xlabel="time [s]")
        pages.savefig(figure)
        # Figs. 6, 8, 9, 10.
        series = first.series
        for title, t, curves in (
            ("Fig. 6: motor force and model", series["t"], {"tau_m": series["measured"], "W X": series["model"]}),
            ("Fig. 8: cross validation", seen["t"], {"sensor": seen["sensor"], "observed, mean of ten": seen["cross"]}),
            ("Fig. 9: direct validation", seen["t"], {"sensor": seen["sensor"], "observed": seen["direct"]}),
            (
                "Fig. 10: most of the motor's force moves the machine",
                seen["t"],
                {"tau_m": seen["motor"], "W X": seen["model"], "tau_e": seen["sensor"]},
            ),
        ):
            figure, panel = plt.subplots(layout="constrained")
            for label, curve in curves.items():
                panel.plot(t, curve, lw=0.8, label=label)
            panel.set(xlabel="time [s]", ylabel="force [N]", title=title)
            panel.legend()
            pages.savefig(figure)
    plt.close("all")
