"""The command line over real ROS 2: components outlive their manager, and `down` ends them."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from midstride.codec.specification_form import encode_specification
from midstride.foreign.page import PAGE
from midstride.foreign.page_layout import OLDEST, VERSION, PageLayout
from midstride.runtime.handover.new_publishers import ATTACH_TIMEOUT
from tests.acceptance.foreign_support import declared_talker, programs_of_the_page
from tests.acceptance.support import PERIOD, Recorder, components_looked_at, ended, swap_specification
from tests.acceptance.test_fencing import WAIT, hanging_specification
from tests.acceptance.test_manager_killed import silent_since
from tests.cli.conftest import EXAMPLES, Midstride, alive, nothing_lost, unwritten

TALKER = str(EXAMPLES / "talker" / "talker.stride")

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
    up = midstride("up", TALKER, "-d", "--use-sim-time", "--no-middleware-settings", "--no-diagnostics")
    # Nothing publishes on /clock, so the talker is not called.
    assert up.status == 3 and "nothing has arrived on /clock" in up.out, up.out + up.err
    os.kill(midstride.manager("talker"), signal.SIGKILL)
    assert midstride("up", TALKER, "-d").status == 3
    assert midstride("replace", "talker", "NewTalker", "--strategy", "paper", "--yes", timeout=90).status == 0
    status = midstride("status", "--json").json
    assert [(row["name"], row["simulated_time"]) for row in status["instances"]] == [
        ("listener", True),
        ("talker_2", True),
    ]
    assert status["middleware"]["set"] == {}
    assert "--no-middleware-settings" in status["middleware"]["notes"][0]
    for row in status["instances"]:
        environment = Path(f"/proc/{row['pid']}/environ").read_bytes()
        assert b"FASTDDS_" not in environment and b"FASTRTPS_" not in environment
        assert b"MIDSTRIDE_DIAGNOSTICS=0" in environment.split(b"\0")
    verbose = midstride("status", "--verbose").out
    assert "/clock" in verbose and "python3 new_talker.py" in verbose


def test_a_system_from_up_to_down(midstride: Midstride) -> None:
    up = midstride("up", TALKER, "-d")
    assert up.status == 0, up.err
    where = re.search(r"Middleware: (rmw_\w+ in domain \d+ on ROS 2 \w+)", midstride("status", "--verbose").out)
    words = [incident["words"] for incident in midstride("history", "--json").json["incidents"]]
    assert where is not None and f"talker is up with {where[1]}: 2 components" in words
    before = midstride.components("talker")
    replaced = midstride("replace", "talker", "NewTalker", "--yes", "--json")
    assert replaced.status == 0, replaced.out
    assert nothing_lost(replaced.json["swaps"], "ros2"), replaced.json["swaps"]
    assert not any(replaced.json["below_baseline_seconds"].values())
    assert "good news from talker_2" in heard(midstride)
    after = midstride.components("talker")
    assert len(set(before) & set(after)) == 1  # the listener is the same process
    assert midstride("down").status == 0
    until(lambda: not any(map(alive, {*before, *after})), "components are left")


@pytest.mark.full
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
        assert late.wait(20) == -signal.SIGINT
    assert "stopped late, which an earlier manager had just started" in up.out
    assert "talker_2 was reattached unchanged" in up.out
    assert "was already running and differs from" in up.err  # the file says Talker, a NewTalker runs
    assert midstride.components("talker") == components
    assert midstride("status", "--json").json["valid"]
    back = midstride("apply", TALKER, "--yes", "--json").json
    assert back["outcome"] == "done"
    assert nothing_lost(back["swaps"], "ros2"), back["swaps"]


def killed(midstride: Midstride, system: str, *roles: str) -> None:
    """Kill the manager of a system, and with it the instances of some roles."""
    components = midstride("status", "--system", system, "--json").json["instances"]
    os.kill(midstride.manager(system), signal.SIGKILL)
    for pid in [entry["pid"] for entry in components if entry["role"] in roles]:
        os.kill(pid, signal.SIGKILL)
        until(lambda pid=pid: not alive(pid), "it was killed")  # type: ignore[misc]


@pytest.mark.full
def test_up_restores_what_has_died_with_the_manager(midstride: Midstride) -> None:
    assert midstride("up", TALKER, "-d").status == 0
    (listener,) = [entry for entry in midstride.saved("talker").instances if entry.instance.role == "listener"]
    killed(midstride, "talker", "talker")
    up = midstride("up", TALKER, "-d")
    assert up.status == 0, up.err
    lines = [" ".join(line.split()[1:]) for line in up.out.splitlines()]
    assert lines[:2] == ["listener was reattached unchanged", "talker is no longer running"]
    degraded = lines[2] == "degrade listener.listen from normal to degraded"
    assert degraded or lines[2].startswith("1/4 create talker"), "unless the listener has degraded itself meanwhile"
    assert any(line.startswith("4/4 upgrade listener.listen from degraded to normal") for line in lines)
    assert midstride("status", "--json").json["valid"]
    assert listener in midstride.saved("talker").instances, "the same process"
    log = midstride.runtime / "midstride" / "talker" / "logs" / "listener.log"
    length = log.stat().st_size
    until(lambda: "I heard" in log.read_text()[length:], "the listener hears nothing")
    killed(midstride, "talker", "talker", "listener")
    assert midstride("up", TALKER, "-d").status == 0
    assert midstride("status", "--json").json["valid"]


@pytest.mark.full
def test_nodes_whose_gates_another_version_has_made_can_be_ended(midstride: Midstride, tmp_path: Path) -> None:
    specification = tmp_path / "gated.stride"
    talker = declared_talker("Plain", "python3 talker.py", "preload")
    head, node = "system gated\ntopic /chat : std_msgs/msg/String @ 50 Hz", "node talker : Plain { out -> /chat }"
    specification.write_text(f"{head}\n{talker}{node}\n", encoding="utf-8")
    programs_of_the_page(tmp_path)
    up = midstride("up", str(specification), "-d")
    assert up.status == 0, up.err
    before = midstride.components("gated")
    os.kill(midstride.manager("gated"), signal.SIGKILL)
    (page,) = (midstride.runtime / "midstride" / "gated" / "components").rglob(PAGE)
    with page.open("r+b") as file:
        file.seek(PageLayout.version.offset)
        file.write((VERSION + 1).to_bytes(4, sys.byteorder))
    refused = midstride("up", str(specification), "-d")
    assert refused.status == 1
    assert f"has layout {VERSION + 1}, and this version uses {OLDEST} to {VERSION}" in refused.err
    assert "use that version, or `midstride down`, and start the system again" in refused.err
    assert all(map(alive, before)), "it goes on"
    down = midstride("down")
    assert down.status == 0, down.err
    until(lambda: not any(map(alive, before)), "it is left")


@pytest.mark.full
def test_a_component_that_is_stopped_is_named_by_up_with_what_to_do(midstride: Midstride) -> None:
    assert midstride("up", TALKER, "-d").status == 0
    (pid,) = [c["pid"] for c in midstride("status", "--json").json["instances"] if c["role"] == "listener"]
    os.kill(pid, signal.SIGSTOP)
    try:
        killed(midstride, "talker", "talker")
        up = midstride("up", TALKER, "-d")
        assert up.status == 1
        assert f"listener runs (process {pid}), but does not answer on its control socket" in up.err
        assert f"continue it (`kill -CONT {pid}`) or end it (`kill -9 {pid}`), then run `midstride up` again" in up.err
    finally:
        os.kill(pid, signal.SIGCONT)
    assert midstride("up", TALKER, "-d").status == 0
    assert midstride("status", "--json").json["valid"]


@pytest.mark.full
def test_what_does_not_depend_on_the_dead_one_is_not_disturbed(midstride: Midstride, tmp_path: Path) -> None:
    """A bare recorder of the source's topic notices neither the deaths of manager and sink nor that they return."""
    specification = swap_specification()
    file = tmp_path / "swap.json"
    file.write_text(json.dumps(encode_specification(specification)))
    with ended() as token, components_looked_at(token) as starved:
        assert midstride("up", str(file), "-d").status == 0
        recorder = Recorder(tmp_path)
        recorder.wait_until_it_hears()
        killed(midstride, specification.name, "sink")
        up = midstride("up", str(file), "-d")
        assert up.status == 0, up.err
        assert "create sink" in up.out and "source was reattached unchanged" in up.out
        rows = recorder.stop()
        assert midstride("down").status == 0
    assert max(silent_since(rows))[0] <= 10 * PERIOD + starved.longest


