"""Two plain rclpy servers of one ROS action behind the library, without a manager: whose a goal is until its end.

The steps of the manager are taken here.
"""

from __future__ import annotations

import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from midstride.foreign.gates import Gates
from midstride.foreign.page import KEPT_RESULTS, Page
from midstride.foreign.page_layout import GOALS, NODES, GoalState
from midstride.model.component import ComponentSpec
from tests.backends.ros2_support import Bare, run, without_midstride

pytestmark = [pytest.mark.ros2, pytest.mark.full]

# Counts to the number that a goal asks for, at 20 Hz, until that is cancelled, or until the test finishes all such
# goals; its last number is its server's. With another argument, it is the second node of its process. Its own service
# is made after the ROS action: a client that has had an answer from that and the server of the action know each other.
SERVER = """
import sys
import threading
import time
from pathlib import Path
import rclpy
from rclpy.action import ActionServer, CancelResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor
from rclpy.node import Node
from rcl_interfaces.srv import ListParameters
from test_msgs.action import Fibonacci

rclpy.init()
others = [Node("host", start_parameter_services=False) for _ in sys.argv[2:]]
node = Node("server", start_parameter_services=False)

def count(goal):
    result, feedback = Fibonacci.Result(), Fibonacci.Feedback()
    finished = Path(__file__).parent / f"finished {goal.request.order}"
    while len(result.sequence) < goal.request.order and not goal.is_cancel_requested and not finished.exists():
        result.sequence.append(len(result.sequence))
        feedback.sequence = [int(sys.argv[1])]
        goal.publish_feedback(feedback)
        time.sleep(0.05)
    goal.canceled() if goal.is_cancel_requested else goal.succeed()
    result.sequence.append(int(sys.argv[1]))
    return result

server = ActionServer(node, Fibonacci, "/count", count, cancel_callback=lambda goal: CancelResponse.ACCEPT,
                      callback_group=ReentrantCallbackGroup())
node.create_service(ListParameters, f"/own_{sys.argv[1]}", lambda request, response: response)

def leave():
    if (Path(__file__).parent / "left").exists() and server in node.waitables:
        server.destroy()

node.create_timer(0.1, leave)
try:
    rclpy.spin(node, MultiThreadedExecutor(8))
except (KeyboardInterrupt, ExternalShutdownException):
    pass
"""
OLD, NEW = 1001, 1002
# For longer than a request is held of which nothing else is known (s).
HELD = 6.0
# The orders of goals that last until the test finishes or cancels them.
LONG, ENDLESS = 50_000, 100_000


