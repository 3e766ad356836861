"""The page of shared memory: any number of ports, several nodes in a process, kinds of ports, and its versions."""

from __future__ import annotations

import asyncio
import ctypes
import os
import struct
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from pathlib import Path

import pytest

from midstride.backends.ros2.manager.foreign_nodes import ForeignNodes
from midstride.errors import BackendError
from midstride.foreign.gates import Gates
from midstride.foreign.page import PAGE, KnownSetting, Page, require_usable
from midstride.foreign.page_layout import (
    CLOSED,
    INPUT,
    MAGIC,
    NAMES_ONE,
    OLDEST,
    OPEN,
    OUTPUT,
    ROOM,
    SERVER,
    VERSION,
    PageLayout,
    PagePort,
    PortFlag,
)
from midstride.model.component import ComponentSpec
from midstride.node.handover.baton import BatonStep
from midstride.wire.sockets import SocketFolder
from tests.foreign.lab import MS, Lab, until, variables

RATED = PortFlag.RATED | PortFlag.OFFERS
SECOND = 1000  # what the other node of a process adds to the number of the writer


# -- ports -------------------------------------------------------------------------------------------------


def test_a_node_may_have_any_number_of_ports(tmp_path: Path, gate_library: Path) -> None:
    page = Page(tmp_path / "page", gate_library)
    index, other = page.allocate("many"), page.allocate("few")
    topics = [(f"/topic_{number}", INPUT if number % 2 else OUTPUT) for number in range(20 * ROOM)]
    page.set_ports(other, [("/mine", OUTPUT)])
    page.set_ports(index, topics)
    assert [(port.topic.decode(), port.kind) for port in page.ports(index)] == topics
    assert page.path.stat().st_size >= ctypes.sizeof(PageLayout) + len(topics) * ctypes.sizeof(PagePort)
    room = page.layout.room
    page.free(index)
    assert (page.ports(index), len(page.ports(other))) == ([], 1)
    again = page.allocate("many again")
    page.set_ports(again, topics)
    assert page.layout.room == room, "what another node has given back is used again"
    assert Page(page.path, gate_library).ports(again)[-1].topic.decode() == topics[-1][0]


def test_a_process_that_has_mapped_the_page_sees_it_grow(lab: Lab, monkeypatch: pytest.MonkeyPatch) -> None:
    early = lab.node(MS, RATED)
    lab.port(early).gate = OPEN
    many = lab.page.allocate("many")
    Gates(lab.page, many, ComponentSpec.of("Many")).prepare({})  # it lists its topics
    monkeypatch.setenv("FAKE_TOPICS", str(3 * ROOM))
    lab.run(many, MS, 10**12)
    until(lambda: len(lab.page.ports(many)) == 1 + 3 * ROOM, "not every topic is listed")
    assert [port.number for port in lab.page.ports(many)] == list(range(1 + 3 * ROOM))
    late = lab.node(MS, RATED, baton=lab.port(early).baton)
    lab.page.step(lab.port(early).baton, BatonStep.NAME_SUCCESSOR, early, late)
    until(lambda: lab.written_by(late) > 10, "the later one does not take over")
    lab.kill(late)
    before = lab.written_by(early)
    until(lambda: lab.written_by(early) > before, "the earlier one does not go on")


def test_no_port_is_given_to_two_nodes(tmp_path: Path, gate_library: Path) -> None:
    page = Page(tmp_path / "page", gate_library)
    nodes = [page.allocate(f"node_{number}") for number in range(4)]
    topics = [(f"/topic_{number}", OUTPUT) for number in range(200)]
    with ThreadPoolExecutor(len(nodes)) as pool:
        list(pool.map(lambda index: Page(page.path, gate_library).set_ports(index, topics), nodes))
    for index in nodes:
        assert [port.topic.decode() for port in page.ports(index)] == [topic for topic, _ in topics]


def test_a_server_has_a_port_beside_a_publisher_of_that_name(lab: Lab) -> None:
    index = lab.page.allocate("both")
    lab.page.set_ports(index, [("/chat", SERVER), ("/chat", OUTPUT)])
    (output,), server = lab.page.ports(index), next(port for port in lab.page.every_port() if port.kind == SERVER)
    output.flags, output.baton, output.gate, server.gate = RATED, lab.page.new_baton(index), OPEN, CLOSED
    lab.start(index, "/chat", str(MS), "1000000")
    until(lambda: output.passed > 10, "it does not publish")
    assert (server.endpoints, server.passed, server.gated) == (0, 0, 0)


