"""Records what each subscriber of a swapped topic receives, from before the first step of a plan to after its last."""

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

# Recording continues for 20 periods after the last step, but at most for this long (s).
LONGEST_TAIL: Final = 10.0
# How long it continues if no rate defines a period (s).
TAIL_WITHOUT_RATE: Final = 0.5


@dataclass(frozen=True, slots=True)
class Exchange:
    """A publisher of a topic that a plan replaces with another one of the same role."""

    connector: str
    old: PortRef
    new: PortRef


def exchanges(configuration: Configuration, actions: Iterable[Action]) -> list[Exchange]:
    """The publishers that ``actions`` exchange, by hand-over or by detaching one and attaching the other."""
    found: list[Exchange] = []
    roles = {name: instance.role for name, instance in configuration.instances.items()}
    detached: list[tuple[str, PortRef]] = []
    for action in actions:
        match action:
            case Create(instance):
                roles[instance.name] = instance.role
            case Handover(swaps):
                found.extend(Exchange(swap.connector, swap.old, swap.new) for swap in swaps)
            case Detach(port, connector) if configuration.has_port(port) and configuration.is_output(port):
                detached.append((connector, port))
            case Attach(port, connector):
                found.extend(
                    Exchange(connector, old, port)
                    for name, old in detached
                    if name == connector and old.port == port.port and roles[old.instance] == roles[port.instance]
                )
            case _:
                pass
    return found


@dataclass(slots=True)
class _RecordedInput:
    exchange: Exchange
    topic: str
    input: PortRef
    begun: int
    guaranteed_period: float | None
    grid_period: float | None


@dataclass(slots=True)
class Recording:
    """The recording of one plan. Failures do not affect the plan: their figures are reported as unknown."""

    client: ComponentClient
    clock: Clock
    recorded: list[_RecordedInput] = field(default_factory=list)
    unknown: list[SwapReport] = field(default_factory=list)
    _driving_inputs: dict[PortRef, PortRef] = field(default_factory=dict)
    # The recording inputs, and since when (ns); None if the reply was lost.
    _begun: dict[PortRef, int | None] = field(default_factory=dict)

    async def begin(self, configuration: Configuration, actions: Sequence[Action]) -> None:
        """Start recording at each subscriber that the plan does not remove."""
        removed = {action.instance for action in actions if isinstance(action, Remove)}
        for exchange in exchanges(configuration, actions):
            topic = configuration.context.connectors[exchange.connector].topic
            guarantee = _normal_guarantee(configuration, exchange.old)
            period = 1 / guarantee.rate if guarantee is not None and guarantee.rate else None
            grid_period = await self._grid_period(exchange.old)
            for port in sorted(configuration.subscribers_on(exchange.connector)):
                if port.instance in removed:
                    continue
                try:
                    begun = await self._begin(port)
                except MidstrideError:
                    self.unknown.append(_unknown_report(topic, port, period))
                    continue
                self.recorded.append(_RecordedInput(exchange, topic, port, begun, period, grid_period))

    async def _begin(self, port: PortRef) -> int:
        """Start recording at ``port`` unless it does; returns since when it records (ns)."""
        begun = self._begun.setdefault(port, None)
        if begun is None:
            recording = await self.client.change(port.instance, RecordCommand(inputs=[port.port], on=True))
            begun = self._begun[port] = recording.now
        return begun

    async def record_driving_inputs(self, configuration: Configuration, action: Handover) -> None:
        """Just before a hand-over: record the input that drives the new side of a message-driven output."""
        for swap in action.swaps:
            try:
                if (await self.client.read(swap.old.instance, GridCommand(port=swap.old.port))).trigger != "message":
                    continue
                owner = configuration.component(swap.new.instance).owner(swap.new.port)
                inputs = [PortRef(swap.new.instance, name) for name in owner.inputs]
                if len(inputs) == 1:
                    await self._begin(inputs[0])
                    self._driving_inputs[swap.old] = inputs[0]
            except MidstrideError:
                continue  # the hand-over reports the cause

    async def _grid_period(self, old: PortRef) -> float | None:
        try:
            return (await self.client.read(old.instance, GridCommand(port=old.port))).period
        except MidstrideError:
            return None

    async def finish(self, last_numbers: dict[PortRef, int | None]) -> list[SwapReport]:
        """Keep recording for a while, then compute the figures. :meth:`stop` must be called afterwards.

        If cancelled, it reports unknown figures instead of raising: the plan is done, and its outcome must be reported.
        """
        if not self.recorded:
            return self.unknown
        periods = [each.guaranteed_period for each in self.recorded]
        tails = [TAIL_WITHOUT_RATE if period is None else WINDOW_PERIODS * period for period in periods]
        try:
            await self.clock.sleep(min(max(tails), LONGEST_TAIL))
            # The subscribers first: then the driving inputs have received every message that was answered.
            ports = dict.fromkeys([*(each.input for each in self.recorded), *self._driving_inputs.values()])
            records = {port: await self._records(port) for port in ports}
        except asyncio.CancelledError:
            records = {}
        inputs = {old: records.get(port) for old, port in self._driving_inputs.items()}
        reports = [_report(each, records.get(each.input), inputs, last_numbers) for each in self.recorded]
        return reports + self.unknown

    async def stop(self, live: Container[str]) -> None:
        """Stop recording at the instances in ``live``."""
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
    recorded_input: _RecordedInput,
    records: Records | None,
    inputs: dict[PortRef, Records | None],
    last_numbers: dict[PortRef, int | None],
) -> SwapReport:
    if records is None:
        return _unknown_report(recorded_input.topic, recorded_input.input, recorded_input.guaranteed_period)
    driving = inputs.get(recorded_input.exchange.old)
    sources = None if driving is None else [row.source for row in driving.rows]
    return report(
        Observation(
            topic=recorded_input.topic,
            subscriber=str(recorded_input.input),
            rows=records.rows,
            begun=recorded_input.begun,
            ended=records.now,
            guaranteed_period=recorded_input.guaranteed_period,
            grid_period=recorded_input.grid_period,
            last_number=last_numbers.get(recorded_input.exchange.old),
            inputs=None if sources is None else [source for source in sources if source is not None],
        )
    )


def _normal_guarantee(configuration: Configuration, output: PortRef) -> Predicate | None:
    guarantee = configuration.component(output.instance).owner(output.port).modes[0].guarantee(output.port)
    return guarantee if isinstance(guarantee, Predicate) else None


def _unknown_report(topic: str, port: PortRef, period: float | None) -> SwapReport:
    return SwapReport(topic, str(port), period, None, None, None, None, None)
