"""What the steps of the encoder alone do to an estimate, by simulation of the closed loop.

At a constant speed the steps come too fast for the filters; while the axis starts and stops they do not. So they are in
the motion just where the mass is told, which no statistics of a residual that is the same all along can see.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from emps_design.axis import Axis
from emps_design.errors import EmpsError
from emps_design.identification.closed_loop import simulate
from emps_design.identification.model import Model
from emps_design.laws import NONE
from emps_design.records import Record

PHASES = 8  # of the encoder's steps against the motion
STRIDE = 3  # of the phases, from one run to the next: where within a step the axis stood at first, against the phase


def error_of_steps(
    record: Record, axis: Axis, model: Model, value: np.ndarray, estimate: Callable[[Record, Record], np.ndarray]
) -> np.ndarray | None:
    """Rms (p,) by which the steps of the encoder move ``estimate``, over several of their phases.

    ``estimate`` gives parameters (p,) of a simulated record, beside the same record by an exact encoder; ``value`` (p,)
    are those that are simulated. None without a resolution or a controller in ``axis``, without a recorded reference,
    and where no simulation with ``value`` follows it.
    """
    resolution = axis.sampling.encoder_resolution
    if not resolution or axis.controller.kind == NONE or not record.has_reference:
        return None
    try:
        exact = _as_record(record, axis, model, value)
        right, errors = estimate(exact, exact), []
        for phase in range(PHASES):
            moved, stood = (resolution * (i % PHASES) / PHASES for i in (phase, STRIDE * phase))
            seen = _as_record(record, axis, model, value, moved, stood - 0.5 * resolution)
            errors.append(estimate(seen, exact) - right)
        return np.sqrt(np.mean(np.square(errors), axis=0))
    except (EmpsError, np.linalg.LinAlgError):
        return None


def _as_record(
    record: Record, axis: Axis, model: Model, value: np.ndarray, moved: float = 0.0, stood: float | None = None
) -> Record:
    """``record`` as the axis with ``value`` would have made it, by an exact encoder without ``stood``.

    ``moved`` [m] is all of it against the encoder's steps, ``stood`` [m] how far the axis was at first from what the
    encoder said.
    """
    start = replace(record, q_ref=record.q_ref + moved, q=record.q + moved + (stood or 0.0))
    run = simulate(start, axis, model, value, quantise=stood is not None)
    return replace(record, q=run.q - moved, u=run.u)
