"""The hand-over on live components: both publishers exist at once, and switch at an agreed moment, the *cut*.

The new publisher is behind a closed gate until both sides know the cut, a future slot of the old publisher's time grid
(docs/semantics.md section 7). The old side is sent the cut first, and resumes publishing unless the new side reports
its first message: if the manager exits at any point, the topic is silent for at most ``RESUME_PERIODS`` periods
(:mod:`.agreed_cut`).
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Iterable
from dataclasses import dataclass
from typing import Final, TypeAlias

from midstride.errors import CommandRefused, MidstrideError, StepFailed
from midstride.model.action import Handover, Swap
from midstride.model.component import FunctionalityRef, PortRef
from midstride.model.configuration import Configuration
from midstride.model.contract import Predicate
from midstride.runtime.agreed_cut import Cut, agree_cuts, cut_in, cut_out, topic_of
from midstride.runtime.component_client import ComponentClient
from midstride.wire.commands import (
    AttachCommand,
    AwaitCutCommand,
    AwaitWriteCommand,
    CancelCutCommand,
    DetachCommand,
    GridCommand,
    MeetCommand,
)

# The number of readers on a topic that the middleware still counts although their processes have exited.
LingeringReaders: TypeAlias = Callable[[str], Awaitable[int]]

# How far ahead the cut is (s): many round trips, so that both sides know it in time. If the machine is too busy for one
# of these, the next one is tried.
LEADS: Final = (0.1, 0.3, 1.0)
# How long the new component may take to write once behind its gate (s), on top of 10 of its periods.
PROBATION: Final = 5.0
ATTACH_TIMEOUT: Final = 5.0
# How long to wait for readers outside the model, such as `ros2 topic echo` (s). By default the middleware's discovery
# announces every 3 s. The limit is for readers that were killed and that the middleware still counts.
OUTSIDE_READERS_TIMEOUT: Final = 4.0
DETACH_TIMEOUT: Final = 2.0
# How often, and how long each time (s), the two sides try to connect to each other.
MEET_ATTEMPTS: Final = 10
MEET_TIMEOUT: Final = 0.5


@dataclass(frozen=True, slots=True)
class HandoverResult:
    """The number of each old output's last message, and warnings about what failed after the cut."""

    last: dict[PortRef, int | None]
    warnings: tuple[str, ...] = ()


async def hand_over(
    client: ComponentClient, lingering: LingeringReaders, configuration: Configuration, action: Handover
) -> HandoverResult:
    """Carry out ``action`` on the components of ``configuration``.

    Raises StepFailed with the reason. Then the old publishers publish as before, and the new ones have no endpoint on
    the topics.
    """
    swaps = list(action.swaps)
    warnings: list[str | None] = []
    begun: list[Swap] = []
    cuts: list[Cut] = []
    try:
        for swap in swaps:
            begun.append(swap)
            warnings.append(await _attach_gated(client, lingering, configuration, swap))
        for swap in swaps:
            await _await_probation(client, configuration, swap)
        for old, new in sorted({(swap.old.instance, swap.new.instance) for swap in swaps}):
            await _meet(client, new, old)
        for lead in LEADS:
            cuts = await agree_cuts(client, configuration, swaps, lead)
            if await _announce(client, configuration, cuts, last_try=lead == LEADS[-1]):
                break
        last = await _await_cuts(client, configuration, cuts)
    except (Exception, asyncio.CancelledError) as error:
        degradation = (
            await _degradation_of_new(client, configuration, swaps) if isinstance(error, MidstrideError) else None
        )
        await _undo(client, configuration, cuts, begun)
        if isinstance(error, MidstrideError):
            raise StepFailed(degradation or str(error)) from error
        raise
    warnings += [await _detach_old(client, configuration, swap) for swap in swaps]
    return HandoverResult(last, tuple(warning for warning in warnings if warning))


async def _degradation_of_new(
    client: ComponentClient, configuration: Configuration, swaps: Iterable[Swap]
) -> str | None:
    """If the new side degraded unexpectedly, that is the root cause of any refusal: a message saying so, else None."""
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


async def _announce(client: ComponentClient, configuration: Configuration, cuts: list[Cut], last_try: bool) -> bool:
    """Send each cut to both sides. False if one side received it too late; then all cuts have been cancelled."""
    try:
        for cut in cuts:  # the old side first: it resumes if the new side never learns of the cut
            await client.change(cut.old, cut_out(configuration, cut))
        for cut in cuts:
            await client.change(cut.new, cut_in(configuration, cut, client.address(cut.old)))
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


