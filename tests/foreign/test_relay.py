"""Programs behind relays: handed over, hung, writing once, not what they are declared as; and their processes."""

from __future__ import annotations

import asyncio
import math
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import pytest

from midstride.codec.component_form import NamedComponentForm
from midstride.errors import NodeError
from midstride.foreign.relay import patient
from midstride.foreign.relayed_program import KILLED, RelayedProgram, RelayOrder, differing, private_topics
from midstride.lang.load import load
from midstride.model.contract import QoS
from midstride.plan.request import PlanRequest
from midstride.runtime.handover.live_handover import LEADS
from midstride.runtime.manager import Manager
from midstride.runtime.process.reaper import process_info
from tests.foreign.chat import chat
from tests.foreign.lab import until
from tests.foreign.relayed import Program, SimulatedRelays, managed

TEXT = chat("relay", listener="tolerates 3 missed")
ONCE = TEXT.replace(" @ 50 Hz", "").replace(" tolerates 3 missed", "")
REPLACE = PlanRequest(replace=(("talker", "Other"),))


def programs(other: Program | None = None, most: float = math.inf) -> dict[str, Program]:
    return {"Talker": Program(most=most), "Other": other or Program(most=most), "Listener": Program()}


def writers(heard: list[tuple[int, str]]) -> list[tuple[str, int]]:
    return [(words.split()[0], int(words.split()[1])) for _, words in heard]


def test_one_program_is_heard_at_each_moment_and_no_slot_is_missed(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: SimulatedRelays) -> None:
        await asyncio.sleep(2)
        for number in range(3):
            await asyncio.sleep(1 + number * 0.007)  # at another phase of the old program's grid
            outcome = await manager.change(PlanRequest(replace=(("talker", ("Other", "Talker")[number % 2]),)))
            assert (outcome.outcome, outcome.because) == ("done", None)
            (swap,) = outcome.swaps
            assert (swap.missed, swap.lost, swap.duplicates) == (0, 0, 0)
        await asyncio.sleep(1)
        heard = simulator.heard["listener"]
        found = list(pairwise(writers(heard)))
        changes = [(old, new) for (old, _), (new, _) in found if old != new]
        assert changes == [(f"talker{old}", f"talker{new}") for old, new in pairwise(("", "_2", "_3", "_2"))]
        # Each writes all of its messages while it has the topic.
        assert all(b == a + 1 for (old, a), (new, b) in found if old == new)
        # The cut is a quarter of a period after a message of the old one, and at most a period before the new one's.
        gap = max(b - a for (a, _), (b, _) in pairwise(heard))
        assert gap <= 1.3 * 20e6, gap
        assert (await manager.status()).valid

    managed(tmp_path, TEXT, programs(), body)


@pytest.mark.parametrize("late", [0.0, 0.004, 0.03, 0.1])
def test_a_relay_that_runs_late_is_not_heard_after_its_successor(tmp_path: Path, late: float) -> None:
    """What the old program published before the cut waits in its relay until ``late`` (s) after it, and is heard."""

    async def body(manager: Manager, simulator: SimulatedRelays) -> None:
        async def stall(instance: str, command: str) -> None:
            """As soon as both sides know the cut."""
            if command == "cut_in":
                (old,) = (name for name in manager.configuration.instances if name not in (instance, "listener"))
                simulator.faults.hang(old, LEADS[0] + late)

        await asyncio.sleep(2)
        simulator.control.before_request = stall
        for number in range(4):
            await asyncio.sleep(1 + number * 0.0053)  # at another phase of the old program's grid
            outcome = await manager.change(PlanRequest(replace=(("talker", ("Other", "Talker")[number % 2]),)))
            assert (outcome.outcome, outcome.because) == ("done", None)
            found = writers(simulator.heard["listener"])
            assert len([1 for (old, _), (new, _) in pairwise(found) if old != new]) == number + 1
            assert all(b == a + 1 for (old, a), (new, b) in pairwise(found) if old == new)
            (old, last), (new, first) = next((a, b) for a, b in pairwise(found[::-1]) if a[0] != b[0])[::-1]
            # The one's next message, and the other's message before, were published on the other side of the cut.
            assert simulator.written[old][last] > simulator.written[new][first - 2]

    managed(tmp_path, TEXT, programs(), body)


