"""Old components that hang, are stopped, or are too slow for a hand-over are replaced, and the report says so."""

from __future__ import annotations

import asyncio
import itertools
import re
import time
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest

from midstride.backends.simulator import Simulator
from midstride.backends.simulator.network import SimulatedWriter
from midstride.codec.specification_form import decode_specification
from midstride.model.component import PortRef
from midstride.model.contract import DEFAULT_QOS
from midstride.model.rules import violations
from midstride.model.specification import Specification
from midstride.plan.request import PlanRequest
from midstride.runtime.backend_protocol import Handle, Launch
from midstride.runtime.handover.fences import DEFAULT_WAIT, PATIENCE, Fences
from midstride.runtime.instance_life import STOPPED, FenceState
from midstride.runtime.manager import Manager
from midstride.runtime.process.launcher import STOP_GRACE
from midstride.runtime.records.reports import Event, Outcome
from midstride.runtime.workspace import Workspace
from midstride.wire.commands import FenceCommand
from midstride.wire.replies import FencedOutputs
from tests.runtime.scripted import Bench, bench, talking
from tests.runtime.systems import last_said, managed, replace, stateful_talkers

OUT, OTHER = PortRef("talker", "out"), PortRef("talker", "other")
# A talker at 10 Hz that does not return from its call number `at`, for `seconds`, and then says so.
_TALKER = """
import sys
import time
from midstride import Component
from std_msgs.msg import String

own, at, seconds, every = sys.argv[1], int(sys.argv[2]), float(sys.argv[3]), sys.argv[4:]
comp = Component("talker")
out = comp.create_output("out", String)
talk = comp.create_functionality("talk", outputs=[out])
calls = 0

def say():
    global calls
    calls += 1
    late = calls == at or (every and calls > at)
    if late:
        time.sleep(seconds)
    out.write(String(data=own + (" late" if late else "")))

talk.set_normal_mode(say, rate=10, outputs=[out])
talk.set_degraded_mode(lambda: None)
comp.start()
"""
# A talker whose mode never ends: a loop that awaits.
_LOOPING = """
import sys
from midstride import Component
from std_msgs.msg import String

comp = Component("talker")
out = comp.create_output("out", String)
talk = comp.create_functionality("talk", outputs=[out])

async def say():
    while True:
        out.write(String(data=sys.argv[1]))
        await comp.clock.sleep(0.1)

talk.set_normal_mode(say, outputs=[out], guarantees={out: 10})
talk.set_degraded_mode(lambda: None)
comp.start()
"""
_LISTENER = """
import time
from midstride import Component
from std_msgs.msg import String

comp = Component("listener")
heard = comp.create_input("in", String, rate=10)
listen = comp.create_functionality("listen", inputs=[heard])
listen.set_normal_mode(lambda message: time.sleep(1000) if message.data == "hang" else None, inputs=[heard])
listen.set_degraded_mode(lambda: None)
comp.start()
"""
_WORDS = {"type": "std_msgs/msg/String", "rate": 10}


def _talker(*arguments: object) -> dict[str, Any]:
    return {
        "run": " ".join(["python3 talker.py", *map(str, arguments)]),
        "outputs": ["out"],
        "functionalities": {
            "talk": {"produces": ["out"], "modes": {"normal": {"guarantees": {"out": _WORDS}}, "degraded": {}}}
        },
    }


def specification(**talkers: dict[str, Any]) -> Specification:
    """``talker`` is an ``Old``, and may become a ``New``."""
    listener = {
        "run": "python3 listener.py",
        "inputs": {"in": _WORDS},
        "functionalities": {"listen": {"uses": ["in"], "modes": {"normal": {"assumes": ["in"]}, "degraded": {}}}},
    }
    return decode_specification(
        {
            "system": "hanging",
            "topics": {"/chatter": _WORDS},
            "components": {"New": _talker("new", 0, 0), "Listener": listener, **talkers},
            "nodes": {
                "talker": {"component": "Old", "attachments": {"out": ["/chatter"]}},
                "listener": {"component": "Listener", "attachments": {"in": ["/chatter"]}},
            },
        }
    )


Body = Callable[[Manager, Simulator, "Heard"], Awaitable[Any]]


