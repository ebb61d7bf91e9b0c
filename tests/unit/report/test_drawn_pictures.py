"""Pictures that commands write: the same figure, the same bytes."""

import pytest

from emps_design.cli import app
from emps_design.commands.destinations import PICTURES
from emps_design.machines import machine
from emps_design.report.style import UNDATED
from emps_design.simulation.synthetic import synthetic_record


@pytest.mark.parametrize("form", UNDATED)
@pytest.mark.parametrize(
    "line", ["simulate {axis} --scenario breakaway --plot {out}", "import {record} --axis {axis} --plot {out}"]
)
def test_a_picture_is_drawn_the_same_again(form, line, tmp_path, capsys):
    axis = machine("emps2019")
    names = {"axis": tmp_path / "axis.toml", "record": tmp_path / "record.npz"}
    names["axis"].write_text(axis.to_toml(), encoding="utf-8")
    synthetic_record(axis, laps=1, stroke=0.03).save(names["record"])
    pictures = []
    for name in ("first", "second"):
        out = tmp_path / f"{name}.{form}"
        assert app.run(line.format(out=out, **names).split()) == 0, capsys.readouterr().err
        pictures.append(out.read_bytes())
    assert pictures[0] == pictures[1]


def test_every_format_of_the_commands_is_known():
    assert {f".{form}" for form in UNDATED} == {*PICTURES}
