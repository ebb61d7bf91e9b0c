"""Measure the engine, whole commands and the studio, and write benchmarks/latest.json: ``make bench``.

Times are medians of one process on this machine: processor time where one thread works, so that other work on the
machine counts little, wall time where several do. What counts are the ratios. Peers that are not there are left out
with a note. The record is DATA_EMPS where it can be found, otherwise a synthetic record of the same length.
"""

from __future__ import annotations

import gc
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from benchmarks.commands import commands
from benchmarks.diagnosis import diagnosis
from benchmarks.peers import compiled_c, python_control
from benchmarks.rows import add, children, skip
from benchmarks.studio import studio
from emps_design.comanipulation.study import mismatch_study
from emps_design.control.impedance.law import impedance_law
from emps_design.files import write_text
from emps_design.machines import machine
from emps_design.records import Record, read_record
from emps_design.simulation import Plant, monte_carlo, simulate_ensemble
from emps_design.simulation.synthetic import synthetic_record, trapezoid_laps

# What the measured records of the EMPS machine call for, and the same with a Stribeck effect in place of the curve.
FIVE = (
    {"kind": "asymmetric_viscous_friction", "viscous_difference": -40.0},
    {"kind": "nonlinear_viscous_friction", "amount": -1.5, "exponent": 2.0},
    {"kind": "position_ripple", "amplitude": 1.0, "phase": 0.5, "period": 2.5e-3},
    {"kind": "position_dependent_friction", "amplitude": 2.0, "phase": 0.3, "length": 0.2},
    {"kind": "actuator_lag", "time_constant": 0.25e-3},
)
CASCADE = {
    "kind": "cascade",
    "position": {"kp": 40.0, "every": 4},
    "velocity": {"kp": 300.0, "ti": 0.03},
    "feedforward": {"velocity": 1.0, "acceleration": 2.5, "coulomb": 0.5},
    "filters": [
        {"kind": "lowpass", "frequency": 350.0},
        {"kind": "notch", "frequency": 210.0, "damping": 0.6, "depth": 0.1},
    ],
    "velocity_estimator": "backward",
}
PLAY = {"kind": "backlash", "gap": 1e-4, "frequency": 60.0, "damping": 0.15, "share": 0.4}
STRIBECK = {"kind": "stribeck_friction", "excess": 5.0, "stribeck_velocity": 0.01, "exponent": 1.0}


def main() -> int:
    """Run every measurement, print the table, write the file; 1 when a target is missed."""
    record, source = _record()
    axis = machine("emps2019")
    rows: list[dict] = []
    load = round(os.getloadavg()[0], 2)
    print(
        f"benchmarks: record {source}, {len(record)} samples, {os.cpu_count()} cores, load average {load:g}",
        file=sys.stderr,
    )
    _replays(axis, record, rows)
    _five(axis, record, rows)
    _play(axis, record, rows)
    _contact(axis, record, rows)
    _ensembles(axis, record, rows)
    _comanipulation(rows)
    _hour(axis, rows)
    _starts(rows)
    commands(rows)
    diagnosis(rows)
    studio(rows)
    document = {"rows": rows, "cores": os.cpu_count(), "load_average": load}
    write_text(Path(__file__).with_name("latest.json"), json.dumps(document, indent=1) + "\n")
    _table(rows)
    return 0 if all(row["met"] is not False for row in rows) else 1


def _record() -> tuple[Record, str]:
    folder = Path(os.environ.get("EMPS_DESIGN_DATA", Path(__file__).resolve().parents[2] / "shared" / "data"))
    path = folder / "emps" / "DATA_EMPS.mat"
    if path.exists():
        return read_record(path), "DATA_EMPS"
    record = synthetic_record(machine("emps2019"), laps=2)
    return record.part(0, min(len(record), 24841)), "synthetic (DATA_EMPS is not here)"


def _median(call, least: int = 5, seconds: float = 1.0, clock=time.thread_time) -> float:
    """Median time of ``call`` [s], after one call to warm up: of this thread's processor unless ``clock`` says else."""
    call()
    times = []
    gc.disable()
    while len(times) < least or (sum(times) < seconds and len(times) < 500):
        begun = clock()
        call()
        times.append(clock() - begun)
    gc.enable()
    return float(np.median(times))


def _together(call) -> tuple[float, float]:
    """Medians of wall and processor time of ``call`` [s], all threads together; they part on a machine that is busy."""
    call()
    times = []
    for _ in range(3):
        begun = time.perf_counter(), time.process_time()
        call()
        times.append((time.perf_counter() - begun[0], time.process_time() - begun[1]))
    wall, busy = np.median(times, axis=0)
    return float(wall), float(busy)


