"""Changes of whole systems on ROS 2: what is live at the cut, what a busy component does, what a failed step leaves."""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import subprocess
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from immutables import Map

from midstride.model.component import ComponentSpec, Connector, FunctionalitySpec, Mode
from midstride.model.contract import Predicate
from midstride.model.specification import Node, Specification
from midstride.plan.forms.plan_forms import encode_plan
from midstride.plan.request import PlanRequest
from midstride.runtime.change import mode_changes
from midstride.runtime.manager import Manager
from midstride.wire.state import GateState
from tests.acceptance.support import Recorder, ended, managed, swap_specification
from tests.backends.ros2_support import run, until_async

pytestmark = pytest.mark.ros2
REPLACE = PlanRequest(replace=(("source", "OtherSource"),))


async def step(manager: Manager, kind: str, action: str) -> None:
    """Until an event of ``kind`` tells of a step ``action``."""
    async for event in manager.subscribe():
        if event.kind == kind and event.step and event.step.action == action:
            return


def test_both_publishers_are_live_at_the_cut_and_one_is_gated(tmp_path: Path) -> None:
    async def main() -> None:
        async with managed(tmp_path / "system", swap_specification()) as (manager, _):
            changing = asyncio.ensure_future(manager.change(REPLACE))
            await step(manager, "step", "handover")
            seen: list[dict[str, GateState | None]] = []

            async def both() -> bool:
                ports = {name: (await manager.peek(name)).ports["out"] for name in ("source", "source_2")}
                if changing.done() or not all("/swap" in topics for topics in ports.values()):
                    return changing.done()
                seen.append({name: topics["/swap"].gate for name, topics in ports.items()})
                return True

            await until_async(both)
            assert (await changing).outcome == "done"
            assert seen == [{"source": "open", "source_2": "closed"}]

    with ended():
        run(main())


BUSY = """
import time
from midstride import Component
from std_msgs.msg import String

comp = Component("busy")
out = comp.create_output("out", String)
work = comp.create_functionality("work", outputs=[out])

def normal():
    time.sleep(1)
    out.write(String(data="late"))

work.set_normal_mode(normal, rate=0.8, outputs=[out])
work.set_degraded_mode(lambda: None)
comp.start()
"""


def busy_specification(folder: Path) -> Specification:
    (folder / "busy.py").write_text(BUSY)
    modes = (Mode("normal", (), Map({"out": Predicate("std_msgs/msg/String", 0.8)})), Mode("degraded"))
    work = FunctionalitySpec("work", modes, (), ("out",))
    component = ComponentSpec.of("Busy", outputs=("out",), functionalities=(work,), run="python3 busy.py")
    return Specification(
        "busy",
        connectors=Map({"/swap": Connector("/swap", Predicate("std_msgs/msg/String", 0.8))}),
        components=Map({"Busy": component}),
        nodes=Map({"busy": Node("busy", "Busy", Map({"out": ("/swap",)}))}),
    )


async def a_call_begins(manager: Manager) -> None:
    """Wait for a call of user code to begin, which takes a second, and for the report of it, within half a second."""

    async def is_busy() -> bool:
        return bool((await manager.peek("busy")).functionalities["work"].busy)

    async def is_idle() -> bool:
        return not await is_busy()

    async def is_shown() -> bool:
        return (await manager.status()).instances[0].functionalities[0].busy is not None

    await until_async(is_idle)
    await until_async(is_busy)
    await until_async(is_shown)


@pytest.mark.full
def test_status_answers_while_a_mode_sleeps_and_nothing_comes_after_the_degrade(tmp_path: Path) -> None:
    async def main() -> None:
        async with managed(tmp_path / "system", busy_specification(tmp_path), tmp_path) as (manager, _):
            recorder = Recorder(tmp_path)
            await asyncio.to_thread(recorder.wait_until_it_hears)
            await a_call_begins(manager)
            begun = time.time_ns()
            changing = asyncio.ensure_future(manager.change(PlanRequest(remove=("busy",), strategy="quiesce")))
            await step(manager, "step", "degrade")
            answers = 0
            while (view := (await manager.status()).instances[0].functionalities[0]).busy is not None:
                assert view.name == "work" and view.busy
                answers += 1
                await asyncio.sleep(0.02)
            assert answers >= 3, "the status waited for the call of user code"
            await step(manager, "step_done", "degrade")
            acknowledged = time.time_ns()
            outcome = await changing
            assert outcome.outcome == "done", outcome.because
            # The call under way had written its message before the degrade was acknowledged, and none came after.
            written = [row.source for row in recorder.stop() if row.source is not None and row.source > begun]
            assert len(written) == 1 and written[0] < acknowledged

    with ended():
        run(main())


@pytest.mark.full
def test_a_call_that_outlasts_the_drain_is_waited_for_where_its_node_is_removed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """For as long as the change waits before it fences: that is longer than the call takes."""

    async def main() -> None:
        async with managed(tmp_path / "system", busy_specification(tmp_path), tmp_path) as (manager, _):
            monkeypatch.setattr(mode_changes, "DRAIN_TIMEOUT", 0.3)
            await a_call_begins(manager)
            outcome = await manager.change(PlanRequest(remove=("busy",), strategy="quiesce"))
            assert (outcome.outcome, outcome.because, outcome.fenced) == ("done", None, [])
            assert (await manager.status()).instances == []

    with ended():
        run(main())


