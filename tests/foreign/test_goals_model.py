"""Goals of a ROS action at two instances, explored: every order of the steps of both, their client and the manager.

What a step makes of a word, and whose turn it is, is computed by the shipped library; here is their order, as
goals.c and held.c have it. That a request is claimed once is explored in test_requests_model.py: here a claim is one of
a set.
"""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from enum import IntEnum
from functools import partial, reduce
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from midstride.foreign.page_layout import GoalState, RequestsStep
from tests.native import goal_steps

OLD, NEW = 1, 2
BEGUN = 1 << 24
TAKE_BACK = 2


class Event(IntEnum):
    CLAIM, ACCEPT, REJECT, END, FETCH, EXPIRE = range(6)


class About(IntEnum):
    NONE, ONE, MANY = range(3)


class Turn(IntEnum):
    WAIT, ANSWER, ADD = range(3)


def owner(word: int) -> int:
    return word & 0xFFF


def state(word: int) -> GoalState:
    return GoalState(word >> 12 & 0xF)


def in_flight(word: int) -> bool:
    return GoalState.RESERVED <= state(word) <= GoalState.ENDED


class Steps:
    """The steps of the library."""

    def __init__(self, library: Any) -> None:
        self._library = library

    def give(self, word: int, node: int, lives: bool) -> int:
        return int(self._library.midstride_requests_word(word, RequestsStep.GIVE, node, lives)) & 0xFFFFFFFF

    def take_back(self, word: int, node: int) -> int:
        return int(self._library.midstride_requests_word(word, TAKE_BACK, node, False)) & 0xFFFFFFFF

    def forget(self, word: int, node: int) -> int:
        return int(self._library.midstride_requests_word(word, RequestsStep.FORGET, node, False)) & 0xFFFFFFFF

    def reserve(self, word: int, node: int, ended: bool = False) -> int:
        return int(self._library.midstride_goal(word, True, node, ended))

    def step(self, word: int, node: int, event: Event) -> int:
        return int(self._library.midstride_goal(word, False, node, event))

    def turn(self, about: About, node: int, own: bool, owner: int, in_flight: bool, added: bool, missing: bool) -> Turn:
        return Turn(self._library.midstride_turn(about, node, own, owner, in_flight, added, missing))


@pytest.fixture
def steps(gate_library: Path) -> Steps:
    return Steps(goal_steps(gate_library))


class Request(NamedTuple):
    """``kind``: `goal`, `result`, `cancel` (one), or `all`."""

    kind: str
    goal: int = 0


ABOUT = {"goal": About.NONE, "result": About.ONE, "cancel": About.ONE, "all": About.MANY}


class Node(NamedTuple):
    """``queue``: what the middleware has; ``took``: what its executor has taken, and whose turn that was; ``reserved``:
    the same, once a goal has its place. ``held``: with whether it has added to the answer. ``claimed``: what it has to
    answer, ``adding``: what it adds to. ``runs``: goals in progress; ``results``: those that have ended."""

    queue: tuple[Request, ...] = ()
    took: tuple[Request, Turn] | None = None
    reserved: bool = False
    held: tuple[tuple[Request, bool], ...] = ()
    claimed: tuple[Request, ...] = ()
    adding: tuple[Request, ...] = ()
    runs: tuple[int, ...] = ()
    results: tuple[int, ...] = ()
    alive: bool = True
    receives: bool = True


class Answer(NamedTuple):
    """``goals``: those that it names as cancelled. ``known``: whether its node had the goal that it is about."""

    request: Request
    node: int
    known: bool
    goals: frozenset[int] = frozenset()


class World(NamedTuple):
    role: int
    nodes: tuple[Node, Node]
    goals: tuple[int, ...]  # the words of their places: a goal is in that of its number
    sent: tuple[Request, ...] = ()
    seen: tuple[str, ...] = ()  # the services whose client the new node has heard of
    claimed: frozenset[Request] = frozenset()
    answers: frozenset[Answer] = frozenset()
    added: frozenset[tuple[Request, int, frozenset[int]]] = frozenset()
    executed: tuple[int, ...] = ()
    cancelled: frozenset[int] = frozenset()
    before: frozenset[int] = frozenset()  # the goals that had been accepted when `all` was sent
    lost: frozenset[Request] = frozenset()
    given: int = 0
    drained: bool = False  # the old one has been ended
    kept: frozenset[int] = frozenset()  # the goals whose results the manager has kept

    def node(self, index: int) -> Node:
        return self.nodes[index - 1]

    def changed(self, index: int, **changes: Any) -> World:
        nodes = list(self.nodes)
        nodes[index - 1] = nodes[index - 1]._replace(**changes)
        return self._replace(nodes=(nodes[0], nodes[1]))

    def with_goal(self, number: int, word: int) -> World:
        """Without the number of its generation: that makes no other world."""
        return self._replace(goals=(*self.goals[: number - 1], word & 0xFFFFFFFF, *self.goals[number:]))


