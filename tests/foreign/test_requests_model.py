"""Requests to the services of two instances, explored: every order of the steps of both and the manager, with deaths.

What a step makes of a word is computed by the shipped library; here is only the order of loads and compare-and-swaps,
as claims.c and held.c have it.
"""

from __future__ import annotations

import random
from collections.abc import Iterator
from ctypes import byref, c_uint64
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from midstride.foreign.page_layout import RequestsStep
from tests.native import requests_steps

OLD, NEW = 1, 2
BEGUN = 1 << 24
TAKE_BACK = 2
WINDOW = 16


def answering(word: int) -> int:
    return word & 0xFFF


def before(word: int) -> int:
    return word >> 12 & 0xFFF


class Words:
    """The steps of the library."""

    def __init__(self, library: Any) -> None:
        self._library = library

    def give(self, word: int, node: int, lives: bool) -> int:
        return int(self._library.midstride_requests_word(word, RequestsStep.GIVE, node, lives))

    def take_back(self, word: int, node: int) -> int:
        return int(self._library.midstride_requests_word(word, TAKE_BACK, node, False))

    def forget(self, word: int, node: int) -> int:
        return int(self._library.midstride_requests_word(word, RequestsStep.FORGET, node, False))

    def claim(self, word: int, number: int) -> int | None:
        """The word after it; None where it has been claimed."""
        following = c_uint64()
        done = self._library.midstride_requests_claim(word, number, byref(following))
        return following.value if done else None


@pytest.fixture
def words(gate_library: Path) -> Words:
    return Words(requests_steps(gate_library))


@pytest.mark.parametrize("seed", range(20))
def test_claims_are_those_of_a_set(words: Words, seed: int) -> None:
    """A number is claimed once; one that is far below the highest counts as claimed."""
    chance, word, claimed, highest = random.Random(seed), 0xABCD << 48, {0}, 0
    for _ in range(2000):
        number = max(1, highest + chance.choice([-20, -17, -16, -3, -2, -1, 0, 1, 1, 1, 2, 3, 15, 16, 17, 40]))
        expected = number not in claimed and highest - number <= WINDOW
        after = words.claim(word, number)
        assert (after is not None) == expected, (number, highest)
        if after is not None:
            word = after
            claimed.add(number)
            highest = max(highest, number)
        assert word >> 48 == 0xABCD and word & 0xFFFFFFFF == highest


class Node(NamedTuple):
    """``queue``: what the middleware has; ``took``: what its executor has taken and not judged yet, and whether it
    answers, as it has seen. ``claimed``: what it has still to answer."""

    queue: tuple[int, ...] = ()
    took: tuple[int, bool] | None = None
    held: tuple[int, ...] = ()
    claimed: tuple[int, ...] = ()
    alive: bool = True
    receives: bool = True


class World(NamedTuple):
    role: int
    client: int
    nodes: tuple[Node, Node]
    sent: int = 0
    seen: int = 0  # the first number that the new node has received
    given: int = 0  # how many steps the manager has taken
    answered: tuple[int, ...] = ()
    lost: tuple[int, ...] = ()  # with a node that has claimed it and died

    def node(self, index: int) -> Node:
        return self.nodes[index - 1]

    def changed(self, index: int, **changes: Any) -> World:
        nodes = list(self.nodes)
        nodes[index - 1] = nodes[index - 1]._replace(**changes)
        return self._replace(nodes=(nodes[0], nodes[1]))


