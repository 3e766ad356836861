"""The judgement of benchmarks/swap.py on constructed recordings: what was missed and doubled is known."""

from __future__ import annotations

import random
from collections.abc import Iterable

import pytest

from benchmarks._judging import judged
from midstride.runtime.records.measure import Observation, SwapReport
from midstride.wire.replies import Receipt

PERIOD = 0.02
STEP = 20_000_000
SENT = 300_000  # a message travels so long (ns)
OLD, NEW = "old", "new"


def talk(name: str, slots: Iterable[float], number: int = 1, jitter: float = 0.0, seed: int = 0) -> list[Receipt]:
    """One message in each slot, ``jitter`` periods too early or too late."""
    chance = random.Random(f"{name} {seed}")
    sources = [round((slot + 100 + chance.uniform(-jitter, jitter)) * STEP) for slot in slots]
    return [Receipt(source + SENT, source, number + at, name) for at, source in enumerate(sources)]


def seen(rows: list[Receipt], begun: float = 28, ended: float = 59.5) -> SwapReport:
    at = [round((each + 100) * STEP) for each in (begun, ended)]
    return judged(Observation("/swap", "recorder", rows, at[0], at[1], PERIOD, PERIOD))


@pytest.mark.parametrize("phase", [0.0, 0.05, 0.25, 0.5, 0.75, 0.8])
@pytest.mark.parametrize("seed", range(5))
def test_a_hand_over_to_another_phase_misses_nothing(phase: float, seed: int) -> None:
    rows = talk(OLD, range(30), jitter=0.04, seed=seed) + talk(NEW, (phase + n for n in range(30, 60)), jitter=0.04)
    assert (seen(rows).missed, seen(rows).duplicates, seen(rows).lost) == (0, 0, 0)


@pytest.mark.parametrize("phase", [0.1, 0.5, 0.85])
def test_nor_does_one_in_which_the_new_talker_comes_in_the_same_period(phase: float) -> None:
    rows = talk(OLD, range(30)) + talk(NEW, (phase + n for n in range(29, 60)))
    assert (seen(rows).missed, seen(rows).duplicates) == (0, 0)


@pytest.mark.parametrize("seed", range(5))
def test_a_dropped_message_is_missed(seed: int) -> None:
    rows = talk(OLD, range(30), jitter=0.04, seed=seed) + talk(NEW, range(31, 60), jitter=0.04)
    assert (seen(rows).missed, seen(rows).duplicates) == (1, 0)


@pytest.mark.parametrize(("first", "missed"), [(30.85, 0), (30.95, 1), (31.0, 1), (31.5, 1), (32.0, 2), (40.3, 10)])
def test_silence_at_the_hand_over_is_missed_by_whole_periods(first: float, missed: int) -> None:
    rows = talk(OLD, range(30)) + talk(NEW, (first + n for n in range(25)))
    assert seen(rows, ended=first + 24.5).missed == missed


@pytest.mark.parametrize(("phase", "doubled"), [(-0.5, 1), (-1.5, 2), (0.5, 0)])
def test_what_the_old_talker_writes_beside_the_new_one_is_doubled(phase: float, doubled: int) -> None:
    rows = talk(OLD, range(30)) + talk(NEW, (29 + phase + n for n in range(32)))
    assert (seen(rows).missed, seen(rows).duplicates) == (0, doubled)


def test_a_message_that_comes_twice_is_doubled() -> None:
    rows = talk(OLD, range(30)) + talk(NEW, range(30, 60))
    again = rows[35]
    rows.insert(36, Receipt(again.received + 1000, again.source, again.number, again.publisher))
    assert (seen(rows).missed, seen(rows).duplicates) == (0, 1)


def test_what_one_talker_leaves_out_is_missed_even_if_the_next_one_is_early() -> None:
    slots = [*range(20), 21, *range(22, 30)]
    rows = talk(OLD, slots, jitter=0.3) + talk(NEW, range(30, 60))
    assert seen(rows).missed == 1


def test_a_late_message_is_not_missed() -> None:
    slots = [*range(20), 20.9, *range(21, 30)]
    assert seen(talk(OLD, slots) + talk(NEW, range(30, 60))).missed == 0


def test_a_written_message_that_does_not_arrive_is_lost_and_not_missed() -> None:
    rows = talk(OLD, range(30)) + talk(NEW, range(30, 60))
    del rows[20]
    assert (seen(rows).missed, seen(rows).lost, seen(rows).duplicates) == (0, 1, 0)


def test_a_node_that_is_made_again_under_its_name_is_another_talker() -> None:
    rows = talk(OLD, range(30), number=101) + talk(OLD, (31.3 + n for n in range(29)))
    assert (seen(rows).missed, seen(rows).lost, seen(rows).duplicates) == (1, 0, 0)


def test_an_old_talker_that_goes_on_is_not_doubled_before_and_after_the_new_one() -> None:
    """The change was taken back."""
    rows = talk(OLD, range(30)) + talk(NEW, (30.5, 31.5)) + talk(OLD, range(32, 60), number=31)
    assert (seen(rows).missed, seen(rows).duplicates) == (0, 0)


def test_the_silence_at_the_end_is_missed() -> None:
    assert seen(talk(OLD, range(30)), ended=59.5).missed == 29
    assert seen([]).missed == 31


def test_nothing_is_said_of_talkers_that_are_not_known() -> None:
    rows = [Receipt(row.received, row.source, row.number, None) for row in talk(OLD, range(60))]
    assert (seen(rows).missed, seen(rows).duplicates) == (None, None)
