"""Bounds of servers: what the library records of them, what is made of it, and what their clients do about it."""

from __future__ import annotations

import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from midstride.backends.ros2.manager.seen_answers import SeenAnswers
from midstride.backends.ros2.manager.seen_nodes import SeenNodes
from midstride.codec.component_form import NamedComponentForm
from midstride.foreign.gated_reflex import broken_assumptions
from midstride.foreign.gates import Gates
from midstride.foreign.node import ForeignNode, of_topics
from midstride.foreign.page import SEND_GOAL, Page
from midstride.foreign.page_layout import INPUT, LATEST, SERVER, PagePort
from midstride.foreign.record import ForeignRecord
from midstride.foreign.reported_states import ReportedStates
from midstride.lang.load import load_text
from midstride.node.control.response_watch import STOPPED, ResponseWatch
from tests.foreign.lab import Lab, until, variables

S = 1_000_000_000


class Served:
    """A server, as the page shows it, and what is seen of it. Times in s, from an arbitrary start."""

    def __init__(self, within: float, missed: int | None = None) -> None:
        self.port = PagePort(kind=SERVER, node=3)
        self.watch = ResponseWatch(within, missed)
        self.beat = 0
        self.process = 100
        self.look(0)

    def answers(self, *seconds: float) -> None:
        for took in seconds:
            self.port.took[self.port.answered % LATEST] = int(took * 1e6)
            self.port.answered += 1

    def look(self, at: float, beats: bool = True) -> tuple[str, float] | None:
        """What it breaks its bound by, and for how long (s)."""
        self.beat += beats
        self.watch.look(self.port, (3, self.process), self.beat, int((1000 + at) * S))
        found = self.watch.responses
        return None if found.broken is None else (found.broken, round(found.silent, 3))

    def since(self, at: float) -> int:
        return int((1000 + at) * S)


def test_a_request_that_waits_for_longer_than_is_tolerated() -> None:
    served = Served(0.05, 5)
    assert served.watch.tolerated == pytest.approx(0.3)
    served.port.waiting = served.since(10)
    assert served.look(10.3) is None
    assert served.look(10.31) == ("has not answered a request", 0.31)
    assert served.watch.responses.words == "has not answered a request for 0.31 s, 50 ms are promised"
    served.port.waiting = 0
    served.answers(0.32)
    assert served.look(10.5) is None  # one that is late is tolerated


def test_a_server_that_is_busy_with_a_request_has_not_answered_it() -> None:
    """Cyclone DDS says when a request was taken, which is after the wait for it; Fast DDS when it arrived."""
    for arrived in (9.999, 10.001):
        served = Served(0.05, 5)
        served.port.waiting, served.port.busy = served.since(arrived), served.since(10)
        assert served.look(12) == ("has not answered a request", round(12 - arrived, 3))
        served.port.waiting = served.since(10.2)  # another one, which a further thread has taken
        assert served.look(12) == ("has not waited for requests", 2.0)


def test_unless_stated_as_much_is_tolerated_as_of_messages() -> None:
    assert ResponseWatch(0.05).tolerated == 5.0
    assert ResponseWatch(1.0).tolerated == 11.0


def test_a_request_that_is_never_answered_beside_others_that_are() -> None:
    """It is one that has missed the bound, as one message is that was lost."""
    served = Served(0.05, 5)
    served.port.waiting = served.since(10)
    for second in range(11, 20):
        served.answers(0.01)
        assert served.look(second) is None
    assert served.look(19.4) == ("has not answered a request", 0.4)


def test_an_executor_that_does_not_wait_for_requests() -> None:
    served = Served(0.05, 5)
    served.port.busy = served.since(10)
    assert served.look(10.2) is None
    assert served.look(12) == ("has not waited for requests", 2.0)
    served.port.busy = 0
    assert served.look(12.5) is None


def test_a_process_that_is_stopped() -> None:
    served = Served(0.05, 5)
    assert served.look(STOPPED, beats=False) is None
    assert served.look(STOPPED + 0.1, beats=False) == ("has not run", STOPPED + 0.1)
    assert served.look(STOPPED + 0.2) is None


