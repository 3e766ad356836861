"""The conflict core of a change, compiled to integers (docs/semantics.md section 5, F4).

Which actions are *tied*: creating and removing instances that hold a resource of which there is not enough for old and
new together; attaching and detaching outputs on a topic whose cap does not admit old and new together; and everything
that belongs to a role which an ``order`` names. Independent *parts* of the core share no resource, topic or order.

A state of a part is the set of its tied actions that are done, as the bits of an integer. Everything else is taken to
be as favourable as it can be: what can come is there, what has to go is still there. By F3 no configuration that a plan
passes through with the same tied actions done has less loss, so every cost worked out here is a lower bound of the
plan's (docs/decisions/least-disruption.md).
"""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Collection, Hashable, Iterable, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from math import lcm
from typing import Literal, TypeAlias

from midstride.model.component import PortRef
from midstride.model.configuration import to_fraction
from midstride.model.specification import Constraint, Order
from midstride.plan.change import Change, PortAttachment

OpKind: TypeAlias = Literal["create", "remove", "attach", "detach"]


@dataclass(frozen=True, slots=True)
class Op:
    """One tied structural difference; ``port`` and ``connector`` are those of an attachment."""

    kind: OpKind
    instance: str
    port: PortRef | None = None
    connector: str = ""

    @property
    def attachment(self) -> PortAttachment:
        assert self.port is not None
        return self.port, self.connector


@dataclass(frozen=True, slots=True)
class Topic:
    """A capped topic of a part: the slots that are free at the start, and its tied attachments as bits."""

    free: int
    attach: int
    detach: int


@dataclass(slots=True)
class Part:
    """The tied actions that depend on each other, by bit."""

    ops: tuple[Op, ...]
    roles: tuple[str, ...] = ()
    seconds: tuple[float, ...] = ()
    usage: tuple[tuple[int, ...], ...] = ()
    """What each action adds to the use of each scarce resource, in a unit in which all amounts are whole."""
    free: tuple[int, ...] = ()
    """What is free of each scarce resource at the start."""
    topics: tuple[Topic, ...] = ()
    live: tuple[int, ...] = ()
    """For each action, the bits of those without which it is not possible; a stand-in has to serve before it goes."""
    after: tuple[int, ...] = ()
    """For each action, the bits that the user's orders put before it."""
    of_instance: dict[str, int] = field(default_factory=dict)

    @property
    def everything(self) -> int:
        return (1 << len(self.ops)) - 1


class _Groups:
    """Sets of things that belong together, joined one pair at a time."""

    def __init__(self) -> None:
        self.parent: dict[Hashable, Hashable] = {}

    def find(self, thing: Hashable) -> Hashable:
        self.parent.setdefault(thing, thing)
        while self.parent[thing] != thing:
            self.parent[thing] = self.parent[self.parent[thing]]
            thing = self.parent[thing]
        return thing

    def join(self, one: Hashable, other: Hashable) -> None:
        self.parent[self.find(one)] = self.find(other)


def scarce_resources(change: Change) -> list[str]:
    """The resources of which there is not enough for everything that runs and everything that comes."""
    demand: dict[str, Fraction] = {}
    for instance in change.coming:
        for resource, amount in instance.resource_usage.items():
            demand[resource] = demand.get(resource, Fraction()) + to_fraction(amount)
    held, context = change.start.held, change.start.context
    return sorted(r for r in demand if held.get(r, Fraction()) + demand[r] > to_fraction(context.capacity(r)))


def free_slots(change: Change, connector: str) -> int | None:
    """The number of further publishers that a topic admits at the start, for both contracts together; None: any."""
    context = change.start.context
    cap = context.connectors[connector].max_publishers
    if cap is None:
        return None
    sibling = change.sibling(connector)
    attached = len(change.start.publishers_on(connector))
    beside = 0 if sibling is None else len(change.start.publishers_on(sibling))
    return cap - attached - beside - len(context.publishers_out_of_scope(context.connectors[connector]))


def full_topics(change: Change) -> dict[str, int]:
    """The capped topics that do not admit all of their old and new outputs together: the slots free at the start."""
    wanted = Counter(connector for port, connector in change.attached if change.is_output(port))
    return {name: free for name in wanted if (free := free_slots(change, name)) is not None and free < wanted[name]}


