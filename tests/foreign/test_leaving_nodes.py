"""Nodes of a container that are about to be unloaded, in plain processes: nothing calls them any more."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator

import pytest

from midstride.foreign.page import Page
from midstride.foreign.page_layout import INPUT, OPEN
from tests.foreign.lab import Lab, until, variables

TAKEN = 0
# What rcl returns where there was no message, response or request, and where a timer calls nothing.
NO_MESSAGE, NO_RESPONSE, NO_REQUEST, CANCELED = 401, 501, 601, 801
CALLS = {
    "take": NO_MESSAGE,
    "response": NO_RESPONSE,
    "info": NO_RESPONSE,
    "request": NO_REQUEST,
    "timer": CANCELED,
}


class Container:
    """A process with one node, ``index`` in the page, besides that as which it was started, ``own``."""

    def __init__(self, lab: Lab, listed: bool = True, requests: bool = True) -> None:
        self.page: Page = lab.page
        self.own = self.page.allocate("container")
        self.index = self.page.allocate("node", process=self.own, name="/node")
        if listed:
            self.page.set_ports(self.index, [("/numbers", INPUT)])
            self.page.ports(self.index)[0].gate = OPEN
        if requests:
            self.page.have_requests(self.index)
        self.process = subprocess.Popen(
            [lab.programs / "leaving", "/node", "/numbers", "/serve"],
            env=variables(lab.page.path, lab.programs, lab.library, lab.log, self.own),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        assert self._line() == "ready"

    def _line(self) -> str:
        assert self.process.stdout is not None
        return self.process.stdout.readline().strip()

    def does(self, line: str) -> int:
        assert self.process.stdin is not None
        self.process.stdin.write(f"{line}\n")
        self.process.stdin.flush()
        return int(self._line())

    def looks(self) -> None:
        wanted = self.page.beat(self.index) + 3
        until(lambda: self.page.beat(self.index) >= wanted, "its helper thread does not look")

    def is_called(self) -> bool:
        return self.page.is_called(self.index)


@pytest.fixture
def made(lab: Lab, request: pytest.FixtureRequest) -> Iterator[Container]:
    yield from contained(lab, *getattr(request, "param", ()))


@pytest.fixture(params=["programs", "packaged_programs"])
def linked(lab: Lab, request: pytest.FixtureRequest) -> Iterator[Container]:
    """A container with librcl linked either way."""
    lab.programs = request.getfixturevalue(request.param)
    yield from contained(lab)


def contained(lab: Lab, *how: bool) -> Iterator[Container]:
    container = Container(lab, *how)
    yield container
    container.process.kill()
    container.process.communicate()


@pytest.mark.parametrize("made", [(True, True), (False, False)], indirect=True, ids=["ports", "no ports"])
@pytest.mark.parametrize("call", CALLS)
def test_nothing_calls_a_node_that_leaves(made: Container, call: str) -> None:
    assert made.does(call) == TAKEN
    made.page.leaves(made.index, True)
    assert made.does(call) == CALLS[call]
    assert not made.is_called()
    made.page.leaves(made.index, False)
    made.looks()
    assert made.does(call) == TAKEN


def test_nothing_calls_a_node_that_its_container_has_unloaded(made: Container) -> None:
    """Its container may destroy its timers, clients and servers later."""
    made.page.free(made.index)
    assert {call: made.does(call) for call in CALLS} == CALLS


def test_a_timer_is_due_without_a_call_while_its_node_leaves(linked: Container) -> None:
    """Else the executor would find it ready at once; and it goes on by itself if the node stays after all."""
    seen = [(linked.does("timer"), linked.does("due"), linked.does("calls"))]
    linked.page.leaves(linked.index, True)
    seen += [(linked.does("timer"), linked.does("due"), linked.does("calls")) for _ in range(2)]
    linked.page.leaves(linked.index, False)
    seen += [(linked.does("timer"), linked.does("due"), linked.does("calls"))]
    assert seen == [(TAKEN, 1, 1), (CANCELED, 2, 1), (CANCELED, 3, 1), (TAKEN, 4, 2)]


def test_a_request_is_held_until_the_node_stays_after_all(made: Container) -> None:
    made.page.leaves(made.index, True)
    assert made.does("request") == NO_REQUEST
    made.looks()
    assert made.page.layout.nodes[made.index].unanswered == 0
    made.page.leaves(made.index, False)
    made.looks()
    assert made.does("request") == TAKEN
    assert made.page.layout.nodes[made.index].unanswered == 1


@pytest.mark.parametrize("call", CALLS)
def test_the_page_says_whether_a_call_that_has_begun_still_runs(made: Container, call: str) -> None:
    """Until rclcpp says that it has ended, or its thread does something else."""
    assert not made.is_called()
    made.does(call)
    assert made.is_called()
    made.page.leaves(made.index, True)
    made.does("begin")
    assert made.is_called()
    made.does("end")
    assert not made.is_called()
    made.page.leaves(made.index, False)
    made.looks()
    made.does(call)
    assert made.is_called()
    made.does("wait")
    assert not made.is_called()


def test_a_call_within_a_callback_does_not_end_it(made: Container) -> None:
    """As where a callback waits for a response."""
    made.does("take")
    made.does("begin")
    for line in ("wait", "response", "begin", "end"):
        made.does(line)
        assert made.is_called()
    made.does("end")
    assert not made.is_called()


def test_clients_that_are_removed_make_room_for_others(made: Container) -> None:
    made.does("again")
    made.page.leaves(made.index, True)
    assert made.does("response") == NO_RESPONSE


def test_the_server_of_a_node_that_has_ended_is_not_looked_at(made: Container) -> None:
    """Where the server has not been ended before, as that of type descriptions in rclpy."""
    server = made.page.servers(made.index)["/serve"]
    assert server.endpoints == 1
    made.does("over")
    made.looks()
    assert server.endpoints == 0


def test_the_server_of_type_descriptions_is_seen_once_however_librcl_is_linked(linked: Container) -> None:
    assert linked.does("describe") == 0
    server = linked.page.servers(linked.index)["/node/get_type_description"]
    assert server.endpoints == 1
    linked.does("over")
    assert server.endpoints == 0


def test_the_node_as_which_the_process_was_started_is_not_counted(made: Container) -> None:
    assert not made.page.is_called(made.own)
    made.does("take")
    assert not made.page.is_called(made.own)
