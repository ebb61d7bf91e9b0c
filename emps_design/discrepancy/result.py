"""The result of a diagnosis: findings, gap before and after, data of its views, extended model."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

from emps_design.axis import Axis
from emps_design.discrepancy import rules
from emps_design.discrepancy.closest import Closest
from emps_design.discrepancy.experiment import NextExperiment
from emps_design.discrepancy.gap import Gap, Prediction
from emps_design.discrepancy.noise_floor import Floor
from emps_design.discrepancy.placement import EVERYWHERE
from emps_design.discrepancy.residual_views import View as ResidualView
from emps_design.discrepancy.unexplained import like
from emps_design.discrepancy.view import diagnosis_view
from emps_design.frequency_response.coupling import ResponseComparison
from emps_design.quantities import inside, rounded
from emps_design.units import LINEAR, Units
from emps_design.view import View, Viewed

SCHEMA = "emps-design/diagnosis/1"


@dataclass(frozen=True)
class Finding:
    """One accepted effect: where it acts, its parameters, and the force gap [N] before and after it was added.

    ``confirmed`` is its share on the held-out record, with the standard deviation; None if not determined.
    """

    effect: str
    label: str
    channel: str
    where: Mapping[str, Any]
    parameters: Mapping[str, Mapping[str, Any]]
    p_value: float
    gap_before: float
    gap_after: float
    confirmed: Mapping[str, float] | None = None
    equivalents: tuple[str, ...] = ()
    remedy: str = ""
    note: str = ""

    def to_dict(self, units: Units = LINEAR) -> dict[str, Any]:
        """The contract's entry of ``findings``, with the ``units`` of the axis."""
        entry = {
            "equivalents": list(self.equivalents),
            "where": {"channel": self.channel, **self.where},
            "parameters": {
                name: {**table, "unit": units.unit(table["unit"])} for name, table in self.parameters.items()
            },
            "confirmed": None if self.confirmed is None else dict(self.confirmed),
        }
        names = ("effect", "label", *entry, "p_value", "gap_before", "gap_after", "note")
        return {name: entry.get(name, getattr(self, name)) for name in names}

    def in_words(self, units: Units) -> str:
        """The finding with its parameters, for a sentence."""
        numbers = ", ".join(
            f"{units.words(name.replace('_', ' '))} {in_unit(table['value'], table['std'], table['unit'], units)}"
            for name, table in self.parameters.items()
            if (table["std"] > 0 or self.channel == "controller") and not table.get("per_record")
        )
        others = f" (or {', '.join(e.replace('_', ' ') for e in self.equivalents)})" if self.equivalents else ""
        return f"{self.acts(units)}: {self.label}{others}" + (f", {numbers}" if numbers else "")

    def acts(self, units: Units) -> str:
        """Where and how strongly it acts, for a sentence."""
        force, place = self.where["force"], self.where["text"]
        much = f"up to {force['value']:.3g} {force['unit']}"
        if self.channel == "controller":
            text = f"the controller adds {much}"
        elif force["sense"] == "more or less":
            text = f"the motor's {units.word('force')} differs from the model's by {much}"
        else:
            text = f"the motor needs {much} {force['sense']} than the model predicts"
        return text if place == EVERYWHERE else f"{place}, {text}"


def in_unit(value: float, std: float, unit: str, units: Units) -> str:
    """``value +- std`` [SI of ``unit``] in a readable unit of an axis.

    >>> in_unit(0.0016, 2e-6, "s", Units()), in_unit(0.02, 1e-6, "m", Units("rotary"))
    ('1.600 +- 0.002 ms', '1.14592 +- 0.00006 deg')
    """
    shown, factor = units.readable(value, unit)
    if std <= 0:
        return f"{value * factor:.4g} {shown}".rstrip()
    places = max(0, -math.floor(math.log10(std * factor)))
    return f"{value * factor:.{places}f} +- {std * factor:.{places}f} {shown}".rstrip()


