"""The baton, explored: every order of the atomic steps of the old writer, the new one and the manager, with deaths.

What a step makes of the word is computed by the shipped library; here is only the order of loads and compare-and-swaps,
as `enter` and `leave` in writers.c have it.
"""

from __future__ import annotations

import ctypes
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from midstride.foreign.page_layout import PortFlag
from midstride.node.handover.baton import BatonState, BatonStep, BatonWord
from tests.native import baton_steps

PASS, HOLD_BACK, SKIP, ASK, BUSY = range(5)
OLD, NEW = 1, 2
RATED = int(PortFlag.RATED | PortFlag.OFFERS)
TIMED = int(PortFlag.TIMED | PortFlag.OFFERS)
BESIDE = 0  # an output without a rate beside one that has a rate


class Writer(NamedTuple):
    """One thread of a process. ``at``: what it does next; ``seen``: the word that it has loaded."""

    node: int
    flags: int
    at: str = "idle"
    seen: int = 0
    next: int = 0
    overdue: bool = False  # whether a successor has let the patience of an output without a rate go by
    again: bool = False
    alive: bool = True
    wrote: int = 0  # at most 2: whether it has written, and again
    knows: int = -1  # whether the holder is dead
    gate: str = "baton"  # of a component: "closed" or "open" where it does not ask the baton


class World(NamedTuple):
    word: int
    writers: tuple[Writer, ...]
    manager: str  # the steps that are left to it

    def living(self, node: int) -> bool:
        return any(writer.alive for writer in self.writers if writer.node == node)

    def publishing(self) -> set[int]:
        return {writer.node for writer in self.writers if writer.alive and writer.at in ("publishing", "leaving")}

    def canonical(self) -> World:
        """The same without what makes no difference: how much was written, and the number of the generation."""
        words = [self.word, *(word for writer in self.writers for word in (writer.seen, writer.next) if word)]
        ages = sorted({(self.word >> 48) - (word >> 48) & 0xFFFF for word in words})

        def renumbered(word: int) -> int:
            age = ages.index((self.word >> 48) - (word >> 48) & 0xFFFF)
            return word & 0xFFFFFFFFFFFF | (100 - age) << 48

        writers = tuple(
            w._replace(wrote=0, seen=w.seen and renumbered(w.seen), next=w.next and renumbered(w.next))
            for w in self.writers
        )
        return World(renumbered(self.word), writers, self.manager)

    def with_writer(self, index: int, **changes: Any) -> World:
        writers = list(self.writers)
        writers[index] = writers[index]._replace(**changes)
        return self._replace(writers=tuple(writers))


