"""The figures of a swap, against recordings whose truth is planted."""

from __future__ import annotations

import random
from collections.abc import Callable

import pytest
from msgspec import structs

from midstride.codec.form import encode
from midstride.runtime.records.measure import Observation, SwapReport, _assign, _overlap, _phase, report
from midstride.wire.replies import Receipt

MS = 1_000_000
PERIOD = 20 * MS  # 50 Hz
SKEW = 7_000_000_000_000  # the steady clock of the subscriber against the source's clock


class Recorder:
    """A subscriber's recording, written slot by slot."""

    def __init__(self, seed: int = 0, jitter: int = 2 * MS) -> None:
        self.random = random.Random(seed)
        self.jitter = jitter
        self.rows: list[Receipt] = []
        self.numbers: dict[str, int] = {}

    def write(self, publisher: str, slot: float, *, received: bool = True, late: int = 0) -> None:
        self.numbers[publisher] = self.numbers.get(publisher, 0) + 1
        source = int(slot * PERIOD) + self.random.randrange(self.jitter) + late
        if received:
            at = source + SKEW + MS + self.random.randrange(MS)
            self.rows.append(Receipt(at, source, self.numbers[publisher], publisher))

    def observe(
        self,
        begun: float,
        ended: float,
        *,
        last: int | None = None,
        first: int | None = None,
        known: bool = True,
        resumed: bool = False,
        own_slots: bool = False,
        hung: bool = False,
    ) -> SwapReport:
        rows = self.rows if known else [structs.replace(row, publisher=None) for row in self.rows]
        return report(
            Observation(
                "/t",
                "sub.in",
                rows,
                begun=int(begun * PERIOD) + SKEW,
                ended=int(ended * PERIOD) + SKEW,
                guaranteed_period=0.02,
                grid_period=0.02,
                last_number=last,
                first_number=first,
                resumed=resumed,
                own_slots=own_slots,
                hung=hung,
            )
        )


def swap(recorder: Recorder, cut: int = 40, end: int = 80, old: int | None = None, new: int | None = None) -> None:
    """Old slots 0..cut-1 (or to ``old``), new from ``cut`` (or ``new``) to ``end``."""
    for slot in range(cut if old is None else old):
        recorder.write("old", slot)
    for slot in range(cut if new is None else new, end):
        recorder.write("new", slot)


@pytest.mark.parametrize("known", [True, False], ids=["identity", "numbering"])
def test_the_numbers_of_a_new_publisher_reach_those_of_one_that_hung(known: bool) -> None:
    """It wrote 40 messages, and has been fenced: the 41st is the new one's."""
    recorder = Recorder()
    swap(recorder, cut=40, new=200, end=300)
    seen = recorder.observe(60, 300, known=known, hung=True)
    assert (seen.missed, seen.lost, seen.duplicates) == (160, 0, 0)


@pytest.mark.parametrize("seed", range(20))
@pytest.mark.parametrize("known", [True, False], ids=["identity", "numbering"])
def test_an_agreed_cut_loses_nothing(seed: int, known: bool) -> None:
    recorder = Recorder(seed)
    swap(recorder)
    seen = recorder.observe(35, 80, last=40, known=known)
    assert (seen.missed, seen.lost, seen.duplicates) == (0, 0, 0)
    assert seen.gap_periods is not None and 1.0 <= seen.gap_periods < 1.3


@pytest.mark.parametrize("known", [True, False], ids=["identity", "numbering"])
def test_close_then_open_shows_as_missed(known: bool) -> None:
    recorder = Recorder()
    swap(recorder, old=40, new=43)
    seen = recorder.observe(35, 80, known=known)
    assert (seen.missed, seen.duplicates) == (3, 0)
    assert seen.gap_periods is not None and seen.gap_periods > 3.5


@pytest.mark.parametrize("known", [True, False], ids=["identity", "numbering"])
def test_open_then_close_shows_as_duplicates(known: bool) -> None:
    recorder = Recorder()
    for slot in range(80):
        if slot < 42:
            recorder.write("old", slot)
        if slot >= 40:
            recorder.write("new", slot)
    seen = recorder.observe(35, 80, known=known)
    assert (seen.missed, seen.duplicates) == (0, 2)


def test_a_program_with_its_own_slots_may_write_early_and_not_beside_the_old_one() -> None:
    early, beside = Recorder(), Recorder()
    for slot in range(80):
        (early.write("old", slot) if slot < 41 else early.write("new", slot - 0.6))
        if slot < 42:
            beside.write("old", slot)
        if slot >= 40:
            beside.write("new", slot - 0.4)
    assert early.observe(35, 78).duplicates == 1
    seen = early.observe(35, 78, own_slots=True)
    assert (seen.missed, seen.duplicates) == (0, 0)
    assert beside.observe(35, 78, own_slots=True).duplicates == 2