def test_what_relies_on_a_program_that_hangs_falls_and_is_restored(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: SimulatedRelays) -> None:
        async def mode() -> str:
            return (await manager.peek("listener")).functionalities["listen"].mode

        async def becomes(wanted: str, seconds: float) -> None:
            deadline = simulator.time.steady() + seconds
            while await mode() != wanted:
                assert simulator.time.steady() < deadline, await manager.status()
                await asyncio.sleep(0.05)

        await asyncio.sleep(1)
        assert await mode() == "normal"
        simulator.programs["Talker"].hung.add("talker")
        await becomes("degraded", 2)
        simulator.programs["Talker"].hung.clear()
        await becomes("normal", 60)

    managed(tmp_path, TEXT, programs(), body)


@pytest.mark.parametrize(
    "other",
    [
        pytest.param(Program(hung={"talker_2"}), id="at once"),
        pytest.param(Program(1000.0, most=8), id="before it is attached", marks=pytest.mark.full),
    ],
)
def test_a_program_that_hangs_is_not_let_in(tmp_path: Path, other: Program) -> None:
    async def body(manager: Manager, simulator: SimulatedRelays) -> None:
        await asyncio.sleep(1)
        outcome = await manager.change(REPLACE)
        assert outcome.outcome == "rolled_back"
        assert "talker_2.out has written nothing" in str(outcome.because)
        await asyncio.sleep(1)
        found = writers(simulator.heard["listener"])
        assert {name for name, _ in found} == {"talker"}
        assert all(b == a + 1 for (_, a), (_, b) in pairwise(found))

    text = TEXT.replace("system chat\n", "system chat\ntiming { probation 0 s }\n")
    managed(tmp_path, text, programs(other), body)


def test_a_program_that_hangs_is_replaced(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: SimulatedRelays) -> None:
        await asyncio.sleep(1)
        simulator.programs["Talker"].hung.add("talker")
        outcome = await manager.change(REPLACE)
        assert (outcome.outcome, outcome.because) == ("done", None)
        await asyncio.sleep(1)
        assert writers(simulator.heard["listener"])[-1][0] == "talker_2"

    managed(tmp_path, TEXT, programs(), body)


def test_what_is_written_once_is_published_when_the_gate_opens(tmp_path: Path) -> None:
    """The program has written before its component is in its normal mode, and before it takes over."""

    async def body(manager: Manager, simulator: SimulatedRelays) -> None:
        await asyncio.sleep(1)
        assert writers(simulator.heard["listener"]) == [("talker", 1)]
        outcome = await manager.change(REPLACE)
        assert (outcome.outcome, outcome.because) == ("done", None)
        await asyncio.sleep(1)
        assert writers(simulator.heard["listener"]) == [("talker", 1), ("talker_2", 1)]

    managed(tmp_path, ONCE, programs(most=1), body)


def test_of_a_latched_output_as_many_are_published_as_its_depth(tmp_path: Path) -> None:
    """Behind the gate and before the mode was entered: late joiners of the program itself would have as many."""

    async def body(manager: Manager, simulator: SimulatedRelays) -> None:
        await asyncio.sleep(1)
        assert writers(simulator.heard["listener"]) == [("talker", 3), ("talker", 4), ("talker", 5)]
        outcome = await manager.change(REPLACE)
        assert (outcome.outcome, outcome.because) == ("done", None)
        await asyncio.sleep(1)
        assert writers(simulator.heard["listener"])[3:] == [("talker_2", 3), ("talker_2", 4), ("talker_2", 5)]

    latched = ONCE.replace("std_msgs/msg/String", "std_msgs/msg/String qos(durability = transient_local, depth = 3)")
    managed(tmp_path, latched, programs(most=5), body)


def test_the_fields_of_relayed_messages_are_checked(tmp_path: Path) -> None:
    """Of what a program publishes, and of what it receives; only then are messages read."""

    async def body(manager: Manager, simulator: SimulatedRelays) -> None:
        await asyncio.sleep(3)
        written = (await manager.peek("talker")).ports["out"]["/chat"].fields["number"]
        received = (await manager.peek("listener")).ports["in"]["/chat"].fields["number"]
        for found in (written, received):
            assert found.checked > 100
            # It was not attached from the first message on.
            assert found.violations == found.run and 40 <= found.checked - found.violations <= 50
        assert (await manager.peek("listener")).functionalities["listen"].mode == "degraded"

    text = TEXT.replace("std_msgs/msg/String @ 50 Hz", "std_msgs/msg/String @ 50 Hz where number <= 50")
    managed(tmp_path, text, programs(), body)


def test_a_relay_ends_in_order_when_its_program_has_exited(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: SimulatedRelays) -> None:
        await asyncio.sleep(1)
        simulator.exits["talker"]()
        simulator.exits["talker"]()  # once more does nothing
        await asyncio.sleep(1)
        assert "talker" not in manager.configuration.instances
        words = [event.words for event in manager.log()]
        assert any("talker exited" in each for each in words), words

    managed(tmp_path, TEXT, programs(), body)


