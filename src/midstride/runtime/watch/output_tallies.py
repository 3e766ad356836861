"""The messages of the outputs that a change exchanges, by their own count: also where no subscriber tells.

A count over the whole change needs no more than two reports of each side. It shows a silence of several periods; what
is shorter, subscribers that record show (:mod:`.subscriber_recording`). Where there is none, and for a longer time than
SHORT, or where a part of the count is missing, nothing is known, and that is said.
"""

from __future__ import annotations

from collections.abc import Container, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from midstride.errors import MidstrideError
from midstride.model.action import Action, Attach, Create, Handover
from midstride.model.component import ComponentSpec, PortRef
from midstride.model.configuration import Configuration
from midstride.runtime.change_observer import ChangeObserver
from midstride.runtime.manager_clock import Clock
from midstride.runtime.process.component_client import ComponentClient
from midstride.runtime.records.measure import SwapReport
from midstride.runtime.watch.subscriber_recording import Exchange, exchanges
from midstride.verdicts import change_facts
from midstride.verdicts.assessment import Assessment
from midstride.wire.state import LinkState


@dataclass(frozen=True, slots=True)
class _Begun:
    """An exchange, and its old side as last reported before: ``at`` in steady s.

    ``rate``: what it keeps writing (Hz); None where it guarantees no rate, or that is not in the time of the system.
    ``only_counted``: it does not use Midstride's API, by which each output is handed over from one slot to the next.
    """

    exchange: Exchange
    topic: str
    at: float
    link: LinkState
    rate: float | None
    only_counted: bool = False


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
            plain = components[old.instance].gate is not None or components[exchange.new.instance].gate is not None
            self._begun.append(_Begun(exchange, topic, latest.at, link, min(known) if rated else None, plain))

    async def assessments(
        self, last_numbers: Mapping[PortRef, int | None], received: Container[str] = (), *, resumed: bool
    ) -> list[Assessment]:
        """Return what the counts show; ``resumed``: the change was rolled back, so the old sides write again.

        ``received``: the topics of which a subscriber in the system has recorded what it received.
        """
        found: list[Assessment] = []
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
                passed = self._passed(each, link.count, last_numbers, resumed)
                found += filter(
                    None, self._assessments(each, str(writer), link, passed, now, resumed, each.topic in received)
                )
        return [*found, *(change_facts.unanswered_outputs(name, topics) for name, topics in unanswered.items())]

    def _assessments(
        self,
        begun: _Begun,
        writer: str,
        link: LinkState,
        passed: int | None,
        now: float,
        resumed: bool,
        is_received: bool,
    ) -> Iterator[Assessment | None]:
        if link.inactive is not None:
            seconds = link.inactive - ((begun.link.inactive or 0.0) if resumed else 0.0)
            yield change_facts.inactive(begun.topic, writer, max(0.0, seconds), begun.rate)
            if seconds > 0 and not is_received:
                yield change_facts.written_by_lifecycle(begun.topic, writer)
        elif begun.rate is not None and passed is None:
            yield change_facts.not_counted(begun.topic, str(begun.exchange.old))
        elif begun.rate is not None and passed is not None:
            window = now - begun.at
            lost = change_facts.written(begun.topic, writer, passed, window, begun.rate)
            yield lost
            if lost is None and begun.only_counted and not is_received:
                yield change_facts.silent_between_counts(begun.topic, writer, window, begun.rate)

    def _passed(
        self, begun: _Begun, count: int, last_numbers: Mapping[PortRef, int | None], resumed: bool
    ) -> int | None:
        """The number of messages that both sides have written since the change began; None where a part is not known.

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


def recorded_topics(swaps: Iterable[SwapReport]) -> set[str]:
    """The topics of which a subscriber in the system shows how long it received nothing, or what it missed.

    Of a change that was rolled back before the new side wrote, it may show the silence alone.
    """
    return {each.topic for each in swaps if each.gap is not None or each.missed is not None}


def _rate(components: Mapping[str, ComponentSpec], port: PortRef) -> float | None:
    """Return what an output guarantees in its normal mode (Hz)."""
    component = components[port.instance]
    owner = component.find_owner(port.port)
    return None if owner is None else component.stated_rate(port.port, {owner.name: owner.modes[0].name})


def _measured(link: LinkState) -> float | None:
    """The rate of an output (Hz), where a whole window is measured."""
    measured = link.measured
    return None if measured is None or measured.covered < measured.window else measured.rate