def test_a_stall_of_the_new_one_shows_as_missed() -> None:
    recorder = Recorder()
    swap(recorder, old=40, new=41)
    recorder.rows = [row for row in recorder.rows if not (41 * PERIOD < (row.source or 0) < 56 * PERIOD)]
    seen = recorder.observe(35, 80)
    assert seen.missed == 16  # slot 40, and 41 to 55


def test_a_topic_that_falls_silent_for_ever_is_a_gap_and_missed() -> None:
    recorder = Recorder()
    for slot in range(40):
        recorder.write("old", slot)
    seen = recorder.observe(35, 80)
    assert seen.missed is not None and 38 <= seen.missed <= 40
    assert seen.gap_periods is not None and seen.gap_periods > 39


def test_a_subscriber_that_hears_nothing_at_all_is_no_picture_of_health() -> None:
    seen = Recorder().observe(35, 80)
    assert (seen.gap, seen.missed, seen.lost) == (0.9, 45, None)


@pytest.mark.parametrize("known", [True, False], ids=["identity", "numbering"])
def test_a_publisher_replaced_right_after_its_start_is_known_by_its_first_message(known: bool) -> None:
    """The whole life of the old publisher is in the window."""
    recorder = Recorder()
    swap(recorder, cut=10, end=40)
    seen = recorder.observe(-1, 40, last=10, known=known)
    assert (seen.missed, seen.lost, seen.duplicates) == (0, 0, 0)


@pytest.mark.parametrize("own_slots", [False, True])
@pytest.mark.parametrize("again", ["old", "old, attached again"])
def test_after_a_roll_back_the_old_publisher_is_at_both_ends(again: str, own_slots: bool) -> None:
    """The new one wrote ten messages in between; only slot 60 is empty."""
    recorder = Recorder()
    for slot in range(100):
        if slot != 60:
            recorder.write("old" if slot < 40 else "new" if slot < 50 else again, slot)
    seen = recorder.observe(35, 100, resumed=True, own_slots=own_slots)
    assert (seen.missed, seen.lost, seen.duplicates) == (1, 0, 0)


def test_after_a_roll_back_messages_beside_a_program_with_its_own_slots_are_duplicates() -> None:
    recorder = Recorder()
    for slot in range(100):
        if not 42 <= slot < 50:
            recorder.write("old", slot)
        if 40 <= slot < 50:
            recorder.write("new", slot - 0.4)
    assert recorder.observe(35, 100, resumed=True, own_slots=True).duplicates == 2


def test_after_a_roll_back_a_bystander_is_not_taken_for_the_old_publisher() -> None:
    recorder = Recorder()
    for slot in range(100):
        recorder.write("new" if 40 <= slot < 50 else "old", slot)
        recorder.write("bystander", slot + 0.5)
    seen = recorder.observe(35, 100, resumed=True)
    assert (seen.missed, seen.duplicates) == (None, None)


def test_messages_nobody_received_are_lost() -> None:
    recorder = Recorder()
    for slot in range(40):
        recorder.write("old", slot, received=slot not in {30, 39})
    for slot in range(40, 80):
        recorder.write("new", slot, received=slot != 60)
    assert recorder.observe(35, 80, last=40).lost == 3


@pytest.mark.parametrize("known", [True, False], ids=["identity", "numbering"])
@pytest.mark.parametrize(("still", "lost"), [((33, 40), 7), ((35, 45), 10), ((40, 45), 5), ((42, 45), 3)])
def test_what_a_subscriber_that_stands_still_loses_is_lost_on_either_side_of_the_cut(
    still: tuple[int, int], lost: int, known: bool
) -> None:
    recorder = Recorder()
    recorder.numbers["old"] = 100  # it has been writing for longer than the new one does here
    for slot in range(80):
        recorder.write("old" if slot < 40 else "new", slot, received=not still[0] <= slot < still[1])
    seen = recorder.observe(32, 80, last=140, first=1, known=known)
    assert (seen.missed, seen.lost) == (lost, lost)
    after = max(0, still[1] - max(still[0], 40)) if still[0] <= 40 else 0
    assert recorder.observe(32, 80, last=140, known=known).lost == lost - after, "where nothing is reported"
    assert recorder.observe(32, 80, last=140, first=9, known=known).lost == lost - after, "it wrote its first later"


