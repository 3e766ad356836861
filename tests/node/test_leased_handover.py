"""The cut between two hosts in virtual time, on the shipped node code: a lease decides, and messages are lost."""

from __future__ import annotations

import itertools
from pathlib import Path

import pytest

from midstride.backends.simulator import Simulator
from midstride.errors import CommandRefused
from midstride.wire.commands import LEASE_SLACK
from tests.conformance import puppets
from tests.conformance.lab import Lab
from tests.node.test_handover import SWAPS, in_lab, next_slot, outcomes, reopened, sides, stand_by

LEASE = 1.0


async def leased_cut(lab: Lab, resume_after: float = 0.5) -> None:
    """A cut 0.2 s ahead of two components at 20 Hz."""
    await stand_by(lab, puppets.talker(rate=20), puppets.talker(rate=20))
    at = await next_slot(lab, 0.2)
    await lab.change("old", "cut_out", cut="cut", swaps=SWAPS, at=at, resume_after=resume_after, lease=LEASE)
    await lab.change("new", "cut_in", cut="cut", swaps=SWAPS, at=at, epoch=at, peer="old", leased=True)


async def heard(lab: Lab) -> list[str]:
    """The sides that were heard one after another."""
    return [side for side, _ in itertools.groupby(sides(await lab.received("sink")))]


def test_the_right_passes_without_a_gap(tmp_path: Path) -> None:
    async def main(lab: Lab, simulator: Simulator) -> None:
        await leased_cut(lab)
        assert await outcomes(lab) == ("done", "done")
        await lab.sleep(3 * LEASE)
        words = await lab.received("sink")
        assert await heard(lab) == ["old", "new"]
        times = [int(word.split(" ")[2]) for word in words]
        old = [number for word, number in zip(words, times, strict=True) if word.startswith("old")]
        assert old == list(range(old[0], old[0] + len(old)))
        assert len(words) - len(old) >= 3 * LEASE * 20 - 1

    in_lab(tmp_path, main)


@pytest.mark.parametrize("lost", ["lost_request", "lost_reply"])
def test_a_new_side_whose_report_is_lost_is_silent_once_its_lease_is_over(lost: str, tmp_path: Path) -> None:
    """If the old side has not heard it, that writes again; if only its answer is lost, neither does."""

    async def main(lab: Lab, simulator: Simulator) -> None:
        simulator.faults.fail_next("old", "taken", lost, 10_000)  # type: ignore[arg-type]
        simulator.faults.fail_next("old", "claim", lost, 10_000, 1)  # type: ignore[arg-type]
        await leased_cut(lab)
        await lab.sleep(0.3 + LEASE * LEASE_SLACK + 0.3)
        before = len(await lab.received("sink"))
        await lab.sleep(1.0)
        resumed = lost == "lost_request"
        assert await heard(lab) == (["old", "new", "old"] if resumed else ["old", "new"])
        assert (len(await lab.received("sink")) > before) == resumed
        simulator.faults.clear()
        await lab.sleep(1.0)
        assert await outcomes(lab) == (("resumed", "cancelled") if resumed else ("done", "done"))
        assert len(await lab.received("sink")) >= before + 10
        assert await heard(lab) == (["old", "new", "old"] if resumed else ["old", "new"])

    in_lab(tmp_path, main)


def test_an_old_side_gives_no_lease_once_it_wants_to_write_again(tmp_path: Path) -> None:
    """The new side writes nothing: it renounces, and the old one need not wait for the end of its lease."""

    async def main(lab: Lab, simulator: Simulator) -> None:
        await leased_cut(lab)
        simulator.faults.hang("new", 30.0)
        await lab.sleep(0.3 + 0.5 + 0.5)
        assert await reopened(lab)
        assert (await lab.read("new", "await_cut", cut="cut"))["outcome"] in ("waiting", "cancelled")

    in_lab(tmp_path, main)


def test_an_old_side_that_has_heard_of_the_first_write_writes_again_only_once_the_new_one_cannot(
    tmp_path: Path,
) -> None:
    async def main(lab: Lab, simulator: Simulator) -> None:
        await leased_cut(lab)
        assert await outcomes(lab) == ("done", "done")
        simulator.faults.kill("new")
        await lab.sleep(3 * LEASE)
        assert not await reopened(lab)
        with pytest.raises(CommandRefused, match="can still write"):
            await lab.change("old", "cancel_cut", cut="cut")
        await lab.change("old", "cancel_cut", cut="cut", freed=True)
        assert await reopened(lab)

    in_lab(tmp_path, main)


def test_a_new_side_that_gives_up_says_so_until_the_old_one_has_heard(tmp_path: Path) -> None:
    async def main(lab: Lab, simulator: Simulator) -> None:
        await leased_cut(lab)
        assert await outcomes(lab) == ("done", "done")
        simulator.faults.fail_next("old", "taken", "lost_request", 3)
        await lab.change("new", "cancel_cut", cut="cut")
        await lab.sleep(0.3)
        assert not await reopened(lab)
        await lab.eventually("the old side writes again", lambda: reopened(lab))
        await lab.sleep(0.2)
        assert await heard(lab) == ["old", "new", "old"]

    in_lab(tmp_path, main)


def test_without_a_lease_a_cut_is_refused_before_its_moment(tmp_path: Path) -> None:
    async def main(lab: Lab, simulator: Simulator) -> None:
        simulator.faults.fail_next("old", "claim", "lost_request")
        with pytest.raises(CommandRefused, match="old gave no lease"):
            await leased_cut(lab)
        await lab.eventually("the old side goes on", lambda: reopened(lab))
        assert await heard(lab) == ["old"]

    in_lab(tmp_path, main)


def test_an_old_side_that_has_ended_leaves_the_right_to_the_new_one(tmp_path: Path) -> None:
    """Its manager says so: on another host, a socket that does not answer does not."""

    async def main(lab: Lab, simulator: Simulator) -> None:
        simulator.faults.fail_next("old", "taken", "lost_request", 1000)
        await leased_cut(lab)
        await lab.sleep(0.5)
        simulator.faults.kill("old")
        await lab.sleep(LEASE)
        before = len(await lab.received("sink"))
        await lab.sleep(0.5)
        assert len(await lab.received("sink")) == before, "its lease is over"
        await lab.read("new", "confirm_cut", cut="cut")
        await lab.sleep(0.5)
        assert len(await lab.received("sink")) >= before + 9

    in_lab(tmp_path, main)
