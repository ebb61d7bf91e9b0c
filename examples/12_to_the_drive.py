"""From a model with an effect to code with proof: compensate a ripple, export the controller, run its own check.

Run: python examples/12_to_the_drive.py. Writes into a temporary folder; the check needs make and a C compiler.
"""

import shutil
import subprocess
import tempfile
from pathlib import Path

from emps_design.codegen import export_controller
from emps_design.compensation import compensate
from emps_design.machines import machine
from emps_design.simulation import trapezoid_laps

# 1. A machine with a ripple of 5 N every 5 mm, as a diagnosis may have found it.
ripple = {"kind": "position_ripple", "amplitude": 5.0, "phase": 0.8, "period": 0.005}
axis = machine("emps2019").replace(effects=[ripple])

# 2. Feed forward what the model knows, and try it with parameters 2 % and a phase 10 degrees wrong.
found = compensate(axis, trapezoid_laps(axis.sampling.period, stroke=0.05, speed=0.15, laps=1))
for name, rms in found.to_dict()["tracking_rms"].items():
    print(f"tracking error {name:9s} {1e6 * rms:8.2f} um rms")

# 3. The controller with it as C, and the controller alone as Structured Text.
code = export_controller(axis, "c", found.to_dict())
text = export_controller(axis, "st")
print(", ".join([*code.files, *(name for name in text.files if name.endswith(".st"))]))

# 4. The folder proves itself.
with tempfile.TemporaryDirectory() as folder:
    code.write(Path(folder))
    if shutil.which("make") and shutil.which("cc"):
        done = subprocess.run(["make", "-s", "check"], cwd=folder, capture_output=True, text=True, check=True)
        print(done.stdout.strip())
