"""What is waited for, and what the report says, when a node ends whose goals go on: by the page, without processes."""

from __future__ import annotations

import asyncio
import time
from pathlib import Path

import pytest

from midstride.codec.component_form import NamedComponentForm
from midstride.foreign import ending_goals, gated_outputs
from midstride.foreign.foreign_state import StatePeers
from midstride.foreign.gated_outputs import GatedOutputs
from midstride.foreign.gates import Gates
from midstride.foreign.node import ForeignNode
from midstride.foreign.page import Page
from midstride.foreign.page_layout import SERVER, GoalState
from midstride.foreign.record import ForeignRecord
from midstride.foreign.reported_states import ReportedStates
from midstride.model.component import ComponentSpec, StopTimes

ACTION = "/count"
# Of the word of a role, as in `requests.h`.
BEGUN = 1 << 24
PATIENCE = 20.0


class Ending:
    """The node `old`, whose successor answers, with goals in ``states``."""

    def __init__(self, folder: Path, library: Path, *states: GoalState, since: float | None = None) -> None:
        component = ComponentSpec.of(
            "Server", functionalities=(), run="server", gate="preload", stop=StopTimes(patience=PATIENCE)
        )
        page = self.page = Page(folder / "page", library)
        index = self.index = page.allocate("old")
        page.have_requests(index)
        new = page.allocate("new")
        page.have_requests(new, index)
        page.set_ports(index, [(f"{ACTION}/_action/send_goal", SERVER)])
        port = next(number for number, port in enumerate(page.every_port(), 1) if port.node == index + 1)
        requests = page._requests[page.layout.nodes[index].requests - 1]
        requests.word = BEGUN | (index + 1) << 12 | new + 1  # no process has joined the page, so it is not given to one
        self.goals = requests.goals
        for number, state in enumerate(states):
            self.goals[number].word = state << 12 | index + 1
            self.goals[number].port = port
            self.goals[number].id[0] = number
        self.record = ForeignRecord(
            instance="old",
            node="/old",
            token="",
            uuid="",
            pid=1,
            started=0,
            declaration=NamedComponentForm.of(component),
            index=index,
            topics={},
            modes={},
            draining_since=since,
        )
        self.node = ForeignNode(self.record, folder, Gates(page, index, component), ReportedStates())
        assert self.node.gates is not None
        self.outputs = GatedOutputs(self.node, self.node.gates, StatePeers())

    def left(self) -> str | None:
        """Have it finish; what it has left unfinished, in words."""
        asyncio.run(self.outputs.finish())
        return self.node.unfinished


@pytest.fixture(autouse=True)
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing here needs time to be cancelled, or to be fetched."""
    monkeypatch.setattr(ending_goals, "CANCELLING", 0.02)
    monkeypatch.setattr(gated_outputs, "LINGER", 0.0)


def test_a_node_without_goals_leaves_nothing(tmp_path: Path, gate_library: Path) -> None:
    assert Ending(tmp_path, gate_library, GoalState.FETCHED).left() is None


def test_what_is_left_of_the_patience_is_waited_for_by_the_next_manager(tmp_path: Path, gate_library: Path) -> None:
    """The patience was over before this manager came: goals are cancelled at once."""
    begun = time.monotonic()
    ending = Ending(tmp_path, gate_library, GoalState.ACCEPTED, since=begun - 5 * PATIENCE)
    left = ending.left()
    seconds = round(time.monotonic() - begun + 5 * PATIENCE)
    assert left is not None and ending.page.layout.nodes[ending.index].cancels
    words = "1 goal of ROS action /count had not ended after {} s (`patience`), and cancelling was asked for"
    assert left.split("; ")[0] in {words.format(each) for each in range(int(5 * PATIENCE), seconds + 1)}
    assert "1 goal of ROS action /count had not ended 0.02 s later" in left
    assert ending.node.record.draining_since == begun - 5 * PATIENCE


def test_since_when_goals_are_waited_for_is_kept_for_the_next_manager(tmp_path: Path, gate_library: Path) -> None:
    before = time.monotonic()
    Ending(tmp_path, gate_library).left()
    record = ForeignRecord.read(tmp_path, "old")
    assert record is not None and record.draining_since is not None
    assert before <= record.draining_since <= time.monotonic()


@pytest.mark.parametrize(
    ("number", "words"),
    [
        (1, "the result of 1 goal of ROS action /count that no client had fetched is lost"),
        (2, "the results of 2 goals of ROS action /count that no client had fetched are lost"),
    ],
)
def test_a_result_that_the_node_does_not_give_is_lost(
    tmp_path: Path, gate_library: Path, number: int, words: str
) -> None:
    assert Ending(tmp_path, gate_library, *[GoalState.ENDED] * number).left() == words


def test_goals_without_a_place_are_waited_for_and_said(tmp_path: Path, gate_library: Path) -> None:
    ending = Ending(tmp_path, gate_library, since=time.monotonic() - PATIENCE)
    node = ending.page.layout.nodes[ending.index]
    node.beyond, node.apart = 2, 3
    left = ending.left()
    assert left is not None and node.cancels
    unended, still, lost = left.split("; ")
    assert unended.startswith("2 goals beyond the 256 that are listed had not ended after ")
    assert still == "2 goals beyond the 256 that are listed had not ended 0.02 s later"
    assert lost == "the result of 1 goal beyond the 256 that are listed that no client had fetched is lost"


def test_the_place_of_a_kept_result_is_free_where_goals_wait_for_one(tmp_path: Path, gate_library: Path) -> None:
    ending = Ending(tmp_path, gate_library, GoalState.ENDED, GoalState.ENDED)
    gates, node = Gates(ending.page, ending.index, ComponentSpec("Server")), ending.page.layout.nodes[ending.index]
    for waiting, (goal, *_) in enumerate((gates.unfetched(), gates.unfetched()[1:])):
        number = gates.ask_for_result(goal)
        node.apart = waiting
        assert not gates.keep_result(goal, number)
        ending.page.path.with_name(f"{ending.page.path.name}.{ending.index}.{number}.answer").write_bytes(b"result")
        assert gates.keep_result(goal, number)
    assert [goal.id[0] for goal in gates.unfetched()] == [0]
