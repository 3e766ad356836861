"""The examples from beginning to end, and that nothing of them is left behind."""

from __future__ import annotations

import io
import os
import re
import shutil
import signal
import time

import click
import psutil
import pytest
from rich.console import Console

from midstride.backends.simulator import virtual_loop
from midstride.cli import example as examples
from midstride.cli.demo_runner import run_demo
from midstride.cli.log_excerpt import excerpt, parse
from tests.cli.conftest import ROOT, Midstride, alive, nothing_lost

EVERY = ("filter", "obstacle", "talker")


@pytest.fixture
def environment(monkeypatch: pytest.MonkeyPatch) -> None:
    """A demo says in its environment whose it is: not in that of the tests."""
    monkeypatch.setenv("MIDSTRIDE_DEMO", "")


def in_virtual_time(name: str) -> tuple[list[examples.DemoStep], list[dict[str, object]], str]:
    """An example on the simulator: its acts, what came of each, and what was shown."""
    example = examples.find(name)
    out = Console(file=io.StringIO(), width=1000)
    outcomes = virtual_loop.run(run_demo(example, "sim", out))
    assert isinstance(out.file, io.StringIO)
    return list(example.steps), outcomes, out.file.getvalue()


def test_a_part_of_a_demo_is_chosen_by_name() -> None:
    names = ["a driver dies", "the planner is killed", "a driver is replaced"]
    assert examples.matching(names, ()) == names
    assert examples.matching(names, ("driver", "dies")) == [names[0], names[2]]
    with pytest.raises(click.UsageError, match="no step has 'lidar' in its name; there are: a driver dies; the"):
        examples.matching(names, ("lidar",))


def test_every_example_has_a_demo() -> None:
    folder = examples.examples_folder()
    with_programs = {path.parent.name for path in folder.glob("*/*.py")} - {
        "suave",
        "navigation",
        "navigator",
    }  # a campaign, and what docs/how-to/bring-your-robot.md and replace-a-server.md run
    assert sorted(with_programs) == sorted((*EVERY, "patrol"))
    assert {path.parent.name for path in folder.glob("*/demo.json")} == with_programs
    assert examples.find("patrol").program == folder / "patrol" / "demo.py"


@pytest.mark.usefixtures("environment")
@pytest.mark.parametrize("name", EVERY)
def test_a_hand_over_loses_nothing_and_the_paper_s_strategy_does(name: str) -> None:
    acts, outcomes, shown = in_virtual_time(name)
    assert [outcome["outcome"] for outcome in outcomes] == ["done"] * len(acts)
    for act, outcome in zip(acts, outcomes, strict=True):
        if not act.request.replace:
            continue
        swaps = outcome["swaps"]
        assert isinstance(swaps, list)
        assert swaps
        for swap in swaps:
            lossless = (swap["missed"], swap["lost"], swap["duplicates"]) == (0, 0, 0)
            assert lossless == (act.request.strategy == "minimal"), swap
    assert "Side by side" in shown
    assert not (ROOT / ".midstride" / f"demo-{os.getpid()}").exists()


@pytest.mark.usefixtures("environment")
def test_the_talker_s_demo_shows_the_listener_continuing() -> None:
    _, _, shown = in_virtual_time("talker")
    lines = [line.strip() for line in shown.partition("Log of listener during the change:")[2].splitlines()[1:5]]
    assert [re.sub(r"\d+", "#", line) for line in lines] == [
        "I heard: hello world, this is talker",
        "I heard: hello world, this is talker",
        "I heard: good news from talker_#, number #",
        "I heard: good news from talker_#, number #",
    ]


@pytest.mark.usefixtures("environment")
def test_the_motor_stops_without_a_detector() -> None:
    _, _, shown = in_virtual_time("obstacle")
    without = shown.index("controller.control is now in mode degraded.")
    assert shown.index("no detector") < without < shown.index("a detector again")
    assert "controller.control is now" not in shown[without + 1 :]


def test_an_excerpt_of_a_log_shows_its_changes() -> None:
    log = [f"[INFO] [100.{n:03d}] [ear]: I heard: {'old' if n < 50 else 'new'} {n}" for n in range(100)]
    lines = [parsed for line in ["a line of a library", *log] if (parsed := parse(line)) is not None]
    assert len(lines) == 100
    assert [line and line.text for line in excerpt(lines)] == [
        "I heard: old 48",
        "I heard: old 49",
        "I heard: new 50",
        "I heard: new 51",
    ]
    assert excerpt(lines[:50]) == []
    assert str(lines[50]).endswith(".050  I heard: new 50")
    twice = excerpt([*lines, *lines[:50]])
    assert twice.count(None) == 1


