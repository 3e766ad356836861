"""Topics that are no ports: of two nodes of a role, at most one writes there, whichever dies. Plain processes."""

from __future__ import annotations

import os
import resource
import signal
import subprocess
from collections.abc import Iterator
from functools import partial
from itertools import pairwise
from pathlib import Path

import pytest

from midstride.foreign.gates import PATIENCE, Gates
from midstride.foreign.page_layout import INPUT, OPEN, OUTPUT, ROOM, PagePort
from midstride.model.component import ComponentSpec
from midstride.node.handover.baton import BatonStep
from tests.foreign.lab import MS, Lab, until, variables

COMPONENT = ComponentSpec.of("Talker")


class Role:
    """Nodes of one role that write on `/chat`, of which no port is stated; each has a port of another topic."""

    def __init__(self, lab: Lab) -> None:
        self.lab, self.page = lab, lab.page

    def starts(self, of: int | None = None, *, messages: int = 10**12, topic: str = "/chat", waits: bool = True) -> int:
        """Start a node that writes each ms, as the replacement ``of`` another; its index."""
        page = self.page
        index = page.allocate(f"node_{len(self.lab.processes)}")
        page.set_ports(index, [("/other", OUTPUT)])
        page.have_requests(index, of)
        page.have_unstated(index, PATIENCE, of)
        self.lab.start(index, topic, str(MS), str(messages))
        if waits:
            until(lambda: bool(page.unstated(index)) and bool(self.port(index).tried), "it has not written")
        return index

    def port(self, index: int) -> PagePort:
        return self.page.unstated(index)["/chat"]

    def gates(self, index: int) -> Gates:
        return Gates(self.page, index, COMPONENT)

    def writes(self, index: int, more: int = 10) -> None:
        before = int(self.port(index).passed)
        until(lambda: self.port(index).passed >= before + more, f"node {index} does not write")

    def moves(self, index: int) -> None:
        until(self.gates(index).take_unstated, f"node {index} cannot take over")


@pytest.fixture
def role(lab: Lab) -> Iterator[Role]:
    yield Role(lab)
    assert lab.overlaps() == 0


def test_one_writer_at_each_moment(role: Role) -> None:
    old = role.starts()
    assert role.gates(old).writes_unstated, "the first of its role writes at once"
    role.writes(old)
    new = role.starts(old)
    swaps = 0
    while swaps < 10:
        held_back = int(role.port(new).gated)
        until(partial(lambda new, before: role.port(new).gated > before, new, held_back), "it does not write")
        role.moves(new)
        role.writes(new)
        old, new, swaps = new, old, swaps + 1
    role.page.free(new)  # the other one does not go on when this one is ended
    role.lab.close()
    records = role.lab.records()
    assert sum(writer != before for (before, *_), (writer, *_) in pairwise(records)) == swaps
    for index in (old, new):
        numbers = [number for writer, number, _ in records if writer == index + 1]
        assert numbers == sorted(set(numbers)), "one was published twice, or late"


def test_the_old_one_goes_on_if_the_new_one_dies(role: Role) -> None:
    old = role.starts()
    new = role.starts(old)
    role.moves(new)
    role.writes(new)
    role.lab.kill(new)
    role.writes(old)
    role.page.free(new)
    assert role.gates(old).writes_unstated


def test_the_new_one_takes_over_from_one_that_has_died(role: Role) -> None:
    old = role.starts()
    new = role.starts(old)
    role.lab.kill(old)
    assert not role.gates(new).writes_unstated, "the manager decides which goes on"
    role.moves(new)
    role.writes(new)


def test_what_an_ended_node_had_is_given_to_the_one_that_lives(role: Role) -> None:
    """Also where no step was taken before, and the part of the ended one in the page is given to another."""
    old = role.starts()
    new = role.starts(old)
    role.lab.kill(old)
    role.page.free(old)
    role.writes(new)
    assert role.gates(new).writes_unstated


