"""State moves between the old one's last write and the new one's first: a bare reader has every number exactly once."""

from __future__ import annotations

import asyncio
import random
from pathlib import Path

import pytest

from midstride.backends.simulator import Simulator
from midstride.runtime.manager import Manager
from tests.runtime.counting import (
    BETWEEN_PEERS,
    EXPORT,
    IMPORT,
    Reader,
    at_rates,
    counting,
    exchanged,
    for_messages,
    listening,
    second_source,
    settle,
    system,
)


@pytest.mark.parametrize("seed", [0, 1, *(pytest.param(seed, marks=pytest.mark.full) for seed in range(2, 8))])
@pytest.mark.parametrize("rate", [50, 200])
def test_every_number_of_a_counter_is_written_once(rate: float, seed: int, tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: Simulator) -> None:
        phases = random.Random(seed)
        reader = Reader(simulator, "/out")
        for _ in range(10):
            await settle(phases.uniform(0.1, 0.2))
            outcome = await exchanged(manager)
            assert (outcome.outcome, outcome.because) == ("done", None)
            assert [(swap.missed, swap.lost, swap.duplicates) for swap in outcome.swaps] == [(0, 0, 0)]
            assert outcome.late == {}
        await settle()
        reader.assert_exactly_once()
        assert reader.changes == 10
        assert reader.longest_gap() < 2 / rate

    counting(system(tmp_path, at_rates(out=rate), out=rate), body, Simulator(seed=seed, latency=0.0003, jitter=0.0003))


@pytest.mark.parametrize("seed", [0, 1, *(pytest.param(seed, marks=pytest.mark.full) for seed in range(2, 8))])
@pytest.mark.parametrize("pause", [None, 0.001])
def test_every_message_is_counted_once(pause: float | None, seed: int, tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: Simulator) -> None:
        phases = random.Random(seed)
        reader = Reader(simulator, "/out")
        for _ in range(10):
            await settle(phases.uniform(0.1, 0.2))
            outcome = await exchanged(manager)
            assert (outcome.outcome, outcome.because) == ("done", None)
        await settle()
        reader.assert_exactly_once()
        ticks = [int(word.split()[2]) for word in reader.words]
        assert ticks == list(range(ticks[0], ticks[0] + len(ticks)))
        assert reader.changes == 10
        assert reader.longest_gap() < 0.03, "with one publisher, the first newer message shows that all older have come"

    counting(
        system(tmp_path, for_messages(200, pause=pause), source=200),
        body,
        Simulator(seed=seed, latency=0.0003, jitter=0.0003),
    )


@pytest.mark.parametrize(("slow", "gap"), [(4, 0.35), (0.3, 4.4)])
def test_a_component_with_two_grids_moves_its_one_state_once(slow: float, gap: float, tmp_path: Path) -> None:
    """After the last of its cuts: neither number is missing or doubled, and the slower slot waits for a short time.

    Between the cuts there may be more time than the state may take.
    """
    fast = 50 if slow > 1 else 0.4

    async def body(manager: Manager, simulator: Simulator) -> None:
        out, log = Reader(simulator, "/out"), Reader(simulator, "/log")
        for _ in range(5):
            await settle(0.37)
            outcome = await exchanged(manager)
            assert (outcome.outcome, outcome.because, outcome.late) == ("done", None, {})
        await settle(2 / slow)
        for reader in (out, log):
            reader.assert_exactly_once()
            assert reader.changes == 5
        assert out.longest_gap() < 2 / fast and log.longest_gap() < gap + 2 / fast

    counting(system(tmp_path, at_rates(out=fast, log=slow), out=fast, log=slow), body)


@pytest.mark.parametrize("messages", [False, pytest.param(True, marks=pytest.mark.full)])
def test_reports_between_the_two_that_are_lost_cost_no_number(messages: bool, tmp_path: Path) -> None:
    """The old one sees, when it would resume, that the new one has written; else it would write the same numbers."""

    async def body(manager: Manager, simulator: Simulator) -> None:
        reader = Reader(simulator, "/out")
        await settle()
        simulator.faults.fail_next("counter", "taken", "lost_request", 1000)
        outcome = await exchanged(manager)
        assert (outcome.outcome, outcome.because) == ("done", None)
        await settle()
        reader.assert_exactly_once()
        assert reader.changes == 1

    folder = system(tmp_path, for_messages(200), source=200) if messages else system(tmp_path, at_rates(out=50), out=50)
    counting(folder, body)


