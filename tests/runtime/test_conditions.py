"""Conditions: the last message alone decides whether what an input assumes holds, in virtual time."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import replace
from pathlib import Path

import pytest

from midstride.backends.simulator import Simulator
from midstride.lang import load_text
from midstride.plan.request import PlanRequest
from midstride.runtime.manager import Manager
from midstride.wire.state import FunctionalityState
from tests.runtime.systems import managed

# Writes what is in the file `depth` whenever that changes.
SONAR = """
from pathlib import Path
from midstride import Component, at_least, guarantee
from std_msgs.msg import Float64

comp = Component("sonar")
out = comp.create_output("out", Float64)
work = comp.create_functionality("work", outputs=[out])
file, last = Path({folder!r}) / "depth", None

def normal():
    global last
    depth = float(file.read_text()) if file.exists() else None
    if depth != last:
        last = depth
        out.write(Float64(data=depth))

work.set_normal_mode(normal, rate=100, outputs=[out], guarantees={{out: guarantee(where={{"data": at_least(3)}})}})
work.set_degraded_mode(lambda: None)
comp.start()
"""

DIVER = """
from midstride import Component, at_least
from std_msgs.msg import Float64

comp = Component("diver")
deep = comp.create_input("deep", Float64, where={"data": at_least(3)})
shallow = comp.create_input("shallow", Float64, where={"data": at_least(1)})
clock = comp.create_input("clock", Float64, rate=100, tolerates=49)
work = comp.create_functionality("work", inputs=[deep, shallow, clock])
nothing = lambda *message: None
work.set_normal_mode({deep: nothing}, inputs=[deep, clock])
work.set_mode("low", {shallow: nothing}, inputs=[shallow, clock])
work.set_degraded_mode(nothing)
comp.start()
"""

# Writes at 100 Hz, unless the file `stopped` exists.
CLOCK = """
from pathlib import Path
from midstride import Component
from std_msgs.msg import Float64

comp = Component("clock")
out = comp.create_output("out", Float64)
work = comp.create_functionality("work", outputs=[out])
stopped = Path({folder!r}) / "stopped"
work.set_normal_mode(lambda: None if stopped.exists() else out.write(Float64()), rate=100, outputs=[out])
work.set_degraded_mode(lambda: None)
comp.start()
"""

TEXT = """system sea

contract Deep    = std_msgs/msg/Float64 where data >= 3
contract Shallow = std_msgs/msg/Float64 where data >= 1
contract Ticks   = std_msgs/msg/Float64 @ 100 Hz

topic /depth : Deep
topic /ticks : Ticks

component Sonar {
  run "python3 sonar.py"
  output out
  functionality work { produces out   mode normal { guarantee out : Deep }   mode degraded { } }
}
component Clock {
  run "python3 clock.py"
  output out
  functionality work { produces out   mode normal { guarantee out : Ticks }   mode degraded { } }
}
component Diver {
  run "python3 diver.py"
  input deep    : Deep condition
  input shallow : Shallow condition
  input clock   : Ticks tolerates 49 missed
  functionality work {
    uses deep, shallow, clock
    mode normal { assume deep   assume clock }
    mode low { assume shallow   assume clock }
    mode degraded { }
  }
}

