"""The cost of moving the state of a node without Midstride's API to its replacement: planned, and as measured."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Final

from midstride.model.action import Create, Handover, Remove
from midstride.model.component import ComponentSpec
from midstride.model.configuration import Configuration
from midstride.model.specification import handover_seconds
from midstride.plan.plan import Plan
from midstride.runtime.instance_life import LatestState
from midstride.runtime.records.reports import Outcome
from midstride.verdicts import change_facts
from midstride.verdicts.assessment import Assessment

# An output that was silent for more than so many of its periods was late: one period is between any two messages.
LATE: Final = 1.5


def planned_transfers(plan: Plan, states: Mapping[str, LatestState]) -> Iterator[Assessment]:
    """Assess what waits while ``plan`` moves the state of nodes that offer it.

    ``states``: what each instance reported last.

    Where the old node is removed first, nothing but what the plan says anyway waits.
    """
    change = plan.change
    created: set[str] = set()
    removed_first: set[str] = set()
    for step in plan.steps:
        match step.action:
            case Create(instance):
                created.add(instance.name)
            case Remove(name) if change.replaced.get(name) not in created:
                removed_first.add(name)
    swaps = [swap for step in plan.steps if isinstance(step.action, Handover) for swap in step.action.swaps]
    connectors = {**change.start.context.connectors, **change.target.connectors}
    for old, new in change.replaced.items():
        latest = states.get(old)
        before, after = change.component_of(old), change.component_of(new)
        kinds = {before.has_agent, after.has_agent}
        own_code = before.gate is after.gate is None  # which is held at a slot
        if latest is None or not latest.state.keeps_state or own_code or old in removed_first:
            continue
        if len(kinds) == 2:
            because = f"{old} {_kind(before)}, and {new} {_kind(after)}, so neither waits for the other's state"
            yield change_facts.state_left_behind(old, new, f"{because}; `--strategy paper` moves it")
        elif "none" in (before.gate, after.gate):
            because = "with `gate none`, nothing holds a node back while its state moves; `--strategy paper` moves it"
            yield change_facts.state_left_behind(old, new, because)
        else:
            own = {connectors[swap.connector] for swap in swaps if swap.old.instance == old}
            topics = sorted(each.topic for each in own if each.kind == "topic")
            longest = handover_seconds(change.target.timing, "state_timeout")
            yield change_facts.silent_for_state(old, new, topics, longest)


def _kind(component: ComponentSpec) -> str:
    return "uses Midstride's API" if component.gate is None else f"has `gate {component.gate}`"


def silences_for_state(outcome: Outcome, now: Configuration) -> Iterator[Assessment]:
    """The silences of ``outcome``, after which ``now`` runs, that were longer than the periods of the outputs."""
    for new, moved in sorted(outcome.moved.items()):
        ports = [port for port, _ in now.attached_ports(new)] if new in now.instances else []
        rates = [rate for port in ports if (rate := now.rate(port))]
        if moved.silent is not None and rates and moved.silent > LATE / min(rates):
            yield change_facts.was_silent_for_state(new, moved.words, moved.silent)
