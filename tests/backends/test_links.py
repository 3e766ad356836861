"""The lines between simulated hosts: what is sent while one is cut arrives when it is back."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from functools import partial
from typing import Any

import pytest

from midstride.backends.simulator import Simulator
from midstride.errors import CallTimeout
from tests.conformance import puppets
from tests.conformance.lab import Lab


def between_hosts(tmp_path: Any, main: Callable[[Lab, Simulator], Awaitable[None]]) -> None:
    simulator = Simulator()

    async def opened() -> None:
        async with Lab(simulator, tmp_path) as lab:
            for name in ("here", "there"):
                await lab.start(name, puppets.talker())
                simulator.processes[name].on = name
            await main(lab, simulator)

    simulator.run(opened())


async def met(lab: Lab, seconds: float = 1.0) -> None:
    await lab.change("here", "meet", peer="there", address=lab.backend.transport.address("there"), timeout=seconds)


@pytest.mark.parametrize(("sender", "receiver"), [("here", "there"), ("there", "here")])
def test_a_line_that_is_cut_one_way_holds_what_is_sent(sender: str, receiver: str, tmp_path: Any) -> None:
    async def main(lab: Lab, simulator: Simulator) -> None:
        await met(lab)
        begun = simulator.time.steady()
        simulator.control.links.cut(sender, receiver, 0.3)
        await met(lab)
        assert 0.3 <= simulator.time.steady() - begun < 0.4

    between_hosts(tmp_path, main)


def test_no_connection_is_opened_on_a_line_that_is_cut(tmp_path: Any) -> None:
    async def main(lab: Lab, simulator: Simulator) -> None:
        simulator.control.links.cut("there", "here", 30.0)
        with pytest.raises(CallTimeout, match="the line to there is cut"):
            await simulator.control.connect("memory:there", simulator.processes["here"])
        await lab.read("there", "ping")  # the manager's line is another one
        simulator.control.links.clear()
        await met(lab)

    between_hosts(tmp_path, main)


def test_what_is_held_arrives_once_as_soon_as_every_line_is_back(tmp_path: Any) -> None:
    async def main(lab: Lab, simulator: Simulator) -> None:
        arrived: list[int] = []
        links = simulator.control.links
        links.cut("here", "there", 30.0)
        for number in range(3):
            links.deliver("here", "there", 0.001, partial(arrived.append, number))
        await asyncio.sleep(1.0)
        assert arrived == []
        links.clear()
        await asyncio.sleep(0.01)
        assert sorted(arrived) == [0, 1, 2]
        await asyncio.sleep(60.0)
        assert len(arrived) == 3

    between_hosts(tmp_path, main)