@dataclass(frozen=True)
class Explorer:
    """All steps that can be next. ``requests``: what is sent, in any order that a client can; ``manager``: whom it has
    answer, in turn. ``over``: that a node has had its time may be found at any moment."""

    steps: Steps
    requests: tuple[Request, ...]
    manager: tuple[int, ...] = (NEW,)
    deaths: bool = False
    over: bool = False

    def own(self, world: World, index: int) -> tuple[bool, World]:
        """Whether a node answers what is about no goal, as it finds it."""
        word = world.role
        answering, before = word & 0xFFF, word >> 12 & 0xFFF
        if answering == index:
            if not word & BEGUN and before and world.node(before).alive and self._unanswered(world.node(before)):
                return False, world
            return True, world._replace(role=word | BEGUN)
        if before == index and not world.node(answering).alive:
            return True, world._replace(role=self.steps.take_back(word, index))
        return False, world

    @staticmethod
    def _unanswered(node: Node) -> bool:
        return any(request.kind != "result" for request in node.claimed)

    def turn(
        self, world: World, index: int, request: Request, added: bool, over: bool = False, left_over: bool = False
    ) -> tuple[Turn, World]:
        own, seen = (True, world) if left_over else self.own(world, index)
        about, has, mine, missing = ABOUT[request.kind], 0, False, False
        if about is About.ONE:
            word = world.goals[request.goal - 1]
            has = owner(word) if state(word) >= GoalState.ASKED and world.node(owner(word)).alive else 0
        if about is About.MANY:
            for word in filter(in_flight, world.goals):
                if owner(word) == index:
                    mine = True
                elif world.node(owner(word)).alive and not over:
                    missing |= not any(each[:2] == (request, owner(word)) for each in world.added)
        return self.steps.turn(about, index, own, has, mine, added, missing), seen

    # -- the client, and the manager -------------------------------------------------------------------

    def following(self, world: World) -> Iterator[World]:
        accepted = {each.request.goal for each in world.answers if each.request.kind == "goal" and each.known}
        for request in self.requests:
            if request in world.sent or (ABOUT[request.kind] is About.ONE and request.goal not in accepted):
                continue
            after = world._replace(sent=(*world.sent, request))
            if request.kind == "all":
                after = after._replace(before=frozenset(accepted))
            for index in (OLD, NEW):
                if (node := world.node(index)).receives and node.alive:
                    after = after.changed(index, queue=(*node.queue, request))
            yield after
        if not world.node(NEW).receives:
            yield world.changed(NEW, receives=True)
        if world.given < len(self.manager) and world.node(given := self.manager[world.given]).alive:
            lives = world.node(world.role & 0xFFF).alive
            yield world._replace(role=self.steps.give(world.role, given, lives), given=world.given + 1)
        elif world.given == len(self.manager) and (before := world.role >> 12 & 0xFFF) and world.node(before).alive:
            for number in set(self._unfetched(world, before)) - world.kept:
                yield world._replace(kept=world.kept | {number})
        if world.given == len(self.manager) and self._has_drained(world, before := world.role >> 12 & 0xFFF):
            after = world._replace(drained=True, role=self.steps.forget(world.role, before))
            for number, word in enumerate(world.goals, 1):
                after = after.with_goal(number, 0) if owner(word) == before else after
            yield after.changed(before, alive=False, queue=(), took=None, held=(), results=())
        for index in (OLD, NEW):
            if world.node(index).alive:
                yield from self._of_node(world, index)

    def _has_drained(self, world: World, index: int) -> bool:
        """Whether a node may be ended: all that it has accepted is over, some time after it was sent."""
        if not index or not world.node(index).alive or not world.node(NEW).receives:
            return False
        node = world.node(index)
        under_way = node.queue or node.took or node.claimed or node.adding or node.held
        kept = world.kept.intersection(self._unfetched(world, index))
        left = (number for number, word in enumerate(world.goals, 1) if owner(word) == index and in_flight(word))
        return not under_way and kept.issuperset(left)

    @staticmethod
    def _unfetched(world: World, index: int) -> Iterator[int]:
        """The goals of a node that have ended, and whose results no client has fetched."""
        for number, word in enumerate(world.goals, 1):
            if owner(word) == index and state(word) is GoalState.ENDED:
                yield number

    # -- a node ----------------------------------------------------------------------------------------

    def _of_node(self, world: World, index: int) -> Iterator[World]:
        node = world.node(index)
        for request in node.claimed:
            yield from self._answered(world, index, request)
        for request in node.adding:
            mine = frozenset(node.runs)
            after = self._cancelled(world, index, mine)
            yield after._replace(added=after.added | {(request, index, mine)}).changed(
                index, adding=tuple(each for each in node.adding if each != request)
            )
        for number in node.runs:
            yield self._ended(world, index, number)
        for number in node.results:  # a result that no client asks for
            if Request("result", number) not in self.requests:
                yield world.with_goal(number, self.steps.step(world.goals[number - 1], index, Event.EXPIRE))
        for over in (False, True)[: 1 + self.over]:
            if node.took is None and node.queue:
                turn, seen = self.turn(world, index, node.queue[0], False, over)
                yield seen.changed(index, queue=node.queue[1:], took=(node.queue[0], turn))
            for place, (request, added) in enumerate(node.held):
                rest = (*node.held[:place], *node.held[place + 1 :])
                turn, seen = self.turn(world, index, request, added, over)
                if request in world.claimed:
                    yield seen.changed(index, held=rest)
                elif turn is Turn.ADD:
                    held = (*node.held[:place], (request, True), *node.held[place + 1 :])
                    yield seen.changed(index, held=held, adding=(*node.adding, request))
                elif turn is Turn.ANSWER:
                    yield self._claimed(self._reserved(seen, index, request), index, request).changed(index, held=rest)
                elif index == world.role >> 12 & 0xFFF == OLD and request.kind not in world.seen:
                    if self.turn(world, index, request, added, over, left_over=True)[0] is not Turn.ANSWER:
                        continue
                    yield self._claimed(self._reserved(seen, index, request), index, request).changed(index, held=rest)
        if node.took is not None:
            yield self._judged(world, index, *node.took)
        if self.deaths and not world.drained:
            lost = world.lost | frozenset(node.claimed)
            yield world._replace(lost=lost).changed(
                index, alive=False, queue=(), took=None, held=(), claimed=(), adding=(), runs=(), results=()
            )

    def _judged(self, world: World, index: int, request: Request, turn: Turn) -> World:
        node = world.node(index)
        if turn is Turn.ANSWER and request.kind == "goal" and not node.reserved:
            return self._reserved(world, index, request).changed(index, reserved=True)
        judged = world.changed(index, took=None, reserved=False)
        if index == NEW and request.kind not in world.seen:
            judged = judged._replace(seen=tuple(sorted((*world.seen, request.kind))))
        if turn is Turn.ANSWER:
            return self._claimed(judged, index, request)
        if turn is Turn.ADD and request not in world.claimed:
            return judged.changed(index, held=(*node.held, (request, True)), adding=(*node.adding, request))
        return judged.changed(index, held=(*node.held, (request, False)))

    def _reserved(self, world: World, index: int, request: Request) -> World:
        """A goal has its place. In the page, each of two nodes reserves one; here it is that of the one that claims."""
        if request.kind != "goal" or in_flight(world.goals[request.goal - 1]):
            return world
        return world.with_goal(request.goal, self.steps.reserve(world.goals[request.goal - 1], index))

    def _claimed(self, world: World, index: int, request: Request) -> World:
        number, node = request.goal, world.node(index)
        if request in world.claimed:
            if request.kind == "goal":
                world = world.with_goal(number, self.steps.step(world.goals[number - 1], index, Event.REJECT))
            return world
        if request.kind == "goal":
            if owner(world.goals[number - 1]) != index:  # the other one has this place: it will not get the claim
                world = world.with_goal(number, self.steps.reserve(0, index))
            world = world.with_goal(number, self.steps.step(world.goals[number - 1], index, Event.CLAIM))
        return world._replace(claimed=world.claimed | {request}).changed(index, claimed=(*node.claimed, request))

    def _ended(self, world: World, index: int, number: int) -> World:
        node = world.node(index)
        after = world.with_goal(number, self.steps.step(world.goals[number - 1], index, Event.END))
        runs = tuple(each for each in node.runs if each != number)
        return after.changed(index, runs=runs, results=tuple(sorted((*node.results, number))))

    def _cancelled(self, world: World, index: int, goals: frozenset[int]) -> World:
        for number in goals:
            world = self._ended(world, index, number)
        return world._replace(cancelled=world.cancelled | goals)

    def _answered(self, world: World, index: int, request: Request) -> Iterator[World]:
        node, number = world.node(index), request.goal
        done = world.changed(index, claimed=tuple(each for each in node.claimed if each != request))
        answer = Answer(request, index, number in (*node.runs, *node.results))
        if request.kind == "goal":
            assert number not in world.executed, f"goal {number} is executed twice"
            done = done.with_goal(number, self.steps.step(world.goals[number - 1], index, Event.ACCEPT))
            done = done._replace(executed=tuple(sorted((*world.executed, number)))).changed(
                index, runs=(*node.runs, number)
            )
            answer = answer._replace(known=True)
        elif request.kind == "result":
            if number in node.runs:
                return  # it is answered when the goal has ended
            if not answer.known:
                answer = answer._replace(known=number in world.kept)
            else:
                done = done.with_goal(number, self.steps.step(world.goals[number - 1], index, Event.FETCH))
        elif request.kind == "cancel":
            goals = frozenset(node.runs) & {number}
            done, answer = self._cancelled(done, index, goals), answer._replace(goals=goals)
        else:
            goals = frozenset(node.runs)
            others = (each[2] for each in world.added if each[0] == request)
            done, answer = self._cancelled(done, index, goals), answer._replace(goals=goals.union(*others))
            running = {each for each in world.before for other in world.nodes if each in other.runs}
            assert self.over or self.deaths or running <= answer.goals, f"it goes on: {running - answer.goals}, {world}"
        assert not any(each.request == request for each in world.answers), f"{request} is answered twice"
        yield done._replace(answers=done.answers | {answer})


