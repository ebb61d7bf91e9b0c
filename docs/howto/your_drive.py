"""What stands in for the trace window of a drive on the page "Bring your own drive": two exports and an axis file.

``python your_drive.py`` simulates a ball-screw axis and writes ``trace.csv`` and ``second_trace.csv`` as a drive of a
German maker does; ``python your_drive.py fill AXIS`` writes the numbers of its data sheets into an axis file.
"""

import sys
from pathlib import Path

from emps_design import Axis, Record, synthetic_record

SCREW = Axis.from_dict(
    {
        "name": "screw",
        "mechanics": {"mass": 48.0, "viscous": 260.0, "coulomb": 35.0},
        "drive": {"command": "torque", "command_unit": "%", "force_gain": 15.1, "command_limit": 150.0},
        "sampling": {"period": 0.5e-3, "encoder_resolution": 1e-7},
        "controller": {
            "kind": "cascade",
            "position": {"kp": 40.0, "every": 2},
            "velocity": {"kp": 420.0, "ti": 0.02},
            "feedforward": {"velocity": 1.0, "acceleration": 2.5},
        },
    }
)
# What the data sheets say, and what is a guess: the mass, and friction that nobody measured.
NUMBERS = {"mass": 40.0, "viscous": 200.0, "coulomb": 30.0, "force_gain": 15.1, "command_limit": 150.0}


def export(record: Record, path: Path) -> None:
    """Write ``record`` as the drive does: a preamble, decimal commas, ms, mm and % of the rated torque, CP1252."""
    lines = [
        f"Name;{path.stem}",
        "Abtastzeit;500,0 µs",
        "",
        "Zeit [ms];Lageistwert [mm];Lagesollwert [mm];Momentensollwert [%];Status",
    ]
    for t, q, q_ref, u in zip(record.t, record.q, record.q_ref, record.u, strict=True):
        lines.append(f"{1e3 * t:.3f};{1e3 * q:.6f};{1e3 * q_ref:.6f};{u:.3f};4663".replace(".", ","))
    path.write_text("\n".join(lines) + "\n", encoding="cp1252")


def fill(path: Path) -> None:
    """Put the numbers of the data sheets where the axis file waits for them."""
    text = path.read_text(encoding="utf-8")
    for key, value in NUMBERS.items():
        waiting = next(line for line in text.splitlines() if line.startswith(f"# {key} = "))
        remark = waiting.partition(" # ")[2]
        text = text.replace(waiting, f"{f'{key} = {value}':<32} # {remark}")
    path.write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    if sys.argv[1:2] == ["fill"]:
        fill(Path(sys.argv[2]))
    else:
        for seed, name in enumerate(("trace.csv", "second_trace.csv")):
            export(synthetic_record(SCREW, laps=2, seed=seed), Path(name))
        print("\n".join(Path("trace.csv").read_text(encoding="cp1252").splitlines()[:7]))
