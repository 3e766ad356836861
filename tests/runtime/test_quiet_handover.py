"""Hand-overs of outputs on which nothing is written, on the simulator: a node that is silent since nothing happens."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from immutables import Map

from midstride.backends.simulator import Simulator
from midstride.runtime.manager import Manager
from midstride.runtime.records.reports import Outcome
from tests.runtime.counting import Reader, at_rates, counting, exchanged, for_messages, settle, system

# When the source writes: not in the time of the replacement, and again from its 200th tick on, 20 s after its start.
PAUSES = '    if 20 < ticks[0] < 200:\n        return\n    out.write(String(data="" + str(ticks[0])))'
WRITES = '    out.write(String(data="" + str(ticks[0])))'
# A new version whose code hears its messages, and writes nothing.
DEAF = "return\n    pass"
LATCHED = """
from midstride import Component, QoS
from std_msgs.msg import String

comp = Component("counter")
out = comp.create_output("out", String, qos=QoS(durability="transient_local"))
latch = comp.create_functionality("count_out", outputs=[out])
latch.set_normal_mode(lambda: {write}, outputs=[out])
latch.set_degraded_mode(lambda: None)
comp.start()
"""
WRITES_ONCE = 'out.write(String(data=f"1 {comp.instance}"))'


def without_rates(document: Any) -> Any:
    """The same specification, in which nothing has a rate."""
    if isinstance(document, dict):
        return {key: without_rates(each) for key, each in document.items() if key != "rate"}
    return [without_rates(each) for each in document] if isinstance(document, list) else document


def change(folder: Path, edit: Callable[[Any], Any]) -> None:
    path = folder / "counting.json"
    path.write_text(json.dumps(edit(json.loads(path.read_text()))))


def pausing(folder: Path, new: str, *, rated: bool) -> Path:
    """A counter of messages that stay away from 2 s to 20 s after the start of their source."""
    system(folder, for_messages(10), new, source=10)
    source = (folder / "source.py").read_text()
    assert WRITES in source
    (folder / "source.py").write_text(source.replace(WRITES, PAUSES))
    if not rated:
        change(folder, without_rates)
    return folder


def replaced(folder: Path, after: float = 4.0, more: float = 0.0, **timing: float) -> tuple[Outcome, Reader, list[str]]:
    """The outcome of a replacement, what a reader heard from before it until ``more`` seconds after it, the notes."""

    async def body(manager: Manager, simulator: Simulator) -> tuple[Outcome, Reader, list[str]]:
        manager.system.specification = replace(manager.specification, timing=Map(timing))
        reader = Reader(simulator, "/out")
        await settle(after)
        outcome = await exchanged(manager)
        await settle(more)
        assert (await manager.status()).valid
        return outcome, reader, [event.words for event in manager.log() if event.kind == "note"]

    return counting(folder, body)


@pytest.mark.parametrize("rated", [False, True])
@pytest.mark.parametrize("timing", [{}, {"probation": 0.0}], ids=["by default", "without probation"])
def test_a_filter_without_input_is_replaced_and_goes_on_when_there_is_some(
    rated: bool, timing: dict[str, float], tmp_path: Path
) -> None:
    outcome, reader, notes = replaced(pausing(tmp_path, for_messages(10), rated=rated), more=20.0, **timing)
    assert (outcome.outcome, outcome.because) == ("done", None)
    assert outcome.seconds < 3
    assert "counter_2.out takes over from counter.out without a message: neither writes any" in notes
    reader.assert_exactly_once()  # the count has moved with the topic
    assert reader.changes == 1 and len(reader.numbers) > 20


def test_a_filter_without_input_is_not_handed_back_while_it_is_watched(tmp_path: Path) -> None:
    outcome, reader, _ = replaced(pausing(tmp_path, for_messages(10), rated=True), more=20.0, watch_after=4.0)
    assert (outcome.outcome, outcome.because) == ("done", None)
    assert outcome.seconds > 4
    reader.assert_exactly_once()
    assert reader.changes == 1


def test_a_new_one_that_writes_nothing_while_the_old_one_does_is_refused(tmp_path: Path) -> None:
    folder = system(tmp_path, for_messages(2), for_messages(2).replace("    pass\n", f"    {DEAF}\n"), source=2)
    change(folder, without_rates)
    outcome, reader, _ = replaced(folder)
    assert outcome.outcome == "rolled_back"
    assert "counter_2.out has written nothing within 5 s, so it cannot take over" in str(outcome.because)
    assert reader.words[-1].split()[1] == "counter"


def test_code_at_a_rate_that_has_nothing_to_write_is_replaced(tmp_path: Path) -> None:
    silent = at_rates(out=20).replace("        output.write", "        if count[name] > 1000: output.write")
    outcome, reader, _ = replaced(system(tmp_path, silent, out=20), more=60.0)
    assert (outcome.outcome, outcome.because) == ("done", None)
    reader.assert_exactly_once()
    assert {word.split()[1] for word in reader.words} == {"counter_2"}


@pytest.mark.parametrize(
    ("write", "timing", "taken", "heard"),
    [
        (WRITES_ONCE, {}, True, ["1 counter_2"]),
        ("None", {}, False, []),
        ("None", {"probation": 0.0}, True, []),
    ],
    ids=["writes too", "writes nothing", "without probation"],
)
def test_a_latched_message_is_not_lost_unless_that_is_asked_for(
    write: str, timing: dict[str, float], taken: bool, heard: list[str], tmp_path: Path
) -> None:
    folder = system(tmp_path, LATCHED.format(write=WRITES_ONCE), LATCHED.format(write=write), out=1)
    change(folder, without_rates)

    def latched(document: Any) -> Any:
        for component in "AB":
            modes = document["components"][component]["functionalities"]["count_out"]["modes"]
            modes["normal"]["guarantees"]["out"]["qos"] = {"durability": "transient_local"}
        document["topics"]["/out"]["qos"] = {"durability": "transient_local"}
        return document

    change(folder, latched)
    outcome, reader, notes = replaced(folder, more=1.0, **timing)
    assert outcome.outcome == ("done" if taken else "rolled_back"), outcome
    if not taken:
        assert "counter_2.out has written nothing within 5 s" in str(outcome.because)
        assert "subscribers that join later would not get the last message of counter.out" in str(outcome.because)
    assert reader.words == heard
    assert ("counter_2.out takes over from counter.out without a message: neither writes any" in notes) == (
        taken and write == "None"
    )
