"""Whatever call of a change fails, and in whichever way: the change is carried through or taken back whole.

Every call that the manager makes during a change is counted in a run without faults; then, for
each of them, a run in which just that one fails.
"""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from midstride.backends.simulator import Simulator
from midstride.model.rules import violations
from midstride.plan.request import PlanRequest
from midstride.runtime.manager import Manager
from midstride.runtime.records.reports import Outcome
from midstride.runtime.workspace import Workspace
from tests.runtime.systems import (
    kept,
    last_said,
    managed,
    replace,
    rewritten,
    slow_filter,
    snapshot,
    stateful_talkers,
)

# Reads that only watch: a change may go on without them.
WATCHING = {"observe", "grid", "record", "records", "export_state", "await_match", "count_writes", "program"}
# What is tried again: a cut with another moment, a meeting in short turns.
TRIED_AGAIN = {"cut_out", "cut_in", "meet"}
BETWEEN_PEERS = {"ping", "taken", "offer_state", "fetch_state", "importing"}


class Failing(Simulator):
    """Fails the call number ``at`` once it is armed, in the way ``how`` (see ``Faults.fail_next``)."""

    def __init__(self, at: int | None = None, how: Any = "lost_request", times: int = 1) -> None:
        super().__init__()
        self.at, self.how, self.times = at, how, times
        self.calls: list[tuple[str, str]] = []
        self.armed = False
        self.control.before_request = self.before

    async def before(self, instance: str, op: str) -> None:
        if self.armed:
            if len(self.calls) == self.at:
                self.faults.fail_next(instance, op, self.how, self.times)
            self.calls.append((instance, op))


def change(simulator: Failing, name: str, request: PlanRequest, folder: Path) -> Outcome:
    async def body(manager: Manager, _: Simulator) -> Outcome:
        before = await snapshot(manager, simulator)
        simulator.armed = True
        outcome = await manager.change(request)
        simulator.armed = False
        after = await snapshot(manager, simulator)
        if outcome.outcome == "rolled_back":
            assert after == before
        else:
            assert outcome.outcome == "done", outcome.because
            assert after["configuration"] != before["configuration"]
        assert violations(manager.configuration) == []
        assert sorted(simulator.processes) == sorted(manager.configuration.instances)
        assert await differing(manager) == []
        return outcome

    folder.mkdir()
    return managed(name, folder, body, simulator, directory=programs(name, folder))


def programs(name: str, folder: Path) -> Path | None:
    return slow_filter(folder / "programs") if name == "filter" else None


async def differing(manager: Manager) -> list[str]:
    """Where a component's own state is not what the model says."""
    status = await manager.status()
    return [row.name for row in status.instances if not (row.reachable and row.as_modelled)]


CASES = [
    ("talker", replace("talker", "NewTalker")),
    pytest.param("talker", replace("talker", "NewTalker", "paper"), marks=pytest.mark.full),
    pytest.param("filter", replace("filter", "MedianFilter"), marks=pytest.mark.full),
    ("obstacle", replace("detector", "StereoDetector", "quiesce")),
    ("obstacle", PlanRequest(remove=("detector",))),
]


@pytest.mark.parametrize(("name", "request_"), CASES, ids=lambda value: getattr(value, "strategy", value))
@pytest.mark.parametrize(("how", "times"), [("lost_request", 1), pytest.param("lost_reply", 1, marks=pytest.mark.full)])
def test_one_lost_message_is_made_good(name: str, request_: PlanRequest, how: str, times: int, tmp_path: Path) -> None:
    whole = Failing()
    change(whole, name, request_, tmp_path / "whole")
    for at, (_, op) in enumerate(whole.calls):
        outcome = change(Failing(at, how, times), name, request_, tmp_path / str(at))
        # A cut is agreed for a moment, which a repetition may miss.
        assert outcome.outcome == "done" or op in {"cut_out", "cut_in", "taken", "fetch_state", "importing"}, op