_RAISES = "raise ValueError('lost')"


@pytest.mark.parametrize("messages", [False, True])
@pytest.mark.parametrize(("hook", "parts"), [("export", (_RAISES, IMPORT)), ("import", (EXPORT, _RAISES))])
def test_where_a_hook_raises_the_old_one_goes_on_as_if_nothing_had_happened(
    hook: str, parts: tuple[str, str], messages: bool, tmp_path: Path
) -> None:
    """The call that it held back at the cut is made: no number is missing, not even a slot."""

    async def body(manager: Manager, simulator: Simulator) -> None:
        reader = Reader(simulator, "/out")
        await settle()
        outcome = await exchanged(manager)
        assert outcome.outcome == "rolled_back"
        assert f"on_{hook}_state raised: ValueError: lost" in str(outcome.because)
        await settle()
        reader.assert_exactly_once()
        assert reader.changes == 0 and reader.longest_gap() < 0.04
        if messages:
            ticks = [int(word.split()[2]) for word in reader.words]
            assert ticks == list(range(ticks[0], ticks[0] + len(ticks)))

    if messages:
        folder = system(tmp_path, for_messages(50, *parts), source=50)
    else:
        folder = system(tmp_path, at_rates(*parts, out=50), out=50)
    counting(folder, body)


@pytest.mark.parametrize("messages", [False, True])
def test_a_state_that_takes_longer_than_a_period_delays_the_first_slot_and_loses_nothing(
    messages: bool, tmp_path: Path
) -> None:
    """The old one waits, though it is silent for longer than it would be without the reports of the import."""

    async def body(manager: Manager, simulator: Simulator) -> None:
        reader = Reader(simulator, "/out")
        await settle()
        outcome = await exchanged(manager)
        assert (outcome.outcome, outcome.because) == ("done", None)
        await settle()
        reader.assert_exactly_once()
        assert 0.4 < reader.longest_gap() < 0.45
        if messages:
            assert reader.numbers == [int(word.split()[2]) - 1 for word in reader.words]
        else:
            [(name, late)] = outcome.late.items()
            assert name == "counter_2" and 0.4 < late < 0.43
            assert "wrote its first slot 40" in " ".join(event.words for event in manager.log())

    slow = f"time.sleep(0.4); {IMPORT}"
    folder = (
        system(tmp_path, for_messages(50, import_=slow), source=50)
        if messages
        else system(tmp_path, at_rates(import_=slow, out=50), out=50)
    )
    counting(folder, body)


@pytest.mark.parametrize(
    ("export", "import_"), [(EXPORT, f"time.sleep(9); {IMPORT}"), (f"time.sleep(9); {EXPORT}", IMPORT)]
)
def test_a_state_that_takes_too_long_is_given_up(export: str, import_: str, tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: Simulator) -> None:
        reader = Reader(simulator, "/out")
        await settle()
        outcome = await exchanged(manager)
        assert outcome.outcome == "rolled_back"
        assert "the state took longer than 2 s" in str(outcome.because)
        await settle(10)
        reader.assert_exactly_once()
        assert reader.changes == 0
        # An export holds up the old one itself.
        assert reader.longest_gap() < (2.1 if export == EXPORT else 9.1)

    counting(system(tmp_path, at_rates(export, import_, out=50), out=50), body)


_LARGE = """
seen = {}
changed = [0]

@comp.on_export_changes
def export_changes():
    return json.dumps({"count": count, "seen": list(seen.items())[changed[0]:]}).encode()

@comp.on_import_changes
def import_changes(changes):
    changes = json.loads(changes)
    count.update(changes["count"])
    seen.update(changes["seen"])
"""