def test_responses_that_are_late_in_succession() -> None:
    """More than are tolerated, for longer than is; then it is not known, until there are others."""
    served = Served(0.05, 5)
    served.answers(*[0.1] * 5)
    assert served.look(1) is None
    served.answers(0.02)
    assert served.look(2) is None
    for number in range(6):
        served.answers(0.1)
        found = served.look(3 + number / 10)
    assert found == ("has answered late", 0.6)
    assert served.watch.responses.late == 11
    assert served.look(3.9) is None
    served.answers(0.1)
    assert served.look(4) == ("has answered late", 1.1)
    served.answers(0.04)
    assert served.look(4.1) is None


def test_of_more_responses_than_the_page_has_the_last_ones_count() -> None:
    served = Served(0.05)
    served.answers(*[0.1] * LATEST, *[0.01] * LATEST)
    served.look(1)
    assert (served.watch.answered, served.watch.late) == (LATEST, 0)
    assert served.watch.responses.longest == pytest.approx(0.01)


def test_another_server_begins_anew() -> None:
    served = Served(0.05, 5)
    served.answers(*[0.1] * 7)
    served.look(1)
    served.look(1.5)
    served.process += 1
    served.port.answered = 0
    assert served.look(1.6) is None
    assert served.watch.responses.answered == 0
    served.watch.look(None, (0, 0), 0, 0)
    assert served.watch.responses.answered == 0


# -- what the library records ---------------------------------------------------------------------------------------


class Server:
    """A process with a server, which does what it is asked to."""

    def __init__(self, process: subprocess.Popen[str], port: Callable[[], PagePort | None]) -> None:
        self.process, self._port = process, port

    @property
    def port(self) -> PagePort:
        found = self._port()
        assert found is not None
        return found

    def ask(self, line: str) -> None:
        """Begin to do it."""
        assert self.process.stdin is not None
        self.process.stdin.write(f"{line}\n")
        self.process.stdin.flush()

    def done(self) -> None:
        assert self.process.stdout is not None
        assert self.process.stdout.readline().strip() in {"ready", "done"}

    def does(self, line: str) -> None:
        self.ask(line)
        self.done()


