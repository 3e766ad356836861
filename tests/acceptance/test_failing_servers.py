"""A server in plain rclpy that is replaced, where the new one or the old one raises, hangs or is killed meanwhile.

Bare clients call. One of the two serves on; a client misses no more than the responses of the server that failed, as
ever when a server does.
"""

from __future__ import annotations

import os
import signal
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any, Final

import pytest

from midstride.lang.load import load_text
from midstride.model.specification import Specification
from midstride.plan.request import PlanRequest
from midstride.runtime.process.component_client import ComponentClient
from midstride.runtime.records.reports import Outcome
from tests.acceptance.foreign_support import Robot, robot
from tests.acceptance.serving import CLIENTS, COUNTING_OURS, SERVER, Calls, calling
from tests.acceptance.support import ended
from tests.backends.ros2_support import run

pytestmark = [pytest.mark.ros2, pytest.mark.full]

# Once it answers, it fails with the first request; one that is late talks on meanwhile.
FAILING: Final = (
    SERVER.replace("    if request.depth:", "    fail()\n    if request.depth:")
    .replace(
        "def talk():",
        """def fail():
    if sys.argv[1] == "raises":
        raise ValueError("there is no map")
    if sys.argv[1] == "hangs":
        time.sleep(3600)
    if sys.argv[1] == "late":
        time.sleep(0.5)

def talk():""",
    )
    .replace("import os\n", "import os\nimport sys\n")
    .replace(', "count", count)', ', "count", count, callback_group=ReentrantCallbackGroup())')
    .replace("rclpy.spin(node)", "rclpy.spin(node, MultiThreadedExecutor(8) if sys.argv[1] == 'late' else None)")
    .replace(
        "from rclpy.executors import ",
        "from rclpy.callback_groups import ReentrantCallbackGroup\nfrom rclpy.executors import MultiThreadedExecutor, ",
    )
)
TEXT = """system failing
timing { watch_after 4 s }
contract Listing = rcl_interfaces/srv/ListParameters responds within 0.2 s
topic /chat : std_msgs/msg/String @ 50 Hz
service /count : Listing
component Talker {
  run "python3 server.py" gate preload
  output out as chatter
  server count
  functionality talk {
    produces out, count
    mode normal { guarantee out : std_msgs/msg/String @ 50 Hz  guarantee count : Listing }
    mode degraded { }
  }
}
component Other like Talker { run "python3 server.py" gate preload  parameters { other = true } }
component Raising like Talker { run "python3 failing.py raises" stop drain 0.3 s gate preload }
component Hanging like Talker { run "python3 failing.py hangs" stop drain 0.3 s gate preload }
component Late like Talker { run "python3 failing.py late" gate preload }
node talker : Talker { out -> /chat  count -> /count }
"""
OWN: Final = """component Ours {
  run "python3 ours.py"
  output out
  server count
  functionality talk { produces out  mode normal { guarantee out : std_msgs/msg/String @ 50 Hz }  mode degraded { } }
  functionality counting { produces count  mode normal { guarantee count : Listing }  mode off { } }
}
"""
# After so long a client gives a request up (s).
PATIENCE: Final = 8.0
NUMBER: Final = 5
RESTART: Final = PlanRequest(restart=("talker",))


def written(folder: Path, watch_after: float = 4, gate: str = "preload") -> Specification:
    ours = COUNTING_OURS.replace("within=0.5", "within=0.2")
    for name, text in (("server", SERVER), ("failing", FAILING), ("clients", CLIENTS), ("ours", ours)):
        (folder / f"{name}.py").write_text(text)
    text = TEXT + OWN
    text = text.replace("watch_after 4 s", f"watch_after {watch_after:g} s").replace("gate preload", f"gate {gate}")
    return load_text(text if gate == "preload" else text.replace("stop drain 0.3 s ", "")).require()


def instances(system: Robot) -> list[str]:
    return [each.name for each in system.manager.configuration.instances.values() if each.role == "talker"]


async def served_by(system: Robot, calls: Calls) -> str:
    """The one instance of the role, which answers 20 further requests that are sent from now on."""
    (name,) = instances(system)
    count = len(calls.answered)

    def answered() -> int:
        return sum(each.server == name for each in calls.answered[count:])

    await system.until(lambda: answered() >= 20, 30)
    return name


