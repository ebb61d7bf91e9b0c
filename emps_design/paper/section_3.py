"""Section III of the paper on the virtual bench: Tables I and II, the errors, and the curves of Figs. 3 to 10."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from emps_design.identification.chains import paper_chain
from emps_design.identification.filtered import Filtered
from emps_design.identification.inverse_model import regression
from emps_design.identification.observation import direct_validation
from emps_design.identification.result import Identification
from emps_design.identification.several import SeveralIdentifications, identify_several
from emps_design.paper.printed import BREAK_AWAY, RANGES, TABLES
from emps_design.paper.virtual_bench import Bench, virtual_bench
from emps_design.progress import Progress
from emps_design.quantities import Quantity
from emps_design.records import Record

MODEL = "asymmetric"

# To stand beside what the bench gives: never used in a computation.
PRINTED = {**TABLES, **RANGES, "break_away": BREAK_AWAY}


@dataclass(frozen=True)
class SectionThree:
    """Results of section III: identification of ten, observation of ten others, direct validation of these.

    ``rms_1``, ``rms_2``, ``rms_direct`` (10,) [N] as the paper defines them; ``table_1`` and ``table_2`` rows of
    (value, 2 sigma, 100 * 2 sigma / |value|), as its tables print them.
    """

    bench: Bench = field(repr=False)
    identification: SeveralIdentifications = field(repr=False)
    direct: tuple[Identification, ...] = field(repr=False)
    rms_1: np.ndarray
    rms_2: np.ndarray
    rms_direct: np.ndarray

    @property
    def table_1(self) -> dict[str, tuple[float, float, float]]:
        """The first experiment's parameters."""
        return _table(self.identification.identifications[0])

    @property
    def table_2(self) -> dict[str, tuple[float, float, float]]:
        """Parameters of direct validation on the first co-manipulation experiment."""
        return _table(self.direct[0])

    def observed(self, index: int = 0) -> dict[str, np.ndarray]:
        """Curves of Figs. 8 to 10 for co-manipulation experiment ``index``: t [s] and forces [N]."""
        record = self.bench.comanipulation[index]
        filtered, W, motor, sensor = _prepared(record, self.bench)
        mean = self.identification.values.mean(axis=0)
        own = self.direct[index].values()
        return {
            "t": filtered.t,
            "sensor": sensor,
            "cross": W @ mean - motor,
            "direct": W @ own - motor,
            "motor": motor,
            "model": W @ own,
        }

    def to_dict(self) -> dict[str, Any]:
        """Plain data, with what the paper printed beside it."""
        return {
            "scenario": "bench",
            "axis": self.bench.axis.name,
            "seed": self.bench.seed,
            "numbers": dict(self.bench.numbers),
            "table_1": {name: list(row) for name, row in self.table_1.items()},
            "table_2": {name: list(row) for name, row in self.table_2.items()},
            "rms_1": self.rms_1.tolist(),
            "rms_2": self.rms_2.tolist(),
            "rms_direct": self.rms_direct.tolist(),
            "break_away": list(self.bench.break_away),
            "printed": PRINTED,
            "warnings": [
                "the paper's records are not public: a machine with its Table I, other numbers chosen so that its "
                "errors come out alike"
            ],
        }


def reproduce_section_3(
    seed: int = 0,
    given: Mapping[str, float] | None = None,
    progress: Progress | None = None,
) -> SectionThree:
    """Run the virtual bench of ``seed`` and evaluate it with the paper's chain of filters.

    ``given`` are the numbers of the bench, :func:`emps_design.paper.bench_numbers.numbers` by default.
    """
    bench = virtual_bench(seed, given, progress)
    # The paper knows nothing of the machine but G_tau, and takes the current loop for a gain.
    plain = bench.axis.replace(effects=[], drive={"current_time_constant": 0.0})
    several = identify_several(bench.identification, plain, model=MODEL, filter="paper")
    mean = several.values.mean(axis=0)
    cross, direct = [], []
    for record in bench.comanipulation:
        _, W, motor, sensor = _prepared(record, bench)
        cross.append(float(np.sqrt(np.mean((W @ mean - motor - sensor) ** 2))))
        direct.append(direct_validation(record, plain, model=MODEL, filter="paper"))
    return SectionThree(
        bench=bench,
        identification=several,
        direct=tuple(direct),
        rms_1=np.diag(several.cross_validation).copy(),
        rms_2=np.array(cross),
        rms_direct=np.array([one.rms_error for one in direct]),
    )


def _prepared(record: Record, bench: Bench) -> tuple[Filtered, np.ndarray, np.ndarray, Any]:
    filtered = paper_chain(record, bench.axis.drive.force_gain)
    W, _ = regression(filtered, MODEL)
    return filtered, W, filtered.force, filtered.f_ext


def _table(found: Identification) -> dict[str, tuple[float, float, float]]:
    return {name: _row(estimate.quantity, estimate.value, estimate.std) for name, estimate in found.parameters.items()}


def _row(quantity: Quantity, value: float | None, std: float | None) -> tuple[float, float, float]:
    if value is None or std is None:
        return (float("nan"),) * 3
    return value, 2.0 * std, 200.0 * std / abs(value)
