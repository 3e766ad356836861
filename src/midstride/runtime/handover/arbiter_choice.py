"""The arbiter of a hand-over, which decides which of two components may write: chosen once, from their gates."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from midstride.errors import PlanRefused, StepFailed
from midstride.model.action import Create, Handover, Swap
from midstride.model.component import ComponentSpec
from midstride.model.configuration import Configuration
from midstride.model.hosts import host_in_words
from midstride.plan.plan import Plan

# How long the new side of a cut between two hosts may write, from its request on, before the old one has confirmed its
# first write (s): several requests on a line that loses some of them, or the longest stall of a busy control thread.
LEASE: Final = 1.0


@dataclass(frozen=True, slots=True)
class ArbiterKind:
    """One way to decide it (docs/semantics.md section 7).

    ``by_moment``: both sides know the moment of the cut, on one clock, and each functionality of the old side has a cut
    on its own time grid. Otherwise the right to write changes hands between two messages, for all outputs at once.
    ``needs_probation``: the new side runs, and writes behind its gate, before it takes over. ``exchange``: how long
    the two sides may take besides (s).
    """

    by_moment: bool
    needs_probation: bool = True
    exchange: float = 0.0


# Both processes have an agent: a moment, and a lock for the case that one side does not keep to it.
LOCK: Final = ArbiterKind(by_moment=True)
# A library holds back one side, or both: a word of shared memory.
BATON: Final = ArbiterKind(by_moment=False)
# How long a lifecycle node may take to become active, or inactive, unless it states another time (s).
TRANSITION: Final = 5.0


def choose_arbiter(component: Callable[[str], ComponentSpec], old: str, new: str) -> ArbiterKind:
    """The arbiter between two instances, of which ``component`` gives the components.

    Raises StepFailed where one of them cannot be held back for the other.
    """
    pair = {name: component(name) for name in (old, new)}
    gates = {name: component.gate for name, component in pair.items()}
    loose = next((name for name, each in pair.items() if not each.counts_messages), None)
    if loose is None:
        return LOCK if all(each.has_agent for each in pair.values()) else BATON
    if gates[old] == gates[new] == "lifecycle":  # neither can be held back but by its lifecycle state
        activation = pair[new].activate_seconds or TRANSITION
        return ArbiterKind(by_moment=False, needs_probation=False, exchange=TRANSITION + activation)
    if gates[old] == gates[new]:
        words = "both have `gate none`, so neither can be held back"
    else:
        kinds = " and ".join(
            f"{name} has `gate {gate}`" if gate else f"{name} uses Midstride's API" for name, gate in gates.items()
        )
        words = f"{kinds}, so {loose} cannot be held back for the other"
    raise StepFailed(f"{old} cannot hand over to {new}: {words}; use `--strategy paper`")


def require_answering(configuration: Configuration, swap: Swap) -> None:
    """Raises StepFailed where requests to the service or ROS action of ``swap`` cannot be handed over.

    Components with the API, and relays, have each request answered by one of the instances of a node, and so has the
    preloaded library; also between the two kinds, but for ROS actions (docs/protocols/services.md).
    """
    old, new = swap.old.instance, swap.new.instance
    components = {name: configuration.component(name) for name in (old, new)}
    words = f"{old} cannot hand over {swap.connector} to {new}"
    between_kinds = any(each.has_agent for each in components.values())
    is_action = components[old].kind_of(swap.old.port) == "action"
    decided = (name for name, each in components.items() if not (each.has_agent or each.loads_library))
    if (loose := next(decided, None)) is not None:
        how = f"{loose} has `gate {components[loose].gate}`, so both would answer requests while both run"
        way = _relay(components[loose]) if is_action and between_kinds else "`gate preload`, or "
        raise StepFailed(f"{words}: {how}; use {way}`--strategy paper`")
    inside = {name for name, each in components.items() if each.loads_library}
    if len(inside) == 1 and is_action:
        (plain,) = inside
        how = f"{plain} has `gate {components[plain].gate}`, and the other one has not, so both would execute each goal"
        raise StepFailed(f"{words}: {how}; use {_relay(components[plain])}`--strategy paper`")
    if configuration.instances[old].role != configuration.instances[new].role:
        roles = " and ".join(configuration.instances[name].role for name in (old, new))
        how = f"they are instances of different nodes ({roles}), and only those of one node share its requests"
        raise StepFailed(f"{words}: {how}; use `--strategy paper`")


def _relay(component: ComponentSpec) -> str:
    """The advice to run the program of ``component`` behind a relay; none where that is refused, as it has a client."""
    if any(not component.has_output(port) for port in component.service_ports()):
        return ""
    return f"`gate relay` for {component.name}, or "


def require_between_hosts(configuration: Configuration, swap: Swap) -> None:
    """Raises StepFailed where the two sides of ``swap`` are on two hosts, and one of them is held back on its own."""
    old, new = (configuration.instances[port.instance] for port in (swap.old, swap.new))
    held = next((each for each in (old, new) if not each.component.has_agent), None)
    if old.host != new.host and held is not None:
        where = f"from {host_in_words(old.host)} to {host_in_words(new.host)}"
        gate = f"has `gate {held.component.gate}`, which works within one host"
        raise StepFailed(
            f"{old.name} cannot hand over {swap.connector} {where}: {held.name} {gate}; use `gate relay`, Midstride's "
            "API, or `--strategy paper`"
        )


def require_arbiters(plan: Plan) -> None:
    """Raises PlanRefused where :func:`choose_arbiter`, :func:`require_between_hosts` or :func:`require_answering` would
    fail a step of ``plan``.

    By then the new program would run, and one that nothing holds back would publish, or answer, beside the old one.
    """
    configuration = plan.change.start
    for step in plan.steps:
        if isinstance(step.action, Create):
            configuration = configuration.with_instance(step.action.instance)
    connectors = {**plan.change.start.context.connectors, **plan.change.target.connectors}
    for step in plan.steps:
        for swap in step.action.swaps if isinstance(step.action, Handover) else ():
            try:
                require_between_hosts(configuration, swap)
                if connectors[swap.connector].kind == "topic":
                    choose_arbiter(configuration.component, swap.old.instance, swap.new.instance)
                else:
                    require_answering(configuration, swap)
            except StepFailed as error:
                raise PlanRefused(str(error)) from None
