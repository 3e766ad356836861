"""From Alloy's instance back to the names of the file: what does not hold, where, and why.

Alloy alone decides what does not hold; the model works out the reason. If the model finds none, the finding says so,
since one of the two must be wrong.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Set

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
from midstride.verify.verdict import Finding, ViolationKind

_FINDINGS = "Findings$0"
_DISAGREE = "according to Alloy; Midstride's model finds no reason, so one of the two is wrong: please report this"


class AlloyInstance:
    """The fields of an Alloy instance, with the meanings of its atoms."""

    def __init__(self, outcome: SolverOutcome, meanings: Mapping[str, object], fields: Set[str]) -> None:
        self._values = outcome.values.get(_FINDINGS, {})
        self._meanings = meanings
        if missing := sorted(fields - self._values.keys()):
            raise AlloyFailed(f"Alloy's answer is incomplete: no {', '.join(missing)}")

    def meaning(self, atom: str) -> object:
        try:
            return self._meanings[atom.rpartition("$")[0].rpartition("/")[2]]
        except KeyError:
            raise AlloyFailed(f"Alloy's answer contains {atom}, which is not in the dump") from None

    def field(self, field: str) -> list[tuple[object, ...]]:
        """The tuples of a field of Findings; none if the dump has no such field."""
        return [tuple(self.meaning(each) for each in entry) for entry in self._values.get(field, [])]

    def numbers(self, field: str) -> set[int]:
        """The numbers of the steps or systems in a field of Findings."""
        return {name.number for (name,) in self.field(field) if isinstance(name, (StepName, SystemName))}


def instance(dump: Dump, outcomes: Mapping[str, SolverOutcome]) -> AlloyInstance:
    """The instance of the dump's `Verdict`. Raises AlloyFailed where there is none: the dump must have one."""
    verdict = outcomes.get(VERDICT)
    if verdict is None or not verdict.satisfiable:
        raise AlloyFailed("the dump contradicts itself: Alloy finds no instance of it")
    return AlloyInstance(verdict, dump.meanings, dump.obligations.fields.keys())


def confirm(dump: Dump, outcomes: Mapping[str, SolverOutcome]) -> None:
    """Confirm with the checks that nothing was found. Raises AlloyFailed where one does not hold."""
    for check in dump.obligations.checks:
        if check not in outcomes or outcomes[check].satisfiable:
            raise AlloyFailed(f"Alloy contradicts itself: it finds no violation, but the check {check} does not hold")


def first_failure(dump: Dump, found: AlloyInstance) -> int | None:
    """The first step (0: the start) that fails or whose configuration is invalid; None where there is none."""
    numbers = [each.step for each in dump.unencodable if each.step is not None]
    numbers += found.numbers("refused") | found.numbers("wrong")
    numbers += [number for number in found.numbers("invalid") if number < len(dump.configurations)]
    return min(numbers, default=None)


def step_to_explain(dump: Dump, found: AlloyInstance) -> int | None:
    """The first step that fails, if a detailed dump of it is needed to know why."""
    number = first_failure(dump, found)
    unencodable = {each.step for each in dump.unencodable}
    if number in {None, dump.detail} | unencodable | found.numbers("wrong"):
        return None
    return number


def findings(dump: Dump, outcomes: Mapping[str, SolverOutcome]) -> list[Finding]:
    """The faults of a dump: the declarations, else the start, else the first step that fails, else the end.

    The reasons for a failed step are in the answer to its detailed dump. Raises AlloyFailed for an invalid answer.
    """
    tracer = _Tracer(dump, instance(dump, outcomes))
    # Generators: a part is not looked at where one before it found something.
    parts = (tracer.rules(), tracer.start(), tracer.steps(), tracer.end(outcomes.get(BEST)))
    return next((found for part in parts if (found := list(part))), [])


