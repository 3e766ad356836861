"""The text of a counterexample: the configuration before, the action, and what does not hold afterwards."""

from __future__ import annotations

from functools import cache
from itertools import product

from midstride.model import wording
from midstride.verify.prove.goals import Case
from midstride.verify.prove.solvers import Session, value
from midstride.verify.prove.terms import Term, app
from midstride.verify.prove.theory import (
    ASSUMPTION,
    COMPONENT,
    FUNCTIONALITY,
    OFFER,
    PORT,
    RESOURCE,
    TOPIC,
    State,
    Theory,
)


class Counterexample:
    """Reads a solver's model lazily. Components are c1, c2, …, their functionalities c1.f1, and so on."""

    def __init__(self, t: Theory, case: Case, session: Session) -> None:
        self.t, self.case = t, case
        self.value = cache(lambda term: value(session, term))

    def true(self, term: Term) -> bool:
        return self.value(term) == "true"

    def every(self, sort: str) -> list[Term]:
        return self.t.elements(sort)

    @staticmethod
    def short(element: Term) -> str:
        sort, _, number = element.partition("_")
        return f"{sort[0]}{number}"

    def port(self, p: Term) -> str:
        return f"{self.short(self.value(self.t.component(p)))}.{self.short(p)}"

    def functionality(self, f: Term) -> str:
        return f"{self.short(self.value(self.t.host(f)))}.{self.short(f)}"

    def assumption(self, f: Term, a: Term) -> str:
        if self.true(self.t.is_named(a)):
            named = [self.port(p) for p in self.every(PORT) if self.true(self.t.names(a, p))]
            return " or ".join(named) or "no input"
        return f"contract {self.short(self.value(self.t.wants(a)))}"

    def needs(self, f: Term, m: Term) -> str:
        wanted = [self.assumption(f, a) for a in self.every(ASSUMPTION) if self.true(self.t.assumes(m, a))]
        return f"assumes {' and '.join(wanted)}" if wanted else "assumes nothing"

    def modes(self, s: State) -> list[str]:
        lines = []
        for f in self.every(FUNCTIONALITY):
            if self.true(self.t.live_in(s, f)):
                m = self.value(s.mode(f))
                lines.append(f"{self.functionality(f)} in {self.short(m)} ({self.needs(f, m)})")
        return lines

    def attachments(self, s: State) -> list[str]:
        lines = []
        for k, p in product(self.every(TOPIC), self.every(PORT)):
            if not self.true(s.attached(p, k)):
                continue
            if not self.true(self.t.is_output(p)):
                lines.append(f"input {self.port(p)} on {self.short(k)}")
                continue
            meets = self.true(self.t.meets(s, p, k))
            lines.append(f"output {self.port(p)} on {self.short(k)} ({'meets' if meets else 'does not meet'} it)")
        return lines

    def configuration(self, s: State) -> str:
        live = [self.short(c) for c in self.every(COMPONENT) if self.true(s.live(c))]
        parts = [f"live {', '.join(live) or 'nothing'}", *self.modes(s), *self.attachments(s)]
        for e, k in product(self.every(OFFER), self.every(TOPIC)):
            if self.true(self.t.offered_on(e, k)):
                parts.append(f"the environment publishes on {self.short(k)}")
        return "; ".join(parts)

    def action(self) -> str:
        action = self.case.action
        kind, _, direction = action.partition(" ")
        if kind in ("create", "remove"):
            return wording.existence(kind, self.short(self.value("the_component")))
        if kind in ("attach", "detach"):
            port, topic = f"{direction} {self.port(self.value('the_port'))}", self.short(self.value("the_topic"))
            return wording.attachment(kind, port, topic)
        if kind in ("degrade", "upgrade"):
            members = [f for f in self.every(FUNCTIONALITY) if self.true(app("in_group", f))]
            entered = {f: self.short(self.value(app("mode_named", f))) for f in members}
            return wording.mode_changes(kind, ((self.functionality(f), None, mode) for f, mode in entered.items()))
        if kind == "handover":
            swaps = product(self.every(TOPIC), self.every(PORT), self.every(PORT))
            chosen = [each for each in swaps if self.true(app("swapped", *each))]
            return wording.handover((self.short(k), self.port(o), self.port(n)) for k, o, n in chosen)
        return ""

    def breaches(self, s: State) -> list[str]:
        """The rules that make a configuration invalid."""
        t = self.t
        lines: list[str] = []
        for f, a in product(self.every(FUNCTIONALITY), self.every(ASSUMPTION)):
            m = self.value(s.mode(f))
            if (
                self.true(t.live_in(s, f))
                and self.true(t.assumes(m, a))
                and not self.true(t.assumption_satisfied(s, f, a))
            ):
                lines.append(f"{self.functionality(f)} in {self.short(m)} lacks {self.assumption(f, a)}")
        for k, p in product(self.every(TOPIC), self.every(PORT)):
            if self.true(s.attached(p, k)) and not self.true(s.live(t.component(p))):
                lines.append(f"{self.port(p)} is attached to {self.short(k)} but is not live")
        for k in self.every(TOPIC):
            if not self.true(t.cap_holds(s, k)):
                count, cap = self.value(s.publishers(k)), self.value(t.cap(k))
                counted = f"{count} publisher{'' if count == '1' else 's'}"
                lines.append(f"{self.short(k)} has {counted}, more than the {_number(cap)} allowed")
        for r in self.every(RESOURCE):
            if not self.true(app("<=", s.held(r), t.capacity(r))):
                held, capacity = _number(self.value(s.held(r))), _number(self.value(t.capacity(r)))
                lines.append(f"{held} of {self.short(r)} is held, but its capacity is {capacity}")
        return lines

    def __str__(self) -> str:
        before, *later = self.case.states
        failed = [name for name, formula in self.case.conclusion.items() if not self.true(formula)]
        in_validity = any("satisfied" in name or name.startswith(("only ports", "no ")) for name in failed)
        parts = [f"before: {self.configuration(before)}"]
        if action := self.action():
            parts.append(f"then {action}")
        elif later:
            parts.append(f"then: {self.configuration(later[-1])}")
        parts.append(f"fails: {'; '.join(failed)}")
        if later and in_validity and (breaches := self.breaches(later[0] if self.case.action else later[-1])):
            parts.append(f"since {'; '.join(breaches)}")
        return ". ".join(parts)


def _number(text: str) -> str:
    """`(- 1)`, `(/ 1.0 2.0)` and `1.0` in ordinary notation."""
    words = text.replace("(", " ").replace(")", " ").split()
    if words[0] == "-":
        return f"-{_number(' '.join(words[1:]))}"
    if words[0] == "/":
        return f"{_number(words[1])}/{_number(words[2])}"
    return words[0].removesuffix(".0")