class Explorer:
    """All steps that can be next in a world."""

    def __init__(self, library: Any) -> None:
        self.library = library

    def enter(self, word: int, writer: Writer, waited: bool, collided: bool = False) -> tuple[int, int]:
        following = ctypes.c_uint64(0)
        verdict = self.library.midstride_enter(
            word, writer.node, writer.flags, waited or writer.overdue, collided, writer.knows, ctypes.byref(following)
        )
        return int(verdict), following.value

    def step(self, word: int, step: BatonStep, node: int, successor: int = 0, at_once: bool = False) -> int:
        return int(self.library.midstride_step(word, step, node, successor, at_once))

    def following(self, world: World) -> Iterator[World]:
        for index, writer in enumerate(world.writers):
            if writer.alive:
                yield from self.writer_steps(world, index, writer)
        yield from self.manager_steps(world)

    def writer_steps(self, world: World, index: int, writer: Writer) -> Iterator[World]:
        if writer.at == "idle" and writer.gate == "open":
            yield world.with_writer(index, at="publishing")
        elif writer.at == "publishing" and writer.gate == "open":
            yield world.with_writer(index, at="idle", wrote=min(2, writer.wrote + 1))
        elif writer.at == "idle" and writer.gate == "baton":
            yield world.with_writer(index, at="deciding", seen=world.word, knows=-1)
        elif writer.at == "deciding":
            lies = BatonWord.of(writer.seen).state is BatonState.OFFERED
            # How much time has passed, and whether the other one has come meanwhile, may be either way.
            for waited, collided in ((False, False), (True, True), (True, False)) if lies else ((False, False),):
                verdict, following = self.enter(writer.seen, writer, waited, collided)
                if verdict == PASS:
                    yield world.with_writer(index, at="entering", next=following)
                elif verdict == ASK:
                    holder = BatonWord.of(writer.seen).holder
                    yield world.with_writer(index, knows=int(not world.living(holder)))
                else:
                    overdue = writer.overdue and verdict == SKIP
                    yield world.with_writer(index, at="idle", overdue=overdue, seen=0, knows=-1)
        elif writer.at == "entering":
            if world.word != writer.seen:
                yield world.with_writer(index, at="deciding", seen=world.word, knows=-1)
            else:
                before, after = BatonWord.of(writer.seen), BatonWord.of(writer.next)
                again = before.state is BatonState.OFFERED and before.holder == writer.node and bool(after.successor)
                overdue = again and bool(writer.flags & PortFlag.TIMED)
                entered = world.with_writer(index, at="publishing", again=again, overdue=overdue, seen=0, knows=-1)
                yield entered._replace(word=writer.next)
        elif writer.at == "publishing":
            yield world.with_writer(index, at="leaving", seen=world.word, wrote=min(2, writer.wrote + 1))
        elif writer.at == "leaving":
            following = int(self.library.midstride_leave(writer.seen, writer.next, writer.flags, writer.again))
            if following == writer.seen or world.word == writer.seen:
                done = world.with_writer(index, at="idle", next=0, seen=0, again=False)
                yield done if following == writer.seen else done._replace(word=following)
            else:
                yield world.with_writer(index, seen=world.word)

    def manager_steps(self, world: World) -> Iterator[World]:
        """Each of its steps once, in this order or left out: it may end at any point."""
        word, rest = BatonWord.of(world.word), world.manager[1:]
        timed = bool(world.writers[0].flags & PortFlag.TIMED)
        if not world.manager:
            return
        yield world._replace(manager=rest)
        match world.manager[0]:
            case "n":
                yield world._replace(
                    word=self.step(world.word, BatonStep.NAME_SUCCESSOR, OLD, NEW, timed), manager=rest
                )
            case "q":  # of a side on which nothing is written
                yield world._replace(word=self.step(world.word, BatonStep.NAME_SUCCESSOR, OLD, NEW, True), manager=rest)
            case "t":
                yield world._replace(word=self.step(world.word, BatonStep.TAKE, NEW), manager=rest)
            case "w":
                yield world._replace(word=self.step(world.word, BatonStep.WITHDRAW, OLD), manager=rest)
            case "s":  # once the new one has been seen to have it
                if word.holder == NEW:
                    yield world._replace(word=self.step(world.word, BatonStep.SETTLE, NEW), manager=rest)
            case "f":
                yield world._replace(word=self.step(world.word, BatonStep.FENCE, OLD), manager=rest)
            case "l":
                yield world._replace(word=self.step(world.word, BatonStep.LIFT, OLD), manager=rest)
            case "d":  # a component that has the baton asks no more
                for index, writer in enumerate(world.writers):
                    if word.holder == writer.node == NEW and writer.at == "idle":
                        yield world.with_writer(index, gate="open")
            case "c":  # or it closes its gates, to give the baton back
                for index, writer in enumerate(world.writers):
                    if writer.node == NEW and writer.at == "idle":
                        yield self.given_back(world.with_writer(index, gate="closed"), rest)
            case "r":  # a component that is the old side keeps the baton, or has got it back
                fenced = self.step(world.word, BatonStep.FENCE, OLD)
                for index, writer in enumerate(world.writers):
                    if word.holder == writer.node == OLD and writer.at == "idle":
                        yield world.with_writer(index, gate="open")._replace(word=fenced, manager=rest)
            case "g":  # only from one that is fenced and does not publish, or that has died
                fenced = word.state is BatonState.FENCED and not word.writers
                if word.holder == OLD and (fenced or not world.living(OLD)):
                    yield world._replace(word=self.step(world.word, BatonStep.GIVE, NEW), manager=rest)

    def given_back(self, world: World, rest: str) -> World:
        """The new side is a component whose gates are closed: it withdraws, or gives the baton back."""
        word = self.step(world.word, BatonStep.WITHDRAW, OLD)
        if BatonWord.of(word).holder == NEW:
            word = self.step(word, BatonStep.GIVE, OLD)
        return world._replace(word=word, manager=rest)

    def deaths(self, world: World, mortal: frozenset[int]) -> Iterator[World]:
        for node in mortal:
            if world.living(node):
                writers = tuple(w._replace(alive=False) if w.node == node else w for w in world.writers)
                yield world._replace(writers=writers)

    def reachable(self, start: World, mortal: frozenset[int]) -> Iterator[World]:
        found, waiting = {start.canonical()}, [start.canonical()]
        while waiting:
            world = waiting.pop()
            yield world
            for each in (*self.following(world), *self.deaths(world, mortal)):
                if (following := each.canonical()) not in found:
                    found.add(following)
                    waiting.append(following)

    def someone_writes(self, world: World) -> bool:
        """Whether a writer that lives publishes if all go on in turn, and nothing else happens: five rounds suffice."""
        world = world._replace(manager="")
        for _ in range(5):
            for index in range(len(world.writers)):
                for step in range(12):
                    writer = world.writers[index]
                    if not writer.alive or writer.gate == "closed" or (writer.at == "idle" and step):
                        break
                    world = list(self.writer_steps(world, index, writer))[-1]  # the last: a time that has passed
        return any(writer.wrote for writer in world.writers)


