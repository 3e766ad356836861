"""The state of a plain rclpy node across its replacements, under requests that change it; and one that refuses it.

MIDSTRIDE_STATE_REPLACEMENTS says how many replacements the long test makes, where 30 take too long.
"""

from __future__ import annotations

import asyncio
import os
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from midstride.lang.load import load
from midstride.plan.request import PlanRequest
from tests.acceptance.foreign_support import Robot, declared_talker, manager_of, robot, system_to_kill
from tests.acceptance.support import ended
from tests.acceptance.test_manager_killed import kill_the_manager
from tests.backends.ros2_support import Bare, run

pytestmark = [pytest.mark.ros2, pytest.mark.full]

REPLACEMENTS = int(os.environ.get("MIDSTRIDE_STATE_REPLACEMENTS", "30"))
BYTES = int(os.environ.get("MIDSTRIDE_STATE_BYTES", "0"))

# Plain rclpy: it counts its messages, and the requests that it has handled; both are its state. Its argument is what it
# says to a state that is offered to it, or how many bytes its own has besides.
COUNTER = """
import os
import sys
import rclpy
from rcl_interfaces.msg import ParameterType, ParameterValue, SetParametersResult
from rcl_interfaces.srv import GetParameters, ListParameters, SetParameters
from rclpy.executors import ExternalShutdownException
from rclpy.node import Node
from std_msgs.msg import String

rclpy.init()
node, own = Node("counter"), os.environ["MIDSTRIDE_INSTANCE"]
publisher = node.create_publisher(String, "chatter", 10)
count = handled = 0
refusal = sys.argv[1] if sys.argv[1:] and not sys.argv[1].isdigit() else ""
filling = b" " * int(sys.argv[1]) if sys.argv[1:] and not refusal else b""

def talk():
    global count
    count += 1
    publisher.publish(String(data=f"{own} {count}"))

def handle(request, response):
    global handled
    handled += 1
    response.result.names = [str(handled)]
    return response

def export_state(request, response):
    assert list(request.names) == ["state"], request.names
    state = f"{count} {handled}".encode() + filling
    value = ParameterValue(type=ParameterType.PARAMETER_BYTE_ARRAY)
    value.byte_array_value = [bytes((each,)) for each in state]
    response.values = [value]
    return response

def import_state(request, response):
    global count, handled
    (parameter,) = request.parameters
    if not refusal:
        count, handled = map(int, b"".join(parameter.value.byte_array_value).split())
    response.results = [SetParametersResult(successful=not refusal, reason=refusal)]
    return response

node.create_timer(0.02, talk)
node.create_service(ListParameters, "handle", handle)
node.create_service(GetParameters, "~/midstride/export_state", export_state)
node.create_service(SetParameters, "~/midstride/import_state", import_state)
try:
    rclpy.spin(node)
except (KeyboardInterrupt, ExternalShutdownException):
    pass
"""


# With the API, the same: its state has the same form.
OURS = """
from midstride import Component
from std_msgs.msg import String

comp = Component("Ours")
out = comp.create_output("out", String)
talk = comp.create_functionality("talk", outputs=[out])
count = handled = 0

def normal():
    global count
    count += 1
    out.write(String(data=f"{comp.instance} {count}"))

@comp.on_export_state
def export_state():
    return f"{count} {handled}".encode()

@comp.on_import_state
def import_state(state):
    global count, handled
    count, handled = map(int, state.split())

talk.set_normal_mode(normal, rate=50, outputs=[out])
talk.set_degraded_mode(lambda: None)
comp.start()
"""


def written(folder: Path) -> Path:
    (folder / "counter.py").write_text(COUNTER, encoding="utf-8")
    text = "system counting\ntopic /chat : std_msgs/msg/String @ 50 Hz\n"
    for name, argument in (("Plain", BYTES), ("Other", BYTES), ("Refusing", "'of another version'")):
        text += declared_talker(name, f"python3 counter.py {argument}", "preload")
    path = folder / "counting.stride"
    path.write_text(f"{text}node counter : Plain {{ out -> /chat }}\n", encoding="utf-8")
    return path


async def calling(system: Robot, answers: list[int]) -> None:
    """One request after the other, without an end."""
    from rcl_interfaces.srv import ListParameters

    client: Any = system.bare.node.create_client(ListParameters, "/handle")
    while not client.service_is_ready():
        await asyncio.sleep(0.01)
    while True:
        future = client.call_async(ListParameters.Request())
        while not future.done():
            await asyncio.sleep(0.002)
        answers.append(int(future.result().result.names[0]))


