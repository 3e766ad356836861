"""The hand-over on live components: both publishers live, one agreed cut, nothing chased.

Semantics.md section 7, *the cut is agreed*. The new component's publisher stands behind a closed
gate until both sides have been told one future slot of the old one's time grid. The old side is
told first, and takes up again by itself unless it learns from the new one that it has written: if
the manager dies at any point, the topic falls silent for no longer than ``RESUME_PERIODS``.
"""

from __future__ import annotations

import asyncio
import math
import uuid
from collections.abc import Awaitable, Callable, Iterable
from dataclasses import dataclass, field
from typing import Final, TypeAlias

from midstride.errors import CommandRefused, MidstrideError, StepFailed
from midstride.model.action import Handover, Swap
from midstride.model.component import FunctionalityRef, PortRef
from midstride.model.configuration import Configuration
from midstride.model.contract import Predicate
from midstride.runtime.component_client import ComponentClient
from midstride.wire.commands import (
    AttachCommand,
    AwaitCutCommand,
    AwaitWriteCommand,
    CancelCutCommand,
    CutInCommand,
    CutOutCommand,
    CutSwap,
    DetachCommand,
    GridCommand,
    MeetCommand,
    Trigger,
)

# How many readers on a topic the middleware still counts although their processes are known to be dead.
LingeringReaders: TypeAlias = Callable[[str], Awaitable[int]]

# The old side takes up again when it has not heard of the new one's first write for this many periods,
RESUME_PERIODS: Final = 10
# and for at least this long (s): below it a busy machine's own jitter would look like a death.
RESUME_AT_LEAST: Final = 0.1
# Where no rate says how long silence may last (s).
RESUME_WITHOUT_RATE: Final = 2.0
# How far ahead the cut is agreed (s): many round trips, so that both sides know it before it comes. On a machine too
# busy for the first, the next is tried.
LEADS: Final = (0.1, 0.3, 1.0)
# How long the new component may take to write once behind its gate (s), on top of 10 of its periods.
PROBATION: Final = 5.0
ATTACH_TIMEOUT: Final = 5.0
# How long readers that the model does not know of (`ros2 topic echo`, a recording) are waited for (s): the defaults of
# the middleware look around every 3 s. What was killed without a word is in nobody's way for longer.
OTHERS_PATIENCE: Final = 4.0
DETACH_TIMEOUT: Final = 2.0
# How long the two sides may take to find each other: so many turns of so many seconds.
MEET_TURNS: Final = 10
MEET_TURN: Final = 0.5


@dataclass(slots=True)
class Cut:
    """One agreed cut between two components, for the outputs whose calls share one time grid."""

    old: str
    new: str
    swaps: list[Swap]
    id: str = field(default_factory=lambda: uuid.uuid4().hex)
    trigger: Trigger = "none"
    epoch: int | None = None
    period: float | None = None
    at: int = 0

    def resume_after(self, declared: float | None) -> float:
        """How long the old side waits for the new one's first write (s)."""
        period = self.period if self.period is not None else declared
        if period is None:
            return RESUME_WITHOUT_RATE
        # It then writes in its next slot: one period less, and the silence is what is stated.
        return max((RESUME_PERIODS - 1) * period, RESUME_AT_LEAST)


@dataclass(frozen=True, slots=True)
class HandoverResult:
    """What came of a hand-over: the number of each old output's last message, and what went wrong after it."""

    last: dict[PortRef, int | None]
    warnings: tuple[str, ...] = ()


async def hand_over(
    client: ComponentClient, lingering: LingeringReaders, configuration: Configuration, action: Handover
) -> HandoverResult:
    """Carry out ``action`` on the components of ``configuration``.

    Raises StepFailed with the reason; then the old publishers have their topics as before and the
    new ones no endpoint there.
    """
    swaps = list(action.swaps)
    warnings: list[str | None] = []
    begun: list[Swap] = []
    cuts: list[Cut] = []
    try:
        for swap in swaps:
            begun.append(swap)
            warnings.append(await _stand_by(client, lingering, configuration, swap))
        for swap in swaps:
            await _await_probation(client, configuration, swap)
        for old, new in sorted({(swap.old.instance, swap.new.instance) for swap in swaps}):
            await _meet(client, new, old)
        for lead in LEADS:
            cuts = await _agree(client, configuration, swaps, lead)
            if await _told(client, configuration, cuts, last_try=lead == LEADS[-1]):
                break
        last = await _await_cuts(client, configuration, cuts)
    except (Exception, asyncio.CancelledError) as error:
        fallen = await _fallen(client, configuration, swaps) if isinstance(error, MidstrideError) else None
        await _take_back(client, configuration, cuts, begun)
        if isinstance(error, MidstrideError):
            raise StepFailed(fallen or str(error)) from error
        raise
    warnings += [await _retire(client, configuration, swap) for swap in swaps]
    return HandoverResult(last, tuple(warning for warning in warnings if warning))


