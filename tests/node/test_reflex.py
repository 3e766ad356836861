"""The local reflex without a manager: what breaks an assumption, and what must not (docs/protocols/reflex.md)."""

from __future__ import annotations

import re
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import pytest

from midstride.node.control.shortfall import FLOOR, LONG_FLOOR, SHARE, SLOW, Shortfall, Stopwatch, tolerated_periods

from .author import Bench, simulate

# How long after a silence may no longer be tolerated the mode has changed, at the latest (s).
SLACK = 0.25

# At call n it sleeps for `pause(n)` s and then writes `count(n)` messages.
SPEAKER = """
import time
from midstride import Component
from std_msgs.msg import String

comp = Component("speaker")
out = comp.create_output("out", String)
talk = comp.create_functionality("talk", outputs=[out])
calls = 0

def normal():
    global calls
    calls += 1
    time.sleep(pause(calls))
    for _ in range(count(calls)):
        out.write(String(data=str(calls)))

pause, count = lambda n: {pause}, lambda n: {count}
talk.set_normal_mode(normal, rate={rate}, outputs=[out])
talk.set_degraded_mode(lambda: None)
comp.start()
"""

LISTENER = """
import time
from midstride import Component, any_of
from std_msgs.msg import String

comp = Component("listener")
inlet = comp.create_input("in", String{arguments})
hear = comp.create_functionality("hear", inputs=[inlet])
hear.set_normal_mode(lambda message: None, inputs=[inlet])
hear.set_degraded_mode(lambda: None)
{more}
comp.start()
"""


@dataclass
class Pair:
    """A speaker at 50 Hz and a listener, both in their normal modes."""

    bench: Bench

    def mode(self, functionality: str = "hear", instance: str = "listener") -> str:
        return self.bench.state(instance).functionalities[functionality].mode

    def because(self, functionality: str = "hear", instance: str = "listener") -> str:
        return self.bench.state(instance).functionalities[functionality].because

    async def falls_within(self, least: float, most: float) -> None:
        """The listener stays in its normal mode for ``least`` seconds from now on, and leaves it by ``most``."""
        await self.bench.sleep(least)
        assert self.mode() == "normal", self.because()
        await self.bench.sleep(most - least)
        assert self.mode() == "degraded"

    async def never_falls(self, seconds: float) -> None:
        """Not once: nothing restores a mode here."""
        await self.bench.sleep(seconds)
        assert self.mode() == "normal", self.because()


def pair(
    folder: Path,
    body: Callable[[Pair], Awaitable[None]],
    *,
    rate: float = 50,
    pause: str = "0",
    count: str = "1",
    arguments: str = ", rate=50, tolerates=49",  # a silence of 1 s
    more: str = "",
) -> None:
    async def main(bench: Bench) -> None:
        await bench.start("speaker", SPEAKER.format(rate=rate, pause=pause, count=count))
        await bench.start("listener", LISTENER.format(arguments=arguments, more=more))
        await bench.attach("listener", "in", "/chatter")
        await bench.attach("speaker", "out", "/chatter")
        await bench.mode("speaker", "talk", "normal")
        await bench.mode("listener", "hear", "normal")
        await body(Pair(bench))

    simulate(folder, main)


# -- the rule ----------------------------------------------------------------------------------------------


def test_silence_is_tolerated_for_the_stated_number_of_messages_or_the_floor() -> None:
    assert tolerated_periods(50, None, FLOOR) == FLOOR * 50
    assert tolerated_periods(2, None, FLOOR) == 11  # 5.5 s
    assert tolerated_periods(50, 3, 0.0) == 4


@pytest.mark.parametrize(("share", "breaks"), [(1.0, False), (0.6, False), (0.4, False), (0.3, True), (0.2, True)])
def test_a_stream_that_keeps_its_share_never_breaks(share: float, breaks: bool) -> None:
    stream, count = Shortfall(0), 0.0
    for _ in range(10_000):
        count += share
        stream.advance(1.0, int(count))
    assert stream.exceeds(11) is breaks


def test_what_has_come_too_much_is_not_saved_up() -> None:
    stream = Shortfall(0)
    stream.advance(1.0, 1000)
    for _ in range(11):
        stream.advance(1.0, 1000)
    assert not stream.exceeds(11)
    stream.advance(1.0, 1000)
    assert stream.exceeds(11)


