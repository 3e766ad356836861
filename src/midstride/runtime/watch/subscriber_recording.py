"""Records what each subscriber of a swapped topic receives, from before the first step of a plan to after its last."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import Container, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import Final, TypeAlias

from midstride.errors import CommandRefused, MidstrideError
from midstride.model.action import Action, Attach, Create, Detach, Handover, Remove
from midstride.model.component import PortRef
from midstride.model.configuration import Configuration
from midstride.model.contract import Predicate
from midstride.runtime.change_observer import ChangeObserver
from midstride.runtime.manager_clock import Clock
from midstride.runtime.process.component_client import ComponentClient
from midstride.runtime.records.measure import WINDOW_PERIODS, Observation, SwapReport, report, unknown_report
from midstride.runtime.records.status_forms import SilenceFault
from midstride.runtime.watch.silence import UNRECEIVED, not_receiving
from midstride.runtime.watch.simulated_time import report_on_ros_clock, stretch_of
from midstride.wire.commands import GridCommand, RecordCommand, RecordsCommand
from midstride.wire.replies import Grid, Records

_PortOnTopic: TypeAlias = tuple[PortRef, str]

# Recording continues for 20 periods after the last step, but at most for this long (s).
LONGEST_TAIL: Final = 10.0
# How long it continues if no rate defines a period (s).
TAIL_WITHOUT_RATE: Final = 0.5
# For how many periods at least, where the next command does not wait for the rest.
SHORTEST_TAIL_PERIODS: Final = 3


@dataclass(frozen=True, slots=True)
class Exchange:
    """A publisher of a topic that a plan replaces with another one of the same role."""

    connector: str
    old: PortRef
    new: PortRef


def exchanges(configuration: Configuration, actions: Iterable[Action]) -> list[Exchange]:
    """The publishers of topics that ``actions`` exchange, by hand-over or by detaching one and attaching the other.

    What a stand-in takes over and hands on is one exchange: of the one before it with the one after it.
    """
    found: list[Exchange] = []
    roles = {name: instance.role for name, instance in configuration.instances.items()}
    detached: list[tuple[str, PortRef]] = []
    for action in actions:
        match action:
            case Create(instance):
                roles[instance.name] = instance.role
            case Handover(swaps):
                for swap in swaps:
                    before = next((e for e in found if (e.connector, e.new) == (swap.connector, swap.old)), None)
                    if before is not None:
                        found.remove(before)
                    old = swap.old if before is None else before.old
                    found.append(Exchange(swap.connector, old, swap.new))
            case Detach(port, connector) if configuration.has_port(port) and configuration.is_output(port):
                detached.append((connector, port))
            case Attach(port, connector):
                found.extend(
                    Exchange(connector, old, port)
                    for name, old in detached
                    if name == connector and old.port == port.port and roles[old.instance] == roles[port.instance]
                )
    return [each for each in found if configuration.is_topic(each.connector)]


@dataclass(frozen=True, slots=True)
class RecordedInput:
    """A subscriber that is being recorded; ``observation`` has no rows yet."""

    input: PortRef
    exchange: Exchange
    observation: Observation


@dataclass(slots=True)
class Recording(ChangeObserver):
    """The recording of one plan. Failures do not affect the plan: their figures are reported as unknown.

    Where ``hurried`` is set meanwhile, it ends as soon as the figures mean something; where ``broken_off`` is, at once,
    and the figures are unknown. What was received before ``earliest`` (steady ns) belongs to another change.
    """

    client: ComponentClient
    clock: Clock
    hurried: asyncio.Event | None = None
    earliest: int = 0
    broken_off: asyncio.Event = field(default_factory=asyncio.Event)
    recorded: list[RecordedInput] = field(default_factory=list)
    unknown: list[SwapReport] = field(default_factory=list)
    # Subscribers that received nothing while the new publisher published.
    silences: list[SilenceFault] = field(default_factory=list)
    _driving_inputs: dict[PortRef, PortRef] = field(default_factory=dict)
    # The recording inputs, and since when (ns); None if the reply was lost.
    _begun: dict[PortRef, int | None] = field(default_factory=dict)

    async def begin(self, configuration: Configuration, actions: Sequence[Action]) -> None:
        """Start recording at each subscriber that the plan does not remove."""
        removed = {action.instance for action in actions if isinstance(action, Remove)}
        created = [action.instance for action in actions if isinstance(action, Create)]
        own_slots = {each.name for each in (*configuration.instances.values(), *created) if each.component.gate}
        for exchange in exchanges(configuration, actions):
            old = exchange.old
            topic = configuration.topic(exchange.connector)
            guarantee = configuration.component(old.instance).owner(old.port).modes[0].guarantee(old.port)
            period = 1 / guarantee.rate if isinstance(guarantee, Predicate) and guarantee.rate else None
            grid = await self._grid(old)
            grid_period = None if grid is None else grid.period
            for port in sorted(configuration.subscribers_on(exchange.connector)):
                if port.instance in removed:
                    continue
                try:
                    begun = await self._begin(port)
                except MidstrideError:
                    self.unknown.append(unknown_report(topic, str(port), period))
                    continue
                observation = Observation(
                    topic,
                    str(port),
                    (),
                    begun,
                    begun,
                    period,
                    grid_period,
                    own_slots=exchange.new.instance in own_slots,
                )
                self.recorded.append(RecordedInput(port, exchange, observation))

    async def _grid(self, old: PortRef) -> Grid | None:
        """The grid of an old publisher; None if it does not answer: the hand-over reports that."""
        if self.client.life.responsive(old.instance) is None:
            return None
        try:
            return await self.client.read(old.instance, GridCommand(port=old.port))
        except MidstrideError:
            return None

    async def _begin(self, port: PortRef) -> int:
        """Start recording at ``port`` unless it does; returns since when it records (ns)."""
        begun = self._begun.setdefault(port, None)
        if begun is None:
            record = RecordCommand(inputs=[port.port], on=True)
            try:
                recording = await self.client.change(port.instance, record)
            except CommandRefused:  # it has degraded by itself meanwhile, which makes no difference here
                recording = await self.client.change(port.instance, record)
            begun = self._begun[port] = recording.now
        return begun

    async def before_handover(self, configuration: Configuration, action: Handover) -> None:
        """Record the input that drives the new side of a message-driven output."""
        for swap in action.swaps:
            if not configuration.is_topic(swap.connector):
                continue
            grid = await self._grid(swap.old)
            if grid is None or grid.trigger != "message":
                continue
            owner = configuration.component(swap.new.instance).owner(swap.new.port)
            inputs = [PortRef(swap.new.instance, name) for name in owner.inputs]
            if len(inputs) == 1:
                with contextlib.suppress(MidstrideError):  # the hand-over reports the cause
                    await self._begin(inputs[0])
                    self._driving_inputs[swap.old] = inputs[0]

    async def finish(
        self,
        last_numbers: dict[PortRef, int | None],
        *,
        first_numbers: Mapping[PortRef, int] = MappingProxyType({}),
        resumed: bool = False,
        hung: Container[str] = (),
    ) -> list[SwapReport]:
        """Keep recording for a while, then compute the figures. :meth:`stop` must be called afterwards.

        ``last_numbers`` are those of the old publishers' last messages, ``first_numbers`` those of the new ones' first.
        ``resumed``: the plan was rolled back, so the old publishers publish again. ``hung``: the instances that were
        silent before the change.
        """
        if not self.recorded:
            return self.unknown
        periods = [each.observation.guaranteed_period for each in self.recorded]
        factor = max(stretch_of(self.client, each.input.instance) for each in self.recorded)
        tails = [TAIL_WITHOUT_RATE if period is None else WINDOW_PERIODS * period * factor for period in periods]
        begun, records = self.clock.steady(), dict[PortRef, Records]()
        before = await self._published(resumed)
        tail = min(max(tails), LONGEST_TAIL)
        least = tail * SHORTEST_TAIL_PERIODS / WINDOW_PERIODS
        await self.wait(least)
        await self.wait(tail - least, self.hurried)
        after = await self._published(resumed)
        # The subscribers first: then the driving inputs have received every message that was answered.
        for port in dict.fromkeys([*(each.input for each in self.recorded), *self._driving_inputs.values()]):
            if self.broken_off.is_set():
                records.clear()
                break
            with contextlib.suppress(MidstrideError):
                records[port] = await self.client.read(port.instance, RecordsCommand(input=port.port))
        watched = self.clock.steady() - begun
        inputs = {old: records[port] for old, port in self._driving_inputs.items() if port in records}
        reports = []
        for each in self.recorded:
            seen, old, found = each.observation, each.exchange.old, records.get(each.input)
            if found is None:
                reports.append(unknown_report(seen.topic, seen.subscriber, seen.guaranteed_period))
                continue
            driving = inputs.get(old)
            sources = None if driving is None else [row.source for row in driving.rows if row.source is not None]
            last = last_numbers.get(old)
            seen = replace(seen, rows=found.rows, ended=found.now, last_number=last, inputs=sources, resumed=resumed)
            seen = replace(seen, first_number=first_numbers.get(each.exchange.new))
            seen = replace(seen, watched=watched, earliest=self.earliest, hung=old.instance in hung)
            if found.moments is None:
                reports.append(report(seen))
            else:
                reports.append(report_on_ros_clock(seen, found.moments, ros_sources=found.ros_sources))
            attachment = old, seen.topic
            published = after.get(attachment, 0) - before.get(attachment, after.get(attachment, 0))
            if published >= UNRECEIVED and not any(row.received > found.now - watched * 1e9 for row in found.rows):
                self.silences.append(not_receiving(each.input, seen.topic, watched))
        return reports + self.unknown

    async def wait(self, seconds: float, hurried: asyncio.Event | None = None) -> None:
        """Wait so long (s), or until ``hurried`` is set, or the recording is broken off."""
        events = (self.broken_off,) if hurried is None else (self.broken_off, hurried)
        waiting = [asyncio.ensure_future(each) for each in (self.clock.sleep(seconds), *(e.wait() for e in events))]
        try:
            await asyncio.wait(waiting, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for each in waiting:
                each.cancel()

    async def _published(self, resumed: bool) -> dict[_PortOnTopic, int]:
        """The number of messages that the publishers at the end have published so far, where that is known.

        By the old publisher and its topic.
        """
        counts = {}
        for old, new, topic in dict.fromkeys(
            (each.exchange.old, each.exchange.new, each.observation.topic) for each in self.recorded
        ):
            port = old if resumed else new
            with contextlib.suppress(MidstrideError, KeyError):
                counts[old, topic] = (await self.client.peek(port.instance)).ports[port.port][topic].count
        return counts

    async def stop(self, live: Container[str]) -> None:
        """Stop recording at the instances in ``live``."""
        for port in self._begun:
            if port.instance in live:
                await self.client.undo(port.instance, RecordCommand(inputs=[port.port], on=False))
        self._begun.clear()