def test_a_node_with_another_type_is_refused(tmp_path: Path) -> None:
    other = programs()
    other["Listener"].type = "std_msgs/msg/Int32"

    async def body(manager: Manager, simulator: SimulatedRelays) -> None:
        assert "listener" not in manager.configuration.instances
        [crashed] = (await manager.status()).crashed
        assert "node /listener subscribes to /chat as std_msgs/msg/Int32" in crashed.log

    managed(tmp_path, TEXT, other, body)


# -- the process of the program --------------------------------------------------------------------------


def order(folder: Path, *command: str, environment: dict[str, str | None] | None = None) -> RelayOrder:
    path = folder / "chat.stride"
    path.write_text(TEXT, encoding="utf-8")
    component = load(path).require().components["Talker"]
    made = RelayOrder(
        command=list(command),
        node="/talker",
        declaration=NamedComponentForm.of(component),
        topics=private_topics(component, "talker"),
        environment=environment or {},
    )
    made.write(folder / "relays" / "talker.json")
    return RelayOrder.read(folder / "relays" / "talker.json")


def in_a_process(folder: Path, body: str) -> subprocess.Popen[str]:
    """Run ``body``, which has the ``program`` of the order in ``folder``, in a process."""
    text = (
        "import os, signal, sys, threading\nfrom pathlib import Path\n"
        "from midstride.foreign.relayed_program import RelayedProgram, RelayOrder\n"
        f"program = RelayedProgram(RelayOrder.read(Path({str(folder / 'relays' / 'talker.json')!r})))\n"
        f"print(program.pid, flush=True)\n{body}\n"
    )
    return subprocess.Popen([sys.executable, "-c", text], stdout=subprocess.PIPE, text=True)


@pytest.mark.full
def test_the_program_ends_with_its_relay_however_that_ends(tmp_path: Path) -> None:
    order(tmp_path, "sleep", "300")
    with in_a_process(tmp_path, "signal.pause()") as relay:
        assert relay.stdout is not None
        pid = int(relay.stdout.readline())
        info = process_info(pid)
        assert info is not None and info.alive
        relay.kill()
    until(lambda: (left := process_info(pid)) is None or not left.alive, "the program lives on")


@pytest.mark.full
def test_the_relay_ends_as_its_program_does(tmp_path: Path) -> None:
    order(tmp_path, "sh", "-c", '[ -z "$HOME" ] && exit $STATUS', environment={"STATUS": "7", "HOME": None})
    body = "ended = threading.Event()\nprogram.watch(ended.set)\nended.wait()\nsys.exit(program.end())"
    with in_a_process(tmp_path, body) as relay:
        assert relay.wait(60) == 7


@pytest.mark.full
def test_a_program_that_ignores_that_it_is_to_end_is_killed(tmp_path: Path) -> None:
    ready = tmp_path / "ready"
    order(tmp_path, "sh", "-c", f"trap '' INT TERM; touch '{ready}'; while true; do sleep 0.1; done")
    body = f"while not Path({str(ready)!r}).exists():\n    threading.Event().wait(0.01)\nsys.exit(program.end())"
    with in_a_process(tmp_path, body) as relay:
        assert relay.stdout is not None
        pid = int(relay.stdout.readline())
        assert relay.wait(60) == KILLED
        left = process_info(pid)
        assert left is None or not left.alive


def test_a_program_that_cannot_be_started_is_named(tmp_path: Path) -> None:
    with pytest.raises(NodeError, match=r"cannot start `\./nothing`: No such file"):
        RelayedProgram(order(tmp_path, "./nothing"))


def test_the_variables_of_the_program() -> None:
    found = differing({"A": "1", "B": "2"}, {"A": "1", "B": "3", "C": "4"})
    assert found == {"B": "2", "C": None}


def test_a_reliable_output_may_wait_in_a_relay() -> None:
    """For 2 s at its rate; with best effort, as with 1 kHz for longer, messages are dropped as ever."""
    for declared, rate, depth in ((None, 50.0, 100), (200, 50.0, 200), (None, None, 10), (5, 9e9, 1000)):
        assert patient(QoS(depth=declared), rate).effective().depth == depth
    sensor, everything = QoS(reliability="best_effort", depth=5), QoS(history="keep_all")
    assert (patient(sensor, 50.0), patient(everything, 50.0)) == (sensor, everything)