def test_half_of_what_is_lacking_is_forgiven_where_the_stream_is_not_all_to_blame() -> None:
    silent, slow = Shortfall(0), Shortfall(0)
    silent.advance(8.0, 0)
    silent.halve()
    assert silent.exceeds(3.99, slow=False) and not silent.exceeds(4.01, slow=False)
    slow.advance(32.0, 1)
    lacking = (SHARE * 32 - 1) / 2
    slow.halve()
    assert slow.exceeds(0.99 * lacking / (SLOW * SHARE)) and not slow.exceeds(1.01 * lacking / (SLOW * SHARE))


class StopwatchHost:
    """Two clocks that the test sets (s)."""

    def __init__(self, *, simulated: bool) -> None:
        self.simulated_time, self.at, self.ros = simulated, 100.0, 1000.0

    def steady(self) -> int:
        return round(self.at * 1e9)

    def now(self) -> int:
        return round(self.ros * 1e9)


@pytest.mark.parametrize("simulated", [True, False])
def test_a_lap_lasts_on_the_ros_clock_and_never_longer_than_the_process_has_run(simulated: bool) -> None:
    host = StopwatchHost(simulated=simulated)
    watch = Stopwatch(cast(Any, host))

    def lap(gone: float, moved: float) -> float:
        host.at += gone
        host.ros += moved
        return round(watch.lap(0.1), 6)

    assert lap(0.1, 0.05) == (0.05 if simulated else 0.1)
    assert lap(0.1, 0.0) == (0.0 if simulated else 0.1), "/clock stands still"
    assert lap(0.1, -500.0) == (0.0 if simulated else 0.1), "it is set back"
    assert watch.grace == 0.0
    assert lap(3.0, 3.0) == pytest.approx(0.45 if simulated else 0.2, abs=0.06), "the process was stopped"
    assert watch.grace == LONG_FLOOR
    assert lap(0.1, 0.0) == (0.0 if simulated else 0.1)
    assert watch.grace == pytest.approx(LONG_FLOOR - 0.1)


# -- what breaks an assumption -----------------------------------------------------------------------------


def test_a_publisher_that_falls_silent_is_noticed_after_the_floor(tmp_path: Path) -> None:
    """The speaker's last message is that of 3 s after its start; then its calls return without a write."""

    async def body(pair: Pair) -> None:
        await pair.bench.sleep(3.0 - 0.004)
        await pair.falls_within(FLOOR - 0.02, FLOOR + SLACK)
        assert pair.because().startswith(
            "the assumption of mode normal broke: input in received nothing on /chatter for 1."
        )
        assert pair.because().endswith(" s (50 Hz is assumed; silence is tolerated for 1 s)")
        assert pair.mode("talk", "speaker") == "normal", "a call that returns is no hang"
        [line] = [line for line in pair.bench.simulator.log("listener").splitlines() if line.startswith("[ERROR]")]
        assert "hear is in mode degraded: the assumption of mode normal broke: input in" in line

    pair(tmp_path, body, count="n <= 150")


def test_a_publisher_that_writes_every_fifth_message_is_noticed(tmp_path: Path) -> None:
    async def body(pair: Pair) -> None:
        await pair.bench.sleep(3.0)
        await pair.falls_within(3.7 * FLOOR, 4.3 * FLOOR)
        assert re.search(r"received \d+ messages on /chatter for [34].\d+ s", pair.because())

    pair(tmp_path, body, count="n <= 150 or n % 5 == 0")


def test_a_publisher_whose_process_is_gone_is_noticed_and_named(tmp_path: Path) -> None:
    async def body(pair: Pair) -> None:
        await pair.bench.sleep(1.0)
        pair.bench.simulator.faults.kill("speaker")
        await pair.falls_within(FLOOR - 0.03, FLOOR + SLACK)
        assert " s, and its publisher is gone (50 Hz" in pair.because()

    pair(tmp_path, body)


def test_a_stated_tolerance_replaces_the_floor(tmp_path: Path) -> None:
    """Three missed messages: the fourth is due 80 ms after the last one that came."""

    async def body(pair: Pair) -> None:
        await pair.bench.sleep(3.0 - 0.004)
        await pair.falls_within(0.07, 0.12)

    pair(tmp_path, body, count="n <= 150", arguments=", rate=50, tolerates=3")