@pytest.fixture(scope="session")
def explorer(gate_library: Path) -> Explorer:
    return Explorer(baton_steps(gate_library))


def begin(explorer: Explorer, flags: tuple[tuple[int, int], ...], manager: str) -> World:
    return World(explorer.step(0, BatonStep.GIVE, OLD), tuple(Writer(node, flag) for node, flag in flags), manager)


FULL = pytest.mark.full
# What the manager does, if it lives so long: name a successor, withdraw that, settle it, fence, lift that, give; name
# one that takes the baton at once (q), and take it (t).
PLANS = ["n", "qt", *(pytest.param(plan, marks=FULL) for plan in ("nw", "ns", "nfg", "nfl", "fgn", "qtw", "qts"))]


@pytest.mark.parametrize("mortal", [frozenset({OLD, NEW}), pytest.param(frozenset(), marks=FULL)], ids=str)
@pytest.mark.parametrize("flags", [RATED, TIMED], ids=["rated", "timed"])
@pytest.mark.parametrize("manager", PLANS)
def test_there_is_one_writer_and_never_none(
    explorer: Explorer, manager: str, flags: int, mortal: frozenset[int]
) -> None:
    found = list(explorer.reachable(begin(explorer, ((OLD, flags), (NEW, flags)), manager), mortal))
    assert len(found) > 100
    for world in found:
        assert len(world.publishing()) < 2, world
        fenced = BatonWord.of(world.word).state is BatonState.FENCED
        settled = "s" not in world.manager and "s" in manager and BatonWord.of(world.word).holder == NEW
        given = "g" in manager and BatonWord.of(world.word).holder == NEW
        if not fenced and not ((settled or given) and not world.living(NEW)):
            needed = world.living(OLD) if BatonWord.of(world.word).holder == OLD else world.living(NEW)
            named = NEW in (BatonWord.of(world.word).successor, BatonWord.of(world.word).holder)
            if needed or (world.living(OLD) and named) or (world.living(NEW) and named):
                assert explorer.someone_writes(world), world


@pytest.mark.full
def test_two_threads_of_one_node(explorer: Explorer) -> None:
    """The baton is offered only when no thread of the old one publishes any more."""
    flags = ((OLD, RATED), (OLD, RATED), (NEW, RATED))
    for world in explorer.reachable(begin(explorer, flags, "n"), frozenset()):
        assert len(world.publishing()) < 2, world


