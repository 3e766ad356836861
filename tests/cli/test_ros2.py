"""The command line over real ROS 2: components outlive their manager, and `down` ends them."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from tests.cli.conftest import EXAMPLES, Midstride, alive, nothing_lost, unwritten

TALKER = str(EXAMPLES / "talker" / "talker.json")

pytestmark = pytest.mark.ros2


def until(condition: Callable[[], bool], what: str) -> None:
    deadline = time.monotonic() + 20
    while not condition():
        assert time.monotonic() < deadline, what
        time.sleep(0.02)


def heard(midstride: Midstride) -> str:
    """The last line in the listener's log."""
    log = midstride.runtime / "midstride" / "talker" / "logs" / "listener.log"
    return log.read_text().splitlines()[-1].rpartition("]: ")[2]


@pytest.mark.full
def test_what_up_was_given_holds_for_the_next_manager_and_for_new_components(midstride: Midstride) -> None:
    up = midstride("up", TALKER, "-d", "--use-sim-time", "--no-middleware-settings")
    assert up.status == 0, up.err
    os.kill(midstride.manager("talker"), signal.SIGKILL)
    assert midstride("up", TALKER, "-d").status == 0
    assert midstride("replace", "talker", "NewTalker", "--strategy", "paper", "--yes", timeout=90).status == 0
    status = midstride("status", "--json").json
    assert [(row["name"], row["simulated_time"]) for row in status["components"]] == [
        ("listener", True),
        ("talker_2", True),
    ]
    assert status["middleware"]["set"] == {}
    assert "--no-middleware-settings" in status["middleware"]["notes"][0]
    for row in status["components"]:
        environment = Path(f"/proc/{row['pid']}/environ").read_bytes()
        assert b"FASTDDS_" not in environment and b"FASTRTPS_" not in environment
    verbose = midstride("status", "--verbose").out
    assert "/clock" in verbose and "python3 new_talker.py" in verbose


def test_a_system_from_up_to_down(midstride: Midstride) -> None:
    up = midstride("up", TALKER, "-d")
    assert up.status == 0, up.err
    before = midstride.components("talker")
    replaced = midstride("replace", "talker", "NewTalker", "--yes", "--json")
    assert replaced.status == 0, replaced.out
    assert nothing_lost(replaced.json["swaps"]), replaced.json["swaps"]
    assert not any(replaced.json["fallen"].values())
    assert "good news from talker_2" in heard(midstride)
    after = midstride.components("talker")
    assert len(set(before) & set(after)) == 1  # the listener is the same process
    assert midstride("down").status == 0
    until(lambda: not any(map(alive, {*before, *after})), "components are left")


def test_components_outlive_their_manager_and_are_reattached(midstride: Midstride) -> None:
    assert midstride("up", TALKER, "-d").status == 0
    assert midstride("replace", "talker", "NewTalker", "--yes").status == 0
    components = midstride.components("talker")
    os.kill(midstride.manager("talker"), signal.SIGKILL)
    last = heard(midstride)
    until(lambda: heard(midstride) != last, "the listener hears nothing any more")
    done = midstride("status")
    assert done.status == 1
    assert "its components may still be running: `midstride up FILE` reattaches to them" in done.err
    with unwritten(midstride) as late:
        up = midstride("up", TALKER, "-d")
        assert up.status == 0, up.err
        assert late.wait(20) == -signal.SIGTERM
    assert "stopped late, which an earlier manager had just started" in up.out
    assert "talker_2 was reattached unchanged" in up.out
    assert "was already running and differs from" in up.err  # the file says Talker, a NewTalker runs
    assert midstride.components("talker") == components
    assert midstride("status", "--json").json["valid"]
    back = midstride("apply", TALKER, "--yes", "--json").json
    assert back["outcome"] == "done"
    assert nothing_lost(back["swaps"]), back["swaps"]


def test_down_stops_the_components_of_a_killed_manager(midstride: Midstride) -> None:
    assert midstride("up", TALKER, "-d").status == 0
    components = midstride.components("talker")
    os.kill(midstride.manager("talker"), signal.SIGKILL)
    assert all(map(alive, components))
    assert midstride("down").out == "talker is down.\n"
    assert not any(map(alive, components))


@pytest.mark.full
def test_a_terminated_manager_leaves_the_components_running(midstride: Midstride) -> None:
    assert midstride("up", TALKER, "-d").status == 0
    manager, components = midstride.manager("talker"), midstride.components("talker")
    os.kill(manager, signal.SIGTERM)
    until(lambda: not alive(manager), "the manager does not end")
    assert all(map(alive, components))
    assert midstride("up", TALKER, "-d").status == 0
    assert midstride.components("talker") == components