def kept_across(folder: Path, number: int) -> None:
    async def scenario() -> None:
        answers: list[int] = []
        async with robot(load(written(folder)).require(), folder) as system:
            clients = asyncio.ensure_future(calling(system, answers))
            await system.until(lambda: len(answers) > 5)
            silences = []
            for count in range(number):
                before = len(answers)
                component = "Other" if count % 2 == 0 else "Plain"
                report = await system.change(component, "counter")
                assert (report.outcome, report.because, report.own_state) == ("done", None, {}), report
                ((new, moved),) = report.moved.items()
                assert moved.silent is not None
                silences.append((moved.silent, moved.held, moved.bytes))
                await system.until(lambda new=new: system.heard[-1][1] == new)  # type: ignore[misc]
                await system.hears()
                await system.until(lambda before=before: len(answers) > before + 5)  # type: ignore[misc]
            plan = await system.manager.plan(PlanRequest(replace=(("counter", "Refusing"),)))
            assert any("nothing is published on /chat, and requests" in each.words for each in plan.besides)
            (writer,) = system.manager.configuration.instances
            report = await system.change("Refusing", "counter")
            assert report.outcome == "rolled_back"
            assert report.because is not None and "has not imported the state: of another version" in report.because
            await system.hears()
            assert system.heard[-1][1] == writer
            count = len(answers)
            await system.until(lambda: len(answers) > count + 5)
            clients.cancel()
            await asyncio.gather(clients, return_exceptions=True)
            for silent, held, size in sorted(silences):
                print(f"{size} bytes: silent for {silent * 1e3:.1f} ms, requests held for {held * 1e3:.1f} ms")
        # No number comes again, and each request was counted once, by a node that knew of all those before.
        numbers = [number for _, _, number in system.heard]
        assert all(before < after for before, after in pairwise(numbers)), system.holes()
        assert answers == list(range(1, len(answers) + 1))
        system.require_changes(number)

    with ended():
        run(scenario(), 3600)


def test_a_plain_node_keeps_what_it_has_counted_across_replacements(tmp_path: Path) -> None:
    kept_across(tmp_path, 3)


SERVERS = """
contract Handling = rcl_interfaces/srv/ListParameters
service /declared : Handling
component Declared {
  run "python3 counter.py 0" gate preload
  server handle
  functionality serve { produces handle  mode normal { guarantee handle : Handling }  mode off { } }
}
component Bare { run "python3 counter.py 0 --ros-args -r handle:=/bare" gate preload }
node declared : Declared { handle -> /declared }
node bare : Bare
"""


@pytest.mark.long
@pytest.mark.parametrize("role", ["declared", "bare"])
def test_a_server_keeps_its_state_where_no_topic_is_handed_over(tmp_path: Path, role: str) -> None:
    async def scenario() -> None:
        from rcl_interfaces.srv import ListParameters

        path = written(tmp_path)
        path.write_text(path.read_text() + SERVERS, encoding="utf-8")
        async with robot(load(path).require(), tmp_path) as system:
            client: Any = system.bare.node.create_client(ListParameters, f"/{role}")
            await system.until(client.service_is_ready)
            for number in range(1, 4):
                future = client.call_async(ListParameters.Request())
                await system.until(future.done)
                assert future.result().result.names == [str(number)]
                report = await system.meanwhile(system.manager.change(PlanRequest(restart=(role,))))
                assert (report.outcome, report.because, report.own_state) == ("done", None, {}), report
                (moved,) = report.moved.values()
                assert moved.silent is None

    with ended():
        run(scenario(), 3600)


# Where a manager is killed: around each step of a transfer.
POINTS = [
    (op, when)
    for op in ("prepare_state", "node_export_state", "node_import_state", "cut_in", "await_cut", "detach")
    for when in ("before", "after")
]


