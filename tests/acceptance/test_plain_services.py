"""Services of nodes of every kind across replacements: every request is handled once, by bare clients' count.

MIDSTRIDE_REPLACEMENTS says how many replacements the long test makes, where 200 take too long.
"""

from __future__ import annotations

import asyncio
import os
import sys
from collections.abc import Callable, Sequence
from itertools import cycle, islice
from pathlib import Path

import pytest

from midstride import backends
from midstride.lang.load import load
from midstride.runtime.manager import Manager
from midstride.runtime.workspace import Workspace
from tests.acceptance.foreign_support import declared_talker, robot
from tests.acceptance.serving import COUNTING_OURS, Calls, called, calling, written, written_with_the_api
from tests.acceptance.support import ended
from tests.acceptance.test_manager_killed import calls_of_a_swap, kill_the_manager, manage
from tests.backends.ros2_support import run, until

pytestmark = [pytest.mark.ros2, pytest.mark.full]

REPLACEMENTS = int(os.environ.get("MIDSTRIDE_REPLACEMENTS", "200"))


def replaced(folder: Path, components: Sequence[str]) -> None:
    """Replace the server by each of ``components`` under 20 clients; print what that costs them."""

    async def scenario() -> None:
        path = written_with_the_api(folder) if "Ours" in components else written(folder)
        async with robot(load(path).require(), folder) as system:
            async with called(folder, system) as calls:
                for component in components:
                    await system.replaced(component)
                count = len(calls.answered)
                await system.until(lambda: len(calls.answered) > count + 40)
            system.require_changes(len(components))
            assert system.holes() == []
            found = sorted(each.latency for each in calls.answered)
            p50, p99 = (found[int(len(found) * part)] for part in (0.5, 0.99))
            print(f"{len(found)} requests, p50 {p50 * 1e3:.1f} ms, p99 {p99 * 1e3:.1f} ms, {found[-1] * 1e3:.1f} ms")

    with ended():
        run(scenario(), 3600)


def test_every_request_is_handled_once_across_replacements(tmp_path: Path) -> None:
    """From rclpy to C, by both functions that take a request."""
    replaced(tmp_path, ["Id", "Info"])


def test_what_outlasts_its_time_to_answer_is_in_plan_and_report(tmp_path: Path) -> None:
    """A request that the old node never answers; its outputs and other requests go on."""
    path = written(tmp_path)
    text = path.read_text().replace(' id" gate', ' id" stop drain 300 ms gate')
    path.write_text(text.replace("talker : Plain", "talker : Id"))

    async def scenario() -> None:
        from rcl_interfaces.srv import ListParameters

        async with robot(load(path).require(), tmp_path) as system:
            client = system.bare.node.create_client(ListParameters, "/count")
            await system.until(client.service_is_ready)
            client.call_async(ListParameters.Request(prefixes=["0_1"], depth=1))
            await system.until(lambda: (tmp_path / "calls").read_text().startswith("0_1"))
            report = await system.change("Info")
            assert (report.outcome, report.because) == ("done", None)
            remark = (
                "talker_2 answers service /count once talker has answered the requests that it has taken, after 0.3 s "
                "(`drain`) at the latest"
            )
            # While its only thread handles that request, it may not have said its parameters either.
            assert report.plan is not None and remark in list(report.plan.remarks or ())
            found = [event.words for event in system.manager.events.since(0) if event.kind in ("note", "killed")]
            left = "talker: 1 request that it had taken was not answered within the 0.3 s of `drain`"
            assert [each for each in found if "drain" in each] == [
                "talker_2 answers requests; talker has not answered 1 request that it had taken within the 0.3 s of "
                "`drain`",
                left,
            ]
            assert report.continuity is not None
            assert any(each.words.startswith(left) for each in report.continuity.found)
            answered = client.call_async(ListParameters.Request(prefixes=["0_2"]))
            await system.until(answered.done)
            assert answered.result().result.names == ["talker_2"]

    with ended():
        run(scenario())


@pytest.mark.long
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("kinds", [("Other", "Plain"), ("Id", "Info"), ("OurOther", "Ours")])
def test_every_request_is_handled_once_across_many_replacements(tmp_path: Path, kinds: tuple[str, str]) -> None:
    replaced(tmp_path, list(islice(cycle(kinds), REPLACEMENTS)))


