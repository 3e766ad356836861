"""The messages of the outputs that a change exchanges, by their own count: also where no subscriber tells.

A count over the whole change needs no more than two reports of each side. It shows a silence of several periods; what
is shorter, subscribers that record show (:mod:`.subscriber_recording`). Where a part of the count is missing, nothing
is known of it, and that is said.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from midstride import verdicts
from midstride.errors import MidstrideError
from midstride.model.action import Action, Attach, Create, Handover
from midstride.model.component import ComponentSpec, PortRef
from midstride.model.configuration import Configuration
from midstride.runtime.change_observer import ChangeObserver
from midstride.runtime.manager_clock import Clock
from midstride.runtime.process.component_client import ComponentClient
from midstride.runtime.watch.subscriber_recording import Exchange, exchanges
from midstride.wire.state import LinkState


@dataclass(frozen=True, slots=True)
class _Begun:
    """An exchange, and its old side as last reported before: ``at`` in steady s.

    ``rate``: what it keeps writing (Hz); None where it guarantees no rate, or that is not in the time of the system.
    """

    exchange: Exchange
    topic: str
    at: float
    link: LinkState
    rate: float | None


@dataclass(slots=True)
class OutputTallies(ChangeObserver):
    """The counts of one change. What cannot be asked for in the end is said to be not measurable."""

    client: ComponentClient
    clock: Clock
    _begun: list[_Begun] = field(default_factory=list)
    # What the change has attached, which counts from 0 since, and to which outputs it has handed over.
    _attached: set[PortRef] = field(default_factory=set)
    _taken_over: set[PortRef] = field(default_factory=set)

    async def performed(self, action: Action) -> None:
        """Note which counts begin anew."""
        match action:
            case Attach(port):
                self._attached.add(port)
            case Handover(swaps):
                self._taken_over.update(swap.new for swap in swaps)

    def begin(self, configuration: Configuration, actions: Sequence[Action]) -> None:
        """Note what each old side has written, by its last report."""
        components = {name: instance.component for name, instance in configuration.instances.items()}
        components |= {each.instance.name: each.instance.component for each in actions if isinstance(each, Create)}
        for exchange in exchanges(configuration, actions):
            old, topic = exchange.old, configuration.topic(exchange.connector)
            latest = self.client.life.latest(old.instance)
            link = None if latest is None else latest.state.ports.get(old.port, {}).get(topic)
            if latest is None or link is None or link.gate != "open":
                continue  # it does not answer, or has been degraded: what that means is reported by itself
            rates = [configuration.rate(old), _rate(components, exchange.new), _measured(link)]
            known = [rate for rate in rates if rate is not None]
            rated = rates[0] is not None and rates[1] is not None and not latest.state.simulated_time
            self._begun.append(_Begun(exchange, topic, latest.at, link, min(known) if rated else None))

    async def assessments(
        self, last_numbers: Mapping[PortRef, int | None], *, resumed: bool
    ) -> list[verdicts.Assessment]:
        """Return what the counts show; ``resumed``: the change was rolled back, so the old sides write again."""
        found: list[verdicts.Assessment] = []
        unanswered: dict[str, list[str]] = {}
        for each in self._begun:
            writer = each.exchange.old if resumed else each.exchange.new
            try:
                state = await self.client.peek(writer.instance)
            except MidstrideError:
                unanswered.setdefault(writer.instance, []).append(each.topic)
                continue
            now, link = self.clock.steady(), state.ports.get(writer.port, {}).get(each.topic)
            if link is not None:
                found += filter(None, self._assessments(each, writer, link, last_numbers, now, resumed))
        return [*found, *(verdicts.unanswered_outputs(name, topics) for name, topics in unanswered.items())]

    def _assessments(
        self,
        begun: _Begun,
        writer: PortRef,
        link: LinkState,
        last_numbers: Mapping[PortRef, int | None],
        now: float,
        resumed: bool,
    ) -> Iterator[verdicts.Assessment | None]:
        if link.inactive is not None:
            before = begun.link.inactive if resumed else 0.0
            yield verdicts.inactive(begun.topic, str(writer), max(0.0, link.inactive - (before or 0.0)), begun.rate)
        elif begun.rate is not None:
            passed = self._passed(begun, link.count, last_numbers, resumed)
            if passed is None:
                yield verdicts.not_counted(begun.topic, str(begun.exchange.old))
            else:
                yield verdicts.written(begun.topic, str(writer), passed, now - begun.at, begun.rate)

    def _passed(
        self, begun: _Begun, count: int, last_numbers: Mapping[PortRef, int | None], resumed: bool
    ) -> int | None:
        """How many messages both sides have written since the change began; None where a part of that is not known.

        ``count``: what the side that writes in the end has written since it was attached last.
        """
        old, new = begun.exchange.old, begun.exchange.new
        if not resumed or old in self._attached:
            last = last_numbers.get(old)
            by_old = None if last is None else last - begun.link.count + count
        else:
            by_old = count - begun.link.count
        if not resumed or new not in self._taken_over:
            return by_old
        by_new = last_numbers.get(new)  # it wrote until the topic was handed back
        return None if by_old is None or by_new is None else by_old + by_new


def _rate(components: Mapping[str, ComponentSpec], port: PortRef) -> float | None:
    """Return what an output guarantees in its normal mode (Hz)."""
    component = components[port.instance]
    owner = component.find_owner(port.port)
    return None if owner is None else component.stated_rate(port.port, {owner.name: owner.modes[0].name})


def _measured(link: LinkState) -> float | None:
    """The rate of an output (Hz), where a whole window is measured."""
    measured = link.measured
    return None if measured is None or measured.covered < measured.window else measured.rate
