"""The invariants of every run: checked while it runs, after each change of what really runs.

The checks do not believe the manager: they look at the simulated processes, at what their components report of
themselves, and at the messages that are published.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from typing import Final

from midstride.backends.simulator.network import SimulatedWriter
from midstride.model.component import FunctionalityRef
from midstride.node.author.client_ports import ABSENT
from midstride.node.control.shortfall import LONG_FLOOR
from midstride.runtime.handover.agreed_cut import RESUME_PERIODS
from midstride.simulation.oracle import Oracle, Shown
from midstride.simulation.platform import Platform
from midstride.simulation.request_invariants import RequestInvariants
from midstride.simulation.stand_in import StandIn

# How long at most until a component notices by itself that an input with a rate is silent, also during a change (s).
REFLEX: Final = 6.5
# The same for a client whose server, which it had, is not in the graph any more (s): it may be missing for so long, and
# the reflex looks every 0.1 s.
CLIENT_REFLEX: Final = ABSENT + 1.0
# How much later than the time that it waits an old publisher may continue that no new one takes over from (s).
RESUMED_LATE: Final = 0.5
# Two publishers that exchanged their topic this often within so many seconds were heard at once.
EXCHANGES: Final = 3
EXCHANGES_WITHIN: Final = 1.0
# How often it is looked whether what is cut off has left its mode (s): more often than a line is back and cut again.
LOOK: Final = 0.02
# Two publishers that write within this part of a period write the same slot.
SAME_SLOT: Final = 0.25


def resumes_within(period: float) -> float:
    """After how long the old publisher of a topic continues at the latest if the new one does not take over (s).

    ``period``: that of the topic (s).
    """
    return RESUME_PERIODS * period + RESUMED_LATE


def received(process: StandIn) -> set[str]:
    """The ports on which messages have passed since they were attached."""
    assert process.state is not None
    return {port for port, links in process.state.ports.items() if any(link.count for link in links.values())}


def _guarantees(process: StandIn, port: str) -> bool:
    """Return whether its mode guarantees something at that output; true while it has said no mode."""
    owner, state = process.component.owner(port), process.state
    mode = None if state is None else state.functionalities[owner.name].mode
    return mode is None or port in owner.modes[owner.mode_index(mode)].guarantees


@dataclass
class Invariants:
    """Call :meth:`begin` first."""

    platform: Platform
    oracle: Oracle
    # Counted up with what is heard: part of the digest.
    heard: dict[str, int] = field(default_factory=dict)
    requests: RequestInvariants = field(init=False)
    _shown: dict[str, Shown] = field(default_factory=dict)
    # Since when the assumption of each functionality is broken, and since when the manager could have reacted (s).
    _broken: dict[FunctionalityRef, float] = field(default_factory=dict)
    _free: dict[FunctionalityRef, float] = field(default_factory=dict)
    # Since when what each assumes does not arrive, as a line between hosts is cut; and when that was looked at (s).
    _cut_off: dict[FunctionalityRef, float] = field(default_factory=dict)
    _looked_at: float = 0.0
    # Since when the mode of each assumes clients whose servers are gone (s).
    _serverless: dict[FunctionalityRef, float] = field(default_factory=dict)
    # Since when each functionality has been in its mode, and for how long it had been in the one before (steady s, s).
    entered: dict[FunctionalityRef, tuple[float, float]] = field(default_factory=dict)
    # What is shown has changed, or an assumption is broken.
    due: bool = False
    _changed: bool = False
    _publishers: dict[tuple[str, str], tuple[StandIn, float]] = field(default_factory=dict)
    # By instance: its latest process that was heard, and when it last was (steady s).
    _last_heard: dict[str, tuple[StandIn, float]] = field(default_factory=dict)
    # By instance: when it has last imported state (steady s).
    _imported: dict[str, float] = field(default_factory=dict)
    # By topic and the two processes: a hand-over that is rolled back and made again is one to another process.
    _exchanged: dict[tuple[str, frozenset[int]], deque[float]] = field(default_factory=dict)
    _reported: set[str] = field(default_factory=set)

    def __post_init__(self) -> None:
        self.requests = RequestInvariants(self.platform, self.heard)

    def begin(
        self,
        reaction: Callable[[], float],
        lateness: Callable[[], float],
        uninterrupted: Callable[[], bool],
        torn: Callable[[], bool],
        violated: Callable[[str], None],
        deafened: Callable[[], bool] = bool,
        moved: Collection[str] = (),
    ) -> None:
        """A new seed begins.

        ``reaction()``: how long the manager may take to react now (s), infinite while it cannot.
        ``lateness()``: how long after a publisher was replaced its last message may be heard (s), because of a fault
        that makes calls late; infinite where it may not know either that it was replaced.
        ``uninterrupted()``: whether no plan and no fault has a reason to make a topic silent.
        ``torn()``: whether one of two instances may take the other one for dead.
        ``violated`` is called once for each violation, with words.
        ``deafened()``: whether a fault may keep an instance that ends from telling another one what it leaves to it.
        ``moved``: the roles that the change moves to other hosts.
        """
        self.reaction, self.lateness, self.uninterrupted, self.violated = reaction, lateness, uninterrupted, violated
        self.requests.torn, self.requests.violated = torn, self._violation
        self.requests.goals.torn, self.requests.goals.violated = deafened, self._violation
        self.moved = moved
        self.heard.clear()
        self._reported.clear()

    def on_change(self, process: StandIn) -> None:
        state = process.state
        if process.dead:
            self.requests.on_exit(process)
        if process.dead or state is None:
            if self._shown.pop(process.instance, None) is not None:
                self.due = self._changed = True
            return
        modes = tuple((name, view.mode) for name, view in state.functionalities.items())
        links = tuple(
            (port, topic)
            for port, topics in state.ports.items()
            for topic, link in topics.items()
            if link.gate != "closed"
        )
        shown = Shown(process.instance, process.key, process.component, modes, links)
        before = self._shown.get(process.instance)
        if before != shown:
            self._note_modes(shown, dict(before.modes) if before is not None else {})
            self._shown[process.instance] = shown
            self.due = self._changed = True
        self._check_gates(process)

    def _note_modes(self, shown: Shown, before: dict[str, str]) -> None:
        now = self.platform.time.steady()
        for name, mode in shown.modes:
            if before.get(name) != mode:
                ref = FunctionalityRef(shown.instance, name)
                self.entered[ref] = now, now - self.entered[ref][0] if name in before else 0.0

    def _check_gates(self, process: StandIn) -> None:
        """Of two instances of one role, not both publish whatever they write: a cut decides for one at least.

        That is so unless neither guarantees anything there in its mode, as where what both need is missing: then the
        new one takes nothing over, and a plan may attach it before the old one is detached.
        """
        for other in self.platform.stand_ins():
            if other is process or other.role != process.role:
                continue
            if other.host != process.host and process.role not in self.moved:
                names = " and ".join(sorted((process.instance, other.instance)))
                self._violation(f"{names} run on two hosts, although nobody has moved the node")
            for port, topic in sorted(process.open_outputs() & other.open_outputs()):
                if not _guarantees(process, port) and not _guarantees(other, port):
                    continue
                names = " and ".join(sorted((process.instance, other.instance)))
                self._violation(f"{port} of both {names} is open on {topic}")

    def on_publish(self, writer: SimulatedWriter) -> None:
        """A message is heard on a topic: two instances of one role must not alternate there."""
        owner = writer.owner
        assert isinstance(owner, StandIn)
        self.heard[owner.instance] = self.heard.get(owner.instance, 0) + 1
        key, now = (writer.topic, owner.role), self.platform.time.steady()
        self._last_heard[owner.instance] = owner, now
        before, at = self._publishers.get(key, (owner, now))
        period = self.oracle.period(writer.topic)
        if period and now - at > resumes_within(period) and self.uninterrupted():
            self._violation(f"{writer.topic} was silent for {now - at:.1f} s although its publishers were alive")
        self._publishers[key] = owner, now
        self._note_heard(owner, writer.topic)
        if before.instance == owner.instance:
            return
        lateness = self.lateness()
        if now - at < period * SAME_SLOT and not lateness:
            self._violation(f"{before.instance} and {owner.instance} both write one slot of {writer.topic}")
        times = self._exchanged.setdefault(
            (writer.topic, frozenset({before.pid, owner.pid})), deque(maxlen=EXCHANGES + 2)
        )
        times.append(now)
        # A call that a fault has made late may still write what belongs before the cut, and so add two.
        late = len(times) >= EXCHANGES and times[-2] - times[-EXCHANGES] < lateness
        most = EXCHANGES + 2 if late else EXCHANGES
        if len(times) >= most and now - times[-most] < EXCHANGES_WITHIN:
            self._violation(f"{before.instance} and {owner.instance} are both heard on {writer.topic}")

    def on_import(self, process: StandIn, exporter: str) -> None:
        """A process has imported state: what it has worked on with since must not be lost.

        The exporter has all that was published before it has imported state itself, or has published.
        """
        heard, at = self._last_heard.get(process.instance, (None, 0.0))
        known = max(self._last_heard.get(exporter, (None, 0.0))[1], self._imported.get(exporter, 0.0))
        if heard is process and at > known:
            self._violation(f"{process.instance} is set back to the state of {exporter}, after which it has published")
        self._imported[process.instance] = self.platform.time.steady()

    def _note_heard(self, process: StandIn, topic: str) -> None:
        """Note that a process which publishes is open, also where it reports so later: once its peer has answered."""
        shown = self._shown.get(process.instance)
        if shown is not None and not any(topic == other for _, other in shown.links):
            links = [(port, topic) for port in process.outputs_on(topic)]
            self._shown[process.instance] = shown._replace(links=(*shown.links, *links))
            self.due = self._changed = True

    def check(self) -> None:
        """After each event that makes it ``due``."""
        if self._changed:
            self._changed = False
            now = self.platform.time.steady()
            self._broken = {ref: self._broken.get(ref, now) for ref in self.oracle.broken(self._shown.values())}
            self._free = {ref: self._free.get(ref, now) for ref in self._broken}
            self._serverless = {ref: at for ref, at in self._serverless.items() if ref in self._broken}
            self.due = bool(self._broken) or self.platform.network.links.any_cut
        if self._broken:
            self._check_reaction()
        if self.platform.network.links.any_cut:
            self._check_cut_off()
        elif self._cut_off:
            self._cut_off.clear()

    def _check_cut_off(self) -> None:
        """A component must leave a mode whose input does not arrive, although somebody publishes it on another host."""
        now = self.platform.time.steady()
        if now < self._looked_at + LOOK:
            return
        self._looked_at = now
        found = self.oracle.broken(self._shown.values(), self._hears)
        self._cut_off = {ref: self._cut_off.get(ref, now) for ref in found if ref not in self._broken}
        for ref, since in self._cut_off.items():
            process = self.platform.standing(ref.instance)
            if process is None or not process.reacts:
                self._cut_off[ref] = now
                continue
            if now - max(since, self._counts_from(process)) > REFLEX and self.oracle.reflex_applies(
                self._shown[ref.instance], ref.functionality, received(process)
            ):
                self._violation(f"{self._stays(ref)} has not arrived for more than {REFLEX:g} s")

    def _counts_from(self, process: StandIn) -> float:
        """The time from which a silence counts for the reflex of ``process`` (steady s).

        After a stop it counts nothing for a while; and what a cut had held back is no silence when it arrives.
        """
        stopped = process.frozen_until and process.frozen_until + LONG_FLOOR
        return max(stopped, self.platform.network.links.late_at(process.on))

    def _hears(self, instance: str, by: str) -> bool:
        """Return whether the line from the host of an instance to that of another one is not cut."""
        sender, receiver = self.platform.standing(instance), self.platform.standing(by)
        if sender is None or receiver is None or sender.on == receiver.on:
            return True
        return not self.platform.network.links.is_cut(sender.on, receiver.on)

    def _check_reaction(self) -> None:
        """The manager must react where it can; and the component itself, whatever the manager does."""
        now, reaction = self.platform.time.steady(), self.reaction()
        for ref, since in self._broken.items():
            process = self.platform.standing(ref.instance)
            if reaction == math.inf:
                self._free[ref] = now
            if process is None or not process.reacts:
                self._broken[ref] = now  # what a hung call keeps waiting is not missing
                self._serverless.pop(ref, None)
            elif now > process.frozen_until + LONG_FLOOR and self._lacks_server(ref, process, now):
                self._violation(f"{self._stays(ref)} has had no server for more than {CLIENT_REFLEX:g} s")
            elif now - self._free[ref] > reaction:
                self._violation(f"{self._stays(ref)} is broken, and the manager does not react")
            elif now - max(since, self._counts_from(process)) > REFLEX and self.oracle.reflex_applies(
                self._shown[ref.instance], ref.functionality, received(process)
            ):
                self._violation(f"{self._stays(ref)} is broken for more than {REFLEX:g} s")

    def _lacks_server(self, ref: FunctionalityRef, process: StandIn, now: float) -> bool:
        """Return whether its mode should have been left, since a server is gone that it had."""
        if not self.oracle.assumes_one_of(self._shown[ref.instance], ref.functionality, process.lost_servers()):
            self._serverless.pop(ref, None)
            return False
        return now - self._serverless.setdefault(ref, now) > CLIENT_REFLEX

    def _stays(self, ref: FunctionalityRef) -> str:
        mode = dict(self._shown[ref.instance].modes)[ref.functionality]
        return f"{ref} stays in mode {mode} although what it assumes there"

    def _violation(self, words: str) -> None:
        if words not in self._reported:
            self._reported.add(words)
            self.violated(words)