@pytest.mark.parametrize(("name", "request_"), CASES, ids=lambda value: getattr(value, "strategy", value))
@pytest.mark.parametrize(
    ("how", "times"),
    [
        pytest.param("lost_request", 2, marks=pytest.mark.long),
        pytest.param("lost_reply", 2, marks=pytest.mark.long),
        ("refused", 1),
    ],
)
def test_a_change_in_which_any_one_call_fails_is_done_or_taken_back_whole(
    name: str, request_: PlanRequest, how: str, times: int, tmp_path: Path
) -> None:
    whole = Failing()
    assert change(whole, name, request_, tmp_path / "whole").outcome == "done"
    outcomes: dict[str, int] = {"done": 0, "rolled_back": 0}
    for at, (instance, op) in enumerate(whole.calls):
        outcome = change(Failing(at, how, times), name, request_, tmp_path / str(at))
        outcomes[outcome.outcome] += 1
        if op in BETWEEN_PEERS:
            continue  # repeated by the one that calls, or answered by the other's taking up again
        if outcome.outcome == "rolled_back":
            assert instance in str(outcome.because) and op in str(outcome.because)
        else:
            assert op in WATCHING | TRIED_AGAIN or (instance, op) in after_the_cut(whole.calls), (instance, op)
    assert outcomes["rolled_back"] > 0


def after_the_cut(calls: list[tuple[str, str]]) -> Iterator[tuple[str, str]]:
    """What is called once a hand-over has happened: it is not taken back for an old side that no longer answers."""
    cut = max((index for index, (_, op) in enumerate(calls) if op == "await_cut"), default=len(calls))
    yield from calls[cut + 1 :]


@pytest.mark.parametrize(("name", "request_"), CASES[:4], ids=lambda value: getattr(value, "strategy", value))
def test_a_component_that_dies_at_any_call_leaves_no_half_done_change(
    name: str, request_: PlanRequest, tmp_path: Path
) -> None:
    whole = Failing()
    change(whole, name, request_, tmp_path / "whole")
    for at, (instance, op) in enumerate(whole.calls):
        simulator = Dying(at)

        async def body(manager: Manager, _: Simulator, simulator: Dying = simulator) -> Outcome:
            simulator.armed = True
            outcome = await manager.change(request_)
            simulator.armed = False
            await simulator.clock.sleep(1)
            assert violations(manager.configuration) == []
            assert sorted(simulator.processes) == sorted(manager.configuration.instances)
            assert await differing(manager) == []
            restored = await manager.change(PlanRequest(to=manager.specification))
            assert restored.outcome == "done", restored.because
            roles = sorted(instance.role for instance in manager.configuration.instances.values())
            assert roles == sorted(manager.specification.nodes)
            return outcome

        folder = tmp_path / str(at)
        folder.mkdir()
        outcome = managed(name, folder, body, simulator, directory=programs(name, folder))
        assert outcome.outcome in ("done", "rolled_back", "failed"), (instance, op)
        if outcome.outcome != "done":
            assert outcome.because


class Dying(Failing):
    """Kills the component that the call number ``at`` is for, just before it."""

    async def before(self, instance: str, op: str) -> None:
        if self.armed:
            if len(self.calls) == self.at and instance in self.processes:
                self.faults.kill(instance)
            self.calls.append((instance, op))


class Cancelling(Failing):
    """Cancels ``change``, as at the manager's end, while call number ``at`` is under way."""

    task: asyncio.Task[Outcome] | None = None
    fails: int | None = None  # the number of a call that is refused before

    async def before(self, instance: str, op: str) -> None:
        if self.armed and len(self.calls) == self.fails:
            self.faults.fail_next(instance, op, "refused")
        if self.armed and len(self.calls) == self.at and self.task is not None:
            asyncio.get_running_loop().call_later(self.network.latency, self.task.cancel)
        await super().before(instance, op)


@pytest.mark.full
@pytest.mark.parametrize(("name", "request_"), CASES[:2], ids=lambda value: getattr(value, "strategy", value))
def test_a_change_that_is_broken_off_at_any_call_is_taken_back_whole(
    name: str, request_: PlanRequest, tmp_path: Path
) -> None:
    whole = Failing()
    change(whole, name, request_, tmp_path / "whole")
    for at, call in enumerate(whole.calls):
        simulator = Cancelling(at)

        async def body(
            manager: Manager, _: Simulator, simulator: Cancelling = simulator, call: tuple[str, str] = call
        ) -> None:
            before = await snapshot(manager, simulator)
            simulator.armed = True
            simulator.task = asyncio.ensure_future(manager.change(request_))
            await asyncio.wait({simulator.task})
            simulator.armed = False
            after = await snapshot(manager, simulator)
            if after["specification"] == before["specification"]:
                assert after == before, call
            else:  # all was done, and only the measuring was broken off
                assert call[1] in ("records", "observe", "record")
            assert await differing(manager) == [], call

        folder = tmp_path / str(at)
        folder.mkdir()
        managed(name, folder, body, simulator)


