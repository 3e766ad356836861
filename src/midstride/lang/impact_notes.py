"""The impact of an attachment with mismatched contracts: the functionalities it keeps from their normal modes."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable

from midstride.model.component import FunctionalityRef, PortRef
from midstride.model.configuration import Configuration
from midstride.model.diagnostics import Problem
from midstride.model.specification import Specification, initial

_SHOWN = 8


class ImpactNotes:
    """Describes the impact of mismatches in a specification that has no other errors."""

    def __init__(self, specification: Specification) -> None:
        self.specification = specification
        self._initial: Configuration | None = None

    def of(self, problem: Problem) -> str | None:
        """The impact of a mismatched attachment (E020), or None if there is none."""
        if self._initial is None:
            self._initial = initial(self.specification)
        configuration = self._initial
        _, role, _, port, index = problem.subject
        attached = PortRef(role, port)
        topic = self.specification.nodes[role].attachments[port][int(index)]
        first: Iterable[FunctionalityRef] = (
            configuration.consumers(topic) if configuration.is_output(attached) else configuration.users(attached)
        )
        degraded = self._degraded(configuration, first)
        if not degraded:
            return None
        shown = [f"{ref} will be in mode {configuration.mode(ref).name}" for ref in degraded[:_SHOWN]]
        more = len(degraded) - _SHOWN
        return ", ".join(shown) + (f", and {more} more below their normal modes" if more > 0 else "")

    def _degraded(self, configuration: Configuration, first: Iterable[FunctionalityRef]) -> list[FunctionalityRef]:
        """Those of ``first`` that are below their normal modes, and those degraded as a consequence, nearest first."""
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
