"""Prolonged silence of a component that should answer, an output that should publish, or an input that should receive.

A server that breaks its bound is one of them, as its component reports.

Components report the counts of their ports twice a second, and the monitor compares the reports over time. What it
finds are faults of the running system: they are part of the status, of the events, and of the outcome of a change
during which they began (docs/protocols/faults.md).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Set
from dataclasses import dataclass, field
from typing import Final

from midstride.model.component import FunctionalityRef, PortRef
from midstride.model.configuration import Configuration
from midstride.runtime.backend_protocol import HostLinkState
from midstride.runtime.instance_life import SILENCE, LifeTable
from midstride.runtime.manager_clock import Clock
from midstride.runtime.records.events import EventLog
from midstride.runtime.records.status_forms import SilenceFault, SilenceKind
from midstride.runtime.watch.simulated_time import stretch
from midstride.wire.state import ComponentState, LinkState

# How long a port may be silent before that is a fault (s); for an output, also how many of its periods.
PORT_SILENCE: Final = 3.0
SILENT_PERIODS: Final = 10
# An input is not receiving once this many messages were published on its topic, the first of them at least so long
# after the last one that it received (s): the reports of two components are up to half a second apart.
UNRECEIVED: Final = 3
REPORT_SKEW: Final = 1.0
# How often the faults are looked for, for the events (s).
CHECK_INTERVAL: Final = 1.0
_ENDED: Final = {
    "unreachable": "{0.instance} answers again",
    "not_answering": "{0.instance} answers again",
    "not_discovering": "{0.instance} discovers endpoints again",
    "not_publishing": "{0.port} publishes on {0.topic} again",
    "not_receiving": "{0.port} receives messages on {0.topic} again",
    "not_responding": "{0.port} answers requests on {0.topic} in time again",
}


@dataclass(slots=True)
class _Link:
    """One attachment as last reported, and since when its count is the same (steady s).

    ``passed``: when it was known last that a message had passed (steady s). For an input: how many messages others have
    published on its topic since, and when the first of them was.
    """

    state: LinkState
    since: float
    passed: float = -math.inf
    unreceived: int = 0
    unreceived_since: float = 0.0


@dataclass(frozen=True, slots=True)
class _Report:
    """The time of an instance's last report (steady s), and the topics and ports of its attachments then."""

    at: float
    attached: Set[tuple[str, PortRef]]


