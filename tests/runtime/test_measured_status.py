"""Declared against measured, in the status of a running system."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from midstride.backends.simulator import Simulator
from midstride.runtime.manager import Manager
from midstride.runtime.records.status_forms import PortStatus
from tests.runtime.systems import managed, replace, rewritten


async def measured(manager: Manager) -> dict[str, PortStatus]:
    """By port."""
    status = await manager.status()
    return {f"{each.name}.{port.name}": port for each in status.instances for port in each.ports if port.window}


def test_the_status_has_declared_and_measured_rates_of_every_port(tmp_path: Path) -> None:
    async def body(manager: Manager, _: Simulator) -> None:
        await asyncio.sleep(3.0)
        found = await measured(manager)
        assert set(found) == {"talker.out", "listener.in"}
        for each in found.values():
            assert (each.declared, each.met) == (10, True)
            assert each.rate == pytest.approx(10, rel=0.01)

    managed("talker", tmp_path, body)


def test_what_is_slower_than_declared_is_not_met(tmp_path: Path) -> None:
    """A talker that writes every fifth time; the system itself stays valid."""
    slow = rewritten(
        "talker", tmp_path / "slow", lambda name, text: text.replace("rate=10, ", "rate=2, guarantees={out: 10}, ")
    )

    async def body(manager: Manager, _: Simulator) -> None:
        await asyncio.sleep(6.0)
        found = await measured(manager)
        assert set(found) == {"talker.out", "listener.in"}
        for each in found.values():
            assert (each.declared, each.met) == (10, False)
            assert each.rate == pytest.approx(2, rel=0.01)

    managed("talker", tmp_path, body, directory=slow)


def test_a_hand_over_keeps_the_measured_rate_at_the_subscriber(tmp_path: Path) -> None:
    async def body(manager: Manager, _: Simulator) -> None:
        await asyncio.sleep(3.0)
        assert (await manager.change(replace("talker", "NewTalker"))).outcome == "done"
        found = await measured(manager)
        assert found["listener.in"].met is True
        assert found["talker_2.out"].declared == 10

    managed("talker", tmp_path, body)


def test_one_instance_of_a_role_shows_its_diagnostics(tmp_path: Path) -> None:
    """So a replacement changes neither the names that ROS's tools show, nor how often they appear."""

    async def body(manager: Manager, simulator: Simulator) -> None:
        await asyncio.sleep(3.0)
        names = {entry.name for entry in simulator.diagnostics("talker")}
        assert names == {"component", "out on /chatter"}
        assert (await manager.change(replace("talker", "NewTalker"))).outcome == "done"
        await asyncio.sleep(1.5)
        assert {entry.name for entry in simulator.diagnostics("talker_2")} == names

    managed("talker", tmp_path, body)
