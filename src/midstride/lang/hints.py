"""What to write instead, in the language's own words, where the model can only tell what is wrong.

The model's advice holds for specifications of any form; here it is known how each declaration is written, and which
topics a port could be attached to.
"""

from __future__ import annotations

from typing import Final

from midstride.model.contract import Contract, Predicate, satisfies
from midstride.model.diagnostics import Problem
from midstride.model.specification import Specification

# Looking for the topics that fit is linear in the system: for a port or a dozen, not for a thousand.
_SHOWN: Final = 3
MAX_SOUGHT: Final = 20

# How what is named is declared, by the section of the JSON form that it would be in.
_DECLARATIONS: Final = {
    "topics": "topic {name} : TYPE",
    "resources": "resource {name} = CAPACITY",
    "components": "component {name} {{ … }}",
}


class Hints:
    """Advice on the problems of one specification."""

    def __init__(self, specification: Specification) -> None:
        self._specification = specification
        self._sought = 0

    def on(self, problem: Problem, name: str) -> str | None:
        """What to do about ``problem``, which is told at a place that reads ``name``; None where nothing is known."""
        if problem.code == "E008" and not problem.help.startswith("did you mean"):
            how = _declaration(problem, name)
            if how is not None:
                return f"{problem.help}; or {how}" if problem.help.startswith("known:") else how
        if problem.code == "W030" and self._sought < MAX_SOUGHT:
            self._sought += 1
            return self._attachment(problem) or problem.help
        return problem.help or None

    def _attachment(self, problem: Problem) -> str | None:
        """How the port would be attached to the topics that fit it."""
        _, role, _, name = problem.subject
        component = self._specification.components[self._specification.nodes[role].component]
        output = component.has_output(name)
        owner = component.find_owner(name) if output else None
        stated: Contract | None = None if output else component.inputs[name]
        if owner is not None and owner.modes:
            stated = owner.modes[0].guarantee(name)
        if not isinstance(stated, Predicate):
            return None
        fitting = [
            topic
            for topic, connector in sorted(self._specification.connectors.items())
            if (satisfies(stated, connector.guarantee) if output else satisfies(connector.guarantee, stated))
        ]
        if not fitting:
            return None
        arrow = "->" if output else "<-"
        told = " or ".join(f"`{name} {arrow} {topic}`" for topic in fitting[:_SHOWN])
        return f"attach it, to what fits it: {told}{' …' if len(fitting) > _SHOWN else ''}"


def _declaration(problem: Problem, name: str) -> str | None:
    section = problem.declared[-1] if problem.declared else ""
    if section == "parameters":
        return f"declare it in {problem.declared[1]}: `parameters {{ {name} = … }}`"
    if section in _DECLARATIONS and len(problem.declared) == 1:
        return f"declare it: `{_DECLARATIONS[section].format(name=name)}`"
    return None
