"""Let the generator be imported as it is run, from the root of the repository: ``tests.hidden``."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
