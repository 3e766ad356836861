"""State of components without outputs: nothing is handed over, and each message is still received by one of the two."""

from __future__ import annotations

import asyncio
import itertools
import json
import random
from collections.abc import Awaitable, Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from rich.console import Console, RenderableType

from midstride.backends.simulator import Simulator
from midstride.cli import render
from midstride.errors import Unreachable
from midstride.plan.forms.plan_forms import plan_form
from midstride.plan.request import PlanRequest
from midstride.runtime.manager import Manager
from midstride.runtime.records.reports import Outcome
from tests.runtime.counting import _SOURCE as SOURCE
from tests.runtime.counting import STRING, at_rates, counting, settle, system

# Notes each message, how many it has had with those of its predecessors, and whether it is live; and its own slots.
SINK = """
import json
from pathlib import Path
from midstride import Component
from std_msgs.msg import String

comp = Component("sink")
inlet = comp.create_input("in", String, qos=200)
count = {{"in": 0, "slots": 0}}

def note(what, number):
    count[what] += 1
    with (Path(__file__).parent / what).open("a") as file:
        file.write(f"{{number}} {{count[what]}} {{comp.instance}} {{comp.is_live}}\\n")

hear = comp.create_functionality("hear", inputs=[inlet])
hear.set_normal_mode(lambda message: note("in", message.data), inputs=[inlet])
hear.set_degraded_mode(lambda: None)
look = comp.create_functionality("look")
look.set_normal_mode(lambda: note("slots", 0), rate=50)
look.set_degraded_mode(lambda: None)

@comp.on_export_state
def export_state():
    {export}

{import_}

comp.start()
"""
EXPORT = "return json.dumps(count).encode()"
IMPORT = "@comp.on_import_state\ndef import_state(state):\n    count.update(json.loads(state))\n"
RESTART = PlanRequest(restart=("sink",))


def sink_system(folder: Path, rate: float = 200, export: str = EXPORT, import_: str = IMPORT) -> None:
    """A source, and a sink that notes what it receives in files: their programs and their specification."""
    (folder / "source.py").write_text(SOURCE.format(rate=rate, prefix=""))
    (folder / "sink.py").write_text(SINK.format(export=export, import_=import_))
    contract = {"type": STRING, "rate": rate}
    talk = {"produces": ["out"], "modes": {"normal": {"guarantees": {"out": contract}}, "degraded": {}}}
    hear = {"uses": ["in"], "modes": {"normal": {"assumes": ["in"]}, "degraded": {}}}
    look: dict[str, Any] = {"modes": {"normal": {}, "degraded": {}}}
    components = {
        "Source": {"run": "python3 source.py", "outputs": ["out"], "functionalities": {"talk": talk}},
        "Sink": {
            "run": "python3 sink.py",
            "inputs": {"in": {"type": STRING}},
            "functionalities": {"hear": hear, "look": look},
        },
    }
    nodes = {
        "source": {"component": "Source", "attachments": {"out": ["/ticks"]}},
        "sink": {"component": "Sink", "attachments": {"in": ["/ticks"]}},
    }
    document = {"system": "sinking", "topics": {"/ticks": contract}, "components": components, "nodes": nodes}
    (folder / "counting.json").write_text(json.dumps(document))


def sinking(
    folder: Path,
    body: Callable[[Manager, Simulator], Awaitable[None]],
    export: str = EXPORT,
    import_: str = IMPORT,
    seed: int = 0,
) -> None:
    """Run ``body`` with that system on the simulator."""
    sink_system(folder, export=export, import_=import_)
    counting(folder, body, Simulator(seed=seed, latency=0.0003, jitter=0.0003))


def noted(folder: Path, what: str = "in") -> list[list[str]]:
    return [line.split() for line in (folder / what).read_text().splitlines()]


def assert_each_once(folder: Path) -> None:
    """Every message was received by one component, in order, and counted on from the one before it."""
    lines = noted(folder)
    numbers, counts = [int(line[0]) for line in lines], [int(line[1]) for line in lines]
    assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))
    assert counts == list(range(1, len(counts) + 1))
    assert {line[3] for line in lines} == {"True"}


def printed(part: RenderableType) -> str:
    """What is shown on the terminal, on one line."""
    console = Console(width=200)
    with console.capture() as capture:
        console.print(part)
    return " ".join(capture.get().split())


