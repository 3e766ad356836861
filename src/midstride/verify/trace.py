"""From Alloy's instance back to the file's own names: what does not hold, where, and why.

That something does not hold is Alloy's word alone. The reason is worked out on the configuration by the model; where
the model sees none, that is said, since one of the two is then wrong.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping

from midstride.errors import AlloyFailed
from midstride.model.action import Action
from midstride.model.component import Assumption, FunctionalityRef
from midstride.model.configuration import Configuration
from midstride.model.rules import Evaluator, cap_violation
from midstride.plan.step import Step
from midstride.verify.alloy_atoms import ModeName, SystemName
from midstride.verify.alloy_text import BEST, VERDICT, StepName
from midstride.verify.chain import chain
from midstride.verify.export import Dump
from midstride.verify.run import SolverOutcome
from midstride.verify.verdict import Finding

_FINDINGS = "Findings$0"
_DISAGREE = "so says Alloy; the model sees no reason, so one of the two is wrong: please report it"


class AlloyInstance:
    """The fields of an Alloy instance, its atoms turned into what they stand for."""

    def __init__(self, outcome: SolverOutcome, bearers: Mapping[str, object], fields: frozenset[str]) -> None:
        self._values = outcome.values.get(_FINDINGS, {})
        self._bearers = bearers
        if missing := sorted(fields - self._values.keys()):
            raise AlloyFailed(f"Alloy's answer does not say all that was asked ({', '.join(missing)})")

    def bearer(self, atom: str) -> object:
        try:
            return self._bearers[_name(atom)]
        except KeyError:
            raise AlloyFailed(f"Alloy's answer speaks of {atom}, which is not in the dump") from None

    def field(self, field: str) -> list[tuple[object, ...]]:
        """The tuples of a field of Findings; none where the dump does not ask for it."""
        return [tuple(self.bearer(each) for each in entry) for entry in self._values.get(field, [])]

    def steps(self, field: str) -> list[StepName]:
        return [named for (named,) in self.field(field) if isinstance(named, StepName)]

    def systems(self, field: str) -> list[SystemName]:
        return [named for (named,) in self.field(field) if isinstance(named, SystemName)]


def _name(atom: str) -> str:
    return atom.rpartition("$")[0].rpartition("/")[2]


def instance(dump: Dump, outcomes: Mapping[str, SolverOutcome]) -> AlloyInstance:
    """What the dump's `Verdict` found. Raises AlloyFailed where there is none: the dump must have an instance."""
    told = outcomes.get(VERDICT)
    if told is None or not told.satisfiable:
        raise AlloyFailed("the dump contradicts itself: Alloy finds no instance of it")
    return AlloyInstance(told, dump.bearers, dump.fields)


def confirm(dump: Dump, outcomes: Mapping[str, SolverOutcome]) -> None:
    """That nothing was found is said a second time, by the checks. Raises AlloyFailed where they say otherwise."""
    for check in dump.checks:
        if check not in outcomes or outcomes[check].satisfiable:
            raise AlloyFailed(f"Alloy contradicts itself: it finds nothing, and the check {check} does not hold")


def first_failure(dump: Dump, found: AlloyInstance) -> int | None:
    """The first step (0: the start) that fails, or whose configuration is not valid; None where there is none."""
    numbers = [stray.step for stray in dump.strays if stray.step is not None]
    numbers += [named.number for field in ("refused", "wrong") for named in found.steps(field)]
    numbers += [named.number for named in found.systems("invalid") if named.number < len(dump.configurations)]
    return min(numbers, default=None)


def unexplained(dump: Dump, found: AlloyInstance) -> int | None:
    """The first step that fails, where only its own detailed dump tells why; None where this one does."""
    number = first_failure(dump, found)
    strays = {stray.step for stray in dump.strays}
    if number in {None, dump.detail} | strays or number in {named.number for named in found.steps("wrong")}:
        return None
    return number


def findings(dump: Dump, outcomes: Mapping[str, SolverOutcome]) -> list[Finding]:
    """What does not hold: the declarations, else the start, else the first step that fails, else the end.

    Why a step fails is in the answers to its detailed dump. Raises AlloyFailed where the answer is none.
    """
    tracer = _Tracer(dump, instance(dump, outcomes))
    parts: tuple[Callable[[], Iterator[Finding]], ...] = (
        tracer.rules,
        tracer.start,
        tracer.steps,
        lambda: tracer.end(outcomes.get(BEST)),
    )
    for part in parts:
        if found := list(part()):
            return found
    return []


