"""What follows from an attachment whose contracts do not fit: who cannot be at its normal mode on its account."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable

from midstride.model.component import FunctionalityRef, PortRef
from midstride.model.configuration import Configuration
from midstride.model.diagnostics import Problem
from midstride.model.specification import Specification, initial

_SHOWN = 8


class ImpactNotes:
    """Tells what follows in one specification. Meaningful where nothing else is wrong with it."""

    def __init__(self, specification: Specification) -> None:
        self.specification = specification
        self._initial: Configuration | None = None

    def of(self, problem: Problem) -> str | None:
        """What follows from an unfit attachment (E020), or None where nothing does."""
        if self._initial is None:
            self._initial = initial(self.specification)
        configuration = self._initial
        _, role, _, port, index = problem.subject
        attached = PortRef(role, port)
        topic = self.specification.nodes[role].attachments[port][int(index)]
        first: Iterable[FunctionalityRef] = (
            configuration.consumers(topic) if configuration.is_output(attached) else configuration.users(attached)
        )
        fallen = self._fallen(configuration, first)
        if not fallen:
            return None
        told = [f"{ref} will be in mode {configuration.mode(ref).name}" for ref in fallen[:_SHOWN]]
        more = len(fallen) - _SHOWN
        return ", ".join(told) + (f", and {more} more below their normal modes" if more > 0 else "")

    def _fallen(self, configuration: Configuration, first: Iterable[FunctionalityRef]) -> list[FunctionalityRef]:
        """Those below their normal modes among ``first``, and those that fall with them, nearest first."""
        found: dict[FunctionalityRef, None] = {}
        waiting = deque(dict.fromkeys(first))
        while waiting:
            ref = waiting.popleft()
            if ref in found or configuration.modes[ref] == 0:
                continue
            found[ref] = None
            for output in configuration.functionality(ref).outputs:
                for topic in configuration.attached_to(PortRef(ref.instance, output)):
                    waiting.extend(sorted(set(configuration.consumers(topic))))
        return list(found)