def test_the_first_message_is_that_of_the_only_publisher_that_has_appeared() -> None:
    recorder = Recorder()
    for slot in range(80):
        recorder.write("old" if slot < 40 else "new", slot, received=not 40 <= slot < 45)
        if slot > 60:
            recorder.write("bystander", slot + 0.5)
    assert recorder.observe(35, 80, last=40, first=1).lost == 0, "which of the two it is is not known"
    recorder.rows = [row for row in recorder.rows if row.publisher != "old"]
    assert recorder.observe(35, 80, first=1).lost == 0


def test_a_late_message_is_not_taken_for_two_faults() -> None:
    recorder = Recorder()
    for slot in range(40):
        recorder.write("old", slot, late=18 * MS if slot in (20, 39) else 0)
    for slot in range(40, 80):
        recorder.write("new", slot, late=17 * MS if slot == 55 else 0)
    seen = recorder.observe(35, 80)
    assert (seen.missed, seen.duplicates) == (0, 0)


@pytest.mark.parametrize("late", [(22,), (25, 21)], ids=["one", "two"])
def test_a_last_message_late_by_more_than_a_period_is_not_taken_for_two_faults(late: tuple[int, ...]) -> None:
    recorder = Recorder()
    for slot in range(40):
        recorder.write("old", slot, late=([0] * (40 - len(late)) + list(late))[slot] * MS)
    for slot in range(40, 80):
        recorder.write("new", slot)
    seen = recorder.observe(35, 80, last=40)
    assert (seen.missed, seen.lost, seen.duplicates) == (0, 0, 0)


def test_a_late_last_message_is_no_fault_either_where_the_old_one_was_heard_twice() -> None:
    recorder = Recorder()
    for slot in (38, 39):
        recorder.write("old", slot, late=22 * MS if slot == 39 else 0)
    for slot in range(40, 80):
        recorder.write("new", slot)
    seen = recorder.observe(35, 80, last=2)
    assert (seen.lost, seen.duplicates) == (0, 0)


def test_an_early_first_message_is_not_taken_for_two_faults() -> None:
    recorder = Recorder()
    for slot in range(40):
        recorder.write("old", slot)
    for slot in range(40, 80):
        recorder.write("new", slot, late=-9 * MS if slot == 40 else 0)
    seen = recorder.observe(35, 80, last=40)
    assert (seen.missed, seen.lost, seen.duplicates) == (0, 0, 0)


@pytest.mark.parametrize("phase", [0.1, 0.3, 0.5, 0.7, 0.74, 0.76, 0.9])
def test_a_new_grid_of_another_phase_is_counted_evenly(phase: float) -> None:
    recorder = Recorder()
    for slot in range(40):
        recorder.write("old", slot)
    for slot in range(50, 90):
        recorder.write("new", slot + phase)
    seen = recorder.observe(35, 90)
    assert seen.duplicates == 0
    assert seen.missed in (10, 11)


def test_a_bystander_on_the_topic_does_not_hide_a_miss() -> None:
    recorder = Recorder()
    for slot in range(80):
        recorder.write("bystander", slot + 0.5)
        if slot < 40:
            recorder.write("old", slot)
        elif slot >= 42:
            recorder.write("new", slot)
    seen = recorder.observe(35, 80)
    assert (seen.missed, seen.duplicates) == (2, 0)


@pytest.mark.parametrize(
    ("hide", "unknown"),
    [
        (lambda row: structs.replace(row, source=None), {"missed", "duplicates"}),
        (lambda row: structs.replace(row, number=None), {"lost"}),
        (lambda row: structs.replace(row, number=None, publisher=None), {"lost", "missed", "duplicates"}),
    ],
    ids=["no source time", "no number", "neither number nor identity"],
)
def test_what_the_middleware_cannot_tell_is_null_and_never_zero(
    hide: Callable[[Receipt], Receipt], unknown: set[str]
) -> None:
    recorder = Recorder()
    swap(recorder)
    recorder.rows = [hide(row) for row in recorder.rows]
    document = encode(recorder.observe(35, 80))
    figures = {"gap", "missed", "lost", "duplicates"}
    assert {name for name in figures if document[name] is None} == unknown


