"""When another process may start, by how many are starting and what the machine has to spare."""

from __future__ import annotations

import asyncio
from typing import cast

import pytest

from midstride.backends.simulator.virtual_loop import run
from midstride.runtime.manager_clock import Clock
from midstride.runtime.process.pacing import INTERVAL, LOOK, MOST_EACH, PATIENCE, SPARE, room_for_a_start

PROCESSORS = 2


class Machine:
    """A clock of a machine of which that many processors are idle; ``starting``: how many processes are."""

    def __init__(self, idle: float, starting: int) -> None:
        self.idle_processors, self.starting = idle, starting

    def processors(self) -> int:
        return PROCESSORS

    def steady(self) -> float:
        return asyncio.get_running_loop().time()

    def idle(self) -> float:
        return self.idle_processors * self.steady()

    async def sleep(self, seconds: float) -> None:
        await asyncio.sleep(seconds)


async def waited(machine: Machine) -> float:
    """How long it takes until another may start (s)."""
    begun = machine.steady()
    await room_for_a_start(cast(Clock, machine), lambda: machine.starting)
    return machine.steady() - begun


@pytest.mark.parametrize("starting", range(PROCESSORS))
def test_one_for_each_processor_may_start_in_any_case(starting: int) -> None:
    async def main() -> None:
        assert await waited(Machine(0.0, starting)) == 0.0

    run(main())


@pytest.mark.parametrize("starting", [PROCESSORS, MOST_EACH * PROCESSORS - 1])
def test_where_processors_are_idle_more_may_start_one_after_another(starting: int) -> None:
    async def main() -> None:
        for idle in (1.01 * SPARE, PROCESSORS):
            assert await waited(Machine(idle, starting)) == pytest.approx(INTERVAL, abs=LOOK)

    run(main())


@pytest.mark.parametrize(("idle", "starting"), [(0.99 * SPARE, PROCESSORS), (PROCESSORS, MOST_EACH * PROCESSORS)])
def test_a_busy_machine_or_one_on_which_many_start_waits_until_one_has_registered(idle: float, starting: int) -> None:
    async def main() -> None:
        machine = Machine(idle, starting)
        asyncio.get_running_loop().call_later(2.0, lambda: setattr(machine, "starting", PROCESSORS - 1))
        assert await waited(machine) == pytest.approx(2.0, abs=2 * LOOK)

    run(main())


@pytest.mark.parametrize(("idle", "starting"), [(0.0, PROCESSORS), (PROCESSORS, MOST_EACH * PROCESSORS)])
def test_what_does_not_register_does_not_hold_up_what_it_may_wait_for(idle: float, starting: int) -> None:
    async def main() -> None:
        assert await waited(Machine(idle, starting)) == pytest.approx(PATIENCE, abs=INTERVAL + LOOK)

    run(main())