# -- several nodes in a process ------------------------------------------------------------------------------


def two(lab: Lab, monkeypatch: pytest.MonkeyPatch, messages: int = 10**12, flags: PortFlag = RATED) -> tuple[int, int]:
    """A process with two nodes that publish on one topic, the first with an open gate; their indices."""
    first = lab.page.allocate("first")
    second = lab.page.allocate("second", process=first, name="/second")
    for index in (first, second):
        lab.page.set_ports(index, [("/chat", OUTPUT)])
        lab.port(index).flags, lab.port(index).baton = flags, lab.page.new_baton(index)
    lab.port(first).gate = OPEN
    monkeypatch.setenv("FAKE_SECOND", "/second")
    lab.run(first, MS, messages)
    monkeypatch.delenv("FAKE_SECOND")
    return first, second


class Told:
    """A container in a process of ``lab`` that loads and unloads nodes as it is told; ``own``: its part of the page."""

    def __init__(self, lab: Lab) -> None:
        self.page, self.own = lab.page, lab.page.allocate("container")
        given = variables(lab.page.path, lab.programs, lab.library, lab.log, self.own)
        command = [str(lab.programs / "node"), "1", "/chat"]
        self.process = subprocess.Popen(
            command, env={**os.environ, **given, "FAKE_LOADS": "1"}, stdin=subprocess.PIPE, stdout=subprocess.PIPE
        )
        lab.processes[self.own] = self.process

    def tell(self, words: str) -> None:
        assert self.process.stdin is not None and self.process.stdout is not None
        self.process.stdin.write(f"{words}\n".encode())
        self.process.stdin.flush()
        assert self.process.stdout.readline() == b"done\n"

    def load(self, name: str) -> int:
        index = self.page.allocate(name, process=self.own, name=name)
        self.page.set_ports(index, [("/chat", OUTPUT)])
        self.tell(f"+{name}")
        assert self.page.layout.nodes[index].pid == self.process.pid and not self.page.is_dead(index)
        return index

    def unload(self, name: str) -> None:
        self.tell(f".{name}")
        self.tell(f"-{name}")


def test_a_container_that_goes_on_gives_back_the_parts_of_the_nodes_that_it_has_unloaded(lab: Lab) -> None:
    told = Told(lab)
    stays, given = told.load("/stays"), set[int]()
    room = lab.page.layout.room
    for number in range(600):
        name = f"/node_{number % 7}"
        index = told.load(name)
        given.add(index)
        if number % 2:  # as where a destructor returns late
            lab.page.free(index)
            told.unload(name)
        else:
            told.unload(name)
            assert lab.page.layout.nodes[index].pid == 0
            lab.page.free(index)
    assert (len(given), lab.page.layout.room) == (1, room)
    assert lab.page.ros_nodes(stays) == ["/stays"]
    assert lab.page.layout.nodes[stays].pid == told.process.pid and not lab.page.is_dead(stays)


def test_a_part_is_not_given_away_while_the_process_publishes_as_that_node(lab: Lab) -> None:
    told = Told(lab)
    index = told.load("/node")
    told.tell("-/node")
    lab.page.free(index)
    other = told.load("/other")
    assert other != index
    assert lab.page.layout.nodes[index].pid == told.process.pid and not lab.page.is_dead(index)


def test_a_node_of_a_container_is_known_until_nothing_of_it_is_there(lab: Lab) -> None:
    """Also where that has said to have unloaded it, and another thread of it still uses it."""
    told = Told(lab)
    stays, index = told.load("/stays"), told.load("/node")
    assert lab.page.loaded_into(told.own, {stays}) == {"/node"} and lab.page.loaded_into(stays, ()) == set()
    lab.page.free(index)
    assert lab.page.loaded_into(told.own, ()) == {"/stays", "/node"}
    told.unload("/node")
    assert lab.page.loaded_into(told.own, ()) == {"/stays"}
    lab.page.free(told.load("/node"))
    assert lab.page.loaded_into(told.own, {stays}) == {"/node"}
    lab.kill(told.own)
    assert lab.page.loaded_into(told.own, {stays}) == set()


