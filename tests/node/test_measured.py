"""What components report of their attachments, script by script in the simulator."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import msgspec
import pytest

from midstride.backends.simulator.host import SimulatedHost
from midstride.wire.state import LinkState

from .author import Bench, simulate

TALKER = """
from midstride import Component, guarantee, at_least
from sensor_msgs.msg import Range

comp = Component("talker")
out = comp.create_output("out", Range)
talk = comp.create_functionality("talk", outputs=[out])
every, depth = comp.parameter("every", 1, on_change=int), comp.parameter("depth", 5.0, on_change=float)
wrong = comp.parameter("wrong", 0, on_change=int)
calls = 0

def normal():
    global calls
    calls += 1
    if calls % every.value == 0:
        out.write(Range(range=0.1 if wrong.value and calls % wrong.value == 0 else depth.value))

promised = {out: guarantee(where={"range": at_least(1.5)})}
talk.set_normal_mode(normal, rate=20, outputs=[out], guarantees=promised)
talk.set_mode("slow", normal, rate=5, outputs=[out])
talk.set_degraded_mode(lambda: None)
comp.start()
"""

LISTENER = """
from midstride import Component, at_least
from sensor_msgs.msg import Range

comp = Component("listener")
in_ = comp.create_input("in", Range, rate=10, where={"range": at_least(1.5)}, tolerates=200)
listen = comp.create_functionality("listen", inputs=[in_])
listen.set_normal_mode(lambda message: print(in_.measured["/depth"].rate), inputs=[in_])
listen.set_degraded_mode(lambda: None)
comp.start()
"""

# It tolerates ten missed messages.
WATCHFUL = LISTENER.replace("tolerates=200", "tolerates=10")


async def started(bench: Bench, listener: str = LISTENER) -> None:
    await bench.start("talker", TALKER)
    await bench.start("listener", listener)
    await bench.attach("listener", "in", "/depth")
    await bench.attach("talker", "out", "/depth")


async def link(bench: Bench, instance: str, port: str) -> LinkState:
    """What the component reports of its attachment to /depth now."""
    state = await bench.send(instance, "observe")
    return msgspec.convert(state["ports"][port]["/depth"], LinkState)


def test_both_ends_report_rate_age_and_jitter(tmp_path: Path) -> None:
    async def main(bench: Bench) -> None:
        await started(bench)
        await bench.mode("talker", "talk", "normal")
        await bench.mode("listener", "listen", "normal")
        await bench.sleep(2.0)
        for instance, port, declared in (("talker", "out", 20.0), ("listener", "in", 10.0)):
            found = await link(bench, instance, port)
            assert found.measured is not None
            assert found.measured.rate == pytest.approx(20, rel=0.01)
            assert found.measured.jitter == pytest.approx(0, abs=0.001)
            assert found.measured.age is not None and found.measured.age <= 0.051
            assert found.measured.meets(declared) is True
        assert float(bench.log("listener")[-1]) == pytest.approx(20, rel=0.01), "what the author's code reads"

    simulate(tmp_path, main)


def test_a_publisher_that_writes_every_fifth_message_misses_its_declared_rate_on_both_sides(tmp_path: Path) -> None:
    async def main(bench: Bench) -> None:
        await started(bench)
        await bench.mode("talker", "talk", "normal")
        await bench.sleep(2.0)
        await bench.send("talker", "set", parameters={"every": 5})
        await bench.sleep(1.5)
        for instance, port, declared in (("talker", "out", 20.0), ("listener", "in", 10.0)):
            found = (await link(bench, instance, port)).measured
            assert found is not None
            assert found.rate == pytest.approx(4, rel=0.01)
            assert found.longest == pytest.approx(0.25, rel=0.01)
            assert found.meets(declared) is False

    simulate(tmp_path, main)


@pytest.mark.parametrize("by", [30.0, -30.0])
def test_a_rate_is_watched_across_a_step_of_the_systems_clock(
    by: float, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    step, made = 0, SimulatedHost.__init__

    def with_a_clock_that_steps(host: SimulatedHost, *arguments: Any) -> None:
        made(host, *arguments)
        system = host.now
        host.now = lambda: system() + step

    monkeypatch.setattr(SimulatedHost, "__init__", with_a_clock_that_steps)

    async def main(bench: Bench) -> None:
        await started(bench)
        await bench.mode("talker", "talk", "normal")
        await bench.sleep(1.0)
        watch: dict[str, Any] = {"port": "out", "topic": "/depth", "rate": 20.0, "window": 1.0, "timeout": 3.0}
        watching = asyncio.ensure_future(bench.send("talker", "await_rate", until="broken", **watch))
        await bench.sleep(1.5)
        nonlocal step
        step = int(by * 1e9)
        assert not (await watching)["reached"]

    simulate(tmp_path, main)


def test_a_mode_that_guarantees_another_rate_is_measured_afresh(tmp_path: Path) -> None:
    async def main(bench: Bench) -> None:
        await started(bench)
        await bench.mode("talker", "talk", "normal")
        await bench.sleep(2.0)
        await bench.mode("talker", "talk", "slow")
        await bench.sleep(0.3)
        soon = await link(bench, "talker", "out")
        assert soon.measured is not None
        assert soon.measured.meets(5) is None
        assert soon.measured.covered < 0.6
        await bench.sleep(2.0)
        later = await link(bench, "talker", "out")
        assert later.measured is not None
        assert later.measured.rate == pytest.approx(5, rel=0.01)
        assert later.measured.meets(5) is True

    simulate(tmp_path, main)


def test_rates_are_on_the_ros_clock(tmp_path: Path) -> None:
    """Where a simulation runs at half the speed, 20 Hz are 20 messages in each of its seconds; paused, nothing ages."""

    async def main(bench: Bench) -> None:
        bench.simulator.time.drive(0.5)
        await started(bench)
        await bench.mode("talker", "talk", "normal")
        await bench.sleep(4.0)
        for instance, port in (("talker", "out"), ("listener", "in")):
            found = (await link(bench, instance, port)).measured
            assert found is not None
            assert found.rate == pytest.approx(20, rel=0.01)
        bench.simulator.time.drive(0.0)
        await bench.sleep(60.0)
        paused = (await link(bench, "listener", "in")).measured
        assert paused is not None
        assert paused.rate == pytest.approx(20, rel=0.01)
        bench.simulator.time.drive(1.0, at=bench.simulator.time.ros_now() - 3_000_000_000)
        await bench.sleep(3.0)
        again = (await link(bench, "listener", "in")).measured
        assert again is not None
        assert again.rate == pytest.approx(20, rel=0.01)

    simulate(tmp_path, main)


def test_field_constraints_are_sampled_at_both_ends(tmp_path: Path) -> None:
    async def main(bench: Bench) -> None:
        await started(bench)
        await bench.mode("talker", "talk", "normal")
        await bench.sleep(1.0)
        for instance, port in (("talker", "out"), ("listener", "in")):
            found = (await link(bench, instance, port)).fields["range"]
            assert found.checked > 10
            assert (found.constraint, found.violations, found.last) == (">= 1.5", 0, None)
        await bench.send("talker", "set", parameters={"depth": 0.5})
        await bench.sleep(1.0)
        for instance, port in (("talker", "out"), ("listener", "in")):
            found = (await link(bench, instance, port)).fields["range"]
            assert 15 <= found.violations == found.run < found.checked
            assert found.last == 0.5
        await bench.mode("talker", "talk", "slow")
        assert (await link(bench, "talker", "out")).fields == {}, "that mode guarantees nothing of the field"

    simulate(tmp_path, main)


def test_the_figures_come_with_the_reports_that_a_component_makes_anyway(tmp_path: Path) -> None:
    """Two a second, however many messages pass."""

    async def main(bench: Bench) -> None:
        await started(bench)
        await bench.mode("talker", "talk", "normal")
        await bench.sleep(1.0)
        before = bench.lab.reports
        await bench.sleep(10.0)
        assert bench.lab.reports - before == pytest.approx(2 * 2 * 10, abs=2)

    simulate(tmp_path, main)


def test_messages_that_violate_a_constraint_break_the_assumption_like_missing_ones(tmp_path: Path) -> None:
    """After the silence that is tolerated: eleven periods. A single one in ten does not."""

    async def main(bench: Bench) -> None:
        await started(bench, WATCHFUL)
        await bench.mode("talker", "talk", "normal")
        await bench.mode("listener", "listen", "normal")
        await bench.send("talker", "set", parameters={"wrong": 10})
        await bench.sleep(10.0)
        assert bench.state("listener").functionalities["listen"].mode == "normal"
        await bench.send("talker", "set", parameters={"wrong": 1})
        await bench.sleep(0.9)
        assert bench.state("listener").functionalities["listen"].mode == "normal"
        await bench.sleep(0.4)
        fallen = bench.state("listener").functionalities["listen"]
        assert fallen.mode == "degraded"
        assert "nothing that meets its constraints (range is 0.1, range >= 1.5 is assumed) on /depth" in fallen.because

    simulate(tmp_path, main)


def test_messages_that_never_met_a_constraint_break_nothing(tmp_path: Path) -> None:
    """As with a publisher that has never been heard: the reflex is for what was there, and is no more."""

    async def main(bench: Bench) -> None:
        await started(bench, WATCHFUL)
        await bench.send("talker", "set", parameters={"wrong": 1})
        await bench.mode("talker", "talk", "normal")
        await bench.mode("listener", "listen", "normal")
        await bench.sleep(5.0)
        assert bench.state("listener").functionalities["listen"].mode == "normal"

    simulate(tmp_path, main)