async def _attach_gated(
    client: ComponentClient, lingering: LingeringReaders, configuration: Configuration, swap: Swap
) -> str | None:
    """Attach the new publisher with a closed gate, and wait until it is matched with the subscribers of the model.

    It should also match as many readers as the old publisher does; returns a warning if it does not.
    """
    topic = topic_of(configuration, swap.connector)

    async def readers_of_old() -> int:
        grid = await client.read(swap.old.instance, GridCommand(port=swap.old.port, topic=topic))
        return (grid.readers or 0) - await lingering(topic)

    readers = await readers_of_old()
    attach = AttachCommand(
        port=swap.new.port,
        topic=topic,
        gate="closed",
        peers=len(configuration.subscribers_on(swap.connector)),
        everyone=readers,
        patience=OUTSIDE_READERS_TIMEOUT,
        timeout=ATTACH_TIMEOUT + OUTSIDE_READERS_TIMEOUT,
    )
    matched = (await client.change(swap.new.instance, attach)).matched
    # Asked again if some are missing: the old publisher may have counted readers whose lease was about to expire.
    if matched >= readers or matched >= (readers := await readers_of_old()):
        return None
    return (
        f"{swap.old} had {readers} readers on {swap.connector}, and {swap.new} has found {matched} of them: "
        "subscribers outside this system may miss messages"
    )


async def no_lingering_readers(topic: str) -> int:
    """For a middleware that never counts readers of processes that have exited."""
    return 0


async def _meet(client: ComponentClient, new: str, old: str) -> None:
    """Have the new side connect to the old one.

    Several short attempts, because the topic is silent if the old side has exited: each attempt checks that first.
    """
    for _ in range(MEET_ATTEMPTS):
        await client.peek(old)
        try:
            await client.change(new, MeetCommand(peer=old, address=client.address(old), timeout=MEET_TIMEOUT))
            return
        except CommandRefused as error:
            refused = error
    raise refused


async def _await_probation(client: ComponentClient, configuration: Configuration, swap: Swap) -> None:
    guarantee = configuration.guarantee(swap.new)
    rate = guarantee.rate if isinstance(guarantee, Predicate) else None
    timeout = PROBATION + (10 / rate if rate else 0.0)
    topic = topic_of(configuration, swap.connector)
    seen = await client.read(swap.new.instance, AwaitWriteCommand(port=swap.new.port, topic=topic, timeout=timeout))
    if seen.wrong_type:
        raise StepFailed(f"{swap.new} wrote a message of the wrong type behind its gate: {seen.wrong_type}")
    if not seen.gated:
        raise StepFailed(f"{swap.new} has written nothing within {timeout:g} s, so it cannot take over")


async def _await_cuts(
    client: ComponentClient, configuration: Configuration, cuts: list[Cut]
) -> dict[PortRef, int | None]:
    last: dict[PortRef, int | None] = {}
    for cut in cuts:
        timeout = LEADS[-1] + cut.resume_after(configuration) + 2.0
        await_cut = AwaitCutCommand(cut=cut.id, timeout=timeout)
        incoming, outgoing = await asyncio.gather(client.read(cut.new, await_cut), client.read(cut.old, await_cut))
        if incoming.outcome != "done":
            raise StepFailed(f"{cut.new} did not publish after the cut; {cut.old} continues")
        if outgoing.outcome != "done":
            raise StepFailed(f"{cut.old} resumed before it learned that {cut.new} had published")
        for swap in cut.swaps:
            write = outgoing.last.get(f"{swap.old.port} {topic_of(configuration, swap.connector)}")
            last[swap.old] = None if write is None else write.number
    return last


async def _undo(client: ComponentClient, configuration: Configuration, cuts: list[Cut], begun: list[Swap]) -> None:
    """Reopen the gates of the old publishers and detach the new ones, as far as they can be reached."""
    await _cancel(client, cuts)
    for swap in begun:
        topic = topic_of(configuration, swap.connector)
        detach = DetachCommand(port=swap.new.port, topic=topic, timeout=DETACH_TIMEOUT)
        await client.undo(swap.new.instance, detach)


async def _detach_old(client: ComponentClient, configuration: Configuration, swap: Swap) -> str | None:
    """Detach the old publisher. The swap is done, so a failure is only a warning, which is returned."""
    topic = topic_of(configuration, swap.connector)
    try:
        await client.change(swap.old.instance, DetachCommand(port=swap.old.port, topic=topic, timeout=DETACH_TIMEOUT))
    except MidstrideError as error:
        return f"{swap.old} could not be taken off {swap.connector} after the hand-over: {error}"
    return None
