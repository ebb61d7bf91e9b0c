"""What tests of the studio share."""

import pytest

from emps_design.errors import EmpsError


@pytest.fixture
def at_once(monkeypatch):
    """Work of a tab done where it is started."""

    def start(job, work, done, failed):
        try:
            found = work(lambda stage, share: None)
        except EmpsError as error:
            failed(str(error))
        else:
            done(found)
        return True

    monkeypatch.setattr("emps_design.studio.panes.Job.start", start)


@pytest.fixture(autouse=True)
def _record_not_drawn(monkeypatch):
    """An empty picture of each record that a tab shows: what is in it is tested with the pictures of reports."""
    from matplotlib.figure import Figure

    monkeypatch.setattr("emps_design.report.record.record_figure", lambda record, units: Figure())