def parts(change: Change, constraints: Iterable[Constraint], ignored: Collection[str] = ()) -> list[Part]:
    """The independent parts of the conflict core. Empty where nothing is tied.

    The resources and topics that are ``ignored`` count as large enough.
    """
    orders = [c for c in constraints if isinstance(c, Order) and c.first != c.then]
    ordered = {role for order in orders for role in (order.first, order.then)}
    scarce = [resource for resource in scarce_resources(change) if resource not in ignored]
    full = {name: free for name, free in full_topics(change).items() if name not in ignored}
    on_full = {name: name for name in full}
    on_full.update({sibling: name for name in full if (sibling := change.sibling(name)) is not None})

    groups, ops = _Groups(), list[Op]()

    def tie(op: Op, *things: Hashable) -> None:
        ops.append(op)
        groups.join(op, ("role", change.role_of(op.instance)))
        for thing in things:
            groups.join(op, thing)

    # Something is lost already: then it matters when each action takes its time.
    urgent = bool(change.lowered)
    for kind, names in (("create", [i.name for i in change.coming]), ("remove", change.leaving)):
        for name in names:
            used = [("resource", r) for r in scarce if r in change.instance(name).resource_usage]
            if used or urgent or change.role_of(name) in ordered:
                tie(Op(kind, name), *used, *([("urgent",)] if urgent else []))  # type: ignore[arg-type]
    for kind, pairs in (("attach", change.attached), ("detach", change.detached)):
        for port, connector in pairs:
            topic = on_full.get(connector) if change.is_output(port) else None
            if topic is not None or change.role_of(port.instance) in ordered:
                tie(Op(kind, port.instance, port, connector), *([("topic", topic)] if topic else []))  # type: ignore[arg-type]
    for order in orders:
        groups.join(("role", order.first), ("role", order.then))

    together: dict[Hashable, list[Op]] = {}
    for op in ops:
        together.setdefault(groups.find(op), []).append(op)
    return [_part(change, tuple(some), scarce, full, orders) for some in together.values()]


def _part(
    change: Change, ops: tuple[Op, ...], scarce: Sequence[str], full: dict[str, int], orders: Sequence[Order]
) -> Part:
    roles = tuple(change.role_of(op.instance) for op in ops)
    of_instance: dict[str, int] = defaultdict(int)
    of_role: dict[str, int] = defaultdict(int)
    for bit, op in enumerate(ops):
        of_instance[op.instance] |= 1 << bit
        of_role[roles[bit]] |= 1 << bit
    context, held = change.start.context, change.start.held
    usage: list[list[int]] = [[] for _ in ops]
    free: list[int] = []
    for resource in (r for r in scarce if any(_holds(change, op, r) for op in ops)):
        amounts = [{"create": 1, "remove": -1}.get(op.kind, 0) * _holds(change, op, resource) for op in ops]
        amounts.append(to_fraction(context.capacity(resource)) - held.get(resource, Fraction()))
        unit = lcm(*(amount.denominator for amount in amounts))
        *whole, left = (int(amount * unit) for amount in amounts)
        free.append(left)
        for of_op, amount in zip(usage, whole, strict=True):
            of_op.append(amount)
    topics = []
    for name, slots in full.items():
        on = {name, change.sibling(name) or name}
        attach = sum(1 << bit for bit, op in enumerate(ops) if op.kind == "attach" and op.connector == name)
        detach = sum(1 << bit for bit, op in enumerate(ops) if op.kind == "detach" and op.connector in on)
        outputs = sum(1 << bit for bit, op in enumerate(ops) if op.port is not None and change.is_output(op.port))
        if attach & outputs:
            topics.append(Topic(slots, attach & outputs, detach & outputs))
    creation = {op.instance: 1 << bit for bit, op in enumerate(ops) if op.kind == "create"}

    def first(op: Op) -> int:
        if op.kind == "attach":
            return creation.get(op.instance, 0)
        if op.kind == "create" or op.instance not in change.stand_ins:
            return 0
        return sum(
            1 << bit
            for bit, each in enumerate(ops)
            if each.instance == op.instance and each.kind in ("create", "attach")
            if each.port is None or op.port is None or each.attachment == op.attachment
        )

    return Part(
        ops=ops,
        roles=roles,
        seconds=tuple(_seconds(change, op) for op in ops),
        usage=tuple(map(tuple, usage)),
        free=tuple(free),
        topics=tuple(topics),
        live=tuple(map(first, ops)),
        after=tuple(
            sum(of_role[order.first] for order in dict.fromkeys(orders) if order.then == role) for role in roles
        ),
        of_instance=dict(of_instance),
    )


def _holds(change: Change, op: Op, resource: str) -> Fraction:
    if op.port is not None:
        return Fraction()
    return to_fraction(change.instance(op.instance).resource_usage.get(resource, 0.0))


def _seconds(change: Change, op: Op) -> float:
    return 0.0 if op.port is not None else change.seconds(op.kind, change.instance(op.instance))
