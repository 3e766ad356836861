"""The gates of one node in the page: what its attachments let pass, and the baton that it shares at a hand-over."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from typing import Final

from midstride.errors import BackendError
from midstride.foreign.page import GET_RESULT, KnownGoal, KnownSetting, Page
from midstride.foreign.page_layout import (
    CLOSED,
    INPUT,
    LISTS,
    NAMES_ONE,
    OPEN,
    OUTPUT,
    GoalState,
    PagePort,
    PortFlag,
    Within,
)
from midstride.foreign.sharing_components import has_joined, place, share_requests
from midstride.model.component import ComponentSpec
from midstride.node.handover.baton import BatonState, BatonStep, BatonWord
from midstride.wire.replies import PagePlace

# How many messages in a row must each have answered an input, for a node to count as one that answers messages.
SEEN: Final = 2
# For how long a writer without a rate leaves the baton to its successor (s).
PATIENCE: Final = 2.0
# How a serialized message begins whose numbers are so.
_LITTLE_ENDIAN: Final = b"\0\1\0\0"


@dataclass
class Gates:
    """The gates of the node ``index`` of ``page``, whose ports are those of ``component``, in its order."""

    page: Page
    index: int
    component: ComponentSpec

    def __post_init__(self) -> None:
        self._names = tuple(self.component.ports())
        self._entries = dict(zip(self._names, self.page.ports(self.index), strict=False))

    def entry(self, port: str) -> PagePort:
        """The part of a port in the page. Raises BackendError where the page has none: it is not that of the node."""
        if (found := self._entries.get(port)) is None:
            raise BackendError(f"{self.page.path} has no port {port} of its node {self.index}")
        return found

    def prepare(self, topics: dict[str, str], predecessor: int | None = None) -> None:
        """Before the process starts: outputs are closed, inputs open (what is latched arrives when it subscribes).

        Requests to its services are answered by the node ``predecessor`` (index), where there is one, until this one
        is to answer them. The same holds for what it writes on topics that are no ports.

        Where the component states no ports yet, the library adds one for each topic, for `midstride capture --probe`.
        """
        listed = [(topics[port], OUTPUT if self.component.has_output(port) else INPUT) for port in self._names]
        self.page.set_ports(self.index, listed)
        self._entries = dict(zip(self._names, self.page.ports(self.index), strict=True))
        if not listed:
            self.page.layout.nodes[self.index].used |= LISTS
        self.prepare_requests(predecessor)
        self.page.have_unstated(self.index, PATIENCE, predecessor)
        baton = self.page.new_baton(self.index)
        for port in self._names:
            entry = self.entry(port)
            if self.component.has_output(port):
                entry.baton = baton
                rate = self.rate(port)
                entry.flags = PortFlag.ANSWERS if rate else PortFlag.KEEPS | PortFlag.ANSWERS
                entry.half = int(min(5e5 / rate, 2**32 - 1)) if rate else 0
                entry.within = Within.KEEP_OUT
            else:
                entry.gate = OPEN

    def prepare_requests(self, predecessor: int | None = None) -> None:
        """Before the process starts, the requests to its services alone: no topic gets a gate."""
        # Else the name is passed for one node only, or none.
        if not self.component.unnamed and self.component.renames is None:
            self.page.layout.nodes[self.index].used |= NAMES_ONE
        self.page.have_requests(self.index, predecessor)

    def rate(self, port: str) -> float | None:
        """Return the rate that an output guarantees in its normal mode (Hz); None if none, or if it is lazy."""
        owner = None if port in self.component.lazy else self.component.find_owner(port)
        return None if owner is None else self.component.stated_rate(port, {owner.name: owner.modes[0].name})

    def missing(self) -> list[str]:
        """The ports for which the process has created no endpoint, but for those that come and go."""
        return [port for port in self._names if not self.entry(port).endpoints and port not in self.component.lazy]

    def set_gate(self, port: str, open: bool) -> None:
        self.entry(port).gate = OPEN if open else CLOSED
        self.page.ring(self.index)

    # -- hand-over -------------------------------------------------------------------------------------

    def share(self, ports: Iterable[str], baton: int | None = None) -> int:
        """Have these outputs alone decided by one baton: of that number, or that of the first of them; its number."""
        ports = list(ports)
        shared = int(self.entry(ports[0]).baton) if baton is None else baton
        for port in self.component.outputs:
            if port not in ports:
                self.entry(port).baton = 0
        share_baton(self.page, [(self.entry(port), self.rate(port)) for port in ports], shared)
        return shared

    def share_answers(self, ports: Iterable[str], baton: int, other: int) -> None:
        """Have ``baton``, of the node ``other`` (index), pass between two inputs: one of the two answers each."""
        wanted = {self.entry(port).topic for port in ports}
        for port in self.component.outputs:
            if self.entry(port).topic not in wanted:
                self.entry(port).baton = 0
        for index in (other, self.index):
            entries = [entry for entry in self.page.ports(index) if entry.kind == OUTPUT and entry.topic in wanted]
            share_baton(self.page, [(entry, None) for entry in entries], baton, PortFlag.ANSWERS)

    def answers_as(self, other: int, ports: Iterable[str]) -> bool:
        """Return whether this node and the node ``other`` (index) have each answered the same inputs on these outputs.

        One message for each, in the thread that has taken it, as far as the library in both has seen. Of each topic,
        the other node has answered an input that this one had taken: else it may still have to answer some that came
        before this one was there.
        """
        nodes = self.page.layout.nodes
        if not nodes[other].requests or nodes[other].requests != nodes[self.index].requests:
            return False
        theirs = {entry.topic: entry for entry in self.page.ports(other) if entry.kind == OUTPUT}

        def answers(own: PagePort) -> bool:
            old = theirs.get(own.topic)
            if old is None or old.in_step < SEEN or own.in_step < 1:
                return False
            return bool(old.answers == own.answers == own.overlaps & own.answers)

        return all(answers(self.entry(port)) for port in ports)

    def falls(self, other: int, ports: Collection[str]) -> list[int]:
        """Return how often these outputs of this node, and then of the node ``other`` (index), have ceased to do so."""
        topics = {self.entry(port).topic for port in ports}
        theirs = [entry for entry in self.page.ports(other) if entry.kind == OUTPUT and entry.topic in topics]
        return [int(entry.falls) for entry in (*map(self.entry, ports), *theirs)]

    def answers_inputs(self, port: str) -> bool:
        """Return whether each of the last messages of an output has answered one message that the node had taken."""
        return int(self.entry(port).in_step) >= SEEN

    def is_kept_out(self, port: str) -> bool:
        """Return whether a publisher of an output would use intra-process communication without its gate."""
        return bool(self.entry(port).within & Within.KEPT_OUT)

    def past_the_gate(self) -> list[str]:
        """The outputs of which subscriptions of the process may get messages that the gate does not see."""
        return [port for port in self.component.outputs if self.entry(port).within & Within.TAKES_PART]

    def baton(self, port: str) -> int:
        return int(self.entry(port).baton)

    def word(self, port: str) -> BatonWord:
        return self.page.word(self.baton(port))

    def has_it(self, port: str) -> bool:
        """Return whether this node holds the baton of ``port``, or the gate alone decides."""
        return not self.baton(port) or self.word(port).holder == self.index + 1

    def fenced(self, port: str) -> bool:
        return bool(self.baton(port)) and self.has_it(port) and self.word(port).state is BatonState.FENCED

    def step(self, baton: int, step: BatonStep, successor: int = -1, at_once: bool = False) -> BatonWord:
        """Take ``step`` as this node; the word after it."""
        self.page.step(baton, step, self.index, successor, at_once)
        self.page.ring(self.index)
        return self.page.word(baton)

    # -- topics that are no ports ----------------------------------------------------------------------

    @property
    def unstated(self) -> int:
        """The baton of the topics that are no ports, which the instances of its role share."""
        return int(self.page.layout.nodes[self.index].unstated)

    @property
    def writes_unstated(self) -> bool:
        """Return whether it is this node that may write on topics that are no ports."""
        return not self.unstated or self.page.word(self.unstated).holder == self.index + 1

    def unstated_topics(self) -> set[str]:
        """The topics that are no ports, by full name, that are handed over to a replacement with this kind of gate.

        Not those on which subscriptions of its process may get messages past the gate.
        """
        return {topic for topic, port in self.page.unstated(self.index).items() if not port.within & Within.TAKES_PART}

    def has_readers_of(self, other: int) -> bool:
        """Return whether it has as many readers as the node ``other`` on each topic that is no port of either."""
        theirs = self.page.unstated(other)
        return all(
            port.matched >= theirs[topic].matched
            for topic, port in self.page.unstated(self.index).items()
            if topic in theirs
        )

    def take_unstated(self) -> bool:
        """Take a step towards writing on topics that are no ports; whether this node may."""
        baton, word = self.unstated, self.page.word(self.unstated)
        if word.holder == self.index + 1:
            self.step(baton, BatonStep.WITHDRAW)
            return True
        self.page.step(baton, BatonStep.NAME_SUCCESSOR, word.holder - 1, self.index, at_once=True)
        return self.step(baton, BatonStep.TAKE).holder == self.index + 1

    # -- state that moves ------------------------------------------------------------------------------

    def hold_back(self, ports: Iterable[str], baton: int, longest: float) -> None:
        """Have this node leave ``baton``, once it offers it, for ``longest`` (s), also where no successor takes it.

        It publishes nothing on ``ports`` meanwhile.
        """
        self.page.layout.batons[baton - 1].patience = int(longest * 1e9)
        for port in ports:
            kept = PortFlag(0) if self.rate(port) else PortFlag.KEEPS
            self.entry(port).flags = PortFlag.TIMED | PortFlag.OFFERS | kept

    def wait_for_manager(self, ports: Iterable[str], *, keeping: bool) -> None:
        """Have this node, a successor, take the baton of ``ports`` only as the manager does it for the node.

        ``keeping``: of what it writes meanwhile without a rate, the last is kept; else it forgets what it has kept.
        """
        for port in ports:
            self.entry(port).flags = PortFlag.KEEPS if keeping and not self.rate(port) else PortFlag(0)
        self.page.ring(self.index)

    # -- requests to its services ----------------------------------------------------------------------

    @property
    def answers(self) -> bool:
        """Return whether this node answers requests to the services that the instances of its role share."""
        return self.page.answering(self.index) is None

    def answer(self, patience: float) -> None:
        """Have this node answer, once the one that does has answered what it has taken, or ``patience`` (s) is over."""
        other = self.page.answering(self.index)
        self.page.give_requests(self.index, patience)
        for index in (self.index, other):
            if index is not None:
                self.page.ring(index)

    def share_requests(self, instance: str) -> PagePlace | None:
        """Have the component ``instance``, with Midstride's API, join to share the requests to this node.

        None where this node has no library that claims any. Raises BackendError.
        """
        if not instance or not self.page.layout.nodes[self.index].pid:
            return None
        return place(self.page, share_requests(self.page, instance, self.index))

    def to_be_joined(self, other: int) -> PagePlace | None:
        """The place where the node ``other`` (index), a component, is to join first; None where it has, or is none."""
        return None if has_joined(self.page, other) else place(self.page, other)

    def settings(self) -> list[KnownSetting]:
        """The requests to set parameters that this node has taken, in their order. Raises BackendError."""
        return self.page.settings(self.index)

    def seen_services(self, process: int | None = None) -> set[str]:
        """The services, by full name, that the library has seen of this node, and of the node ``process`` (index).

        None at all: it may see none, as that of ROS 2 Humble.
        """
        indices = {self.index, self.index if process is None else process}
        return {name for index in indices for name in self.page.servers(index)}

    def taken(self, service: str) -> int | None:
        """The number of requests to the service of that full name that this node has taken; None if it has no such.

        Those of the manager to this node alone do not count.
        """
        port = self.page.servers(self.index).get(service)
        return None if port is None else int(port.passed)

    def has_clients_of(self, other: int) -> bool:
        """Return whether each service that the node ``other`` has, too, shows as many clients to this one."""
        theirs = self.page.servers(other)
        return all(
            port.matched >= theirs[name].matched
            for name, port in self.page.servers(self.index).items()
            if name in theirs
        )

    @property
    def begun(self) -> bool:
        """Return whether this node answers, and the one before has answered all that it had taken."""
        before = self.page.answered_before(self.index)
        return self.answers and (before is None or not self.page.layout.nodes[before].unanswered)

    @property
    def succeeded(self) -> bool:
        """Return whether another node answers now, instead of this one."""
        return self.page.answered_before(self.index) == self.index

    def answered_all(self, linger: float) -> bool:
        """Return whether this node has answered all that it has taken, the last at least ``linger`` (s) ago.

        What it holds that no node has taken is waited for as well.
        """
        node = self.page.layout.nodes[self.index]
        age = (time.monotonic_ns() - node.answered) / 1e9
        waiting = any(port.gated for port in self.page.servers(self.index).values())
        return not node.unanswered and not waiting and age >= linger

    def pause(self, longest: float) -> None:
        """Have no instance of the role take a request until :meth:`resume`, for ``longest`` (s) at most."""
        self.page.pause_requests(self.index, longest)

    def resume(self, other: int) -> None:
        """Have the instance that answers, this or the ``other`` one (index), take what was held meanwhile."""
        self.page.resume_requests(self.index)
        for index in (self.index, other):
            self.page.ring(index)

    # -- goals of its ROS actions ----------------------------------------------------------------------

    def goals(self, *states: GoalState) -> Counter[str]:
        """The number of goals of each ROS action that it has in one of these states; without any, that are not over."""
        wanted = states or (GoalState.RESERVED, GoalState.ASKED, GoalState.ACCEPTED, GoalState.ENDED)
        return Counter(goal.action for goal in self.page.goals(self.index) if goal.state in wanted)

    @property
    def goals_beyond(self) -> int:
        """The number of goals in progress for which the page has no room."""
        return int(self.page.layout.nodes[self.index].beyond)

    @property
    def goals_apart(self) -> int:
        """The number of its goals for which the page has no room: in progress, or with a result to be fetched."""
        return int(self.page.layout.nodes[self.index].apart)

    def unfetched(self) -> list[KnownGoal]:
        """The goals that have ended, and whose results no client has fetched."""
        return [goal for goal in self.page.goals(self.index) if goal.state is GoalState.ENDED]

    def ask_for_result(self, goal: KnownGoal) -> int:
        """Ask the node for the result of ``goal``; the number of the request. Raises BackendError."""
        return self.page.ask(self.index, goal.action + GET_RESULT, _LITTLE_ENDIAN + goal.id)

    def keep_result(self, goal: KnownGoal, number: int) -> bool:
        """Keep the result that the node has given to the request ``number``; whether it has. Raises BackendError.

        The place of the goal becomes that of one that the page had no room for, if there is such a one.
        """
        response = self.page.response(self.index, number)
        if response is not None:
            self.page.keep_result(goal.id, response)
            if self.goals_apart:
                self.page.forget_goal(self.index, goal)
        return response is not None

    def cancel_goals(self) -> None:
        self.page.cancel_goals(self.index)

    # -- what has passed -------------------------------------------------------------------------------

    def total(self, port: str) -> int:
        """The number of messages that an output has published or held back, or an input has received or dropped."""
        return total(self.entry(port))

    def age(self, port: str) -> float | None:
        """Seconds since the last message that was published or held back, or received; None before the first."""
        tried = self.entry(port).tried
        return max(0, time.monotonic_ns() - tried) / 1e9 if tried else None


def total(entry: PagePort) -> int:
    """The number of messages that a port has let pass and held back, in all.

    Of an output that takes part in intra-process communication: how many it has published, each once.
    """
    return int(entry.written if entry.inside else entry.passed + entry.gated)


def share_baton(
    page: Page,
    outputs: Sequence[tuple[PagePort, float | None]],
    baton: int,
    besides: PortFlag = PortFlag(0),  # noqa: B008  # immutable
) -> None:
    """Have one baton decide for these outputs of a node, each with its rate (Hz); ``besides``: further flags of each.

    The baton is offered after a write of the slowest output that has a rate. Where none has one, it is offered at
    any time, and left to the successor for ``PATIENCE``.
    """
    page.layout.batons[baton - 1].patience = int(PATIENCE * 1e9)
    slowest = min((rate for _, rate in outputs if rate), default=None)
    offering = False
    for entry, rate in outputs:
        if slowest is None:
            flags = PortFlag.KEEPS | PortFlag.TIMED | PortFlag.OFFERS
        elif not rate:
            flags = PortFlag.KEEPS
        else:
            offers = rate == slowest and not offering
            offering |= offers
            flags = PortFlag.RATED | (PortFlag.OFFERS if offers else PortFlag(0))
        entry.flags = flags | besides
        entry.baton = baton
