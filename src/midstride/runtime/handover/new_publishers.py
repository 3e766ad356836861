"""The new publishers of a hand-over, until they may publish: attached behind a closed gate, found, and on probation.

They must find the subscribers of the model and, as far as possible, the readers outside it that the old publishers
have. Behind the gate they must write (docs/protocols/probation.md).
"""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

from midstride.errors import MidstrideError, StepFailed
from midstride.model.action import Swap
from midstride.model.configuration import Configuration
from midstride.runtime.backend_protocol import Backend
from midstride.runtime.handover.arbiter_choice import choose_arbiter
from midstride.runtime.handover.probation import require_rate
from midstride.runtime.process.component_client import ComponentClient
from midstride.runtime.records.events import EventLog
from midstride.runtime.watch.simulated_time import stretch_of
from midstride.wire import commands

# How long the new component may take to write once behind its gate (s), on top of 10 of its periods.
PROBATION: Final = 5.0
# From how many calls its code must have returned behind the gate, as far as they come within so many seconds of its
# first message: what raises at once in most cases is not let in, and a slow component costs no time.
CALLS: Final = 3
CALLS_PATIENCE: Final = 0.5
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
    # The swaps whose new publisher may be attached, and those where it is.
    _begun: list[Swap] = field(default_factory=list)
    _attached: list[Swap] = field(default_factory=list)
    _proved: list[Swap] = field(default_factory=list)  # those that have passed their probation

    async def attach_beside(self, swap: Swap, readers: int, ids: Sequence[str]) -> None:
        """As :meth:`attach`, and note if the new publisher does not find the :meth:`readers` of the old one."""
        matched = await self.attach(swap, readers, ids)
        # Asked again if some are missing: the old publisher may have counted readers whose lease was about to expire.
        if matched < readers and matched < (readers := (await self.readers(swap))[0]):
            self.events.add(
                "note",
                f"{swap.old} had {readers} readers on {swap.connector}, and {swap.new} has found {matched} of them: "
                "subscribers outside this system may miss messages",
            )

    async def readers(self, swap: Swap) -> tuple[int, list[str]]:
        """How many living readers the old publisher has, and which, unless some of them are dead."""
        topic = self._topic(swap)
        grid = await self.client.read(swap.old.instance, commands.GridCommand(port=swap.old.port, topic=topic))
        dead = await self.backend.lingering_readers(topic)
        return (grid.readers or 0) - dead, [] if dead else grid.reader_ids

    async def attach(self, swap: Swap, readers: int = 0, ids: Sequence[str] = ()) -> int:
        """Attach the new publisher with a closed gate; how many readers it is matched with.

        It waits for the subscribers of the model, and for a while for so many readers, those with ``ids`` among them.
        """
        topic = self._topic(swap)
        subscribers = self.configuration.subscribers_on(swap.connector)
        attach = commands.AttachCommand(
            port=swap.new.port,
            topic=topic,
            gate="closed",
            peers=sum(not self.client.life.is_gone(port.instance) for port in subscribers),
            everyone=readers,
            reader_ids=list(ids),
            patience=OUTSIDE_READERS_TIMEOUT,
            timeout=ATTACH_TIMEOUT + OUTSIDE_READERS_TIMEOUT,
        )
        self._begun.append(swap)
        matched = (await self.client.change(swap.new.instance, attach)).matched
        self._attached.append(swap)
        return matched

    def attached(self, swap: Swap) -> bool:
        return swap in self._attached

    async def detach(self) -> None:
        """Detach those that have been attached, as far as they can be reached."""
        for swap in self._begun:
            detach = commands.DetachCommand(port=swap.new.port, topic=self._topic(swap), timeout=DETACH_TIMEOUT)
            await self.client.undo(swap.new.instance, detach)
        self._begun, self._attached, self._proved = [], [], []

    async def await_probation(self, swap: Swap) -> None:
        """Wait until the new publisher has written behind its gate, once. Raises StepFailed with what it lacks."""
        component = self.configuration.component(swap.new.instance)
        arbiter = choose_arbiter(self.configuration.component, swap.old.instance, swap.new.instance)
        if not arbiter.needs_probation or swap in self._proved:
            return  # it writes nothing until it takes over; or the old side has exited since
        if swap.new.port in component.lazy and not self.configuration.subscribers_on(swap.connector):
            return  # it need not exist, and the old publisher neither
        rate = self.configuration.rate(swap.new)
        duration = stretch_of(self.client, swap.old.instance)  # of a second of its clock (s)
        timeout = PROBATION + (10 / rate * duration if rate else 0.0)
        # Without a rate, messages drive it, or it is called once.
        calls = min(CALLS, 1 + int(rate / duration * CALLS_PATIENCE)) if rate else 1
        await_write = commands.AwaitWriteCommand(
            port=swap.new.port, topic=self._topic(swap), calls=calls, patience=CALLS_PATIENCE, timeout=timeout
        )
        seen = await self.client.read(swap.new.instance, await_write)
        if seen.wrong_type:
            raise StepFailed(f"{swap.new} wrote a message of the wrong type behind its gate: {seen.wrong_type}")
        if seen.failed:
            raise StepFailed(f"the code that writes {swap.new} has raised behind its gate")
        if not seen.gated:
            because = await self.waits_for(swap.new.instance)
            raise StepFailed(f"{swap.new} has written nothing within {timeout:g} s, so it cannot take over{because}")
        if rate:
            foreign = component.gate is not None
            await require_rate(self.client, swap.new, self._topic(swap), rate, self.timing, duration, foreign)
        self._proved.append(swap)

    async def waits_for(self, instance: str) -> str:
        """What the component waits for, if anything, as the end of a sentence."""
        with contextlib.suppress(MidstrideError):
            if (waiting := (await self.client.peek(instance)).waiting) is not None:
                return f": {waiting}"
        return ""

    def _topic(self, swap: Swap) -> str:
        return self.configuration.topic(swap.connector)