def test_one_that_ended_as_a_successor_is_forgotten(role: Role) -> None:
    """What it was offered is no longer left to it: the old one misses nothing."""
    old = role.starts()
    new = role.starts(old)
    os.kill(role.lab.processes[old].pid, signal.SIGSTOP)
    role.page.step(role.gates(old).unstated, BatonStep.NAME_SUCCESSOR, old, new, at_once=True)
    role.lab.kill(new)
    role.page.free(new)
    os.kill(role.lab.processes[old].pid, signal.SIGCONT)
    role.writes(old)
    assert role.page.word(role.gates(old).unstated).successor == 0


def test_a_node_that_is_stopped_does_not_write_beside_its_successor(role: Role) -> None:
    old = role.starts()
    new = role.starts(old)
    os.kill(role.lab.processes[old].pid, signal.SIGSTOP)
    role.gates(new).take_unstated()  # not at once where it was stopped inside a call
    os.kill(role.lab.processes[old].pid, signal.SIGCONT)
    role.moves(new)
    role.writes(new)
    passed = int(role.port(old).passed)
    until(lambda: role.port(old).gated > 10, "the old one does not write")
    assert role.port(old).passed == passed


@pytest.mark.parametrize(("depth", "published"), [(0, [4]), (3, [2, 3, 4]), (9, [1, 2, 3, 4])])
def test_what_is_latched_is_published_again_at_the_change(
    role: Role, monkeypatch: pytest.MonkeyPatch, depth: int, published: list[int]
) -> None:
    if depth:
        monkeypatch.setenv("FAKE_LATCHED", str(depth))
    old = role.starts(messages=4)
    until(lambda: role.lab.count() == 4, "the first one does not publish all")
    new = role.starts(old, messages=4)
    until(lambda: role.port(new).gated == 4, "it has not written all")
    role.moves(new)
    until(lambda: not role.port(new).kept, "they are not published")
    assert [number for writer, number, _ in role.lab.records() if writer == new + 1] == published


@pytest.mark.parametrize(
    "topic",
    ["/rosout", "/parameter_events", "/diagnostics", "/bond", "/a/bond", "/a/transition_event", "/dock/_action/status"],
)
def test_what_a_process_says_of_itself_is_not_handed_over(lab: Lab, topic: str) -> None:
    role = Role(lab)
    old = role.starts(topic=topic, waits=False)
    new = role.starts(old, topic=topic, waits=False)
    until(lambda: {old + 1, new + 1} <= {writer for writer, *_ in lab.records()}, "one of them is held back")
    assert not lab.page.unstated(old) and not lab.page.unstated(new)


def test_where_the_page_is_full_it_is_said_and_both_write(lab: Lab, tmp_path: Path) -> None:
    index, page = lab.page.allocate("talker"), lab.page
    lab.page.set_ports(index, [(f"/topic_{number}", INPUT) for number in range(ROOM)])
    page.have_unstated(index, PATIENCE)
    given = variables(page.path, lab.programs, lab.library, lab.log, index)
    full = page.path.stat().st_size

    def limit() -> None:
        resource.setrlimit(resource.RLIMIT_FSIZE, (full, full))
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)

    with open(tmp_path / "said", "wb") as said:
        command = [str(lab.programs / "node"), str(index + 1), "/chat", str(MS), "1000000"]
        lab.processes[index] = subprocess.Popen(command, env={**os.environ, **given}, stderr=said, preexec_fn=limit)
        until(lambda: lab.count() > 10, "it does not write")
    assert "/chat has no gate, since the page of the gates has no room for it" in (tmp_path / "said").read_text()
    assert not page.unstated(index)


def test_a_node_whose_ports_are_not_stated_yet_has_gates_for_all_its_topics(lab: Lab) -> None:
    index, after = lab.page.allocate("talker"), lab.page.allocate("talker_2")
    Gates(lab.page, index, COMPONENT).prepare({})
    lab.run(index, MS, 10**12)
    Gates(lab.page, after, COMPONENT).prepare({}, index)
    lab.run(after, MS, 10**12)
    assert [port.gate for port in (*lab.page.ports(index), *lab.page.ports(after))] == [OPEN, OPEN]
    until(lambda: lab.port(after).gated > 10, "it is not held back")
    assert lab.port(after).passed == 0
    until(Gates(lab.page, after, COMPONENT).take_unstated, "it cannot take over")
    until(lambda: lab.port(after).passed > 10, "it does not write")
    assert lab.overlaps() == 0
