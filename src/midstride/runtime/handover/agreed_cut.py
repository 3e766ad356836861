"""The cut of a hand-over: the moment from which the new publisher publishes instead of the old one.

It is a slot of the old publisher's time grid, agreed in advance (docs/protocols/cut.md). Before that, both sides
must follow the same clock, and the subscribers must have found the new publisher.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import uuid
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Final

from immutables import Map
from msgspec import structs

from midstride.errors import CallTimeout, StepFailed, Unreachable
from midstride.model.action import Swap
from midstride.model.component import PortRef
from midstride.model.configuration import Configuration
from midstride.runtime.backend_protocol import Backend
from midstride.runtime.handover.arbiter_choice import LEASE, ArbiterKind, choose_arbiter
from midstride.runtime.process.component_client import ComponentClient
from midstride.wire.clock_offset import SAME_CLOCK, ClockOffset
from midstride.wire.commands import (
    LEASE_SLACK,
    AwaitMatchCommand,
    CutInCommand,
    CutOutCommand,
    CutSwap,
    GridCommand,
    SharedSlotPort,
    ShareSlotCommand,
    StateTransfer,
)
from midstride.wire.replies import CutClock, Grid, SharedSlotPlace, TriggerKind

# The old side resumes if the new side has not reported its first write for this many periods,
RESUME_PERIODS: Final = 10
# but at least for this long (s), which is more than the jitter of a busy machine.
SHORTEST_RESUME: Final = 0.1
# The same if no rate defines a period (s).
RESUME_WITHOUT_RATE: Final = 2.0
# How long a subscriber may take to find the new publishers (s).
FIND_TIMEOUT: Final = 5.0
# How long a new side may wait at a cut until the old one has published, or passed on, what was before (s).
ORDER_TIMEOUT: Final = 1.0
# How often, and at which interval (s), a subscriber may still count a publisher that has left.
LEAVE_ATTEMPTS: Final = 10
LEAVE_INTERVAL: Final = 0.05
# How often, and at which interval (s), the manager looks for a new publisher that others may have found.
IDENTITY_INTERVAL: Final = 0.05
IDENTITY_ATTEMPTS: Final = round(FIND_TIMEOUT / IDENTITY_INTERVAL)


@dataclass(slots=True)
class Cut:
    """One cut between two components, for the outputs of one functionality, which share a time grid.

    ``lead`` is how far ahead it was agreed (s); ``state`` how state moves at the cuts of these two components.
    ``quiet``: neither side writes, so the new one takes over without a message too. ``lease``: how long the new side
    may write at a time before its first write is confirmed (s); 0 where a lock decides, or a baton. ``offset``: how
    far the clock of the new side's host is ahead of that of the old one's, where the cut is on those.
    """

    configuration: Configuration
    old: str
    new: str
    arbiter: ArbiterKind
    swaps: list[Swap] = field(default_factory=list)
    id: str = field(default_factory=lambda: uuid.uuid4().hex)
    trigger: TriggerKind = "none"
    clock: CutClock = "ros"
    epoch: int | None = None
    period: float | None = None
    at: int = 0
    lead: float = 0.0
    state: StateTransfer | None = None
    quiet: bool = False
    lease: float = 0.0
    offset: ClockOffset = SAME_CLOCK

    @property
    def timeline(self) -> tuple[str, CutClock]:
        """The clock of its moment: that of a host."""
        return self.configuration.instances[self.old].host, self.clock

    @property
    def in_order(self) -> bool:
        """Return whether the new side waits for the old one's last message, as their clocks are not known so well."""
        return self.period is not None and self.offset.uncertainty > self.period / 2 * 1e9

    @property
    def shift(self) -> int:
        """By how much the moment is later on the clock of the new side's host (ns).

        It is the latest moment that may be meant, so that the new side does not begin before the old one has ended;
        where it waits for that anyway, the earliest.
        """
        return self.offset.ahead + (-self.offset.uncertainty if self.in_order else self.offset.uncertainty)

    def resume_after(self) -> float:
        """The time that the old side waits for the new one's first write (s, on the clock of the cut)."""
        # Between hosts, the new one may begin later by twice the uncertainty, which is half a round trip; and reports.
        late = 4 * self.offset.uncertainty / 1e9
        period = self.period if self.period is not None else self._declared_period()
        if period is None:
            return RESUME_WITHOUT_RATE + late
        # The old side then writes in its next slot, which may be a period later.
        return max((RESUME_PERIODS - 1) * period, SHORTEST_RESUME) + late

    def _declared_period(self) -> float | None:
        """The longest of the periods that the cut's topics require; None if one states no rate."""
        if not self.swaps:
            return None
        connectors = self.configuration.context.connectors
        rates = [connectors[swap.connector].guarantee.rate or self.configuration.rate(swap.old) for swap in self.swaps]
        return None if None in rates else max(1 / rate for rate in rates if rate)

    def outgoing(self, address: str, slot: SharedSlotPlace | None = None) -> CutOutCommand:
        """The cut as the old side is sent it; ``address`` is where the new side reaches it."""
        swaps = [CutSwap(port=swap.old.port, topic=self.configuration.topic(swap.connector)) for swap in self.swaps]
        return CutOutCommand(
            cut=self.id,
            swaps=swaps,
            at=self.at,
            resume_after=self.resume_after(),
            clock=self.clock,
            state=self.state,
            shared_slot=slot,
            lease=self.lease,
            own_address=address if self.lease else "",
        )

    def timeout(self, stretch: float) -> float:
        """The time that it may take until both sides know how it ended (s); ``stretch`` as for a slow clock."""
        moving = 0.0 if self.state is None else self.state.timeout
        return (
            self.lead + self.resume_after() * stretch + LEASE_SLACK * self.lease + 2.0 + moving + self.arbiter.exchange
        )

    def incoming(self, address: str, slot: SharedSlotPlace | None = None) -> CutInCommand:
        """The cut as the new side is sent it; ``address`` is that of the old side."""
        # What is written once is repeated at the cut.
        swaps = [
            CutSwap(
                port=swap.new.port,
                topic=self.configuration.topic(swap.connector),
                latch=written_once(self.configuration, swap.new, self.trigger)
                if self.arbiter.by_moment
                else not self.configuration.rate(swap.new),
            )
            for swap in self.swaps
        ]
        at = self.at + self.shift
        state = self.state and structs.replace(self.state, at=self.state.at + self.shift)
        return CutInCommand(
            cut=self.id,
            swaps=swaps,
            at=at,
            epoch=at if self.trigger == "rate" else None,
            shift=self.shift,
            peer=self.old,
            address=address,
            clock=self.clock,
            state=state,
            shared_slot=slot,
            resume_after=0.0 if slot is None else self.resume_after(),
            quiet=self.quiet,
            leased=self.lease > 0,
        )

    async def shared_slot(self, client: ComponentClient, side: str) -> SharedSlotPlace | None:
        """The slot of ``side`` in the page of the gates, where only the other side has a gate."""
        old = side == self.old
        other = self.new if old else self.old
        if self.arbiter.by_moment or not self.configuration.component(side).has_agent:
            return None
        own = [(swap.old if old else swap.new, self.configuration.topic(swap.connector)) for swap in self.swaps]
        # What is quiet has no slots: it is offered at any time.
        rates = [None if self.quiet else self.configuration.rate(port) for port, _ in own]
        ports = [SharedSlotPort(topic=topic, rate=rate) for (_, topic), rate in zip(own, rates, strict=True)]
        return await client.change(other, ShareSlotCommand(cut=self.id, peer=side, ports=ports, old=old))