@pytest.mark.full
def test_a_component_started_by_hand_keeps_a_system_whose_other_components_have_died(
    midstride: Midstride, tmp_path: Path
) -> None:
    """Nothing but its control socket shows that it runs, and it obeys only the token of the earlier manager."""
    text = Path(TALKER).read_text().replace('  run "python3 talker.py"\n', "")
    for file in (EXAMPLES / "talker").glob("*.py"):
        (tmp_path / file.name).write_text(file.read_text())
    (tmp_path / "talker.stride").write_text(text)
    command = [sys.executable, str(tmp_path / "talker.py"), "--system", "talker"]
    with subprocess.Popen(command, env=midstride.environment, start_new_session=True) as talker:
        try:
            assert midstride("up", str(tmp_path / "talker.stride"), "-d").status == 0
            killed(midstride, "talker", "listener")
            up = midstride("up", str(tmp_path / "talker.stride"), "-d")
            assert up.status == 0, up.err
            assert "talker was reattached unchanged" in up.out and "create listener" in up.out
            assert midstride("down").status == 0
        finally:
            talker.kill()


@pytest.mark.full
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


@pytest.mark.full
def test_a_publisher_that_hangs_is_replaced_within_the_stated_wait(midstride: Midstride, tmp_path: Path) -> None:
    """The report says what was done, and what the subscriber missed."""
    hang, file = tmp_path / "hang", tmp_path / "swap.json"
    specification = hanging_specification(tmp_path, hang)
    file.write_text(json.dumps(encode_specification(specification)))

    def hangs() -> bool:
        [source] = [row for row in midstride("status", "--json").json["instances"] if row["name"] == "source"]
        return any((row["busy"] or 0.0) > 1.0 for row in source["functionalities"])

    with ended() as token, components_looked_at(token) as starved:
        assert midstride("up", str(file), "-d").status == 0
        hang.touch()
        until(hangs, "the source does not hang")
        replaced = midstride("replace", "source", "OtherSource", "--wait", f"{WAIT:g}", "--yes")
        report = midstride("report", "--json").json
        assert midstride("down").status == 0
    outcome = report["outcome"]
    assert outcome["outcome"] == "done", outcome["because"]
    # Where all of it took more than 5 s, the subscriber has degraded by itself.
    assert replaced.status == 0 or {each["functionality"] for each in outcome["remaining_degradations"]} == {
        "sink.listen"
    }, replaced.out
    said, [swap] = " ".join(replaced.out.split()), outcome["swaps"]
    assert "Fenced: source hangs: user code did not return" in said
    assert f"{swap['missed']} missed" in said
    [number] = [number for number, step in enumerate(report["plan"]["steps"], 1) if step["action"] == "handover"]
    [seconds] = [each["seconds"] for each in outcome["steps"] if each["step"] == number]
    # The new side is ready, and the old one is asked once more, before it is fenced. To be ready it has found the
    # subscriber, for which discovery takes one more of its announcements (3 s apart) where it has lost the first.
    assert WAIT <= seconds < WAIT + 1.5 + ATTACH_TIMEOUT + starved.longest
    assert swap["missed"] >= (1.0 + WAIT) / PERIOD - 1