class Heard:
    """What is heard on the talkers' topic, and when (steady s)."""

    def __init__(self, simulator: Simulator) -> None:
        party = simulator.processes["listener"]
        self.rows: list[tuple[float, str]] = []

        def take() -> None:
            message, _ = reader.queue.popleft()
            self.rows.append((simulator.clock.steady(), message.data))

        reader = simulator.network.create_reader(party, "/chatter", "std_msgs/msg/String", DEFAULT_QOS, take)

    def words(self) -> list[str]:
        return [words for _, words in self.rows]

    def longest_gap(self) -> float:
        times = [at for at, _ in self.rows]
        return max(later - earlier for earlier, later in itertools.pairwise(times))


def hanging(path: Path, body: Body, simulator: Simulator | None = None, **talkers: dict[str, Any]) -> None:
    (path / "talker.py").write_text(_TALKER)
    (path / "listener.py").write_text(_LISTENER)

    async def main(manager: Manager, simulator: Simulator) -> None:
        heard = Heard(simulator)
        await asyncio.sleep(2)
        await body(manager, simulator, heard)
        assert "old late" not in heard.words(), "one that was fenced is never heard"

    talkers = {"Old": _talker("old", 20, 1000)} | talkers
    managed("talker", path, main, simulator, specification(**talkers), directory=path)


async def replaced(manager: Manager, **options: Any) -> Outcome:
    outcome = await manager.change(replace("talker", "New"), **options)
    assert violations(manager.configuration) == []
    return outcome


@pytest.mark.parametrize("strategy", ["minimal", "paper", pytest.param("quiesce", marks=pytest.mark.full)])
def test_a_publisher_that_hangs_is_replaced(strategy: str, tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: Simulator, heard: Heard) -> None:
        await asyncio.sleep(10)
        assert "new" not in heard.words()
        begun = simulator.clock.steady()
        outcome = await manager.change(replace("talker", "New", strategy))
        assert outcome.outcome == "done", outcome.because
        [fenced] = outcome.fenced
        assert (fenced.instance, fenced.how) == ("talker", "gate")
        assert "talker hangs: user code did not return" in fenced.words and "state" not in fenced.words
        assert outcome.own_state == {}
        assert [event.words for event in manager.log() if event.kind == "fenced"] == [fenced.words]
        assert outcome.unexpected_exits == [] and outcome.silences == [] and outcome.remaining_degradations == []
        assert simulator.clock.steady() - begun < DEFAULT_WAIT + 12
        assert sorted(simulator.processes) == sorted(manager.configuration.instances) == ["listener", "talker_2"]
        assert (await manager.status()).valid
        await asyncio.sleep(1)
        assert heard.words()[-1] == "new"

    hanging(tmp_path, body)


def test_one_whose_mode_never_ends_and_is_not_left_hands_over(tmp_path: Path) -> None:
    (tmp_path / "looping.py").write_text(_LOOPING)

    async def body(manager: Manager, simulator: Simulator, heard: Heard) -> None:
        await asyncio.sleep(10)
        [said] = [each for each in (await manager.plan(replace("talker", "New"))).remarks if "hangs" in each]
        assert said.endswith("where it has to wait for that, it is fenced after 5 s (`--wait`), and ended")
        outcome = await replaced(manager)
        assert (outcome.outcome, outcome.because, outcome.fenced) == ("done", None, [])
        assert list(dict.fromkeys(heard.words())) == ["loop", "new"]

    hanging(tmp_path, body, Old=_talker() | {"run": "python3 looping.py loop"})


def test_the_plan_says_how_much_longer_one_that_hangs_takes(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: Simulator, heard: Heard) -> None:
        request = replace("talker", "New")
        assert not [each for each in (await manager.plan(request)).remarks if "hangs" in each]
        await asyncio.sleep(10)
        plan = await manager.plan(request)
        [said] = [each for each in plan.remarks if "hangs" in each]
        longer = DEFAULT_WAIT + STOP_GRACE
        assert re.fullmatch(
            rf"talker hangs: a call of its code has not returned for \d+ s; unless it returns, the change takes up to "
            rf"{longer:g} s longer: where it has to wait for that, it is fenced after {DEFAULT_WAIT:g} s \(`--wait`\), "
            rf"and ended",
            said,
        )
        begun = simulator.clock.steady()
        outcome = await manager.change(request)
        assert outcome.outcome == "done", outcome.because
        assert outcome.seconds > plan.seconds + 1 and simulator.clock.steady() - begun < plan.seconds + longer + 3

    hanging(tmp_path, body)


