"""Configurations and plans as Alloy text (pure text: nothing is run here), and what the atoms in it stand for.

A dump is exact: every atom and every tuple is given, so the verdict on it is a verdict on that configuration
or plan, not on a scope. It carries the specification along, so that it can be opened by itself.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, replace

from midstride.model.action import Create, SetParameters
from midstride.model.best import best
from midstride.model.configuration import Configuration, Instance, configure
from midstride.plan.plan import Plan
from midstride.plan.step import Step
from midstride.verify.alloy_atoms import AlloyAtoms
from midstride.verify.alloy_text import Judged, JudgedStep, StepName, configuration_detail, step_detail, written
from midstride.verify.formulas import NotInTheDump, formula
from midstride.verify.world_encoder import WorldEncoder


@dataclass(frozen=True, slots=True)
class Stray:
    """What cannot be dumped, because the specification has no such thing. ``step`` is None for the start."""

    step: int | None
    told: str


@dataclass(frozen=True, slots=True)
class Dump:
    """Alloy text, what its atoms stand for, and the configurations it dumps.

    ``fields`` are those of the answer's Findings, ``checks`` what must hold where these are all empty. ``detail`` is
    the step (0: the start) of which the dump says why it fails; ``steps`` is None where it is of no plan.
    """

    subject: str
    text: str
    bearers: dict[str, object]
    configurations: tuple[Configuration, ...]
    fields: frozenset[str]
    checks: tuple[str, ...]
    steps: tuple[Step, ...] | None = None
    strays: tuple[Stray, ...] = ()
    atoms: int = 0
    detail: int | None = None

    @property
    def scope(self) -> str:
        count = len(self.configurations)
        return f"exact: {count} configuration{'s' if count != 1 else ''}, {self.atoms} atoms"


def dump_configuration(configuration: Configuration, name: str, told: str = "the configuration") -> Dump:
    """One configuration, to be judged by the specification's validity. Raises TooLarge."""
    universe = AlloyAtoms()
    scene = WorldEncoder(universe, configuration.context)
    for instance in _sorted(configuration):
        scene.instance(instance)
    bare, strays = _attached(configuration)
    scene.overloads()
    system = scene.system(bare, 0, told)
    judged = Judged(detail=configuration_detail(system))
    return Dump(
        subject=told,
        text=written(universe, f"{name}: {told}", judged),
        bearers=universe.names.bearers,
        configurations=(configuration,),
        fields=frozenset(judged.fields),
        checks=judged.checks,
        strays=strays,
        atoms=universe.size,
        detail=0,
    )


def dump_plan(plan: Plan, name: str, detail: int | None = None) -> Dump:
    """Every step of a plan: precondition, effect, validity; and whether it arrives at ``best`` of its target.

    The configurations on the way are the model's, as far as the steps can be taken at all; whether the preconditions
    hold and the effects are right is Alloy's to say. With ``detail``, that step alone (0: the start), and why it
    fails. Raises TooLarge.
    """
    universe = AlloyAtoms()
    scene = WorldEncoder(universe, plan.change.start.context)
    way = _Way(scene, plan)
    goal, strays = _goal(plan, way.configurations[-1])
    if goal is not None:
        for instance in _sorted(goal):
            scene.instance(instance)
    scene.overloads()
    asked = range(len(plan.steps) + 1) if detail is None else range(max(0, detail - 1), detail + 1)
    systems: dict[int, str] = {}
    for number in asked:
        each = way.configurations[number]
        same = number - 1 in systems and each is way.configurations[number - 1]
        told = f"after step {number}" if number else "at the start"
        systems[number] = systems[number - 1] if same else scene.system(each, number, told)
    steps = []
    for number, step in enumerate(plan.steps, start=1):
        if number in asked and number - 1 in asked and number not in way.impossible:
            named = StepName(number, step.describe())
            given = formula(scene, step.action, systems[number - 1], systems[number])
            steps.append(JudgedStep(universe.names.give(f"step{number}", named), given, named))
    judged = Judged(steps)
    if detail is not None:
        judged.detail = configuration_detail(systems[detail])
        judged.detail |= step_detail(universe, steps[0].formula) if steps else {}
    elif goal is not None:
        judged.end = (systems[len(plan.steps)], scene.system(goal, len(plan.steps) + 1, "at the target"))
    text = written(universe, f"{name}: a plan of {len(plan.steps)} steps, by strategy {plan.strategy}", judged)
    return Dump(
        subject=f"the plan of {len(plan.steps)} steps",
        text=text,
        bearers=universe.names.bearers,
        configurations=way.configurations,
        fields=frozenset(judged.fields),
        checks=judged.checks,
        steps=plan.steps,
        strays=(*way.strays, *strays),
        atoms=universe.size + len(steps),
        detail=detail,
    )


