"""Ports: what the author writes to and reads from, and their attachments to topics.

A port is connected to nothing until the manager attaches it (docs/semantics.md section 2). Writing and receiving are
the data path: a gate and a counter on top of the middleware, without locks or logging. All of it runs on the data
thread; other threads only read counters.
"""

from __future__ import annotations

import copy
from collections import deque
from collections.abc import Callable, Sequence
from typing import Any, Final, Generic, Literal, Protocol, TypeAlias, TypeVar

from midstride.errors import NodeError
from midstride.model.contract import Predicate, QoS
from midstride.node.author.declared_contracts import Guarantee, type_name
from midstride.node.author.field_checks import FieldChecks
from midstride.node.author.message_times import MessageTimes, window_of
from midstride.node.author.write_lease import WriteLease
from midstride.node.component_host import Host, Publisher, Subscription
from midstride.wire.state import GateState, LinkState, Measured

# How many receipts an input keeps while it does not record: enough to look back 20 periods.
REMEMBERED: Final = 64
# How many it keeps while it records; the oldest are dropped first.
RECORDED: Final = 200_000

# How many messages are kept for late joiners of a transient-local output whose history has no bound.
MOST_KEPT: Final = 1000

# How long after a message of a program outside a cut is, as a share of its period: more than its jitter.
AFTER: Final = 0.25

Listener = Callable[[Any, Any], None]
Driven: TypeAlias = Literal["rate", "message", "none"]


class GatePolicy(Protocol):
    """A cut in progress: decides, write by write, what passes a gate (midstride.node.handover.cut)."""

    def passes(self, link: OutputLink) -> bool:
        """Return whether a message that is written now may be published."""

    def admits(self, link: OutputLink) -> bool:
        """True where it passes, and will: the other side of the cut publishes nothing from now on."""

    def publish(self, link: OutputLink, message: Any) -> bool:
        """Publish and count ``message`` if it passes; whether it does."""

    def shows(self, link: OutputLink) -> GateState: ...


class TimeGrid(Protocol):
    """The slots of a rate-driven mode: ``period`` (s), and the slot of its last call (ns)."""

    period: float
    slot: int | None

    def regrid(self, epoch: int) -> None:
        """Continue along the grid through ``epoch`` (ns)."""


class OutputOwner(Protocol):
    """The running functionality that an output belongs to, as far as its attachments need to know it."""

    # Since when a call has been running (steady ns).
    busy: int | None = None
    # What places that call in time: the first and the last slot that it accounts for, or the info of the messages that
    # it answers.
    slots: tuple[int, int] | None = None
    info: Any = None
    # During a cut, called with the info of every message that reaches the functionality.
    watch: Callable[[Any], None] | None = None
    # Whether it is in its mode because user code raised.
    failed: bool = False
    # From how many calls user code has returned in this mode.
    calls: int = 0

    @property
    def driven(self) -> Driven: ...

    @property
    def rate(self) -> TimeGrid | None: ...

    @property
    def driving(self) -> Sequence[Input]:
        """The inputs whose messages it is called for."""