@pytest.mark.long
@pytest.mark.timeout(600)
def test_a_manager_that_is_killed_while_state_moves_leaves_one_node_with_all_of_it(tmp_path: Path) -> None:
    """One of the two answers each request, with what it knows of all those before; the next manager keeps it."""
    specification = system_to_kill(tmp_path, COUNTER, "/chat")

    async def scenario() -> None:
        from rcl_interfaces.srv import ListParameters

        manager, handled = manager_of(specification, tmp_path), 0
        await manager.up()
        with Bare("client") as bare:
            client: Any = bare.node.create_client(ListParameters, "/handle")
            await bare.until(client.service_is_ready, 60)

            async def answered(point: object) -> None:
                nonlocal handled
                future = client.call_async(ListParameters.Request())  # once: a request is never lost
                await bare.until(future.done, 60)
                assert future.result().result.names == [str(handled + 1)], f"{point}, after {handled}"
                handled += 1

            for point in POINTS:
                await answered(point)
                await manager.close()
                await asyncio.to_thread(kill_the_manager, tmp_path / "system", point[0], "1", point[1])
                await answered(f"killed {point}")
                manager = manager_of(specification, tmp_path)
                await manager.up()
                await answered(f"after killed {point}")
                assert (await manager.status()).valid
                assert len(manager.configuration.instances) == 1
        await manager.down()
        await manager.close()

    with ended():
        run(scenario(), 580)


@pytest.mark.long
def test_one_that_hangs_as_it_exports_is_replaced_all_the_same(tmp_path: Path) -> None:
    """Its replacement takes over with its own state, and the report says what is lost."""

    async def scenario() -> None:
        path = written(tmp_path)
        hangs = COUNTER.replace("    state = f", "    __import__('time').sleep(60)\n    state = f")
        (tmp_path / "counter.py").write_text(hangs, encoding="utf-8")
        async with robot(load(path).require(), tmp_path) as system:
            report = await system.change("Other", "counter")
            assert (report.outcome, len(report.fenced)) == ("done", 1), report
            assert "counter hangs" in report.own_state["counter_2"], report.own_state
            await system.hears()
            assert system.heard[-1][1] == "counter_2"

    with ended():
        run(scenario(), 3600)


@pytest.mark.long
def test_a_plain_node_keeps_what_it_has_counted_across_many_replacements(tmp_path: Path) -> None:
    kept_across(tmp_path, REPLACEMENTS)


@pytest.mark.long
def test_the_state_of_a_relayed_node_goes_on_behind_another_relay_and_with_the_api(tmp_path: Path) -> None:
    """Beside each other. With `--strategy paper`, also between the API and a node with the library in it."""
    for name, text in (("counter", COUNTER), ("ours", OURS)):
        (tmp_path / f"{name}.py").write_text(text, encoding="utf-8")
    text = "system counting\ntopic /chat : std_msgs/msg/String @ 50 Hz\n"
    for name, gate in (("Relayed", "relay"), ("Other", "relay"), ("Plain", "preload")):
        text += declared_talker(name, "python3 counter.py 0", gate)
    text += declared_talker("Refusing", "python3 counter.py 'of another version'", "relay")
    text += declared_talker("Ours", "python3 ours.py")
    (tmp_path / "counting.stride").write_text(f"{text}node counter : Relayed {{ out -> /chat }}\n", encoding="utf-8")

    async def scenario() -> None:
        async with robot(load(tmp_path / "counting.stride").require(), tmp_path) as system:
            for component in ("Other", "Relayed", "Ours", "Other", "Ours", "Relayed"):
                begun = len(system.heard)
                report = await system.change(component, "counter")
                assert (report.outcome, report.because, report.own_state) == ("done", None, {}), report
                await system.hears()
                heard = system.heard[begun - 1 :]
                silences = [(b[0] - a[0], b[2] - a[2] - 1) for a, b in pairwise(heard) if a[1] != b[1]]
                (moved,) = report.moved.values()
                assert 3 <= moved.bytes <= 8, moved
                assert moved.silent is not None and abs(moved.silent - silences[0][0]) < 0.1, (moved, silences)
                print(
                    f"{component}: silent for {silences[0][0] * 1e3:.0f} ms, left out {silences[0][1]} numbers; {moved}"
                )
            report = await system.change("Refusing", "counter")
            assert report.outcome == "rolled_back" and "of another version" in (report.because or ""), report
            await system.hears()
            for component, strategy in (("Ours", "minimal"), ("Plain", "paper"), ("Ours", "paper"), ("Other", "paper")):
                request = PlanRequest(replace=(("counter", component),), strategy=strategy)
                plan = await system.manager.plan(request)
                assert not any("state" in each.words and "lost" in each.words for each in plan.besides), plan.besides
                report = await system.meanwhile(system.manager.change(request))
                assert (report.outcome, report.because, report.own_state) == ("done", None, {}), report
                await system.hears()
        numbers = [number for _, _, number in system.heard]
        assert all(before < after for before, after in pairwise(numbers)), system.holes()
        system.require_changes(10)

    with ended():
        run(scenario(), 300)
