"""The assumptions broken in what really runs: docs/semantics.md section 3 again, without the model's own code.

It works on what the processes show of themselves. Only whether one contract satisfies another is taken from the model.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable
from typing import NamedTuple

from midstride.model.component import ComponentSpec, Connector, FunctionalityRef, InputAlternatives
from midstride.model.configuration import SystemContext
from midstride.model.contract import satisfies
from midstride.model.specification import Specification


class Shown(NamedTuple):
    """``modes``: functionality and mode; ``links``: port and topic of each attachment whose gate is not closed.

    ``key`` identifies the declaration of ``component``.
    """

    instance: str
    key: str
    component: ComponentSpec
    modes: tuple[tuple[str, str], ...]
    links: tuple[tuple[str, str], ...]


class Oracle:
    """Judges systems whose topics and environment are those of ``specifications``."""

    def __init__(self, specifications: Iterable[Specification]) -> None:
        self._contexts: list[SystemContext] = []
        self._topics: dict[str, list[Connector]] = {}
        for specification in specifications:
            self._contexts.append(specification.context)
            for connector in specification.connectors.values():
                self._topics.setdefault(connector.topic, []).append(connector)
        # The topics that the environment satisfies.
        self._given = {
            topic
            for topic, connectors in self._topics.items()
            for context in self._contexts
            for connector in connectors
            if any(
                satisfies(each.guarantee, connector.guarantee) for each in context.publishers_out_of_scope(connector)
            )
        }
        self._provides: dict[tuple[str, str, str, str], bool] = {}
        self._needs: dict[tuple[str, str, str], tuple[frozenset[str], ...]] = {}
        self._accepts: dict[tuple[str, str, str], bool] = {}

    @property
    def served_outside(self) -> frozenset[str]:
        """The services that the environment satisfies."""
        return frozenset(
            topic for topic in self._given if any(each.kind == "service" for each in self._topics.get(topic, ()))
        )

    def period(self, topic: str) -> float:
        """The period of a topic that has a rate (s), else 0."""
        rates = [connector.guarantee.rate or 0.0 for connector in self._topics.get(topic, ())]
        fastest = max(rates, default=0.0)
        return 1 / fastest if fastest else 0.0

    def longest_period(self) -> float:
        """The longest period of a topic (s); 0 where none has a rate."""
        return max(map(self.period, self._topics), default=0.0)

    def broken(
        self, shown: Collection[Shown], hears: Callable[[str, str], bool] = lambda _, by: True
    ) -> list[FunctionalityRef]:
        """The functionalities whose current mode assumes what nothing guarantees.

        ``hears(instance, by)``: whether what an instance publishes arrives at another one.
        """
        providers: dict[str, list[str]] = {}
        for each in shown:
            modes = dict(each.modes)
            for port, topic in each.links:
                if port not in each.component.inputs and topic not in self._given:
                    owner = each.component.owner(port).name
                    if self._provided(each, owner, modes[owner], port, topic):
                        providers.setdefault(topic, []).append(each.instance)
        found = []
        for each in shown:
            inputs = {
                port
                for port, topic in each.links
                if topic in self._given or any(hears(name, each.instance) for name in providers.get(topic, ()))
                if self._accepted(each, port, topic)
            }
            for functionality, mode in each.modes:
                if any(inputs.isdisjoint(names) for names in self._needed(each, functionality, mode)):
                    found.append(FunctionalityRef(each.instance, functionality))
        return found

    def reflex_applies(self, shown: Shown, functionality: str, received: Collection[str]) -> bool:
        """Return whether each assumption of the mode is about inputs whose silence shows.

        Those have a rate, and have ``received`` something since they were attached.
        """
        inputs, mode = shown.component.inputs, dict(shown.modes)[functionality]
        needed = self._needed(shown, functionality, mode)
        return all(inputs[name].rate and name in received for names in needed for name in names)

    def assumes_one_of(self, shown: Shown, functionality: str, lost: Collection[str]) -> bool:
        """Return whether an assumption of its mode can be met by none but the inputs in ``lost``."""
        needed = self._needed(shown, functionality, dict(shown.modes)[functionality])
        return bool(lost) and any(names <= set(lost) for names in needed)

    def _provided(self, shown: Shown, functionality: str, mode: str, port: str, topic: str) -> bool:
        """Return whether that output satisfies the topic in that mode."""
        key = (shown.key, mode, port, topic)
        if key not in self._provides:
            spec = shown.component.functionalities[functionality]
            offered = spec.modes[spec.mode_index(mode)].guarantee(port)
            self._provides[key] = any(satisfies(offered, each.guarantee) for each in self._topics.get(topic, ()))
        return self._provides[key]

    def _accepted(self, shown: Shown, port: str, topic: str) -> bool:
        """Return whether that input can rely on the topic."""
        key = (shown.key, port, topic)
        if key not in self._accepts:
            assumption = shown.component.inputs.get(port)
            connectors = self._topics.get(topic, ())
            self._accepts[key] = assumption is not None and any(
                satisfies(connector.guarantee, assumption) for connector in connectors
            )
        return self._accepts[key]

    def _needed(self, shown: Shown, functionality: str, mode: str) -> tuple[frozenset[str], ...]:
        """The inputs that each assumption of that mode can be met by, without those that the environment meets."""
        key = (shown.key, functionality, mode)
        if key not in self._needs:
            spec, inputs = shown.component.functionalities[functionality], shown.component.inputs
            needs = []
            for assumption in spec.modes[spec.mode_index(mode)].assumptions:
                if isinstance(assumption, InputAlternatives):
                    needs.append(frozenset(assumption.inputs))
                elif not any(
                    satisfies(offer.guarantee, assumption) for context in self._contexts for offer in context.offers()
                ):
                    needs.append(frozenset(name for name in spec.inputs if satisfies(inputs[name], assumption)))
            self._needs[key] = tuple(needs)
        return self._needs[key]
