"""The loss in a state of a part of the conflict core (:mod:`midstride.plan.core.conflict_core`), memoised.

The functionalities that the part can lower are compiled to integers once, with the topics between them. A state then
costs one walk over what it lowers: ``best`` as the fixed point of :mod:`midstride.model.best`, from the top.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Final

from midstride.model.best import rebalanced
from midstride.model.component import FunctionalityRef, InputAlternatives, Mode, PortRef
from midstride.model.configuration import Configuration
from midstride.model.contract import satisfies
from midstride.plan.change import Change, PortAttachment
from midstride.plan.core.conflict_core import Op, Part
from midstride.plan.disruption import Counted, Levels

Losses = tuple[tuple[FunctionalityRef, int], ...]


def fullest(change: Change) -> Configuration:
    """Everything that runs and everything that comes, attached wherever it is or will be, in ``best``."""
    configuration = change.start
    seeds: dict[FunctionalityRef, None] = dict.fromkeys(change.pending)
    for instance in change.coming:
        configuration = configuration.with_instance(instance)
        seeds.update(dict.fromkeys(instance.functionality_refs()))
    for port, connector in change.attached:
        configuration = configuration.with_attachment(port, connector)
        if not configuration.is_output(port):
            seeds.update(dict.fromkeys(configuration.users(port)))
    for _, connector in change.attached:
        seeds.update(dict.fromkeys(configuration.consumers(connector)))
    return configuration.with_modes(rebalanced(configuration, seeds))


def cone(full: Configuration, tied: Iterable[str]) -> list[FunctionalityRef]:
    """The functionalities that can be lowered: of the ``tied`` instances, and downstream of them."""
    pending = [ref for name in tied for ref in full.instances[name].functionality_refs()]
    seen = dict.fromkeys(pending)
    while pending:
        for ref in full.downstream(pending.pop()):
            if ref not in seen:
                seen[ref] = None
                pending.append(ref)
    return list(seen)


_ALWAYS: Final = 1 << 30


@dataclass(frozen=True, slots=True)
class _Counted:
    """A role's functionality, with those of instances that may serve it: their numbers, and for each output that they
    need attached, where all of its attachments are tied, these. ``otherwise`` is the level that others provide."""

    counted: Counted
    servers: tuple[tuple[int, tuple[tuple[int, ...], ...]], ...]
    otherwise: int


class PartLosses:
    """The losses in the states of one part, everything outside it being as favourable as it can be."""

    def __init__(self, change: Change, part: Part, levels: Levels, full: Configuration) -> None:
        self.part, self.levels, self.full = part, levels, full
        self.cache: dict[int, float] = {}
        self.equivalent = self._equivalent(change)
        self._refs = cone(full, part.of_instance)
        self._number = {ref: index for index, ref in enumerate(self._refs)}
        self._compile()

    def loss(self, state: int) -> float:
        """The weighted sum of the levels lost."""
        key = self.key(state)
        found = self.cache.get(key)
        if found is None:
            weight = self.levels.weight
            found = self.cache[key] = sum(weight(ref) * lost for ref, lost in self.losses(state))
        return found

    def key(self, state: int) -> int:
        """A key that is equal for states that differ only in which of two equivalent instances serves a role."""
        for mask, gone, come in self.equivalent:
            if state & mask and (not state & gone or state & come == come):
                state &= ~mask
        return state

    # -- compiling -----------------------------------------------------------------------------------

    def _equivalent(self, change: Change) -> list[tuple[int, int, int]]:
        """Of each role whose old and new instance do the same: its bits, those of its going and of its coming."""
        found = []
        part = self.part
        start, target = change.specification, change.target
        for old, new in change.replaced.items():
            if old in change.stand_ins or new in change.stand_ins:
                continue  # that one does not stay whole
            role = change.role_of(old)
            one, other = change.component_of(old), change.component_of(new)
            alike = (
                one.inputs == other.inputs
                and set(one.outputs) == set(other.outputs)
                and {each.meaning() for each in one} == {each.meaning() for each in other}
                and role in start.nodes
                and start.nodes[role].attachments == target.nodes[role].attachments
                and len(change.start.instances_of(role)) == 1
                and not change.identities
            )
            gone, come = part.of_instance.get(old, 0), part.of_instance.get(new, 0)
            if alike and gone and come:
                found.append((gone | come, gone, come))
        return found

    def _compile(self) -> None:
        full, part = self.full, self.part
        # Tied attachments of outputs are numbered; -1 stands for one that is there as long as its instance.
        self._attachments: dict[PortAttachment, int] = {}
        for bit, op in enumerate(part.ops):
            if op.port is not None:
                self._attachments.setdefault(op.attachment, bit)  # a stand-in's is made and undone: one number
        self._top = [full.modes[ref] for ref in self._refs]
        self._outputs: list[list[tuple[int, int, int]]] = [[] for _ in self._refs]  # topic, last good mode, attachment
        self._readers: list[list[int]] = []
        self._count: list[int] = []
        topics: dict[str, int] = {}

        def topic(name: str) -> int:
            if name not in topics:
                topics[name] = len(topics)
                self._readers.append([])
                self._count.append(self._supply(name, topics[name]))
            return topics[name]

        self._needs = [
            [list(self._assumed(ref, mode, topic)) for mode in full.functionality(ref).modes] for ref in self._refs
        ]
        for index, chain in enumerate(self._needs):
            for number in dict.fromkeys(n for needs in chain for alternatives in needs for n in alternatives):
                self._readers[number].append(index)
        self._absent = [self._absent_without(op) for op in part.ops]
        self._counted = self._count_roles()

    def _supply(self, name: str, number: int) -> int:
        """The number of outputs that satisfy the topic and that the part can lower; very many if another one does."""
        full, connector = self.full, self.full.context.connectors[name]
        needed, count = connector.guarantee, 0
        if any(satisfies(offer.guarantee, needed) for offer in full.context.publishers_out_of_scope(connector)):
            count = _ALWAYS
        for port in full.publishers_on(name):
            owner = full.component(port.instance).owner(port.port)
            ref = FunctionalityRef(port.instance, owner.name)
            good = [index for index, mode in enumerate(owner.modes) if satisfies(mode.guarantee(port.port), needed)]
            if good and full.modes[ref] <= good[-1]:
                index = self._number.get(ref)
                count += _ALWAYS if index is None else 1
                if index is not None:
                    self._outputs[index].append((number, good[-1], self._attachments.get((port, name), -1)))
        return count

    def _assumed(self, ref: FunctionalityRef, mode: Mode, topic: Callable[[str], int]) -> Iterator[list[int]]:
        """For each assumption of a mode, the topics of which one must be satisfied."""
        full, component = self.full, self.full.component(ref.instance)
        connectors, used = full.context.connectors, component.functionalities[ref.functionality].inputs
        for assumption in mode.assumptions:
            if isinstance(assumption, InputAlternatives):
                names: Iterable[str] = assumption.inputs
            elif any(satisfies(offer.guarantee, assumption) for offer in full.context.offers()):
                continue
            else:
                names = [name for name in used if satisfies(component.inputs[name], assumption)]
            yield [
                topic(connector)
                for name in names
                for connector in full.connectors_of.get(PortRef(ref.instance, name), ())
                if satisfies(connectors[connector].guarantee, component.inputs[name])
            ]

    def _absent_without(self, op: Op) -> tuple[bool, tuple[int, ...]]:
        """Return whether ``op`` takes something away until it is done, and the functionalities that this concerns."""
        numbers = self._number
        if op.port is None:
            refs = self.full.instances[op.instance].functionality_refs()
            return op.kind == "create", tuple(numbers[ref] for ref in refs)
        owner = self.full.component(op.instance).find_owner(op.port.port)
        concerned = () if owner is None else (numbers[FunctionalityRef(op.instance, owner.name)],)
        return op.kind == "attach", concerned

    def _count_roles(self) -> list[_Counted]:
        """The functionalities of roles that the part can lower, with the instances that may serve them."""
        full, found = self.full, list[_Counted]()
        self._counted_of: list[list[int]] = [[] for _ in self._refs]
        for role in dict.fromkeys(full.instances[ref.instance].role for ref in self._refs):
            for counted in self.levels.counted(role):
                servers, otherwise = [], counted.worst
                for instance in full.instances_of(role):
                    ref = FunctionalityRef(instance.name, counted.ref.functionality)
                    needed = [
                        [(PortRef(instance.name, o), k) for k in full.attached_to(PortRef(instance.name, o))]
                        for o in counted.outputs
                    ]
                    if ref not in full.modes or not all(needed):
                        continue
                    if ref not in self._number:
                        otherwise = min(otherwise, full.modes[ref])
                        continue
                    tied = tuple(
                        tuple(self._attachments[pair] for pair in pairs)
                        for pairs in needed
                        if all(pair in self._attachments for pair in pairs)
                    )
                    servers.append((self._number[ref], tied))
                    self._counted_of[self._number[ref]].append(len(found))
                found.append(_Counted(counted, tuple(servers), otherwise))
        return found

    # -- one state -------------------------------------------------------------------------------------

    def losses(self, state: int) -> Losses:
        """The functionalities of roles that are below their baseline, each with how many levels."""
        modes, count = list(self._top), list(self._count)
        gone, detached = set[int](), set[int]()
        for bit, (lacking, concerned) in enumerate(self._absent):
            if bool(state >> bit & 1) is not lacking:
                if self.part.ops[bit].port is None:
                    gone.update(concerned)
                else:
                    detached.add(self._attachments[self.part.ops[bit].attachment])
        pending: list[int] = []

        def withdraw(topic: int) -> None:
            count[topic] -= 1
            if not count[topic]:
                pending.extend(self._readers[topic])

        changed = set(gone)
        for bit in detached:
            changed.update(self._absent[bit][1])
        for index in changed:
            for topic, _, attachment in self._outputs[index]:
                if index in gone or attachment in detached:
                    withdraw(topic)
        while pending:
            index = pending.pop()
            before = after = modes[index]
            if index in gone:
                continue
            while any(not any(count[topic] > 0 for topic in needs) for needs in self._needs[index][after]):
                after += 1
            if after == before:
                continue
            modes[index] = after
            changed.add(index)
            for topic, last_good, attachment in self._outputs[index]:
                if before <= last_good < after and attachment not in detached:
                    withdraw(topic)
        found = []
        for number in sorted({number for index in changed for number in self._counted_of[index]}):
            each = self._counted[number]
            level = min(
                (
                    modes[index]
                    for index, tied in each.servers
                    if index not in gone and all(not detached.issuperset(some) for some in tied)
                ),
                default=each.counted.worst,
            )
            lost = min(level, each.otherwise) - each.counted.baseline
            if lost > 0:
                found.append((each.counted.ref, lost))
        return tuple(found)