class Actions:
    """The old server and the new one, and a client that sends them goals."""

    def __init__(self, folder: Path, library: Path, bare: Bare) -> None:
        from rclpy.action import ActionClient
        from test_msgs.action import Fibonacci

        self.page = Page(folder / "page", library)
        self.bare = bare
        self.folder = folder
        self._library, self._program = library, folder / "server.py"
        self._program.write_text(SERVER)
        self.processes: dict[int, subprocess.Popen[bytes]] = {}
        self.indices: dict[int, int] = {}
        self._type = Fibonacci
        self.client: Any = ActionClient(bare.node, Fibonacci, "/count")

    async def start(self, name: int, of: int | None = None, *, second: bool = False) -> None:
        """Start a server beside the one that it replaces. ``second``: it is not the first node of its process.

        On return, it and the client know each other: a goal sent before that gets no answer.
        """
        from rcl_interfaces.srv import ListParameters

        page = self.page
        process = page.allocate(f"{name} host") if second else None
        index = page.allocate(str(name), process=process, name="/server" if second else "")
        self.indices[name] = index
        page.have_requests(index, None if of is None else self.indices[of])
        given = {
            "LD_PRELOAD": str(self._library),
            "MIDSTRIDE_GATE_PAGE": str(page.path),
            "MIDSTRIDE_GATE_NODE": str(index if process is None else process),
        }
        command = [sys.executable, str(self._program), str(name), *(["host"] if second else [])]
        self.processes[name] = subprocess.Popen(command, env={**without_midstride(), **given})
        parts = {f"/count/_action/{part}" for part in ("send_goal", "cancel_goal", "get_result")}
        await self.bare.until(lambda: parts <= page.servers(index).keys())
        asking = self.bare.node.create_client(ListParameters, f"/own_{name}")
        await self.bare.ask(asking, ListParameters.Request())
        self.bare.node.destroy_client(asking)
        number = len([each for each in self.processes.values() if each.poll() is None])
        await self.bare.until(lambda: all(self.bare.node.count_services(part) >= number for part in parts))
        await self.bare.until(self.client.server_is_ready)
        if of is not None:  # it knows the client, too
            old = page.servers(self.indices[of])
            await self.bare.until(lambda: all(page.servers(index)[part].matched >= 1 for part in parts & old.keys()))

    def give(self, name: int) -> None:
        self.page.give_requests(self.indices[name], 2.0)
        for index in self.indices.values():
            self.page.ring(index)

    async def result(self, future: Any) -> Any:
        try:
            await self.bare.until(future.done, 30)
        except AssertionError as error:
            raise AssertionError(f"no response: {self.state()}") from error
        return future.result()

    def state(self) -> str:
        """What is known of the servers, for a test that fails."""
        known = []
        for name, index in self.indices.items():
            node, ended = self.page.layout.nodes[index], self.processes[name].poll()
            words = f"server {name}: {'lives' if ended is None else f'ended ({ended})'}, goals {self.goals(name)}, "
            words += f"beyond the page {node.beyond} and {node.apart}, not answered {node.unanswered}"
            for service, port in sorted(self.page.servers(index).items()):
                part = service.rpartition("/")[2]
                words += f"; {part}: {port.matched} clients, {port.passed} taken, {port.gated} held"
            known.append(words)
        return " | ".join(known)

    async def accepted(self, order: int, feedback: Any = None) -> Any:
        goal = await self.result(self.client.send_goal_async(self._type.Goal(order=order), feedback))
        assert goal.accepted
        return goal

    def finish(self, order: int) -> None:
        """Have the goals of ``order`` succeed now."""
        (self._program.parent / f"finished {order}").touch()

    def goals(self, name: int) -> list[GoalState]:
        return [goal.state for goal in self.page.goals(self.indices[name])]

    async def reach(self, name: int, expected: list[GoalState]) -> None:
        """Wait for its goals' states: the library records a response that it has sent, maybe after it has arrived."""
        await self.bare.until(lambda: sorted(self.goals(name)) == expected)

    def end(self, name: int) -> None:
        self.processes[name].kill()
        self.processes[name].wait()

    def close(self) -> None:
        self.client.destroy()
        for process in self.processes.values():
            process.kill()
            process.wait()


@pytest.fixture
def actions(tmp_path: Path, gate_library: Path) -> Iterator[Actions]:
    pytest.importorskip("test_msgs.action", reason="no package with a ROS action is installed")
    with Bare() as bare:
        made = Actions(tmp_path, gate_library, bare)
        try:
            yield made
        finally:
            made.close()


def test_a_goal_stays_with_the_server_that_has_accepted_it(actions: Actions) -> None:
    from action_msgs.msg import GoalStatus
    from action_msgs.srv import CancelGoal

    async def scenario() -> None:
        await actions.start(OLD)
        await actions.start(NEW, OLD)
        heard: list[int] = []
        finishes = await actions.accepted(LONG, lambda message: heard.append(message.feedback.sequence[-1]))
        asked = finishes.get_result_async()
        stopped, among_all = await actions.accepted(ENDLESS), await actions.accepted(ENDLESS)
        await actions.reach(OLD, [GoalState.ACCEPTED] * 3)
        assert not actions.goals(NEW)
        actions.give(NEW)
        before = len(heard)

        # New goals go to the new one, and what is asked about one goes to its own.
        short, new = await actions.accepted(2), await actions.accepted(ENDLESS)
        done = await actions.result(short.get_result_async())
        assert (done.status, list(done.result.sequence)) == (GoalStatus.STATUS_SUCCEEDED, [0, 1, NEW])
        await actions.reach(NEW, [GoalState.ACCEPTED, GoalState.FETCHED])
        answer = await actions.result(stopped.cancel_goal_async())
        assert [bytes(each.goal_id.uuid) for each in answer.goals_canceling] == [bytes(stopped.goal_id.uuid)]
        done = await actions.result(stopped.get_result_async())
        assert (done.status, done.result.sequence[-1]) == (GoalStatus.STATUS_CANCELED, OLD)
        await actions.bare.until(lambda: len(heard) > before + 2)
        actions.finish(LONG)
        done = await actions.result(asked)
        counted = list(done.result.sequence)
        assert (done.status, counted) == (GoalStatus.STATUS_SUCCEEDED, [*range(len(counted) - 1), OLD])
        assert set(heard) == {OLD} and len(counted) > before

        # All goals: both cancel theirs, and one answer names all of them.
        third = await actions.accepted(ENDLESS)
        cancel = actions.bare.node.create_client(CancelGoal, "/count/_action/cancel_goal")
        await actions.bare.until(cancel.service_is_ready)
        answer = await actions.result(cancel.call_async(CancelGoal.Request()))
        assert answer.return_code == CancelGoal.Response.ERROR_NONE
        expected = {bytes(each.goal_id.uuid) for each in (among_all, new, third)}
        found = [bytes(each.goal_id.uuid) for each in answer.goals_canceling]
        assert (len(found), set(found)) == (3, expected)
        for goal, server in ((among_all, OLD), (new, NEW), (third, NEW)):
            done = await actions.result(goal.get_result_async())
            assert (done.status, done.result.sequence[-1]) == (GoalStatus.STATUS_CANCELED, server)
        await actions.bare.until(lambda: set(actions.goals(OLD)) == {GoalState.FETCHED})  # it has drained

        # The new one dies, and the old one goes on.
        actions.processes[NEW].send_signal(signal.SIGKILL)
        actions.processes[NEW].wait()
        last = await actions.accepted(1)
        done = await actions.result(last.get_result_async())
        assert done.result.sequence[-1] == OLD

    run(scenario())


