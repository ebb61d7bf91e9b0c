"""Run a command of this package and catch what it prints."""

import os
import shlex
import subprocess
import sys
from pathlib import Path


def execute(command: str, folder: Path) -> subprocess.CompletedProcess:
    """Run ``emps-design`` (or Python) of this environment in ``folder``."""
    folder.mkdir(parents=True, exist_ok=True)
    words = shlex.split(command)
    program = {"emps-design": [sys.executable, "-m", "emps_design.cli"], "python": [sys.executable]}[words[0]]
    settings = {**os.environ, "COLUMNS": "80", "TERM": "dumb", "NO_COLOR": "1", "MPLBACKEND": "Agg"}
    settings["PYTHONPATH"] = os.pathsep.join([str(Path(__file__).resolve().parents[2]), settings.get("PYTHONPATH", "")])
    return subprocess.run(
        [*program, *words[1:]], cwd=folder, env=settings, capture_output=True, text=True, check=False, timeout=900
    )
