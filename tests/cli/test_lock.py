"""`lock` and `unlock` by the command line: what they refuse, where a lock shows, and that it outlives the manager."""

from __future__ import annotations

import os
import signal
import time
from datetime import datetime, timedelta

import click
import pytest

from midstride.cli.commands.lock_commands import Duration, LocalTime
from tests.cli.conftest import EXAMPLES, Midstride

TALKER = str(EXAMPLES / "talker" / "talker.stride")
LOCKED = "the system is locked by alice since"


def words_of(text: str) -> str:
    """What a table says, on one line: long cells are folded."""
    return " ".join(text.split())


@pytest.mark.full
def test_every_command_that_changes_the_system_is_refused_and_says_why(talker: Midstride) -> None:
    locked = talker("lock", "--reason", "the brake is held", "--by", "alice", "--for", "2h")
    assert (locked.status, locked.err) == (0, "")
    assert (
        locked.out.startswith("The system is locked by alice since") and ": the brake is held (it holds" in locked.out
    )
    for words in (
        ["replace", "talker", "NewTalker", "--yes"],
        ["restart", "talker", "--yes"],
        ["remove", "talker", "--yes"],
        ["add", "second", "Listener", "in=/chatter", "--yes"],
        ["apply", TALKER, "--yes"],
        ["param", "set", "listener", "use_sim_time", "true"],
    ):
        done = talker(*words)
        assert done.status == 1 and LOCKED in done.out + done.err and "the brake is held" in done.out + done.err, words
    assert talker("replace", "talker", "NewTalker", "--yes", "--json").json["outcome"] == "refused"
    status = talker("status", "--json").json
    assert status["lock"]["by"] == "alice" and status["lock"]["until"] == pytest.approx(time.time() + 7200, abs=60)
    assert "The system is locked by alice" in talker("status").out
    plan = talker("plan", "--replace", "talker=NewTalker")
    assert plan.status == 0 and f"It may not be carried out now: {LOCKED}" in plan.out
    assert LOCKED in talker("log").out
    history = words_of(talker("history").out)
    assert LOCKED in history and "replace talker with NewTalker: refused, since" in history
    again = talker("lock", "--reason", "mine", "--by", "bob")
    assert again.status == 1 and "`midstride unlock` ends that lock" in again.err
    override = talker("restart", "talker", "--yes", "--despite-lock")
    assert override.status == 0 and "carried out although the system is locked by alice" in words_of(
        talker("history").out
    )
    assert talker("unlock", "--by", "bob").out == "Unlocked. alice had locked it: the brake is held\n"
    assert talker("unlock").status == 1
    assert talker("restart", "talker", "--yes").status == 0


@pytest.mark.full
def test_a_lock_outlives_the_manager_and_does_not_prevent_down(midstride: Midstride) -> None:
    assert midstride("up", TALKER, "--backend", "sim", "-d").status == 0
    assert midstride("lock", "--reason", "moving", "--by", "alice", "--also-recovery").status == 0
    os.kill(midstride.manager("talker"), signal.SIGKILL)
    # The processes of the simulator end with their manager; the next one starts them again.
    assert midstride("up", TALKER, "--backend", "sim", "-d").status == 0
    assert midstride("restart", "talker", "--yes").status == 1
    assert midstride("status", "--json").json["lock"]["holds_recovery"] is True
    down = midstride("down")
    assert (down.status, down.out) == (0, "talker is down.\n")
    assert LOCKED in down.err and "`down` stops it all the same" in down.err
    assert "although the system is locked by alice" in words_of(midstride("history").out)


@pytest.mark.parametrize(
    ("words", "error"),
    [
        (["lock"], "missing option '--reason'"),
        (["lock", "--reason", " "], "--reason is empty"),
        (["lock", "--reason", "x", "--for", "2"], "'2' is no time such as 90s, 5m, 2h or 1d"),
        (["lock", "--reason", "x", "--for", "0s"], "'0s' is no time"),
        (["lock", "--reason", "x", "--until", "25:00"], "'25:00' is no time of day"),
        (["lock", "--reason", "x", "--until", "2001-01-01"], "is in the past"),
        (["lock", "--reason", "x", "--until", "noon"], "is no time such as 18:30"),
        (["lock", "--reason", "x", "--for", "1h", "--until", "18:30"], "exclude each other"),
    ],
)
def test_what_is_wrong_is_said(midstride: Midstride, words: list[str], error: str) -> None:
    done = midstride(*words)
    assert done.status == 2 and error in done.err


def test_times() -> None:
    assert [Duration().convert(text, None, None) for text in ("90s", "5m", "2h", "1.5d")] == [90, 300, 7200, 129600]
    now = datetime.now()
    assert 0 < LocalTime().convert(now.strftime("%H:%M"), None, None) - now.timestamp() <= 86400
    tomorrow = (now + timedelta(days=1)).replace(microsecond=0)
    assert LocalTime().convert(tomorrow.isoformat(), None, None) == tomorrow.timestamp()
    with pytest.raises(click.BadParameter):
        LocalTime().convert("12:75", None, None)
