"""The ways through the conflict core from where nothing goes by itself (semantics.md section 5, F4).

Each is the least that unblocks something: a component to create while others wait for the same
room, a least set of components to remove for it, a slot of a capped topic to take or to make.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from fractions import Fraction
from itertools import combinations, permutations
from typing import TYPE_CHECKING, Final, Literal, TypeAlias

from midstride.model.action import Swap
from midstride.model.configuration import to_fraction
from midstride.plan.change import Attachment

if TYPE_CHECKING:
    from midstride.plan.search_state import OrderGate, SearchState

# Sets of components to remove for one that needs room are looked for up to this size, among so many.
_SET_SIZE: Final = 3
_SET_FROM: Final = 10

# What is missing of each resource that is short.
Need: TypeAlias = tuple[tuple[str, Fraction], ...]

Kind: TypeAlias = Literal["create", "remove", "attach", "detach", "exchange", "finish", "hand over", "part"]


@dataclass(frozen=True, slots=True)
class Move:
    """A way to go on from where nothing goes by itself."""

    kind: Kind
    names: tuple[str, ...] = ()
    attachment: Attachment | None = None
    swap: Swap | None = None


def moves(core: SearchState) -> list[Move]:
    """The ways to go on, the least of each kind, in a stable order; empty where the user's orders leave none."""
    turn = core.turn()
    found = dict.fromkeys(
        [
            *_hand_overs(core, turn),
            *_creations(core, turn),
            *_attachments(core, turn),
            *_closings(core, turn),
            *_parts(core, turn),
        ]
    )
    fallen = {ref.instance for ref in core.draft.meter.below}
    return sorted(found, key=lambda move: _priority(core, move, fallen))


def _hand_overs(core: SearchState, turn: OrderGate) -> Iterator[Move]:
    for new, swaps in core.swaps.items():
        if core.fits(new, swaps, turn):
            yield Move("hand over", (new,))


def _creations(core: SearchState, turn: OrderGate) -> Iterator[Move]:
    known: dict[Need, list[tuple[str, ...]]] = {}
    for name, instance in core.creates.items():
        if instance.role not in turn:
            continue
        holds = instance.component.resource_usage
        lacks = ((resource, core.lack(resource, to_fraction(holds[resource]))) for resource in sorted(holds))
        need: Need = tuple((resource, lack) for resource, lack in lacks if lack > 0)
        if not need:
            yield Move("create", (name,))
            continue
        if need not in known:  # what needs the same room is made room for in the same ways
            known[need] = _making_room(core, need, turn)
            for names in known[need]:  # a small set in every order, since the first to go stays away longest
                orders = permutations(names) if len(names) <= _SET_SIZE else (names,)
                yield from (Move("remove", order) for order in orders)


def _making_room(core: SearchState, need: Need, turn: OrderGate) -> list[tuple[str, ...]]:
    """The least sets of components whose removal gives back what is needed."""
    configuration, role_of = core.draft.configuration, core.draft.change.role_of

    def enough(names: Iterable[str]) -> bool:
        given = [configuration.component(name).resource_usage for name in names]
        return all(sum(to_fraction(holds.get(r, 0.0)) for holds in given) >= lack for r, lack in need)

    holders = [
        name
        for name in core.removes
        if role_of(name) in turn
        and any(resource in configuration.component(name).resource_usage for resource, _ in need)
    ]
    holders.sort(key=lambda name: (not core.is_relieved(name), role_of(name) in core.draft.change.target.nodes))
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


def _attachments(core: SearchState, turn: OrderGate) -> Iterator[Move]:
    """Taking a slot of a capped topic; or making one, by handing over to the one that waits or by detaching."""
    configuration, change = core.draft.configuration, core.draft.change
    for port, connector in core.attaches:
        if not core.may_attach(port, turn):
            continue
        if core.slots(connector) >= 1:
            yield Move("attach", attachment=(port, connector))
        for other, on in core.detaches:
            if on not in (connector, change.sibling(connector)) or not configuration.is_output(other):
                continue
            if change.role_of(other.instance) not in turn:
                continue
            if on == connector and core.satisfies_topic(port, connector):
                yield Move("exchange", swap=Swap(connector, other, port))
            yield Move("detach", attachment=(other, on))


def _closings(core: SearchState, turn: OrderGate) -> Iterator[Move]:
    """A role after which another is to come, and of which only the going is left."""
    role_of = core.draft.change.role_of
    coming = {role_of(name) for name in (*core.creates, *core.swaps)}
    coming |= {role_of(port.instance) for port, _ in core.attaches}
    for role in sorted({order.first for order in core.orders} & core.busy()):
        if role in turn and role not in coming:
            yield Move("finish", (role,))


def _parts(core: SearchState, turn: OrderGate) -> Iterator[Move]:
    """A replacement that is not good enough for all its topics, whose place others want, or whose role would fall by
    the hand-over: it is not handed over there, but attached beside the old one where there is room."""
    for new, swaps in core.swaps.items():
        if core.draft.change.role_of(new) not in turn:
            continue
        live = new in core.draft.configuration.instances
        if core.is_wanted(swaps) or (live and (not core.fits(new, swaps, turn) or core.costs(swaps))):
            yield Move("part", (new,))


def _priority(core: SearchState, move: Move, fallen: set[str]) -> int:
    """How late a move is tried: first what makes good, then what costs nothing, last what breaks."""
    match move.kind:
        case "create":
            return 0 if core.creates[move.names[0]].role in fallen else 2
        case "remove":
            return 1 if all(core.is_relieved(name) for name in move.names) else 3 + len(move.names)
        case "attach" | "exchange":
            return 1
        case "finish" | "detach":
            return 2
    return 3
