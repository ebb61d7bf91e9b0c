"""The EMPS machine itself: what its model misses, confirmed on a lap not used, and on the benchmark's second record.

Run: python examples/11_diagnose_emps.py DATA_EMPS.mat [DATA_EMPS_PULSES.mat]. Laps 1 to 3 are diagnosed and lap 4
confirms; what has no name is described, for a simulation that comes close. With the second record the model that is
named is also scored as the public benchmark asks: simulated open loop from the voltage alone, 20 initial samples given,
nothing decided on that record; rms error of position. Without records it says so and ends.
"""

import sys

import numpy as np

from emps_design.discrepancy import diagnose
from emps_design.machines import machine
from emps_design.records import read_record
from emps_design.simulation import Plant

GIVEN = 20  # initial samples of the benchmark's protocol

if len(sys.argv) < 2:
    print("give the measured record: python examples/11_diagnose_emps.py DATA_EMPS.mat [DATA_EMPS_PULSES.mat]")
    sys.exit()

# 1. Laps 1 to 3 are searched, lap 4 is opened once.
record = read_record(sys.argv[1])
lap = 6240 * record.period
diagnosis = diagnose(
    record,
    machine("emps2019"),
    fit_time=(0.0, 3 * lap),
    confirm_time=(3 * lap, 4 * lap),
    progress=lambda stage, done: print(f"  {stage}", file=sys.stderr),
    closest=True,
)
print(diagnosis.verdict)
print(diagnosis.sentence)
for finding in diagnosis.findings:
    print(f"  {finding.effect}: without it {finding.gap_before:.2f} N, with it {finding.gap_after:.2f} N")

prediction, window = diagnosis.trace, diagnosis.trace.used
measured = np.linalg.norm(prediction.measured[window])
for name, force in (("baseline", prediction.baseline), ("extended", prediction.extended)):
    print(f"lap 4, closed loop, {name}: {100 * np.linalg.norm((prediction.measured - force)[window]) / measured:.2f} %")
print(
    f"lap 4, inverse model at 60 Hz: {diagnosis.holdout.baseline_60hz:.2f} N -> {diagnosis.holdout.extended_60hz:.2f} N"
)
closest = diagnosis.closest
print(closest.text)
if closest.axis is not None:
    print(f"lap 4, closed loop, closest model: {100 * closest.share:.2f} %")
    print(f"lap 4, inverse model at 60 Hz, closest model: {closest.holdout.extended_60hz:.2f} N")

# 2. The benchmark's protocol on the second record.
if len(sys.argv) > 2:
    pulses = read_record(sys.argv[2])
    speed = (pulses.q[GIVEN - 1] - pulses.q[GIVEN - 3]) / (2 * pulses.period)
    for name, axis in (("published least squares", machine("emps2019")), ("extended model", diagnosis.axis)):
        run = Plant.of(axis).open_loop(pulses.u[GIVEN:], q0=float(pulses.q[GIVEN]), v0=float(speed))
        rmse = float(np.sqrt(np.mean((run.q - pulses.q[GIVEN:]) ** 2)))
        print(f"benchmark, open loop, {name}: {1e3 * rmse:.2f} mm")