def stepped(steps: Steps, word: int, event: Event) -> int:
    return steps.step(word, OLD, event)


def alive(world: World) -> tuple[bool, ...]:
    return tuple(node.alive for node in world.nodes)


def explored(
    explorer: Explorer, judge: Callable[[World], None], receives: bool = True, begun: Request | None = None
) -> int:
    """Explore; the number of worlds. Each in which only deaths can be next is judged.

    ``begun``: a goal that the old node executes from the beginning.
    """
    role = explorer.steps.give(0, OLD, False)
    goals = tuple(0 for request in explorer.requests if request.kind == "goal")
    first = World(role, (Node(), Node(receives=receives)), goals)
    if begun is not None:
        word = reduce(partial(stepped, explorer.steps), (Event.CLAIM, Event.ACCEPT), explorer.steps.reserve(0, OLD))
        first = (
            first.changed(OLD, runs=(begun.goal,))
            .with_goal(begun.goal, word)
            ._replace(
                sent=(begun,),
                claimed=frozenset({begun}),
                answers=frozenset({Answer(begun, OLD, True)}),
                executed=(begun.goal,),
            )
        )
    known, waiting = {first}, [first]
    while waiting:
        world = waiting.pop()
        after = [each for each in explorer.following(world) if each != world]
        if not any(each.drained != world.drained or alive(each) == alive(world) for each in after):
            judge(world)
        for each in after:
            if each not in known:
                known.add(each)
                waiting.append(each)
    return len(known)


