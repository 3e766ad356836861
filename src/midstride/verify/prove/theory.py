"""The model as a first-order theory: declarations, configurations, satisfaction, validity.

See docs/semantics.md, sections 1 to 3. Contracts are elements with a satisfaction relation that obeys section 1 and is
otherwise arbitrary. The publishers of a topic and the held amount of a resource are numbers, with three laws of finite
sets: a part is no larger than the whole (:meth:`Theory.state`, for publishers and amounts), and one-to-one replacement
keeps the number (``actions.handover``). Bounded scripts count instead.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from midstride.verify.prove.terms import Logic, Term, and_, app, equal, if_, iff, implies, or_

COMPONENT, FUNCTIONALITY, MODE, PORT = "Component", "Functionality", "Mode", "Port"
TOPIC, PREDICATE, ASSUMPTION, OFFER, RESOURCE = "Topic", "Predicate", "Assumption", "Offer", "Resource"
SORTS = (COMPONENT, FUNCTIONALITY, MODE, PORT, TOPIC, PREDICATE, ASSUMPTION, OFFER, RESOURCE)


@dataclass(frozen=True, slots=True)
class Part:
    """One named conjunct of a hypothesis or a conclusion."""

    name: str
    formula: Term


@dataclass(frozen=True, slots=True)
class State:
    """A configuration: live components, attachments, modes; and the derived numbers."""

    live: Callable[[Term], Term]
    attached: Callable[[Term, Term], Term]
    mode: Callable[[Term], Term]
    publishers: Callable[[Term], Term]
    held: Callable[[Term], Term]

    def in_modes(self, mode: Callable[[Term], Term]) -> State:
        return replace(self, mode=mode)


class Theory:
    """The declarations, as SMT-LIB functions, and satisfaction in a state. The rules are in :mod:`.rules`."""

    def __init__(self, sizes: Mapping[str, int] | None = None) -> None:
        logic = self.logic = Logic(SORTS, sizes)
        declare = logic.function
        self.satisfies = declare("satisfies", (PREDICATE, PREDICATE), "Bool")
        self.nothing = logic.constant("nothing", PREDICATE)
        # components and ports
        self.component = declare("component_of", (PORT,), COMPONENT)
        self.is_output = declare("is_output", (PORT,), "Bool")
        self.owner = declare("owner", (PORT,), FUNCTIONALITY)
        self.input_assumes = declare("input_assumes", (PORT,), PREDICATE)
        self.host = declare("host", (FUNCTIONALITY,), COMPONENT)
        self.uses = declare("uses", (FUNCTIONALITY, PORT), "Bool")
        # modes
        self.whose = declare("whose", (MODE,), FUNCTIONALITY)
        self.better = declare("better", (MODE, MODE), "Bool")
        self.normal = declare("normal", (FUNCTIONALITY,), MODE)
        self.last = declare("last", (FUNCTIONALITY,), MODE)
        self.guarantee = declare("guarantee", (MODE, PORT), PREDICATE)
        self.assumes = declare("assumes", (MODE, ASSUMPTION), "Bool")
        self.is_named = declare("is_named", (ASSUMPTION,), "Bool")
        self.names = declare("names", (ASSUMPTION, PORT), "Bool")
        self.wants = declare("wants", (ASSUMPTION,), PREDICATE)
        # the system context
        self.topic_guarantee = declare("topic_guarantee", (TOPIC,), PREDICATE)
        self.capped = declare("capped", (TOPIC,), "Bool")
        self.cap = declare("cap", (TOPIC,), "Int")
        self.offers = declare("offers", (OFFER,), PREDICATE)
        self.offered_on = declare("offered_on", (OFFER, TOPIC), "Bool")
        self.is_free = declare("is_free", (OFFER,), "Bool")
        self.capacity = declare("capacity", (RESOURCE,), "Real")
        self.holds = declare("holds", (COMPONENT, RESOURCE), "Real")
        self._states: list[State] = []
        if logic.bounded:  # small numbers, for readable counterexamples
            few = ("0", "1", "2")
            logic.facts += [
                logic.all((TOPIC,), lambda k: or_(*(equal(self.cap(k), n) for n in few))),
                logic.all((RESOURCE,), lambda r: or_(*(equal(self.capacity(r), f"{n}.0") for n in few))),
                logic.all((COMPONENT, RESOURCE), lambda c, r: or_(*(equal(self.holds(c, r), f"{n}.0") for n in few))),
            ]
        else:
            self._offers_on = declare("number_of_offers", (TOPIC,), "Int")
            logic.facts.append(logic.all((TOPIC,), lambda k: app(">=", self._offers_on(k), "0")))

    # -- states --------------------------------------------------------------------------------------

    def start(self, tag: str = "before") -> State:
        """An arbitrary configuration in which each functionality is in one of its modes."""
        logic = self.logic
        mode = logic.function(f"mode_{tag}", (FUNCTIONALITY,), MODE)
        logic.facts.append(logic.all((FUNCTIONALITY,), lambda f: equal(self.whose(mode(f)), f)))
        live = logic.function(f"live_{tag}", (COMPONENT,), "Bool")
        attached = logic.function(f"attached_{tag}", (PORT, TOPIC), "Bool")
        return self.state(tag, live, attached, mode)

    def state(
        self,
        tag: str,
        live: Callable[[Term], Term],
        attached: Callable[[Term, Term], Term],
        mode: Callable[[Term], Term],
    ) -> State:
        """A configuration; its numbers are related to those of every earlier one."""
        logic = self.logic
        if logic.bounded:
            return State(
                live,
                attached,
                mode,
                lambda k: app(
                    "+",
                    logic.number(PORT, lambda p: and_(self.is_output(p), attached(p, k))),
                    logic.number(OFFER, lambda e: self.offered_on(e, k)),
                ),
                lambda r: app("+", "0.0", *(if_(live(c), self.holds(c, r), "0.0") for c in logic.elements(COMPONENT))),
            )
        outputs = logic.function(f"outputs_on_{tag}", (TOPIC,), "Int")
        held = logic.function(f"held_{tag}", (RESOURCE,), "Real")
        state = State(live, attached, mode, lambda k: app("+", outputs(k), self._offers_on(k)), held)
        for other in self._states:
            logic.facts += [*self._part_and_whole(state, other), *self._part_and_whole(other, state)]
        self._states.append(state)
        return state

    def _part_and_whole(self, part: State, whole: State) -> list[Term]:
        logic = self.logic
        return [
            logic.all(
                (TOPIC,),
                lambda k: implies(
                    logic.all(
                        (PORT,), lambda p: implies(and_(self.is_output(p), part.attached(p, k)), whole.attached(p, k))
                    ),
                    app("<=", part.publishers(k), whole.publishers(k)),
                ),
            ),
            logic.all(
                (RESOURCE,),
                lambda r: implies(
                    logic.all((COMPONENT,), lambda c: implies(part.live(c), whole.live(c))),
                    app("<=", part.held(r), whole.held(r)),
                ),
            ),
        ]

    def same(self, s: State, t: State) -> list[Part]:
        """Two configurations are the same. Modes count only for live components."""
        logic = self.logic
        return [
            Part("the same components are live", logic.all((COMPONENT,), lambda c: iff(s.live(c), t.live(c)))),
            Part(
                "the same ports are attached",
                logic.all((PORT, TOPIC), lambda p, k: iff(s.attached(p, k), t.attached(p, k))),
            ),
            Part(
                "every functionality is in the same mode",
                logic.all((FUNCTIONALITY,), lambda f: implies(t.live(self.host(f)), equal(s.mode(f), t.mode(f)))),
            ),
        ]

    # -- satisfaction and validity ---------------------------------------------------------------------

    def current(self, s: State, output: Term) -> Term:
        """The guarantee of an output in the current mode of its owner."""
        return self.guarantee(s.mode(self.owner(output)), output)

    def topic_satisfied(self, s: State, k: Term) -> Term:
        needed = self.topic_guarantee(k)
        published = self.logic.some(
            (PORT,),
            lambda p: and_(
                self.is_output(p),
                s.live(self.component(p)),
                s.attached(p, k),
                self.satisfies(self.current(s, p), needed),
            ),
        )
        offered = self.logic.some(
            (OFFER,), lambda e: and_(self.offered_on(e, k), self.satisfies(self.offers(e), needed))
        )
        return or_(published, offered)

    def input_satisfied(self, s: State, p: Term) -> Term:
        return self.logic.some(
            (TOPIC,),
            lambda k: and_(
                s.attached(p, k),
                self.satisfies(self.topic_guarantee(k), self.input_assumes(p)),
                self.topic_satisfied(s, k),
            ),
        )

    def assumption_satisfied(self, s: State, f: Term, a: Term) -> Term:
        logic = self.logic
        named = logic.some((PORT,), lambda p: and_(self.names(a, p), self.input_satisfied(s, p)))
        by_input = logic.some(
            (PORT,),
            lambda p: and_(
                self.uses(f, p), self.satisfies(self.input_assumes(p), self.wants(a)), self.input_satisfied(s, p)
            ),
        )
        by_offer = logic.some((OFFER,), lambda e: and_(self.is_free(e), self.satisfies(self.offers(e), self.wants(a))))
        return if_(self.is_named(a), named, or_(by_input, by_offer))

    def mode_satisfied(self, s: State, f: Term, m: Term) -> Term:
        """Whether the assumptions of mode ``m`` of ``f`` are satisfied in ``s``, whatever mode ``f`` is in."""
        return self.logic.all((ASSUMPTION,), lambda a: implies(self.assumes(m, a), self.assumption_satisfied(s, f, a)))

    def satisfied(self, s: State, f: Term) -> Term:
        return self.mode_satisfied(s, f, s.mode(f))

    def live_in(self, s: State, f: Term) -> Term:
        return s.live(self.host(f))

    def all_satisfied(self, s: State) -> Term:
        return self.logic.all((FUNCTIONALITY,), lambda f: implies(s.live(self.host(f)), self.satisfied(s, f)))

    def cap_holds(self, s: State, k: Term) -> Term:
        return implies(self.capped(k), app("<=", s.publishers(k), self.cap(k)))

    def capacities_hold(self, s: State) -> Term:
        return self.logic.all((RESOURCE,), lambda r: app("<=", s.held(r), self.capacity(r)))

    def structure_valid(self, s: State) -> list[Part]:
        """The part of validity that does not depend on modes."""
        logic = self.logic
        return [
            Part(
                "only ports of live components are attached",
                logic.all((PORT, TOPIC), lambda p, k: implies(s.attached(p, k), s.live(self.component(p)))),
            ),
            Part("no publisher cap is exceeded", logic.all((TOPIC,), lambda k: self.cap_holds(s, k))),
            Part("no capacity is exceeded", self.capacities_hold(s)),
        ]

    def valid(self, s: State) -> list[Part]:
        """Section 3: the safety property."""
        return [Part("every functionality is satisfied", self.all_satisfied(s)), *self.structure_valid(s)]

    def fits(self, p: Term, k: Term) -> Term:
        """Whether the contracts of a port and a topic fit, as ``attach`` requires."""
        normal = self.guarantee(self.normal(self.owner(p)), p)
        needed = self.topic_guarantee(k)
        return if_(self.is_output(p), self.satisfies(normal, needed), self.satisfies(needed, self.input_assumes(p)))

    def all_fit(self, s: State) -> Term:
        return self.logic.all((PORT, TOPIC), lambda p, k: implies(s.attached(p, k), self.fits(p, k)))

    def at_least(self, m: Term, n: Term) -> Term:
        """Mode ``m`` is ``n`` or better."""
        return or_(equal(m, n), self.better(m, n))