def test_the_tolerance_of_the_manager_precedes_that_of_the_code(tmp_path: Path) -> None:
    async def main(bench: Bench) -> None:
        await bench.start("speaker", SPEAKER.format(rate=50, pause="0", count="n <= 150"))
        await bench.start("listener", LISTENER.format(arguments="", more=""))
        await bench.send("listener", "attach", port="in", topic="/chatter", rate=50, tolerates=5)
        await bench.attach("speaker", "out", "/chatter")
        await bench.mode("speaker", "talk", "normal")
        await bench.mode("listener", "hear", "normal")
        await bench.sleep(3.0 - 0.004)
        await Pair(bench).falls_within(0.1, 0.16)

    simulate(tmp_path, main)


def test_without_a_stated_tolerance_only_long_silence_counts(tmp_path: Path) -> None:
    async def silent(pair: Pair) -> None:
        await pair.bench.sleep(3.0 - 0.004)
        await pair.falls_within(LONG_FLOOR - 0.02, LONG_FLOOR + SLACK)

    for name in ("silent", "slow"):
        (tmp_path / name).mkdir()
    pair(tmp_path / "silent", silent, count="n <= 150", arguments=", rate=50")
    pair(tmp_path / "slow", lambda pair: pair.never_falls(60.0), count="n % 10 == 0", arguments=", rate=50")


def test_a_deadline_is_a_rate(tmp_path: Path) -> None:
    async def body(pair: Pair) -> None:
        await pair.bench.sleep(3.0)
        await pair.falls_within(FLOOR - 0.05, FLOOR + SLACK)

    async def main(bench: Bench) -> None:
        speaker = SPEAKER.replace("Component\n", "Component, QoS\n").replace(
            "String)\n", "String, QoS(deadline=0.1))\n"
        )
        await bench.start("speaker", speaker.format(rate=50, pause="0", count="n <= 150"))
        listener = LISTENER.replace("any_of\n", "any_of, QoS\n")
        await bench.start("listener", listener.format(arguments=", qos=QoS(deadline=0.1), tolerates=10", more=""))
        await bench.attach("listener", "in", "/chatter")
        await bench.attach("speaker", "out", "/chatter")
        await bench.mode("speaker", "talk", "normal")
        await bench.mode("listener", "hear", "normal")
        await bench.sleep(3.0)
        await Pair(bench).falls_within(1.0, 1.1 + SLACK)

    simulate(tmp_path, main)


# -- what does not -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("pause", "count"),
    [
        ("0.3 if n % 20 == 0 else 0", "1"),  # a scheduler that pauses it again and again
        ("0.9 if n % 50 == 0 else 0", "1"),
        ("0", "5 if n % 5 == 0 else 0"),  # bursts
        ("0", "n % 2"),
    ],
)
def test_jitter_bursts_and_half_of_the_rate_are_no_breakage(tmp_path: Path, pause: str, count: str) -> None:
    pair(tmp_path, lambda pair: pair.never_falls(60.0), pause=pause, count=count)


def test_a_gap_of_the_tolerated_number_is_no_breakage_and_one_more_is(tmp_path: Path) -> None:
    async def body(pair: Pair) -> None:
        await pair.never_falls(19.9)
        await pair.bench.sleep(1.5)  # each gap has another phase: it is looked for at times
        assert pair.mode() == "degraded"

    pair(tmp_path, body, count="n % 11 not in (1, 2, 3) and not (n > 1000 and n % 11 == 4)", arguments=TOLERATING)


TOLERATING = ", rate=50, tolerates=3"


def test_an_input_without_a_rate_is_not_watched(tmp_path: Path) -> None:
    pair(tmp_path, lambda pair: pair.never_falls(60.0), count="n <= 10", arguments="")


def test_what_has_never_been_received_is_not_lost(tmp_path: Path) -> None:
    """A recording that is not played yet, say: the best mode is that of before."""
    pair(tmp_path, lambda pair: pair.never_falls(60.0), count="0")