async def agree_cuts(
    client: ComponentClient,
    configuration: Configuration,
    swaps: Iterable[Swap],
    lead: float,
    states: Mapping[tuple[str, str], StateTransfer],
    offsets: Mapping[tuple[str, str, CutClock], ClockOffset] = Map(),
) -> list[Cut]:
    """One cut for the outputs of each old functionality, all at the first slot after one common moment.

    There is one such moment on each clock of each host, ``lead`` seconds of real time ahead. ``states`` says how state
    moves between two components, which have a cut for it alone if they swap nothing. Else the slowest grid is cut
    first, and each faster one at its first slot after that, so the slots that wait for the last cut do so for a short
    part of their period. ``offsets``: by old and new component and clock, how far that of the new one's host is ahead.
    """
    cuts: dict[tuple[str, str, str], Cut] = {}
    grids: dict[tuple[str, str, str], Grid] = {}
    moments: dict[tuple[str, CutClock], int] = {}
    for swap in swaps:
        old, new = swap.old.instance, swap.new.instance
        arbiter = choose_arbiter(configuration.component, old, new)
        key = (old, new, configuration.component(old).owner(swap.old.port).name if arbiter.by_moment else "")
        if key not in cuts:
            grid = grids[key] = await client.read(old, GridCommand(port=swap.old.port))
            offset = offsets.get((old, new, grid.clock), SAME_CLOCK)
            cuts[key] = cut = Cut(configuration, old, new, arbiter, clock=grid.clock, offset=offset)
            if arbiter.by_moment:
                cut.trigger, cut.epoch, cut.period = grid.trigger, grid.epoch, grid.period
            ahead = lead + 2 * offset.uncertainty / 1e9  # the new side may learn of it later by its clock
            moment = grid.now + int(ahead * (grid.speed or 1.0) * 1e9)
            moments[cut.timeline] = max(moments.get(cut.timeline, 0), moment)
        cuts[key].swaps.append(swap)
    for cut in cuts.values():
        cut.at = _first_slot(cut, moments[cut.timeline])
        if cut.in_order and (cut.old, cut.new) not in states:
            states = {**states, (cut.old, cut.new): _order_alone(client, cut)}
    for old, new in states:
        if not any((cut.old, cut.new) == (old, new) for cut in cuts.values()):  # no output: only its state moves
            grid = grids[old, new, ""] = await client.read(old, GridCommand())
            arbiter = choose_arbiter(configuration.component, old, new)
            offset = offsets.get((old, new, grid.clock), SAME_CLOCK)
            at = grid.now + int(lead * 1e9) + 2 * offset.uncertainty
            cuts[old, new, ""] = Cut(configuration, old, new, arbiter, clock=grid.clock, at=at, offset=offset)
    for pair, state in states.items():
        own = sorted((cut for cut in cuts.values() if (cut.old, cut.new) == pair), key=lambda cut: -(cut.period or 0.0))
        latest = dict(moments)
        for cut in own:
            latest[cut.timeline] = cut.at = _first_slot(cut, latest.get(cut.timeline, cut.at))
        last = own[-1]
        transfer = structs.replace(state, id=uuid.uuid4().hex, cuts=len(own), at=last.at, clock=last.clock)
        for cut in own:
            cut.state = transfer
    for key, cut in cuts.items():
        if cut.arbiter.by_moment and not await client.share_locks(cut.old, cut.new):
            cut.lease = LEASE
        cut.lead = (cut.at - grids[key].now) / 1e9 / (grids[key].speed or 1.0)
    return list(cuts.values())