@pytest.mark.parametrize("by", [86400 * 365 * 50, 5, -5, -86400], ids="{} s".format)
def test_slots_mean_nothing_where_the_clock_of_the_publishers_was_set(by: int) -> None:
    """A robot that boots in 1970 and then reaches a time server: the years in between are not missed messages."""
    recorder = Recorder()
    for slot in range(80):
        recorder.write("old" if slot < 40 else "new", slot)
    recorder.rows[45:] = [structs.replace(row, source=(row.source or 0) + by * 10**9) for row in recorder.rows[45:]]
    seen = recorder.observe(35, 80, last=40)
    assert (seen.missed, seen.duplicates) == (None, None)
    assert seen.gap is not None and seen.gap < 0.025
    assert seen.lost == 0


@pytest.mark.parametrize(("spread", "set_"), [(80 * PERIOD, False), (80 * PERIOD + 1, True)])
def test_a_clock_was_set_if_no_message_can_have_been_under_way_for_so_long(spread: int, set_: bool) -> None:
    """Since the first was received: 80 periods, when the window ends."""
    rows = [Receipt(SKEW + number * 40 * PERIOD, number * 40 * PERIOD, number, "a") for number in range(2)]
    rows.append(Receipt(SKEW + 80 * PERIOD, 80 * PERIOD - spread, 2, "a"))
    seen = report(Observation("/t", "sub.in", rows, SKEW, SKEW + 80 * PERIOD, PERIOD / 1e9, PERIOD / 1e9))
    assert (seen.missed is None) == set_


def test_without_a_rate_there_is_no_gap_to_speak_of() -> None:
    recorder = Recorder()
    swap(recorder)
    seen = report(Observation("/t", "sub.in", recorder.rows, SKEW, SKEW + 80 * PERIOD, None))
    assert (seen.period, seen.gap, seen.gap_periods, seen.missed) == (None, None, None, None)
    assert seen.lost == 0


def test_only_the_window_counts() -> None:
    recorder = Recorder()
    for slot in range(120):
        if slot < 60:
            if slot != 10:  # long before the first step
                recorder.write("old", slot)
        elif slot < 110:
            recorder.write("new", slot)
    seen = recorder.observe(55, 105)
    assert (seen.missed, seen.lost) == (0, 0)


def answers(
    cut: int, *, lose: frozenset[int] = frozenset(), twice: frozenset[int] = frozenset(), late: int = 0
) -> SwapReport:
    """A filter at 200 Hz whose source skips slots of its own; ``cut`` is the first input that the new one answers."""
    chance = random.Random(3)
    inputs = [slot * 5 * MS for slot in range(200) if slot % 17]
    rows, numbers = [], {"old": 0, "new": 0}
    for index, source in enumerate(inputs):
        names = ["old"] if index < cut else ["new"]
        names = ["old", "new"] if index in twice else names
        for name in names:
            numbers[name] += 1
            if index in lose:
                continue
            written = source + chance.randrange(9 * MS)
            if late and index == cut - 1:
                written = source + late
            rows.append(Receipt(written + SKEW + MS, written, numbers[name], name))
    return report(
        Observation(
            "/t", "sink.in", rows, 60 * 5 * MS + SKEW, 200 * 5 * MS + SKEW, 0.005, None, None, inputs=inputs[40:]
        )
    )


def test_a_message_driven_output_is_held_to_the_inputs_it_had_to_answer() -> None:
    assert (answers(90).missed, answers(90).duplicates) == (0, 0)


@pytest.mark.parametrize("cut", range(80, 100))
def test_a_late_last_answer_of_the_old_one_is_not_taken_for_two_faults(cut: int) -> None:
    seen = answers(cut, late=9 * MS)
    assert (seen.missed, seen.duplicates) == (0, 0)
    seen = answers(cut, lose=frozenset({cut - 10}), twice=frozenset({cut}))
    assert (seen.missed or 0) >= 1 and (seen.duplicates or 0) >= 1, "what is no lateness is not explained away"


def test_an_input_that_nobody_answered_is_missed_and_one_answered_twice_is_a_duplicate() -> None:
    assert answers(90, lose=frozenset({89, 90, 91})).missed == 3
    assert answers(90, twice=frozenset({95})).duplicates == 1


def test_numberings_that_meet_are_told_apart_by_the_old_ones_last_number() -> None:
    recorder = Recorder()
    recorder.numbers["old"] = 5
    swap(recorder)  # old 6 to 45, new 1 to 40: extend the new one beyond the old one's last number
    for slot in range(80, 95):
        recorder.write("new", slot)
    known = recorder.observe(35, 95, last=45, known=False)
    assert (known.missed, known.lost, known.duplicates) == (0, 0, 0)
    unknown = recorder.observe(35, 95, known=False)
    assert unknown.lost is None and unknown.duplicates is None


