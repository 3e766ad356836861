"""A change that is rehearsed beside the manager: the same result as the command's, in bounded time."""

from __future__ import annotations

import asyncio

import pytest

from midstride.codec.form import encode
from midstride.codec.specification_form import SpecificationForm
from midstride.errors import ManagerError
from midstride.plan.forms.request_form import ChangeRequest
from midstride.runtime.records.rehearsal_forms import RehearsalOrder
from midstride.server import rehearsing
from midstride.server.rehearsing import Rehearser
from midstride.server.requests import SubmittedRehearsal
from midstride.simulation.rehearsal import rehearse
from tests.runtime.systems import example

SWAP = ChangeRequest(replace=[("talker", "NewTalker")])


def test_the_process_finds_what_the_simulator_does() -> None:
    asked = SubmittedRehearsal(request=SWAP, seeds=2, first=3)
    found = asyncio.run(Rehearser().rehearse(example("talker"), asked))
    order = RehearsalOrder(
        specification=SpecificationForm.of(example("talker")), request=SWAP, seeds=2, first=3, within=1000
    )
    assert encode(found) == encode(rehearse(order))
    assert found.seeds == 2 and not found.failed and sum(found.outcomes.values()) >= 2


def test_a_change_that_cannot_be_planned_is_refused_with_the_reason() -> None:
    asked = SubmittedRehearsal(request=ChangeRequest(remove=["nobody"]), seeds=1)
    with pytest.raises(ManagerError, match=r"cannot be rehearsed: .*nobody"):
        asyncio.run(Rehearser().rehearse(example("talker"), asked))


@pytest.mark.full
def test_no_seed_is_begun_after_the_time() -> None:
    asked = SubmittedRehearsal(request=SWAP, seeds=1000, seconds=0.001)
    assert asyncio.run(Rehearser().rehearse(example("talker"), asked)).seeds == 1


def test_a_process_that_does_not_end_is_killed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rehearsing, "_STARTING", 0.0)
    asked = SubmittedRehearsal(request=SWAP, seeds=1, seconds=0.05)
    with pytest.raises(ManagerError, match=r"has not ended within 0\.05 s"):
        asyncio.run(Rehearser().rehearse(example("talker"), asked))


def test_one_at_a_time() -> None:
    async def run() -> None:
        rehearser, asked = Rehearser(), SubmittedRehearsal(request=SWAP, seeds=1)
        first = asyncio.ensure_future(rehearser.rehearse(example("talker"), asked))
        await asyncio.sleep(0)
        with pytest.raises(ManagerError, match="another change is being rehearsed"):
            await rehearser.rehearse(example("talker"), asked)
        first.cancel()
        await asyncio.gather(first, return_exceptions=True)
        assert (await rehearser.rehearse(example("talker"), asked)).seeds == 1

    asyncio.run(run())
