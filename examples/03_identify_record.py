"""From a record to an axis: identify, look at what the numbers are worth, write the axis file.

Run: python examples/03_identify_record.py [RECORD [AXIS.toml]]. Without a record, a simulated one is taken.
"""

import sys
from pathlib import Path

from emps_design.files import write_text
from emps_design.identification import identify
from emps_design.machines import machine
from emps_design.records import read_record
from emps_design.simulation import synthetic_record

axis = machine("emps2019")
record = read_record(sys.argv[1]) if len(sys.argv) > 1 else synthetic_record(axis)

for model in ("symmetric", "asymmetric"):
    found = identify(record, axis, model=model)
    print(f"{record.name}, {model}: force error {found.rms_error:.3f} N, {found.relative_error_percent:.2f} %")
    for name, estimate in found.parameters.items():
        if not estimate.determined:
            print(f"  {name:18} not determined by this record")
            continue
        low, high = estimate.interval_95
        print(f"  {name:18} {estimate.value:10.4f} +- {estimate.std:.4f} {estimate.quantity.unit:8}", end="")
        print(f"  95 % {low:.3f} to {high:.3f}, the residual being correlated")

identified = found.to_axis("identified")
if len(sys.argv) > 2:
    write_text(Path(sys.argv[2]), identified.to_toml())
print(identified.to_toml())
