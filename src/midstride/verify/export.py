"""Configurations and plans as Alloy text, with the meaning of its atoms. Nothing is run here.

A dump is exact: it lists every atom and every tuple, so the verdict is about that configuration or plan, not about a
scope. It includes the specification, so that Alloy can open it without other files.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace

from midstride.model.action import Create, SetParameters
from midstride.model.best import best
from midstride.model.configuration import Configuration, configure
from midstride.plan.plan import Plan
from midstride.plan.step import Step
from midstride.verify.alloy_atoms import AlloyAtoms
from midstride.verify.alloy_text import Obligations, StepName, StepObligation, configuration_detail, render, step_detail
from midstride.verify.formulas import formula
from midstride.verify.world_encoder import NotEncoded, WorldEncoder


@dataclass(frozen=True, slots=True)
class Unencodable:
    """Something that has no encoding because it does not exist. ``step`` is None for the start and the end."""

    step: int | None
    reason: str


@dataclass(frozen=True, slots=True)
class Dump:
    """Alloy text, the meaning of its atoms, and the configurations that it encodes.

    ``detail`` is the step (0: the start) whose failure the dump explains; ``steps`` is None where the dump is not of a
    plan.
    """

    subject: str
    text: str
    meanings: dict[str, object]
    configurations: tuple[Configuration, ...]
    obligations: Obligations
    steps: tuple[Step, ...] | None = None
    unencodable: tuple[Unencodable, ...] = ()
    atoms: int = 0
    detail: int | None = None

    @property
    def scope(self) -> str:
        count = len(self.configurations)
        return f"exact: {count} configuration{'s' if count != 1 else ''}, {self.atoms} atoms"


def dump_configuration(configuration: Configuration, name: str, subject: str = "the configuration") -> Dump:
    """One configuration, to be checked for validity. Raises TooLarge."""
    atoms = AlloyAtoms()
    encoder = WorldEncoder(atoms, configuration.context)
    encoder.instances(configuration)
    encodable, unencodable = _encodable(configuration)
    encoder.overloads()
    system = encoder.system(encodable, 0, subject)
    obligations = Obligations(detail=configuration_detail(system))
    return Dump(
        subject=subject,
        text=render(atoms, f"{name}: {subject}", obligations),
        meanings=atoms.names.meanings,
        configurations=(configuration,),
        obligations=obligations,
        unencodable=unencodable,
        atoms=atoms.size,
        detail=0,
    )


def dump_plan(plan: Plan, name: str, detail: int | None = None) -> Dump:
    """Every step of a plan (precondition, effect, validity), and whether the plan ends in ``best`` of its target.

    The model computes the intermediate configurations, as far as the steps can be applied; Alloy decides whether
    preconditions hold and effects are right. With ``detail``, that step alone (0: the start), and why it fails. Raises
    TooLarge.
    """
    atoms = AlloyAtoms()
    encoder = WorldEncoder(atoms, plan.change.start.context)
    walk = _PlanWalk(encoder, plan)
    target, unencodable = _target(plan, walk.configurations[-1])
    if target is not None:
        encoder.instances(target)
    encoder.overloads()
    encoded = range(len(plan.steps) + 1) if detail is None else range(max(0, detail - 1), detail + 1)
    systems: dict[int, str] = {}
    for number in encoded:
        configuration = walk.configurations[number]
        same = number - 1 in systems and configuration is walk.configurations[number - 1]
        when = f"after step {number}" if number else "at the start"
        systems[number] = systems[number - 1] if same else encoder.system(configuration, number, when)
    steps = []
    for number, step in enumerate(plan.steps, start=1):
        if number in encoded and number - 1 in encoded and number not in walk.impossible:
            step_name = StepName(number, step.describe())
            step_formula = formula(encoder, step.action, systems[number - 1], systems[number])
            steps.append(StepObligation(atoms.names.assign(f"step{number}", step_name), step_formula, step_name))
    obligations = Obligations(steps)
    if detail is not None:
        obligations.detail = configuration_detail(systems[detail])
        obligations.detail |= step_detail(atoms, steps[0].formula) if steps else {}
    elif target is not None:
        obligations.end = (systems[len(plan.steps)], encoder.system(target, len(plan.steps) + 1, "at the target"))
    text = render(atoms, f"{name}: a plan of {len(plan.steps)} steps, by strategy {plan.strategy}", obligations)
    return Dump(
        subject=f"the plan of {len(plan.steps)} steps",
        text=text,
        meanings=atoms.names.meanings,
        configurations=walk.configurations,
        obligations=obligations,
        steps=plan.steps,
        unencodable=(*walk.unencodable, *unencodable),
        atoms=atoms.size + len(steps),
        detail=detail,
    )


class _PlanWalk:
    """The configurations that a plan passes through, and the steps that refer to something that does not exist."""

    def __init__(self, encoder: WorldEncoder, plan: Plan) -> None:
        self.unencodable: list[Unencodable] = []
        self.impossible: set[int] = set()
        configuration = plan.change.start
        encoder.instances(configuration)
        configurations = [configuration]
        for number, step in enumerate(plan.steps, start=1):
            action = step.action
            try:
                if isinstance(action, Create):
                    encoder.instance(action.instance)
                formula(encoder, action, "s", "t")
            except (NotEncoded, ValueError) as error:
                self.unencodable.append(Unencodable(number, str(error)))
                self.impossible.add(number)
            else:
                if isinstance(action, SetParameters):  # the specification has no parameters
                    self.unencodable += [Unencodable(number, str(reason)) for reason in action.check(configuration)]
                for change in step.modes:
                    ref = change.functionality
                    if ref in configuration.modes and (now := configuration.mode(ref).name) != change.before:
                        because = f"it assumes that {ref} is in mode {change.before}, but it is in mode {now}"
                        self.unencodable.append(Unencodable(number, because))
                # If it cannot be applied, its precondition fails, and Alloy reports that.
                with suppress(KeyError):
                    configuration = action.effect(configuration)
            configurations.append(configuration)
        self.configurations = tuple(configurations)


def _encodable(configuration: Configuration) -> tuple[Configuration, tuple[Unencodable, ...]]:
    """``configuration`` without the attachments whose port or topic does not exist."""
    unencodable = []
    for port, connector in sorted(configuration.attachments()):
        if connector not in configuration.context.connectors or not configuration.has_port(port):
            missing = connector if configuration.has_port(port) else port
            unencodable.append(
                Unencodable(None, f"{port} is attached to {connector}, but there is no {missing} in this system")
            )
            configuration = configuration.without_attachment(port, connector)
    return configuration, tuple(unencodable)


def _target(plan: Plan, end: Configuration) -> tuple[Configuration | None, list[Unencodable]]:
    """The target configuration, with the instance names that the plan ends with.

    Parameters are compared here, since the specification has none.
    """
    change, target = plan.change, plan.change.target
    instances, attachments, unencodable = [], [], []
    for role in target.nodes:
        expected = target.instance(role)
        found = end.instances_of(role)
        if len(found) == 1 and found[0].component.same_body(expected.component):
            expected = replace(expected, name=found[0].name, component=found[0].component)
            if found[0].parameters != expected.parameters:
                unencodable.append(
                    Unencodable(None, f"at the end {expected.name} has parameters that differ from the target's")
                )
        else:
            names = ", ".join(instance.name for instance in found)
            actual = f"there is {names}" if names else "there is none"
            unencodable.append(
                Unencodable(None, f"at the end {role} should be one {expected.component.name}, but {actual}")
            )
        instances.append(expected)
        for port, connector in target.attachments_of(role, expected.name):
            attachments.append((port, change.identities.get(connector, connector)))
    if unencodable:
        return None, unencodable
    return best(configure(change.start.context, instances, attachments)), unencodable
