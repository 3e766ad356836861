"""Recording what every subscriber of a swapped topic sees, from before the first step to after the last."""

from __future__ import annotations

import asyncio
from collections.abc import Container, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Final

from midstride.errors import MidstrideError
from midstride.model.action import Action, Attach, Create, Detach, Handover, Remove
from midstride.model.component import PortRef
from midstride.model.configuration import Configuration
from midstride.model.contract import Predicate
from midstride.runtime.clock import Clock
from midstride.runtime.component_client import ComponentClient
from midstride.runtime.measure import WINDOW_PERIODS, Observation, SwapReport, report
from midstride.wire.commands import GridCommand, RecordCommand, Records, RecordsCommand

# The tail after the last step is 20 periods, but a slow topic does not keep the user waiting longer than this (s).
LONGEST_TAIL: Final = 10.0
# The tail where no rate says how long a period is (s).
TAIL_WITHOUT_RATE: Final = 0.5


@dataclass(frozen=True, slots=True)
class Exchange:
    """A publisher of a topic that a plan exchanges for another one of the same role."""

    connector: str
    old: PortRef
    new: PortRef


def exchanges(configuration: Configuration, actions: Iterable[Action]) -> list[Exchange]:
    """The publishers that ``actions`` exchange, whether by hand-over or by taking away and putting back."""
    found: list[Exchange] = []
    roles = {name: instance.role for name, instance in configuration.instances.items()}
    gone: list[tuple[str, PortRef]] = []
    for action in actions:
        match action:
            case Create(instance):
                roles[instance.name] = instance.role
            case Handover(swaps):
                found.extend(Exchange(swap.connector, swap.old, swap.new) for swap in swaps)
            case Detach(port, connector) if configuration.has_port(port) and configuration.is_output(port):
                gone.append((connector, port))
            case Attach(port, connector):
                found.extend(
                    Exchange(connector, old, port)
                    for name, old in gone
                    if name == connector and old.port == port.port and roles[old.instance] == roles[port.instance]
                )
            case _:
                pass
    return found


@dataclass(slots=True)
class _Subject:
    exchange: Exchange
    topic: str
    input: PortRef
    begun: int
    guaranteed_period: float | None
    grid_period: float | None


@dataclass(slots=True)
class Recording:
    """One recording. It never stands in the way of the plan: what cannot be recorded is reported as unknown."""

    client: ComponentClient
    clock: Clock
    subjects: list[_Subject] = field(default_factory=list)
    unknown: list[SwapReport] = field(default_factory=list)
    _witnesses: dict[PortRef, PortRef] = field(default_factory=dict)
    # Where recording is on, and since when (ns); None where the answer was lost.
    _begun: dict[PortRef, int | None] = field(default_factory=dict)

    async def begin(self, configuration: Configuration, actions: Sequence[Action]) -> None:
        """Turn recording on at each subscriber that is there before and after."""
        leaving = {action.instance for action in actions if isinstance(action, Remove)}
        for exchange in exchanges(configuration, actions):
            topic = configuration.context.connectors[exchange.connector].topic
            guarantee = _normal(configuration, exchange.old)
            period = 1 / guarantee.rate if guarantee is not None and guarantee.rate else None
            grid_period = await self._grid_period(exchange.old)
            for port in sorted(configuration.subscribers_on(exchange.connector)):
                if port.instance in leaving:
                    continue
                try:
                    begun = await self._begin(port)
                except MidstrideError:
                    self.unknown.append(_unknown(topic, port, period))
                    continue
                self.subjects.append(_Subject(exchange, topic, port, begun, period, grid_period))

    async def _begin(self, port: PortRef) -> int:
        """Turn recording on at ``port``, once; since when it is on there (ns)."""
        begun = self._begun.setdefault(port, None)
        if begun is None:
            recording = await self.client.change(port.instance, RecordCommand(inputs=[port.port], on=True))
            begun = self._begun[port] = recording.now
        return begun

    async def witness(self, configuration: Configuration, action: Handover) -> None:
        """Just before a hand-over: have the new side of a message-driven output note what there is to answer."""
        for swap in action.swaps:
            try:
                if (await self.client.read(swap.old.instance, GridCommand(port=swap.old.port))).trigger != "message":
                    continue
                owner = configuration.component(swap.new.instance).owner(swap.new.port)
                inputs = [PortRef(swap.new.instance, name) for name in owner.inputs]
                if len(inputs) == 1:
                    await self._begin(inputs[0])
                    self._witnesses[swap.old] = inputs[0]
            except MidstrideError:
                continue  # the hand-over itself will say what is wrong

    async def _grid_period(self, old: PortRef) -> float | None:
        try:
            return (await self.client.read(old.instance, GridCommand(port=old.port))).period
        except MidstrideError:
            return None

    async def finish(self, last_numbers: dict[PortRef, int | None]) -> list[SwapReport]:
        """Wait for the tail, and work out the figures. :meth:`stop` is still due.

        Whoever is cancelled meanwhile gets what is known by then: nothing. The change is done, and that is to be told.
        """
        if not self.subjects:
            return self.unknown
        periods = [subject.guaranteed_period for subject in self.subjects]
        tails = [TAIL_WITHOUT_RATE if period is None else WINDOW_PERIODS * period for period in periods]
        try:
            await self.clock.sleep(min(max(tails), LONGEST_TAIL))
            # The subscribers first: what they have received, the witnesses must have too.
            ports = dict.fromkeys([*(subject.input for subject in self.subjects), *self._witnesses.values()])
            records = {port: await self._records(port) for port in ports}
        except asyncio.CancelledError:
            records = {}
        inputs = {old: records.get(port) for old, port in self._witnesses.items()}
        reports = [_report(subject, records.get(subject.input), inputs, last_numbers) for subject in self.subjects]
        return reports + self.unknown

    async def stop(self, live: Container[str]) -> None:
        """Turn recording off in whichever of ``live`` it is on: they would go on keeping what nobody asks for."""
        for port in self._begun:
            if port.instance in live:
                await self.client.undo(port.instance, RecordCommand(inputs=[port.port], on=False))
        self._begun.clear()

    async def _records(self, port: PortRef) -> Records | None:
        try:
            return await self.client.read(port.instance, RecordsCommand(input=port.port))
        except MidstrideError:
            return None


def _report(
    subject: _Subject,
    records: Records | None,
    inputs: dict[PortRef, Records | None],
    last_numbers: dict[PortRef, int | None],
) -> SwapReport:
    if records is None:
        return _unknown(subject.topic, subject.input, subject.guaranteed_period)
    to_answer = inputs.get(subject.exchange.old)
    sources = None if to_answer is None else [row.source for row in to_answer.rows]
    return report(
        Observation(
            topic=subject.topic,
            subscriber=str(subject.input),
            rows=records.rows,
            begun=subject.begun,
            ended=records.now,
            guaranteed_period=subject.guaranteed_period,
            grid_period=subject.grid_period,
            last_number=last_numbers.get(subject.exchange.old),
            inputs=None if sources is None else [source for source in sources if source is not None],
        )
    )


def _normal(configuration: Configuration, output: PortRef) -> Predicate | None:
    guarantee = configuration.component(output.instance).owner(output.port).modes[0].guarantee(output.port)
    return guarantee if isinstance(guarantee, Predicate) else None


def _unknown(topic: str, port: PortRef, period: float | None) -> SwapReport:
    return SwapReport(topic, str(port), period, None, None, None, None, None)