def test_a_part_that_is_given_to_another_process_is_left_alone(lab: Lab) -> None:
    """The helper thread of the one that had it writes nothing there, and the lock is that of the other."""
    told = Told(lab)
    told.load("/stays")
    index = told.load("/node")
    told.unload("/node")
    lab.page.free(index)
    other = lab.node(MS, RATED, messages=5)
    assert other == index
    until(lambda: lab.port(other).matched == 3, "its own process has not looked")
    before = lab.page.beat(told.own)
    until(lambda: lab.page.beat(told.own) > before + 2, "the other one does not look")
    assert lab.port(other).matched == 3
    lab.kill(other)
    assert lab.page.is_dead(other)


def test_the_nodes_of_a_process_are_listed_while_they_are_there(lab: Lab, monkeypatch: pytest.MonkeyPatch) -> None:
    index = lab.page.allocate("both")
    lab.page.set_ports(index, [("/chat", OUTPUT), ("/other", OUTPUT)])
    monkeypatch.setenv("FAKE_NODES", "/a,/b=/local,/c-")
    lab.run(index, MS, 10**12)
    # The rules of the command line name them all, as long as no node is to be named alone.
    assert lab.page.ros_nodes(index) == ["/given", "/local"]
    assert [port.topic for port in lab.page.ports(index)] == [b"/chat", b"/other"], "a node is no port"
    lab.page.free(index)
    assert lab.page.ros_nodes(index) == []


@pytest.mark.parametrize("linked", ["programs", "packaged_programs"])
def test_a_name_for_all_nodes_names_the_first_one_alone(
    lab: Lab, monkeypatch: pytest.MonkeyPatch, request: pytest.FixtureRequest, linked: str
) -> None:
    """One that its program names by a rule of its own is not meant; the first one keeps its name when made anew."""
    lab.programs = request.getfixturevalue(linked)
    index = lab.page.allocate("both")
    lab.page.set_ports(index, [("/chat", OUTPUT)])
    lab.page.layout.nodes[index].used |= NAMES_ONE
    monkeypatch.setenv("FAKE_NODES", "/helper=/local,/without!,/first-,/second,/first,/third=/other")
    lab.run(index, MS, 10**12)
    assert lab.page.ros_nodes(index) == ["/given", "/local", "/other", "/second", "/without"]


def test_where_the_page_has_no_room_for_a_node_they_are_not_known(lab: Lab) -> None:
    index = lab.page.allocate("both")
    assert lab.page.ros_nodes(index) == []
    lab.page.layout.nodes[index].unlisted = 1
    assert lab.page.ros_nodes(index) is None


def writers(lab: Lab, since: int) -> set[int]:
    return {writer for writer, _, _ in lab.records()[since:]}


def test_each_node_of_a_process_has_a_gate_of_its_own(lab: Lab, monkeypatch: pytest.MonkeyPatch) -> None:
    first, second = two(lab, monkeypatch)
    until(lambda: lab.port(second).gated > 10, "the second one does not write")
    assert (lab.port(first).endpoints, lab.port(second).endpoints) == (1, 1)
    assert writers(lab, 0) == {first + 1} and lab.port(second).passed == 0
    lab.port(second).gate, lab.port(first).gate = OPEN, CLOSED
    until(lambda: lab.port(second).passed > 10 and lab.port(first).gated > 10, "the second one does not publish")
    at, passed = lab.count(), lab.port(first).passed
    until(lambda: lab.count() > at + 10, "nothing is published")
    assert writers(lab, at) == {first + 1 + SECOND} and lab.port(first).passed == passed
    until(lambda: [lab.port(index).matched for index in (first, second)] == [3, 3], "the helper thread does not look")
    assert not lab.page.is_dead(first) and not lab.page.is_dead(second)
    lab.kill(first)
    assert lab.page.is_dead(first) and lab.page.is_dead(second)