@contextmanager
def server(lab: Lab, of: int | None = None, **environment: str) -> Iterator[Server]:
    """``of``: the index of the node that answers its requests; None: it does."""
    page = lab.page
    index = page.allocate("server")
    page.have_requests(index, of)
    given = variables(page.path, lab.programs, lab.library, lab.log, index)
    process = subprocess.Popen(
        [lab.programs / "server", "/count"],
        env={**given, **environment},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        made = Server(process, lambda: page.server("/count"))
        made.done()
        yield made
    finally:
        process.kill()
        process.communicate()


def test_the_page_says_since_when_the_oldest_request_waits_and_how_long_the_last_took(lab: Lab) -> None:
    with server(lab) as served:
        assert (served.port.waiting, served.port.answered) == (0, 0)
        before = time.monotonic_ns()
        served.does("take")
        between = time.monotonic_ns()
        served.does("take")
        assert before <= served.port.waiting <= between
        served.does("answer 1")
        assert between <= served.port.waiting <= time.monotonic_ns()
        assert served.port.answered == 1
        for number in range(2, LATEST + 4):
            served.does(f"answer {number}")
            served.does("take")
        assert served.port.answered == LATEST + 3
        assert lab.page.layout.nodes[served.port.node - 1].unanswered == 1
        served.does(f"answer {LATEST + 4}")
        assert served.port.waiting == 0
        assert 0 <= served.port.took[0] <= (time.monotonic_ns() - between) / 1e3


@pytest.mark.parametrize("take", ["take", "plain"])
def test_it_waits_since_the_middleware_has_received_it(lab: Lab, take: str) -> None:
    with server(lab, FAKE_RECEIVED_MS="700") as served:
        served.does(take)
        assert 0.7 * S <= time.monotonic_ns() - served.port.waiting < 60 * S
        served.does("answer 1")
        assert 0.7e6 <= served.port.took[0] < 60e6


def test_more_requests_than_there_is_room_for_are_answered_all_the_same(lab: Lab) -> None:
    with server(lab) as served:
        for _ in range(50):
            served.does("take")
        for number in range(50, 0, -1):
            served.does(f"answer {number}")
        assert served.port.waiting == 0
        assert 0 < served.port.answered < 50  # of those beyond, nothing is measured
        assert lab.page.layout.nodes[served.port.node - 1].unanswered == 0


def test_the_page_says_since_when_no_executor_waits(lab: Lab) -> None:
    with server(lab) as served:
        assert served.port.busy == 0  # it is not known whether one ever does
        served.does("wait 1")
        assert 0 < served.port.busy <= time.monotonic_ns()
        served.ask("wait 300")
        until(lambda: served.port.busy == 0, "nothing waits")
        served.done()
        assert served.port.busy
        served.does("events")
        served.does("wait 1")
        assert served.port.busy == 0


@pytest.mark.parametrize("taken", [False, True])
def test_a_server_stays_one_while_its_part_of_the_page_is_free(lab: Lab, taken: bool) -> None:
    """As that of a node is which its container has unloaded, while an executor still has its servers."""
    with server(lab) as served:
        index = served.port.node - 1
        lab.page.free(index)
        if taken:
            lab.page.set_ports(lab.page.allocate("another"), [("/count", INPUT)])
        wanted, ended = lab.page.beat(index) + 3, served.process.poll
        until(lambda: ended() is not None or lab.page.beat(index) >= wanted, "its helper thread does not look")
        assert ended() is None
        served.does("take")


def test_capture_reads_how_long_each_took(
    lab: Lab, tmp_path: Path, gate_library: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without being the manager; what was answered before it looked does not count."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(gate_library.parent.parent))
    with server(lab) as served:
        lab.processes[served.port.node - 1] = served.process  # type: ignore[assignment]
        lab.record("server", served.port.node - 1, next(iter(load_text(TEXT).require().components.values())))
        served.does("take")
        served.does("answer 1")
        seen = SeenAnswers(SeenNodes(tmp_path))
        seen.look()
        assert seen.took == {("/server", "/count"): []}
        for number in (2, 3):
            served.does("take")
            served.does(f"answer {number}")
        seen.look()
        seen.look()
        (took,) = seen.took.values()
        assert len(took) == 2 and all(0 <= each < 60 for each in took)
        for number in range(4, LATEST + 9):
            served.does("take")
            served.does(f"answer {number}")
        seen.look()
        assert len(took) == 2 + LATEST
        served.port.answered = 0
        lab.page.layout.nodes[served.port.node - 1].pid += 1
        seen.look()
        assert len(took) == 2 + LATEST, "the part of a node that has ended was given to another"


# -- what clients do about it ---------------------------------------------------------------------------------------

TEXT = """system mapping
contract Map = rcl_interfaces/srv/ListParameters responds within 0.5 s
service /map : Map
service /free : rcl_interfaces/srv/ListParameters
action /dock : nav2_msgs/action/DockRobot
component Server {
  run "server" gate preload
  server map
  server free
  action server dock
  functionality serve {
    produces map, free, dock
    mode normal {
      guarantee map : Map
      guarantee free : rcl_interfaces/srv/ListParameters
      guarantee dock : nav2_msgs/action/DockRobot accepts within 0.2 s
    }
    mode off { }
  }
}
component User {
  run "user" gate preload
  client map : Map tolerates 3 missed
  client free : rcl_interfaces/srv/ListParameters
  action client dock : nav2_msgs/action/DockRobot accepts within 0.2 s tolerates 1 missed
  functionality mapping { uses map  mode normal { assume map }  mode off { } }
  functionality freeing { uses free  mode normal { assume free }  mode off { } }
  functionality docking { uses dock  mode normal { assume dock }  mode off { } }
}
"""
NAMES = ("map", "free", "dock")


class Robot:
    """A server and its user, whose processes are simulated by what the library would write."""

    def __init__(self, folder: Path, library: Path) -> None:
        components = load_text(TEXT).require().components
        self.page = Page(folder / "page", library)
        self.nodes = {}
        for name, each in components.items():
            gates = Gates(self.page, self.page.allocate(name), of_topics(each))
            gates.prepare({})
            record = ForeignRecord(
                instance=name,
                node=f"/{name}",
                token="a token",
                uuid=name,
                pid=1,
                started=0,
                declaration=NamedComponentForm.of(each),
                index=gates.index,
                topics={port: f"/{port}" for port in NAMES},
                modes={functionality.name: "normal" for functionality in each},
                links=dict.fromkeys(NAMES, "open"),
                welcomed=True,
            )
            node = self.nodes[name] = ForeignNode(record, folder, gates, ReportedStates())
            for functionality in record.modes:
                node._since[functionality] -= 3600
        self.index = self.nodes["Server"].gates.index if self.nodes["Server"].gates else -1
        self.page.set_ports(self.index, [("/map", SERVER), ("/free", SERVER), (f"/dock{SEND_GOAL}", SERVER)])
        for port in self.ports():
            port.endpoints = 1

    def ports(self) -> list[PagePort]:
        found = [port for port in self.page.every_port() if port.node == self.index + 1 and port.kind == SERVER]
        return sorted(found, key=lambda port: int(port.number))

    def waits(self, port: str, seconds: float) -> None:
        self.ports()[NAMES.index(port)].waiting = time.monotonic_ns() - int(seconds * S)

    def broken(self) -> dict[str, str]:
        return {name: because for name, (_, because) in broken_assumptions(self.nodes["User"]).items()}


@pytest.fixture
def robot(tmp_path: Path, gate_library: Path) -> Robot:
    return Robot(tmp_path, gate_library)


def test_what_relies_on_a_server_that_hangs_is_broken(robot: Robot) -> None:
    assert robot.broken() == {}
    robot.waits("map", 1.9)
    assert robot.broken() == {}
    robot.waits("map", 3)
    words = robot.broken()
    assert words == {
        "mapping": "the assumption of mode normal broke: client map: the server of /map has not answered a request for "
        "3 s, 0.5 s are promised (silence is tolerated for 2 s)"
    }
    user, server = robot.nodes["User"], robot.nodes["Server"]
    found = user.state().ports["map"]["/map"].responses
    assert found is not None and found.broken == "has not answered a request"
    # By its own promise, for which nothing else is stated, it may take 5.5 s.
    own = server.state().ports["map"]["/map"].responses
    assert own is not None and own.broken is None and own.silent > 2.9
    robot.waits("map", 6)
    own = server.state().ports["map"]["/map"].responses
    assert own is not None and own.broken == "has not answered a request"
    robot.ports()[0].waiting = 0
    assert robot.broken() == {}


def test_nothing_is_claimed_where_no_bound_is_stated(robot: Robot) -> None:
    robot.waits("free", 3600)
    assert robot.broken() == {}
    for node in robot.nodes.values():
        assert node.state().ports["free"]["/free"].responses is None


def test_of_an_action_the_bound_is_on_the_acceptance_of_goals(robot: Robot) -> None:
    robot.waits("dock", 0.5)
    assert list(robot.broken()) == ["docking"]
    assert "action client dock: the server of /dock has not answered a request for 0.5" in robot.broken()["docking"]


def test_it_counts_from_the_entry_to_the_mode(robot: Robot) -> None:
    robot.waits("map", 30)
    robot.nodes["User"].enter_modes({"mapping": "normal"}, "a test")
    assert robot.broken() == {}


def test_a_server_that_does_not_answer_any_more_is_not_judged(robot: Robot) -> None:
    """What relies on it is up to the change that has another one answer."""
    robot.waits("map", 30)
    assert list(robot.broken()) == ["mapping"]
    new = robot.page.allocate("Server_2")
    robot.page.have_requests(new, robot.index)
    robot.page.set_ports(new, [("/map", SERVER)])
    for port in robot.page.every_port():
        port.endpoints = 1
    robot.page.give_requests(new, 0.0)
    assert robot.broken() == {}