def judge(calls: Calls, failed: set[str], ends: int = 0) -> None:
    """Each request was handled once at most, and each that was not answered by one that failed.

    At each of so many ``ends`` of a server that answered, a request of each client may be lost that none has noted.
    """
    assert not calls.handled_twice
    handled = dict(calls.handled)
    lost = [each.name for each in calls.unanswered]
    print(f"{len(calls.answered)} requests, {len(lost)} not answered: {[(name, handled.get(name)) for name in lost]}")
    unnoted = [name for name in lost if handled.get(name) not in failed]
    assert len(unnoted) <= NUMBER * ends, unnoted
    assert all(each.server == handled[each.name] for each in calls.answered if each.server != "-")


@asynccontextmanager
async def failing(folder: Path, watch_after: float = 4, gate: str = "preload") -> AsyncIterator[tuple[Robot, Calls]]:
    async with (
        robot(written(folder, watch_after, gate), folder) as system,
        calling(folder, system.until, clients=NUMBER, patience=PATIENCE) as calls,
    ):
        yield system, calls


def test_a_new_server_that_raises_or_hangs_is_rolled_back(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with failing(tmp_path) as (system, calls):
            for component, because in (
                ("Raising", ""),
                ("Hanging", "on /count after the hand-over: 0.2 s are promised"),
            ):
                report = await system.change(component)
                assert report.outcome == "rolled_back", report
                assert because in (report.because or ""), report.because
                assert await served_by(system, calls) == "talker"
        judge(calls, {name for _, name in calls.handled} - {"talker"})

    with ended():
        run(scenario(), 120)


@pytest.mark.long
def test_a_new_server_that_is_late_is_rolled_back_and_another_one_is_kept(tmp_path: Path) -> None:
    async def scenario() -> None:
        async with failing(tmp_path) as (system, calls):
            report = await system.change("Late")
            assert report.outcome == "rolled_back", report
            assert "has answered" in (report.because or "") and "late" in (report.because or ""), report.because
            assert await served_by(system, calls) == "talker"
            report = await system.change("Other")
            assert (report.outcome, report.because) == ("done", None)
            assert await served_by(system, calls) != "talker"
        judge(calls, set())

    with ended():
        run(scenario(), 120)


class Killer:
    """Kills an instance at a point of a change: `old` or `new`, a command to the new one, `before` or `after` it.

    One command is to the old one: `join_requests`.
    """

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.commands: list[str] = []  # those to the new one
        self.killed: set[str] = set()
        self._point: tuple[str, str, str] | None = None
        self._system: Robot | None = None
        self._old = self._new = ""
        send = ComponentClient._send

        async def sends(client: ComponentClient, instance: str, command: Any, revision: Any) -> Any:
            self._kill(instance, command.name, "before")
            reply = await send(client, instance, command, revision)
            self._kill(instance, command.name, "after")
            return reply

        monkeypatch.setattr(ComponentClient, "_send", sends)

    def _kill(self, instance: str, command: str, when: str) -> None:
        if self._system is None or (instance == self._old and command != "join_requests"):
            return
        self._new = self._new if instance == self._old else instance
        if when == "before":
            self.commands.append(command)
        if self._point is None or self._point[1:] != (command, when):
            return
        victim = self._old if self._point[0] == "old" else self._new
        self._point, handle = None, self._system.manager.system.life[victim].handle
        if handle is not None and handle.pid:
            os.kill(handle.pid, signal.SIGKILL)
            self.killed.add(victim)

    @property
    def has_killed(self) -> bool:
        """Return whether the last change came to its point."""
        return self._point is None

    async def change(self, system: Robot, point: tuple[str, str, str] | None, request: PlanRequest) -> Outcome:
        self._system, self._point, self._old = system, point, instances(system)[0]
        self.commands = []
        report: Outcome = await system.meanwhile(system.manager.change(request))
        self._system = None
        return report


@pytest.mark.long
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("victim", ["old", "new"])
@pytest.mark.parametrize("gate", ["preload", "relay"])
def test_one_serves_on_when_the_other_is_killed_at_any_command(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, gate: str, victim: str
) -> None:
    """At the first of each command that the new one gets in a whole change, before and after it.

    Where the new one dies before it has taken over, no request is lost.
    """
    killer = Killer(monkeypatch)

    async def scenario() -> None:
        ends, reached = 0, set[str]()
        async with failing(tmp_path, 0, gate) as (system, calls):
            assert (await killer.change(system, None, RESTART)).outcome == "done"
            points = [(victim, name, when) for name in dict.fromkeys(killer.commands) for when in ("before", "after")]
            for point in points:
                await served_by(system, calls)
                report = await killer.change(system, point, RESTART)
                print(point, report.outcome, report.because)
                if not killer.has_killed:  # a command that not every change needs
                    continue
                reached.add(point[1])
                ends += victim == "old" or report.outcome == "done"
                if not instances(system):  # the one that was to be kept is the one that was killed
                    await system.meanwhile(system.manager.change(RESTART))
            await served_by(system, calls)
        assert reached >= {"cut_in", "await_cut", "answer"}
        judge(calls, killer.killed, ends)

    with ended():
        run(scenario(), 1200)


@pytest.mark.long
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("victim", ["old", "new"])
def test_one_serves_on_when_one_of_the_two_has_the_api_and_either_is_killed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, victim: str
) -> None:
    """A program with the library and a component with the API in turn; otherwise as above."""
    killer = Killer(monkeypatch)

    async def scenario() -> None:
        ends, reached = 0, set[str]()

        async def becomes(component: str, system: Robot, point: tuple[str, str, str] | None = None) -> Outcome:
            return await killer.change(system, point, PlanRequest(replace=(("talker", component),)))

        async with failing(tmp_path, 0) as (system, calls):
            for old, new in (("Talker", "Ours"), ("Ours", "Talker")):
                assert (await becomes(new, system)).outcome == "done"
                points = [
                    (victim, name, when) for name in dict.fromkeys(killer.commands) for when in ("before", "after")
                ]
                assert (await becomes(old, system)).outcome == "done"
                for point in points:
                    await served_by(system, calls)
                    report = await becomes(new, system, point)
                    print(old, new, point, report.outcome, report.because)
                    if killer.has_killed:
                        reached.add(point[1])
                        ends += victim == "old" or report.outcome == "done"
                    if not instances(system):
                        await system.meanwhile(system.manager.change(RESTART))
                    (name,) = instances(system)
                    if system.manager.configuration.component(name).name != old:
                        assert (await becomes(old, system)).outcome == "done"
                assert (await becomes(new, system)).outcome == "done"
            await served_by(system, calls)
        assert reached >= {"cut_in", "await_cut", "answer"}  # a component that has just taken over has joined already
        judge(calls, killer.killed, ends)

    with ended():
        run(scenario(), 1800)