@pytest.mark.long
def test_an_output_without_a_rate_beside_one_that_has_one(explorer: Explorer) -> None:
    """It loses nothing while the baton lies, and does not keep the new one from taking it."""
    flags = ((OLD, RATED), (OLD, BESIDE), (NEW, RATED))
    found = list(explorer.reachable(begin(explorer, flags, "n"), frozenset({NEW})))
    for world in found:
        assert len(world.publishing()) < 2, world
    assert any(BatonWord.of(world.word).holder == NEW for world in found)
    offered = [
        w for w in found if BatonWord.of(w.word).state is BatonState.OFFERED and BatonWord.of(w.word).holder == OLD
    ]
    for world in offered:
        beside = world.writers[1]._replace(knows=-1)
        assert explorer.enter(world.word, beside, False)[0] == PASS


@pytest.mark.parametrize("mortal", [frozenset(), pytest.param(frozenset({OLD, NEW}), marks=FULL)], ids=str)
@pytest.mark.parametrize("flags", [RATED, pytest.param(TIMED, marks=FULL)], ids=["rated", "timed"])
@pytest.mark.parametrize("manager", ["nc", *(pytest.param(plan, marks=FULL) for plan in ("ndcs", "nds", "nr", "nfr"))])
def test_a_component_takes_part(explorer: Explorer, manager: str, flags: int, mortal: frozenset[int]) -> None:
    """The steps that a component takes itself, as the new side (d, c) or as the old one (r), in every order."""
    found = list(explorer.reachable(begin(explorer, ((OLD, flags), (NEW, flags)), manager), mortal))
    assert any(writer.gate != "baton" for world in found for writer in world.writers)
    for world in found:
        assert len(world.publishing()) < 2, world
        holder = BatonWord.of(world.word).holder
        fenced = BatonWord.of(world.word).state is BatonState.FENCED and world.writers[0].gate == "baton"
        if world.living(holder) and not fenced:
            assert explorer.someone_writes(world), world


def test_the_old_one_takes_it_back_and_leaves_a_slot_to_a_successor_that_collides_with_it(explorer: Explorer) -> None:
    """A successor that comes late costs no slot; one that has come while the old one was publishing costs one."""
    offered = explorer.step(explorer.step(0, BatonStep.GIVE, OLD), BatonStep.NAME_SUCCESSOR, OLD, NEW, True)
    old = Writer(OLD, RATED)
    assert explorer.enter(offered, old, True, collided=True)[0] == SKIP
    assert explorer.enter(offered, old, False, collided=True)[0] == PASS  # it was late: that is no slot
    verdict, word = explorer.enter(offered, old, True)
    assert verdict == PASS
    assert (BatonWord.of(word).holder, BatonWord.of(word).successor) == (OLD, NEW)
    assert explorer.enter(word, Writer(NEW, RATED, knows=0), False)[0] == HOLD_BACK
    again = int(explorer.library.midstride_leave(word, word, RATED, True))
    assert BatonWord.of(again).state is BatonState.OFFERED
    assert explorer.enter(again, Writer(NEW, RATED), False)[0] == PASS


def test_the_exploration_finds_a_component_that_gives_back_while_it_publishes(explorer: Explorer) -> None:
    class Faulty(Explorer):
        def manager_steps(self, world: World) -> Iterator[World]:
            yield from super().manager_steps(world)
            if world.manager == "c":
                yield self.given_back(world, "")

    found = Faulty(explorer.library).reachable(begin(explorer, ((OLD, RATED), (NEW, RATED)), "nc"), frozenset())
    assert any(len(world.publishing()) == 2 for world in found)


def test_the_exploration_finds_a_missing_count_of_writers(explorer: Explorer) -> None:
    """The same search on a planted fault: a baton that is offered although another thread still publishes."""

    class Faulty(Explorer):
        def writer_steps(self, world: World, index: int, writer: Writer) -> Iterator[World]:
            for following in super().writer_steps(world, index, writer):
                left = writer.at == "leaving" and following.writers[index].at == "idle"
                if left and BatonWord.of(world.word).successor and BatonWord.of(following.word).writers == 1:
                    yield following._replace(word=following.word - 1 | BatonState.OFFERED << 8)
                yield following

    faulty = Faulty(explorer.library)
    flags = ((OLD, RATED), (OLD, RATED), (NEW, RATED))
    found = faulty.reachable(begin(faulty, flags, "n"), frozenset())
    assert any(len(world.publishing()) == 2 for world in found)