class OutputLink:
    """One attachment of an output: a publisher behind a gate. Created closed.

    ``count`` is the number of published messages, as the middleware counts them; ``gated`` that of the others.
    ``times`` has the writes of both. ``lease``: that of the component, without which nothing passes once it is over.
    """

    __slots__ = (
        "count",
        "cut",
        "endpoint",
        "gated",
        "held",
        "kept",
        "lease",
        "open",
        "output",
        "publish",
        "set_by",
        "times",
        "topic",
    )

    def __init__(
        self, output: Output, topic: str, publisher: Publisher, times: MessageTimes, lease: WriteLease | None = None
    ) -> None:
        self.output = output
        self.lease = lease
        self.topic = topic
        self.times = times
        self.endpoint = publisher
        self.publish: Callable[[Any], None] = publisher.publish
        self.open = False
        self.count = 0
        self.gated = 0
        # The newest that the gate has held back, which late joiners shall have: one, or of a transient-local output
        # without a rate as many as its depth.
        self.kept: deque[Any] = deque(maxlen=output.kept.maxlen)
        # What the gate has held back since the old side of a cut closed it, as long as that side may write again.
        self.held: deque[Any] | None = None
        self.cut: GatePolicy | None = None
        # What has set the gate last, where that was the end of a cut.
        self.set_by: GatePolicy | None = None

    @property
    def lets_pass(self) -> bool:
        """Return whether a message that is written now is published."""
        return not self.is_silenced and (self.open or (self.cut is not None and self.cut.passes(self)))

    @property
    def is_live(self) -> bool:
        """True if the output publishes now what the author writes, so that acting on it makes sense."""
        return not self.is_silenced and (self.open or (self.cut is not None and self.cut.admits(self)))

    @property
    def is_silenced(self) -> bool:
        """Return whether nothing passes, however the gate is set: it is fenced, or its lease is over."""
        return self.is_fenced or (self.lease is not None and self.lease.is_over)

    @property
    def is_fenced(self) -> bool:
        """Return whether a command has fenced it."""
        return self.publish == self._drop

    def fence(self, on: bool) -> None:
        """Let nothing pass from now on, however the gate is set, or lift that. On the control thread.

        It replaces what every message passes in the end, which the data thread never sets: so no command that still
        waits for that thread can open the gate again. One that is being published meanwhile is not held up.
        """
        self.publish = self._drop if on else self._unfenced()

    def follow_lease(self) -> None:
        """The component has a lease now, or has none any more."""
        if not self.is_fenced:
            self.publish = self._unfenced()

    def replace_endpoint(self, publisher: Publisher) -> None:
        """Publish with another publisher, so that what the one before has not delivered is never delivered."""
        before, self.endpoint = self.endpoint, publisher
        self.follow_lease()
        before.destroy()

    def _unfenced(self) -> Callable[[Any], None]:
        leased = self.lease is not None and self.lease.until is not None
        return self._publish_leased if leased else self.endpoint.publish

    def _publish_leased(self, message: Any) -> None:
        if self.lease is not None and self.lease.is_over:
            self._drop(message)
        else:
            self.endpoint.publish(message)

    def _drop(self, message: Any) -> None:
        """In the place of ``publish``: its callers count a message that has passed."""
        self.count -= 1
        self.gated += 1

    def write_gated(self, message: Any) -> None:
        """A write while the gate is not open: a cut may let it pass, else it is counted, and kept for late joiners."""
        cut = self.cut
        if cut is None or not cut.publish(self, message):
            self.gated += 1
            self.output.keep(message, self.kept)
            if self.held is not None:
                self.held.append(copy.deepcopy(message))  # the author may fill and write the same object again

    def write_kept(self) -> bool:
        """Publish the newest that the gate has held back, for late joiners; whether there was any."""
        for message in self.kept:
            self.publish(message)
            self.count += 1
        return bool(self.kept)

    def set_gate(self, open_: bool, by: GatePolicy | None = None) -> None:
        """Open or close the gate, and take this attachment out of its cut; ``by`` the end of a cut."""
        self.set_by = by
        self.open = open_
        self.cut = None

    def enter(self, cut: GatePolicy) -> None:
        """From now on, ``cut`` decides what passes."""
        self.cut = cut
        self.open = False
        self.set_by = None

    def destroy(self) -> None:
        self.set_gate(False)
        self.output.remove(self)

    @property
    def fields(self) -> FieldChecks:
        return self.output.fields

    @property
    def gate(self) -> GateState:
        if self.is_fenced:
            return "closed"
        if self.cut is not None:
            return self.cut.shows(self)
        return "open" if self.open else "closed"

    def __str__(self) -> str:
        return f"{self.output.name} {self.topic}"


class InputLink:
    """One attachment of an input: a subscription without a gate, and the number and times of its messages.

    ``violating`` of them did not meet the constraints on their fields, or came after one that did not and before one
    that did (they are sampled).
    """

    __slots__ = ("count", "endpoint", "fields", "input", "times", "topic", "violating")
    endpoint: Subscription
    gate: Final = None
    gated: Final = 0
    is_silenced: Final = False

    def __init__(self, input: Input, topic: str, times: MessageTimes) -> None:
        self.input = input
        self.topic = topic
        self.times = times
        self.fields = FieldChecks(input.assumption.fields, input.decode)
        self.count = self.violating = 0

    def destroy(self) -> None:
        self.input.remove(self)


L = TypeVar("L", OutputLink, InputLink)


class _Port(Generic[L]):
    """A port, with its attachments: one for each topic."""

    links: tuple[L, ...] = ()

    #: The rate (Hz) that is declared for its messages now, None where none is.
    rate: float | None = None

    @property
    def measured(self) -> dict[str, Measured]:
        """By topic: rate, age and jitter of its messages, as measured on the component's ROS clock."""
        window = window_of(self.rate)
        return {link.topic: link.times.measured(window) for link in self.links}

    def states(self) -> dict[str, LinkState]:
        """By topic: the attachments as reported. Read without waiting for the data thread."""
        window = window_of(self.rate)
        return {
            link.topic: LinkState(
                gate=link.gate,
                count=link.count,
                gated=link.gated,
                measured=link.times.measured(window),
                fields=link.fields.samples(),
                fenced=link.is_silenced,
            )
            for link in self.links
        }

    @property
    def attached(self) -> bool:
        """Return whether the port is attached to a topic."""
        return bool(self.links)

    def link(self, topic: str) -> L | None:
        return next((link for link in self.links if link.topic == topic), None)

    def remove(self, link: L) -> None:
        """Remove an attachment and destroy its endpoint; does nothing if that has been done."""
        if link in self.links:
            self.links = tuple(other for other in self.links if other is not link)
            link.endpoint.destroy()


