"""Many replacements of components that count, on real ROS: a bare recorder has every number exactly once.

MIDSTRIDE_STATE_REPLACEMENTS says how many replacements there are in the long tests.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from midstride import backends
from midstride.codec.specification_form import decode_specification
from midstride.runtime.manager import Manager
from midstride.runtime.workspace import Workspace
from tests.acceptance.support import ended
from tests.backends.ros2_support import tuned_environment
from tests.runtime.counting import at_rates, exchanged, for_messages, system
from tests.runtime.test_state_without_outputs import RESTART, noted, sink_system

pytestmark = pytest.mark.timeout(7200)

LONG = int(os.environ.get("MIDSTRIDE_STATE_REPLACEMENTS", "200"))
SHORT = 6
# A hand-over may be given up on a machine that is too busy for its cut; no number may be missing all the same.
GIVEN_UP_AT_MOST = 0.02

_RCLPY = """
import sys, rclpy
from std_msgs.msg import String
rclpy.init()
node = rclpy.create_node("recorder")
heard = open(sys.argv[1], "a", buffering=1)
node.create_subscription(String, "/out", lambda message: heard.write(message.data + chr(10)), 1000)
rclpy.spin(node)
"""
_ROSPY = """
import sys, rospy
from std_msgs.msg import String
rospy.init_node("recorder")
heard = open(sys.argv[1], "a", buffering=1)
rospy.Subscriber("/out", String, lambda message: heard.write(message.data + chr(10)), tcp_nodelay=True)
rospy.spin()
"""


@contextlib.contextmanager
def recorded(source: str, path: Path) -> Iterator[None]:
    """A process that knows nothing of Midstride; ``path`` has a line for each message."""
    environment = tuned_environment(dict(os.environ)) if source is _RCLPY else None
    process = subprocess.Popen([sys.executable, "-c", source, str(path)], env=environment, start_new_session=True)
    try:
        yield
    finally:
        process.kill()
        process.wait()


async def lines(path: Path, count: int) -> list[str]:
    """The lines of the file, once there are so many."""
    for _ in range(600):
        found = path.read_text().splitlines() if path.exists() else []
        if len(found) >= count:
            return found
        await asyncio.sleep(0.05)
    raise AssertionError(f"the recorder hears nothing: {len(found)} of {count} lines came")


async def replaced(backend: str, folder: Path, recorder: str, replacements: int) -> tuple[list[str], list[str]]:
    """What the recorder heard, and why hand-overs were given up."""
    path, given_up = folder / "heard", []
    workspace = Workspace(folder / "workspace")
    workspace.path.mkdir(mode=0o700)
    specification = decode_specification(json.loads((folder / "counting.json").read_text()))
    manager = Manager(specification, backends.make(backend, workspace), workspace, folder)
    try:
        await manager.up()
        with recorded(recorder, path):
            await lines(path, 20)
            for number in range(replacements):
                outcome = await exchanged(manager)
                if outcome.outcome != "done":
                    assert outcome.outcome == "rolled_back", outcome.because
                    given_up.append(f"{number}: {outcome.because}")
                # A process that hangs cannot export its state: then numbers are missing, and this says why.
                given_up += [f"{number}: fenced: {each.words}" for each in outcome.fenced]
                given_up += [f"{number}: {words}" for words in outcome.own_state.values()]
            heard = await lines(path, len(path.read_text().splitlines()) + 20)
    finally:
        await manager.down()
        await manager.close()
    return heard[:-1], given_up  # the last line may be half a line


def assert_exactly_once(heard: list[str], given_up: list[str], replacements: int) -> None:
    numbers = sorted(int(line.split()[0]) for line in heard)
    expected = range(numbers[0], numbers[-1] + 1)
    missing = sorted(set(expected) - set(numbers))
    twice = sorted({number for number, next_ in itertools.pairwise(numbers) if number == next_})
    seen = [f"line {at}: {line}" for at, line in enumerate(heard) if int(line.split()[0]) in twice[:5]]
    assert not missing and not twice, f"of {len(expected)}, missing: {missing}, twice: {seen}; given up: {given_up}"
    assert len(given_up) <= max(1, GIVEN_UP_AT_MOST * replacements), given_up
    sides = [line.split()[1] for line in heard]
    assert sum(a != b for a, b in itertools.pairwise(sides)) >= replacements - len(given_up)


COUNTS = [pytest.param(SHORT, marks=pytest.mark.full), pytest.param(LONG, marks=pytest.mark.long)]


@pytest.mark.ros2
@pytest.mark.long
@pytest.mark.parametrize("replacements", [LONG])
def test_ros2_a_counter_at_50_hz(replacements: int, tmp_path: Path) -> None:
    folder = system(tmp_path, at_rates(out=50), out=50)
    with ended():
        heard, given_up = asyncio.run(replaced("ros2", folder, _RCLPY, replacements))
    assert_exactly_once(heard, given_up, replacements)


@pytest.mark.ros2
@pytest.mark.parametrize("replacements", COUNTS)
def test_ros2_a_counter_of_messages_at_200_hz(replacements: int, tmp_path: Path) -> None:
    """Every number once, and every message counted once."""
    folder = system(tmp_path, for_messages(200), source=200)
    with ended():
        heard, given_up = asyncio.run(replaced("ros2", folder, _RCLPY, replacements))
    assert_exactly_once(heard, given_up, replacements)
    ticks = sorted(int(line.split()[2]) for line in heard)
    assert ticks == list(range(ticks[0], ticks[0] + len(ticks)))


@pytest.mark.ros1
@pytest.mark.parametrize("replacements", COUNTS)
def test_ros1_a_counter_at_50_hz(replacements: int, tmp_path: Path) -> None:
    from tests.backends.ros1_support import own_master_uri

    folder = system(tmp_path, at_rates(out=50), out=50)
    with own_master_uri(), ended():
        heard, given_up = asyncio.run(replaced("ros1", folder, _ROSPY, replacements))
    assert_exactly_once(heard, given_up, replacements)


@pytest.mark.ros2
@pytest.mark.full
def test_ros2_a_component_without_outputs_at_200_hz(tmp_path: Path) -> None:
    """Each message is received by one of the two, once, and counted on from the one before it."""
    sink_system(tmp_path)
    workspace = Workspace(tmp_path / "workspace")
    workspace.path.mkdir(mode=0o700)
    specification = decode_specification(json.loads((tmp_path / "counting.json").read_text()))
    manager = Manager(specification, backends.make("ros2", workspace), workspace, tmp_path)

    async def main() -> None:
        try:
            await manager.up()
            for _ in range(4):
                outcome = await manager.change(RESTART)
                assert (outcome.outcome, outcome.because, outcome.own_state) == ("done", None, {})
            await lines(tmp_path / "in", len(noted(tmp_path)) + 20)
        finally:
            await manager.down()
            await manager.close()

    with ended():
        asyncio.run(main())
    heard = noted(tmp_path)
    gaps = [(before, after) for before, after in itertools.pairwise(heard) if int(after[0]) != int(before[0]) + 1]
    assert not gaps, f"missed between (number, count, instance, live): {gaps}"
    assert [int(line[1]) for line in heard] == list(range(1, len(heard) + 1))
    assert len({line[2] for line in heard}) == 3, "sink, sink_2 and sink_3"