def test_one_node_of_a_process_is_taken_over_from_while_the_other_goes_on(
    lab: Lab, monkeypatch: pytest.MonkeyPatch
) -> None:
    first, second = two(lab, monkeypatch)
    lab.port(second).gate = OPEN
    baton = lab.port(second).baton
    successor = lab.node(MS, RATED, baton=baton)
    lab.page.step(baton, BatonStep.NAME_SUCCESSOR, second, successor)
    until(lambda: lab.written_by(successor) > 10, "the new one does not take over")
    assert lab.word(baton).holder == successor + 1
    before, passed = lab.written_by(first), lab.written_by(second)
    until(lambda: lab.written_by(first) > before + 10, "the neighbour does not go on")
    assert lab.written_by(second) == passed
    lab.kill(successor)
    until(lambda: lab.written_by(second) > passed, "it does not go on where its successor has died")


def test_a_baton_passes_between_two_nodes_of_a_process_and_neither_takes_the_other_for_dead(
    lab: Lab, monkeypatch: pytest.MonkeyPatch
) -> None:
    first, second = two(lab, monkeypatch)
    baton = lab.port(second).baton = lab.port(first).baton
    lab.port(second).gate = OPEN
    old, new = first, second
    for _ in range(10):
        before = lab.written_by(new)
        lab.page.step(baton, BatonStep.NAME_SUCCESSOR, old, new)
        until(lambda index=new, count=before: lab.written_by(index) > count + 5, "no answer")  # type: ignore[misc]
        assert lab.word(baton).holder == new + 1
        old, new = new, old
    lab.kill(first)
    records = lab.records()
    changes = sum(before[0] != after[0] for before, after in pairwise(records))
    assert changes == 10, "they are interleaved"


def test_what_a_further_node_has_kept_is_published_when_its_gate_opens(
    lab: Lab, monkeypatch: pytest.MonkeyPatch
) -> None:
    first, second = two(lab, monkeypatch, 1, PortFlag.TIMED | PortFlag.OFFERS | PortFlag.KEEPS)
    until(lambda: bool(lab.port(second).kept), "it is not kept")
    lab.port(second).gate = OPEN
    beat = lab.page.beat(second)
    lab.page.ring(second)
    until(lambda: lab.written_by(second) == 1, "it is not published")
    until(lambda: lab.page.beat(second) > beat, "the helper thread has not looked to the end")
    before, between, after = (lab.page.beat(index) for index in (first, second, first))
    assert before <= between <= after, "the nodes of a process have one helper thread"


