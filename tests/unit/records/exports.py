"""Exports of drives, made here: one motion of one axis, written as different drives and loggers write it."""

import numpy as np

N = 400
T = np.arange(N) * 1e-3
Q_REF = 0.1 * np.sin(6 * T)
ENCODER = 2e-5
Q = np.round((Q_REF - 1e-4 * np.cos(6 * T)) / ENCODER) * ENCODER
NOISE = np.random.default_rng(7).standard_normal(N)
U = 40 * np.cos(6 * T) + 0.5 * NOISE

GERMAN = """Name;Aufzeichnung 4
Startzeit;12.03.2026 08:14:22
Abtastzeit;1000,0 µs

"""


def rows(*columns, between=";", comma=False, digits=7):
    lines = [between.join(f"{x:.{digits}f}" for x in row) for row in zip(*columns, strict=True)]
    return [line.replace(".", ",") for line in lines] if comma else lines


def german(
    header="Zeit [ms];Lageistwert [mm];Lagesollwert [mm];Momentensollwert [%];Status", preamble=GERMAN, **change
):
    columns = {"t": 1e3 * T, "q": 1e3 * Q, "q_ref": 1e3 * Q_REF, "u": U, "status": np.full(N, 4663.0)} | change
    return preamble + "\n".join([header, *rows(*columns.values(), comma=True)]) + "\n"


def scope(comma=False, step=1, end=""):
    """A Scope export of three channels at 1 ms and one, the reference, at ``step`` ms with a time column of its own."""
    names = [("ActPos", "mm (Length)"), ("TorqueCommand", "% (Ratio)"), ("SetPos", "mm (Length)")]
    head = [
        "Name\tProject 4",
        "File\tC:\\trace\\project 4.csv",
        "Starttime of export\t132959733843760000\tMontag, 2. Mai 2022\t15:56:24.376",
        "",
        "",
        "\t".join(["Name", names[0][0], names[1][0], "Name", names[2][0]]),
        "SymbolComment\t\t\tSymbolComment\t",
        "Data-Type\tREAL64\tREAL64\tData-Type\tREAL64",
        f"SampleTime[ms]\t1\t1\tSampleTime[ms]\t{step}",
        "SymbolName\tMAIN.fAct\tMAIN.fTorque\tSymbolName\tMAIN.fSet",
        "Port\t851\t851\tPort\t851",
        "\t".join(["Unit", names[0][1], names[1][1], "Unit", names[2][1]]),
        "Unit ScaleFactor\t1\t1\tUnit ScaleFactor\t1",
        "",
    ]
    slow = slice(None, None, step)
    second = [f"{t:.4f}\t{x:.7f}" for t, x in zip(1e3 * T[slow], 1e3 * Q_REF[slow], strict=True)]
    second += ["\t"] * (N - len(second))
    first = [f"{t:.4f}\t{q:.7f}\t{u:.7f}" for t, q, u in zip(1e3 * T, 1e3 * Q, U, strict=True)]
    body = [f"{a}\t{b}" for a, b in zip(first, second, strict=True)]
    body = [line.replace(".", ",") for line in body] if comma else body
    return "\n".join([*head, *body, end])
