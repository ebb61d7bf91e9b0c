"""Where measured records are looked for: beside the repository, or in the folder EMPS_DESIGN_DATA names."""

import os
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).resolve().parents[1]
DATA = Path(os.environ.get("EMPS_DESIGN_DATA", REPOSITORY.parent / "shared" / "data"))


@pytest.fixture(scope="session")
def emps_data() -> Path:
    """Folder with DATA_EMPS.mat and DATA_EMPS_PULSES.mat."""
    folder = DATA / "emps"
    if not (folder / "DATA_EMPS.mat").exists():
        pytest.skip(f"the measured EMPS records are not in {folder}")
    return folder


@pytest.fixture(scope="session")
def hidden_data() -> Path:
    """Folder with the records in which effects are hidden."""
    folder = DATA / "hidden"
    if not folder.is_dir():
        pytest.skip(f"the hidden-effect records are not in {folder}")
    return folder
