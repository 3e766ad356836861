"""Why a functionality is not in a better mode: the chain of reasons, from it to what falls short.

A configuration in its best modes is taken; in any other one the answer says what is unsatisfied now.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from typing import TypeAlias

from midstride.model.component import Assumption, FunctionalityRef, FunctionalitySpec, InputAlternatives, PortRef
from midstride.model.configuration import Configuration
from midstride.model.contract import satisfies
from midstride.model.rules import Evaluator

_Aim: TypeAlias = tuple[FunctionalityRef, int]


def reasons_against(configuration: Configuration, ref: FunctionalityRef, mode: int = 0) -> tuple[str, ...]:
    """Why ``ref`` cannot be in its mode number ``mode``, then why those cannot help that could; () if it can.

    Each functionality on the way is told once, so a cycle ends.
    """
    judge = Evaluator(configuration)
    told: list[str] = []
    seen = {ref}
    waiting = deque([(ref, mode)])
    while waiting:
        current, index = waiting.popleft()
        functionality = configuration.functionality(current)
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


class Diagnosis:
    """The same for many functionalities of one configuration: chains cut short, each with what it ends in.

    All of them together cost no more than the configuration: each step of a chain is worked out once.
    """

    def __init__(self, configuration: Configuration) -> None:
        self.configuration = configuration
        self._judge = Evaluator(configuration)
        self._steps: dict[_Aim, tuple[tuple[str, ...], tuple[_Aim, ...]]] = {}
        self._ends: dict[_Aim, str] = {}

    def chain(self, ref: FunctionalityRef, mode: int = 0, most: int = 4) -> tuple[str, ...]:
        """As :func:`reasons_against`, but after ``most`` reasons only what the first way on ends in."""
        told: list[str] = []
        seen = {ref}
        waiting = deque([(ref, mode)])
        while waiting and len(told) < most:
            reasons, helpers = self._step(waiting.popleft())
            told += reasons
            for other in helpers:
                if other[0] not in seen:
                    seen.add(other[0])
                    waiting.append(other)
        if waiting and (end := self._end(waiting[0])) and end not in told:
            told.append(f"… in the end {end}")
        return tuple(told)

    def _step(self, aim: _Aim) -> tuple[tuple[str, ...], tuple[_Aim, ...]]:
        """The reasons against one aim, and the aims that would help it."""
        if aim not in self._steps:
            ref, index = aim
            functionality = self.configuration.functionality(ref)
            told: list[str] = []
            helpers: list[_Aim] = []
            for assumption in functionality.modes[index].assumptions:
                if not self._judge.assumption_satisfied(ref, functionality, assumption):
                    because = self._judge.why_assumption_unsatisfied(ref, assumption)
                    told.append(f"{ref} cannot be in mode {functionality.modes[index].name}: it {because}")
                    helpers += _helpers(self._judge, ref, functionality, assumption)
            self._steps[aim] = tuple(told), tuple(helpers)
        return self._steps[aim]

    def _end(self, aim: _Aim) -> str:
        """The last reason on the first way on from ``aim``; a cycle ends where it comes round."""
        way: dict[_Aim, None] = {}
        end = ""
        while aim not in self._ends:
            told, helpers = self._step(aim)
            end = told[-1] if told else end
            way[aim] = None
            onward = next((other for other in helpers if other not in way), None)
            if onward is None:
                break
            aim = onward
        else:
            end = self._ends[aim]
        self._ends.update(dict.fromkeys(way, end))
        return end


def _helpers(
    judge: Evaluator, ref: FunctionalityRef, functionality: FunctionalitySpec, assumption: Assumption
) -> Iterator[tuple[FunctionalityRef, int]]:
    """The functionalities that would satisfy the assumption if they were in a better mode, and that mode."""
    configuration, inputs = judge.configuration, judge.configuration.component(ref.instance).inputs
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
                for index in range(judge.mode_index(other) - 1, -1, -1):
                    if satisfies(owner.modes[index].guarantee(output.port), connector.guarantee):
                        yield other, index
                        break