def test_the_goals_of_one_server_are_cancelled_by_the_page(actions: Actions) -> None:
    """As at the end of the patience: no client has asked for it, and the other server's goals go on."""
    from action_msgs.msg import GoalStatus

    async def scenario() -> None:
        page = actions.page
        await actions.start(OLD)
        goals = [await actions.accepted(ENDLESS) for _ in range(2)]
        await actions.start(NEW, OLD)
        actions.give(NEW)
        other = await actions.accepted(20)
        page.cancel_goals(actions.indices[OLD])
        for goal in goals:
            done = await actions.result(goal.get_result_async())
            assert (done.status, done.result.sequence[-1]) == (GoalStatus.STATUS_CANCELED, OLD)
        done = await actions.result(other.get_result_async())
        assert (done.status, done.result.sequence[-1]) == (GoalStatus.STATUS_SUCCEEDED, NEW)
        assert len(page.goals(actions.indices[NEW])) == 1 <= GOALS

    run(scenario())


@pytest.mark.parametrize("second", [False, pytest.param(True, marks=pytest.mark.long)])
def test_a_result_that_no_client_has_fetched_outlasts_its_server(actions: Actions, second: bool) -> None:
    """The successor answers with it, and so does the one after that."""
    from action_msgs.msg import GoalStatus

    third = 1003

    async def scenario() -> None:
        page = actions.page
        await actions.start(OLD, second=second)
        await actions.start(NEW, OLD, second=second)
        goals = [await actions.accepted(order) for order in (2, 3)]
        actions.give(NEW)
        await actions.reach(OLD, [GoalState.ENDED] * 2)
        gates = Gates(page, actions.indices[OLD], ComponentSpec("Server"))
        for goal in gates.unfetched():
            await actions.bare.until(partial(gates.keep_result, goal, gates.ask_for_result(goal)))
        actions.end(OLD)
        page.free(actions.indices[OLD])

        async def ends(goal: Any, expected: list[int]) -> None:
            done = await actions.result(goal.get_result_async())
            assert (done.status, list(done.result.sequence)) == (GoalStatus.STATUS_SUCCEEDED, expected)

        await ends(goals[0], [0, 1, OLD])
        await actions.start(third, NEW, second=second)
        actions.give(third)
        actions.end(NEW)
        page.free(actions.indices[NEW])
        await ends(goals[1], [0, 1, 2, OLD])
        # The oldest one is given up for one that has no room beside it: then nobody knows that goal.
        page.keep_result(bytes(16), bytes(KEPT_RESULTS - 1))
        done = await actions.result(goals[0].get_result_async())
        assert done.status == GoalStatus.STATUS_UNKNOWN

    run(scenario())