def test_of_a_large_state_only_the_changes_move_at_the_cut(tmp_path: Path) -> None:
    """The bulk takes 25 periods at either side, and the slot of the cut is not late. Every entry arrives."""
    export = "changed[0] = len(seen); return json.dumps(list(seen.items())).encode()"
    import_ = "time.sleep(0.5); seen.update(json.loads(state))"
    more = _LARGE + "comp.large = seen\n"

    async def body(manager: Manager, simulator: Simulator) -> None:
        reader = Reader(simulator, "/out")
        for _ in range(3):
            await settle(0.31)
            outcome = await exchanged(manager)
            assert (outcome.outcome, outcome.because, outcome.late) == ("done", None, {})
        await settle()
        reader.assert_exactly_once()
        assert reader.changes == 3 and reader.longest_gap() < 0.04
        entries = [int(word.split()[2]) for word in reader.words]
        assert entries == reader.numbers, "what the bulk and the changes bring is what was there"

    # Each call adds one entry, and writes how many there are.
    program = at_rates(export, import_, more, out=50).replace(
        'output.write(String(data=f"{count[name]} {comp.instance}"))',
        'seen[str(count[name])] = 1; output.write(String(data=f"{count[name]} {comp.instance} {len(seen)}"))',
    )
    counting(system(tmp_path, program, out=50), body)


async def rolled_back_at_the_removal(manager: Manager, simulator: Simulator) -> Reader:
    """An exchange whose hand-over succeeds, and whose old component then cannot be removed."""
    reader = Reader(simulator, "/out")
    await settle()
    simulator.faults.fail_next("counter", "export_state", "refused")
    outcome = await exchanged(manager)
    assert outcome.outcome == "rolled_back"
    await settle()
    return reader


def test_a_roll_back_after_the_hand_over_brings_the_state_back(tmp_path: Path) -> None:
    """The old one cannot be removed, so it gets the topic again, and continues where the new one was."""

    async def body(manager: Manager, simulator: Simulator) -> None:
        reader = await rolled_back_at_the_removal(manager, simulator)
        reader.assert_exactly_once()
        assert reader.changes == 2

    counting(system(tmp_path, at_rates(out=50), out=50), body)


def test_a_roll_back_goes_on_where_the_state_cannot_come_back(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: Simulator) -> None:
        reader = await rolled_back_at_the_removal(manager, simulator)
        notes = [event.words for event in manager.log() if "keeps its own state" in event.words]
        assert len(notes) == 1 and "counter keeps its own state" in notes[0] and "ValueError: lost" in notes[0]
        assert reader.changes == 2 and reader.longest_gap() < 0.05

    new = at_rates(export=_RAISES, out=50)
    counting(system(tmp_path, at_rates(out=50), new, out=50), body)


@pytest.mark.parametrize("transit", [0.0, 0.04])
def test_what_another_functionality_has_counted_moves_as_well(transit: float, tmp_path: Path) -> None:
    """A component that counts messages in one functionality, and writes at a rate how many there were in another.

    Some are in transit at T, and are not waited for: they arrive after the export, and the new one counts them.
    """
    more = """
inlet = comp.create_input("in", String, qos=200)
def hear(message):
    count["log"] = count["log"] + 1
    count["last"] = int(message.data)
    count.setdefault("first", count["last"])
hearing = comp.create_functionality("hear", inputs=[inlet])
hearing.set_normal_mode(hear, inputs=[inlet])
hearing.set_degraded_mode(lambda: None)
"""
    program = at_rates(more=more, out=50).replace(
        "{comp.instance}", "{comp.instance} {count['log']} {count.get('last', 0) - count.get('first', 0) + 1}"
    )
    folder = system(tmp_path, program, out=50)
    listening(folder, rate=97)

    async def body(manager: Manager, simulator: Simulator) -> None:
        simulator.faults.delay("/ticks", transit)
        reader = Reader(simulator, "/out")
        for _ in range(5):
            await settle(0.23)
            outcome = await exchanged(manager)
            assert (outcome.outcome, outcome.because) == ("done", None)
        await settle()
        reader.assert_exactly_once()
        assert [swap.missed for swap in outcome.swaps] == [0]
        counted, numbered = (int(word) for word in reader.words[-1].split()[2:])
        assert counted == numbered > 100, "a message was counted twice, or not at all"

    counting(folder, body)


