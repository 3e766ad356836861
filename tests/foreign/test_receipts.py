"""What a node has received, as the library notes it, in plain processes: beside what the node itself makes of each."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import pytest

from midstride.errors import CommandRefused
from midstride.foreign import receipts
from midstride.foreign.gates import Gates
from midstride.foreign.receipts import ReceiptNotes
from midstride.wire import commands, replies
from tests.foreign.lab import MS, until
from tests.foreign.test_answers import AnsweringLab

READ = commands.RecordsCommand(input="in")


@pytest.fixture
def lab(tmp_path: Path, programs: Path, gate_library: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[AnsweringLab]:
    monkeypatch.setenv("FAKE_INPUT_NS", str(MS))
    made = AnsweringLab(tmp_path, programs, gate_library)
    yield made
    made.close()


def notes(gates: Gates, *, simulated: bool = False) -> ReceiptNotes:
    return ReceiptNotes(gates, simulated, asyncio.sleep)


def switched(made: ReceiptNotes, *, on: bool) -> int:
    return asyncio.run(made.switch(commands.RecordCommand(inputs=["in"], on=on))).now


def read(made: ReceiptNotes) -> replies.Records:
    return asyncio.run(made.read(READ))


def received(gates: Gates, number: int) -> None:
    entry = gates.entry("in")
    before = entry.passed
    until(lambda: entry.passed >= before + number, "it receives nothing")


def test_each_message_is_noted_with_its_number_and_writer(lab: AnsweringLab) -> None:
    gates = lab.first()
    made = notes(gates)
    for _ in range(2):  # the second change uses the same file
        begun = switched(made, on=True)
        received(gates, 50)
        found = read(made)
        switched(made, on=False)
        rows = found.rows
        assert len(rows) >= 50 and found.publisher_identity and found.moments is None
        assert {row.publisher for row in rows} == {b"a writer of them".hex()}
        assert {row.source for row in rows} == {None}, "this middleware does not say it"
        numbers = [row.number for row in rows]
        assert all(later == (earlier or 0) + 1 for earlier, later in pairwise(numbers) if later is not None)
        times = [row.received for row in rows]
        assert times == sorted(times) and begun - 10**9 < times[0] and times[-1] <= found.now <= time.monotonic_ns()
        answered = {number for _, number, _ in lab.records()}
        assert set(numbers[:-1]) <= answered, "what the node has made of them"
        with pytest.raises(CommandRefused, match="in is not recorded"):
            read(made)
        noted = made.noted("in")
        received(gates, 20)
        assert made.noted("in") <= noted + 1, "no longer"


def test_what_is_not_known_is_refused(lab: AnsweringLab, monkeypatch: pytest.MonkeyPatch) -> None:
    gates = lab.first()
    with pytest.raises(CommandRefused, match="not known on the ROS clock"):
        switched(notes(gates, simulated=True), on=True)
    made = notes(gates)
    switched(made, on=True)
    received(gates, 5)
    gates.entry("in").gated += 1000  # as where a program takes many messages in one call
    with pytest.raises(CommandRefused, match="not all that in has received was noted"):
        read(made)
    switched(made, on=True)
    received(gates, 5)
    monkeypatch.setattr(receipts, "RECEIPTS", 4)
    with pytest.raises(CommandRefused, match="more than 4 messages"):
        read(made)
    silent = Gates(lab.page, lab.page.allocate("silent"), gates.component)
    silent.prepare({"out": "/chat", "in": "/numbers"})
    with pytest.raises(CommandRefused, match="in has received nothing yet that the library sees"):
        switched(notes(silent), on=True)
    assert list(gates.page.path.parent.glob("*.receipts.*"))
    gates.page.free(gates.index)
    assert not list(gates.page.path.parent.glob("*.receipts.*")), "its files are removed with its part of the page"


def test_what_is_taken_behind_a_closed_gate_is_received_all_the_same(lab: AnsweringLab) -> None:
    gates = lab.first()
    made = notes(gates)
    switched(made, on=True)
    gates.set_gate("in", False)
    entry = gates.entry("in")
    before = entry.gated
    until(lambda: entry.gated >= before + 20, "it is not taken")
    found = read(made)
    assert len(found.rows) >= 20
