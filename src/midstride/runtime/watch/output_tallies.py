"""What the outputs that a change exchanges have written meanwhile, by their own count: also where no subscriber tells.

A count over the whole change needs no more than two reports of each side. It shows a silence of several periods; what
is shorter, subscribers that record show (:mod:`.subscriber_recording`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from midstride import verdicts
from midstride.errors import MidstrideError
from midstride.model.action import Action, Create
from midstride.model.component import ComponentSpec, PortRef
from midstride.model.configuration import Configuration
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
class OutputTallies:
    """The counts of one change. What cannot be asked for in the end is said to be not measurable."""

    client: ComponentClient
    clock: Clock
    _begun: list[_Begun] = field(default_factory=list)

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

    @staticmethod
    def _assessments(
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
            last = last_numbers.get(begun.exchange.old)
            if resumed and link.count >= max(begun.link.count, last or 0):
                passed = link.count - begun.link.count
            elif last is not None:  # the new side's count, or that of the old one, attached anew, began at 0
                passed = last - begun.link.count + link.count
            else:
                return  # attached anew, and how much it had written before is not known
            yield verdicts.written(begun.topic, str(writer), passed, now - begun.at, begun.rate)


def _rate(components: Mapping[str, ComponentSpec], port: PortRef) -> float | None:
    """Return what an output guarantees in its normal mode (Hz)."""
    component = components[port.instance]
    owner = component.find_owner(port.port)
    return None if owner is None else component.stated_rate(port.port, {owner.name: owner.modes[0].name})


def _measured(link: LinkState) -> float | None:
    """The rate of an output (Hz), where a whole window is measured."""
    measured = link.measured
    return None if measured is None or measured.covered < measured.window else measured.rate
