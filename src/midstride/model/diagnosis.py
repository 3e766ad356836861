"""The reasons why a functionality cannot be in a better mode: a chain down to the root cause.

Meant for configurations in their best modes; in any other, the answer says what is unsatisfied now.
"""

from __future__ import annotations

import sys
from collections import deque
from collections.abc import Iterator
from typing import TypeAlias

from midstride.model.component import Assumption, FunctionalityRef, FunctionalitySpec, InputAlternatives, PortRef
from midstride.model.configuration import Configuration
from midstride.model.contract import satisfies
from midstride.model.rules import Evaluator

_Goal: TypeAlias = tuple[FunctionalityRef, int]


class Diagnosis:
    """The reasons against modes of one configuration, each chain shortened to its first reasons and the last.

    All chains together cost no more than a walk over the configuration: each step of a chain is worked out once.
    """

    def __init__(self, configuration: Configuration) -> None:
        self.configuration = configuration
        self._evaluator = Evaluator(configuration)
        self._steps: dict[_Goal, tuple[tuple[str, ...], tuple[_Goal, ...]]] = {}
        self._ends: dict[_Goal, str] = {}

    def chain(self, ref: FunctionalityRef, mode: int = 0, most: int = 4) -> tuple[str, ...]:
        """The reasons why ``ref`` cannot be in its mode number ``mode``, then those of its suppliers; () if it can.

        Each mode of a functionality occurs once, so a cycle ends. After ``most`` reasons only the root cause on the
        first path.
        """
        found: list[str] = []
        seen = {(ref, mode)}
        waiting = deque([(ref, mode)])
        while waiting and len(found) < most:
            reasons, suppliers = self._step(waiting.popleft())
            found += reasons
            for other in suppliers:
                if other not in seen:
                    seen.add(other)
                    waiting.append(other)
        if waiting and (end := self._end(waiting[0])) and end not in found:
            found.append(f"… root cause: {end}")
        return tuple(found)

    def _step(self, goal: _Goal) -> tuple[tuple[str, ...], tuple[_Goal, ...]]:
        """The reasons against one goal, and the goals that would help it."""
        if goal not in self._steps:
            ref, index = goal
            functionality = self.configuration.functionality(ref)
            reasons: list[str] = []
            suppliers: list[_Goal] = []
            for assumption in functionality.modes[index].assumptions:
                if not self._evaluator.assumption_satisfied(ref, functionality, assumption):
                    because = self._evaluator.why_assumption_unsatisfied(ref, assumption)
                    reasons.append(f"{ref} cannot be in mode {functionality.modes[index].name}: it {because}")
                    suppliers += self._suppliers(ref, functionality, assumption)
            self._steps[goal] = tuple(reasons), tuple(suppliers)
        return self._steps[goal]

    def _end(self, goal: _Goal) -> str:
        """The last reason on the first path from ``goal``; a cycle ends where it closes."""
        path: dict[_Goal, None] = {}
        end = ""
        while goal not in self._ends:
            reasons, suppliers = self._step(goal)
            end = reasons[-1] if reasons else end
            path[goal] = None
            following = next((other for other in suppliers if other not in path), None)
            if following is None:
                break
            goal = following
        else:
            end = self._ends[goal]
        self._ends.update(dict.fromkeys(path, end))
        return end

    def _suppliers(
        self, ref: FunctionalityRef, functionality: FunctionalitySpec, assumption: Assumption
    ) -> Iterator[_Goal]:
        """The functionalities that would satisfy the assumption if they were in a better mode, and that mode."""
        configuration, inputs = self.configuration, self.configuration.component(ref.instance).inputs
        if isinstance(assumption, InputAlternatives):
            names = list(assumption.inputs)
        else:
            names = [name for name in functionality.inputs if satisfies(inputs[name], assumption)]
        for name in names:
            for topic in configuration.attached_to(PortRef(ref.instance, name)):
                connector = configuration.context.connectors.get(topic)
                if connector is None or not satisfies(connector.guarantee, inputs[name]):
                    continue
                for output in sorted(configuration.publishers_on(topic)):
                    owner = configuration.component(output.instance).owner(output.port)
                    other = FunctionalityRef(output.instance, owner.name)
                    for index in range(configuration.modes[other] - 1, -1, -1):
                        if satisfies(owner.modes[index].guarantee(output.port), connector.guarantee):
                            yield other, index
                            break


def reasons_against(configuration: Configuration, ref: FunctionalityRef, mode: int = 0) -> tuple[str, ...]:
    """The reasons why ``ref`` cannot be in its mode number ``mode``, then those of its suppliers; () if it can."""
    return Diagnosis(configuration).chain(ref, mode, sys.maxsize)
