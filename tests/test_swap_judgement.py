"""The judgement of benchmarks/swap on constructed recordings, of which it is known what was missed or doubled."""

from __future__ import annotations

import random
from collections.abc import Iterable

import pytest
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.swap.judging import Figures, Row, judged
from benchmarks.swap.programs.content import HEAD, counted, read

PERIOD = 0.02
STEP = 20_000_000
SENT = 300_000  # a message travels so long (ns)
OLD, NEW = "old", "new"


def talk(name: str, slots: Iterable[float], number: int = 1, jitter: float = 0.0, seed: int = 0) -> list[Row]:
    """One message in each slot, ``jitter`` periods too early or too late."""
    chance = random.Random(f"{name} {seed}")
    sources = [round((slot + 100 + chance.uniform(-jitter, jitter)) * STEP) for slot in slots]
    return [Row(source + SENT, source, number + at, name) for at, source in enumerate(sources)]


def seen(rows: list[Row], begun: float = 28, ended: float = 59.5) -> Figures:
    at = [round((each + 100) * STEP) for each in (begun, ended)]
    return judged(rows, at[0], at[1], PERIOD)


def counts(found: Figures) -> tuple[int, int, int, int, int]:
    return found.missed, found.lost, found.twice, found.overlapping, found.reordered


@pytest.mark.parametrize("phase", [0.0, 0.05, 0.25, 0.5, 0.75, 0.8])
@pytest.mark.parametrize("seed", range(5))
def test_a_hand_over_to_another_phase_misses_nothing(phase: float, seed: int) -> None:
    rows = talk(OLD, range(30), jitter=0.04, seed=seed) + talk(NEW, (phase + n for n in range(30, 60)), jitter=0.04)
    assert counts(seen(rows)) == (0, 0, 0, 0, 0)


@pytest.mark.parametrize("phase", [0.1, 0.5, 0.85])
def test_nor_does_one_in_which_the_new_talker_comes_in_the_same_period(phase: float) -> None:
    rows = talk(OLD, range(30)) + talk(NEW, (phase + n for n in range(29, 60)))
    assert counts(seen(rows)) == (0, 0, 0, 0, 0)


@pytest.mark.parametrize("seed", range(5))
def test_a_dropped_message_is_missed(seed: int) -> None:
    rows = talk(OLD, range(30), jitter=0.04, seed=seed) + talk(NEW, range(31, 60), jitter=0.04)
    assert counts(seen(rows)) == (1, 0, 0, 0, 0)


@pytest.mark.parametrize(("first", "missed"), [(30.85, 0), (30.95, 1), (31.0, 1), (31.5, 1), (32.0, 2), (40.3, 10)])
def test_silence_at_the_hand_over_is_missed_by_whole_periods(first: float, missed: int) -> None:
    rows = talk(OLD, range(30)) + talk(NEW, (first + n for n in range(25)))
    found = seen(rows, ended=first + 24.5)
    assert found.missed == missed
    assert found.gap == pytest.approx((first - 29) * PERIOD)


@pytest.mark.parametrize(("phase", "doubled"), [(-0.5, 1), (-1.5, 2), (0.5, 0)])
def test_what_the_old_talker_writes_beside_the_new_one_overlaps(phase: float, doubled: int) -> None:
    rows = talk(OLD, range(30)) + talk(NEW, (29 + phase + n for n in range(32)))
    assert counts(seen(rows)) == (0, 0, 0, doubled, 0)


def test_two_messages_that_are_made_at_once_do_not_overlap_where_the_old_one_comes_first() -> None:
    """The new talker has made its message before the old one made its last, and was let through after it."""
    rows = talk(OLD, range(31)) + talk(NEW, (29.9 + n for n in range(31)))
    assert seen(rows).overlapping == 1
    rows[31] = rows[31]._replace(received=rows[30].received + 1000)
    assert seen(rows).overlapping == 0


