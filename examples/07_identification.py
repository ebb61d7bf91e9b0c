"""Four estimators on one record, what their deviations are worth, and several records at once.

Run: python examples/07_identification.py [RECORD...]. Without a record, three simulated ones are taken, and the truth
stands beside the estimates.
"""

import sys

from emps_design.identification import chosen_cutoff, identify, identify_several
from emps_design.machines import machine
from emps_design.records import read_record
from emps_design.simulation import synthetic_record

axis = machine("emps2019")
given = [read_record(path) for path in sys.argv[1:]]
records = given or [synthetic_record(axis, seed=seed) for seed in range(3)]
record = records[0]

# 1. The cut-off that motion and encoder ask for.
print(f"cut-off chosen from the data: {chosen_cutoff(record):g} Hz")

# 2. Least squares on three chains, instruments, output error.
estimates = {
    f"least squares, {name}": identify(record, axis, estimator="ls", filter=name)
    for name in ("report", "paper", "hold")
}
estimates["instruments"] = instruments = identify(record, axis, estimator="iv")
estimates["output error"] = identify(record, axis, estimator="oe")
if not given:
    print(f"{'truth':24}", *(f"{value:9.3f}" for value in axis.mechanics.array()))
for label, found in estimates.items():
    print(f"{label:24}", *(f"{value:9.3f}" for value in found.values()), f"  {found.rms_error:.3f} N")
test = instruments.extra["hausman_test"]
print(f"Durbin-Wu-Hausman: p = {test['p_value']:.2g}, at most {test['shift_in_std']:.2f} standard deviations")

# 3. Standard deviations: (15), the long-run covariance, HAC, noise redrawn.
found = identify(record, axis, bootstrap=200)
print(f"\n{found.samples} rows count as {found.residual.effective_samples:.0f}; HAC lag {found.hac_lag:.2f} s")
for name, one in found.parameters.items():
    print(f"{name:16} (15) {one.std:.4f}  long-run {one.std_long_run:.4f}  HAC {one.std_hac:.4f}", end="")
    print(f"  bootstrap {one.std_bootstrap:.4f} {one.quantity.unit}")

# 4. Several records: mean, spread, drift, and each judged with the parameters of the others.
if len(records) > 1:
    several = identify_several(records, axis)
    for row in several.table():
        print(f"{row['name']:16} mean {row['mean']:9.3f}  spread {row['spread']:.3f}", end="")
        print(f"  within {row['std']:.3f} {row['unit']}")
    print("identified on the row's record, judged on the column's [N rms]:")
    print(several.cross_validation.round(3))
