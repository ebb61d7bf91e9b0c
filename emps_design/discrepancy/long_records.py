"""Records too long for a full search: only their beginnings are searched, and the model is checked on the rest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from emps_design.discrepancy import rules
from emps_design.discrepancy.preparation import LawCheck, law_voltage, with_law_gap
from emps_design.discrepancy.problem import Hypothesis
from emps_design.errors import SimulationError
from emps_design.messages import Message, warning
from emps_design.quantities import rounded
from emps_design.records import Record

Interval = tuple[float, float]


def beginnings(records: tuple[Record, ...], *windows: Interval | None) -> tuple[Record, ...]:
    """The parts of ``records`` to search: all; if too long, as much as the ``windows`` [s] need, or the first strokes.

    >>> wave = np.sin(np.arange(rules.MOST_SAMPLES + 1) * 1e-3)
    >>> hour = Record.from_arrays(1e-3, wave, wave, wave)
    >>> [len(part) for part in beginnings((hour,), None)], [len(part) for part in beginnings((hour,), (5.0, 60.0))]
    ([150001], [60000])
    """
    if sum(map(len, records)) <= rules.MOST_SAMPLES:
        return records
    last = max((window[1] for window in windows if window is not None), default=None)
    parts = []
    for record in records:
        if last is None:
            moving = int(np.argmax(record.q_ref != record.q_ref[0]))
            stop = moving + rules.SEARCHED // len(records)
        else:
            stop = round(last / record.period)
        parts.append(record.until(stop))
    return tuple(parts)


def check_the_rest(
    records: tuple[Record, ...], parts: tuple[Record, ...], laws: tuple[LawCheck, ...], extended: Hypothesis
) -> tuple[tuple[Message, ...], bool]:
    """Messages about the residual of ``extended``, fitted to ``parts``, on whole ``records``; whether it is too large.

    One simulation of each whole record shows later changes. ``parts`` are the :func:`beginnings`; ``laws`` their
    checks, one per record if the controller is known.
    """
    remarks, fails = list[Message](), False
    for index, (record, searched) in enumerate(zip(records, parts, strict=True)):
        if len(searched) == len(record):
            continue
        head = (
            f"{record.name}: only {searched.duration:.4g} of {record.duration:.4g} s were searched, "
            f"because {len(record)} samples are too many"
        )
        hypothesis = extended.only(index)
        if laws and laws[index].unexplained:
            record = with_law_gap(
                record, replace(laws[index], gap=record.u - law_voltage(record, hypothesis.problem.axis))
            )
        whole = Hypothesis(replace(hypothesis.problem, records=(record,)), hypothesis.model)
        try:
            (residual,) = whole.residuals()
        except SimulationError as error:
            text = f"{head}; the model cannot be simulated to the end: {error}"
            remarks.append(warning("rest-not-simulated", text, record=record.name))
            fails = True
            continue
        size = round(rules.PIECE_TIME / record.period)
        pieces = (
            residual[rules.START_UP :][: (residual.size - rules.START_UP) // size * size].reshape(-1, size).std(axis=1)
        )
        usual, most = float(np.median(pieces[: len(searched) // size])), int(np.argmax(pieces))
        whole_rms, largest_rms, usual_rms = (
            hypothesis.problem.axis.units.quantity(float(rms), "N", rounded)
            for rms in (np.std(residual[rules.START_UP :]), pieces[most], usual)
        )
        text = f"{head}; over the whole record the residual is {whole_rms}"
        if pieces[most] > rules.UNUSUAL * usual:
            fails = True
            text += (
                f", but {largest_rms} in the {rules.PIECE_TIME:g} s from {most * rules.PIECE_TIME:g} s on, against "
                f"{usual_rms} as a rule: another effect acts there, or the machine changed; examine it with `fit_time`"
            )
        remarks.append(warning("part-searched", text, record=record.name, searched=searched.duration))
    return tuple(remarks), fails