def all_answered(world: World) -> None:
    answered = {each.request for each in world.answers}
    assert answered == set(world.sent), f"not answered: {set(world.sent) - answered}, {world}"


def by_the_one_that_has_it(world: World) -> None:
    """Each request is answered, and what is about a goal by the node that executes it, until that has ended."""
    all_answered(world)
    assert all(each.known for each in world.answers if each.request.kind in ("goal", "result")), world
    assert world.drained or all(each.known for each in world.answers if each.request.kind == "cancel"), world
    if world.role & 0xFFF == NEW:
        assert world.drained, "the old node is kept for ever"


def from_what_was_kept(world: World) -> bool:
    """Whether a result was asked for after the node that had the goal had ended."""
    return any(each.request.kind == "result" and each.node == NEW for each in world.answers) and bool(world.kept)


ONE_GOAL = (Request("goal", 1), Request("result", 1))


@pytest.mark.parametrize("manager", [(NEW,), (NEW, OLD)], ids=["taken over", "rolled back"])
def test_a_result_comes_from_the_node_that_has_the_goal(steps: Steps, manager: tuple[int, ...]) -> None:
    """Or is the one that was kept, where it is asked for later."""
    worlds: list[World] = []

    def judge(world: World) -> None:
        by_the_one_that_has_it(world)
        worlds.append(world)

    assert explored(Explorer(steps, ONE_GOAL, manager), judge) > 100
    assert manager != (NEW,) or any(map(from_what_was_kept, worlds))


