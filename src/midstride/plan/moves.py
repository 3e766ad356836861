"""The ways through the conflict core from where nothing goes by itself (semantics.md section 5, F4).

Each is the least that unblocks something: a component to create while others wait for the same
room, a least set of components to remove for it, a slot of a capped topic to take or to make.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING, Final, Literal, TypeAlias

from midstride.model.action import Swap
from midstride.model.configuration import Instance
from midstride.plan.change import Attachment

if TYPE_CHECKING:
    from midstride.plan.core import Core, Turn

_EPSILON: Final = 1e-9

# Sets of components to remove for one that needs room are looked for up to this size, among so many.
_SET_SIZE: Final = 3
_SET_FROM: Final = 10

Kind: TypeAlias = Literal["create", "remove", "attach", "detach", "exchange", "finish", "hand over", "part"]


@dataclass(frozen=True, slots=True)
class Move:
    """A way to go on from where nothing goes by itself."""

    kind: Kind
    names: tuple[str, ...] = ()
    attachment: Attachment | None = None
    swap: Swap | None = None


def moves(core: Core) -> list[Move]:
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
    return list(found)


def _hand_overs(core: Core, turn: Turn) -> Iterator[Move]:
    for new, swaps in core.swaps.items():
        if core.fits(new, swaps, turn):
            yield Move("hand over", (new,))


def _creations(core: Core, turn: Turn) -> Iterator[Move]:
    for name, instance in core.creates.items():
        if instance.role not in turn:
            continue
        holds = instance.component.holds
        short = [resource for resource in sorted(holds) if not core.room(resource, holds[resource])]
        if not short:
            yield Move("create", (name,))
            continue
        for names in _making_room(core, short, instance, turn):
            yield Move("remove", names)


def _making_room(core: Core, short: Sequence[str], instance: Instance, turn: Turn) -> Iterator[tuple[str, ...]]:
    """The least sets of components whose removal makes room for ``instance``."""
    s, change = core.draft.s, core.draft.change
    need = {
        resource: s.held.get(resource, 0.0) + instance.component.holds[resource] - s.world.capacity(resource)
        for resource in short
    }
    holders = [
        name
        for name in core.removes
        if change.role_of(name) in turn and any(resource in s.component(name).holds for resource in short)
    ]

    def enough(names: Iterable[str]) -> bool:
        given = [s.component(name).holds for name in names]
        return all(sum(h.get(r, 0.0) for h in given) + _EPSILON >= amount for r, amount in need.items())

    found: list[tuple[str, ...]] = []
    for size in range(1, _SET_SIZE + 1):
        for names in combinations(holders[:_SET_FROM], size):
            if enough(names) and not any(set(less) <= set(names) for less in found):
                found.append(names)
    if not found and enough(holders):
        least = list(holders)
        for name in holders:
            rest = [other for other in least if other != name]
            least = rest if enough(rest) else least
        found.append(tuple(least))
    yield from found


def _attachments(core: Core, turn: Turn) -> Iterator[Move]:
    """Taking a slot of a capped topic; or making one, by handing over to the one that waits or by detaching."""
    s, change = core.draft.s, core.draft.change
    for port, connector in core.attaches:
        if not core.may_attach(port, turn):
            continue
        if core.slots(connector) >= 1:
            yield Move("attach", attachment=(port, connector))
        for other, on in core.detaches:
            if on not in (connector, change.sibling(connector)) or not s.is_output(other):
                continue
            if change.role_of(other.component) not in turn:
                continue
            if on == connector and core.satisfies_topic(port, connector):
                yield Move("exchange", swap=Swap(connector, other, port))
            yield Move("detach", attachment=(other, on))


def _closings(core: Core, turn: Turn) -> Iterator[Move]:
    """A role after which another is to come, and of which only the going is left."""
    role_of = core.draft.change.role_of
    coming = {role_of(name) for name in (*core.creates, *core.swaps)}
    coming |= {role_of(port.component) for port, _ in core.attaches}
    for role in sorted({order.first for order in core.orders} & core.busy()):
        if role in turn and role not in coming:
            yield Move("finish", (role,))


def _parts(core: Core, turn: Turn) -> Iterator[Move]:
    """A replacement that is not good enough for all its topics: those are not handed over."""
    for new, swaps in core.swaps.items():
        live = new in core.draft.s.instances and core.draft.change.role_of(new) in turn
        if live and not core.fits(new, swaps, turn):
            yield Move("part", (new,))