def test_goals_that_the_page_has_no_room_for_stay_with_their_server(actions: Actions) -> None:
    """What is asked about them later is answered by their server; once there is room, they are as any other."""
    from action_msgs.msg import GoalStatus
    from action_msgs.srv import CancelGoal

    async def scenario() -> None:
        page = actions.page
        await actions.start(OLD)
        old = page.layout.nodes[actions.indices[OLD]]
        places = page._requests[old.requests - 1].goals
        for goal in places:  # in progress at another node
            goal.word = GoalState.ACCEPTED << 12 | NODES
        asked, unasked, stopped = [await actions.accepted(order) for order in (LONG, LONG, ENDLESS)]
        result = asked.get_result_async()
        await actions.start(NEW, OLD)
        await actions.bare.until(lambda: (old.beyond, old.apart) == (3, 3))
        assert actions.goals(OLD) == []
        actions.give(NEW)
        answer = await actions.result(stopped.cancel_goal_async())
        assert [bytes(each.goal_id.uuid) for each in answer.goals_canceling] == [bytes(stopped.goal_id.uuid)]
        done = await actions.result(stopped.get_result_async())
        assert (done.status, done.result.sequence[-1]) == (GoalStatus.STATUS_CANCELED, OLD)
        await actions.bare.until(lambda: (old.beyond, old.apart) == (2, 2))
        actions.finish(LONG)
        for waiting in (result, unasked.get_result_async()):
            done = await actions.result(waiting)
            assert (done.status, done.result.sequence[-1]) == (GoalStatus.STATUS_SUCCEEDED, OLD)
        await actions.bare.until(lambda: (old.beyond, old.apart) == (0, 0))

        # All goals: those of either server are in one answer, also where neither has room.
        actions.give(OLD)
        last = await actions.accepted(ENDLESS)
        actions.give(NEW)
        other = await actions.accepted(ENDLESS)
        cancel = actions.bare.node.create_client(CancelGoal, "/count/_action/cancel_goal")
        await actions.bare.until(cancel.service_is_ready)
        answer = await actions.result(cancel.call_async(CancelGoal.Request()))
        found = {bytes(each.goal_id.uuid) for each in answer.goals_canceling}
        assert found == {bytes(each.goal_id.uuid) for each in (last, other)}

        # One that has ended, and of which no client has fetched the result, is known as soon as there is room.
        await actions.bare.until(lambda: (old.beyond, old.apart) == (0, 1))
        assert actions.goals(OLD) == []
        for place in places[GOALS - 2 :]:
            place.word = 0
        for name in (OLD, NEW):
            await actions.reach(name, [GoalState.ENDED])
        assert old.apart == 0
        done = await actions.result(last.get_result_async())
        assert (done.status, done.result.sequence[-1]) == (GoalStatus.STATUS_CANCELED, OLD)

        # A goal that no server has: the client is told so, by one of them.
        unknown = type(last)(actions.client, type(last.goal_id)(uuid=[7] * 16), None)
        assert (await actions.result(actions.client._get_result_async(unknown))).status == GoalStatus.STATUS_UNKNOWN

        # A server that leaves while its process goes on, as that of a node which is unloaded, has none any more.
        for place in places:
            place.word = GoalState.ACCEPTED << 12 | NODES
        new = page.layout.nodes[actions.indices[NEW]]
        await actions.accepted(ENDLESS)
        await actions.bare.until(lambda: (new.beyond, new.apart) == (1, 1))
        (actions.folder / "left").touch()
        await actions.bare.until(lambda: (new.beyond, new.apart) == (0, 0))

    run(scenario())


@pytest.mark.long
def test_what_only_the_new_server_has_received_about_a_goal_of_the_old_one_is_answered_once_that_has_ended(
    actions: Actions,
) -> None:
    """However long that takes: nothing else would answer it."""
    from action_msgs.msg import GoalStatus

    async def scenario() -> None:
        await actions.start(OLD)
        goal = await actions.accepted(ENDLESS)
        await actions.start(NEW, OLD)
        actions.give(NEW)
        old = actions.processes[OLD]
        old.send_signal(signal.SIGSTOP)  # it receives nothing any more
        result, begun = goal.get_result_async(), time.monotonic()
        await actions.bare.until(lambda: time.monotonic() > begun + HELD)
        assert not result.done()
        actions.end(OLD)
        assert (await actions.result(result)).status == GoalStatus.STATUS_UNKNOWN

    run(scenario())