def test_a_component_is_live_on_one_side_only(tmp_path: Path) -> None:
    """For every number, exactly one of the two components has acted."""
    program = at_rates(out=50).replace(
        "        output.write(",
        f"""        if comp.is_live:
            with open({str(tmp_path / "acts")!r}, "a") as acts:
                acts.write(f"{{count[name]}}\\n")
        output.write(""",
    )
    folder = system(tmp_path, program, out=50)

    async def body(manager: Manager, simulator: Simulator) -> None:
        reader = Reader(simulator, "/out")
        for _ in range(4):
            await settle(0.21)
            assert (await exchanged(manager)).outcome == "done"
        await settle()
        acts = [int(line) for line in (folder / "acts").read_text().split()]
        assert acts == list(range(1, acts[-1] + 1))
        assert {*reader.numbers} <= {*acts}

    counting(folder, body)


def test_with_two_publishers_older_messages_are_waited_for(tmp_path: Path) -> None:
    """A newer message of one says nothing about those of the other, which take 40 ms to arrive."""
    folder = system(tmp_path, for_messages(100), source=100)
    second_source(folder, rate=50)

    async def body(manager: Manager, simulator: Simulator) -> None:
        simulator.faults.delay("/slow", 0.04)
        await settle(0.5)
        reader = Reader(simulator, "/out")
        await settle(0.2)
        for _ in range(3):
            await settle(0.23)
            outcome = await exchanged(manager)
            assert (outcome.outcome, outcome.because) == ("done", None)
        await settle()
        reader.assert_exactly_once()
        assert reader.changes == 3
        words = [word.split()[2] for word in reader.words]
        for first in ("", "s"):
            ticks = [int(word.removeprefix("s")) for word in words if word.startswith("s") == bool(first)]
            assert ticks == list(range(ticks[0], ticks[0] + len(ticks)))

    counting(folder, body)


# -- death at every moment -------------------------------------------------------------------------

# A hand-over whose import takes two and a half periods, so that there are moments between its parts.
_SLOW = f"time.sleep(0.05); {IMPORT}"
# What follows T within this time (s): export, import, first write, and the end of the cut on both sides.
_AFTER = 0.12
# How long the topic may be silent: ten periods, after the last report of an import that has taken so long.
_SILENT = 0.2 + 0.05 + 0.03


class Dying(Simulator):
    """So many seconds after `cut_out` is sent, ``victims`` die: components, or the manager, which is then mute."""

    def __init__(self, victims: tuple[str, ...], delay: float) -> None:
        super().__init__()
        self.victims, self.delay = victims, delay
        self.mute = False
        self.begun = False
        self.control.before_request = self.before

    async def before(self, instance: str, op: str) -> None:
        if op == "cut_out" and not self.begun:  # 1 ms before the new side is sent it
            self.begun = True
            self.time.loop.call_later(self.delay, self._die)
        if self.mute and op not in BETWEEN_PEERS:
            await self.clock.sleep(20)

    def _die(self) -> None:
        self.mute = "manager" in self.victims
        for victim in self.victims:
            if victim in self.processes:
                self.faults.kill(victim)


def _moments() -> list[float]:
    """From the agreement on, until after the cut: T is 0.1 to 0.12 s ahead, and every part takes a few milliseconds."""
    return [0.0, 0.002, 0.05, *(0.09 + 0.008 * step for step in range(int(_AFTER / 0.008)))]


