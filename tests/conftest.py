"""Where measured records are looked for, and what several workers on one machine need.

Records: beside the repository, or in the folder EMPS_DESIGN_DATA names.
"""

import ctypes
import gc
import os
from contextlib import suppress
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

pytest_plugins = ["tests.costs"]
REPOSITORY = Path(__file__).resolve().parents[1]
GROWN = 25_000_000  # bytes, after which memory is collected
kept = {"bytes": 0}  # after it was collected last
DATA = Path(os.environ.get("EMPS_DESIGN_DATA", REPOSITORY.parent / "shared" / "data"))

# As the command line has it: one thread of linear algebra in every worker, and in what it starts.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# Workers give memory back: one heap for all threads, and what is large not from the heap.
for name, value in (("ARENA_MAX", "1"), ("MMAP_THRESHOLD_", "2000000"), ("TRIM_THRESHOLD_", "10000000")):
    os.environ.setdefault(f"MALLOC_{name}", value)
gc.set_threshold(20_000, 20, 20)

# No test asserts a time: how long an example takes is the machine's.
settings.register_profile("any machine", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("any machine")


@pytest.fixture(scope="session", autouse=True)
def _compiled_once(request, tmp_path_factory):
    """Steppers on disk before the first test of several workers."""
    if hasattr(request.config, "workerinput"):
        from tests.compiled_once import compile_apart, wait_for_each_other

        folder = tmp_path_factory.getbasetemp().parent
        wait_for_each_other(folder)
        compile_apart(int(request.config.workerinput["workerid"].removeprefix("gw")), folder)


def resident() -> int:
    """Memory of this process [bytes]; 0 where the system does not say."""
    pages = Path("/proc/self/statm")
    return int(pages.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") if pages.exists() else 0


@pytest.fixture(scope="module", autouse=True)
def _memory_given_back():
    """What a file of tests leaves is collected once it is large: figures and models are circles of references."""
    yield
    if resident() > kept["bytes"] + GROWN:
        gc.collect()
        with suppress(OSError, AttributeError):
            ctypes.CDLL(None).malloc_trim(0)
        kept["bytes"] = resident()


@pytest.fixture
def sketched(monkeypatch):
    """Pages whose pictures are made but not drawn, which takes longest: for tests of the words around them."""
    monkeypatch.setattr("emps_design.report.page.svg", lambda figure, key="": "<svg></svg>")


@pytest.fixture
def no_walls(monkeypatch):
    """Impedance laws that are pressed against no wall, which takes longest: for tests of everything else."""
    from emps_design.comanipulation.assessment import ImpedanceAssessment

    monkeypatch.setattr(ImpedanceAssessment, "walls", {})


@pytest.fixture
def few_estimates(no_walls, monkeypatch):
    """Impedance laws tried with few estimates, and against no wall: for tests of everything but their verdicts."""
    monkeypatch.setattr("emps_design.comanipulation.assessment.DRAWN", 4)


@pytest.fixture
def short_vectors(monkeypatch):
    """Test vectors of exported code a quarter as long: for tests of something else."""
    monkeypatch.setattr("emps_design.codegen.vectors.MOTION", 60)
    monkeypatch.setattr("emps_design.codegen.vectors.LIMITED", 30)
    monkeypatch.setattr("emps_design.codegen.vectors.EXTREME", 20)


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


@pytest.fixture(scope="session")
def servo_data() -> Path:
    """Folder with servo axes as their drives record them."""
    folder = DATA / "servo"
    if not folder.is_dir():
        pytest.skip(f"the servo records are not in {folder}")
    return folder
