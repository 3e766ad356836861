"""The model as a first-order theory: declarations, configurations, satisfaction, validity.

See docs/semantics.md, sections 1 to 3. Contracts are elements with a satisfaction relation that obeys section 1 and is
otherwise arbitrary, so rates, fields and bounds are all the same here. Services and ROS actions are topics with a cap
of 1, their servers outputs and their clients inputs. The publishers of a topic and the held amount of a resource are
numbers, with three laws of finite sets: a part is no larger than the whole (:meth:`Theory.state`, for publishers and
amounts), and one-to-one replacement keeps the number (``actions.handover``). Bounded scripts count instead.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import TypeAlias

from midstride.verify.prove.terms import TRUE, Logic, Term, and_, app, equal, if_, implies, not_, or_

COMPONENT, FUNCTIONALITY, MODE, PORT = "Component", "Functionality", "Mode", "Port"
TOPIC, PREDICATE, ASSUMPTION, OFFER, RESOURCE = "Topic", "Predicate", "Assumption", "Offer", "Resource"
SATISFIED = "every functionality is satisfied"
SORTS = (COMPONENT, FUNCTIONALITY, MODE, PORT, TOPIC, PREDICATE, ASSUMPTION, OFFER, RESOURCE)


# The named conjuncts of a hypothesis or of a conclusion.
Parts: TypeAlias = dict[str, Term]


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


class Theory(Logic):
    """The declarations, as SMT-LIB functions; the rules; and satisfaction in a state."""

    def __init__(self, sizes: Mapping[str, int] | None = None) -> None:
        super().__init__(SORTS, sizes)
        declare = self.function
        self.satisfies = declare("satisfies", (PREDICATE, PREDICATE), "Bool")
        self.nothing = self.constant("nothing", PREDICATE)
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
        if self.bounded:  # small numbers, for readable counterexamples
            few = ("0", "1", "2")
            self.facts += [
                self.all((TOPIC,), lambda k: or_(*(equal(self.cap(k), n) for n in few))),
                self.all((RESOURCE,), lambda r: or_(*(equal(self.capacity(r), f"{n}.0") for n in few))),
                self.all((COMPONENT, RESOURCE), lambda c, r: or_(*(equal(self.holds(c, r), f"{n}.0") for n in few))),
            ]
        else:
            self._offers_on = declare("number_of_offers", (TOPIC,), "Int")
            self.facts.append(self.all((TOPIC,), lambda k: app(">=", self._offers_on(k), "0")))

    def rules(self) -> Parts:
        """The rules that every well-formed system obeys (docs/semantics.md, sections 1 and 2), by name."""
        sat, nothing, better, whose = self.satisfies, self.nothing, self.better, self.whose
        satisfaction = and_(
            self.all((PREDICATE,), lambda q: not_(sat(nothing, q))),
            self.all((PREDICATE,), lambda q: or_(equal(q, nothing), sat(q, q))),
            self.all((PREDICATE,) * 3, lambda p, q, r: implies(and_(sat(p, q), sat(q, r)), sat(p, r))),
        )
        declared = and_(
            self.all((PORT,), lambda p: implies(self.is_output(p), equal(self.host(self.owner(p)), self.component(p)))),
            self.all(
                (FUNCTIONALITY, PORT),
                lambda f, p: implies(
                    self.uses(f, p), and_(not_(self.is_output(p)), equal(self.component(p), self.host(f)))
                ),
            ),
            self.all((OFFER, TOPIC), lambda e, k: implies(self.is_free(e), not_(self.offered_on(e, k)))),
            self.all((COMPONENT, RESOURCE), lambda c, r: app(">=", self.holds(c, r), "0.0")),
        )
        named = self.all(
            (MODE, ASSUMPTION, PORT),
            lambda m, a, p: implies(
                and_(self.assumes(m, a), self.is_named(a), self.names(a, p)), self.uses(whose(m), p)
            ),
        )
        chains = and_(
            self.all((MODE,), lambda m: not_(better(m, m))),
            self.all((MODE,) * 3, lambda m, n, o: implies(and_(better(m, n), better(n, o)), better(m, o))),
            self.all((MODE, MODE), lambda m, n: implies(better(m, n), equal(whose(m), whose(n)))),
            self.all(
                (MODE, MODE),
                lambda m, n: implies(equal(whose(m), whose(n)), or_(equal(m, n), better(m, n), better(n, m))),
            ),
            self.all((FUNCTIONALITY,), lambda f: and_(equal(whose(self.normal(f)), f), equal(whose(self.last(f)), f))),
            self.all((MODE,), lambda m: not_(better(m, self.normal(whose(m))))),
            self.all((MODE,), lambda m: not_(better(self.last(whose(m)), m))),
        )
        m1 = self.all((FUNCTIONALITY, ASSUMPTION), lambda f, a: not_(self.assumes(self.last(f), a)))
        m2 = self.all(
            (MODE, MODE, PORT, PREDICATE),
            lambda m, n, p, q: implies(
                and_(self.is_output(p), equal(self.owner(p), whose(m)), better(m, n), sat(self.guarantee(n, p), q)),
                sat(self.guarantee(m, p), q),
            ),
        )
        return {
            "satisfaction is a preorder, and `nothing` satisfies nothing": satisfaction,
            "ports, functionalities and offers are well-formed": declared,
            "an assumption names associated inputs": named,
            "modes form chains": chains,
            "M1": m1,
            "M2": m2,
        }

    # -- states --------------------------------------------------------------------------------------

    def assignment(self, name: str) -> Callable[..., Term]:
        """An arbitrary function from each functionality to one of its modes."""
        mode = self.function(name, (FUNCTIONALITY,), MODE)
        self.facts.append(self.all((FUNCTIONALITY,), lambda f: equal(self.whose(mode(f)), f)))
        return mode

    def start(self, tag: str = "before") -> State:
        """An arbitrary configuration in which each functionality is in one of its modes."""
        mode = self.assignment(f"mode_{tag}")
        live = self.function(f"live_{tag}", (COMPONENT,), "Bool")
        attached = self.function(f"attached_{tag}", (PORT, TOPIC), "Bool")
        return self.state(tag, live, attached, mode)

    def state(
        self,
        tag: str,
        live: Callable[[Term], Term],
        attached: Callable[[Term, Term], Term],
        mode: Callable[[Term], Term],
    ) -> State:
        """A configuration; its numbers are related to those of every earlier one."""
        if self.bounded:
            return State(
                live,
                attached,
                mode,
                lambda k: app(
                    "+",
                    self.number(PORT, lambda p: and_(self.is_output(p), attached(p, k))),
                    self.number(OFFER, lambda e: self.offered_on(e, k)),
                ),
                lambda r: app("+", "0.0", *(if_(live(c), self.holds(c, r), "0.0") for c in self.elements(COMPONENT))),
            )
        outputs = self.function(f"outputs_on_{tag}", (TOPIC,), "Int")
        held = self.function(f"held_{tag}", (RESOURCE,), "Real")
        state = State(live, attached, mode, lambda k: app("+", outputs(k), self._offers_on(k)), held)
        for other in self._states:
            self.facts += [*self._part_and_whole(state, other), *self._part_and_whole(other, state)]
        self._states.append(state)
        return state

    def _part_and_whole(self, part: State, whole: State) -> list[Term]:
        return [
            self.all(
                (TOPIC,),
                lambda k: implies(
                    self.all(
                        (PORT,), lambda p: implies(and_(self.is_output(p), part.attached(p, k)), whole.attached(p, k))
                    ),
                    app("<=", part.publishers(k), whole.publishers(k)),
                ),
            ),
            self.all(
                (RESOURCE,),
                lambda r: implies(
                    self.all((COMPONENT,), lambda c: implies(part.live(c), whole.live(c))),
                    app("<=", part.held(r), whole.held(r)),
                ),
            ),
        ]

    def same(self, s: State, t: State) -> Parts:
        """Two configurations are the same. Modes count only for live components."""
        ports = self.all((PORT, TOPIC), lambda p, k: equal(s.attached(p, k), t.attached(p, k)))
        modes = self.all((FUNCTIONALITY,), lambda f: implies(self.live_in(t, f), equal(s.mode(f), t.mode(f))))
        return {
            "the same components are live": self.all((COMPONENT,), lambda c: equal(s.live(c), t.live(c))),
            "the same ports are attached": ports,
            "every functionality is in the same mode": modes,
        }

    # -- satisfaction and validity ---------------------------------------------------------------------

    def current(self, s: State, output: Term) -> Term:
        """The guarantee of an output in the current mode of its owner."""
        return self.guarantee(s.mode(self.owner(output)), output)

    def meets(self, s: State, output: Term, k: Term) -> Term:
        """Return whether an output meets the guarantee of a topic in that mode."""
        return self.satisfies(self.current(s, output), self.topic_guarantee(k))

    def topic_satisfied(self, s: State, k: Term) -> Term:
        published = self.some(
            (PORT,),
            lambda p: and_(self.is_output(p), s.live(self.component(p)), s.attached(p, k), self.meets(s, p, k)),
        )
        offered = self.some(
            (OFFER,),
            lambda e: and_(self.offered_on(e, k), self.satisfies(self.offers(e), self.topic_guarantee(k))),
        )
        return or_(published, offered)

    def input_satisfied(self, s: State, p: Term) -> Term:
        return self.some(
            (TOPIC,),
            lambda k: and_(
                s.attached(p, k),
                self.satisfies(self.topic_guarantee(k), self.input_assumes(p)),
                self.topic_satisfied(s, k),
            ),
        )

    def assumption_satisfied(self, s: State, f: Term, a: Term) -> Term:
        named = self.some((PORT,), lambda p: and_(self.names(a, p), self.input_satisfied(s, p)))
        by_input = self.some(
            (PORT,),
            lambda p: and_(
                self.uses(f, p), self.satisfies(self.input_assumes(p), self.wants(a)), self.input_satisfied(s, p)
            ),
        )
        by_offer = self.some((OFFER,), lambda e: and_(self.is_free(e), self.satisfies(self.offers(e), self.wants(a))))
        return if_(self.is_named(a), named, or_(by_input, by_offer))

    def mode_satisfied(self, s: State, f: Term, m: Term) -> Term:
        """Return whether the assumptions of mode ``m`` of ``f`` are satisfied in ``s``, whatever mode ``f`` is in."""
        return self.all((ASSUMPTION,), lambda a: implies(self.assumes(m, a), self.assumption_satisfied(s, f, a)))

    def satisfied(self, s: State, f: Term) -> Term:
        return self.mode_satisfied(s, f, s.mode(f))

    def live_in(self, s: State, f: Term) -> Term:
        return s.live(self.host(f))

    def all_satisfied(self, s: State, among: Callable[[Term], Term] = lambda f: TRUE) -> Term:
        """Every live functionality, of those for which ``among`` is true, is satisfied."""
        return self.all((FUNCTIONALITY,), lambda f: implies(and_(self.live_in(s, f), among(f)), self.satisfied(s, f)))

    def cap_holds(self, s: State, k: Term) -> Term:
        return implies(self.capped(k), app("<=", s.publishers(k), self.cap(k)))

    def capacities_hold(self, s: State) -> Term:
        return self.all((RESOURCE,), lambda r: app("<=", s.held(r), self.capacity(r)))

    def structure_valid(self, s: State) -> Parts:
        """The part of validity that does not depend on modes."""
        live = self.all((PORT, TOPIC), lambda p, k: implies(s.attached(p, k), s.live(self.component(p))))
        return {
            "only ports of live components are attached": live,
            "no publisher cap is exceeded": self.all((TOPIC,), lambda k: self.cap_holds(s, k)),
            "no capacity is exceeded": self.capacities_hold(s),
        }

    def valid(self, s: State) -> Parts:
        """Section 3: the safety property."""
        return {SATISFIED: self.all_satisfied(s), **self.structure_valid(s)}

    def fits(self, p: Term, k: Term) -> Term:
        """Return whether the contracts of a port and a topic fit, as ``attach`` requires."""
        normal = self.guarantee(self.normal(self.owner(p)), p)
        needed = self.topic_guarantee(k)
        return if_(self.is_output(p), self.satisfies(normal, needed), self.satisfies(needed, self.input_assumes(p)))

    def all_fit(self, s: State) -> Term:
        return self.all((PORT, TOPIC), lambda p, k: implies(s.attached(p, k), self.fits(p, k)))

    def at_least(self, m: Term, n: Term) -> Term:
        """Mode ``m`` is ``n`` or better."""
        return or_(equal(m, n), self.better(m, n))