def _order_alone(client: ComponentClient, cut: Cut) -> StateTransfer:
    """No state moves, and the new side waits for the old one's last message, which may take a round trip."""
    timeout = ORDER_TIMEOUT + 4 * cut.offset.uncertainty / 1e9
    address = client.address(cut.new, cut.old)
    return StateTransfer(
        id="", cuts=0, at=0, required=False, timeout=timeout, new=cut.new, address=address, order_only=True
    )


def _first_slot(cut: Cut, moment: int) -> int:
    """The first slot of its grid that is not before ``moment``, which itself is one where there is no grid."""
    if cut.epoch is None or not cut.period:
        return moment
    step = cut.period * 1e9
    return cut.epoch + round(math.ceil((moment - cut.epoch) / step) * step)


async def publishers_found(
    client: ComponentClient, configuration: Configuration, connector: str, early: int = 0
) -> dict[PortRef, int]:
    """The number of publishers that each subscriber of ``connector`` is matched with, before new ones attach.

    A publisher that has just left may still be counted, so a subscriber that counts more than there are in the model is
    asked again for a while. That is not done if some of the new ones are ``early``: they may be counted as well.
    """
    living = sum(not client.life.is_gone(port.instance) for port in configuration.publishers_on(connector))
    found: dict[PortRef, int] = {}
    for port in sorted(configuration.subscribers_on(connector)):
        asked = AwaitMatchCommand(port=port.port, topic=configuration.topic(connector), peers=0, timeout=0.0)
        with contextlib.suppress(CallTimeout, Unreachable):  # reported as a silence
            for _ in range(1 if early else LEAVE_ATTEMPTS):
                found[port] = (await client.read(port.instance, asked)).matched
                if found[port] <= living:
                    break
                await asyncio.sleep(LEAVE_INTERVAL)
    return found