@pytest.mark.parametrize("seconds", [0.5, 3.0, pytest.param(40.0, marks=pytest.mark.full)])
def test_a_process_that_was_stopped_does_not_blame_its_publishers(tmp_path: Path, seconds: float) -> None:
    async def body(pair: Pair) -> None:
        await pair.bench.sleep(1.0)
        pair.bench.simulator.faults.freeze("listener", seconds)
        await pair.never_falls(seconds + 20.0)

    pair(tmp_path, body, arguments=TOLERATING)


def test_a_call_that_keeps_messages_waiting_is_not_the_publishers_fault(tmp_path: Path) -> None:
    other = """
other = comp.create_functionality("other")
other.set_normal_mode(lambda: time.sleep(3), rate=0.2)
other.set_degraded_mode(lambda: None)
"""

    async def body(pair: Pair) -> None:
        await pair.bench.mode("listener", "other", "normal")
        await pair.never_falls(30.0)

    pair(tmp_path, body, more=other)


def test_a_clock_that_stands_still_or_jumps_is_no_breakage(tmp_path: Path) -> None:
    async def body(pair: Pair) -> None:
        clock = pair.bench.simulator.time
        clock.drive(1.0)
        await pair.never_falls(3.0)
        clock.drive(0.0)
        await pair.never_falls(30.0)
        clock.drive(10.0)
        await pair.never_falls(5.0)
        clock.drive(1.0, at=clock.ros_now() + 3_600_000_000_000)
        await pair.never_falls(3.0)
        clock.drive(0.1, at=1_000_000_000)
        await pair.never_falls(30.0)
        pair.bench.simulator.faults.kill("speaker")
        await pair.never_falls(5.0)  # half a second of its clock
        await pair.bench.sleep(7.0)
        assert pair.mode() == "degraded"

    pair(tmp_path, body)


def test_while_a_plan_records_longer_silence_is_tolerated(tmp_path: Path) -> None:
    """A hand-over with a transfer of state is under way."""

    async def body(pair: Pair) -> None:
        await pair.bench.send("listener", "record", inputs=["in"], on=True)
        await pair.bench.sleep(3.0)
        await pair.falls_within(LONG_FLOOR - 0.05, LONG_FLOOR + SLACK)

    pair(tmp_path, body, count="n <= 150", arguments=TOLERATING)


def test_a_component_without_a_manager_is_not_degraded(tmp_path: Path) -> None:
    """Nothing would restore it."""

    async def main(bench: Bench) -> None:
        await bench.start(
            "speaker", SPEAKER.format(rate=50, pause="0", count="n <= 150"), "--standalone", "out:=/chatter"
        )
        await bench.start("listener", LISTENER.format(arguments=", rate=50", more=""), "--standalone", "in:=/chatter")
        await bench.sleep(10.0)
        assert bench.state("listener").functionalities["hear"].mode == "normal"

    simulate(tmp_path, main)


# -- alternatives and modes in between ---------------------------------------------------------------------

FUSION = """
from midstride import Component, any_of
from std_msgs.msg import String

comp = Component("fusion")
left = comp.create_input("left", String, rate=50, tolerates=49)
right = comp.create_input("right", String, rate=50, tolerates=49)
chart = comp.create_input("chart", String)
either = comp.create_functionality("either", inputs=[left, right])
either.set_normal_mode(lambda message: None, inputs=[any_of(left, right)])
either.set_degraded_mode(lambda: None)
both = comp.create_functionality("both", inputs=[left, right, chart])
both.set_normal_mode(lambda: None, rate=1, inputs=[left, right, chart])
both.set_mode("left_only", lambda: None, rate=1, inputs=[left, chart])
both.set_mode("right_only", lambda: None, rate=1, inputs=[right, chart])
both.set_degraded_mode(lambda: None)
comp.start()
"""