def _replays(axis, record, rows) -> None:
    q_ref, q0, plant = np.ascontiguousarray(record.q_ref), float(record.q[0]), Plant.of(axis)

    def ours(method: str):
        return lambda: plant.closed_loop(q_ref, q0=q0, quantise=False, method=method)

    exact = ours("plain")()
    plain, folded, general = (_median(ours(method)) for method in ("plain", "folded", "general"))
    add(rows, "replay, core model, plain", 1e3 * plain, "ms")
    add(rows, "replay, core model, folded", 1e3 * folded, "ms")
    add(rows, "replay, core model, general stepper", 1e3 * general, "ms")
    add(rows, "folded over plain", folded / plain, "times", 0.5)
    compiled = compiled_c()
    if isinstance(compiled, str):
        skip("C", compiled)
    else:
        in_c, cascade_in_c = compiled
        _cascade(cascade_in_c, rows)
        same = in_c(q_ref, axis, q0)
        add(
            rows,
            "C and plain, largest difference of position",
            np.abs(same["position"] - exact.position).max(),
            "m",
            1e-12,
        )
        seconds = _median(lambda: in_c(q_ref, axis, q0))
        add(rows, "replay in C, -O3", 1e3 * seconds, "ms")
        add(rows, "plain over C", plain / seconds, "times", 1.3)
        add(rows, "folded over C", folded / seconds, "times")
    peer = python_control()
    if isinstance(peer, str):
        skip("python-control", peer)
    else:
        begun = time.thread_time()
        same = peer(q_ref, axis, q0)
        seconds = time.thread_time() - begun
        add(
            rows,
            "python-control and plain, difference of position",
            np.abs(same["position"] - exact.position).max(),
            "m",
            1e-12,
        )
        add(rows, "python-control, one nlsys with the exact step", 1e3 * seconds, "ms")
        add(rows, "python-control over plain", seconds / plain, "times", 1000.0, least=True)


def _cascade(in_c, rows) -> None:
    """A drive's cascade over 50,000 samples, with a position loop of another rate, feed-forward and two filters."""
    axis = machine("emps2019").replace(controller=CASCADE, sampling={"period": 0.25e-3})
    q_ref, plant = trapezoid_laps(0.25e-3, laps=1)[:50_000], Plant.of(axis)
    run, same = plant.closed_loop(q_ref, quantise=False), in_c(q_ref, axis, float(q_ref[0]))
    difference = np.abs(same["position"] - run.position).max()
    add(rows, "C and a cascade, largest difference of position", difference, "m", 1e-12)
    ours = _median(lambda: plant.closed_loop(q_ref, quantise=False))
    seconds = _median(lambda: in_c(q_ref, axis, float(q_ref[0])))
    add(rows, "replay of a cascade, 50,000 samples", 1e3 * ours, "ms")
    add(rows, "replay of a cascade in C, -O3", 1e3 * seconds, "ms")
    add(rows, "cascade over C", ours / seconds, "times", 2.0)


def _five(axis, record, rows) -> None:
    q0 = float(record.q[0])
    for label, effects in (("as the records need", FIVE), ("Stribeck for the curve", (STRIBECK, FIVE[0], *FIVE[2:]))):
        plant = Plant.of(axis.replace(effects=list(effects)))
        fast = plant.closed_loop(record.q_ref, q0=q0, quantise=False)
        tight = plant.closed_loop(record.q_ref, q0=q0, quantise=False, tolerance=1e-4)
        seconds = _median(lambda plant=plant: plant.closed_loop(record.q_ref, q0=q0))
        add(rows, f"replay, five effects ({label})", 1e3 * seconds, "ms", 2.0)
        difference = float(np.abs(fast.position - tight.position).max())
        add(rows, f"five effects ({label}), position against tight steps", difference, "m", 1e-9)


def _play(axis, record, rows) -> None:
    """Play in pieces against the same step by step, and beside smooth forces."""
    q0 = float(record.q[0])
    alone, beside = (Plant.of(axis.replace(effects=[PLAY, *more])) for more in ((), (STRIBECK, FIVE[2])))
    exact, stepped = (
        _median(lambda method=method: alone.closed_loop(record.q_ref, q0=q0, method=method))
        for method in ("linear", "general")
    )
    add(rows, "replay, play", 1e3 * exact, "ms")
    add(rows, "play step by step over play in pieces", stepped / exact, "times", 2.0, least=True)
    seconds = _median(lambda: beside.closed_loop(record.q_ref, q0=q0))
    add(rows, "replay, play beside Stribeck friction and a ripple", 1e3 * seconds, "ms")
    fast, tight = (
        beside.closed_loop(record.q_ref, q0=q0, quantise=False, tolerance=tolerance) for tolerance in (1.0, 1e-4)
    )
    difference = float(np.abs(fast.position - tight.position).max())
    add(rows, "play beside Stribeck friction and a ripple, position against tight steps", difference, "m", 1e-8)