def test_a_roll_back_is_not_broken_off_and_its_reason_is_reported(tmp_path: Path) -> None:
    """By the manager's end, at whatever call: only the measurement is."""
    request = replace("detector", "StereoDetector", "quiesce")
    whole = Failing()
    change(whole, "obstacle", request, tmp_path / "whole")
    *_, last = (at for at, (_, op) in enumerate(whole.calls) if op == "attach")
    failing = Failing(last, "refused")
    reason = change(failing, "obstacle", request, tmp_path / "failing").because
    recreated = failing.calls.index(("detector", "program"), last)

    def cancelled(at: int) -> Outcome:
        simulator = Cancelling(at)
        simulator.fails = last

        async def body(manager: Manager, _: Simulator) -> Outcome:
            before = await snapshot(manager, simulator)
            simulator.armed = True
            simulator.task = asyncio.ensure_future(manager.change(request))
            outcome = await simulator.task
            simulator.armed = False
            assert await snapshot(manager, simulator) == before
            assert await differing(manager) == []
            return outcome

        folder = tmp_path / str(at)
        folder.mkdir()
        return managed("obstacle", folder, body, simulator)

    calls = range(recreated, len(failing.calls))
    assert len(calls) > 5
    for at in calls:
        outcome = cancelled(at)
        assert (outcome.outcome, outcome.because) == ("rolled_back", reason), failing.calls[at]


def test_a_recording_ends_with_the_change_however_that_ends(tmp_path: Path) -> None:
    simulator = Simulator()
    workspace = Workspace(tmp_path)

    async def body(manager: Manager, _: Simulator) -> None:
        task = asyncio.ensure_future(manager.change(replace("talker", "NewTalker")))
        while not any(event.kind == "measuring" for event in manager.log()):
            await asyncio.sleep(0.01)
        task.cancel()
        outcome = await task
        assert (outcome.outcome, outcome.swaps[0].missed) == ("done", None), "it is done, if not measured"
        await asyncio.sleep(10)
        assert await kept(workspace, simulator, "listener.in") == 64

    managed("talker", tmp_path, body, simulator)


def test_a_witness_of_the_inputs_ends_where_there_is_nobody_to_measure(tmp_path: Path) -> None:
    simulator = Simulator()
    workspace = Workspace(tmp_path)

    async def body(manager: Manager, _: Simulator) -> None:
        assert (await manager.change(PlanRequest(remove=("sink",)))).outcome == "done"
        assert (await manager.change(replace("filter", "MedianFilter"))).outcome == "done"
        await asyncio.sleep(1)
        assert await kept(workspace, simulator, "filter_2.in") == 64

    managed("filter", tmp_path, body, simulator)