class Output(_Port[OutputLink]):
    """An output port. Created by ``Component.create_output``.

    Write only in mode functions, ``on_stop``, ``on_change`` and callbacks of the ROS 2 node, which all run on one
    thread. Do not write from other threads, such as those of rospy's callbacks: there is no lock.
    """

    # From when the component runs.
    owner: OutputOwner

    def __init__(self, name: str, type_: type, qos: QoS) -> None:
        self.name = name
        self.type = type_
        self.qos = qos
        self.unattached = 0
        # The newest messages of a transient-local output, else the last one that was written while unattached.
        effective = qos.effective()
        self.latched = effective.durability == "transient_local"
        depth = MOST_KEPT if effective.history == "keep_all" else effective.depth or 1
        self.kept: deque[Any] = deque(maxlen=depth if self.latched else 1)
        # Whether a program outside writes it, on a grid that is only known by its messages (midstride.foreign.relay).
        self.relayed = False
        self.wrong_type: str | None = None
        self.fields = FieldChecks()

    def guaranteed(self, promise: Guarantee) -> Predicate:
        """The guarantee of a mode with this ``promise``, in the model's terms."""
        return Predicate(type_name(self.type), promise.rate, self.qos, promise.where)

    def promise(self, guaranteed: Guarantee) -> None:
        """Set the guarantee of the current mode, from now on; a rate that has changed is measured afresh."""
        self.fields.require(guaranteed.where)
        if guaranteed.rate != self.rate:
            self.rate = guaranteed.rate
            for link in self.links:
                link.times.restart()

    def write(self, message: Any) -> None:
        """Publish ``message`` on every topic that the output is attached to.

        While the output is attached to no topic, or its gate is closed (before and after a hand-over), the message is
        counted and not published (docs/protocols/probation.md). Raises NodeError if it is not of the output's type.
        """
        if message.__class__ is not self.type and not isinstance(message, self.type):
            self.wrong_type = f"output {self.name} takes {type_name(self.type)}, not {type(message).__name__}"
            raise NodeError(f"{self.wrong_type}; write {self.name}.write({self.type.__name__}(…))")
        links = self.links
        if self.latched or not links:
            self.keep(message, self.kept)
        if not links:
            self.unattached += 1
        now = 0
        for link in links:
            now = link.times.mark()
            if link.open:
                link.publish(message)
                link.count += 1
            else:
                link.write_gated(message)
        if links and self.fields.active:
            self.fields.sample(message, now)

    def forget_kept(self) -> None:
        """Note that a mode is left that writes again and again: its last message is repeated to no one, unless latched.

        What a program outside writes is of no mode.
        """
        if not (self.latched or self.relayed):
            for kept in (self.kept, *(link.kept for link in self.links)):
                kept.clear()

    def keep(self, message: Any, kept: deque[Any]) -> None:
        """Add ``message`` to those that are ``kept`` for late joiners. Where there is a rate, the newest is enough."""
        if self.rate is not None:
            kept.clear()
        elif self.latched:
            message = copy.deepcopy(message)  # the author may fill and write the same object again
        kept.append(message)

    def observed_grid(self) -> tuple[int, float] | None:
        """The grid of messages at a steady rate: a moment shortly after one of them (ns), and their period (s).

        A cut at such a moment leaves the new side the whole period that follows.
        """
        for link in self.links if self.rate is not None else ():
            measured = link.times.measured(window_of(self.rate))
            if measured.rate and (last := link.times.last()):
                return last + int(AFTER / measured.rate * 1e9), 1 / measured.rate
        return None

    @property
    def count(self) -> int:
        """The number of messages that the author has written, published or not."""
        count = self.unattached
        for link in self.links:  # a loop, as below: the reflex asks ten times a second
            count += link.count + link.gated
        return count

    def __repr__(self) -> str:
        return f"<output {self.name}: {type_name(self.type)}>"


