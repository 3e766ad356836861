"""A second slow twin of ``minimal``, in another formalism: the semantics as a logic program, solved by clingo.

Written from docs/semantics.md sections 3, 4 and 6. Of the code under test it uses only the relation between two
contracts, the start and the structural differences; modes are worked out by the program itself (``bad`` is the least
fixed point whose complement is ``best``), and so are levels, baselines and losses.
"""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction

import clingo

from midstride.model.component import Assumption, FunctionalityRef, InputAlternatives, PortRef
from midstride.model.configuration import Configuration, Instance
from midstride.model.contract import satisfies
from midstride.model.specification import Keep, Limit, Order, initial
from midstride.plan.change import Change
from midstride.plan.constraints import in_force
from tests.plan.exhaustive import Choice, Detoured

PROGRAM = """
time(0..n).
% -- detours: some roles' nodes are moved, or have a stand-in ---------------------------------------------------
{ chosen(D) : detour(D, R) }.
:- stand_in(D, R), stand_in(E, R), chosen(D), chosen(E), D < E.
:- #count{ R : chosen(D), detour(D, R) } > k.
needed(O) :- op(O), not optional(O), not dropped(O).
needed(O) :- part_of(O, D), chosen(D).
optional(O) :- part_of(O, _).
dropped(O) :- instead_of(O, D), chosen(D).
:- create(O, I), remove(P, I), at(O, T), at(P, U), U <= T.
:- attach(O, P, K), detach(Q, P, K), at(O, T), at(Q, U), U <= T.

% -- every difference is made once; several at once are a hand-over -------------------------------------------
{ at(O, T) : T = 1..n } = 1 :- needed(O).
used(T) :- at(_, T).
:- used(T), T > 1, not used(T - 1).
handover(T) :- at(O, T), at(P, T), O < P.
:- handover(T), at(O, T), not swappable(O).
:- handover(T), topic_of(_, K, _), #sum{ D, O : at(O, T), topic_of(O, K, D) } != 0.
:- handover(T), at(O, T), attach(O, P, K), not enough(P, K, T - 1).
done(O, T) :- at(O, U), time(T), T >= U.

% -- the structure ----------------------------------------------------------------------------------------------
live(I, T) :- time(T), live0(I), not gone(I, T).
gone(I, T) :- remove(O, I), done(O, T).
live(I, T) :- create(O, I), done(O, T), not gone(I, T).
attached(P, K, T) :- time(T), attached0(P, K), not off(P, K, T).
off(P, K, T) :- detach(O, P, K), done(O, T).
attached(P, K, T) :- attach(O, P, K), done(O, T), not off(P, K, T).
:- attached(P, K, T), port(P, I), not live(I, T).
:- capped(G, C), time(T), #sum{ 1, P, K : attached(P, K, T), counts(P, K, G) } > C.
:- capacity(R, C), time(T), #sum{ A, I : live(I, T), holds(I, R, A) } > C.

% -- the modes: bad(F, M, T) where functionality F of an instance cannot be in mode M ---------------------------
bad(F, M, T) :- assumes(F, M, A), time(T), unmet(A, T).
unmet(A, T) :- assumption(A), time(T), dead(P, T) : alternative(A, P).
dead(P, T) :- input(P), time(T), silent(P, K, T) : reads(P, K).
silent(P, K, T) :- reads(P, K), time(T), not attached(P, K, T).
silent(P, K, T) :- reads(P, K), unsupported(K, T).
unsupported(K, T) :- topic(K), not outside(K), time(T), mute(P, K, T) : writes(P, K).
mute(P, K, T) :- writes(P, K), time(T), not attached(P, K, T).
mute(P, K, T) :- writes(P, K), time(T), owner(P, F), bad(F, M, T) : fits(P, K, M).
mode(F, M, T) :- functionality(F, I), live(I, T), chain(F, M), not bad(F, M, T), bad(F, L, T) : chain(F, L), L < M.
enough(P, K, T) :- mode(F, M, T), owner(P, F), fits(P, K, M).

% -- the levels --------------------------------------------------------------------------------------------------
lame(F, C, T) :- instance_of(F, C), required(F, P), time(T), not anywhere(P, T).
anywhere(P, T) :- attached(P, _, T).
reaches(C, L, T) :- instance_of(F, C), mode(F, M, T), not lame(F, C, T), level(C, L), M <= L.
lost(C, L, T) :- level(C, L), L >= B, baseline(C, B), time(T), not reaches(C, L, T).
during(C, L, T) :- lost(C, L, T), T > 0.
during(C, L, T + 1) :- lost(C, L, T), T < n.
#minimize{ W * D, C, L, T : during(C, L, T), weight(C, W), at(O, T), seconds(O, D) }.

% -- constraints ---------------------------------------------------------------------------------------------------
:- keep(C, L), time(T), not reaches(C, L, T).
:- never(C), lost(C, _, T), T > 0.
:- before(O, P), at(O, T), at(P, U), T >= U.
"""