@pytest.mark.parametrize("messages", [False, pytest.param(True, marks=pytest.mark.full)])
@pytest.mark.parametrize(
    "victims",
    [
        ("counter",),
        ("counter_2",),
        *(pytest.param(those, marks=pytest.mark.full) for those in (("manager",), ("counter", "manager"))),
        ("counter_2", "manager"),
    ],
)
def test_whatever_dies_at_whichever_moment_no_number_is_missing_or_doubled(
    victims: tuple[str, ...], messages: bool, tmp_path: Path
) -> None:
    """Of what survives: a new one that has written may die, and then the numbers are those of the old one again."""
    ends: set[str] = set()
    for moment in _moments():
        folder = tmp_path / f"{moment:.3f}"
        folder.mkdir()
        if messages:
            system(folder, for_messages(50, import_=_SLOW), source=50)
        else:
            system(folder, at_rates(import_=_SLOW, out=50), out=50)
        ends.add(_dies(folder, victims, moment))
    expected = {
        ("counter",): {"continued", "continued without the state"},
        ("counter", "manager"): {"continued", "continued without the state", "silent"},
        ("counter_2",): {"the old one goes on", "dead after it had taken over"},
        ("counter_2", "manager"): {"the old one goes on", "dead after it had taken over"},
        ("manager",): {"the old one goes on", "continued"},
    }
    assert ends == expected[victims], "the moments do not cover what may happen"


def _dies(folder: Path, victims: tuple[str, ...], moment: float) -> str:
    """How it ended."""

    async def body(manager: Manager, simulator: Simulator) -> str:
        assert isinstance(simulator, Dying)
        reader = Reader(simulator, "/out")
        await settle()
        change = asyncio.ensure_future(exchanged(manager))
        await settle(3.0)
        notes = [event.words for event in manager.log() if "keeps its own state" in event.words]
        reader.stop()
        simulator.mute = False
        await asyncio.wait({change}, timeout=60)
        change.cancel()
        return judged(reader, notes, (moment, reader.words[-250:]))

    def judged(reader: Reader, notes: list[str], words: object) -> str:
        sides = [word.split()[1] for word in reader.words]
        handed = sides.index("counter_2") if "counter_2" in sides else len(sides)
        before, after = reader.numbers[:handed], reader.numbers[handed:]
        assert before == list(range(before[0], before[0] + len(before))), words
        if handed == len(sides) and "counter" in victims:
            assert "manager" in victims, words  # before the new one was sent the cut
            return "silent"
        if handed == len(sides):
            assert reader.longest_gap() < _SILENT, (reader.longest_gap(), words)
            return "the old one goes on"
        continued = after[: sides[handed:].index("counter")] if "counter" in sides[handed:] else after
        assert continued == list(range(continued[0], continued[0] + len(continued))), words
        if "counter_2" in victims:
            assert continued[0] == before[-1] + 1, words
            return "dead after it had taken over"
        assert reader.longest_gap() < _SILENT, (reader.longest_gap(), words)
        assert reader.changes == 1, words
        if continued[0] == before[-1] + 1:
            assert notes == [], words
            return "continued"
        assert "counter" in victims, words
        assert notes or "manager" in victims, words
        return "continued without the state"

    return counting(folder, body, Dying(victims, moment))


class Freezing(Dying):
    """They are stopped for 0.6 s instead, which is longer than the old side waits without a sign of the new one."""

    def _die(self) -> None:
        for victim in self.victims:
            if victim in self.processes:
                self.faults.freeze(victim, 0.6)


@pytest.mark.parametrize("victim", ["counter", "counter_2"])
def test_where_a_side_is_stopped_for_a_while_no_number_is_missing_or_doubled(victim: str, tmp_path: Path) -> None:
    """One that continues after its peer has resumed learns that before it writes."""
    outcomes = set()
    for moment in _moments():
        folder = tmp_path / f"{moment:.3f}"
        folder.mkdir()
        system(folder, at_rates(import_=_SLOW, out=50), out=50)

        async def body(manager: Manager, simulator: Simulator, moment: float = moment) -> str:
            reader = Reader(simulator, "/out")
            await settle()
            outcome = await exchanged(manager)
            await settle()
            numbers = reader.numbers
            assert sorted(numbers) == list(range(min(numbers), max(numbers) + 1)), (moment, reader.words)
            return outcome.outcome

        outcomes.add(counting(folder, body, Freezing((victim,), moment)))
    assert outcomes == ({"done", "rolled_back"} if victim == "counter_2" else {"done"})