@pytest.mark.long
@pytest.mark.timeout(600)
@pytest.mark.parametrize("victim", ["old", "new"])
def test_one_serves_on_when_either_is_killed_as_a_component_begins_to_share_its_requests(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, victim: str
) -> None:
    """A component that has begun alone shares them once its successor is to answer, which is then asked again."""
    killer = Killer(monkeypatch)

    async def scenario() -> None:
        ends = 0
        async with failing(tmp_path, 0) as (system, calls):
            for point in (("join_requests", "before"), ("join_requests", "after")):
                ours = PlanRequest(replace=(("talker", "Ours"),))
                for request in (ours, RESTART):  # the second one has not replaced a program with the library
                    assert (await killer.change(system, None, request)).outcome == "done"
                await served_by(system, calls)
                report = await killer.change(system, (victim, *point), PlanRequest(replace=(("talker", "Talker"),)))
                print(victim, point, report.outcome, report.because)
                assert killer.has_killed
                ends += victim == "old" or report.outcome == "done"
                if not instances(system):
                    await system.meanwhile(system.manager.change(RESTART))
                await served_by(system, calls)
                (name,) = instances(system)
                if system.manager.configuration.component(name).name == "Ours":
                    assert (
                        await killer.change(system, None, PlanRequest(replace=(("talker", "Talker"),)))
                    ).outcome == "done"
        judge(calls, killer.killed, ends)

    with ended():
        run(scenario(), 600)
