"""A system on two hosts, over SSH and real ROS 2: network namespaces, an SSH server, and a link that can be cut."""

from __future__ import annotations

import json
import os
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest

from midstride.runtime.process.reaper import process_info
from tests.cli.conftest import EXAMPLES
from tests.hosts.robots import Robot, robots

pytestmark = [pytest.mark.ros2, pytest.mark.hosts]


@pytest.fixture
def robot() -> Iterator[Robot]:
    text = (EXAMPLES / "talker" / "talker.stride").read_text()
    moved = text.replace("node talker   : Talker ", "node talker : Talker on arm ")
    assert moved != text
    with robots(EXAMPLES / "talker", moved) as robot:
        yield robot


@pytest.mark.full
@pytest.mark.timeout(120)
def test_a_system_on_two_hosts_comes_up_is_changed_crashes_and_is_ended(robot: Robot) -> None:
    up = robot("up", robot.file, "-d")
    assert up.status == 0, up.out + up.err
    talker = robot.instance("talker")
    assert talker["host"] == "arm" and talker["log_file"].startswith(f"arm:{robot.workspace}/logs/")
    assert Path(f"/proc/{talker['pid']}/cwd").resolve() == robot.folder / "far"
    assert "I heard: hello world" in robot("logs", "listener").out
    assert robot("logs", "talker").status == 0
    replaced = robot("replace", "talker", "NewTalker", "--yes", "--json")
    assert replaced.status == 0 and replaced.json["outcome"] == "done", replaced.out + replaced.err
    (swap,) = replaced.json["swaps"]
    assert (swap["topic"], swap["missed"]) == ("/chatter", 0), swap
    os.kill(robot.instance("talker")["pid"], signal.SIGKILL)
    robot.until(lambda: robot.status["crashed"] != [], "the crash is noticed")
    assert robot("down").status == 0
    robot.until(lambda: not (robot.workspace / "host.sock").exists(), "the host process ends once nothing is left")


@pytest.mark.long
@pytest.mark.timeout(300)
def test_a_host_outlives_the_manager_the_link_and_its_own_process(robot: Robot) -> None:
    assert robot("up", robot.file, "-d").status == 0
    pid = robot.instance("talker")["pid"]
    started = process_info(pid)
    # The manager is killed, and the next one finds all as it was.
    os.kill(robot.manager, signal.SIGKILL)
    assert robot("up", robot.file, "-d").status == 0
    assert robot.instance("talker")["pid"] == pid
    # The link is cut: the host is unreachable, and nothing is started elsewhere.
    robot.hosts.link("down")
    robot.until(lambda: not robot.instance("talker")["reachable"], "the host is not reachable")
    assert "arm cannot be reached" in _until_said(robot, "cannot be reached")
    assert robot.status["crashed"] == [] and process_info(pid) == started
    robot.hosts.link("up")
    robot.until(lambda: bool(robot.instance("talker")["reachable"]), "the host is reachable again")
    # The host process is killed, and started again; its components go on.
    os.kill(robot.host_process, signal.SIGKILL)
    robot.until(lambda: not robot.instance("talker")["reachable"], "the host process is gone")
    robot.until(lambda: bool(robot.instance("talker")["reachable"]), "the host process is there again")
    assert robot.instance("talker")["pid"] == pid
    # An exit while nothing watched is noticed.
    os.kill(robot.host_process, signal.SIGKILL)
    os.kill(pid, signal.SIGKILL)
    robot.until(lambda: robot.status["crashed"] != [], "the exit is noticed")
    assert robot("restart", "talker", "--yes").status == 0
    assert robot.instance("talker")["host"] == "arm"
    assert robot("down").status == 0


def _until_said(robot: Robot, words: str) -> str:
    robot.until(lambda: words in robot("log", "--all").out, words)
    return robot("log", "--all").out


@pytest.mark.long
@pytest.mark.timeout(300)
def test_another_manager_takes_over_where_every_host_can_be_reached(robot: Robot) -> None:
    assert robot("up", robot.file, "-d").status == 0
    earlier, pid = robot.manager, robot.instance("talker")["pid"]
    robot.hosts.stop_serving()
    refused = robot("up", robot.file, "-d", "--replace-manager")
    assert refused.status != 0 and "host arm cannot be reached" in refused.out + refused.err, refused
    assert robot.manager == earlier
    robot.hosts.serve()
    done = robot("up", robot.file, "-d", "--replace-manager")
    assert done.status == 0, done.out + done.err
    assert robot.manager != earlier and robot.instance("talker")["pid"] == pid
    assert robot("replace", "talker", "NewTalker", "--yes").status == 0
    assert robot("down").status == 0