class Input(_Port[InputLink]):
    """An input port. Created by ``Component.create_input``.

    ``rate`` (Hz) is what it relies on, and ``tolerates`` how many missed messages in succession it tolerates; None if
    nothing is stated. ``condition``: its last message decides whether what it assumes holds. The manager attaches it
    with those of the specification (docs/protocols/reflex.md).
    """

    def __init__(
        self, name: str, type_: type, assumption: Predicate, tolerates: int | None = None, condition: bool = False
    ) -> None:
        self.name = name
        self.type = type_
        self.assumption = assumption
        deadline = assumption.qos.deadline
        self.rate = 1 / deadline if assumption.rate is None and deadline else assumption.rate
        self.tolerates = tolerates
        self.condition = condition
        # Reads messages that stay serialised, where their fields are checked.
        self.decode: Callable[[Any], Any] | None = None
        # Called on the data thread when a message of a condition decides otherwise than the one before.
        self.condition_changed: Callable[[], object] = lambda: None
        #: The newest message since the input was attached; None if there is none.
        self.latest: Any = None
        self.listeners: tuple[Listener, ...] = ()
        self.receipts: deque[tuple[int, Any]] = deque(maxlen=REMEMBERED)
        self._received_at: int | None = None
        self._now: Callable[[], int] | None = None

    @property
    def age(self) -> float | None:
        """The seconds of the ROS clock since ``latest`` arrived; None if there is no message."""
        if self._received_at is None or self._now is None:
            return None
        return (self._now() - self._received_at) / 1e9

    def receiver(self, link: InputLink, host: Host) -> Callable[[Any, Any], None]:
        """The callback of one subscription. On the data path: it uses local variables and attributes only."""
        mark, steady, fields = link.times.mark, host.steady, link.fields
        self._now = host.now

        def receive(message: Any, info: Any) -> None:
            self.receipts.append((steady(), info))
            self.latest = message
            self._received_at = now = mark()
            link.count += 1
            if fields.active:
                if self.condition:
                    self._decide(fields, message)
                else:
                    fields.sample(message, now)
                link.violating += fields.violated
            for listener in self.listeners:
                listener(message, info)

        return receive

    def _decide(self, fields: FieldChecks, message: Any) -> None:
        before = fields.violated
        fields.check(message)
        if fields.violated != before:
            self.condition_changed()

    @property
    def denied(self) -> bool:
        """Return whether the input is a condition that does not hold, by the last message on every topic that it has
        received.
        """
        if not self.condition:
            return False
        received = [link for link in self.links if link.count]
        return bool(received) and all(link.fields.violated for link in received)

    def last_receipts(self) -> tuple[tuple[int, Any], ...]:
        """The times of the last receipts (steady, ns), each with the middleware's report. On any thread."""
        return tuple(self.receipts)[-REMEMBERED:]

    def remove(self, link: InputLink) -> None:
        super().remove(link)
        if not self.links:
            self.latest = self._received_at = None

    @property
    def count(self) -> int:
        """The number of messages received since it was attached, without those that violate its constraints."""
        count = 0
        for link in self.links:
            count += link.count - link.violating
        return count

    @property
    def violations(self) -> list[str]:
        """The constraints that the last messages did not meet, with the fields' values."""
        return [
            f"{path} is {samples.last}, {path} {samples.constraint} is assumed"
            for link in self.links
            for path, samples in link.fields.samples().items()
            if samples.run
        ]

    @property
    def recording(self) -> bool:
        """Return whether the input records, as while a plan exchanges publishers of its topic."""
        return self.receipts.maxlen == RECORDED

    def record(self, on: bool) -> None:
        """Keep every receipt from now on, or only the last few; earlier ones are kept."""
        self.receipts = deque(self.receipts, maxlen=RECORDED if on else REMEMBERED)

    def __repr__(self) -> str:
        return f"<input {self.name}: {self.assumption}>"


class AnyOf:
    """Inputs that are alternatives: one of them suffices. Created by :func:`any_of`."""

    def __init__(self, inputs: tuple[Input, ...]) -> None:
        self.inputs = inputs

    def __repr__(self) -> str:
        return f"any_of({', '.join(port.name for port in self.inputs)})"


def any_of(*inputs: Input) -> AnyOf:
    """An assumption that any one of several inputs can meet: ``inputs=[any_of(left, right)]``.

    This is a named assumption of docs/semantics.md section 2. Raises NodeError for fewer than two inputs, or for
    anything that is not an input.
    """
    for port in inputs:
        if not isinstance(port, Input):
            raise NodeError(f"any_of(): {port!r} is not an input; write what create_input returned")
    if len(inputs) < 2:
        raise NodeError("any_of() takes at least two inputs; for one, write inputs=[scan]")
    return AnyOf(inputs)