async def _fallen(client: ComponentClient, configuration: Configuration, swaps: Iterable[Swap]) -> str | None:
    """Why a new side cannot take over that has degraded by itself: that is the reason, whatever it then refused."""
    for swap in swaps:
        owner = configuration.component(swap.new.instance).owner(swap.new.port)
        try:
            view = (await client.peek(swap.new.instance)).functionalities.get(owner.name)
        except MidstrideError:
            continue
        ref = FunctionalityRef(swap.new.instance, owner.name)
        if view is not None and owner.mode_index(view.mode) > configuration.modes[ref]:
            return f"{ref} degraded to {view.mode} by itself: {view.because.strip()}"
    return None


async def _told(client: ComponentClient, configuration: Configuration, cuts: list[Cut], last_try: bool) -> bool:
    """Tell both sides of each cut. False where one was told too late, and nothing is agreed any more."""
    try:
        for cut in cuts:  # the old side first: it alone can go on by itself
            await client.change(cut.old, _cut_out(configuration, cut))
        for cut in cuts:
            await client.change(cut.new, _cut_in(configuration, cut, client.address(cut.old)))
    except CommandRefused:
        if last_try:
            raise
        await _cancel(client, cuts)
        return False
    return True


async def _cancel(client: ComponentClient, cuts: list[Cut]) -> None:
    for cut in cuts:
        for side in (cut.new, cut.old):
            await client.undo(side, CancelCutCommand(cut=cut.id))


def _topic(configuration: Configuration, connector: str) -> str:
    return configuration.context.connectors[connector].topic


async def _stand_by(
    client: ComponentClient, lingering: LingeringReaders, configuration: Configuration, swap: Swap
) -> str | None:
    """The new publisher on the topic, its gate closed, matched with every subscriber the model knows of, and with as
    many as the old one is matched with; else a warning."""
    topic = _topic(configuration, swap.connector)
    grid = await client.read(swap.old.instance, GridCommand(port=swap.old.port, topic=topic))
    readers = (grid.readers or 0) - await lingering(topic)
    attach = AttachCommand(
        port=swap.new.port,
        topic=topic,
        gate="closed",
        peers=len(configuration.subscribers_on(swap.connector)),
        everyone=readers,
        patience=OTHERS_PATIENCE,
        timeout=ATTACH_TIMEOUT + OTHERS_PATIENCE,
    )
    matched = (await client.change(swap.new.instance, attach)).matched
    if matched >= readers:
        return None
    return (
        f"{swap.old} had {readers} readers on {swap.connector}, and {swap.new} has found {matched} of them: "
        "subscribers outside this system may miss messages"
    )


async def no_lingering_readers(topic: str) -> int:
    """Every reader that the middleware counts is alive."""
    return 0


async def _meet(client: ComponentClient, new: str, old: str) -> None:
    """Have the new side find the old one, in short turns: that the old one has ended is known between them, at once,
    and its topic is silent meanwhile."""
    for _ in range(MEET_TURNS):
        await client.peek(old)
        try:
            await client.change(new, MeetCommand(peer=old, address=client.address(old), timeout=MEET_TURN))
            return
        except CommandRefused as error:
            refused = error
    raise refused


async def _await_probation(client: ComponentClient, configuration: Configuration, swap: Swap) -> None:
    guarantee = configuration.guarantee(swap.new)
    rate = guarantee.rate if isinstance(guarantee, Predicate) else None
    timeout = PROBATION + (10 / rate if rate else 0.0)
    topic = _topic(configuration, swap.connector)
    seen = await client.read(swap.new.instance, AwaitWriteCommand(port=swap.new.port, topic=topic, timeout=timeout))
    if seen.wrong_type:
        raise StepFailed(f"{swap.new} wrote a message of the wrong type behind its gate: {seen.wrong_type}")
    if not seen.gated:
        raise StepFailed(f"{swap.new} has written nothing within {timeout:g} s, so it cannot take over")


