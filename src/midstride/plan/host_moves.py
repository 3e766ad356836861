"""Changes of hosts: which declarations a change may not alter, and the words for nodes that move."""

from __future__ import annotations

from collections.abc import Iterator

from midstride.errors import PlanRefused
from midstride.model.configuration import Configuration
from midstride.model.hosts import host_in_words
from midstride.model.specification import Specification
from midstride.plan.change import Change, measured_key


def require_same_hosts(start: Configuration, before: Specification, after: Specification) -> None:
    """Raises PlanRefused where a host on which something runs would be another computer, or another folder of it."""
    if before.hosts == after.hosts:
        return
    for name in sorted({instance.host for instance in start.instances.values()}):
        old, new = before.hosts.get(name), after.hosts.get(name)
        if old is not None and new is not None and new != old:
            both = [(word, getattr(old, word), getattr(new, word)) for word in ("ssh", "setup", "folder")]
            differ = [(word, was or "not stated", will or "not stated") for word, was, will in both if was != will]
            details = "; ".join(f"{word}: {was} -> {will}" for word, was, will in differ)
            on = ", ".join(sorted(each.name for each in start.instances.values() if each.host == name))
            raise PlanRefused(
                f"host {name}, on which {on} runs, is declared differently ({details}): declare it under another name, "
                "to which its nodes then move, or end the system first (`midstride down`)"
            )


def in_words(change: Change) -> Iterator[str]:
    """Yield which nodes move to another host, and how that differs from a replacement on one host."""
    for before, after in sorted(change.replaced.items()):
        old, new = change.instance(before), change.instance(after)
        if old.host == new.host:
            continue
        where = f"from {host_in_words(old.host)} to {host_in_words(new.host)}"
        same = "the same program" if old.component.same_body(new.component) else f"the program of {new.component.name}"
        yield (
            f"{new.role} moves {where}: {after} is a new process of {same} there, and holds the resources of that host "
            f"while {before} still holds those of its own; what they hand over crosses the network between the two"
            "; a hand-over is at a moment on the clocks of both hosts, and where these are not known to half a period, "
            f"a round trip later, when {before} has said that it has written its last message"
            f"{_not_measured(change, after)}"
        )


def _not_measured(change: Change, name: str) -> str:
    """Say that the start on the new host has not been measured, where it has not."""
    instance = change.instance(name)
    if instance.component.startup_seconds is not None or measured_key("create", instance) in change.measured:
        return ""
    return f"; how long {instance.component.name} takes to start there has not been measured"
