"""A whole diagnosis in the library: how long one record takes, and whether both cores work."""

from __future__ import annotations

import time

import numpy as np

from benchmarks.rows import add
from emps_design.discrepancy import diagnose
from emps_design.machines import machine
from emps_design.simulation.synthetic import synthetic_record

HIDDEN = {
    "nothing to find": [],
    "Stribeck friction": [{"kind": "stribeck_friction", "excess": 8.0, "stribeck_velocity": 0.008, "exponent": 1.0}],
    "flexible coupling": [{"kind": "flexible_coupling", "frequency": 35.0, "damping": 0.05, "share": 0.4}],
}
SAMPLES = 25_000  # of a record at 1 kHz, in whole laps and a part of one


def diagnosis(rows: list[dict]) -> None:
    """Measure ``diagnose`` on a record of 25 s, of the same machine with one effect after the other hidden in it."""
    given = machine("emps2019")
    for what, effects in HIDDEN.items():
        made = synthetic_record(given.replace(effects=effects), seed=1)
        record = made.part(0, min(len(made), SAMPLES))
        times = []
        for _ in range(3):
            begun = time.perf_counter(), time.process_time()
            diagnose(record, given)
            times.append((time.perf_counter() - begun[0], time.process_time() - begun[1]))
        wall, busy = np.min(times[1:], axis=0)  # the first one compiles
        add(rows, f"diagnose in the library, {what}, 25 s", wall, "s", 3.0)
        add(rows, "the same, processor time", busy, "s")
        if effects:
            add(rows, "the same, cores busy", busy / wall, "cores", 1.7, least=True)
