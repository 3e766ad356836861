"""The ways through the conflict core from a state where nothing can be done at once (docs/semantics.md section 5, F4).

Each is the least that unblocks something: creating an instance while others wait for the same room, removing a
smallest set of instances to make room, taking or freeing a slot of a capped topic.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import chain, combinations, permutations
from typing import Final, Literal, TypeAlias

from midstride.model.action import Swap
from midstride.model.configuration import to_fraction
from midstride.plan.change import PortAttachment
from midstride.plan.core.search_state import SearchState, UnblockedRoles

# Sets of instances to remove for one that needs room are searched up to this size, among this many instances.
_SET_SIZE: Final = 3
_SET_FROM: Final = 10

# The missing amount of each resource that is short.
Need: TypeAlias = tuple[tuple[str, Fraction], ...]

MoveKind: TypeAlias = Literal["create", "remove", "attach", "detach", "exchange", "finish", "hand over", "split"]


@dataclass(frozen=True, slots=True)
class Move:
    """A way to go on from a state where nothing can be done at once.

    ``priority`` says how late it is tried: first what restores a role, then what costs nothing, last what breaks
    something.
    """

    priority: int
    kind: MoveKind
    names: tuple[str, ...] = ()
    attachments: tuple[PortAttachment, ...] = ()
    swaps: tuple[Swap, ...] = ()


def moves(state: SearchState) -> list[Move]:
    """The ways to go on, the least of each kind, in a stable order; empty where the user's orders leave none."""
    unblocked = state.unblocked_roles()
    kinds = (_hand_overs, _creations, _attachments, _finishes, _splits)
    found = chain.from_iterable(kind(state, unblocked) for kind in kinds)
    return sorted(dict.fromkeys(found), key=lambda move: move.priority)


def play(state: SearchState, move: Move) -> SearchState:
    """The state after a move."""
    match move.kind:
        case "create":
            state = state.create(*move.names)
        case "hand over":
            state = state.hand_over(move.names[0])
        case "remove":
            for name in move.names:
                state = _removed_early(state, name)
        case "attach":
            state = state.attach(*move.attachments)
        case "detach":
            state = state.detach(move.attachments)
        case "exchange":
            state = state.exchange(*move.swaps)
        case "finish":
            state = state.remove_rest_of(move.names)
        case "split":
            (new,) = move.names
            swaps, rest = state.swaps[new], replace(state, swaps=state.swaps_of_others(new))
            kept = tuple(swap for swap in swaps if rest.can_take_over(swap) and not rest.is_contended([swap]))
            state = state.without_swaps(new, () if kept == swaps else kept)
    return state.raise_touched()


def _removed_early(state: SearchState, name: str) -> SearchState:
    """Break before make: detach every port of ``name``, and remove it."""
    new = state.builder.change.replaced.get(name)
    if new is not None:  # to attach the new instance before that is a move too: "split"
        state = state.without_swaps(new)
    return state.remove([name], [pair for pair in state.detaches if pair[0].instance == name])


def _hand_overs(state: SearchState, unblocked: UnblockedRoles) -> Iterator[Move]:
    for new, swaps in state.swaps.items():
        if state.can_hand_over(new, swaps, unblocked):
            yield Move(3, "hand over", (new,))


def _creations(state: SearchState, unblocked: UnblockedRoles) -> Iterator[Move]:
    known: dict[Need, list[tuple[str, ...]]] = {}
    fallen = {ref.instance for ref in state.builder.meter.below}
    for name, instance in state.creates.items():
        if instance.role not in unblocked:
            continue
        usage = instance.resource_usage
        shortages = ((resource, state.shortage(resource, to_fraction(usage[resource]))) for resource in sorted(usage))
        need: Need = tuple((resource, shortage) for resource, shortage in shortages if shortage > 0)
        if not need:
            yield Move(0 if instance.role in fallen else 2, "create", (name,))
            continue
        if need not in known:  # the same need is met in the same ways
            known[need] = _making_room(state, need, unblocked)
            for names in known[need]:  # a small set in every order, since the first to be removed is absent longest
                orders = permutations(names) if len(names) <= _SET_SIZE else (names,)
                priority = 1 if all(state.is_superseded(name) for name in names) else 3 + len(names)
                yield from (Move(priority, "remove", order) for order in orders)


def _making_room(state: SearchState, need: Need, unblocked: UnblockedRoles) -> list[tuple[str, ...]]:
    """The least sets of instances whose removal frees what is needed."""
    configuration, change = state.builder.configuration, state.builder.change

    def enough(names: Iterable[str]) -> bool:
        usages = [configuration.instances[name].resource_usage for name in names]
        return all(sum(to_fraction(usage.get(r, 0.0)) for usage in usages) >= shortage for r, shortage in need)

    holders = [
        name
        for name in state.removes
        if change.role_of(name) in unblocked
        and any(resource in configuration.instances[name].resource_usage for resource, _ in need)
    ]
    holders.sort(key=lambda name: (not state.is_superseded(name), change.role_of(name) in change.target.nodes))
    found = [(name,) for name in holders if enough((name,))]
    alone = {name for (name,) in found}
    several = [name for name in holders if name not in alone][:_SET_FROM]
    sets: list[tuple[str, ...]] = []
    for size in range(2, _SET_SIZE + 1):
        for names in combinations(several, size):
            if enough(names) and not any(set(less) <= set(names) for less in sets):
                sets.append(names)
    if not found and not sets and enough(holders):
        least = list(holders)
        for name in holders:
            rest = [other for other in least if other != name]
            least = rest if enough(rest) else least
        sets.append(tuple(least))
    return [*found, *sets]


def _attachments(state: SearchState, unblocked: UnblockedRoles) -> Iterator[Move]:
    """Taking a slot of a capped topic; or freeing one, by handing over to the output that waits or by detaching."""
    configuration, change = state.builder.configuration, state.builder.change
    for port, connector in state.attaches:
        if not state.may_attach(port, unblocked):
            continue
        if state.free_slots(connector) >= 1:
            yield Move(1, "attach", attachments=((port, connector),))
        for other, on in state.detaches:
            if on not in (connector, change.sibling(connector)) or not configuration.is_output(other):
                continue
            if change.role_of(other.instance) not in unblocked:
                continue
            if on == connector and state.satisfies_topic(port, connector):
                yield Move(1, "exchange", swaps=(Swap(connector, other, port),))
            yield Move(2, "detach", attachments=((other, on),))


def _finishes(state: SearchState, unblocked: UnblockedRoles) -> Iterator[Move]:
    """Removing the rest of a role that the user's orders put before another, once nothing of it is to come."""
    role_of = state.builder.change.role_of
    coming = {role_of(name) for name in (*state.creates, *state.swaps)}
    coming |= {role_of(port.instance) for port, _ in state.attaches}
    for role in sorted({order.first for order in state.orders} & state.unfinished_roles()):
        if role in unblocked and role not in coming:
            yield Move(2, "finish", (role,))


def _splits(state: SearchState, unblocked: UnblockedRoles) -> Iterator[Move]:
    """Attaching a replacement beside the old instance, where there is room, instead of handing over.

    For a replacement that does not satisfy all of its topics, that occupies a slot which another output needs, or
    whose role would fall by the hand-over.
    """
    for new, swaps in state.swaps.items():
        if state.builder.change.role_of(new) not in unblocked:
            continue
        live = new in state.builder.configuration.instances
        if state.is_contended(swaps) or (
            live and (not state.can_hand_over(new, swaps, unblocked) or state.lowers_role(swaps))
        ):
            yield Move(3, "split", (new,))