@dataclass(frozen=True)
class Explorer:
    """All steps that can be next. ``manager``: whom it gives the requests, in turn; ``most``: how many are sent."""

    words: Words
    manager: tuple[int, ...]
    deaths: bool
    most: int = 2

    def answers(self, world: World, index: int, over: bool = False) -> tuple[bool, World]:
        """Whether a node answers, as it finds it. ``over``: the time of the one before is over."""
        word = world.role
        if answering(word) == index:
            old = before(word)
            if not word & BEGUN and old and world.node(old).claimed and world.node(old).alive and not over:
                return False, world
            return True, world._replace(role=word | BEGUN)
        if before(word) == index and not world.node(answering(word)).alive:
            return True, world._replace(role=self.words.take_back(word, index))
        return False, world

    def claim(self, world: World, index: int, number: int) -> World:
        after = self.words.claim(world.client, number)
        if after is None:
            return world
        node = world.node(index)
        done = [*world.answered, *world.lost, *(each for other in world.nodes for each in other.claimed)]
        assert number not in done, f"request {number} is claimed twice"
        return world._replace(client=after).changed(index, claimed=(*node.claimed, number))

    def following(self, world: World) -> Iterator[World]:
        if world.sent < self.most:
            number = world.sent + 1
            receivers = [index for index in (OLD, NEW) if world.node(index).receives and world.node(index).alive]
            after = world._replace(sent=number)
            for index in receivers:
                after = after.changed(index, queue=(*after.node(index).queue, number))
            yield after
        if not world.node(NEW).receives:
            yield world.changed(NEW, receives=True)
        if world.given < len(self.manager):
            node = self.manager[world.given]
            lives = world.node(answering(world.role)).alive
            if world.node(node).alive:
                yield world._replace(role=self.words.give(world.role, node, lives), given=world.given + 1)
        for index in (OLD, NEW):
            if world.node(index).alive:
                yield from self._of_node(world, index)

    def _of_node(self, world: World, index: int) -> Iterator[World]:
        node = world.node(index)
        if node.claimed:
            yield world._replace(answered=(*world.answered, node.claimed[0])).changed(index, claimed=node.claimed[1:])
        for over in (False, True):
            own, seen = self.answers(world, index, over)
            if node.took is None and node.queue:
                yield seen.changed(index, queue=node.queue[1:], took=(node.queue[0], own))
            if node.held and own:
                yield self.claim(seen, index, node.held[0]).changed(index, held=node.held[1:])
        if node.took is not None:
            number, own = node.took
            judged = world.changed(index, took=None)
            if index == NEW and not world.seen:
                judged = judged._replace(seen=number)
            if own:
                yield self.claim(judged, index, number)
            else:
                yield judged.changed(index, held=(*node.held, number))
        if index == before(world.role) and node.held and not 0 < world.seen <= node.held[0]:
            yield self.claim(world, index, node.held[0]).changed(index, held=node.held[1:])
        if self.deaths:
            dead = world._replace(lost=(*world.lost, *node.claimed))
            yield dead.changed(index, alive=False, queue=(), took=None, held=(), claimed=())


def explored(explorer: Explorer, receives: bool) -> int:
    """Explore; the number of worlds. Asserts that what a living node can answer is answered at the end."""
    role = explorer.words.give(0, OLD, False)
    first = World(role, 0xABCD << 48, (Node(), Node(receives=receives)))
    known, waiting = {first}, [first]
    while waiting:
        world = waiting.pop()
        after = [each for each in explorer.following(world) if each != world]
        if not [
            each
            for each in after
            if each.nodes[0].alive == world.nodes[0].alive and each.nodes[1].alive == world.nodes[1].alive
        ]:  # only deaths are left
            judge(explorer, world)
        for each in after:
            each = each._replace(role=each.role & 0xFFFFFFFF, answered=tuple(sorted(each.answered)))
            if each not in known:
                known.add(each)
                waiting.append(each)
    return len(known)


def judge(explorer: Explorer, world: World) -> None:
    left = set(range(1, world.sent + 1)) - {*world.answered, *world.lost}
    for index in (OLD, NEW):
        node = world.node(index)
        if node.alive and explorer.answers(world, index)[0]:
            assert not left & set(node.held), f"not answered: {left}, {world}"
    if all(node.alive for node in world.nodes):
        assert not left, f"not answered: {left}, {world}"


@pytest.mark.parametrize("manager", [(NEW,), (NEW, OLD)], ids=["taken over", "rolled back"])
@pytest.mark.parametrize("deaths", [False, True], ids=["both live", "deaths"])
@pytest.mark.parametrize("receives", [True, False], ids=["matched", "matched later"])
def test_every_request_is_claimed_once_and_none_is_forgotten(
    words: Words, manager: tuple[int, ...], deaths: bool, receives: bool
) -> None:
    assert explored(Explorer(words, manager, deaths), receives) > 100


def test_one_that_has_ended_is_not_waited_for(words: Words) -> None:
    word = words.give(words.give(0, OLD, False), NEW, True)
    assert (answering(word), before(word), bool(word & BEGUN)) == (NEW, OLD, False)
    word = words.forget(word, OLD)
    assert (answering(word), before(word), bool(word & BEGUN)) == (NEW, 0, True)
    assert words.take_back(word, OLD) == word
    assert words.give(word, NEW, True) == word, "it answers already"