def early_publishers(configuration: Configuration, new: Iterable[PortRef]) -> int:
    """The number of these that exist as long as their processes, attached or not: those without an agent in them."""
    return sum(not configuration.component(port.instance).has_agent for port in new)


async def new_publisher_ids(
    backend: Backend, configuration: Configuration, new: Iterable[PortRef], connector: str
) -> dict[str, PortRef]:
    """The identities of new publishers on ``connector``, with their ports; empty unless all of them are known.

    The manager may find them a little later than others do.
    """
    ports, topic = sorted(new), configuration.topic(connector)
    for _ in range(IDENTITY_ATTEMPTS):
        found = [(port, await backend.publisher_ids(topic, port.instance)) for port in ports]
        if any(ids is None for _, ids in found):
            return {}
        if all(ids for _, ids in found):
            return {each: port for port, ids in found for each in ids or ()}
        await asyncio.sleep(IDENTITY_INTERVAL)
    return {}


async def require_found(
    client: ComponentClient,
    backend: Backend,
    configuration: Configuration,
    swaps: Iterable[Swap],
    connector: str,
    before: Mapping[PortRef, int],
) -> None:
    """Raises StepFailed unless the subscribers of ``connector`` have found the new publishers.

    That the publishers have found them is not enough: a subscriber whose middleware does not discover endpoints any
    more would receive nothing after the cut. Each is asked for the new ones by their identities. Where the middleware
    does not tell these, and of a subscriber without Midstride's API, only numbers are known.

    ``before`` is what :func:`publishers_found` returned. Such a subscriber may also not have noticed who left, so the
    number of publishers there are would not do. New publishers of nodes without Midstride's API have existed since
    their processes started, and may have been counted before. Such a node may also have left without a word, and be
    counted for long. So for them that number has to do.
    """
    new = {swap.new for swap in swaps if swap.connector == connector}
    ids = await new_publisher_ids(backend, configuration, new, connector)
    gone = sum(client.life.is_gone(port.instance) for port in configuration.publishers_on(connector))
    topic, early = configuration.topic(connector), early_publishers(configuration, new)
    for port, counted in before.items():
        # Whether one that has exited is still counted is not known.
        wanted = (len(configuration.publishers_on(connector)) if early else counted) + len(new) - gone
        await_match = AwaitMatchCommand(
            port=port.port, topic=topic, peers=wanted, publisher_ids=sorted(ids), timeout=FIND_TIMEOUT
        )
        try:
            found = await client.read(port.instance, await_match)
        except (CallTimeout, Unreachable):
            continue
        if found.missing is not None:
            lacks = sorted({str(ids[each]) for each in found.missing if each in ids})
            words = f"has not found {' and '.join(lacks)}" if lacks else ""
        else:
            words = f"has found only {found.matched} of {wanted} publishers" if found.matched < wanted else ""
        if words:
            raise StepFailed(
                f"{port} {words} on {topic} within {FIND_TIMEOUT:g} s "
                "and would receive nothing after the hand-over; its middleware may have stopped discovering endpoints: "
                f"replace {port.instance} first"
            )


async def require_same_clock(client: ComponentClient, old: str, new: str) -> None:
    """Raises StepFailed unless both sides follow the same clock, and it has a time: they agree on a moment of it."""
    state = await client.peek(old)
    if state.simulated_time != (await client.peek(new)).simulated_time:
        simulated, other = (old, new) if state.simulated_time else (new, old)
        raise StepFailed(
            f"{simulated} follows /clock (use_sim_time) and {other} the clock of the system, so they cannot agree on a "
            "moment for the hand-over; set use_sim_time to the same value for both"
        )
    if state.waiting is not None:
        raise StepFailed(f"{old} cannot hand over: {state.waiting}")


def written_once(configuration: Configuration, new: PortRef, trigger: TriggerKind) -> bool:
    """Return whether a message of an output may have been written only once, and then behind its gate."""
    relayed = configuration.component(new.instance).gate == "relay"
    return trigger == "none" or (relayed and not configuration.rate(new))
