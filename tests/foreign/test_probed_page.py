"""Inputs of running nodes are closed by a probe, and open again however that ends."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

from midstride.backends.ros2.manager.probed_page import probing
from midstride.capture.probe import ProbedPort
from midstride.errors import BackendError
from midstride.foreign.gates import Gates
from midstride.foreign.page_layout import INPUT, OPEN, OUTPUT, PagePort, PortFlag
from midstride.model.component import ComponentSpec
from tests.foreign.lab import MS, Lab, until

# As `midstride import` writes it: without ports.
THING = ComponentSpec.of("Thing", run="node", gate="preload")
IN, OUT = ProbedPort("/relay", "/in", False), ProbedPort("/relay", "/chat", True)
PROBER = """
import sys
from pathlib import Path
from midstride.backends.ros2.manager import probed_page
from midstride.capture.probe import ProbedPort

probed_page.LEASE = 0.3
with probed_page.probing(Path(sys.argv[1])) as gates:
    gates.watch(ProbedPort("/relay", "/in", False), 0.0, 1000.0)
"""


@dataclass
class Relay:
    """A node that publishes a message on /chat for each one that it takes from /in."""

    lab: Lab
    folder: Path
    index: int

    def port(self, number: int) -> PagePort:
        port: PagePort = self.lab.page.ports(self.index)[number]
        return port

    @property
    def closed(self) -> bool:
        """Whether the input drops messages now."""
        dropped = self.port(1).gated
        written = self.port(0).passed
        until(lambda: bool(self.port(1).gated > dropped + 3 or self.port(0).passed > written + 3), "it does nothing")
        return bool(self.port(1).gated > dropped + 3)


@pytest.fixture
def relay(lab: Lab, tmp_path: Path, gate_library: Path, monkeypatch: pytest.MonkeyPatch) -> Relay:
    monkeypatch.setenv("XDG_CACHE_HOME", str(gate_library.parent.parent))
    index = lab.page.allocate("relay")
    Gates(lab.page, index, THING).prepare({})
    lab.run(index, MS, 10**12, "/in")
    lab.record("relay", index, THING)
    return Relay(lab, tmp_path, index)


def test_a_node_whose_ports_are_not_stated_yet_lists_its_topics(relay: Relay) -> None:
    ports = relay.lab.page.ports(relay.index)
    assert [(port.topic, port.kind) for port in ports] == [(b"/chat", OUTPUT), (b"/in", INPUT)]
    assert [port.gate for port in ports] == [OPEN, OPEN] and not relay.closed
    with probing(relay.folder) as gates:
        assert gates.ports() == {IN, OUT}
        relay.lab.kill(relay.index)
        assert gates.ports() == set()


def test_an_input_is_closed_while_it_is_watched(relay: Relay) -> None:
    with probing(relay.folder) as gates:
        opened = gates.watch(None, 0.0, 0.1)
        closed = gates.watch(IN, 0.05, 0.1)
        assert relay.port(1).flags == 0 and not relay.closed
    assert opened[OUT].passed > 0 and opened[IN].passed > 0 and opened[IN].held == 0
    assert (closed[OUT].passed, closed[IN].passed) == (0, 0)
    assert closed[IN].held > 0 and closed[OUT].longest >= 0.1


def test_what_an_output_writes_behind_its_own_gate_counts_as_well(relay: Relay) -> None:
    relay.port(0).gate = 0
    with probing(relay.folder) as gates:
        assert gates.watch(None, 0.0, 0.1)[OUT].passed > 0


def test_a_node_that_ends_meanwhile_is_left_out(relay: Relay, monkeypatch: pytest.MonkeyPatch) -> None:
    with probing(relay.folder) as gates:
        counted = gates.ports()
        monkeypatch.setattr(
            "midstride.backends.ros2.manager.probed_page.time.sleep", lambda _: relay.lab.kill(relay.index)
        )
        assert counted == {IN, OUT} and gates.watch(None, 0.0, 0.01) == {}


@pytest.mark.parametrize(
    "how", [signal.SIGKILL, *(pytest.param(each, marks=pytest.mark.full) for each in (signal.SIGINT, signal.SIGSTOP))]
)
def test_the_input_is_open_again_however_the_probe_ends(relay: Relay, how: signal.Signals) -> None:
    command = [sys.executable, "-c", PROBER, str(relay.folder)]
    prober = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    try:
        until(lambda: bool(relay.port(1).gated), "the input is not closed")
        prober.send_signal(how)
        until(lambda: not relay.closed, "the input is not opened")
        prober.send_signal(signal.SIGCONT)
        _, said = prober.communicate(timeout=60)
    finally:
        prober.kill()
        prober.wait()
    assert relay.port(1).flags == (PortFlag.SHUT if how is signal.SIGKILL else 0)  # else it has opened the input itself
    if how is signal.SIGSTOP:
        assert "its input opened by itself" in said
    with probing(relay.folder) as gates:  # and another one may begin, which does not close what that one closed
        assert relay.port(1).flags == 0 and gates.watch(None, 0.0, 0.05)[IN].passed > 0


def test_one_probe_at_a_time(relay: Relay, tmp_path: Path) -> None:
    with (
        probing(relay.folder),
        pytest.raises(BackendError, match="another `midstride capture --probe` is running"),
        probing(relay.folder),
    ):
        pass
    with pytest.raises(BackendError, match="no node has a gate"), probing(tmp_path / "elsewhere"):
        pass
    assert not os.path.exists(tmp_path / "elsewhere")
