"""An independent replay of a plan: is it what it claims to be? (docs/semantics.md section 6)

No code of the planners is used, only the plan itself: the model's own actions check each step's precondition, the end
is compared with the configuration in which the target starts, and the costs are computed again, slowly and straight
from the definition. The lower bound is checked where the change is small enough (:mod:`tests.replay.bound_check`).
The result is data.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final, Literal

from midstride.model.action import Action, Create, Remove
from midstride.model.best import best
from midstride.model.component import FunctionalityRef, PortRef
from midstride.model.configuration import Configuration, Instance
from midstride.model.instance_names import is_named_after
from midstride.model.rules import violations
from midstride.model.specification import Keep, Limit, Order, Specification, initial
from midstride.plan.constraints import in_force
from midstride.plan.plan import Plan
from tests.replay.bound_check import BoundCheck, check_bound

_EPSILON: Final = 1e-6

_NOT_CHECKED: Final = BoundCheck("not checked", "the plan does not hold")

ModeLevels = dict[FunctionalityRef, int]


@dataclass(frozen=True, slots=True)
class ReplayFinding:
    """One problem of a plan; ``step`` counts from 1, None means the plan as a whole."""

    step: int | None
    because: str

    def __str__(self) -> str:
        return self.because if self.step is None else f"step {self.step}: {self.because}"


@dataclass(frozen=True, slots=True)
class ReplayResult:
    """The result of the replay of ``steps`` steps. ``bound`` says whether the lower bound was checked, and why not."""

    outcome: Literal["holds", "violated"]
    findings: tuple[ReplayFinding, ...]
    steps: int
    bound: BoundCheck = _NOT_CHECKED

    @property
    def holds(self) -> bool:
        return self.outcome == "holds"

    def __str__(self) -> str:
        if self.holds:
            bound = f"; its lower bound was not checked: {self.bound.because}" if self.bound.because else ""
            return f"the plan holds: {self.steps} steps replayed{bound}"
        return "the plan does not hold: " + "; ".join(str(finding) for finding in self.findings)


def replay(plan: Plan) -> ReplayResult:
    """The result for a plan. The replay stops at the first refused step, since what follows has no meaning."""
    configuration = plan.change.start
    findings = [ReplayFinding(None, f"the start is not valid: {each}") for each in violations(configuration)]
    ledger = Ledger(plan)
    for number, step in enumerate(plan.steps, start=1):
        reasons = [str(reason) for reason in step.action.check(configuration)] or list(
            _misfits(plan, configuration, step.action)
        )
        if reasons:
            findings += [ReplayFinding(number, f"{step.describe()}: {reason}") for reason in reasons]
            return ReplayResult("violated", tuple(findings), number)
        before, configuration = configuration, step.action.effect(configuration)
        ledger.enter(step.action, step.seconds, before, configuration)
    findings += [ReplayFinding(None, because) for because in _end(plan, configuration)]
    findings += [ReplayFinding(None, because) for because in ledger.differences()]
    if findings:
        return ReplayResult("violated", tuple(findings), len(plan.steps))
    bound = check_bound(plan, ledger)
    if bound.outcome == "violated":
        findings.append(ReplayFinding(None, f"its lower bound, {plan.lower_bound:g}, is too high: {bound.because}"))
    return ReplayResult("violated" if findings else "holds", tuple(findings), len(plan.steps), bound)


def _misfits(plan: Plan, configuration: Configuration, action: Action) -> Iterator[str]:
    """What is wrong with a new instance: its role, its declaration, its name."""
    if not isinstance(action, Create):
        return
    new, change = action.instance, plan.change
    if new.role not in change.target.nodes:
        yield f"the target has no node {new.role}"
        return
    wanted = change.target.instance(new.role)
    differs = new.component != wanted.component or new.parameters != wanted.parameters
    # A stand-in may be of any component that is declared; that it is gone at the end is checked there.
    declared = (change.specification.components, change.target.components)
    may_stand_in = plan.proof_space == "detours" and any(
        some.get(new.component.name) == new.component for some in declared
    )
    if differs and not may_stand_in:
        yield f"{new.name} differs from the declaration of {new.role} in the target"
    nodes = {*change.specification.nodes, *change.target.nodes}
    if new.name == new.role:
        if configuration.instances_of(new.role):
            yield f"{new.name} has the name of its role, but is not its first instance"
    elif not is_named_after(new.name, new.role) or new.name in nodes:
        yield f"{new.name} is not a valid name for an instance of {new.role}"


# -- the end ---------------------------------------------------------------------------------------------


def _end(plan: Plan, configuration: Configuration) -> Iterator[str]:
    """The differences between the configuration reached and the one in which the target starts."""
    target = initial(plan.change.target)
    for role in sorted({*configuration.instances_by_role, *target.instances_by_role}):
        names = [instance.name for instance in configuration.instances_of(role)]
        if role not in target.instances_by_role:
            yield f"{', '.join(names)} still runs at the end, but the target has no node {role}"
        elif len(names) != 1:
            yield f"{role} has {len(names)} instances at the end ({', '.join(names) or 'none'})"
        else:
            yield from _role_end(configuration, configuration.instances[names[0]], target, target.instances[role])


def _role_end(
    configuration: Configuration, instance: Instance, target: Configuration, wanted: Instance
) -> Iterator[str]:
    if not instance.component.same_body(wanted.component):
        yield f"{instance.name} is a {instance.component.name} at the end, not a {wanted.component.name}"
        return
    if instance.parameters != wanted.parameters:
        yield f"the parameters of {instance.name} at the end differ from the target"
    for port in wanted.component.ports():
        attached = [
            configuration.context.connectors[name] for name in configuration.attached_to(PortRef(instance.name, port))
        ]
        have = sorted({connector.topic for connector in attached})
        want = target.attached_to(PortRef(wanted.name, port))
        if have != want:
            actual, expected = ", ".join(have) or "nothing", ", ".join(want) or "nothing"
            yield f"{instance.name}.{port} is attached to {actual} at the end, not to {expected}"
        for connector in attached:
            topic = connector.topic
            if topic in want and connector.guarantee != target.context.connectors[topic].guarantee:
                yield f"{instance.name}.{port} is still attached to {topic} with its old contract at the end"
    for functionality in wanted.component:
        now = configuration.modes[FunctionalityRef(instance.name, functionality.name)]
        then = target.modes[FunctionalityRef(wanted.name, functionality.name)]
        if now != then:
            names = functionality.modes[now].name, functionality.modes[then].name
            yield f"{instance.name}.{functionality.name} is in mode {names[0]} at the end, but could be in {names[1]}"


# -- the costs -------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _Counted:
    """A functionality that a role has in both, the outputs without which it is not served, and its worst level."""

    ref: FunctionalityRef
    needed: tuple[str, ...]
    worst: int


def _counted(start: Specification, target: Specification) -> Iterator[_Counted]:
    for role in sorted(set(start.nodes) & set(target.nodes)):
        old, new = start.component_of(role), target.component_of(role)
        before, after = start.nodes[role].attachments, target.nodes[role].attachments
        for name in sorted(set(old.functionalities) & set(new.functionalities)):
            was, will = old.functionalities[name], new.functionalities[name]
            outputs = sorted(set(was.outputs) & set(will.outputs))
            needed = tuple(output for output in outputs if before.get(output) and after.get(output))
            yield _Counted(FunctionalityRef(role, name), needed, max(len(was.modes), len(will.modes)))


class Ledger:
    """The costs of a plan, entered step by step."""

    def __init__(self, plan: Plan) -> None:
        self.plan = plan
        self.target = plan.change.target
        self.counted = tuple(_counted(plan.change.specification, self.target))
        at_start, at_end = self._now(best(plan.change.origin)), self._now(initial(self.target))
        self.baseline = {ref: max(level, at_end[ref]) for ref, level in at_start.items()}
        self.levels = self._now(plan.change.start)
        self.fallen = {ref for ref in self.levels if self._below(ref, self.levels)}
        self.disruption = self.seconds = 0.0
        self.spent: dict[FunctionalityRef, float] = dict.fromkeys(self.levels, 0.0)
        self.keeps: dict[Keep, int] = {}
        for constraint in in_force(plan.change):
            if isinstance(constraint, Keep) and (ref := constraint.functionality) in self.levels:
                chain = self.target.component_of(ref.instance).functionalities[ref.functionality]
                self.keeps[constraint] = max(chain.mode_index(constraint.mode), self.levels[ref])
        self.never: list[FunctionalityRef] = []
        self.limits: dict[FunctionalityRef, float] = {}
        for constraint in in_force(plan.change):
            if isinstance(constraint, Limit) and (ref := constraint.functionality) in self.levels:
                if constraint.seconds:
                    self.limits[ref] = min(constraint.seconds, self.limits.get(ref, constraint.seconds))
                else:
                    self.never.append(ref)
        self.roles: list[set[str]] = []
        self.broken: dict[str, None] = {}

    def _now(self, configuration: Configuration) -> ModeLevels:
        """The level of every functionality that both ends have, literally as section 6 defines it."""
        found: ModeLevels = {}
        for counted in self.counted:
            role, name = counted.ref
            served = [
                configuration.modes[FunctionalityRef(instance.name, name)]
                for instance in configuration.instances_of(role)
                if name in instance.component.functionalities
                and all(configuration.attached_to(PortRef(instance.name, output)) for output in counted.needed)
            ]
            found[counted.ref] = min([counted.worst, *served])
        return found

    def _below(self, ref: FunctionalityRef, levels: ModeLevels) -> int:
        return max(0, levels[ref] - self.baseline[ref])

    def _weight(self, ref: FunctionalityRef) -> float:
        return self.target.component_of(ref.instance).functionalities[ref.functionality].weight

    def loss(self, configuration: Configuration) -> float:
        """The weighted sum of the levels below the baseline."""
        levels = self._now(configuration)
        return sum(self._below(ref, levels) * self._weight(ref) for ref in levels)

    def is_allowed(self, configuration: Configuration) -> bool:
        """Whether no ``keep`` and no ``limit`` of 0 s forbids it."""
        levels = self._now(configuration)
        return all(levels[keep.functionality] <= threshold for keep, threshold in self.keeps.items()) and not any(
            self._below(ref, levels) for ref in self.never
        )

    def limited(self, configuration: Configuration) -> frozenset[FunctionalityRef]:
        """Those of ``limits`` that are below their baselines."""
        levels = self._now(configuration)
        return frozenset(ref for ref in self.limits if self._below(ref, levels))

    def enter(self, action: Action, seconds: float, start: Configuration, after: Configuration) -> None:
        before, self.levels = self.levels, self._now(after)
        self.seconds += seconds
        for ref in self.levels:
            loss = max(self._below(ref, before), self._below(ref, self.levels))
            if loss:
                self.spent[ref] += seconds
                if isinstance(action, (Create, Remove)):
                    self.disruption += loss * self._weight(ref) * seconds
            if self._below(ref, self.levels):
                self.fallen.add(ref)
        for keep, threshold in self.keeps.items():
            if self.levels[keep.functionality] > threshold:
                self.broken[f"`{keep}` does not hold after `{action.describe(start)}`"] = None
        named = action.instances() if action.is_structural else ()
        self.roles.append({(start.instances.get(name) or after.instances[name]).role for name in named})

    def differences(self) -> Iterator[str]:
        """The differences between what the plan claims and what the replay found."""
        plan = self.plan
        if abs(plan.disruption - self.disruption) > _EPSILON:
            yield f"its disruption is {self.disruption:g}, not {plan.disruption:g} as it claims"
        if abs(plan.seconds - self.seconds) > _EPSILON:
            yield f"its steps take {self.seconds:g} s, not {plan.seconds:g} s as it claims"
        if set(plan.degraded) != self.fallen:
            found, claimed = (", ".join(map(str, sorted(refs))) or "nothing" for refs in (self.fallen, plan.degraded))
            yield f"it takes {found} below the baseline, not {claimed} as it claims"
        if plan.proved_minimal and plan.disruption - plan.lower_bound > _EPSILON:
            yield f"it is not proved minimal: its disruption is above the lower bound, {plan.lower_bound:g}"
        if plan.lower_bound - plan.disruption > _EPSILON:
            yield f"its lower bound, {plan.lower_bound:g}, is above its disruption"
        if plan.makespan - plan.seconds > _EPSILON:
            yield f"its makespan, {plan.makespan:g} s, is longer than its steps one after another"
        yield from self.broken
        for constraint in in_force(plan.change):
            if isinstance(constraint, Limit):
                spent = self.spent.get(constraint.functionality, 0.0)
                if spent > constraint.seconds + _EPSILON:
                    yield f"`{constraint}` is exceeded: {spent:g} s"
            elif isinstance(constraint, Order):
                last = [index for index, roles in enumerate(self.roles) if constraint.first in roles]
                first = [index for index, roles in enumerate(self.roles) if constraint.then in roles]
                both = constraint.first != constraint.then and set(last) & set(first)
                if last and first and (last[-1] > first[0] or both):
                    yield f"`{constraint}` is broken by step {last[-1] + 1}"