def test_a_message_that_comes_twice_is_counted_once_more_and_is_not_late() -> None:
    rows = talk(OLD, range(30)) + talk(NEW, range(30, 60))
    rows.append(rows[35]._replace(received=rows[38].received + 1000))
    assert counts(seen(rows)) == (0, 0, 1, 0, 0)


def test_a_message_that_comes_after_a_later_one_is_reordered() -> None:
    rows = talk(OLD, range(30)) + talk(NEW, range(30, 60))
    rows[35] = rows[35]._replace(received=rows[37].received + 1000)
    assert counts(seen(rows)) == (0, 0, 0, 0, 1)


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
    assert counts(seen(rows)) == (0, 1, 0, 0, 0)


def test_an_old_talker_that_goes_on_does_not_overlap_before_and_after_the_new_one() -> None:
    """The change was taken back."""
    rows = talk(OLD, range(30)) + talk(NEW, (30.5, 31.5)) + talk(OLD, range(32, 60), number=31)
    assert counts(seen(rows)) == (0, 0, 0, 0, 0)


def test_the_silence_at_the_end_is_missed() -> None:
    assert seen(talk(OLD, range(30)), ended=59.5).missed == 29
    nothing = seen([])
    assert nothing.missed == 31 and nothing.gap == pytest.approx(31.5 * PERIOD)


def test_what_is_outside_the_window_counts_nothing() -> None:
    inside = talk(OLD, range(8, 30)) + talk(NEW, range(30, 60))
    outside = talk(OLD, [0, 0, 5], number=-9) + talk("third", [62, 61.9, 62])
    assert seen(inside + outside) == seen(inside)


def obvious(rows: list[Row]) -> tuple[int, int, int, int]:
    """Lost, twice, overlapping and reordered, each by looking at all pairs of rows."""
    heard = [(row.talker, row.number) for row in rows]
    lost = 0
    for talker in {row.talker for row in rows}:
        own = [row.number for row in rows if row.talker == talker]
        lost += sum((talker, number) not in heard for number in range(min(own), max(own)))
    firsts = [row for at, row in enumerate(rows) if heard[at] not in heard[:at]]
    reordered = sum(
        any(before.talker == row.talker and before.number > row.number for before in firsts[:at])
        for at, row in enumerate(firsts)
    )
    old = min(firsts, key=lambda row: row.sent).talker
    overlapping = sum(
        row.talker == old
        and any(each.talker != old and each.sent < row.sent and each.received < row.received for each in firsts)
        and any(each.talker != old and each.sent > row.sent for each in firsts)
        for row in firsts
    )
    return lost, len(rows) - len(firsts), overlapping, reordered


@given(st.lists(st.tuples(st.sampled_from((OLD, NEW, "third")), st.integers(1, 8)), min_size=1, max_size=14))
def test_the_counts_are_those_that_are_obvious(drawn: list[tuple[str, int]]) -> None:
    """In the order in which they are drawn they are received; a talker writes its numbers in their order."""
    offset = {OLD: 0, NEW: 3, "third": 5}
    rows = [
        Row(40 * STEP + at, (30 + offset[name] + number) * STEP + offset[name], number, name)
        for at, (name, number) in enumerate(drawn)
    ]
    found = judged(rows, 35 * STEP, 60 * STEP, PERIOD)
    assert (found.lost, found.twice, found.overlapping, found.reordered) == obvious(rows)


@pytest.mark.parametrize("size", [1, 100, 10_000])
def test_a_message_says_who_wrote_it_and_has_its_size(size: int) -> None:
    following = counted("talker", size)
    texts = [following(), following()]
    found = [read(text.encode()[:HEAD]) for text in texts]
    assert [number for _, number, _ in found] == [1, 2]
    assert found[0][2] == found[1][2] != read(counted("talker", size)().encode())[2]
    assert found[0][0] <= found[1][0]
    assert all(len(text) == max(size, len(text.rstrip("x"))) for text in texts)