def test_the_state_of_one_that_hangs_is_lost_and_the_outcome_says_so(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: Simulator) -> None:
        simulator.faults.hang("talker", 1000.0)
        await asyncio.sleep(1)
        outcome = await manager.change(replace("talker", "NewTalker"))
        assert outcome.outcome == "done", outcome.because
        assert outcome.fenced[0].words.endswith("and its state could not be exported")
        assert "talker_2 continues with its own state (talker hangs)" in outcome.own_state["talker_2"]
        assert await last_said(simulator) == "the new one's"

    managed("talker", tmp_path, body, specification=stateful_talkers(tmp_path))


def test_the_report_is_that_of_a_bare_listener(tmp_path: Path) -> None:
    """The silence began long before the change."""

    async def body(manager: Manager, simulator: Simulator, heard: Heard) -> None:
        await asyncio.sleep(10)
        outcome = await replaced(manager)
        [swap] = outcome.swaps
        assert swap.gap == pytest.approx(heard.longest_gap(), abs=0.01)
        assert swap.gap is not None and swap.gap > 10 + DEFAULT_WAIT
        assert swap.missed == pytest.approx(swap.gap * 10 - 1, abs=1)
        assert (swap.lost, swap.duplicates) == (0, 0)

    hanging(tmp_path, body)


@pytest.mark.parametrize("wait", [0.0, 2.0, 20.0])
def test_a_change_tries_without_a_fence_for_as_long_as_requested(wait: float, tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: Simulator, heard: Heard) -> None:
        begun = simulator.clock.steady()
        outcome = await replaced(manager, wait=wait)
        assert len(outcome.fenced) == 1
        took = next(at for at, words in heard.rows if words == "new") - begun
        assert wait < took < wait + 4

    hanging(tmp_path, body)


def test_one_that_returns_in_time_hands_over_at_a_cut(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: Simulator, heard: Heard) -> None:
        outcome = await replaced(manager)
        assert (outcome.outcome, outcome.fenced) == ("done", [])
        assert heard.words().count("late") == 0 and "returned late" in heard.words()

    hanging(tmp_path, body, Old=_talker("returned", 20, 4.0))


def test_one_whose_every_call_takes_two_seconds_hands_over_at_a_cut(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: Simulator, heard: Heard) -> None:
        outcome = await replaced(manager, wait=10.0)
        assert (outcome.outcome, outcome.fenced) == ("done", [])

    hanging(tmp_path, body, Old=_talker("slow", 10, 2.0, "always"))


def test_one_that_is_slower_than_all_time_outs_is_fenced(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: Simulator, heard: Heard) -> None:
        outcome = await replaced(manager, wait=2.0)
        assert outcome.outcome == "done" and [each.how for each in outcome.fenced] == ["gate"]

    hanging(tmp_path, body, Old=_talker("old", 20, 7.0, "always"))


@pytest.mark.parametrize("strategy", ["minimal", "paper"])
def test_a_stopped_publisher_is_killed_and_never_continues(strategy: str, tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: Simulator, heard: Heard) -> None:
        simulator.faults.freeze("talker", 60.0)
        begun = simulator.clock.steady()
        outcome = await manager.change(replace("talker", "New", strategy), wait=1.0)
        assert outcome.outcome == "done", outcome.because
        assert [(each.instance, each.how) for each in outcome.fenced] == [("talker", "killed")]
        assert "does not answer" in outcome.fenced[0].words
        assert outcome.unexpected_exits == [] and simulator.clock.steady() - begun < DEFAULT_WAIT + STOPPED + 8
        [swap] = outcome.swaps
        assert swap.gap == pytest.approx(heard.longest_gap(), abs=0.01)
        await asyncio.sleep(60)
        first_new = heard.words().index("new")
        assert set(heard.words()[first_new:]) == {"new"}
        assert (await manager.status()).valid and (await manager.status()).crashed == []

    hanging(tmp_path, body, Old=_talker("old", 0, 0))