async def _agree(
    client: ComponentClient, configuration: Configuration, swaps: Iterable[Swap], lead: float
) -> list[Cut]:
    """One cut for the outputs of each functionality pair; all at the slot nearest to one common moment."""
    groups: dict[tuple[str, str, str], Cut] = {}
    moment: int | None = None
    for swap in swaps:
        owner = configuration.component(swap.old.instance).owner(swap.old.port).name
        cut = groups.setdefault(
            (swap.old.instance, swap.new.instance, owner), Cut(swap.old.instance, swap.new.instance, [])
        )
        cut.swaps.append(swap)
        if len(cut.swaps) > 1:
            continue
        grid = await client.read(swap.old.instance, GridCommand(port=swap.old.port))
        cut.trigger, cut.epoch, cut.period = grid.trigger, grid.epoch, grid.period
        moment = max(moment or 0, grid.now)
    assert moment is not None
    moment += int(lead * 1e9)
    for cut in groups.values():
        cut.at = moment
        if cut.trigger == "rate" and cut.epoch is not None and cut.period:
            step = cut.period * 1e9
            cut.at = cut.epoch + round(math.ceil((moment - cut.epoch) / step) * step)
    return list(groups.values())


def _declared_period(configuration: Configuration, cut: Cut) -> float | None:
    """The longest of the periods that the cut's topics require; None where one states no rate."""
    rates = [configuration.context.connectors[swap.connector].guarantee.rate for swap in cut.swaps]
    rates = [
        rate or (g.rate if isinstance(g := configuration.guarantee(swap.old), Predicate) else None)
        for rate, swap in zip(rates, cut.swaps, strict=True)
    ]
    return None if any(rate is None for rate in rates) else max(1 / rate for rate in rates if rate)


def _cut_out(configuration: Configuration, cut: Cut) -> CutOutCommand:
    return CutOutCommand(
        cut=cut.id,
        swaps=[CutSwap(port=swap.old.port, topic=_topic(configuration, swap.connector)) for swap in cut.swaps],
        at=cut.at,
        resume_after=cut.resume_after(_declared_period(configuration, cut)),
    )


def _cut_in(configuration: Configuration, cut: Cut, address: str) -> CutInCommand:
    # What is written neither at a rate nor for a message is written once: at the cut, again.
    latch = cut.trigger == "none"
    return CutInCommand(
        cut=cut.id,
        swaps=[
            CutSwap(port=swap.new.port, topic=_topic(configuration, swap.connector), latch=latch) for swap in cut.swaps
        ],
        at=cut.at,
        epoch=cut.at if cut.trigger == "rate" else None,
        peer=cut.old,
        address=address,
    )


async def _await_cuts(
    client: ComponentClient, configuration: Configuration, cuts: list[Cut]
) -> dict[PortRef, int | None]:
    last: dict[PortRef, int | None] = {}
    for cut in cuts:
        patience = LEADS[-1] + cut.resume_after(_declared_period(configuration, cut)) + 2.0
        over = AwaitCutCommand(cut=cut.id, timeout=patience)
        incoming, outgoing = await asyncio.gather(client.read(cut.new, over), client.read(cut.old, over))
        if incoming.outcome != "done":
            raise StepFailed(f"{cut.new} did not publish after the cut; {cut.old} continues")
        if outgoing.outcome != "done":
            raise StepFailed(f"{cut.old} resumed before it learned that {cut.new} had published")
        for swap in cut.swaps:
            write = outgoing.last.get(f"{swap.old.port} {_topic(configuration, swap.connector)}")
            last[swap.old] = None if write is None else write.number
    return last


async def _take_back(client: ComponentClient, configuration: Configuration, cuts: list[Cut], begun: list[Swap]) -> None:
    """Old publishers as before, new ones off the topic. What cannot be reached is left to the roll-back."""
    await _cancel(client, cuts)
    for swap in begun:
        topic = _topic(configuration, swap.connector)
        detach = DetachCommand(port=swap.new.port, topic=topic, timeout=DETACH_TIMEOUT)
        await client.undo(swap.new.instance, detach)


async def _retire(client: ComponentClient, configuration: Configuration, swap: Swap) -> str | None:
    """Take the old endpoint off the topic. The swap has happened: an old side that will not let go is only told."""
    topic = _topic(configuration, swap.connector)
    try:
        await client.change(swap.old.instance, DetachCommand(port=swap.old.port, topic=topic, timeout=DETACH_TIMEOUT))
    except MidstrideError as error:
        return f"{swap.old} could not be taken off {swap.connector} after the hand-over: {error}"
    return None
