"""The right to write between two hosts, explored: every order of messages, time and commands, with clocks that differ.

The two sides are the shipped ones, `OldLease` and `NewLease`. The rest is the slow and obvious twin: time passes in
quarters of a lease, of which each side's clock counts more or fewer; what was sent may arrive at any later moment,
again, or never; and each side may write, give up, or want its right back at any moment. So a link that delays, loses,
or is cut one way or both, and a process that is stopped or has ended, are all among these orders.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any

import pytest

from midstride.node.handover import lease
from midstride.node.handover.lease import NewLease, OldLease
from midstride.wire.commands import LEASE_SLACK
from midstride.wire.replies import Claimed
from tests.planting import plant

# Of a lease (1 s); time is counted in such quarters.
QUARTER = Fraction(1, 4)
SECOND = 10**9
STEADY, FAST, SLOW = Fraction(1), Fraction(11, 10), Fraction(9, 10)
Step = Callable[["World"], None]


@dataclass
class Clock:
    """The steady clock of one side, by how fast it runs, and from where: no two hosts began to count at one moment."""

    rate: Fraction
    begun: int
    quarters: int = 0

    def __call__(self) -> int:
        return self.begun + int(self.quarters * QUARTER * self.rate * SECOND)


@dataclass
class World:
    """``claim`` and ``answer`` have been sent last, with the moment of the claim; a ``taken`` and its replies, ever.

    An older answer to a claim allows less than the last one, so it need not be kept.
    """

    old: OldLease
    new: NewLease
    clocks: tuple[Clock, Clock]
    lasts: int  # how many quarters
    claim: int | None = None
    answer: tuple[int, Claimed] | None = None
    taken: bool = False
    replies: frozenset[bool] = frozenset()  # whether the old side writes again
    # One side has begun to write, while the other one could.
    both: bool = False

    @property
    def new_may_write(self) -> bool:
        return not self.new._ended and self.new._may_write()

    @property
    def writers(self) -> str:
        return "o" * self.old._has + "n" * self.new_may_write

    def key(self) -> object:
        old, new = self.old, self.new
        return (
            self.clocks[0].quarters,
            (old._until, old._recalled, old._taken, old._freed, old._has),
            (new._until, new._used, new._confirmed, new._ended, new.refused),
            (self.claim, self.answer, self.taken, self.replies),
        )

    def steps(self) -> Iterator[Step]:
        if self.clocks[0].quarters < self.lasts:
            yield World.passes
        if not self.new.settled:
            yield World.asks
        if self.claim is not None:
            yield World.is_asked
        if self.answer is not None:
            yield World.is_answered
        yield World.writes
        yield lambda world: world.new.give_back()
        yield World.renounces
        if self.taken:
            yield World.hears_taken
        yield from (lambda world, resumed=resumed: world.hears_reply(resumed) for resumed in self.replies)
        if self.new.owes_word:
            yield World.is_freed
        if not self.old._has:
            yield World.wants_back

    def passes(self) -> None:
        for clock in self.clocks:
            clock.quarters += 1

    def asks(self) -> None:
        self.claim = self.clocks[1]()

    def is_asked(self) -> None:
        assert self.claim is not None
        self.answer = self.claim, self.old.claim()

    def is_answered(self) -> None:
        assert self.answer is not None
        self.new.answered(*self.answer)

    def writes(self) -> None:
        if self.new.admits():
            self.both = self.both or self.old._has
            self.taken = True

    def renounces(self) -> None:
        self.new.renounce()

    def hears_taken(self) -> None:
        """As `CutOutTask.taken`."""
        if not self.old._has:
            self.old.share("")
        self.replies |= {self.old._has}

    def hears_reply(self, resumed: bool) -> None:
        self.new.lose() if resumed else self.new.confirm()

    def is_freed(self) -> None:
        self.old.free()
        self.wants_back()

    def wants_back(self) -> None:
        if self.old.reclaim():
            self.both = self.both or self.new_may_write

    def copied(self) -> World:
        clocks = (replace(self.clocks[0]), replace(self.clocks[1]))
        world = copy.copy(self)
        world.clocks, world.old, world.new = clocks, copy.copy(self.old), copy.copy(self.new)
        world.old.steady, world.new.steady = clocks
        return world


def worlds(old_rate: Fraction, new_rate: Fraction, lasts: int = 6) -> Iterator[World]:
    """Every world that can be reached; the last one is the first in which both write."""
    clocks = Clock(old_rate, 5 * SECOND), Clock(new_rate, 70 * SECOND)
    first = World(OldLease(clocks[0], 1.0), NewLease(clocks[1]), clocks, lasts)
    found, waiting = {first.key()}, [first]
    while waiting:
        yield (world := waiting.pop())
        for step in world.steps():
            after = world.copied()
            step(after)
            if after.both:
                yield after
                return
            if (key := after.key()) not in found:
                found.add(key)
                waiting.append(after)


def once_the_link_is_back(world: World) -> str:
    """The sides that write after one more lease in which every message arrives at once."""
    world = world.copied()
    for _ in range(6):
        if not world.new.settled:
            for step in (World.asks, World.is_asked, World.is_answered):
                step(world)
        world.writes()
        if world.new.owes_word:
            world.is_freed()
        elif world.taken:
            world.replies = frozenset()
            world.hears_taken()
            (resumed,) = world.replies
            world.hears_reply(resumed)
        elif world.old._recalled:
            world.wants_back()
        world.passes()
    return world.writers


def why_nobody(world: World) -> str:
    """Why neither side may write, although both run: for how long that lasts differs."""
    old, new = world.old, world.new
    if old._taken and not (new._confirmed or new._ended):
        return "its answer to the first write is lost"
    if new._ended and not old._freed:
        return "the word that the new side gives up is lost"
    return "a lease runs out"


def test_never_do_both_write() -> None:
    assert not any(world.both for world in worlds(FAST, SLOW, 3))


@pytest.mark.parametrize(
    ("old_rate", "new_rate", "lasts"),
    [
        pytest.param(FAST, SLOW, 5, marks=pytest.mark.full),
        pytest.param(FAST, SLOW, 6, marks=pytest.mark.long),
        pytest.param(STEADY, STEADY, 6, marks=pytest.mark.long),
        pytest.param(SLOW, FAST, 6, marks=pytest.mark.long),
    ],
)
def test_one_writes_as_soon_as_the_link_is_back(old_rate: Fraction, new_rate: Fraction, lasts: int) -> None:
    why = set[str]()
    for world in worlds(old_rate, new_rate, lasts):
        assert not world.both
        assert once_the_link_is_back(world) in ("o", "n")
        if not world.writers:
            why.add(why_nobody(world))
            if why_nobody(world) == "a lease runs out":  # then the old side needs no message
                waited = world.copied()
                for _ in range(6):
                    waited.passes()
                assert waited.old.reclaim()
    assert why == {
        "a lease runs out",
        "its answer to the first write is lost",
        "the word that the new side gives up is lost",
    }


def unchecked(self: NewLease) -> bool:
    return self._confirmed or self._until > 0


def from_the_answer(self: NewLease, sent: int, answer: Claimed) -> None:
    original(self, self.steady(), answer)


original = NewLease.answered


def given_when_recalled(self: OldLease) -> Claimed:
    self._until = self.steady() + round(self.seconds * LEASE_SLACK * SECOND)
    return Claimed(how="leased", seconds=self.seconds)


def without_waiting(self: OldLease) -> bool:
    self._has = self._freed or not self._taken
    return self._has


def although_taken(self: OldLease) -> bool:
    self._has = self._freed or self._is_over()
    return self._has


@pytest.mark.parametrize(
    ("owner", "name", "mistake"),
    [
        pytest.param(NewLease, "_may_write", unchecked, id="a lease that is not checked"),
        pytest.param(
            NewLease, "answered", from_the_answer, id="a lease that begins with its answer", marks=pytest.mark.full
        ),
        pytest.param(OldLease, "claim", given_when_recalled, id="a lease although this side writes"),
        pytest.param(OldLease, "reclaim", without_waiting, id="a lease that is not waited for"),
        pytest.param(OldLease, "reclaim", although_taken, id="a first write that is forgotten"),
        pytest.param(lease, "LEASE_SLACK", 1.0, id="a lease without the difference of the clocks"),
    ],
)
def test_the_exploration_finds(owner: Any, name: str, mistake: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    if owner is lease:
        monkeypatch.setattr(lease, name, mistake)
    else:
        plant(monkeypatch, owner, name, mistake)
    assert any(world.both for world in worlds(FAST, SLOW))
