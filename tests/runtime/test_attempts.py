"""How many attempts a policy allows in its window, which only counts the time that the component runs."""

from __future__ import annotations

from midstride.model.respawn import RespawnPolicy
from midstride.runtime.restore.attempts import Attempts

POLICY = RespawnPolicy(max_retries=2, window=60.0)


def test_what_is_older_than_the_window_does_not_count() -> None:
    attempts = Attempts()
    for ran, number in [(40.0, 1), (50.0, 2), (90.0, None), (100.0, 2)]:
        attempts.ran = ran
        assert attempts.next(POLICY) == number, ran


def test_only_the_time_that_it_runs_counts() -> None:
    attempts = Attempts(runs_since=100.0)
    attempts.stopped(130.0)
    attempts.stopped(900.0)
    assert attempts.ran == 30.0