class _Tracer:
    def __init__(self, dump: Dump, found: AlloyInstance) -> None:
        self.dump = dump
        self.instance = found
        self.refused = {named.number for named in found.steps("refused")}
        self.wrong = {named.number for named in found.steps("wrong")}
        self.invalid = {named.number for named in found.systems("invalid")}

    def _all(self, field: str) -> list[tuple[object, ...]]:
        return self.instance.field(field)

    # -- the parts, in the order in which they matter -----------------------------------------------------

    def rules(self) -> Iterator[Finding]:
        for (clause,) in self._all("faults"):
            yield Finding("rule", None, "the declarations", "rule", str(clause))

    def start(self) -> Iterator[Finding]:
        where = "the configuration" if self.dump.steps is None else "at the start"
        if self.dump.steps is None:
            for stray in self.dump.strays:
                yield Finding("attachment", None, where, "attachment", stray.told)
        if 0 in self.invalid:
            yield from self._configuration(0, where)

    def steps(self) -> Iterator[Finding]:
        number = first_failure(self.dump, self.instance)
        if number and self.dump.steps is not None:
            yield from self._step(number, self.dump.steps[number - 1])

    def end(self, best: SolverOutcome | None) -> Iterator[Finding]:
        if self.dump.steps is None:
            return
        where = "at the end"
        for stray in self.dump.strays:
            if stray.step is None:
                yield Finding("end", None, where, "target", stray.told.removeprefix("at the end "))
        for connector, port in self._all("missing"):
            yield Finding("end", None, where, str(port), f"it should be attached to {connector}, and is not")
        for connector, port in self._all("extra"):
            yield Finding("end", None, where, str(port), f"it is attached to {connector}, and should not be")
        for (component,) in self._all("absent"):
            yield Finding("end", None, where, str(component), "it should be live, and is not")
        for (component,) in self._all("left"):
            yield Finding("end", None, where, str(component), "it is live, and should not be")
        if best is not None and best.satisfiable:
            yield from self._better(best, where)

    # -- one step, one configuration ------------------------------------------------------------------------

    def _step(self, number: int, step: Step) -> Iterator[Finding]:
        where = f"step {number}, {step.describe()}"
        strays = [stray for stray in self.dump.strays if stray.step == number]
        if strays:
            yield from (Finding("name", number, where, step.action.kind, stray.told) for stray in strays)
            return
        if number in self.refused:
            yield from self._refused(number, step.action, where)
        elif number in self.wrong:
            yield Finding("effect", number, where, step.action.kind, "its effect is not what the action does")
        else:
            yield from self._configuration(number, f"after step {number}, {step.describe()}")

    def _refused(self, number: int, action: Action, where: str) -> Iterator[Finding]:
        before, after = self.dump.configurations[number - 1 : number + 1]
        found = False
        for ref, assumption in self._all("lacking"):
            found = True
            yield self._lacking(after, ref, assumption, number, where, "precondition")
        for connector, port in self._all("attached"):
            found = True
            yield Finding("precondition", number, where, str(port), f"it is still attached to {connector}")
        reasons = [str(reason) for reason in action.check(before)]
        for (clause,) in self._all("broken"):
            found = True
            because = "; ".join(reasons) or _DISAGREE
            yield Finding("precondition", number, where, action.kind, f"{clause} ({because})")
        if not found:
            because = "; ".join(reasons) or _DISAGREE
            yield Finding("precondition", number, where, action.kind, f"its precondition does not hold ({because})")

    def _configuration(self, at: int, where: str) -> Iterator[Finding]:
        configuration, number = self.dump.configurations[at], at or None
        found = False
        for ref, assumption in self._all("unsatisfied"):
            found = True
            yield self._lacking(configuration, ref, assumption, number, where, "assumption")
        for (connector,) in self._all("crowded"):
            found = True
            violation = cap_violation(configuration, str(connector))
            because = _DISAGREE if violation is None else violation.because
            yield Finding("cap", number, where, str(connector), because)
        for (group,) in self._all("overloaded"):
            found = True
            together = ", ".join(str(name) for name in group) if isinstance(group, tuple) else str(group)
            yield Finding("capacity", number, where, together, "together they hold more of a resource than there is")
        if not found:
            yield Finding(
                "attachment", number, where, "structure", "a mode or an attachment belongs to nothing that is live"
            )

    def _lacking(
        self, configuration: Configuration, ref: object, assumption: object, number: int | None, where: str, kind: str
    ) -> Finding:
        assert isinstance(ref, FunctionalityRef)
        model: Assumption = assumption  # type: ignore[assignment]
        functionality = configuration.functionality(ref)
        judge = Evaluator(configuration)
        agreed = not judge.assumption_satisfied(ref, functionality, model)
        because = judge.why_assumption_unsatisfied(ref, model) if agreed else f"assumes {model}: {_DISAGREE}"
        subject = f"{ref} in mode {configuration.mode(ref).name}"
        told = chain(configuration, ref, model)
        if kind == "precondition":
            return Finding("precondition", number, where, subject, because, str(model), told)
        return Finding("assumption", number, where, subject, because, str(model), told)

    def _better(self, best: SolverOutcome, where: str) -> Iterator[Finding]:
        raised = [entry for name, tuples in best.skolems.items() if name.endswith("_to") for entry in tuples]
        better = [self.instance.bearer(mode) for _, mode in raised]
        told = [mode for mode in better if isinstance(mode, ModeName)]
        if not told:
            yield Finding("end", None, where, "modes", "some functionality could be in a better mode")
        for mode in told:
            together = " (together with the others)" if len(told) > 1 else ""
            yield Finding("end", None, where, str(mode.functionality), f"it could be in mode {mode.mode}{together}")
