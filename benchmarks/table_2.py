"""Which assumption makes Table II: the virtual bench with one assumption taken back, or changed, at a time.

The paper's Table II (direct validation during co-manipulation) differs from its Table I by more than its own
deviations allow. Each :class:`Assumption` changes some numbers of the bench, everything else and the seed being the
same, and both tables are identified again; what an assumption moves is what it can explain.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from emps_design.identification.chains import CHAINS
from emps_design.identification.inverse_model import LeastSquares, least_squares, regression
from emps_design.identification.model import parameters_of
from emps_design.paper.virtual_bench import (
    MODEL,
    NUMBERS,
    PRINTED,
    bench_axis,
    comanipulation_experiment,
    identification_experiment,
    numbers,
)
from emps_design.progress import Progress
from emps_design.records import Record

# Without the bend, Table I's friction is the machine's: nothing has to be taken off it.
STRAIGHT = {
    name: 0.0
    for name in NUMBERS
    if name in ("bend_positive", "bend_negative") or name.startswith(("viscous_less", "coulomb_less"))
}


@dataclass(frozen=True)
class Assumption:
    """Changed ``numbers`` of the bench, or another ``chain`` of filters, under a ``title``."""

    title: str
    numbers: dict[str, float] = field(default_factory=dict)
    chain: str = "paper"


ASSUMPTIONS = (
    Assumption("the bench as it is"),
    Assumption("friction is a straight line", STRAIGHT),
    Assumption("friction does not depend on position", {"position_amplitude": 0.0}),
    Assumption("no break-away", {"break_away_excess": 0.0}),
    Assumption("no ripple", {"ripple_amplitude": 0.0}),
    Assumption("friction without noise", {"friction_noise": 1e-9}),
    Assumption("no mass beyond the sensor", {"mass_beyond_sensor": 0.0}),
    Assumption("sensor late by 30 ms instead of a mass beyond it", {"mass_beyond_sensor": 0.0, "sensor_lag": 0.03}),
    Assumption("no offset of the sensor", {"sensor_offset": 0.0}),
    Assumption("sensor reads 10 % more", {"sensor_gain_error": 0.1}),
    Assumption("sensor reads 10 % less", {"sensor_gain_error": -0.1}),
    Assumption("hand does not balance tau_ref of 1 N", {"hand_bias": 0.0, "tau_ref": 1.0}),
    Assumption("tau_ref = 0", {"tau_ref": 0.0}),
    Assumption("40 s instead of 110 s", {"hand_duration": 40.0}),
    Assumption("k_e1 halved: half the speed", {"k_e1": 0.0025}),
    Assumption("k_e1 doubled: twice the speed", {"k_e1": 0.01}),
    Assumption("the hand's ramps of 0.05 s", {"hand_ramp": 0.05}),
    Assumption("the hand's ramps of 1 s", {"hand_ramp": 1.0}),
    Assumption("the hand's floors of 2 s", {"hand_floor": 2.0}),
    Assumption("cut-off of the 2019 report", chain="report"),
    Assumption("hold modelled, rest left out", chain="hold"),
    Assumption(
        "all of these taken back: Table I's machine",
        {
            **STRAIGHT,
            "position_amplitude": 0.0,
            "break_away_excess": 0.0,
            "mass_beyond_sensor": 0.0,
            "mass_less": 0.0,
            "sensor_offset": 0.0,
        },
    ),
)


@dataclass(frozen=True)
class Tables:
    """Both tables under an assumption, means over experiments: ``value``, ``spread``, ``two_sigma`` (5,) and the error.

    ``table_1`` and ``table_2`` hold one dict each with these names, SI; ``rms`` [N] is direct validation's.
    """

    assumption: Assumption
    table_1: dict[str, np.ndarray]
    table_2: dict[str, np.ndarray]
    rms: float

    @property
    def off_by(self) -> np.ndarray:
        """Relative distance of Table II's values from the printed ones, (5,)."""
        printed = np.array([row[0] for row in PRINTED["table_2"].values()])
        return self.table_2["value"] / printed - 1.0

    def to_row(self) -> dict[str, Any]:
        """One row of the sweep: what stands in Table II, the largest distance in it, and the changed numbers."""
        names = [p.name for p in parameters_of(MODEL)]
        columns = {
            "": self.table_2["value"],
            "two_sigma_": self.table_2["two_sigma"],
            "spread_": self.table_2["spread"],
            "table_1_": self.table_1["value"],
        }
        return {
            "assumption": self.assumption.title,
            **{
                before + name: round(float(number), 3)
                for before, column in columns.items()
                for name, number in zip(names, column, strict=True)
            },
            "rms": round(self.rms, 2),
            "off_by_percent": round(100.0 * float(np.max(np.abs(self.off_by))), 1),
            "numbers": self.assumption.numbers,
            "chain": self.assumption.chain,
        }


def tables_under(assumption: Assumption, experiments: int = 10, seed: int = 1000) -> Tables:
    """Identify both tables under ``assumption`` from so many experiments of either kind, at the mean friction.

    The seeds are not those of :func:`virtual_bench.virtual_bench`, on which the bench's numbers are judged.
    """
    n = numbers(**assumption.numbers)
    gain = bench_axis(n).drive.force_gain
    fits: dict[str, list] = {"table_1": [], "table_2": []}
    for index in range(experiments):
        for key, make in (("table_1", identification_experiment), ("table_2", comanipulation_experiment)):
            record = make(n, np.random.default_rng([seed, index]), 1.0, key)
            fits[key].append(_fit(record, gain, assumption.chain))
    tables = {
        key: {
            "value": np.mean([fit.value for fit in own], axis=0),
            "spread": np.std([fit.value for fit in own], axis=0, ddof=1),
            "two_sigma": np.mean([2.0 * fit.std for fit in own], axis=0),
        }
        for key, own in fits.items()
    }
    return Tables(assumption, **tables, rms=float(np.mean([fit.rms_error for fit in fits["table_2"]])))


def sweep(
    assumptions: tuple[Assumption, ...] = ASSUMPTIONS,
    experiments: int = 10,
    progress: Progress | None = None,
) -> list[Tables]:
    """Return the :func:`tables_under` each assumption."""
    found = []
    for index, one in enumerate(assumptions):
        if progress is not None:
            progress(one.title, index / len(assumptions))
        found.append(tables_under(one, experiments))
    return found


def _fit(record: Record, gain: float, chain: str) -> LeastSquares:
    filtered = CHAINS[chain](record, gain)
    W, Y = regression(filtered, MODEL)
    return least_squares(W, Y, tuple(p.name for p in parameters_of(MODEL)), filtered.used)


def rms_speeds(table: dict[str, tuple[float, float, float]]) -> tuple[float, float]:
    """Root mean square of the speed [m/s] forth and back of its experiment, from the deviations in a table.

    For a line F_c + F_v v the deviations are as 1 to the root mean square of v, whatever the noise and the number of
    samples: sigma(F_c)/sigma(F_v).

    >>> [round(1e3 * v, 1) for v in rms_speeds(PRINTED["table_1"])]
    [18.6, 17.4]
    """
    forth, back = (table[f"coulomb_{way}"][1] / table[f"viscous_{way}"][1] for way in ("positive", "negative"))
    return forth, back