node sonar : Sonar { out -> /depth }
node clock : Clock { out -> /ticks }
node diver : Diver { deep <- /depth   shallow <- /depth   clock <- /ticks }
"""


class Sea:
    def __init__(self, manager: Manager, simulator: Simulator, folder: Path) -> None:
        self.manager = manager
        self.simulator = simulator
        self.folder = folder

    @property
    def diver(self) -> FunctionalityState:
        state = self.simulator.state("diver")
        assert state is not None
        return state.functionalities["work"]

    def depth(self, metres: float) -> None:
        (self.folder / "depth").write_text(str(metres))

    async def seconds_until(self, mode: str, at_most: float = 60.0) -> float:
        began = self.simulator.clock.steady()
        while self.diver.mode != mode:
            assert self.simulator.clock.steady() - began < at_most, f"{self.diver.mode}: {self.diver.because}"
            await asyncio.sleep(0.001)
        return self.simulator.clock.steady() - began


def at_sea(folder: Path, body: Callable[[Sea], Awaitable[None]], conditions: bool = True) -> None:
    programs = folder / "programs"
    programs.mkdir()
    for name, text in (("sonar", SONAR), ("clock", CLOCK)):
        (programs / f"{name}.py").write_text(text.format(folder=str(programs)))
    (programs / "diver.py").write_text(DIVER)
    system = load_text(TEXT).require()
    if not conditions:
        diver = replace(system.components["Diver"], conditions=frozenset())
        system = replace(system, components=system.components.set("Diver", diver))

    async def main(manager: Manager, simulator: Simulator) -> None:
        await asyncio.sleep(2.0)
        await body(Sea(manager, simulator, programs))

    managed("sea", folder, main, specification=system, directory=programs)


# A message every 10 ms at most, two messages of the network, and the time in which it reaches all inputs.
AT_ONCE = 0.03


def test_a_message_lowers_at_once_and_another_one_raises_at_once_each_time(tmp_path: Path) -> None:
    async def body(sea: Sea) -> None:
        assert sea.diver.mode == "normal"  # nothing is concluded before the first message
        for _ in range(3):  # more often than the attempts to restore what a fault has degraded
            for metres, mode in ((2.0, "low"), (0.5, "degraded"), (2.5, "low"), (4.0, "normal"), (0.0, "degraded")):
                sea.depth(metres)
                assert await sea.seconds_until(mode) < AT_ONCE
                await asyncio.sleep(0.2)
                assert sea.diver.mode == mode and sea.diver.conditional is (mode != "normal")
                assert (await sea.manager.status()).valid
        sea.depth(3.0)
        assert await sea.seconds_until("normal") < AT_ONCE
        words = [event.words for event in sea.manager.log()]
        assert "what diver.work relies on is back: it is restored (a condition)" in words
        sea.depth(2.0)
        await sea.seconds_until("low")
        reason = "condition deep does not hold on /depth: data is 2.0, data >= 3 is assumed"
        assert sea.diver.because == f"the assumption of mode normal broke: {reason}"

    at_sea(tmp_path, body)


@pytest.mark.full
def test_without_the_word_nothing_is_watched_as_before(tmp_path: Path) -> None:
    async def body(sea: Sea) -> None:
        sea.depth(0.5)
        await asyncio.sleep(5.0)
        assert sea.diver.mode == "normal"

    at_sea(tmp_path, body, conditions=False)


@pytest.mark.full
def test_a_command_that_raises_against_a_condition_does_not_last(tmp_path: Path) -> None:
    async def body(sea: Sea) -> None:
        sea.depth(2.0)
        await sea.seconds_until("low")
        await sea.manager.change(PlanRequest(to=sea.manager.specification))
        await sea.seconds_until("low", at_most=0.2)
        sea.depth(3.0)
        assert await sea.seconds_until("normal") < AT_ONCE

    at_sea(tmp_path, body)


@pytest.mark.full
@pytest.mark.parametrize("first", ["condition", "silence"])
def test_what_a_fault_has_degraded_waits_as_ever_although_a_condition_has_turned(tmp_path: Path, first: str) -> None:
    """The clock falls silent, and the water gets shallow, in either order; then both are as they were."""

    async def body(sea: Sea) -> None:
        if first == "condition":
            sea.depth(2.0)
            await sea.seconds_until("low")
        (sea.folder / "stopped").touch()
        await sea.seconds_until("degraded")
        assert sea.diver.reflex and not sea.diver.conditional
        sea.depth(2.0 if first == "silence" else 4.0)
        await asyncio.sleep(1.0)
        sea.depth(4.0)
        (sea.folder / "stopped").unlink()
        assert await sea.seconds_until("normal") >= 1.9  # the rate of a whole window, and the first delay

    at_sea(tmp_path, body)