OTHER_WAY = """
topic /back : Text

node caller : Talker { out -> /back }
node hearer : Listener on arm { in <- /back }
"""


@pytest.mark.long
@pytest.mark.timeout(300)
def test_while_the_link_is_cut_each_side_degrades_what_relies_on_the_other_and_then_all_is_as_it_was(
    robot: Robot,
) -> None:
    """To the nodes on `arm`, it is the manager's host that is cut off."""
    robot.text += OTHER_WAY
    assert robot("up", robot.file, "-d").status == 0
    before = {each["name"]: each["pid"] for each in robot.status["instances"]}
    (host,) = robot.status["hosts"]
    assert host["connected"] and host["instances"] == ["hearer", "talker"] and host["version"]
    assert "host arm (arm): connected since" in robot("status").out
    robot.hosts.link("down")
    robot.until(lambda: robot.instance("talker")["unreachable"], "the host is unreachable")
    robot.until(lambda: robot.modes("listener") == ["degraded"], "what relies on the host is degraded")
    shown = robot("status")
    assert shown.status == 3 and "host arm (arm): unreachable since" in shown.out, shown.out
    assert "nothing is known of hearer, talker" in shown.out
    assert robot.status["crashed"] == []
    assert "host arm cannot be reached" in robot("why", "talker.talk").out
    refused = robot("restart", "talker", "--yes")
    assert refused.status != 0 and "host arm cannot be reached" in refused.out + refused.err
    assert set(robot.programs("talker.py")) == {before["talker"], before["caller"]}  # nothing is started elsewhere
    log = next((robot.workspace / "logs").glob("hearer*.log"))
    robot.until(lambda: "I hear nothing" in log.read_text(), "what relies on the manager's host is degraded there")
    robot.hosts.link("up")
    robot.until(lambda: robot.status["condition"]["state"] == "up", "all is as it was")
    after = robot.status
    assert {each["name"]: each["pid"] for each in after["instances"]} == before and after["valid"]
    assert after["hosts"][0]["connected"] and after["hosts"][0]["since"] > host["since"]
    replaced = robot("replace", "talker", "NewTalker", "--yes", "--json")
    assert replaced.status == 0 and replaced.json["swaps"][0]["missed"] == 0, replaced.out + replaced.err
    assert robot("down").status == 0


@pytest.mark.long
@pytest.mark.timeout(300)
def test_what_prevents_a_start_is_said_by_check_and_by_up(robot: Robot) -> None:
    assert robot("check", "--hosts", robot.file).status == 0
    far = robot.folder / "far"
    assert not (far / ".midstride").exists()
    right, robot.text = robot.text, robot.text.replace(str(far), f"{far}r")
    for words in (("check", "--hosts", robot.file), ("up", robot.file, "-d")):
        done = robot(*words)
        assert done.status != 0 and f"the folder {far}r is not there" in done.out + done.err, done
        assert not Path(f"{far}r").exists()
    assert robot("down").status == 0
    robot.text = right
    program = far / "talker.py"
    program.rename(program.with_suffix(".away"))
    done = robot("check", "--hosts", robot.file)
    assert done.status != 0 and f"there is no file {program} for `python3 talker.py`" in done.out, done
    robot.text = robot.text.replace('"python3 talker.py"', '"./talker.py"')
    for words in (("check", "--hosts", robot.file), ("up", robot.file, "-d")):
        done = robot(*words)
        assert done.status != 0 and "there is no program ./talker.py" in done.out + done.err, done
    assert robot("down").status == 0
    robot.hosts.stop_serving()
    robot.hosts.serve("AllowStreamLocalForwarding no")
    for words in (("check", "--hosts", robot.file), ("up", robot.file, "-d")):
        done = robot(*words)
        assert done.status != 0 and "AllowStreamLocalForwarding yes" in done.out + done.err, done
    assert robot("down").status == 0
    robot.hosts.stop_serving()
    for words in (("check", "--hosts", robot.file), ("up", robot.file, "-d")):
        done = robot(*words)
        assert done.status != 0 and "refuses connections of SSH" in done.out + done.err, done
    assert robot("down").status == 0
    assert json.loads(robot("check", "--hosts", robot.file, "--json").out)["hosts"][0]["ok"] is False
