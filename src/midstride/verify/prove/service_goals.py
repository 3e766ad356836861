"""The proofs about topics carried over to services and ROS actions: these are topics with a cap of 1, of another kind.

F1 and `fit` (:mod:`.goals`) preserve what is assumed here: a valid configuration, and attached ports that fit.
"""

from __future__ import annotations

from midstride.verify.prove.goals import FITS, Case, Goal
from midstride.verify.prove.terms import Term, and_, app, equal, if_, implies, not_
from midstride.verify.prove.theory import PORT, PREDICATE, TOPIC, Theory


def _one_server(t: Theory) -> Case:
    """Services and ROS actions are topics with a cap of 1 (docs/semantics.md, section 2)."""
    s = t.start()
    service = t.function("is_service", (TOPIC,), "Bool")

    def serves(p: Term, k: Term) -> Term:
        return and_(service(k), t.is_output(p), s.attached(p, k))

    if not t.bounded:  # a law of finite sets: two are no fewer than two
        t.facts.append(
            t.all(
                (TOPIC, PORT, PORT),
                lambda k, p, q: implies(
                    and_(serves(p, k), serves(q, k), not_(equal(p, q))), app(">=", s.publishers(k), "2")
                ),
            )
        )
    premises = {
        "each service has a cap of 1": t.all(
            (TOPIC,), lambda k: implies(service(k), and_(t.capped(k), equal(t.cap(k), "1")))
        ),
        "no publisher cap is exceeded": t.all((TOPIC,), lambda k: t.cap_holds(s, k)),
    }
    one = t.all((TOPIC, PORT, PORT), lambda k, p, q: implies(and_(serves(p, k), serves(q, k)), equal(p, q)))
    return Case({}, premises, {"a service has one server at most": one}, (s,), t.some((PORT, TOPIC), serves))


def _one_kind(t: Theory) -> Case:
    """Contracts of one kind satisfy each other only: the types of topics, services and ROS actions differ."""
    s = t.start()
    kind = t.function("kind", (PREDICATE,), "Int")

    def of(p: Term) -> Term:
        return if_(t.is_output(p), kind(t.guarantee(t.normal(t.owner(p)), p)), kind(t.input_assumes(p)))

    premises = {
        "contracts of two kinds do not satisfy each other": t.all(
            (PREDICATE, PREDICATE), lambda p, q: implies(t.satisfies(p, q), equal(kind(p), kind(q)))
        ),
        FITS: t.all_fit(s),
    }
    same = t.all((PORT, TOPIC), lambda p, k: implies(s.attached(p, k), equal(of(p), kind(t.topic_guarantee(k)))))
    conclusion = {"what is attached has the kind of its connector": same}
    return Case({}, premises, conclusion, (s,), t.some((PORT, TOPIC), s.attached))


SERVICE_GOALS: tuple[Goal, ...] = (
    Goal("one server", "services", "a service or ROS action has one server at most", _one_server),
    Goal("one kind", "services", "attached ports that fit have the kind of their connector", _one_kind),
)