def test_one_that_hangs_while_it_publishes_is_killed(tmp_path: Path) -> None:
    """The middleware blocks, say: that message has passed the gate, and would be heard after the fence."""

    async def body(manager: Manager, simulator: Simulator, heard: Heard) -> None:
        [old], publish = simulator.network.topic("/chatter").writers, simulator.network.publish

        def blocking(writer: SimulatedWriter, message: Any) -> None:
            if writer is old:
                time.sleep(20.0)
            publish(writer, message)

        simulator.network.publish = blocking  # type: ignore[method-assign]
        await asyncio.sleep(1)
        outcome = await replaced(manager, wait=1.0)
        assert [(each.instance, each.how) for each in outcome.fenced] == [("talker", "killed")]
        await asyncio.sleep(30)
        assert set(heard.words()[heard.words().index("new") :]) == {"new"}

    hanging(tmp_path, body, Old=_talker("old", 0, 0))


class Acting(Simulator):
    """Does something just before the first request ``op`` for ``instance`` in a change."""

    def __init__(self, instance: str, op: str, act: Callable[[Acting], object]) -> None:
        super().__init__()
        self.control.before_request = self.before
        self.instance, self.op, self.act, self.armed = instance, op, act, False

    async def before(self, instance: str, op: str) -> None:
        if self.armed and (instance, op) == (self.instance, self.op):
            self.armed = False
            self.act(self)


@pytest.mark.parametrize(("name", "op"), [("listener", "modes"), ("talker", "detach")])
@pytest.mark.parametrize("wait", [0.0, 1.0, 10.0])
def test_all_that_is_tried_in_a_step_without_a_fence_takes_as_long_as_asked_for(
    wait: float, name: str, op: str, tmp_path: Path
) -> None:
    """Not each command on its own, nor their undoing, which would wait for the same call."""
    hung: list[float] = []

    def hang(simulator: Acting) -> None:
        hung.append(simulator.clock.steady())
        simulator.faults.hang(name, 1000)

    simulator = Acting(name, op, hang)

    async def body(manager: Manager, _: Simulator, heard: Heard) -> None:
        fenced: list[float] = []

        def on_event(event: Event) -> None:
            if event.kind == "fenced":
                fenced.append(simulator.clock.steady())

        manager.events.listeners.append(on_event)
        simulator.armed = True
        outcome = await manager.change(PlanRequest(restart=(name,), strategy="paper"), wait=wait)
        assert outcome.outcome == "done", outcome.because
        assert [(each.instance, each.how) for each in outcome.fenced] == [(name, "gate")]
        assert wait <= fenced[0] - hung[0] < wait + 2 * PATIENCE + 0.1

    hanging(tmp_path, body, simulator, Old=_talker("old", 0, 0))


def test_one_that_returns_in_time_degrades_in_order(tmp_path: Path) -> None:
    """Although that takes longer than a mode change of others may."""
    simulator = Acting("listener", "modes", lambda s: s.faults.hang("listener", 7.0))

    async def body(manager: Manager, _: Simulator, heard: Heard) -> None:
        simulator.armed = True
        outcome = await manager.change(PlanRequest(restart=("listener",), strategy="paper"), wait=10.0)
        assert (outcome.outcome, outcome.fenced) == ("done", [])

    hanging(tmp_path, body, simulator, Old=_talker("old", 0, 0))


def test_one_that_is_stopped_before_it_degrades_is_killed_once_it_counts_as_stopped(tmp_path: Path) -> None:
    stopped: list[float] = []

    def stop(simulator: Acting) -> None:
        stopped.append(simulator.clock.steady())
        simulator.faults.freeze("listener", 1000)

    simulator = Acting("listener", "modes", stop)

    async def body(manager: Manager, _: Simulator, heard: Heard) -> None:
        simulator.armed = True
        outcome = await manager.change(PlanRequest(restart=("listener",), strategy="paper"), wait=1.0)
        assert outcome.outcome == "done", outcome.because
        assert [(each.instance, each.how) for each in outcome.fenced] == [("listener", "killed")]
        assert simulator.clock.steady() - stopped[0] < STOPPED + 5

    hanging(tmp_path, body, simulator, Old=_talker("old", 0, 0))