# Durations, weights and amounts are whole thousandths.
UNIT = 1000


class AnswerSets:
    """The least disruption of a change by clingo. ``limit`` constraints count only where they allow no time at all.

    ``detours``: of how many roles there may be.
    """

    def __init__(self, change: Change, detours: int = 0) -> None:
        self.change, self.roles = change, detours
        self.facts: list[str] = []
        self.instances: dict[str, Instance] = dict(change.start.instances)
        self.instances |= {instance.name: instance for instance in change.coming}
        self.numbers: dict[object, int] = {}
        self.number_of_ops = 0
        roles = sorted(change.target.nodes) if detours else ()
        self.choices = [choice for role in roles for choice in Detoured(change).choices(role)]
        self.instances |= {choice.instance.name: choice.instance for choice in self.choices}
        self._write()

    def optimum(self) -> float | None:
        """The least disruption; None where no plan meets the constraints."""
        sizes = (f"n={self.number_of_ops}", f"k={self.roles}")
        control = clingo.Control(
            ["--opt-strategy=usc", *(word for size in sizes for word in ("-c", size))], message_limit=0
        )
        control.add("base", [], PROGRAM + "\n".join(self.facts))
        control.ground([("base", [])])
        best: list[int] | None = None
        with control.solve(yield_=True) as handle:
            for model in handle:
                best = list(model.cost)
        return None if best is None else round(sum(best) / UNIT / UNIT, 9)

    # -- facts ---------------------------------------------------------------------------------------

    def _id(self, thing: object) -> int:
        return self.numbers.setdefault(thing, len(self.numbers))

    def _fact(self, name: str, *arguments: object) -> None:
        numbers = (a if isinstance(a, int) else self._id(a) for a in arguments)
        self.facts.append(f"{name}({', '.join(map(str, numbers))}).")

    def _write(self) -> None:
        change, connectors = self.change, self.change.start.context.connectors
        for name, connector in connectors.items():
            self._fact("topic", name)
            outside = change.start.context.publishers_out_of_scope(connector)
            if any(satisfies(offer.guarantee, connector.guarantee) for offer in outside):
                self._fact("outside", name)
        for instance in self.instances.values():
            self._instance(instance)
        for name in change.start.instances:
            self._fact("live0", name)
        for port, name in change.start.attachments():
            self._fact("attached0", port, name)
        roles = list(self._ops())
        self._limits()
        levels = self._levels()
        self._constraints(roles, levels)

    def _instance(self, instance: Instance) -> None:
        component, connectors = instance.component, self.change.start.context.connectors
        offers = self.change.start.context.offers()
        for port in component.inputs:
            ref = PortRef(instance.name, port)
            self._fact("port", ref, instance.name)
            self._fact("input", ref)
            for name, connector in connectors.items():
                if satisfies(connector.guarantee, component.inputs[port]):
                    self._fact("reads", ref, name)
        for functionality in component:
            own = FunctionalityRef(instance.name, functionality.name)
            self._fact("functionality", own, instance.name)
            for output in functionality.outputs:
                ref = PortRef(instance.name, output)
                self._fact("port", ref, instance.name)
                self._fact("owner", ref, own)
                for name, connector in connectors.items():
                    good = [
                        index
                        for index, mode in enumerate(functionality.modes)
                        if satisfies(mode.guarantee(output), connector.guarantee)
                    ]
                    if good:
                        self._fact("writes", ref, name)
                    for index in good:
                        self._fact("fits", ref, name, index)
            for index, mode in enumerate(functionality.modes):
                self._fact("chain", own, index)
                for place, assumption in enumerate(mode.assumptions):
                    if isinstance(assumption, InputAlternatives) or not any(
                        satisfies(offer.guarantee, assumption) for offer in offers
                    ):
                        self._assumption((own, index, place), own, index, instance, assumption)

    def _assumption(
        self, key: object, own: FunctionalityRef, index: int, instance: Instance, assumption: Assumption
    ) -> None:
        self._fact("assumption", key)
        self._fact("assumes", own, index, key)
        inputs = instance.component.inputs
        if isinstance(assumption, InputAlternatives):
            names: list[str] = list(assumption.inputs)
        else:
            used = instance.component.functionalities[own.functionality].inputs
            names = [name for name in used if satisfies(inputs[name], assumption)]
        for name in names:
            self._fact("alternative", key, PortRef(instance.name, name))

    def _ops(self) -> Iterator[tuple[tuple[object, ...], str]]:
        """Each difference with the role it belongs to."""
        change = self.change
        for instance in change.coming:
            yield self._op(("create", instance.name), instance.name)
            self._fact("create", ("create", instance.name), instance.name)
            self._fact("seconds", ("create", instance.name), _scaled(change.seconds("create", instance)))
        for name in change.leaving:
            yield self._op(("remove", name), name)
            self._fact("remove", ("remove", name), name)
            self._fact("seconds", ("remove", name), _scaled(change.seconds("remove", change.instance(name))))
        for kind, pairs in (("attach", change.attached), ("detach", change.detached)):
            for port, connector in pairs:
                yield self._attachment((kind, port, connector), port, connector)
        sizes = dict[str, list[int]]()
        for choice in self.choices:
            before = self.number_of_ops
            yield from self._choice(choice)
            sizes.setdefault(choice.role, []).append(self.number_of_ops - before)
            self.number_of_ops = before
        # Of each role at most all; of so many roles the largest.
        self.number_of_ops += sum(sorted(map(sum, sizes.values()))[-self.roles :]) if sizes else 0

    def _choice(self, choice: Choice) -> Iterator[tuple[tuple[object, ...], str]]:
        change, new = self.change, choice.instance
        self._fact("detour", choice, choice.role)
        if not choice.moved:
            self._fact("stand_in", choice, choice.role)
        create, remove = ("create", new.name), ("remove", choice.leaving)
        gone = self.instances[choice.leaving]
        ops = [self._op(create, new.name), self._op(remove, choice.leaving)]
        self._fact("create", create, new.name)
        self._fact("seconds", create, _scaled(change.seconds("create", new)))
        self._fact("remove", remove, choice.leaving)
        self._fact("seconds", remove, _scaled(change.seconds("remove", gone)))
        for kind, pairs in (("attach", choice.attached), ("detach", choice.detached)):
            ops += [self._attachment((kind, *pair, choice), *pair) for pair in pairs]
        for op, _ in ops:
            self._fact("part_of", op, choice)
        for kind, direct in (("attach", change.attached), ("detach", change.detached)):
            for port, connector in direct:
                if port.instance == choice.moved:
                    self._fact("instead_of", (kind, port, connector), choice)
        yield from ops

    def _attachment(self, op: tuple[object, ...], port: PortRef, connector: str) -> tuple[tuple[object, ...], str]:
        self._fact(str(op[0]), op, port, connector)
        if self.instances[port.instance].component.has_output(port.port):
            self._fact("swappable", op)
            self._fact("topic_of", op, connector, 1 if op[0] == "attach" else -1)
        return self._op(op, port.instance)

    def _op(self, op: tuple[object, ...], instance: str) -> tuple[tuple[object, ...], str]:
        self.number_of_ops += 1
        self._fact("op", op)
        return op, self.instances[instance].role

    def _limits(self) -> None:
        context = self.change.start.context
        outputs = [
            PortRef(name, output) for name, instance in self.instances.items() for output in instance.component.outputs
        ]
        for name, connector in context.connectors.items():
            cap = connector.max_publishers if connector.kind == "topic" else 1
            if cap is not None:
                outside = len(context.publishers_out_of_scope(connector))
                self._fact("capped", name, cap - outside)
                sibling = self.change.sibling(name)
                for output in outputs:
                    self._fact("counts", output, name, name)
                    if sibling is not None:
                        self._fact("counts", output, sibling, name)
        for resource in {r for instance in self.instances.values() for r in instance.component.resource_usage}:
            self._fact("capacity", resource, _scaled(context.capacity(resource)))
            for name, instance in self.instances.items():
                if resource in instance.component.resource_usage:
                    self._fact("holds", name, resource, _scaled(instance.component.resource_usage[resource]))

    def _levels(self) -> dict[FunctionalityRef, int]:
        """The baseline of each functionality that both ends have, from the two ends themselves."""
        start, target = self.change.specification, self.change.target
        baselines = {}
        for role in set(start.nodes) & set(target.nodes):
            old, new = start.component_of(role), target.component_of(role)
            for name in set(old.functionalities) & set(new.functionalities):
                ref, will = FunctionalityRef(role, name), new.functionalities[name]
                needed, worst = self._served(ref)
                ends = (self.change.baseline, initial(target))
                baseline = baselines[ref] = max(_level(end, ref, needed, worst) for end in ends)
                key = ("level", ref)
                self._fact("baseline", key, baseline)
                self._fact("weight", key, _scaled(will.weight))
                for level in range(worst):
                    self._fact("level", key, level)
                for instance in self.instances.values():
                    if instance.role == role and name in instance.component.functionalities:
                        own = FunctionalityRef(instance.name, name)
                        self._fact("instance_of", own, key)
                        for output in needed:
                            self._fact("required", own, PortRef(instance.name, output))
        return baselines

    def _constraints(self, ops: list[tuple[tuple[object, ...], str]], baselines: dict[FunctionalityRef, int]) -> None:
        target = self.change.target
        for constraint in in_force(self.change):
            if isinstance(constraint, Order):
                for first, role in ops:
                    for then, other in ops:
                        if (role, other) == (constraint.first, constraint.then) and role != other:
                            self._fact("before", first, then)
            elif (ref := constraint.functionality) not in baselines:
                continue
            elif isinstance(constraint, Limit) and not constraint.seconds:
                self._fact("never", ("level", ref))
            elif isinstance(constraint, Keep):
                chain = target.component_of(ref.instance).functionalities[ref.functionality]
                level = _level(self.change.start, ref, *self._served(ref))
                self._fact("keep", ("level", ref), max(chain.mode_index(constraint.mode), level))

    def _served(self, ref: FunctionalityRef) -> tuple[list[str], int]:
        """The outputs without which a role's functionality is not served, and the level that it then has."""
        start, target = self.change.specification, self.change.target
        was, will = (spec.component_of(ref.instance).functionalities[ref.functionality] for spec in (start, target))
        attached = [spec.nodes[ref.instance].attachments for spec in (start, target)]
        needed = [name for name in set(was.outputs) & set(will.outputs) if all(each.get(name) for each in attached)]
        return needed, max(len(was.modes), len(will.modes))


def _level(configuration: Configuration, ref: FunctionalityRef, needed: list[str], worst: int) -> int:
    level = worst
    for instance in configuration.instances.values():
        has_it = instance.role == ref.instance and ref.functionality in instance.component.functionalities
        if has_it and all(configuration.attached_to(PortRef(instance.name, output)) for output in needed):
            level = min(level, configuration.modes[FunctionalityRef(instance.name, ref.functionality)])
    return level


def _scaled(amount: float) -> int:
    scaled = Fraction(repr(amount)) * UNIT
    assert scaled.denominator == 1, amount
    return int(scaled)