def test_a_failure_that_nobody_foresaw_is_taken_back_as_well(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    class Odd(Failing):
        async def before(self, instance: str, op: str) -> None:
            if self.armed and op == "attach":
                self.armed = False
                raise KeyError("what is this?")

    simulator = Odd()

    async def body(manager: Manager, _: Simulator) -> Outcome:
        before = await snapshot(manager, simulator)
        simulator.armed = True
        outcome = await manager.change(replace("talker", "NewTalker"))
        assert await snapshot(manager, simulator) == before
        return outcome

    outcome = managed("talker", tmp_path, body, simulator)
    assert outcome.outcome == "rolled_back" and "internal error: KeyError: 'what is this?'" in str(outcome.because)
    assert "Traceback" in caplog.text


def test_a_component_that_comes_back_has_its_own_state_again(tmp_path: Path) -> None:
    """Under ``paper`` the old one is removed before the new one comes, which has taken up its state and then fails."""
    simulator = Simulator()

    async def body(manager: Manager, _: Simulator) -> tuple[Outcome, str]:
        simulator.faults.fail_next("talker_2", "attach", "refused")
        outcome = await manager.change(replace("talker", "NewTalker", "paper"))
        return outcome, await last_said(simulator)

    folder = tmp_path / "workspace"
    folder.mkdir()
    outcome, heard = managed("talker", folder, body, simulator, stateful_talkers(tmp_path))
    assert outcome.outcome == "rolled_back", outcome.because
    assert heard == "the old one's+"


@pytest.mark.parametrize("dies_at", ["attach", "await_write", "meet", "cut_out", "cut_in", "await_cut"])
def test_where_the_old_side_dies_in_its_hand_over_the_new_one_takes_over_at_once(dies_at: str, tmp_path: Path) -> None:
    """It is ready, and going back would leave the topic silent."""

    class Meeting(Simulator):
        died: float | None = None

        async def before(self, instance: str, op: str) -> None:
            if op == dies_at and "talker_2" in self.processes and self.died is None:
                self.died = self.clock.steady()
                self.faults.kill("talker")

    simulator = Meeting()
    simulator.control.before_request = simulator.before

    async def body(manager: Manager, _: Simulator) -> tuple[Outcome, str]:
        outcome = await manager.change(replace("talker", "NewTalker"))
        listening = (await manager.peek("listener")).functionalities["listen"].mode
        assert simulator.died is not None
        words = [event.words for event in manager.log()]
        assert "talker exited during the hand-over, and talker_2 took over at once" in words, outcome.because
        assert sorted(manager.configuration.instances) == ["listener", "talker_2"]
        assert await differing(manager) == []
        return outcome, listening

    outcome, listening = managed("talker", tmp_path, body, simulator)
    assert (outcome.outcome, outcome.unexpected_exits, listening) == ("done", ["talker"], "normal")
    [swap] = outcome.swaps
    assert swap.gap is not None and swap.gap < 2.0  # with one turn of `meet`, and the moment agreed with the dead side


def test_a_new_side_that_has_degraded_by_itself_is_the_reason(tmp_path: Path) -> None:
    """Not what it then refused: its revision is another one by that, which explains nothing to anybody."""

    def broken(file: str, text: str) -> str:
        raising = "    raise ValueError('unplugged')\n    out.write("
        return text.replace("    out.write(", raising) if file == "new_talker.py" else text

    async def body(manager: Manager, _: Simulator) -> Outcome:
        return await manager.change(replace("talker", "NewTalker"))

    outcome = managed("talker", tmp_path, body, directory=rewritten("talker", tmp_path / "programs", broken))
    assert outcome.outcome == "rolled_back"
    assert outcome.seconds < 4  # of the simulator's own time: its first write is not waited for any more
    told = "talker_2.talk entered mode degraded unexpectedly: mode normal raised: ValueError: unplugged"
    assert told in str(outcome.because)


@pytest.mark.parametrize("command", ["attach", "await_write", "meet", "prepare_state", "cut_in", "fetch_state"])
@pytest.mark.parametrize("call", [1, 2])
def test_a_message_of_the_wrong_type_is_the_reason_whenever_it_is_written(
    call: int, command: str, tmp_path: Path
) -> None:
    """In the first call, or in the one before any command of the hand-over arrives."""

    class Waiting(Simulator):
        async def before(self, instance: str, op: str) -> None:
            if op == command and "talker_2" in self.processes:
                await self.clock.sleep(0.5)  # five of its periods

    simulator = Waiting()
    simulator.control.before_request = simulator.before
    specification = stateful_talkers(tmp_path)
    program = tmp_path / "NewTalker.py"
    write = f"""
def write():
    write.calls += 1
    out.write(String() if write.calls < {call} else comp)
write.calls = 0
talk.set_normal_mode(write,"""
    text = program.read_text()
    program.write_text(text.replace("talk.set_normal_mode(lambda: out.write(String(data=state)),", write))
    assert program.read_text() != text

    async def body(manager: Manager, _: Simulator) -> Outcome:
        return await manager.change(replace("talker", "NewTalker"))

    folder = tmp_path / "workspace"
    folder.mkdir()
    outcome = managed("talker", folder, body, simulator, specification)
    assert outcome.outcome == "rolled_back" and outcome.because is not None
    step, _, reason = outcome.because.partition(": ")
    assert step == "hand over /chatter from talker.out to talker_2.out"
    assert reason.startswith(
        "talker_2.talk entered mode degraded unexpectedly: mode normal raised: midstride.errors.NodeError: "
        "output out takes std_msgs/msg/String, not Component;"
    )