@dataclass(frozen=True)
class Diagnosis(Viewed):
    """The result of :func:`emps_design.discrepancy.diagnose`.

    ``trace`` is the force over time of the held-out record, or of the training record; ``response`` the frequency
    response of excited records beside that of the extended model; ``closest`` the model that follows the records most
    closely, if requested.
    """

    verdict: str
    findings: tuple[Finding, ...]
    axis: Axis
    noise: Floor
    train: Gap
    holdout: Gap | None
    trace: Prediction
    views: tuple[ResidualView, ...]
    details: Mapping[str, Any] = field(default_factory=dict)
    experiment: NextExperiment | None = None
    response: ResponseComparison | None = None
    closest: Closest | None = None
    model_file: str | None = None

    @property
    def floor(self) -> float:
        """Rms [N] of the noise of the unfiltered force."""
        return self.noise.force

    @property
    def sentence(self) -> str:
        """The result in words, followed by the held-out data and the parts of the records that were not searched."""
        confirming = self.details.get("held_out", {}).get("text", "")
        return " ".join(
            [self._answer, *filter(None, [confirming]), *(f"{rest}." for rest in self.details.get("rest", ()))]
        )

    @property
    def _answer(self) -> str:
        judged, where = (self.holdout, "held-out") if self.holdout else (self.train, "training")
        units, force = self.axis.units, partial(self.axis.units.quantity, base="N", spec=rounded)
        before, remaining, noise = map(force, (judged.baseline, judged.extended, self.floor))
        error = f"{units.word('force')} error"
        gap = f"{where} {error} {before} -> {remaining}, noise {noise}"
        if self.verdict in ("named", "ambiguous", "partly-named"):
            if len(self.findings) <= rules.FEW:
                text = "; ".join(finding.in_words(units) for finding in self.findings)
            else:
                text = f"{len(self.findings)} effects are missing: "
                text += ", ".join(
                    f"{inside(f.label)} (up to {units.quantity(f.where['force']['value'], 'N', '.3g')})"
                    for f in self.findings
                )
            rest = ""
            if self.verdict == "partly-named":
                rest = f" No effect explains the rest: {self.details['unexplained']['text']}."
            return f"{text[0].upper()}{text[1:]}; {gap}.{rest}"
        if self.details.get("interrupted") and not self.findings:
            return f"Interrupted before an effect was found; {gap}."
        if self.verdict == "unnamed":
            unexplained = self.details["unexplained"]
            place = unexplained["place"]
            where = "" if place == EVERYWHERE else f", most of it {place}"
            known = "".join(f"{finding.in_words(units)}; " for finding in self.findings)  # from the controller's law
            errors = remaining
            if self.holdout is not None:
                part = "record" if self.trace.window is None else "part"
                sides = (
                    f"{remaining} on the held-out {part}",
                    f"{force(self.train.extended)} on the training {part}",
                )
                errors = ", ".join(sides if unexplained["record"] == "holdout" else sides[::-1])
            text = f"{known}{'in addition, ' if known else ''}the {error} is {errors}"
            text = f"{text[0].upper()}{text[1:]} (noise {noise}){where}, and no effect of the library explains it"
            if "law_gap" in unexplained:
                law_gap = units.quantity(unexplained["law_gap"], "V", rounded)
                text += f", nor the {law_gap} rms by which the command differs from the controller's law"
            if unexplained["kind"]:
                text += f"; {like(unexplained['kind'], unexplained['kind_leaves'], units)}"
            return f"{text}."
        least = self.details.get("least_visible")
        rest = f"; an effect of {least} or more would have been found" if least else ""
        if self.verdict == "parameters-only":
            changed = self.details.get("changed", "")
            return f"Only the parameters of the axis file are wrong ({changed}); {gap}{rest}."
        return f"Nothing is missing from the model: {error} {before}, noise {noise}{rest}."

    def to_dict(self) -> dict[str, Any]:
        """The contract's document, with further entries for the report.

        | key | content |
        |---|---|
        | ``simulation`` | "closed loop", or "inverse model" where the controller is not known |
        | ``unexplained`` | for ``unnamed`` and ``partly-named``: {rms [N], share, over, predicted, text, map, ...} |
        | ``regions`` | of a ``where``, if tested: {false_discovery_rate, proposed, passed, speed, position, time} |
        | ``spectrum_over_time`` | {time [s], frequency [Hz], force [N]}: residual of the baseline |
        | ``candidates`` | [{effect, label, gap [N], statistic, threshold, accepted: bool, note}], best first |
        | ``parameters`` | {name: {unit, axis, baseline: {value, std}, extended: {value, std}}} |
        | ``not_excluded`` | [{effect, label, size, unit, text}]: the smallest size that would have been found |
        | ``experiment`` | :meth:`NextExperiment.to_dict`: a record that separates what these data cannot, or None |
        | ``response`` | of records with an excitation: {coupling, model}, as in ``frf --json`` |
        | ``closest`` | if requested: {text, model_file, effects, gap, gap_inverse_60hz, share_of_force} |
        | ``held_out`` | {what, chosen: given, kept, in turn or none, time [s] or None, text} of ``gap.holdout`` |
        | ``records`` | [{name, role, sha256}] with role "train" or "holdout" |
        | ``calibration`` | str, how the threshold was found |
        | ``assumptions``, ``warnings`` | [str] |
        """
        unit = self.axis.units.unit("N")
        judged = {"train": self.train} | ({} if self.holdout is None else {"holdout": self.holdout})
        gap, inverse = (
            {"unit": unit, **self.noise.to_dict(measure)} | {part: g.to_dict(measure) for part, g in judged.items()}
            for measure in ("", "_60hz")
        )
        shown = {k: v for k, v in self.details.items() if k not in ("least_visible", "changed", "rest")}
        return {
            "schema": SCHEMA,
            "verdict": self.verdict,
            "sentence": self.sentence,
            "findings": [finding.to_dict(self.axis.units) for finding in self.findings],
            "gap": gap,
            "gap_inverse_60hz": inverse,
            "model_file": self.model_file,
            # Once for all lines of a ripple.
            "remedies": list(dict.fromkeys(f.remedy for f in self.findings if f.remedy)),
            "experiment": None if self.experiment is None else self.experiment.to_dict(self.axis.units),
            **({} if self.response is None else {"response": self.response.to_dict()}),
            **({} if self.closest is None else {"closest": self.closest.to_dict(unit, self.model_file is not None)}),
            **shown,
        }

    def with_file(self, model_file: str) -> Diagnosis:
        """The same with the name of the model file; the reference of the experiment is written beside it."""
        written = None if self.experiment is None else self.experiment.written()
        return replace(self, model_file=model_file, experiment=written)

    def view(self) -> View:
        """The answer, its findings, and what to do next."""
        return diagnosis_view(self.to_dict(), self.axis.units)