def _contact(axis, record, rows) -> None:
    """Presliding friction where the contact bends by less than an encoder sees, and under friction that varies."""

    ripple = {"kind": "friction_ripple", "amplitude": 1.0, "phase": 0.5, "period": 2.5e-3}

    def seconds(*effects: dict, tolerance: float = 1.0) -> float:
        plant = Plant.of(axis.replace(effects=list(effects)))
        return _median(lambda: plant.closed_loop(record.q_ref, q0=float(record.q[0]), tolerance=tolerance))

    soft, stiff = ({"kind": "presliding_friction", "stiffness": stiffness} for stiffness in (1e5, 1e8))
    add(rows, "presliding friction, the stiffest contact over a soft one", seconds(stiff) / seconds(soft), "times", 2.0)
    add(rows, "a friction ripple with presliding over it alone", seconds(soft, ripple) / seconds(ripple), "times", 4.0)
    behind = {"kind": "flexible_coupling", "frequency": 60.0, "damping": 0.05, "share": 0.4}
    loose = seconds(stiff, behind, tolerance=1e5) / seconds(stiff, behind)
    add(rows, "a stiff contact beside a coupling, loose steps over tight ones", loose, "times", 1.0)


def _ensembles(axis, record, rows) -> None:
    drawn = monte_carlo(axis, 0.02, 10_000)
    wall, busy = _together(lambda: simulate_ensemble(axis, drawn, record=record, workers=2))
    add(rows, "10,000 plants at +-2 %, metrics, two workers", wall, "s", 0.3)
    add(rows, "the same, processor time over two", busy / 2.0, "s")
    extended = axis.replace(effects=list(FIVE))
    few = monte_carlo(extended, 0.02, 400)
    wall, busy = _together(lambda: simulate_ensemble(extended, few, record=record, workers=2))
    add(rows, "plants with five effects, two workers", len(few) / wall, "plants/s", 400.0, least=True)
    add(rows, "the same, by processor time over two", 2.0 * len(few) / busy, "plants/s")


def _comanipulation(rows) -> None:
    """The mismatch study of the impedance law: tasks of 10 s at 1 kHz, verdicts, transparency and poles included."""
    axis = machine("emps2018")
    law = impedance_law(axis, 50.0, 100.0)
    seconds = _median(lambda: mismatch_study(axis, law, 0.02, 10_000, workers=2), least=3, clock=time.perf_counter)
    add(rows, "10,000 co-manipulations of 10 s at +-2 %, two workers", seconds, "s", 1.0)


def _hour(axis, rows) -> None:
    """One hour at 1 kHz in a process of its own, whose peak memory is its own."""
    program = (
        "import resource, sys, time, numpy as np\n"
        "from emps_design.machines import machine\n"
        "from emps_design.simulation import Plant\n"
        "plant = Plant.of(machine('emps2019'))\n"
        "plant.closed_loop(np.zeros(10))\n"
        "for n in (360_000, 3_600_000):\n"
        "    q_ref = 0.1 * np.sin(2e-3 * np.pi * 0.3 * np.arange(n))\n"
        "    best = 1e9\n"
        "    for _ in range(3):\n"
        "        begun = time.thread_time()\n"
        "        plant.closed_loop(q_ref)\n"
        "        best = min(best, time.thread_time() - begun)\n"
        "    print(best)\n"
        "print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)\n"
    )
    answer = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    tenth, whole, kilobytes = map(float, answer.stdout.split())
    add(rows, "one hour at 1 kHz, core model", whole, "s")
    add(rows, "one hour over ten times six minutes", whole / (10.0 * tenth), "times", 1.5)
    add(rows, "one hour, peak memory", kilobytes / 1024.0**2, "GiB", 1.0)


def _starts(rows) -> None:
    """A process that simulates an axis with every kernel it can need, with an empty disk cache and with a full one."""
    program = (
        "import numpy as np\n"
        "from emps_design.machines import machine\n"
        "from emps_design.simulation import Plant, monte_carlo, simulate_ensemble\n"
        "axis = machine('emps2019')\n"
        "q_ref = 1e-3 * np.arange(50.0)\n"
        "Plant.of(axis).closed_loop(q_ref)\n"
        "Plant.of(axis.replace(effects=EFFECTS)).closed_loop(q_ref)\n"
    ).replace("EFFECTS", repr(list(FIVE)))
    with tempfile.TemporaryDirectory() as folder:
        environment = {**os.environ, "NUMBA_CACHE_DIR": folder}
        times = []
        for _ in range(4):
            begun, used = time.perf_counter(), children()
            subprocess.run([sys.executable, "-c", program], check=True, env=environment)
            times.append((time.perf_counter() - begun, children() - used))
    add(rows, "whole process, cold: core, general stepper, five effects", times[0][0], "s", 20.0)
    add(rows, "the same, processor time", times[0][1], "s")
    warm = min(times[1:])
    add(rows, "whole process, warm", warm[0], "s", 1.0)
    add(rows, "the same, processor time", warm[1], "s")
    own = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0**2
    add(rows, "this process, peak memory", own, "GiB")


def _table(rows) -> None:
    width = max(len(row["work"]) for row in rows)
    for row in rows:
        target = "" if row["target"] is None else f"target {row['target']:g} {'met' if row['met'] else 'MISSED'}"
        print(f"{row['work']:<{width}}  {row['value']:>10.4g} {row['unit']:<9} {target}")


if __name__ == "__main__":
    sys.exit(main())