def test_a_functionality_falls_to_the_best_mode_whose_inputs_are_in_order(tmp_path: Path) -> None:
    async def main(bench: Bench) -> None:
        await bench.start("fusion", FUSION)
        for side, last in (("left", 150), ("right", 400)):
            await bench.start(side, SPEAKER.format(rate=50, pause="0", count=f"n <= {last}"))
            await bench.attach("fusion", side, f"/{side}")
            await bench.attach(side, "out", f"/{side}")
        await bench.attach("fusion", "chart", "/chart")
        for instance, functionality in (("left", "talk"), ("right", "talk"), ("fusion", "either"), ("fusion", "both")):
            await bench.mode(instance, functionality, "normal")
        fusion = Pair(bench)
        await bench.sleep(5.0)
        assert (fusion.mode("either", "fusion"), fusion.mode("both", "fusion")) == ("normal", "right_only")
        assert "input left received nothing" in fusion.because("both", "fusion")
        await bench.sleep(5.0)
        assert (fusion.mode("either", "fusion"), fusion.mode("both", "fusion")) == ("degraded", "degraded")
        assert "input left received" in fusion.because("either", "fusion")
        assert "; input right received" in fusion.because("either", "fusion")

    simulate(tmp_path, main)


# -- a call that does not return ---------------------------------------------------------------------------


def test_a_hung_call_is_shown_at_once_and_the_mode_is_left_when_it_returns(tmp_path: Path) -> None:
    async def body(pair: Pair) -> None:
        await pair.bench.sleep(3.0)
        revision = pair.bench.state("speaker").revision
        await pair.bench.sleep(LONG_FLOOR + SLACK)
        assert pair.mode("talk", "speaker") == "degraded"
        assert pair.because("talk", "speaker").startswith(
            "mode normal wrote nothing on output out for 5."
        ) and "a call of talk has not returned for 5." in pair.because("talk", "speaker")
        assert pair.bench.state("speaker").functionalities["talk"].busy is not None
        assert pair.bench.state("speaker").revision == revision + 1
        await pair.bench.sleep(20.0)
        state = (await pair.bench.lab.read("speaker", "observe"))["functionalities"]["talk"]
        assert (state["mode"], state["busy"]) == ("degraded", None)
        assert pair.bench.state("speaker").revision == revision + 1, "it has been reported once"
        await pair.bench.mode("speaker", "talk", "normal")
        await pair.bench.sleep(5.0)
        assert pair.mode("talk", "speaker") == "normal"

    pair(tmp_path, body, pause="10 if n == 150 else 0")


def test_a_slow_first_call_is_no_hang(tmp_path: Path) -> None:
    async def body(pair: Pair) -> None:
        await pair.bench.sleep(10.0)
        assert pair.mode("talk", "speaker") == "normal"

    pair(tmp_path, body, pause="4 if n == 1 else 0")


def test_a_functionality_that_another_one_keeps_from_its_calls_names_it(tmp_path: Path) -> None:
    other = """
other = comp.create_functionality("other")
other.set_normal_mode(lambda: time.sleep(1000))
other.set_degraded_mode(lambda: None)
comp.start()
"""

    async def main(bench: Bench) -> None:
        speaker = SPEAKER.format(rate=50, pause="0", count="1").replace("comp.start()\n", other)
        await bench.start("speaker", speaker)
        await bench.attach("speaker", "out", "/chatter")
        await bench.mode("speaker", "talk", "normal")
        await bench.sleep(1.0)
        await bench.mode("speaker", "other", "normal")
        await bench.sleep(LONG_FLOOR + SLACK)
        pair = Pair(bench)
        assert pair.mode("talk", "speaker") == "degraded"
        assert "a call of other has not returned" in pair.because("talk", "speaker")

    simulate(tmp_path, main)


RELAY = """
import time
from midstride import Component
from std_msgs.msg import String

comp = Component("listener")
inlet, out = comp.create_input("in", String{arguments}), comp.create_output("out", String)
relay = comp.create_functionality("relay", inputs=[inlet], outputs=[out])
other = comp.create_functionality("other")
calls = 0

def normal():
    global calls
    calls += 1
    if calls == {hangs}:
        time.sleep({pause})
    out.write(String(data=str(calls)))

relay.set_normal_mode(normal, rate=50, inputs=[inlet], outputs=[out])
relay.set_degraded_mode(lambda: None)
other.set_normal_mode(lambda: time.sleep({pause}))
other.set_degraded_mode(lambda: None)
comp.start()
"""


