"""A publisher that hangs in its code, and one that is stopped, are replaced on ROS 2; a bare recorder confirms it.

One that is stopped while it takes over costs a bounded time, and the old one goes on.
"""

from __future__ import annotations

import asyncio
import itertools
import os
import signal
import time
from dataclasses import replace
from pathlib import Path

import pytest

from midstride.model.specification import Specification
from midstride.plan.request import PlanRequest
from midstride.runtime.instance_life import STOPPED
from midstride.runtime.manager import Manager
from midstride.runtime.records.reports import Event, Outcome
from midstride.wire.replies import Receipt
from tests.acceptance.support import (
    BENCHMARKS,
    PERIOD,
    Recorder,
    components_looked_at,
    ended,
    managed,
    pids,
    swap_specification,
)
from tests.backends.ros2_support import publishers_are_told_apart, run, until_async

pytestmark = [pytest.mark.ros2, pytest.mark.full]
REPLACE = PlanRequest(replace=(("source", "OtherSource"),))
# How long the clean way is tried (s), and by how much two processes of a busy machine may differ (s).
WAIT = 2.0
APART = 0.5

# The source of the benchmark, which hangs once there is a file of that name.
_HANGING = """
import os
import time
from midstride import Component
from std_msgs.msg import String

comp = Component("source")
out = comp.create_output("out", String)
talk = comp.create_functionality("talk", outputs=[out])

def tick():
    out.write(String(data="tick"))
    if os.path.exists({file!r}):
        time.sleep(1000)
        out.write(String(data="late"))

talk.set_normal_mode(tick, rate=50, outputs=[out])
talk.set_degraded_mode(lambda: None)
comp.start()
"""


def hanging_specification(folder: Path, file: Path) -> Specification:
    script = folder / "hanging.py"
    script.write_text(_HANGING.format(file=str(file)))
    specification = swap_specification()
    source = replace(specification.components["Source"], run=f"python3 {script}")
    return replace(specification, components=specification.components.set("Source", source))


def compare(outcome: Outcome, rows: list[Receipt]) -> None:
    """The report's figures are those of a recorder outside; the old publisher is never heard after the new one."""
    [swap] = outcome.swaps
    silences = [(later.received - earlier.received, earlier, later) for earlier, later in itertools.pairwise(rows)]
    longest, last, first = max(silences, key=lambda silence: silence[0])
    assert swap.gap == pytest.approx(longest / 1e9, abs=APART)
    assert last.source is not None and first.source is not None
    empty = (first.source - last.source) / 1e9 / PERIOD - 1
    if swap.missed is not None or publishers_are_told_apart():
        assert swap.missed == pytest.approx(empty, abs=APART / PERIOD)
    if last.publisher is not None:
        cut = rows.index(first)
        assert {row.publisher for row in rows[:cut]}.isdisjoint({row.publisher for row in rows[cut:]})


async def hung(manager: Manager) -> bool:
    """Whether the source reports a call that has been under way for a while."""
    return ((await manager.peek("source")).functionalities["talk"].busy or 0.0) > 1.0


def test_a_publisher_that_hangs_in_its_code_is_replaced_and_the_report_is_true(tmp_path: Path) -> None:
    async def main() -> None:
        file = tmp_path / "hang"
        async with managed(tmp_path / "system", hanging_specification(tmp_path, file), BENCHMARKS) as (manager, _):
            recorder = Recorder(tmp_path)
            await asyncio.to_thread(recorder.wait_until_it_hears)
            file.touch()
            await until_async(lambda: hung(manager))
            outcome = await manager.change(REPLACE, wait=WAIT)
            assert outcome.outcome == "done", outcome.because
            [fenced] = outcome.fenced
            assert (fenced.instance, fenced.how) == ("source", "gate") and "user code did not return" in fenced.words
            assert outcome.unexpected_exits == [] and (await manager.status()).valid
            compare(outcome, recorder.stop())

    with ended():
        run(main())


def test_a_stopped_publisher_is_replaced_and_never_continues(tmp_path: Path) -> None:
    async def main() -> None:
        async with managed(tmp_path / "system", swap_specification()) as (manager, _):
            recorder = Recorder(tmp_path)
            await asyncio.to_thread(recorder.wait_until_it_hears)
            pid = (await manager.peek("source")).pid
            os.kill(pid, signal.SIGSTOP)
            outcome = await manager.change(REPLACE, wait=WAIT)
            assert outcome.outcome == "done", outcome.because
            assert [(fenced.instance, fenced.how) for fenced in outcome.fenced] == [("source", "killed")]
            with pytest.raises(ProcessLookupError):
                os.kill(pid, signal.SIGCONT)
            assert outcome.unexpected_exits == [] and (await manager.status()).valid
            compare(outcome, recorder.stop())

    with ended():
        run(main())


def test_a_new_publisher_that_is_stopped_costs_a_bounded_time_and_the_old_one_goes_on(tmp_path: Path) -> None:
    moments: dict[str, float] = {}
    rows: list[Receipt] = []

    async def main() -> None:
        async with managed(tmp_path / "system", swap_specification()) as (manager, _):
            recorder = Recorder(tmp_path)
            await asyncio.to_thread(recorder.wait_until_it_hears)

            def stop_the_new_one(event: Event) -> None:
                moments.setdefault(event.kind, time.monotonic())
                if event.kind == "step" and getattr(event.step, "action", None) == "handover":
                    moments["stopped"] = time.monotonic()
                    os.kill(pids(manager)["source_2"], signal.SIGSTOP)

            manager.events.listeners.append(stop_the_new_one)
            outcome = await manager.change(REPLACE, wait=WAIT)
            manager.events.listeners.remove(stop_the_new_one)
            assert outcome.outcome == "rolled_back", outcome.because
            assert outcome.because is not None and "source_2 did not answer" in outcome.because
            assert pids(manager).keys() == {"source", "sink"} and (await manager.status()).valid
            again = await manager.change(REPLACE, wait=WAIT)
            assert again.outcome == "done", again.because
            rows.extend(recorder.stop())

    with ended() as token, components_looked_at(token) as starved:
        run(main())
    times = sorted(row.received if row.source is None else row.source for row in rows)
    silences = [later - earlier for earlier, later in itertools.pairwise(times)]
    assert max(silences) / 1e9 < 10 * PERIOD + starved.longest, "the old one resumes within ten periods"
    late = APART + starved.longest
    assert moments["step_failed"] - moments["stopped"] < STOPPED + late
    assert moments["rolled_back"] - moments["step_failed"] < STOPPED + late
