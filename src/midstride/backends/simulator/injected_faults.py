"""Faults that a test, or a rehearsal, injects into the simulated platform."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, TypeAlias

from midstride.backends.simulator.network import Network
from midstride.backends.simulator.simulated_process import SimulatedProcess
from midstride.errors import BackendError

RequestFault: TypeAlias = Literal[
    "lost_request",
    "lost_reply",
    "refused",
    "unreachable",
    "delayed_request",
    "delayed_reply",
    "repeated_request",
    "repeated_reply",
]


@dataclass(slots=True)
class FailingCall:
    """The next ``times`` calls of ``op`` (any, where None) at ``instance`` fail in this way, after ``after`` more.

    ``seconds``: by how much a request or a reply is delayed. Those after it overtake it.
    """

    instance: str
    op: str | None
    how: RequestFault
    times: int
    after: int
    seconds: float


def beside(process: SimulatedProcess, processes: Mapping[str, SimulatedProcess]) -> list[SimulatedProcess]:
    """The other components of ``processes`` in the process of a container that ``process`` is in."""
    return [each for each in processes.values() if process.shares == each.shares != "" and each is not process]


class Faults:
    """Injects faults. Every method that names an instance raises BackendError where no such component runs."""

    def __init__(self, processes: Mapping[str, SimulatedProcess], network: Network) -> None:
        self._processes = processes
        self._network = network
        self._failing: list[FailingCall] = []

    def kill(self, instance: str) -> None:
        """Kill the process at once, like `kill -9`."""
        self._process(instance).kill()

    def freeze(self, instance: str, seconds: float) -> None:
        """Stop the process for ``seconds``, like SIGSTOP and SIGCONT: nothing in it runs, nothing sent is lost."""
        process = self._process(instance)
        for each in (process, *beside(process, self._processes)):
            each.freeze(seconds)

    def hang(self, instance: str, seconds: float) -> None:
        """Block a call of its code for ``seconds``; its control thread answers meanwhile."""
        self._process(instance).hang(seconds)

    def stop_discovery(self, instance: str) -> None:
        """Deadlock its middleware: its inputs receive nothing from publishers created from now on.

        These publishers count it as matched all the same, and what it publishes is received.
        """
        self._network.undiscovering[self._process(instance)] = self._network.clock.steady()

    def drop(self, topic: str, count: int) -> None:
        """The next ``count`` messages on ``topic`` are lost."""
        self._network.topic(topic).dropping = count

    def delay(self, topic: str, seconds: float) -> None:
        """Messages on ``topic`` take so much longer from now on."""
        self._network.topic(topic).delay = seconds

    def fail_next(
        self,
        instance: str,
        op: str | None = None,
        how: RequestFault = "lost_request",
        times: int = 1,
        after: int = 0,
        seconds: float = 0.0,
    ) -> None:
        """The next call of ``op`` at ``instance`` fails; ``lost_reply``: it is carried out, but its reply is lost."""
        self._failing.append(FailingCall(instance, op, how, times, after, seconds))

    def clear(self) -> None:
        """No request fails any more."""
        self._failing.clear()

    def take_fault(self, instance: str, op: str) -> FailingCall | None:
        """The fault that this request is to have, if any; counts it."""
        for fault in self._failing:
            if fault.instance == instance and fault.op in (None, op):
                if fault.after:
                    fault.after -= 1
                    continue
                fault.times -= 1
                if not fault.times:
                    self._failing.remove(fault)
                return fault
        return None

    def _process(self, instance: str) -> SimulatedProcess:
        process = self._processes.get(instance)
        if process is None:
            raise BackendError(f"no component {instance} runs; running are: {', '.join(self._processes) or 'none'}")
        return process