@pytest.mark.parametrize("op", ["observe", "grid", "attach", "meet", "cut_out", "cut_in", "await_cut", "detach"])
@pytest.mark.parametrize("seconds", [pytest.param(8.0, marks=pytest.mark.full), 1000.0])
def test_a_publisher_that_is_stopped_at_any_point_is_handed_over_or_fenced(
    op: str, seconds: float, tmp_path: Path
) -> None:
    side = "talker_2" if op in ("attach", "meet", "cut_in") else "talker"
    simulator = Acting(side, op, lambda s: s.faults.freeze("talker", seconds))

    async def body(manager: Manager, _: Simulator, heard: Heard) -> None:
        simulator.armed = True
        begun = simulator.clock.steady()
        outcome = await replaced(manager)
        assert not simulator.armed
        assert outcome.outcome == "done", outcome.because
        assert simulator.clock.steady() - begun < DEFAULT_WAIT + 3 * STOPPED
        await asyncio.sleep(15)
        after = heard.words()[heard.words().index("new") :]
        # One that continued in time may still write, once, what belongs before the cut.
        assert after.count("old") <= (1 if seconds < 1000 else 0)
        assert outcome.fenced == [] or [each.how for each in outcome.fenced] == ["killed"]
        assert sorted(simulator.processes) == ["listener", "talker_2"]
        assert (await manager.status()).valid

    hanging(tmp_path, body, simulator, Old=_talker("old", 0, 0))


@pytest.mark.parametrize("op", ["attach", "await_write", "meet", "cut_in", "await_cut", "gate"])
def test_where_the_new_side_fails_too_the_old_one_publishes_again_when_it_returns(op: str, tmp_path: Path) -> None:
    simulator = Acting("talker_2", op, lambda s: s.faults.kill("talker_2"))

    async def body(manager: Manager, _: Simulator, heard: Heard) -> None:
        simulator.armed = True
        outcome = await replaced(manager)
        if simulator.armed:  # a hung old side gets no cut
            assert op in ("cut_in", "await_cut") and outcome.outcome == "done"
            return
        assert outcome.outcome == "rolled_back", outcome.because
        assert outcome.fenced == [] and "talker_2" in str(outcome.because)
        assert sorted(manager.configuration.instances) == ["listener", "talker"]
        await asyncio.sleep(30)
        assert "later late" in heard.words() and "new" not in heard.words()
        assert (await manager.status()).valid

    hanging(tmp_path, body, simulator, Old=_talker("later", 20, 25.0))


def test_where_a_killed_old_side_and_the_new_one_are_gone_the_outcome_says_so(tmp_path: Path) -> None:
    simulator = Acting("talker_2", "gate", lambda s: s.faults.kill("talker_2"))

    async def body(manager: Manager, _: Simulator, heard: Heard) -> None:
        simulator.faults.freeze("talker", 1000.0)
        simulator.armed = True
        outcome = await replaced(manager)
        assert outcome.outcome == "failed"
        assert "talker was fenced" in str(outcome.because)
        assert list(manager.configuration.instances) == ["listener"]
        assert [each.functionality for each in outcome.remaining_degradations] == ["listener.listen", "talker.talk"]
        restored = await manager.change(PlanRequest(restart=("talker",)))
        assert restored.outcome == "done", restored.because
        assert (await manager.status()).valid

    hanging(tmp_path, body, simulator, Old=_talker("old", 0, 0))


@pytest.mark.parametrize("answers", [True, False])
def test_further_outputs_of_a_fenced_node_are_closed_or_it_is_killed(answers: bool, tmp_path: Path) -> None:
    """As where another step of the change hands over other outputs of it."""

    async def body(b: Bench) -> None:
        fences = Fences(b.client, b.launcher, b.events)
        b.client.reply("talker", FenceCommand, FencedOutputs(last={"out /chatter": 7}), FencedOutputs(last={}))
        assert await fences.fence("talker", "it hangs", [(OUT, "/chatter")]) == {OUT: 7}
        if not answers:
            del b.client.states["talker"]
        assert await fences.fence("talker", "it hangs", [(OTHER, "/log")]) == {OTHER: None}
        assert b.client.life["talker"].fence is (FenceState.GATE if answers else FenceState.KILLED)
        assert b.client.life["talker"].closed == ([("other", "/log")] if answers else [])

    bench(talking(), tmp_path, body)