@pytest.mark.parametrize("known", [True, False], ids=["identity", "numbering"])
def test_the_new_one_is_not_charged_with_what_an_old_one_wrote_that_was_silent_all_along(known: bool) -> None:
    """An old one that broke long before: its last number says nothing of what was received in the window."""
    recorder = Recorder()
    for slot in range(20, 60):
        recorder.write("new", slot)
    assert recorder.observe(10, 60, last=70, known=known).lost is None
    assert recorder.observe(10, 60, last=10, known=known).lost is None


# -- slots and phases, without a swap --------------------------------------------------------------------------


@pytest.mark.parametrize("late", [0.0, 0.3, 0.6])
def test_the_phase_of_a_publisher_is_at_the_early_end_of_its_jitter(late: float) -> None:
    """However late a message now and then is: less than half a period off, it would be in another slot."""
    rng = random.Random(1)
    sources = [round(slot * PERIOD) + rng.randrange(2 * MS) for slot in range(50)]
    sources[20] += round(late * PERIOD)
    for offset in (0, 3 * MS, 19 * MS):
        phase = _phase([source + offset for source in sources], PERIOD) - offset
        assert 0 <= phase % PERIOD < 2 * MS


@pytest.mark.parametrize(
    ("places", "slots"),
    [
        ([0.0, 1.0, 2.0, 3.0], [0, 1, 2, 3]),
        ([0.0, 1.0, 2.9, 3.0], [0, 1, 2, 3]),  # late, and followed by one on time
        ([0.0, 1.0, 2.0, 3.9, 4.0], [0, 1, 2, 3, 4]),
        ([0.0, 1.0, 3.9, 4.0], [0, 1, 3, 4]),  # one is missing before it
        ([0.0, 1.0, 2.8, 4.0], [0, 1, 2, 4]),  # after a hole: late for the slot before
        ([0.0, 1.0, 2.8, 3.9, 4.0, 5.0], [0, 1, 2, 3, 4, 5]),  # a burst
        ([0.0, 1.0, 3.0, 4.0], [0, 1, 3, 4]),  # one is missing
        ([0.0, 1.0, 3.8, 5.0, 6.0, 7.0], [0, 1, 4, 5, 6, 7]),  # two may be
    ],
)
def test_each_message_of_a_publisher_is_in_the_slot_that_it_was_due_in(places: list[float], slots: list[int]) -> None:
    on_time = [float(place) for place in range(-40, 0)]  # enough to tell the phase
    sources = [round(place * PERIOD) for place in [*on_time, *places]]
    for origin in (0.0, 0.2 * PERIOD, 100.0 * PERIOD):
        found = list(_assign(sources, origin, PERIOD))[len(on_time) :]
        shift = -round((origin - 0.2 * PERIOD) / PERIOD) if origin > PERIOD else 0
        assert found == [slot + shift for slot in slots], origin


@pytest.mark.parametrize(("resumed", "overlap"), [(False, 4), (True, 2)])
def test_what_the_first_publisher_has_published_after_the_other_one_had_begun_is_counted(
    resumed: bool, overlap: int
) -> None:
    """The other one publishes from 35 to 55; if the first one resumed, what comes after that is no duplicate."""

    def receipts(publisher: str, *sources: int) -> list[Receipt]:
        return [Receipt(source + SKEW, source, number, publisher) for number, source in enumerate(sources, start=1)]

    sides = [receipts("new", 35, 45, 55), receipts("old", 10, 20, 30, 40, 50, 60, 70)]
    assert _overlap(sides, resumed) == overlap
    assert _overlap(sides[1:], resumed) == 0
    by_first_message = [receipts("new", 35, 45), receipts("old", 10, 60)]
    assert _overlap(by_first_message, resumed) == (0 if resumed else 1)


def test_without_identities_and_with_a_number_missing_the_publishers_are_not_told_apart() -> None:
    recorder = Recorder()
    for slot in range(20):
        recorder.write("a", slot)
    recorder.rows[7] = structs.replace(recorder.rows[7], number=None)
    found = recorder.observe(5, 15, known=False)
    assert (found.lost, found.duplicates) == (None, None) and found.gap is not None


def test_an_answer_whose_time_of_publication_is_unknown_is_no_answer_to_any_input() -> None:
    inputs = [slot * PERIOD for slot in range(20)]
    rows = [Receipt(at + SKEW, None if at == inputs[9] else at + MS, 1 + at // PERIOD, "old") for at in inputs]
    seen = Observation("/t", "sink.in", rows, SKEW, inputs[-1] + SKEW, 0.02, None, None, inputs=inputs)
    assert report(seen).missed == 1