@pytest.mark.full
def test_as_a_command(midstride: Midstride) -> None:
    done = midstride.process("demo", "--backend", "sim", "--json")
    assert (done.status, done.err) == (0, "")
    document = done.json
    assert (document["outcome"], document["example"], document["backend"]) == ("done", "talker", "sim")
    assert [act["plan"]["strategy"] for act in document["acts"]] == ["minimal", "paper"]
    assert document["swaps"] == document["acts"][0]["swaps"]


@pytest.mark.parametrize(
    ("number", "moment"),
    [
        (signal.SIGINT, "hand over"),
        pytest.param(signal.SIGTERM, "hand over", marks=pytest.mark.long),
        pytest.param(signal.SIGINT, "watching the subscribers", marks=pytest.mark.full),
    ],
)
def test_an_interrupted_demo_shuts_down_in_order(midstride: Midstride, number: signal.Signals, moment: str) -> None:
    """In the middle of a plan's steps, and while it measures."""
    demo = midstride.start("demo", "--backend", "sim")
    try:
        assert demo.stdout is not None
        assert any(f" {moment}" in line and ("✓" in line or moment != "hand over") for line in demo.stdout)
        demo.send_signal(number)
        assert "Interrupted; all processes have been stopped." in demo.stdout.read()
        assert demo.wait(20) == 130
    finally:
        demo.kill()
        demo.communicate()
    assert not (ROOT / ".midstride" / f"demo-{demo.pid}").exists()


# -- on ROS 2 -------------------------------------------------------------------------------------------------------


@pytest.mark.ros2
@pytest.mark.parametrize("name", ["talker", *(pytest.param(name, marks=pytest.mark.full) for name in EVERY[:2])])
def test_on_ros_2(midstride: Midstride, name: str) -> None:
    done = midstride("demo", name, "--backend", "ros2", "--json", timeout=110)
    assert done.status == 0, done.out + done.err
    for act in done.json["acts"]:
        assert act["outcome"] == "done"
        if any(step["action"] == "handover" for step in act["plan"]["steps"]):
            assert nothing_lost(act["swaps"], "ros2"), act["swaps"]
            assert not any(act["below_baseline_seconds"].values())


@pytest.mark.ros2
@pytest.mark.long
def test_the_patrol_on_ros_2(midstride: Midstride) -> None:
    done = midstride("demo", "patrol", "--backend", "ros2", "--json", timeout=280)
    acts = done.json["acts"]
    assert len(acts) == 8
    assert [(act["name"], act["came_to"], act["collisions"]) for act in acts if act["outcome"] != "done"] == []
    assert done.status == 0


@pytest.mark.ros2
@pytest.mark.parametrize("number", [pytest.param(signal.SIGINT, marks=pytest.mark.full), signal.SIGKILL])
def test_no_orphan_on_ros_2(midstride: Midstride, number: signal.Signals) -> None:
    """In the middle of a change, so that old and new are both there."""
    demo = midstride.start("demo", "--backend", "ros2")
    try:
        assert demo.stdout is not None
        assert any("✓ 1/4 create talker_2" in line for line in demo.stdout)
        started = {child for child in children(demo.pid) if alive(child)}
        assert len(started) >= 4  # listener, talker, talker_2, and the guardian
        demo.send_signal(number)
        demo.stdout.read()  # to its end: the guardian has let go of it, too
        assert demo.wait(30) == (130 if number == signal.SIGINT else -signal.SIGKILL)
        wait_until_gone(started)
    finally:
        demo.kill()
        demo.communicate()
        shutil.rmtree(ROOT / ".midstride" / f"demo-{demo.pid}", ignore_errors=True)  # the next demo would do it


def children(pid: int) -> list[int]:
    return [child.pid for child in psutil.Process(pid).children()]


def wait_until_gone(pids: set[int]) -> None:
    deadline = time.monotonic() + 20
    while left := {pid for pid in pids if alive(pid)}:
        assert time.monotonic() < deadline, f"still there: {left}"
        time.sleep(0.02)
