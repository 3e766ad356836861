"""The words for what a change does to the processes of containers that several nodes share."""

from __future__ import annotations

from collections.abc import Iterator

from midstride.model.configuration import Instance
from midstride.plan.change import Change
from midstride.verdicts.assessment import seconds_in_words


def in_words(change: Change) -> Iterator[str]:
    """Yield who leaves a process that goes on, who gets one for itself, and who moves together."""
    moved: dict[str, list[str]] = {}
    old = {new: before for before, new in change.replaced.items()}
    for instance in change.coming:
        if instance.container is None:
            continue
        container = instance.container.name
        if instance.name not in old:
            if not instance.process:
                yield (
                    f"{instance.name} starts in a process for itself: the one before it had left {container}, or that "
                    f"had exited or hung while loading it; `midstride restart {container}` brings all together again"
                )
        elif instance.process:
            moved.setdefault(instance.process, []).append(instance.role)
        else:
            yield (
                f"{instance.name} has a process for itself, beside {container}, so that it runs what its library has "
                f"now, and no other node ends with it; `midstride restart {container}` brings all together again"
            )
    for process, roles in sorted(moved.items()):
        yield f"{', '.join(sorted(roles))}: loaded into a new process, {process}"
    for name in change.leaving:
        instance = change.instance(name)
        if others := _staying(change, instance):
            yield (
                f"{name} is unloaded from {instance.process}: its destructor runs there, and may hold up "
                f"{', '.join(others)} for as long as it takes ({_known(change, instance)}); if it does not return, it "
                "ends only with all of them"
            )


def _known(change: Change, instance: Instance) -> str:
    """Say how long instances of this component took to end, as far as that has been measured."""
    component = instance.component.name
    if (measured := change.measured.get(f"remove {component}")) is None:
        return f"not measured yet for {component}"
    return f"measured: {component} ended within {seconds_in_words(measured.longest)}"


def _staying(change: Change, instance: Instance) -> list[str]:
    """The other instances of its process that the change leaves there."""
    if not instance.process:
        return []
    others = (each for each in change.start.instances.values() if each.process == instance.process)
    return sorted(each.name for each in others if each.name not in change.leaving)
