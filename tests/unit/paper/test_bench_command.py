"""``simulate --scenario bench``: Tables I and II beside the printed ones, the same bytes for the same seed."""

import json

import pytest

from emps_design.cli.app import run
from emps_design.paper.written import TABLES


@pytest.mark.study("ten experiments")
def test_the_bench_gives_tables_and_ranges(capsys):
    assert run(["simulate", "--scenario", "bench", "--json"]) == 0
    first = capsys.readouterr().out
    found = json.loads(first)
    assert found["printed"]["table_2"]["mass"] == list(TABLES["table_2"]["mass"])
    for table in ("table_1", "table_2"):
        for name, (value, _, _) in TABLES[table].items():
            assert found[table][name][0] == pytest.approx(value, rel=0.13), (table, name)


@pytest.mark.study("the bench, twice")
def test_the_bench_takes_another_force_of_the_hand(capsys):
    assert run(["simulate", "--scenario", "bench", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert run(["simulate", "--scenario", "bench", "--tau-ref", "1.5", "--json"]) == 0
    other = json.loads(capsys.readouterr().out)
    assert other["numbers"]["tau_ref"] == 1.5
    assert other["table_1"] == found["table_1"]
    assert other["table_2"] != found["table_2"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (
            ["--scenario", "bench", "--out", "run.npz"],
            "or breakaway, found bench",
        ),
        (["emps2018", "--scenario", "bench"], "the bench has its own machine"),
        (["--scenario", "comanipulation", "--tau-ref", "1"], "requires --scenario bench, found comanipulation"),
    ],
)
def test_what_does_not_fit_the_bench_is_refused(capsys, arguments, message):
    assert run(["simulate", *arguments]) == 2
    assert message in capsys.readouterr().err