@pytest.mark.parametrize("manager", [(NEW,), (NEW, OLD)], ids=["taken over", "rolled back"])
def test_one_goal_is_cancelled_by_the_node_that_has_it(steps: Steps, manager: tuple[int, ...]) -> None:
    requests = (*ONE_GOAL, Request("cancel", 1))

    def judge(world: World) -> None:
        by_the_one_that_has_it(world)
        (answer,) = (each for each in world.answers if each.request.kind == "cancel")
        assert answer.goals == world.cancelled

    assert explored(Explorer(steps, requests, manager), judge) > 100


def test_a_node_that_is_matched_late_changes_nothing(steps: Steps) -> None:
    assert explored(Explorer(steps, ONE_GOAL), all_answered, receives=False) > 100


@pytest.mark.parametrize(
    ("manager", "over"),
    [
        pytest.param((NEW,), False, id="taken over"),
        pytest.param((NEW,), True, id="taken over, late", marks=pytest.mark.full),
        pytest.param((NEW, OLD), False, id="rolled back", marks=pytest.mark.full),
    ],
)
def test_all_goals_are_cancelled_and_one_answer_names_them(steps: Steps, manager: tuple[int, ...], over: bool) -> None:
    """None goes on that had been accepted when the request was sent, and each of these that was cancelled is named.

    A node that adds its list too late cancels its goals all the same: the answer does not name them.
    """
    requests = (Request("goal", 1), Request("goal", 2), Request("all"))
    results: list[World] = []

    def judge(world: World) -> None:
        all_answered(world)
        results.append(world)
        (answer,) = (each for each in world.answers if each.request.kind == "all")
        assert answer.goals <= world.cancelled
        assert over or answer.goals >= world.cancelled & world.before, world

    assert explored(Explorer(steps, requests, manager, over=over), judge, begun=requests[0]) > 100
    merged = (each for world in results for each in world.answers if each.goals == {1, 2} and world.added)
    assert any(merged), "in some of the worlds both nodes have goals, and both are named"


@pytest.mark.parametrize("requests", [ONE_GOAL, (Request("goal", 1), Request("all"))], ids=["result", "all"])
def test_where_nodes_die_the_other_one_answers_what_they_have_not_claimed(
    steps: Steps, requests: tuple[Request, ...]
) -> None:
    explorer = Explorer(steps, requests, deaths=True)

    def judge(world: World) -> None:
        left = set(world.sent) - {each.request for each in world.answers} - world.lost
        for index in (OLD, NEW):
            if world.node(index).alive and explorer.own(world, index)[0]:
                assert not left & {request for request, _ in world.node(index).held}, f"not answered: {left}, {world}"
        if all(node.alive for node in world.nodes):
            assert not left, world

    assert explored(explorer, judge) > 100


# -- the word of a goal, against a twin ----------------------------------------------------------------------------

_NEXT = {
    (GoalState.RESERVED, Event.CLAIM): GoalState.ASKED,
    (GoalState.RESERVED, Event.REJECT): GoalState.NO_GOAL,
    (GoalState.ASKED, Event.ACCEPT): GoalState.ACCEPTED,
    (GoalState.ASKED, Event.REJECT): GoalState.NO_GOAL,
    (GoalState.ASKED, Event.END): GoalState.ENDED,
    (GoalState.ACCEPTED, Event.END): GoalState.ENDED,
    (GoalState.ACCEPTED, Event.FETCH): GoalState.FETCHED,
    (GoalState.ENDED, Event.FETCH): GoalState.FETCHED,
    (GoalState.ENDED, Event.EXPIRE): GoalState.NO_GOAL,
    (GoalState.FETCHED, Event.EXPIRE): GoalState.NO_GOAL,
}


@pytest.mark.parametrize("seed", range(5))
def test_the_word_of_a_goal_is_that_of_a_table(steps: Steps, seed: int) -> None:
    chance = random.Random(seed)
    word, expected, has, generation = 0, GoalState.NO_GOAL, 0, 0
    for _ in range(2000):
        node = chance.choice((OLD, NEW))
        if chance.random() < 0.3:
            ended = chance.random() < 0.1
            word = steps.reserve(word, node, ended)
            if ended or expected in (GoalState.NO_GOAL, GoalState.FETCHED):
                expected, has, generation = GoalState.RESERVED, node, generation + 1
        else:
            event = chance.choice(list(Event))
            word = steps.step(word, node, event)
            if node == has and (expected, event) in _NEXT:
                expected = _NEXT[expected, event]
                has = 0 if expected is GoalState.NO_GOAL else has
        assert (state(word), owner(word), word >> 32) == (expected, has, generation)