@dataclass(slots=True)
class SilenceMonitor:
    life: LifeTable
    clock: Clock
    events: EventLog
    # Those whose middleware has stopped discovering, and since when that is known (steady s).
    undiscovering: Mapping[str, float] = field(default_factory=dict)
    # Whether the process of an instance is stopped: an agent in the manager's process does not show that.
    is_stopped: Callable[[str], bool] = lambda _: False
    host_links: Callable[[], Iterable[HostLinkState]] = tuple
    _links: dict[str, dict[PortRef, _Link]] = field(default_factory=dict)  # by topic
    _reports: dict[str, _Report] = field(default_factory=dict)  # the last one of each instance
    _known: dict[str, SilenceFault] = field(default_factory=dict)  # the faults of the last check
    _checked: float = 0.0
    _judged: float = 0.0  # when it was checked last whether there are faults (steady s)

    def on_report(self, state: ComponentState, configuration: Configuration) -> None:
        """A component has reported its state."""
        now = self.clock.steady()
        # What happened while it did not report is not known.
        last = self._reports.get(state.instance)
        fresh = last is not None and now - last.at > SILENCE
        current = {
            (topic, PortRef(state.instance, port)): link
            for port, topics in state.ports.items()
            for topic, link in topics.items()
        }
        self._forget(state.instance, kept=current.keys())
        self._reports[state.instance] = _Report(now, current.keys())
        for (topic, port), link in current.items():
            links = self._links.setdefault(topic, {})
            known = links.get(port)
            # While simulated time stands still, nothing is due on it.
            free = fresh or (state.clock_speed == 0 and link.gate is not None)
            if known is not None and link.responses is not None:
                known.state = link
            if known is None or free or (known.state.gate, known.state.count) != (link.gate, link.count):
                passed = -math.inf if known is None else known.passed
                if known is not None and link.count > known.state.count:
                    passed = now
                links[port] = _Link(link, now, passed)
                if known is not None and not fresh and link.gate is not None:
                    self._published(links, link.count - known.state.count, now)
        if (since := now - self._checked) >= CHECK_INTERVAL:
            self._checked = now
            if since <= SILENCE:  # else this process may have been stopped, and the other reports are still to be read
                self._check(configuration)

    def _forget(self, instance: str, kept: Set[tuple[str, PortRef]] = frozenset()) -> None:
        """Drop the attachments of ``instance`` except ``kept``."""
        if (last := self._reports.pop(instance, None)) is not None:
            for topic, port in last.attached - kept:
                del self._links[topic][port]

    @staticmethod
    def _published(links: dict[PortRef, _Link], count: int, now: float) -> None:
        for link in links.values():
            if link.state.gate is None and now - link.since >= REPORT_SKEW:
                link.unreceived_since = link.unreceived_since if link.unreceived else now
                link.unreceived += max(0, count)

    def _check(self, configuration: Configuration) -> None:
        """An event for each fault that has begun or ended; instances that have been removed are forgotten."""
        for instance in self._reports.keys() - configuration.instances.keys():
            self._forget(instance)
        found = {fault.words: fault for fault in self.faults(configuration)}
        for words in sorted(found.keys() - self._known.keys()):
            self.events.add("silence", words)
        for words in sorted(self._known.keys() - found.keys()):
            fault = self._known[words]
            if fault.instance in configuration.instances and self._is_over(fault, found.values()):
                self.events.add("silence_ended", _ENDED[fault.kind].format(fault))
        self._known, self._judged = found, self.clock.steady()

    def _is_over(self, fault: SilenceFault, now: Iterable[SilenceFault]) -> bool:
        """Return whether a fault of the last check has ended, rather than that nothing is expected there any more.

        So it is of an output whose mode guarantees no rate. ``now``: the faults of this moment.
        """
        if any((each.kind, each.instance, each.port) == (fault.kind, fault.instance, fault.port) for each in now):
            return False  # in other words
        if fault.port is None or fault.kind == "not_responding":
            return self.life.responsive(fault.instance) is not None
        links = self._links.get(fault.topic or "", {}).items()
        return any(str(port) == fault.port and link.passed > self._judged for port, link in links)

    def is_unreachable(self, instance: str, configuration: Configuration) -> bool:
        """Return whether the host of an instance cannot be reached, so that nothing is known of the instance."""
        host = configuration.instances[instance].host
        return bool(host) and any(each.host == host and each.problem is not None for each in self.host_links())

    def faults(self, configuration: Configuration) -> list[SilenceFault]:
        """Every silence now, by instance and port."""
        return self._faults(configuration, PORT_SILENCE)

    def silent(self, configuration: Configuration) -> set[str]:
        """Every silence now, in words, also of an output that has not been silent for so long yet that it is a fault.

        What begins now has not made it silent.
        """
        return {fault.words for fault in self._faults(configuration, REPORT_SKEW)}

    def _faults(self, configuration: Configuration, least: float) -> list[SilenceFault]:
        """An output counts if it is silent for more than ``least`` s and ten of its periods."""
        names = sorted(configuration.instances)
        return [fault for name in names for fault in self._faults_of(name, configuration, least)]

    def _faults_of(self, instance: str, configuration: Configuration, least: float) -> Iterator[SilenceFault]:
        state, latest = self.life.responsive(instance), self.life.latest(instance)
        if state is None:
            if self.life.is_ending(instance) or self.life.has_exited(instance):  # which has its own events
                return
            if self.life.is_done(instance):
                return
            seconds = None if latest is None else round(self.clock.steady() - latest.at, 3)
            if self.is_unreachable(instance, configuration):
                words = f"{instance} is unreachable, with host {configuration.instances[instance].host}"
                yield SilenceFault(kind="unreachable", instance=instance, seconds=seconds, words=words)
                return
            words = f"{instance} does not answer"
            yield SilenceFault(kind="not_answering", instance=instance, seconds=seconds, words=words)
            return
        if not configuration.component(instance).has_agent and self.is_stopped(instance):
            yield SilenceFault(kind="not_answering", instance=instance, words=f"{instance} is stopped (SIGSTOP)")
        elif state.unanswered is not None:
            words = f"{instance} does not answer the requests to its lifecycle"
            seconds = round(state.unanswered, 3)
            yield SilenceFault(kind="not_answering", instance=instance, seconds=seconds, words=words)
        if (since := self.undiscovering.get(instance)) is not None:
            words = f"{instance} discovers no new endpoints, although its data flows: its middleware has hung"
            seconds = round(self.clock.steady() - since, 3)
            yield SilenceFault(kind="not_discovering", instance=instance, seconds=seconds, words=words)
        if not configuration.component(instance).counts_messages:
            return
        for port, connector in configuration.attached_ports(instance):
            topic = configuration.topic(connector)
            link = self._links.get(topic, {}).get(port)
            if link is None:
                continue
            if link.state.gate == "open" and (found := link.state.responses) is not None and found.broken:
                words = f"{port} {found.broken} on {topic}, although {found.promised}"
                yield _port_fault("not_responding", port, topic, found.silent, words)
            elif link.state.gate == "open":
                lazy = port.port in configuration.component(instance).lazy
                if lazy and not configuration.subscribers_on(connector):
                    continue  # it need not exist
                yield from self._not_publishing(configuration, state, port, topic, link.since, least)
            elif link.unreceived >= UNRECEIVED and self.clock.steady() - link.unreceived_since > PORT_SILENCE:
                yield not_receiving(port, topic, self.clock.steady() - link.unreceived_since)

    def _not_publishing(
        self,
        configuration: Configuration,
        state: ComponentState,
        port: PortRef,
        topic: str,
        since: float,
        least: float,
    ) -> Iterator[SilenceFault]:
        ref = FunctionalityRef(port.instance, configuration.component(port.instance).owner(port.port).name)
        rate, reported = configuration.rate(port), state.functionalities[ref.functionality]
        if reported.mode != configuration.mode(ref).name:
            return  # a mode that has just been left guarantees nothing
        seconds = min(self.clock.steady() - since, reported.since)
        if rate and seconds > stretch(state) * max(least, SILENT_PERIODS / rate):
            words = f"{port} publishes nothing on {topic}, although mode {reported.mode} guarantees {rate:g} Hz"
            yield _port_fault("not_publishing", port, topic, seconds, words)


def not_receiving(port: PortRef, topic: str, seconds: float) -> SilenceFault:
    """The fault of an input that has received none of the messages published for so long (s)."""
    return _port_fault(
        "not_receiving", port, topic, seconds, f"{port} receives nothing of what is published on {topic}"
    )


def _port_fault(kind: SilenceKind, port: PortRef, topic: str, seconds: float, words: str) -> SilenceFault:
    return SilenceFault(
        kind=kind, instance=port.instance, port=str(port), topic=topic, seconds=round(seconds, 3), words=words
    )