def test_a_subscriber_that_hangs_is_replaced(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: Simulator, heard: Heard) -> None:
        await asyncio.sleep(3)
        outcome = await manager.change(PlanRequest(restart=("listener",)))
        assert outcome.outcome == "done", outcome.because
        assert [(each.instance, each.how) for each in outcome.fenced] == [("listener", "gate")]
        assert "listener_2" in manager.configuration.instances

    hanging(tmp_path, body, Old=_talker("hang", 0, 0))


def test_a_manager_killed_after_the_fence_leaves_a_system_that_the_next_one_completes(tmp_path: Path) -> None:
    """The old one is fenced and the new one not yet open: the worst moment."""
    (tmp_path / "talker.py").write_text(_TALKER)
    (tmp_path / "listener.py").write_text(_LISTENER)
    stuck = asyncio.Event()
    simulator = Acting("talker_2", "gate", lambda s: stuck.set())

    async def before(instance: str, op: str) -> None:
        await Acting.before(simulator, instance, op)
        if stuck.is_set() and not next_one:
            await asyncio.Event().wait()  # this manager gets no further

    simulator.control.before_request = before
    next_one: list[Manager] = []

    async def main() -> None:
        old = specification(Old=_talker("old", 20, 20.0))
        manager = Manager(old, simulator, Workspace(tmp_path), tmp_path)
        await manager.up()
        heard = Heard(simulator)
        await asyncio.sleep(3)
        simulator.armed = True
        changing = asyncio.ensure_future(manager.change(replace("talker", "New")))
        await stuck.wait()
        assert not changing.done()
        manager._client.close()  # as if it had been killed
        manager._store.close()
        other = Manager(old, simulator, Workspace(tmp_path), tmp_path)
        next_one.append(other)
        await other.up()
        # It kept the one that does not hang, and then went back to the component that its file has.
        [words] = [event.words for event in other.log() if event.kind == "half_done"]
        assert words.startswith("stopped talker, which an earlier manager had left half done, within ")
        assert "; talker_2 goes on; " in words
        assert sorted(simulator.processes) == sorted(other.configuration.instances) == ["listener", "talker_3"]
        assert (await other.status()).valid
        await asyncio.sleep(1)
        assert heard.words()[-1] == "old" and "old late" not in heard.words()
        changing.cancel()
        await asyncio.gather(changing, return_exceptions=True)
        await other.close()

    simulator.run(main())


# -- a new side that is stopped ------------------------------------------------------------------------


class Stopping(Simulator):
    """Stops the process of ``instance`` for good just before the request number ``at`` for it, or at its start (-1)."""

    def __init__(self, instance: str, at: int) -> None:
        super().__init__()
        self.control.before_request = self.before
        self.instance, self.at = instance, at
        self.ops: list[str] = []

    async def start(self, launch: Launch) -> Handle:
        handle = await super().start(launch)
        if launch.instance == self.instance and self.at < 0:
            self.faults.freeze(self.instance, 1e6)
        return handle

    async def before(self, instance: str, op: str) -> None:
        if instance == self.instance:
            if len(self.ops) == self.at and instance in self.processes:
                self.faults.freeze(instance, 1e6)
            self.ops.append(op)


@pytest.mark.parametrize("strategy", ["minimal", pytest.param("paper", marks=pytest.mark.full)])
def test_a_new_side_that_is_stopped_at_any_point_costs_a_few_seconds(strategy: str, tmp_path: Path) -> None:
    def change(at: int) -> tuple[Outcome, float, list[str]]:
        simulator = Stopping("talker_2", at)

        async def body(manager: Manager, _: Simulator) -> tuple[Outcome, float]:
            begun = simulator.clock.steady()
            return await manager.change(replace("talker", "NewTalker", strategy)), simulator.clock.steady() - begun

        folder = tmp_path / str(at)
        folder.mkdir()
        return *managed("talker", folder, body, simulator), simulator.ops

    outcome, seconds, ops = change(1000)
    assert outcome.outcome == "done"
    for at in range(-1, len(ops)):
        stopped, took, _ = change(at)
        assert stopped.outcome in ("done", "rolled_back"), ops[at]
        if stopped.outcome == "done":  # it had taken over
            assert [fault.instance for fault in stopped.silences] == ["talker_2"] or at > len(ops) - 4, ops[at]
            assert took < seconds + 3 * STOPPED, ops[at]
        else:
            assert took < seconds + STOPPED + STOP_GRACE + 1, ops[at]
            assert "talker_2" in str(stopped.because)
