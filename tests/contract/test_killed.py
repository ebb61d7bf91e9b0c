"""Killed at any moment, a command leaves whole files or none; the next run cleans up after it."""

import pytest

from tests.kills import COMMANDS, SIGNALS, Kills


@pytest.mark.slow
@pytest.mark.parametrize("name", COMMANDS)
def test_killed_at_any_moment(name, tmp_path):
    killed = Kills(name, tmp_path)
    killed.run(len(SIGNALS))
    assert killed.statuses.total() == len(SIGNALS)
