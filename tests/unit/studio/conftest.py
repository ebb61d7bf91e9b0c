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

    monkeypatch.setattr("emps_design.studio.jobs.Job.start", start)