def test_the_place_of_a_node_is_not_given_away_while_its_process_goes_on(
    lab: Lab, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The kernel would take the process for the next one that has the place."""
    first, second = two(lab, monkeypatch)
    lab.page.free(second)
    assert lab.page.allocate("next") not in (first, second)
    lab.kill(first)
    assert lab.page.allocate("the one after") == second


TWO_NODES = """
import sys, time
import rclpy
from std_msgs.msg import String
rclpy.init()
nodes = [rclpy.create_node(name) for name in ("first", "second")]
publishers = [node.create_publisher(String, "/chat", 10) for node in nodes]
while True:
    for node, publisher in zip(nodes, publishers):
        publisher.publish(String(data=node.get_name()))
    time.sleep(0.005)
"""


@pytest.mark.ros2
def test_the_nodes_of_a_process_on_rcl_are_told_apart(tmp_path: Path, gate_library: Path) -> None:
    page = Page(tmp_path / "page", gate_library)
    first = page.allocate("first")
    second = page.allocate("second", process=first, name="/second")
    for index in (first, second):
        page.set_ports(index, [("/chat", OUTPUT)])
    (one,), (other,) = page.ports(first), page.ports(second)
    other.gate = OPEN
    environment = {
        **os.environ,
        "LD_PRELOAD": str(gate_library),
        "MIDSTRIDE_GATE_PAGE": str(page.path),
        "MIDSTRIDE_GATE_NODE": str(first),
        "ROS_DOMAIN_ID": str(1 + os.getpid() % 100),
    }
    with subprocess.Popen([sys.executable, "-c", TWO_NODES], env=environment) as process:
        try:
            until(lambda: one.gated > 10 and other.passed > 10, "they do not write")
            assert (one.passed, other.gated, one.endpoints, other.endpoints) == (0, 0, 1, 1)
            one.gate, other.gate = OPEN, CLOSED
            until(lambda: one.passed > 10 and other.gated > 10, "they do not write")
        finally:
            process.kill()


# -- versions ------------------------------------------------------------------------------------------------


def of_layout(path: Path, version: int, magic: int = MAGIC) -> bytes:
    """A page of another version, of which no more is known than its first bytes; what is in it."""
    head = PageLayout(magic, version, 1_353_792)
    path.write_bytes(bytes(head)[:64] + b"\1" * 1_353_728)
    return path.read_bytes()


@pytest.mark.parametrize("version", [OLDEST - 1, VERSION + 1])
def test_a_page_of_another_layout_is_refused_by_both_sides_and_left_as_it_is(
    tmp_path: Path, programs: Path, gate_library: Path, version: int
) -> None:
    content = of_layout(tmp_path / "page", version)
    refused = f"has layout {version}, and this version uses {OLDEST} to {VERSION}: .*midstride down"
    with pytest.raises(BackendError, match=refused):
        Page(tmp_path / "page", gate_library)
    with pytest.raises(BackendError, match=refused):
        require_usable(tmp_path / "page")
    log = tmp_path / "log"
    log.touch()
    os.truncate(log, 10**6)
    environment = {**os.environ, **variables(tmp_path / "page", programs, gate_library, log, 0)}
    command = [str(programs / "node"), "1", "/chat", "0", "100", "time"]
    done = subprocess.run(command, env=environment, check=True, capture_output=True, timeout=60, text=True)
    assert f"has no gate: {tmp_path}/page has layout {version}, and {OLDEST} to {VERSION} can be used" in done.stderr
    assert (tmp_path / "page").read_bytes() == content


def test_what_is_no_page_is_called_so(tmp_path: Path, gate_library: Path) -> None:
    of_layout(tmp_path / "page", VERSION, magic=7)
    with pytest.raises(BackendError, match="is no page of Midstride"):
        Page(tmp_path / "page", gate_library)


def test_a_node_that_runs_with_an_earlier_layout_is_named_and_goes_on(
    lab: Lab, monkeypatch: pytest.MonkeyPatch, gate_library: Path
) -> None:
    """As after an upgrade of Midstride while its manager was gone."""
    index = lab.node(MS, RATED)
    lab.port(index).gate = OPEN
    lab.page.layout.version = OLDEST - 1
    lab.record("talker", index, ComponentSpec.of("Talker"))
    assert lab.page.path.name == PAGE
    monkeypatch.setenv("XDG_CACHE_HOME", str(gate_library.parents[1]))

    async def scenario() -> None:
        nodes = ForeignNodes(lab.page.path.parent, SocketFolder(lab.page.path.parent / "components"), lambda _: None)
        with pytest.raises(BackendError, match=f"talker cannot be answered for: .* has layout {OLDEST - 1}"):
            await nodes.adopt("talker")
        await nodes.close()

    asyncio.run(scenario())
    before = lab.written_by(index)
    until(lambda: lab.written_by(index) > before + 10, "the node does not go on")


# -- requests to set parameters ----------------------------------------------------------------------------


def test_what_a_library_has_noted_of_requests_is_read_as_far_as_it_is_whole(tmp_path: Path, gate_library: Path) -> None:
    page = Page(tmp_path / "page", gate_library)
    index = page.allocate("set")
    assert page.settings(index) == []
    requests = [("/set/set_parameters", b"one"), ("/other/set_parameters", b"a\0b")]
    noted = [service.encode() + b"\0" + request for service, request in requests]
    whole = b"".join(struct.pack("<qQ", 1_500_000_000, len(each)) + each for each in noted)
    path = tmp_path / f"page.{index}.settings"
    for rest in range(len(whole) - len(noted[1]), len(whole)):
        path.write_bytes(whole[:rest])
        assert page.settings(index) == [KnownSetting(1.5, *requests[0])]
    path.write_bytes(whole)
    assert page.settings(index) == [KnownSetting(1.5, *request) for request in requests]
    path.write_bytes(struct.pack("<qQ", 0, 3) + b"\xff\0x" + whole)  # what is damaged hides nothing after it
    assert page.settings(index)[1:] == [KnownSetting(1.5, *request) for request in requests]
    page.free(index)
    assert page.settings(index) == []
