"""When nodes with a preloaded library publish is read from the page of their system, without a subscription."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

import pytest

from midstride.backends.ros2.manager.seen_nodes import SeenNodes
from midstride.backends.ros2.manager.seen_writes import EVERY, OUTPUTS_EVERY, SILENT, SeenWrites
from midstride.capture.rates import measured
from midstride.foreign.gates import Gates
from midstride.foreign.page_layout import NODE, WRITES, PagePort, Within
from midstride.model.component import ComponentSpec
from tests.foreign.lab import MS, Lab, until

# As `midstride import` writes it: without ports.
THING = ComponentSpec.of("Thing", run="node", gate="preload")


@dataclass
class Made:
    """A node that runs, of which the page has what a test puts there; ``now`` (s)."""

    lab: Lab
    index: int
    port: PagePort
    now: float = 1000.0

    def write(self, *times: float) -> None:
        for at in times:
            self.port.wrote[self.port.written % WRITES] = int(at * 1e6) % 2**32
            self.port.written += 1


@pytest.fixture
def made(lab: Lab, tmp_path: Path, gate_library: Path, monkeypatch: pytest.MonkeyPatch) -> Made:
    monkeypatch.setenv("XDG_CACHE_HOME", str(gate_library.parent.parent))
    index = lab.page.allocate("talker")
    Gates(lab.page, index, THING).prepare({})
    lab.run(index, 0, 1)
    lab.record("talker", index, THING)
    until(lambda: int(lab.port(index).written) == 1, "it does not write")
    return Made(lab, index, lab.port(index))


def seen(made: Made) -> SeenWrites:
    return SeenWrites(SeenNodes(made.lab.page.path.parent), lambda: made.now)


def test_what_the_graph_shows_before_the_next_look_is_looked_for(lab: Lab, made: Made) -> None:
    """A subscription would stay, so the answer must not be that of the look before."""
    writes = seen(made)
    assert writes.counts("/talker", "/chat"), "before the first look"
    made.write(1000.01, 990.0)  # of the second, the time is not noted yet
    made.now += EVERY
    writes.look()
    assert writes.times("/talker", "/chat") == pytest.approx([1000.01], abs=2e-6)
    index = lab.page.allocate("late")
    Gates(lab.page, index, THING).prepare({})
    lab.run(index, 0, 1)
    lab.page.set_ports(index, [("/late", NODE)])  # as the library names a ROS node of the process
    assert writes.counts("/late", "/chat"), "it has come since the last look"


def test_the_rate_of_a_running_node_is_measured(lab: Lab, made: Made) -> None:
    lab.kill(made.index)
    index = lab.page.allocate("relay")
    Gates(lab.page, index, THING).prepare({})
    lab.run(index, 5 * MS, 10**12)
    lab.record("relay", index, THING)
    writes = SeenWrites(SeenNodes(lab.page.path.parent))
    writes.look()

    def looked() -> list[float]:
        writes.look()
        return writes.times("/relay", "/chat") or []

    until(lambda: len(looked()) >= 20, "nothing is counted")
    time.sleep(EVERY)
    writes.look()
    times = writes.times("/relay", "/chat")
    assert times is not None and writes.counts("/relay", "/chat")

    def recorded() -> list[float]:
        return [at / 1e9 for writer, _, at in lab.records() if writer == index + 1]

    until(lambda: (recorded() or [0.0])[-1] > times[-1], "what it has written is not recorded")
    written = recorded()
    first = min(range(len(written)), key=lambda number: abs(written[number] - times[0]))
    found = list(zip(times, written[first:], strict=False))
    assert len(found) == len(times) and all(abs(one - other) < 0.05 for one, other in found), "not of each message"
    rate = measured(times)
    assert rate is not None and rate.median == pytest.approx(0.005, rel=0.5)
    assert writes.times("/talker", "/chat") is None, "its process has ended"


def test_each_message_has_its_time(made: Made) -> None:
    writes = seen(made)
    writes.look()
    made.write(1000.01, 1000.03)
    made.now = 1000.05
    writes.look()
    made.write(1000.06)
    made.now = 1000.06 + EVERY / 2  # too soon to look again
    writes.look()
    made.write(1000.07)
    made.now = 1000.08
    writes.look()
    assert writes.times("/talker", "/chat") == pytest.approx([1000.01, 1000.03, 1000.06, 1000.07], abs=2e-6)


def test_times_go_on_where_the_microseconds_begin_anew(made: Made) -> None:
    made.now = 2**32 / 1e6 - 0.01
    writes = seen(made)
    writes.look()
    expected = [made.now + 0.005, made.now + 0.02]
    made.write(*expected)
    made.now += 0.03
    writes.look()
    assert writes.times("/talker", "/chat") == pytest.approx(expected, abs=2e-6)


def test_what_was_written_faster_than_it_was_read_makes_no_gap(made: Made) -> None:
    writes = seen(made)
    writes.look()
    made.write(1000.001)
    made.now = 1000.03
    writes.look()
    late = [1000.03 + number * 1e-4 for number in range(WRITES + 10)]
    made.write(*late)
    made.now = 1000.1
    writes.look()
    assert writes.times("/talker", "/chat") == pytest.approx(late[10:], abs=2e-6)


def test_a_time_that_is_not_noted_yet_is_left_out(made: Made) -> None:
    writes = seen(made)
    made.write(990.0)
    writes.look()
    made.write(1000.01, 990.0)
    made.now = 1000.05
    writes.look()
    assert writes.times("/talker", "/chat") == pytest.approx([1000.01], abs=2e-6)


def test_an_output_that_nobody_reads_and_that_is_silent_may_wait_for_a_reader(made: Made) -> None:
    made.port.written = 0
    writes = seen(made)
    writes.look()
    assert writes.counts("/talker", "/chat") and writes.times("/talker", "/chat") == []
    made.now += SILENT
    writes.look()
    made.port.matched = 1
    assert writes.counts("/talker", "/chat"), "it is read, and writes nothing"
    made.port.matched = 0
    assert not writes.counts("/talker", "/chat")
    made.write(made.now + 0.01)
    made.now += 0.1
    writes.look()
    assert writes.counts("/talker", "/chat")


def test_what_goes_within_the_process_is_not_counted_where_rclcpp_does_not_tell(made: Made) -> None:
    writes = seen(made)
    made.port.within = Within.TAKES_PART
    writes.look()
    assert not writes.counts("/talker", "/chat") and writes.times("/talker", "/chat") is None
    made.port.inside = 1
    assert writes.counts("/talker", "/chat") and writes.times("/talker", "/chat") == []


def test_no_other_node_and_no_other_process_is_taken_for_it(made: Made) -> None:
    writes = seen(made)
    writes.look()
    assert writes.counts("/talker", "/chat")
    assert not writes.counts("/other", "/chat") and not writes.counts("/talker", "/other")
    made.lab.page.layout.nodes[made.index].pid += 1
    made.now += 2 * EVERY
    writes.look()
    assert not writes.counts("/talker", "/chat") and writes.times("/talker", "/chat") is None


def test_publishers_of_two_ros_nodes_of_a_process_have_one_count_which_is_neithers(made: Made) -> None:
    page = made.lab.page
    page.set_ports(made.index, [("/second", NODE)])  # as the library names a ROS node of the process
    writes = seen(made)
    writes.look()
    assert writes.counts("/talker", "/chat") and writes.counts("/second", "/chat")
    made.port.endpoints = 2
    made.now += OUTPUTS_EVERY
    writes.look()
    assert not writes.counts("/talker", "/chat") and not writes.counts("/second", "/chat")


def test_a_publisher_that_has_been_closed_is_known(made: Made) -> None:
    writes = seen(made)
    writes.look()
    assert not writes.has_closed("/talker", "/chat")
    made.port.endpoints = 0
    assert writes.has_closed("/talker", "/chat") and not writes.has_closed("/other", "/chat")
