"""Advice on the model's problems beyond their messages: what to write instead, and what a problem leads to.

The model's own help is independent of the form of the specification. Here it is known how each declaration is written,
and which topics a port could be attached to.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from typing import Final

from midstride.model.best import consumers_of
from midstride.model.component import FunctionalityRef, PortRef
from midstride.model.configuration import Configuration
from midstride.model.contract import Contract, Predicate, satisfies
from midstride.model.diagnostics import Problem
from midstride.model.specification import Specification

# Searching for matching topics is linear in the size of the system, so the number of searches is limited.
_SHOWN: Final = 3
MAX_SEARCHES: Final = 20
_DEGRADED_SHOWN: Final = 8

# How a name is declared, by the section of the JSON form that it would be in.
_DECLARATIONS: Final = {
    "topics": "topic {name} : TYPE",
    "resources": "resource {name} = CAPACITY",
    "components": "component {name} {{ … }}",
    "containers": "container {name}",
    "hosts": "host {name} {{ … }}",
}


class Hints:
    """Help for the problems of one specification."""

    def __init__(self, specification: Specification) -> None:
        self._specification = specification
        self._searches = 0

    def help_for(self, problem: Problem, name: str) -> str | None:
        """Advice on ``problem``, reported at a place with the text ``name``; None if nothing is known."""
        if problem.code == "E008" and not problem.help.startswith("did you mean"):
            declare = _declaration(problem, name)
            if declare is not None:
                return f"{problem.help}; or {declare}" if problem.help.startswith("known:") else declare
        if problem.code == "W030" and self._searches < MAX_SEARCHES:
            self._searches += 1
            return self._attachment(problem) or problem.help
        return problem.help or None

    def _attachment(self, problem: Problem) -> str | None:
        """The statement that attaches the port to the topics whose contracts match."""
        _, role, _, name = problem.subject
        component = self._specification.components[self._specification.nodes[role].component]
        output = component.has_output(name)
        owner = component.find_owner(name) if output else None
        stated: Contract | None = None if output else component.inputs[name]
        if owner is not None and owner.modes:
            stated = owner.modes[0].guarantee(name)
        if not isinstance(stated, Predicate):
            return None
        matching = [
            topic
            for topic, connector in sorted(self._specification.connectors.items())
            if (satisfies(stated, connector.guarantee) if output else satisfies(connector.guarantee, stated))
        ]
        if not matching:
            return None
        arrow = "->" if output else "<-"
        examples = " or ".join(f"`{name} {arrow} {topic}`" for topic in matching[:_SHOWN])
        return f"attach it to a topic that matches: {examples}{' …' if len(matching) > _SHOWN else ''}"


def _declaration(problem: Problem, name: str) -> str | None:
    section = problem.declared[-1] if problem.declared else ""
    if section == "parameters":
        return f"declare it in {problem.declared[1]}: `parameters {{ {name} = … }}`"
    if section in _DECLARATIONS and len(problem.declared) == 1:
        return f"declare it: `{_DECLARATIONS[section].format(name=name)}`"
    return None


def impact(problem: Problem, specification: Specification, configuration: Configuration) -> str | None:
    """The functionalities that a mismatched attachment (E020) keeps from their normal modes in ``configuration``, which
    is the initial one; None if there are none."""
    _, role, _, port, index = problem.subject
    topic = specification.nodes[role].attachments[port][int(index)]
    degraded = _degraded(configuration, consumers_of(configuration, PortRef(role, port), topic))
    if not degraded:
        return None
    shown = [f"{ref} will be in mode {configuration.mode(ref).name}" for ref in degraded[:_DEGRADED_SHOWN]]
    more = len(degraded) - _DEGRADED_SHOWN
    return ", ".join(shown) + (f", and {more} more below their normal modes" if more > 0 else "")


def _degraded(configuration: Configuration, first: Iterable[FunctionalityRef]) -> list[FunctionalityRef]:
    """The functionalities of ``first`` below their normal modes, and those degraded by them, nearest first."""
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
