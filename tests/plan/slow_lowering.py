"""The slow, obvious twin of :mod:`midstride.plan.lowering`: whole configurations, all levels figured out each time."""

from __future__ import annotations

from midstride.model.action import Action
from midstride.model.configuration import Configuration
from midstride.plan.plan import Plan


def level(configuration: Configuration, start: Configuration, plan: Plan, role: str, functionality: str) -> int:
    """The best mode in which an instance of ``role`` serves ``functionality``; the number of its modes if none does."""
    specification = plan.change.specification
    declared = specification.component_of(role).functionalities[functionality]
    wanted = {name for name in declared.outputs if specification.nodes[role].attachments.get(name)}
    found = [len(declared.modes)]
    for instance in configuration.instances.values():
        attached = {port.port for port, _ in configuration.attached_ports(instance.name)}
        modes = {ref.functionality: mode for ref, mode in configuration.modes.items() if ref.instance == instance.name}
        if instance.role == role and wanted <= attached and functionality in modes:
            found.append(modes[functionality])
    return min(found)


def below(configuration: Configuration, plan: Plan) -> float:
    """The levels that everything which is specified is below the start, by weight."""
    start, total = plan.change.start, 0.0
    for role in plan.change.specification.nodes:
        for each in plan.change.specification.component_of(role):
            now, then = (level(found, start, plan, role, each.name) for found in (configuration, start))
            total += each.weight * max(0, now - then)
    return total


def lowered(configuration: Configuration, actions: list[tuple[Action, float]], plan: Plan) -> tuple[float, float]:
    """What is below the start after ``actions``, and on the way (times s)."""
    spent = 0.0
    for action, seconds in actions:
        after = action.effect(configuration)
        spent += max(below(configuration, plan), below(after, plan)) * seconds
        configuration = after
    return round(below(configuration, plan), 6), round(spent, 6)


def choices(plan: Plan, done: int) -> tuple[tuple[float, float], tuple[float, float]]:
    """What is lowered where ``done`` steps are done: by finishing, and by rolling back."""
    reached = [plan.change.start]
    for step in plan.steps:
        reached.append(step.action.effect(reached[-1]))
    finish = [(step.action, step.seconds) for step in plan.steps[done:]]
    undo = [
        (action, plan.change.estimate_of(action).seconds)
        for number in reversed(range(done))
        for action in plan.steps[number].action.undo(reached[number])
    ]
    return lowered(reached[done], finish, plan), lowered(reached[done], undo, plan)


def is_better_finished(plan: Plan, done: int) -> bool:
    """Whether to finish lowers less."""
    finishing, rolling_back = choices(plan, done)
    return finishing < rolling_back