def shown(outcome: Outcome) -> str:
    return printed(render.outcome(outcome))


@pytest.mark.parametrize("seed", range(2))
def test_each_message_is_received_once_and_the_state_goes_on(seed: int, tmp_path: Path) -> None:
    async def body(manager: Manager, _: Simulator) -> None:
        phases = random.Random(seed)
        for _count in range(5):
            await settle(phases.uniform(0.1, 0.2))
            outcome = await manager.change(RESTART)
            assert (outcome.outcome, outcome.because, outcome.own_state) == ("done", None, {})
        await settle()
        assert_each_once(tmp_path)
        sides = [line[2] for line in noted(tmp_path)]
        assert sum(earlier != later for earlier, later in itertools.pairwise(sides)) == 5
        slots = noted(tmp_path, "slots")
        assert [int(line[1]) for line in slots] == list(range(1, len(slots) + 1))

    sinking(tmp_path, body, seed=seed)


@pytest.mark.parametrize(
    ("export", "import_"),
    [
        ("raise ValueError('lost')", IMPORT),
        (EXPORT, IMPORT.replace("count.update", "raise ValueError('lost')\n    ")),
    ],
)
def test_where_a_hook_raises_the_old_one_goes_on(export: str, import_: str, tmp_path: Path) -> None:
    async def body(manager: Manager, _: Simulator) -> None:
        await settle()
        outcome = await manager.change(RESTART)
        assert outcome.outcome == "rolled_back" and "state raised: ValueError: lost" in str(outcome.because)
        await settle()
        assert_each_once(tmp_path)
        assert {line[2] for line in noted(tmp_path)} == {"sink"}
        assert (await manager.status()).valid

    sinking(tmp_path, body, export=export, import_=import_)


def test_a_roll_back_after_the_state_has_moved_moves_it_back(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: Simulator) -> None:
        await settle()
        simulator.faults.fail_next("sink", "detach", "refused")
        outcome = await manager.change(RESTART)
        assert outcome.outcome == "rolled_back", outcome
        await settle()
        assert_each_once(tmp_path)
        sides = list(dict.fromkeys(line[2] for line in noted(tmp_path)))
        assert sides == ["sink", "sink_2"] and noted(tmp_path)[-1][2] == "sink"

    sinking(tmp_path, body)


def test_without_an_import_it_is_replaced_and_the_outcome_says_what_is_lost(tmp_path: Path) -> None:
    async def body(manager: Manager, _: Simulator) -> None:
        await settle()
        outcome = await manager.change(RESTART)
        assert outcome.outcome == "done"
        assert "it has no on_import_state" in outcome.own_state["sink_2"]
        assert "sink_2 continues with its own state" in shown(outcome)

    sinking(tmp_path, body, import_="")


