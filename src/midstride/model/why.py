"""Why a functionality is not in a better mode: the chain of reasons, from it to what falls short.

A configuration in its best modes is taken; in any other one the answer says what is unsatisfied now.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator

from midstride.model.component import Assumption, Functionality, FunctionalityRef, NamedInputs, PortRef
from midstride.model.configuration import Configuration
from midstride.model.contract import satisfies
from midstride.model.rules import Judge


def reasons_against(s: Configuration, ref: FunctionalityRef, mode: int = 0) -> tuple[str, ...]:
    """Why ``ref`` cannot be in its mode number ``mode``, then why those cannot help that could; () if it can.

    Each functionality on the way is told once, so a cycle ends.
    """
    judge = Judge(s)
    told: list[str] = []
    seen = {ref}
    waiting = deque([(ref, mode)])
    while waiting:
        current, index = waiting.popleft()
        functionality = s.functionality(current)
        for assumption in functionality.modes[index].assumptions:
            if judge.assumption_satisfied(current, functionality, assumption):
                continue
            because = judge.why_assumption_unsatisfied(current, assumption)
            told.append(f"{current} cannot be in mode {functionality.modes[index].name}: it {because}")
            for other in _helpers(judge, current, functionality, assumption):
                if other[0] not in seen:
                    seen.add(other[0])
                    waiting.append(other)
    return tuple(told)


def _helpers(
    judge: Judge, ref: FunctionalityRef, functionality: Functionality, assumption: Assumption
) -> Iterator[tuple[FunctionalityRef, int]]:
    """The functionalities that would satisfy the assumption if they were in a better mode, and that mode."""
    s, inputs = judge.s, judge.s.component(ref.component).inputs
    if isinstance(assumption, NamedInputs):
        names = list(assumption.inputs)
    else:
        names = [name for name in functionality.inputs if satisfies(inputs[name], assumption)]
    for name in names:
        for topic in s.attached_to(PortRef(ref.component, name)):
            connector = s.world.connectors.get(topic)
            if connector is None or not satisfies(connector.guarantee, inputs[name]):
                continue
            for output in sorted(s.publishers_on(topic)):
                owner = s.component(output.component).owner(output.port)
                other = FunctionalityRef(output.component, owner.name)
                for index in range(judge.mode_index(other) - 1, -1, -1):
                    if satisfies(owner.modes[index].guarantee(output.port), connector.guarantee):
                        yield other, index
                        break
