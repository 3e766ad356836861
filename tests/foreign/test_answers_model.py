"""Nodes that answer messages, explored: every order of the steps of both, of their helper threads, and of the manager.

What a step makes of the word of the baton, and whether an answer is to be given, is computed by the shipped library;
here is only the order of loads, locks and compare-and-swaps, as publishers.c and inputs.c have it.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from midstride.foreign.page_layout import PortFlag
from midstride.node.handover.baton import BatonState, BatonStep, BatonWord
from tests.foreign.test_baton_model import ASK, NEW, OLD, PASS, SKIP, Explorer, Writer
from tests.native import baton_steps

FLAGS = int(PortFlag.TIMED | PortFlag.OFFERS | PortFlag.KEEPS | PortFlag.ANSWERS)


class Call(NamedTuple):
    """One thread of a process. ``at``: what it does next; ``input``: what it answers, 0 of the helper thread."""

    at: str = "idle"
    input: int = 0
    seen: int = 0
    next: int = 0
    again: bool = False
    knows: int = -1


class Side(NamedTuple):
    """A node: the thread that answers, and its helper thread; what it keeps, and which of the two has its lock."""

    node: int
    calls: tuple[Call, Call] = (Call(), Call())
    taken: int = 0  # how many inputs
    kept: tuple[int, ...] = ()
    locked: int | None = None
    overdue: bool = False
    alive: bool = True

    def call(self, thread: int, **changes: Any) -> Side:
        calls = list(self.calls)
        calls[thread] = calls[thread]._replace(**changes)
        return self._replace(calls=(calls[0], calls[1]))

    def done(self, thread: int) -> Side:
        calls = list(self.calls)
        calls[thread] = Call()
        return self._replace(calls=(calls[0], calls[1]), locked=None if self.locked == thread else self.locked)


class World(NamedTuple):
    word: int
    last: tuple[int, int]  # the input that was answered last, and by which node
    answers: tuple[int, ...]  # how often each input has been answered
    sides: tuple[Side, Side]
    manager: str

    def with_side(self, side: Side) -> World:
        old, new = (side if each.node == side.node else each for each in self.sides)
        return self._replace(sides=(old, new))

    def canonical(self) -> World:
        """The same but for the number of the generation."""
        calls = [call for side in self.sides for call in side.calls]
        words = [self.word, *(word for call in calls for word in (call.seen, call.next) if word)]
        ages = sorted({(self.word >> 48) - (word >> 48) & 0xFFFF for word in words})

        def renumbered(word: int) -> int:
            age = ages.index((self.word >> 48) - (word >> 48) & 0xFFFF)
            return word & 0xFFFFFFFFFFFF | (100 - age) << 48

        def of_call(call: Call) -> Call:
            seen, following = call.seen and renumbered(call.seen), call.next and renumbered(call.next)
            return call._replace(seen=seen, next=following)

        def of_side(side: Side) -> Side:
            answering, helping = map(of_call, side.calls)
            return side._replace(calls=(answering, helping))

        old, new = map(of_side, self.sides)
        return self._replace(word=renumbered(self.word), sides=(old, new))

    @property
    def over(self) -> bool:
        """Whether each node that lives has answered each input, as far as it is its own."""
        idle = all(call.at == "idle" for side in self.sides if side.alive for call in side.calls)
        return idle and all(side.taken == len(self.answers) for side in self.sides if side.alive)


class Answering:
    """All steps that can be next in a world of two nodes that answer the same inputs."""

    def __init__(self, library: Any, inputs: int, mortal: frozenset[int] = frozenset()) -> None:
        self.words = Explorer(library)
        self.library, self.inputs, self.mortal = library, inputs, mortal

    def begin(self, manager: str) -> World:
        word = self.words.step(0, BatonStep.GIVE, OLD)
        return World(word, (0, 0), (0,) * self.inputs, (Side(OLD), Side(NEW)), manager)

    def reachable(self, start: World) -> Iterator[World]:
        found, waiting = {start.canonical()}, [start.canonical()]
        while waiting:
            world = waiting.pop()
            yield world
            for each in self.following(world):
                if (following := each.canonical()) not in found:
                    found.add(following)
                    waiting.append(following)

    def following(self, world: World) -> Iterator[World]:
        for side in world.sides:
            if side.alive:
                for thread in range(2):
                    yield from self.steps(world, side, thread)
                if side.node in self.mortal:
                    yield world.with_side(side._replace(alive=False))
        yield from self.manager_steps(world)

    def answered(self, world: World, side: Side, input: int) -> bool:
        return not self.library.midstride_answers_may(input, 0, *world.last, side.node)

    def steps(self, world: World, side: Side, thread: int) -> Iterator[World]:
        call, helper = side.calls[thread], thread == 1
        match call.at:
            case "idle" if helper:
                if side.kept and side.locked is None:
                    yield world.with_side(side.call(thread, at="looking")._replace(locked=thread))
            case "idle":
                if side.taken < self.inputs:
                    yield world.with_side(side.call(thread, at="answering", input=side.taken + 1))
            case "answering":
                if self.answered(world, side, call.input):
                    yield world.with_side(self.next_input(side))
                else:
                    yield world.with_side(side.call(thread, at="deciding", seen=world.word))
            case "looking":
                kept = side.kept
                while kept and self.answered(world, side, kept[0]):
                    kept = kept[1:]
                side = side._replace(kept=kept)
                if kept:
                    yield world.with_side(side.call(thread, at="deciding", seen=world.word))
                else:
                    yield world.with_side(self.looked(side, thread))
            case "deciding":
                yield from self.decide(world, side, thread)
            case "entering":
                yield self.enter(world, side, thread)
            case "locking":
                if side.locked is None:
                    yield world.with_side(side.call(thread, at="giving")._replace(locked=thread))
            case "giving":
                yield self.give_kept(world, side, thread)
            case "gives":
                given = self.publish(world, side.kept[0])
                yield given.with_side(side.call(thread, at="giving")._replace(kept=side.kept[1:]))
            case "checking":
                yield self.check(world, side, thread)
            case "publishing":
                yield self.publish(world, call.input).with_side(side.call(thread, at="left", seen=world.word))
            case "left":
                yield from self.leave(world, side, thread)
            case "keeping":
                if side.locked is None:  # and then looks whether it may publish what is kept by now
                    side = side._replace(kept=(*side.kept, call.input), locked=thread)
                    yield world.with_side(side.call(thread, at="looking", input=0))

    def next_input(self, side: Side) -> Side:
        return side.done(0)._replace(taken=side.taken + 1)

    def looked(self, side: Side, thread: int) -> Side:
        return self.next_input(side) if thread == 0 else side.done(thread)

    def decide(self, world: World, side: Side, thread: int) -> Iterator[World]:
        call = side.calls[thread]
        offered = BatonWord.of(call.seen).state is BatonState.OFFERED
        for waited in (False, True) if offered else (False,):
            writer = Writer(side.node, FLAGS, overdue=side.overdue, knows=call.knows)
            verdict, following = self.words.enter(call.seen, writer, waited)
            if verdict == PASS:
                yield world.with_side(side.call(thread, at="entering", next=following))
            elif verdict == ASK:
                holder = BatonWord.of(call.seen).holder
                dead = not any(each.alive for each in world.sides if each.node == holder)
                yield world.with_side(side.call(thread, knows=int(dead)))
            else:
                side_then = side if verdict == SKIP else side._replace(overdue=False)
                if side.locked == thread:
                    yield world.with_side(self.looked(side_then, thread))
                else:
                    yield world.with_side(side_then.call(thread, at="keeping", seen=0, knows=-1))

    def enter(self, world: World, side: Side, thread: int) -> World:
        call = side.calls[thread]
        if world.word != call.seen:
            return world.with_side(side.call(thread, at="deciding", seen=world.word, knows=-1))
        before, after = BatonWord.of(call.seen), BatonWord.of(call.next)
        again = before.state is BatonState.OFFERED and before.holder == side.node and bool(after.successor)
        at = "giving" if side.locked == thread else "locking"
        entered = side.call(thread, at=at, again=again, seen=0, knows=-1)._replace(overdue=again)
        return world.with_side(entered)._replace(word=call.next)

    def give_kept(self, world: World, side: Side, thread: int) -> World:
        """One of those that are kept, in a call that may publish."""
        if not side.kept:
            looks = not side.calls[thread].input
            free = side if looks else side._replace(locked=None)
            at = "left" if looks else "checking"
            return world.with_side(free.call(thread, at=at, seen=world.word))
        if self.answered(world, side, side.kept[0]):
            return world.with_side(side._replace(kept=side.kept[1:]))
        return self.note(world, side, side.kept[0]).with_side(side.call(thread, at="gives"))

    def check(self, world: World, side: Side, thread: int) -> World:
        """Whether the other node has answered the input since it was looked at first."""
        input = side.calls[thread].input
        if self.answered(world, side, input):
            return world.with_side(side.call(thread, at="left", seen=world.word))
        return self.note(world, side, input).with_side(side.call(thread, at="publishing"))

    def note(self, world: World, side: Side, input: int) -> World:
        return world._replace(last=(max(input, world.last[0]), side.node))

    def publish(self, world: World, input: int) -> World:
        answers = list(world.answers)
        answers[input - 1] += 1
        return world._replace(answers=tuple(answers))

    def leave(self, world: World, side: Side, thread: int) -> Iterator[World]:
        call = side.calls[thread]
        following = int(self.library.midstride_leave(call.seen, call.next, FLAGS, call.again))
        if following == call.seen or world.word == call.seen:
            left = world.with_side(self.looked(side, thread))
            yield left if following == call.seen else left._replace(word=following)
        else:
            yield world.with_side(side.call(thread, seen=world.word))

    def manager_steps(self, world: World) -> Iterator[World]:
        """Each of its steps once, in this order or left out: it may end at any point."""
        if not world.manager:
            return
        word, rest = BatonWord.of(world.word), world.manager[1:]
        yield world._replace(manager=rest)

        def step(step: BatonStep, node: int, successor: int = 0) -> World:
            return world._replace(word=self.words.step(world.word, step, node, successor, True), manager=rest)

        match world.manager[0]:
            case "n":
                yield step(BatonStep.NAME_SUCCESSOR, OLD, NEW)
            case "t":
                yield step(BatonStep.TAKE, NEW)
            case "w":
                yield step(BatonStep.WITHDRAW, OLD)
            case "s" if word.holder == NEW:
                yield step(BatonStep.SETTLE, NEW)
            case "f":
                yield step(BatonStep.FENCE, OLD)
            case "g" if word.holder == OLD and word.state is BatonState.FENCED and not word.writers:
                yield step(BatonStep.GIVE, NEW)

    def ended(self, world: World) -> World:
        """What comes of a world in which all is over: the helper threads publish what may be, once time has passed."""
        for _ in range(4):
            for side in world.sides:
                while True:
                    own = next(each for each in world.sides if each.node == side.node)
                    steps = list(self.steps(world, own, 1)) if own.alive else []
                    if not steps:
                        break
                    world = steps[-1]  # a time that has passed
                    if next(each for each in world.sides if each.node == side.node).calls[1].at == "idle":
                        break
        return world


@pytest.fixture(scope="session")
def library(gate_library: Path) -> Any:
    return baton_steps(gate_library)


def explored(answering: Answering, manager: str) -> Iterator[World]:
    """Each world that can be reached; no input has two answers in any of them."""
    for world in answering.reachable(answering.begin(manager)):
        assert max(world.answers) < 2, world
        yield world


LONG = pytest.mark.long
# What the manager does, if it lives so long: name a successor, withdraw that, settle it, fence, give; take it at once.
PLANS = ["n", "nw", "ns", "nfg", "nt", "nts"]
# Of two inputs, there are ten to a hundred times as many orders.
INPUTS = pytest.mark.parametrize("inputs", [1, pytest.param(2, marks=LONG)])


@INPUTS
@pytest.mark.parametrize("manager", PLANS)
def test_each_input_is_answered_once(library: Any, manager: str, inputs: int) -> None:
    answering = Answering(library, inputs)
    found, ended = 0, 0
    for world in explored(answering, manager):
        found += 1
        if world.over and BatonWord.of(world.word).state is not BatonState.FENCED:
            ended += 1
            assert answering.ended(world).answers == (1,) * inputs, world
    assert found > 1000
    assert ended > 10


@INPUTS
@pytest.mark.parametrize("manager", ["n", "ns", pytest.param("nfg", marks=LONG)])
def test_a_death_costs_one_answer_at_most(library: Any, manager: str, inputs: int) -> None:
    """That which the dead one was about to give, as long as the other one is still to take over from it."""
    answering = Answering(library, inputs, frozenset({OLD, NEW}))
    found = 0
    for world in explored(answering, manager):
        living = [side.node for side in world.sides if side.alive]
        word = BatonWord.of(world.word)
        if not world.over or not living or word.state is BatonState.FENCED:
            continue
        if word.holder in living or {word.successor, word.predecessor}.intersection(living):
            found += 1
            assert answering.ended(world).answers.count(0) <= 2 - len(living), world
    assert found > 10


def test_the_exploration_finds_that_it_is_not_looked_at_again(library: Any) -> None:
    """Whether the other node has answered an input, once this one has the baton."""

    class Faulty(Answering):
        def check(self, world: World, side: Side, thread: int) -> World:
            noted = self.note(world, side, side.calls[thread].input)
            return noted.with_side(side.call(thread, at="publishing"))

    faulty = Faulty(library, 1)
    assert any(max(world.answers) > 1 for world in faulty.reachable(faulty.begin("n")))


def test_the_exploration_finds_a_later_answer_before_those_that_are_kept(library: Any) -> None:
    class Faulty(Answering):
        def enter(self, world: World, side: Side, thread: int) -> World:
            entered = super().enter(world, side, thread)
            own = next(each for each in entered.sides if each.node == side.node)
            if own.calls[thread].at == "locking":
                return entered.with_side(own.call(thread, at="checking"))
            return entered

    faulty = Faulty(library, 2)
    assert any(max(world.answers) > 1 for world in faulty.reachable(faulty.begin("n")))