@pytest.mark.parametrize("behind", [0.02, 0.15, 0.4])
def test_what_the_old_one_receives_late_is_received_by_the_new_one(
    behind: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The new one has had these messages before it knows of the cut, and the old one by the cut not yet."""

    async def body(manager: Manager, simulator: Simulator) -> None:
        send = simulator.network._send

        def send_late(writer: Any, reader: Any, message: Any, info: Any, extra: float = 0.0) -> None:
            send(writer, reader, message, info, extra + (behind if reader.owner.node == "/sink" else 0.0))

        monkeypatch.setattr(simulator.network, "_send", send_late)
        await settle()
        outcome = await manager.change(RESTART)
        assert (outcome.outcome, outcome.because) == ("done", None)
        await settle()
        assert_each_once(tmp_path)
        assert {line[2] for line in noted(tmp_path)} == {"sink", "sink_2"}

    sinking(tmp_path, body)


@pytest.mark.parametrize("op", ["mute", "cut_out", "cut_in", "await_cut", "fetch_state"])
def test_an_old_one_that_dies_leaves_its_replacement_receiving(op: str, tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: Simulator) -> None:
        async def look(to: str, sent: str) -> None:
            if sent == op and "sink" in simulator.processes:
                simulator.faults.kill("sink")

        simulator.control.before_request = look
        await settle()
        outcome = await manager.change(RESTART)
        assert outcome.outcome == "done", outcome.because
        assert "lost is all that sink had kept until" in shown(outcome)
        before = len(noted(tmp_path))
        await settle()
        lines = noted(tmp_path)
        assert len(lines) > before + 40 and lines[-1][2] == "sink_2"
        assert sorted(manager.configuration.instances) == ["sink_2", "source"]

    sinking(tmp_path, body)


@pytest.mark.parametrize("op", ["mute", "cut_in", "await_cut", "modes"])
def test_a_replacement_that_dies_leaves_the_old_one_receiving(op: str, tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: Simulator) -> None:
        async def look(to: str, sent: str) -> None:
            if (to, sent) == ("sink_2", op):
                simulator.faults.kill("sink_2")

        simulator.control.before_request = look
        await settle()
        outcome = await manager.change(RESTART)
        assert outcome.outcome == "rolled_back"
        await settle()
        assert_each_once(tmp_path)
        assert {line[2] for line in noted(tmp_path)} == {"sink"}

    sinking(tmp_path, body)


def test_a_replacement_is_made_whose_first_attempt_has_died(tmp_path: Path) -> None:
    """The second attempt has the name of the first one, and not its exit."""

    async def body(manager: Manager, simulator: Simulator) -> None:
        async def look(to: str, sent: str) -> None:
            if (to, sent) == ("sink_2", "modes") and not outcomes:
                simulator.faults.kill("sink_2")
                await settle()  # its exit is known before the step fails

        outcomes: list[str] = []
        simulator.control.before_request = look
        for _ in range(2):
            await settle()
            outcomes.append((await manager.change(RESTART)).outcome)
        assert outcomes == ["rolled_back", "done"]
        await settle()
        assert_each_once(tmp_path)
        assert {line[2] for line in noted(tmp_path)} == {"sink", "sink_2"}

    sinking(tmp_path, body)


@pytest.mark.parametrize("op", ["cut_out", "cut_in", "await_cut"])
def test_one_of_the_two_receives_whenever_the_manager_dies(op: str, tmp_path: Path) -> None:
    """Each message once, without a manager and with the next one, which ends the other of the two."""

    async def body(manager: Manager, simulator: Simulator) -> None:
        send, dead, over = manager._client._send, asyncio.Event(), asyncio.Event()

        async def until_then(instance: str, command: Any, revision: Any) -> Any:
            if dead.is_set() or command.name == op:
                dead.set()
                await over.wait()
                raise Unreachable("the manager is dead")
            return await send(instance, command, revision)

        manager._client._send = until_then  # type: ignore[method-assign]
        await settle()
        changing = asyncio.ensure_future(manager.change(RESTART))
        await dead.wait()
        await settle(4)
        await manager.close()
        following = Manager(manager.specification, simulator, manager._workspace, tmp_path)
        await following.up()
        try:
            await settle()
            assert_each_once(tmp_path)
            (sink,) = following.configuration.instances_by_role["sink"]
            assert {line[2] for line in noted(tmp_path)[-20:]} == {sink}
            assert sorted(simulator.processes) == sorted(["source", sink])
        finally:
            await following.close()
            over.set()
            changing.cancel()
            await asyncio.wait({changing})

    sinking(tmp_path, body)


def test_where_no_topic_is_handed_over_the_plan_and_the_outcome_say_so(tmp_path: Path) -> None:
    """A topic of another rate is another topic: both publishers are on it for a moment, and there is no cut."""

    async def body(manager: Manager, _: Simulator) -> None:
        connectors = manager.specification.connectors
        contract = replace(connectors["/out"].guarantee, rate=25.0)
        other = connectors.set("/out", replace(connectors["/out"], guarantee=contract))
        request = PlanRequest(to=replace(manager.specification, connectors=other), restart=("counter",))
        plan, _target = await manager._session.planner.plan(request)
        because = "it takes over no topic of counter, so there is no cut at which the state of counter could move"
        form = plan_form(plan)
        assert form.own_state == {"counter_2": because}
        assert f"counter_2 starts with its own state: {because}." in printed(render.plan(form, "title"))
        outcome = await manager.change(request)
        assert outcome.outcome == "done"
        assert because in outcome.own_state["counter_2"] and because in shown(outcome)

    counting(system(tmp_path, at_rates(out=50), out=50), body)