def relaying(folder: Path, source: str, body: Callable[[Pair], Awaitable[None]]) -> None:
    """With a relay as the listener, whose input has a rate: no message reaches it while a call hangs."""

    async def main(bench: Bench) -> None:
        await bench.start("speaker", SPEAKER.format(rate=50, pause="0", count="1"))
        await bench.start("listener", source)
        await bench.attach("listener", "in", "/chatter")
        await bench.attach("listener", "out", "/echo")
        await bench.attach("speaker", "out", "/chatter")
        await bench.mode("speaker", "talk", "normal")
        await bench.mode("listener", "relay", "normal")
        await body(Pair(bench))

    simulate(folder, main)


@pytest.mark.parametrize("arguments", [", rate=50", ", rate=50, tolerates=49", ", rate=50, tolerates=3"])
def test_a_hung_call_is_shown_although_the_inputs_of_its_mode_stand_still_too(tmp_path: Path, arguments: str) -> None:
    async def body(pair: Pair) -> None:
        await pair.bench.sleep(3.0)
        revision = pair.bench.state("listener").revision
        await pair.bench.sleep(LONG_FLOOR + 2 * SLACK)
        assert pair.mode("relay") == "degraded"
        because = pair.because("relay")
        assert re.match(r"mode normal wrote nothing on output out for 5\..*: a call of relay has not returned", because)
        await pair.bench.sleep(20.0)
        state = (await pair.bench.lab.read("listener", "observe"))["functionalities"]["relay"]
        assert (state["mode"], state["busy"], state["reflex"]) == ("degraded", None, True)
        assert pair.bench.state("listener").revision == revision + 1, "it has been reported once"
        await pair.bench.mode("listener", "relay", "normal")
        await pair.bench.sleep(10.0)
        assert pair.mode("relay") == "normal", pair.because("relay")

    relaying(tmp_path, RELAY.format(arguments=arguments, hangs=150, pause=10), body)


def test_a_call_that_is_no_hang_yet_breaks_nothing_either(tmp_path: Path) -> None:
    """However long it keeps the messages waiting: its own output is silent for less than 5 s."""

    async def body(pair: Pair) -> None:
        await pair.bench.sleep(20.0)
        assert pair.mode("relay") == "normal", pair.because("relay")

    relaying(tmp_path, RELAY.format(arguments=", rate=50, tolerates=49", hangs=150, pause=4.5), body)


@pytest.mark.parametrize("arguments", [", rate=50", ", rate=50, tolerates=49"])
def test_a_functionality_with_a_rated_input_names_the_other_one_that_hangs(tmp_path: Path, arguments: str) -> None:
    async def body(pair: Pair) -> None:
        await pair.bench.sleep(1.0)
        await pair.bench.mode("listener", "other", "normal")
        await pair.bench.sleep(LONG_FLOOR + 2 * SLACK)
        assert pair.mode("relay") == "degraded"
        assert "a call of other has not returned" in pair.because("relay")

    relaying(tmp_path, RELAY.format(arguments=arguments, hangs=0, pause=1000), body)


ASYNC = """
from midstride import Component
from std_msgs.msg import String

comp = Component("speaker")
inlet, out = comp.create_input("in", String, rate=50, tolerates=49), comp.create_output("out", String)
relay = comp.create_functionality("relay", inputs=[inlet], outputs=[out])

async def normal(message):
    await comp.clock.sleep(1000 if message.data == "150" else 0.001)
    out.write(message)

relay.set_normal_mode(normal, inputs=[inlet], outputs=[out], guarantees={out: 50})
relay.set_degraded_mode(lambda: None)
comp.start()
"""


@pytest.mark.parametrize(
    ("count", "why"), [("1", "a call of relay has not returned"), ("n <= 150", "input in received")]
)
def test_an_async_call_that_never_ends_does_not_disable_it(tmp_path: Path, count: str, why: str) -> None:
    async def main(bench: Bench) -> None:
        await bench.start("speaker", SPEAKER.format(rate=50, pause="0", count=count))
        await bench.start("listener", ASYNC)
        await bench.attach("listener", "in", "/chatter")
        await bench.attach("listener", "out", "/echo")
        await bench.attach("speaker", "out", "/chatter")
        await bench.mode("speaker", "talk", "normal")
        await bench.mode("listener", "relay", "normal")
        await bench.sleep(3.0 + LONG_FLOOR + 3 * SLACK)
        pair = Pair(bench)
        assert pair.mode("relay") == "degraded"
        assert why in pair.because("relay")

    simulate(tmp_path, main)