def _sorted(configuration: Configuration) -> list[Instance]:
    return sorted(configuration.instances.values(), key=lambda instance: instance.name)


class _Way:
    """The configurations on the way of a plan, and the steps that speak of what there is not."""

    def __init__(self, scene: WorldEncoder, plan: Plan) -> None:
        self.strays: list[Stray] = []
        self.impossible: set[int] = set()
        configuration = plan.change.start
        for instance in _sorted(configuration):
            scene.instance(instance)
        taken = [configuration]
        for number, step in enumerate(plan.steps, start=1):
            action = step.action
            try:
                if isinstance(action, Create):
                    scene.instance(action.instance)
                formula(scene, action, "s", "t")
            except (NotInTheDump, ValueError) as error:
                self.strays.append(Stray(number, str(error)))
                self.impossible.add(number)
            else:
                if isinstance(action, SetParameters):  # parameters have no part in the specification
                    self.strays += [Stray(number, str(reason)) for reason in action.check(configuration)]
                self.strays += [Stray(number, told) for told in _told_otherwise(configuration, step)]
                # Where it cannot even be carried out, that its precondition fails is for Alloy to say.
                with suppress(KeyError):
                    configuration = action.effect(configuration)
            taken.append(configuration)
        self.configurations = tuple(taken)


def _told_otherwise(configuration: Configuration, step: Step) -> Iterator[str]:
    """Where a step says that a functionality leaves another mode than the one it is in."""
    for change in step.modes:
        if (
            change.functionality in configuration.modes
            and configuration.mode(change.functionality).name != change.before
        ):
            now = configuration.mode(change.functionality).name
            yield f"it says that {change.functionality} is in mode {change.before}, and there it is in mode {now}"


def _attached(configuration: Configuration) -> tuple[Configuration, tuple[Stray, ...]]:
    """``configuration`` without the attachments that cannot be dumped, since they are none of this system."""
    strays = []
    for port, connector in sorted(configuration.attachments()):
        if connector not in configuration.context.connectors or not configuration.has_port(port):
            missing = connector if configuration.has_port(port) else port
            strays.append(Stray(None, f"{port} is attached to {connector}, and there is no {missing} in this system"))
            configuration = configuration.without_attachment(port, connector)
    return configuration, tuple(strays)


def _goal(plan: Plan, end: Configuration) -> tuple[Configuration | None, list[Stray]]:
    """The structure of the target, its instances called what they are called at the end of the plan.

    Parameters are compared here: they have no part in the specification.
    """
    change, target = plan.change, plan.change.target
    instances, attachments, strays = [], [], []
    for role in target.nodes:
        wanted = target.instance(role)
        there = end.instances_of(role)
        if len(there) == 1 and there[0].component.same_body(wanted.component):
            wanted = replace(wanted, name=there[0].name, component=there[0].component)
            if there[0].parameters != wanted.parameters:
                strays.append(Stray(None, f"at the end {wanted.name} has other parameters than the target says"))
        else:
            names = ", ".join(instance.name for instance in there)
            told = f"{names} is there" if names else "nothing is there"
            strays.append(Stray(None, f"at the end {role} should be one {wanted.component.name}, and {told}"))
        instances.append(wanted)
        for port, connector in target.attachments_of(role, wanted.name):
            attachments.append((port, change.identities.get(connector, connector)))
    if strays:
        return None, strays
    return best(configure(change.start.context, instances, attachments)), strays
