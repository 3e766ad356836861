"""The nodes that end with a process that a change ends, although it names only one of that process's nodes.

As a container does with the components that others have loaded into it. Such a change is refused unless they are meant
too, and then its plan and its report say what becomes of each of them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from midstride.model.action import Create, Remove
from midstride.model.configuration import Configuration
from midstride.plan.plan import Plan
from midstride.runtime.backend_protocol import NAMES_ALL, OtherNode, OtherNodes
from midstride.runtime.change.running_change import RunningChange
from midstride.verdicts import change_facts
from midstride.verdicts.assessment import Assessment

# How to say on the command line, and in a request of the API, that they are meant too.
OPTION = "--with-other-nodes"
FIELD = "with_other_nodes"


def ending_nodes(plan: Plan, others: Mapping[str, OtherNodes]) -> dict[str, OtherNodes]:
    """The other nodes of each instance that ``plan`` ends, of those that have any; ``others``: of all that run."""
    ended = (step.action.instance for step in plan.steps if isinstance(step.action, Remove))
    return {name: others[name] for name in ended if name in others}


def would_end_others(ending: Mapping[str, OtherNodes]) -> str | None:
    """The reason why a plan that ends these is refused, unless they are meant too; None where it ends no other node."""
    found = [f"{', '.join(each.names)} with {name}" for name, each in sorted(ending.items()) if each.nodes]
    if not found:
        return None
    many = sum(len(each.nodes) for each in ending.values()) > 1
    namesakes = any(node.namesake for each in ending.values() for node in each.nodes)
    return (
        f"the change would also end {'other nodes' if many else 'another node'} of the same process: "
        f"{'; '.join(found)}. If {'they are' if many else 'it is'} meant too, pass `{OPTION}` "
        f'(`"{FIELD}": true` in a request)'
    ) + (f". {NAMES_ALL}" if namesakes else "")


def nodes_that_will_end(plan: Plan, ending: Mapping[str, OtherNodes]) -> Iterator[Assessment]:
    """Assess the end of other nodes, in the processes that ``plan`` is expected to end."""
    for name, others in sorted(ending.items()):
        successor = plan.change.replaced.get(name)
        for node in others.nodes:
            yield change_facts.will_end_with(node.name, node.words, name, replaced=successor is not None)
        if others.unknown is not None:
            yield change_facts.unknown_others(name, others.unknown)


def nodes_that_ended(
    change: RunningChange, ended: Mapping[str, OtherNodes], now: Configuration, others: Mapping[str, OtherNodes]
) -> Iterator[Assessment]:
    """Assess what has become of the nodes that have ``ended`` with an instance while ``change`` was carried out.

    Also with one that it had started itself, and ended in its roll-back. ``others``: the other nodes of all that run.
    """
    created = {action.instance.name: action.instance for action in change.actions if isinstance(action, Create)}
    for name, gone in sorted(ended.items()):
        instance = change.before.instances.get(name) or created.get(name)
        runs = [] if instance is None else [each.name for each in now.instances_of(instance.role)]
        back = [(node, each) for each in runs if each in others for node in others[each].nodes]
        for node in gone.nodes:
            found = next((pair for pair in back if _is_same(node, pair[0])), None)
            if found is not None:
                back.remove(found)
            yield change_facts.ended_with(
                node.name,
                node.words,
                name,
                again=None if found is None else found[1],
                planned=change.outcome == "done" or name in created,
            )
        if gone.unknown is not None:
            yield change_facts.unknown_others(name, gone.unknown)


def _is_same(node: OtherNode, other: OtherNode) -> bool:
    """Return whether ``other`` is the node that the new instance has in the place of ``node``."""
    return other.namesake if node.namesake else node.name == other.name
