"""Memory for both processes of a container while its nodes move from the one to the other."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping

from midstride.errors import PlanRefused
from midstride.model.action import Create, Remove
from midstride.plan.plan import Plan
from midstride.runtime.process.memory import SHARED, Memory, free_memory, memory_of


def room_for_copies(
    plan: Plan,
    pids: Mapping[str, int],
    memory: Callable[[int], Memory | None] = memory_of,
    free: Callable[[], Memory | None] = free_memory,
) -> Iterator[str]:
    """Yield how much memory ``plan`` needs besides, where a new process of a container runs beside the old one.

    ``pids``: the process of each instance that runs. The new process counts with what the old ones have now. Raises
    PlanRefused where there is less. For shared memory nothing is refused: a process has pages of its peers there as
    well, of which a new one needs no second copy.
    """
    needed = Memory(0, 0)
    names: list[str] = []
    for process, old in sorted(_copied(plan).items()):
        found = [memory(pid) for pid in sorted({pids[name] for name in old if name in pids})]
        known = [each for each in found if each is not None]
        if len(known) < len(found) or not known:
            yield f"how much memory {process} needs while the old process runs as well is not known"
            continue
        names.append(process)
        for each in known:
            needed = needed.plus(each)
    if not names:
        return
    left = free()
    what = f"{' and '.join(names)}, beside {'its' if len(names) == 1 else 'their'} predecessor, "
    if left is None:
        yield f"{what}needs about {_size(needed.own)} of memory; how much is left is not known"
        return
    if needed.own > left.own:
        raise PlanRefused(
            f"{what}needs about {_size(needed.own)} of memory, as much as the old process has, and {_size(left.own)} "
            f"are left; {_ways_out(plan)}"
        )
    yield f"{what}needs about {_size(needed.own)} of memory, and {_size(left.own)} are left"
    if needed.shared > left.shared:
        yield (
            f"{what}may need up to {_size(needed.shared)} of shared memory ({SHARED}), of which {_size(left.shared)} "
            "are left; how much of that others have made is not known"
        )


def _ways_out(plan: Plan) -> str:
    """The ways in which the nodes of a plan get new code with less memory."""
    roles = sorted({plan.change.role_of(name) for names in _copied(plan).values() for name in names})
    stop = "use `--strategy stop`, which ends the old process first and pauses what is in it"
    if len(roles) < 2:
        return f"end something, or {stop}"
    alone = f"restart its nodes one at a time (`midstride restart {roles[0]}`, then the others)"
    return f"end something, {alone}, each in a process for itself, or {stop}"


def _copied(plan: Plan) -> dict[str, list[str]]:
    """By new process of a container, the instances that its nodes replace and that still run when it starts."""
    before = {instance.process for instance in plan.change.start.instances.values()}
    removed, found = set[str](), dict[str, list[str]]()
    old = {new: name for name, new in plan.change.replaced.items()}
    for step in plan.steps:
        match step.action:
            case Remove(name):
                removed.add(name)
            case Create(instance) if instance.process and instance.process not in before:
                found.setdefault(instance.process, [])
                replaced = old.get(instance.name)
                if replaced is not None and replaced not in removed:
                    found[instance.process].append(replaced)
    return {process: names for process, names in found.items() if names}


def _size(amount: int) -> str:
    return f"{amount / 2**30:.1f} GiB" if amount >= 2**30 else f"{amount / 2**20:.0f} MiB"