@pytest.mark.full
def test_a_subscriber_stopped_while_its_publisher_is_replaced_is_named_and_answers_when_it_continues(
    tmp_path: Path,
) -> None:
    async def main() -> None:
        async with managed(tmp_path / "system", swap_specification()) as (manager, _):
            pid = (await manager.peek("sink")).pid
            os.kill(pid, signal.SIGSTOP)
            try:
                outcome = await manager.change(REPLACE)
                assert outcome.outcome == "rolled_back", outcome.because
                status = await manager.status()
                assert [(fault.kind, fault.instance) for fault in status.silences] == [("not_answering", "sink")]
                assert [fault.instance for fault in outcome.silences] == ["sink"]
            finally:
                os.kill(pid, signal.SIGCONT)

            async def is_valid() -> bool:
                return (await manager.status()).valid

            await until_async(is_valid)
            outcome = await manager.change(REPLACE)
            assert outcome.outcome == "done", outcome.because
            assert outcome.swaps[0].gap is not None

    with ended():
        run(main())


async def picture(manager: Manager, backend: Any) -> dict[str, Any]:
    """Modes and gates by the components' own word, the graph, and the model."""
    own = {}
    for name in ("source", "sink"):
        state = await manager.peek(name)
        gates = {f"{port} {topic}": view.gate for port, topics in state.ports.items() for topic, view in topics.items()}
        own[name] = ({key: view.mode for key, view in state.functionalities.items()}, gates)
    graph = await backend.endpoints()
    on_swap = {name for name, topic in (*graph.publishers, *graph.subscribers) if topic == "/swap"}
    return {"own": own, "graph": on_swap, "model": manager.configuration}


async def whole_picture(manager: Manager, backend: Any) -> dict[str, Any]:
    """The same once the middleware shows both ends of the topic."""
    found: dict[str, Any] = {}

    async def is_whole() -> bool:
        found.update(await picture(manager, backend))
        return bool(found["graph"] == {"/source", "/sink"})

    await until_async(is_whole)
    return found


@pytest.mark.parametrize("strategy", ["minimal", pytest.param("paper", marks=pytest.mark.full)])
def test_a_step_that_fails_at_any_index_leaves_all_as_it_was(strategy: str, tmp_path: Path) -> None:
    """The new component is killed as each step begins that needs it."""

    async def main() -> int:
        async with managed(tmp_path / "system", swap_specification()) as (manager, backend):
            plan = await manager.plan(replace(REPLACE, strategy=strategy))
            needing = [
                index
                for index, document in enumerate(encode_plan(plan)["steps"])
                if "source_2" in str({**document, "step": None}) and document["action"] != "create"
            ]
            before = await whole_picture(manager, backend)
            for index in needing:
                changing = asyncio.ensure_future(manager.change(replace(REPLACE, strategy=strategy)))
                seen = len(manager.log())
                async for event in manager.subscribe(seen):
                    if event.kind == "step" and event.index == index:
                        break
                os.kill((await manager.peek("source_2")).pid, signal.SIGKILL)
                outcome = await changing
                assert outcome.outcome == "rolled_back", outcome.because
                assert "source_2" in str(outcome.because)

                async def as_before() -> bool:
                    now = await picture(manager, backend)
                    if strategy == "paper":  # the old process had gone: another one bears its name
                        now["graph"], before["graph"] = set(), set()
                    return now == before

                await until_async(as_before)
            return len(needing)

    with ended():
        assert run(main(), 110) >= 2


UNDECLARED = """
from midstride import Component
from std_msgs.msg import String
from std_srvs.srv import Trigger

comp = Component("source")
out = comp.create_output("out", String)
talk = comp.create_functionality("talk", outputs=[out])
talk.set_normal_mode(lambda: out.write(String(data="x")), rate=50, outputs=[out])
talk.set_degraded_mode(lambda: None)
comp.on_setup(lambda node: node.create_service(Trigger, "~/reset", lambda request, response: response))
comp.start()
"""


@pytest.mark.full
def test_an_endpoint_that_is_not_allowed_is_named_and_the_system_is_as_it_was(tmp_path: Path) -> None:
    script = tmp_path / "undeclared.py"
    script.write_text(UNDECLARED)
    specification = swap_specification()
    other = replace(specification.components["OtherSource"], run=f"python3 {script}")
    specification = replace(specification, components=specification.components.set("OtherSource", other))

    async def main() -> None:
        async with managed(tmp_path / "system", specification) as (manager, backend):
            before = await whole_picture(manager, backend)
            outcome = await manager.change(REPLACE)
            assert outcome.outcome == "rolled_back"
            assert "source_2" in str(outcome.because) and "service /source/reset" in str(outcome.because)
            assert await picture(manager, backend) == before

    with ended():
        run(main())


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can mount a disk that is soon full")
@pytest.mark.full
def test_a_full_disk_refuses_a_change_before_anything_is_begun(tmp_path: Path) -> None:
    small = tmp_path / "small"
    small.mkdir()
    if subprocess.run(["mount", "-t", "tmpfs", "-o", "size=1m", "none", str(small)], check=False).returncode:
        pytest.skip("no file system can be mounted here")

    async def main() -> None:
        async with managed(small / "system", swap_specification()) as (manager, backend):
            before = await whole_picture(manager, backend)
            filler = os.open(small / "filler", os.O_CREAT | os.O_WRONLY)
            with contextlib.suppress(OSError):
                while os.write(filler, bytes(4096)):
                    pass
            os.close(filler)
            outcome = await manager.change(REPLACE)
            (small / "filler").unlink()
            assert outcome.outcome == "refused" and "disk is full" in str(outcome.because)
            assert await picture(manager, backend) == before
            assert (await manager.change(REPLACE)).outcome == "done"

    try:
        with ended():
            run(main())
    finally:
        subprocess.run(["umount", "-l", str(small)], check=True)
