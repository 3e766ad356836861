"""The new publishers of a hand-over, until they may publish: attached behind a closed gate, found, and on probation.

They must find the subscribers of the model and, as far as possible, the readers outside it that the old publishers
have. Behind the gate they must write (docs/protocols/probation.md).
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

from midstride.errors import MidstrideError
from midstride.model.action import Swap
from midstride.model.configuration import Configuration
from midstride.runtime.backend_protocol import Backend
from midstride.runtime.cancellation import all_of
from midstride.runtime.handover.arbiter_choice import choose_arbiter
from midstride.runtime.handover.probation import Probation
from midstride.runtime.process.component_client import ComponentClient
from midstride.runtime.records.events import EventLog
from midstride.wire import commands

ATTACH_TIMEOUT: Final = 5.0
# How long to wait for readers outside the model, such as `ros2 topic echo` (s). By default the middleware's discovery
# announces every 3 s. The limit is for readers that were killed and that the middleware still counts.
OUTSIDE_READERS_TIMEOUT: Final = 4.0
DETACH_TIMEOUT: Final = 2.0


@dataclass(slots=True)
class NewPublishers:
    """The new publishers of one hand-over on the components of ``configuration``; ``timing`` is the specification's."""

    client: ComponentClient
    events: EventLog
    configuration: Configuration
    backend: Backend
    timing: Mapping[str, float]
    rates: bool = True  # whether they must keep the rates that they guarantee
    # The swaps whose new publisher may be attached, and those where it is.
    _begun: list[Swap] = field(default_factory=list)
    _attached: list[Swap] = field(default_factory=list)
    _proved: list[Swap] = field(default_factory=list)  # those that have passed their probation
    # Those of them where neither side has written anything.
    quiet: set[Swap] = field(default_factory=set)

    async def readers(self, swap: Swap) -> tuple[int, list[str]]:
        """The living readers of the old publisher and their number, unless some of them are dead."""
        topic = self._topic(swap)
        grid = await self.client.read(swap.old.instance, commands.GridCommand(port=swap.old.port, topic=topic))
        dead = await self.backend.lingering_readers(topic)
        return (grid.readers or 0) - dead, [] if dead else grid.reader_ids

    async def attach_beside(self, swaps: Sequence[Swap], readers: Sequence[tuple[int, list[str]]]) -> None:
        """Attach, and note which new publishers do not find all the :meth:`readers` of the old ones."""
        matched = await self.attach(swaps, readers)
        for swap, (known, _), found in zip(swaps, readers, matched, strict=True):
            # Asked again if some are missing: the old one may have counted readers whose lease was about to expire.
            if found < known and found < (known := (await self.readers(swap))[0]):
                self.events.add(
                    "note",
                    f"{swap.old} had {known} readers on {swap.connector}, and {swap.new} has found {found} of them: "
                    "subscribers outside this system may miss messages",
                )

    async def attach(self, swaps: Sequence[Swap], readers: Sequence[tuple[int, list[str]]] = ()) -> list[int]:
        """Attach the new publishers with closed gates; how many readers each is matched with.

        All of them wait at the same time for the subscribers of the model, and for a while for so many ``readers``,
        those with the ids among them.
        """
        for swap in swaps:
            self._begun.append(swap)
            attach = commands.AttachCommand(port=swap.new.port, topic=self._topic(swap), gate="closed")
            await self.client.change(swap.new.instance, attach)
            self._attached.append(swap)
        wanted = readers or [(0, [])] * len(swaps)
        return await all_of(self._matched(swap, *each) for swap, each in zip(swaps, wanted, strict=True))

    async def _matched(self, swap: Swap, readers: int, ids: Sequence[str]) -> int:
        subscribers = self.configuration.subscribers_on(swap.connector)
        command = commands.AwaitReadersCommand(
            port=swap.new.port,
            topic=self._topic(swap),
            peers=sum(not self.client.life.is_gone(port.instance) for port in subscribers),
            everyone=readers,
            reader_ids=list(ids),
            patience=OUTSIDE_READERS_TIMEOUT,
            timeout=ATTACH_TIMEOUT + OUTSIDE_READERS_TIMEOUT,
        )
        return (await self.client.read(swap.new.instance, command)).matched

    def attached(self, swap: Swap) -> bool:
        return swap in self._attached

    async def detach(self) -> None:
        """Detach those that have been attached, as far as they can be reached."""
        for swap in self._begun:
            detach = commands.DetachCommand(port=swap.new.port, topic=self._topic(swap), timeout=DETACH_TIMEOUT)
            await self.client.undo(swap.new.instance, detach)
        self._begun, self._attached, self._proved = [], [], []
        self.quiet.clear()

    async def await_probation(self, swaps: Iterable[Swap]) -> None:
        """Wait until the new publishers have passed their probations, all at the same time.

        Raises StepFailed with what one lacks.
        """
        await all_of(self._await_probation(swap) for swap in swaps)

    async def _await_probation(self, swap: Swap) -> None:
        component = self.configuration.component(swap.new.instance)
        arbiter = choose_arbiter(self.configuration.component, swap.old.instance, swap.new.instance)
        if not arbiter.needs_probation or swap in self._proved:
            return  # it writes nothing until it takes over; or the old side has exited since
        if swap.new.port in component.lazy and not self.configuration.subscribers_on(swap.connector):
            return  # it need not exist, and the old publisher neither
        rate, endpoint = self.configuration.rate(swap.new) or 0.0, component.output_endpoint(swap.new.port)
        latched = endpoint is not None and endpoint[1].is_transient_local
        probation = Probation(
            self.client, swap, self._topic(swap), rate, latched, self.timing, self.waits_for, self.rates
        )
        if await probation.run() == "quiet":
            self.quiet.add(swap)
            self.events.add("note", f"{swap.new} takes over from {swap.old} without a message: neither writes any")
        self._proved.append(swap)

    async def waits_for(self, instance: str) -> str:
        """Name what the component waits for, if anything, as the end of a sentence."""
        with contextlib.suppress(MidstrideError):
            if (waiting := (await self.client.peek(instance)).waiting) is not None:
                return f": {waiting}"
        return ""

    def _topic(self, swap: Swap) -> str:
        return self.configuration.topic(swap.connector)
