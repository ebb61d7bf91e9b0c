"""The regions in which a force is placed: none on healthy drives, and the right one where an effect is local."""

import pytest

from emps_design import diagnose
from emps_design.discrepancy import rules
from emps_design.discrepancy.calibration import first_noise
from emps_design.discrepancy.fit import fit
from emps_design.discrepancy.placement import placement
from emps_design.discrepancy.preparation import prepare
from emps_design.discrepancy.problem import Hypothesis
from emps_design.effects import known_effects
from emps_design.inputs import read_axis, read_record
from tests.hidden.generate import Case, make, write

SEED = 20010  # not looked at before the rule was written
DRIVES = 30


def read(folder, case, seed):
    """The axis, the record that is fitted and the one that confirms."""
    write(folder / case.name, make(case, seed))
    axis = read_axis(str(folder / case.name / "axis.toml"))
    return axis, *(read_record(folder / case.name / f"{name}.npz", axis) for name in ("train", "holdout"))


@pytest.mark.study("thirty healthy drives")
def test_on_healthy_drives_no_more_than_the_stated_share_has_a_region(tmp_path):
    library, placed = tuple(known_effects().values()), 0
    for number in range(DRIVES):
        axis, train, holdout = read(tmp_path, Case((), 1, number), SEED)
        rough, floor = first_noise(prepare((train,), axis, library, holdout, None, None, None))
        weighed = Hypothesis(rough.problem.with_whitening(floor.whitening), rough.model)
        placed += bool(placement(fit(weighed, "used"), 0, rules.SOME * floor.force).passed)
    assert placed <= rules.FALSE_REGIONS * DRIVES


@pytest.mark.study("three diagnoses with the whole library")
@pytest.mark.parametrize(
    ("effect", "over"),
    [("end_stop", "position"), ("position_dependent_friction", "position"), ("backlash", "speed")],
)
def test_a_local_effect_is_placed_where_it_is(tmp_path, effect, over):
    axis, train, holdout = read(tmp_path, Case((effect,), 2, 2), SEED)
    answer = diagnose((train,), axis, holdout=holdout)
    where = next(finding.where for finding in answer.findings if finding.effect == effect)
    assert where["regions"][over], where["text"]
