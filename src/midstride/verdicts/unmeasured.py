"""Nodes of which nothing measures what they do: why, and what is said of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from midstride.model.component import ComponentSpec
from midstride.verdicts.assessment import Assessment, listed, seconds_in_words


def unmeasured_exchange(
    role: str, because: str, *, down: float | None = None, together: float | None = None, done: bool = True
) -> Assessment:
    """A node of which nothing measures what it does was started and ended.

    ``down``: how long it took from when the one was asked to end until the process of the other was started (s); they
    did not run at once. ``together``: for how long both ran. None: not known.
    """
    words = f"what {role} does: {because}"
    if down is not None and down > 0:
        time = f"exchanged within {seconds_in_words(down)}, and when its new program had started up is not known"
        return Assessment(role, "lost", f"{role} was down, for how long is not known: {time}. {words}")
    if together is not None and done:
        words += f". It was never down: both instances ran for {seconds_in_words(together)}"
    return Assessment(role, "not_measurable", words)


def unmeasured_others(roles: Sequence[str], because: str) -> Assessment:
    """Nodes that a change leaves alone, of which nothing measures whether they keep working."""
    return Assessment(listed(roles), "not_measurable", f"what {listed(roles)} {_do(roles)}: {because}")


def why_unmeasured(component: ComponentSpec) -> str | None:
    """The reason why nothing measures what a node of ``component`` does; None where a gate, a page or its agent does.

    Of a program that ends, its exit status says that its work is done.
    """
    if component.gate is None or component.once:
        return None
    if not component.ports():
        return "no ports are stated"
    if len(component.service_ports()) == len(component.ports()):
        return "nothing counts requests to services"
    if not component.counts_messages and not component.has_lifecycle:
        return f"nothing counts messages (`gate {component.gate}`)"
    return None


def bound_not_known(server: str, name: str, because: str) -> str:
    """Return that nothing shows whether a server answers as it promises: ``name`` is that of its service."""
    return f"whether {server} answers on {name} in time ({because})"


def unmeasured_in_words(components: Mapping[str, ComponentSpec]) -> list[str]:
    """The nodes of which nothing measures what they do, one text for each reason; by role, their components."""
    return [f"what {listed(roles)} {_do(roles)} ({because})" for because, roles in _by_reason(components).items()]


def unmeasured_nodes(components: Mapping[str, ComponentSpec]) -> list[Assessment]:
    """One assessment for each reason why nothing measures what nodes do; by role, their components."""
    return [unmeasured_others(roles, because) for because, roles in _by_reason(components).items()]


def _by_reason(components: Mapping[str, ComponentSpec]) -> dict[str, list[str]]:
    """The roles of which nothing measures what their nodes do, by the reason."""
    found: dict[str, list[str]] = {}
    for role, component in sorted(components.items()):
        if (because := why_unmeasured(component)) is not None:
            found.setdefault(because, []).append(role)
    return found


def _do(roles: Sequence[str]) -> str:
    return "does" if len(roles) == 1 else "do"