class _Tracer:
    def __init__(self, dump: Dump, found: AlloyInstance) -> None:
        self.dump = dump
        self.instance = found
        self.field = found.field

    # -- the parts, in the order of their priority -----------------------------------------------------

    def rules(self) -> Iterator[Finding]:
        for (clause,) in self.field("faults"):
            yield Finding("rule", None, "the declarations", "rule", str(clause))

    def start(self) -> Iterator[Finding]:
        where = "the configuration" if self.dump.steps is None else "at the start"
        if self.dump.steps is None:
            for each in self.dump.unencodable:
                yield Finding("attachment", None, where, "attachment", each.reason)
        if 0 in self.instance.numbers("invalid"):
            yield from self._configuration(0, where)

    def steps(self) -> Iterator[Finding]:
        number = first_failure(self.dump, self.instance)
        if number and self.dump.steps is not None:
            yield from self._step(number, self.dump.steps[number - 1])

    def end(self, best: SolverOutcome | None) -> Iterator[Finding]:
        if self.dump.steps is None:
            return
        where = "at the end"
        for each in self.dump.unencodable:
            if each.step is None:
                yield Finding("end", None, where, "target", each.reason.removeprefix("at the end "))
        for field, verb in (("missing", "should"), ("extra", "should not")):
            for connector, port in self.field(field):
                yield Finding("end", None, where, str(port), f"it {verb} be attached to {connector}")
        for field, verb in (("absent", "should"), ("left", "should not")):
            for (component,) in self.field(field):
                yield Finding("end", None, where, str(component), f"it {verb} be live")
        if best is not None and best.satisfiable:
            yield from self._better(best, where)

    # -- one step, one configuration ------------------------------------------------------------------------

    def _step(self, number: int, step: Step) -> Iterator[Finding]:
        where = f"step {number}, {step.describe()}"
        unencodable = [each for each in self.dump.unencodable if each.step == number]
        if unencodable:
            yield from (Finding("name", number, where, step.action.kind, each.reason) for each in unencodable)
            return
        if number in self.instance.numbers("refused"):
            yield from self._refused(number, step.action, where)
        elif number in self.instance.numbers("wrong"):
            yield Finding("effect", number, where, step.action.kind, "its effect is not that of the action")
        else:
            yield from self._configuration(number, f"after step {number}, {step.describe()}")

    def _refused(self, number: int, action: Action, where: str) -> Iterator[Finding]:
        before, after = self.dump.configurations[number - 1 : number + 1]
        for ref, assumption in self.field("lacking"):
            yield self._lacking(after, ref, assumption, number, where, "precondition")
        for connector, port in self.field("attached"):
            yield Finding("precondition", number, where, str(port), f"it is still attached to {connector}")
        because = "; ".join(str(reason) for reason in action.check(before)) or _DISAGREE
        broken = [str(clause) for (clause,) in self.field("broken")]
        if not (broken or self.field("lacking") or self.field("attached")):
            broken = ["its precondition does not hold"]
        for clause in broken:
            yield Finding("precondition", number, where, action.kind, f"{clause} ({because})")

    def _configuration(self, at: int, where: str) -> Iterator[Finding]:
        configuration, number = self.dump.configurations[at], at or None
        for ref, assumption in self.field("unsatisfied"):
            yield self._lacking(configuration, ref, assumption, number, where, "assumption")
        for (connector,) in self.field("crowded"):
            violation = cap_violation(configuration, str(connector))
            because = _DISAGREE if violation is None else violation.because
            yield Finding("cap", number, where, str(connector), because)
        for (group,) in self.field("overloaded"):
            together = ", ".join(str(name) for name in group) if isinstance(group, tuple) else str(group)
            yield Finding("capacity", number, where, together, "together they exceed a resource")
        if not any(self.field(field) for field in ("unsatisfied", "crowded", "overloaded")):
            because = "a mode or an attachment belongs to no live component"
            yield Finding("attachment", number, where, "structure", because)

    def _lacking(
        self,
        configuration: Configuration,
        ref: object,
        assumption: object,
        number: int | None,
        where: str,
        kind: ViolationKind,
    ) -> Finding:
        assert isinstance(ref, FunctionalityRef)
        model: Assumption = assumption  # type: ignore[assignment]
        functionality = configuration.functionality(ref)
        evaluator = Evaluator(configuration)
        agreed = not evaluator.assumption_satisfied(ref, functionality, model)
        because = evaluator.why_assumption_unsatisfied(ref, model) if agreed else f"assumes {model}: {_DISAGREE}"
        subject = f"{ref} in mode {configuration.mode(ref).name}"
        return Finding(kind, number, where, subject, because, str(model), chain(configuration, ref, model))

    def _better(self, best: SolverOutcome, where: str) -> Iterator[Finding]:
        raised = [entry for name, tuples in best.skolems.items() if name.endswith("_to") for entry in tuples]
        better = [self.instance.meaning(mode) for _, mode in raised]
        modes = [mode for mode in better if isinstance(mode, ModeName)]
        if not modes:
            yield Finding("end", None, where, "modes", "some functionality could be in a better mode")
        for mode in modes:
            together = " (together with the others)" if len(modes) > 1 else ""
            yield Finding("end", None, where, str(mode.functionality), f"it could be in mode {mode.mode}{together}")
