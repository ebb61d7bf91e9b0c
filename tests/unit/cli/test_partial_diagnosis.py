"""What an interrupted diagnosis knew goes beside the folder that was asked for, whatever that is called."""

import json
from pathlib import Path

import pytest

from emps_design.commands.diagnose import PartialDiagnosis


@pytest.mark.parametrize("out", ["found", ".", "../work", "work/.."])
def test_it_stands_beside_the_folder(tmp_path, monkeypatch, out):
    work = tmp_path / "work"
    (work / "work").mkdir(parents=True)
    monkeypatch.chdir(work)
    PartialDiagnosis(Path(out)).write()
    beside = (work / out).resolve()
    left = json.loads((beside.parent / f"{beside.name}.partial" / "partial.json").read_text())
    assert left["interrupted"]
    assert left["stage"] == "reading"


def test_without_a_folder_nothing_is_written(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    PartialDiagnosis(None).write()
    assert list(tmp_path.iterdir()) == []
