"""Runs that are killed, also while they write, leave what they had reached."""

import sys

import pytest

kills = pytest.importorskip("benchmarks.robustness.kills")


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="signals of POSIX")
def test_what_runs_leave_that_are_ended():
    found, troubles = kills.attempt(4)  # one at each place
    assert not troubles
    assert found["failed"] == 0
    assert found["killed"] >= 1