def written_for_a_manager_that_dies(folder: Path) -> Path:
    """The system of :mod:`tests.acceptance.managing`: a node `source`, and two components that run the server."""
    written(folder)
    text = "system serving\ntopic /swap : std_msgs/msg/String @ 50 Hz\n"
    for name in ("Source", "OtherSource"):
        text += declared_talker(name, f"{sys.executable} {folder / 'server.py'}", "preload")
    path = folder / "killed.stride"
    path.write_text(f"{text}node source : Source {{ out -> /swap }}\n", encoding="utf-8")
    return path


# A component with the API, and a program with the library that replaces it.
MIXED = """system serving
topic /swap : std_msgs/msg/String @ 50 Hz
contract Listing = rcl_interfaces/srv/ListParameters responds within 0.5 s
service /count : Listing
component Source {{
  run "{python} {folder}/ours.py"
  output out
  server count
  functionality talk {{
    produces out
    mode normal {{ guarantee out : std_msgs/msg/String @ 50 Hz }}
    mode degraded {{ }}
  }}
  functionality counting {{ produces count  mode normal {{ guarantee count : Listing }}  mode off {{ }} }}
}}
component OtherSource {{
  run "{python} {folder}/server.py" gate preload
  output out as chatter
  server count
  functionality talk {{
    produces out, count
    mode normal {{ guarantee out : std_msgs/msg/String @ 50 Hz  guarantee count : Listing }}
    mode degraded {{ }}
  }}
}}
node source : Source {{ out -> /swap  count -> /count }}
"""


def written_with_both_kinds(folder: Path) -> Path:
    """The same, where the component that is replaced uses the API."""
    written(folder)
    (folder / "ours.py").write_text(COUNTING_OURS)
    path = folder / "killed.stride"
    path.write_text(MIXED.format(python=sys.executable, folder=folder), encoding="utf-8")
    return path


def killed_at(
    folder: Path,
    points: Sequence[tuple[str, str, str]] | None,
    write: Callable[[Path], Path] = written_for_a_manager_that_dies,
) -> None:
    """Kill the manager at each of ``points`` of a replacement under 20 clients; None: at every one.

    One of the two then answers without a manager, and the next manager finds which.
    """
    system = folder / "system"

    async def main() -> None:
        system.mkdir()
        specification = load(write(folder)).require()
        manager = Manager(specification, backends.make("ros2", Workspace(system)), Workspace(system), folder)
        await manager.up()
        await manager.close()
        chosen = points
        if chosen is None:
            found = await asyncio.to_thread(lambda: calls_of_a_swap(system) & calls_of_a_swap(system))
            chosen = [
                (op, str(number + 1), when)
                for op, count in found.items()
                if op != "write"
                for number in range(count)
                for when in ("before", "after")
            ]
            assert "answer" in found and "cut_in" in found
        async with calling(folder, until) as calls:
            for point in chosen:
                await asyncio.to_thread(kill_the_manager, system, *point)
                await answered_by_one(calls, point)
        calls.are_handled_once()
        down = await asyncio.to_thread(manage, system, "down")
        assert down.returncode == 0, down.stdout + down.stderr

    with ended():
        run(main(), 3600)


async def answered_by_one(calls: Calls, point: tuple[str, str, str]) -> None:
    """Every client is answered twice more, without a manager."""
    counts = dict.fromkeys(range(20), 0)
    seen = len(calls.answered)
    for _ in range(600):
        for each in calls.answered[seen:]:
            counts[int(each.name.split("_")[0])] += 1
            seen += 1
        if min(counts.values()) >= 2:
            return
        await asyncio.sleep(0.1)
    raise AssertionError(f"killed at {point}: {counts}")


def test_one_answers_when_the_manager_is_killed_at_the_change_over(tmp_path: Path) -> None:
    killed_at(tmp_path, [("answer", "1", "before")])


@pytest.mark.long
@pytest.mark.timeout(3600)
def test_one_answers_wherever_the_manager_is_killed(tmp_path: Path) -> None:
    killed_at(tmp_path, None)


@pytest.mark.long
@pytest.mark.parametrize("when", ["before", "after"])
@pytest.mark.parametrize("op", ["join_requests", "answer"])
def test_one_answers_when_the_manager_is_killed_as_a_component_begins_to_share_its_requests(
    tmp_path: Path, op: str, when: str
) -> None:
    """The successor is asked to answer, then the component to share them, then the successor again."""
    killed_at(tmp_path, [(op, "1" if op == "join_requests" else "2", when)], written_with_both_kinds)
