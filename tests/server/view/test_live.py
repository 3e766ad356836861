"""The live view of systems that change, crash and fail: every client has at each moment what the whole view has."""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import json
import random
from pathlib import Path
from typing import Any

import pytest
from msgspec import structs

from midstride.errors import MidstrideError
from midstride.plan.request import PlanRequest
from midstride.server.view import timing
from midstride.server.view.live import LiveView
from midstride.server.view.timing import LOOK, SOON, TOGETHER
from tests.runtime.systems import example, replace
from tests.server.view.support import Reader, Viewed, following, live_view, viewed, without_figures


async def something_happens(v: Viewed, drawn: random.Random) -> None:
    """One of the things that change a view."""
    nodes = sorted(v.manager.specification.nodes)
    live = sorted(v.manager.configuration.instances)
    what = drawn.randrange(8)
    if not nodes or not live or what == 7:
        await v.manager.change(PlanRequest(to=example("talker")))
    elif what == 6:
        await v.manager.change(PlanRequest(remove=(drawn.choice(nodes),)))
    elif what == 5:
        await v.manager.change(PlanRequest(restart=(drawn.choice(nodes),)))
    elif what == 4:
        v.simulator.faults.kill(drawn.choice(live))
    elif what == 3:
        v.simulator.faults.freeze(drawn.choice(live), drawn.uniform(0.5, 4.0))
    elif what == 2:
        v.simulator.faults.hang(drawn.choice(live), drawn.uniform(0.5, 3.0))
    elif "talker" in nodes:
        await v.manager.change(replace("talker", drawn.choice(["Talker", "NewTalker"])))


def from_scratch(v: Viewed) -> LiveView:
    """Another view of the same manager, which knows nothing of what was before."""
    watched = v.manager.watched
    of_events, of_components = list(watched.events.listeners), list(watched.client.listeners)
    twin = live_view(v.manager, v.simulator)
    twin.refresh(measurements=True)
    watched.events.listeners[:], watched.client.listeners[:] = of_events, of_components
    return twin


def as_from_scratch(v: Viewed) -> bool:
    """Whether the view is the same as one that is built from nothing."""
    v.live.refresh(measurements=True)
    mine, twin = (without_figures(each.document()) for each in (v, Viewed(v.manager, v.simulator, from_scratch(v))))
    fields = ("instances", "topics", "crashed", "silences", "valid", "violations", "revision", "phase", "running")
    return all(mine[field] == twin[field] for field in fields)


@pytest.mark.parametrize("seed", range(6))
def test_patches_lead_to_the_view_whatever_happens(seed: int, tmp_path: Path) -> None:
    """Clients that read at once, seldom, and with reconnections, against the whole view; and that against one that is
    built from nothing, on random sequences of changes and faults."""
    drawn = random.Random(seed)

    async def body(v: Viewed) -> None:
        quick, slow, returning = Reader(v.live), Reader(v.live), Reader(v.live)
        with following([quick]):
            for _ in range(12):
                with contextlib.suppress(MidstrideError):  # a change may be refused, or has nothing to do
                    await something_happens(v, drawn)
                await asyncio.sleep(drawn.uniform(0.0, 1.5))
                if drawn.random() < 0.5:
                    await slow.take()
                if drawn.random() < 0.5:
                    await returning.close()
                    returning = Reader(
                        v.live, returning.messages[-1].id if returning.messages else "", view=returning.view
                    )
                    await returning.take()
                await asyncio.sleep(2 * SOON + 0.01)
                v.live.refresh(measurements=True)
                await asyncio.sleep(2 * SOON)
                whole = v.document()
                assert quick.view == whole
                for reader in (slow, returning):
                    while reader.view.get("n") != v.live.table.n:
                        await reader.take()
                    assert reader.view == v.document()
                if not as_from_scratch(v):  # what no report shows is looked for once a second
                    await asyncio.sleep(LOOK)
                    assert as_from_scratch(v)

    viewed("talker", tmp_path, body)


def test_a_system_in_which_nothing_happens_sends_next_to_nothing(tmp_path: Path) -> None:
    async def body(v: Viewed) -> None:
        await asyncio.sleep(10)
        reader = Reader(v.live)
        with following([reader]):
            await asyncio.sleep(60)
        assert [message.kind for message in reader.messages][:1] == ["view"]
        assert len(reader.of("patch")) <= 3

    viewed("talker", tmp_path, body)


def test_without_clients_only_what_lasts_is_built(tmp_path: Path) -> None:
    async def body(v: Viewed) -> None:
        await asyncio.sleep(10)
        n = v.live.table.n
        assert not v.live._tick.is_set
        await asyncio.sleep(60)
        assert v.live.table.n == n and not v.live._tick.is_set
        await v.manager.change(replace("talker", "NewTalker"))
        await asyncio.sleep(0.2)
        assert v.live.table.n > n and [each["name"] for each in v.document()["instances"]] == ["listener", "talker_2"]

    viewed("talker", tmp_path, body)


def test_patches_are_coalesced_and_a_step_is_soon_visible(tmp_path: Path) -> None:
    async def body(v: Viewed) -> None:
        loop, reader = asyncio.get_running_loop(), Reader(v.live)
        happened: list[float] = []
        v.manager.events.listeners.append(lambda event: happened.append(loop.time()))
        with following([reader]):
            await asyncio.sleep(1)
            begun = loop.time()
            for _ in range(2000):  # 1000 a second
                v.manager.events.add("note", "again")
                v.live._dirty.add("talker")
                await asyncio.sleep(0.001)
            patches = [message.at for message in reader.of("patch") if message.at >= begun]
            assert all(b - a >= SOON - 1e-9 for a, b in itertools.pairwise(patches))
            assert len(patches) <= 41
            await asyncio.sleep(0.2)
            happened.clear()
            before = len(reader.messages)
            await v.manager.change(replace("talker", "NewTalker"))
            await asyncio.sleep(0.2)
        steps = [message for message in reader.messages[before:] if message.kind == "event"]
        assert [message.document["kind"] for message in steps].count("step") == 4
        for message, at in zip(steps, happened, strict=True):
            assert message.at - at <= 0.1
        shown = [message for message in reader.messages[before:] if message.document.get("change")]
        assert shown[-1].document["change"]["outcome"] == "done"

    viewed("talker", tmp_path, body)


@pytest.mark.parametrize(("refreshed", "fewest", "most"), [(timing.REFRESHED, 6, 11), (2, 3, 5)])
def test_a_mode_is_sent_at_once_and_values_of_parameters_seldom(
    refreshed: int, fewest: int, most: int, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """In five seconds: twice a second, or once where its two components are as many as are refreshed in one."""
    monkeypatch.setattr(timing, "REFRESHED", refreshed)

    async def body(v: Viewed) -> None:
        life, reader = v.manager.watched.system.life, Reader(v.live)

        def report(**changes: Any) -> None:
            latest = life.latest("talker")
            assert latest is not None
            state = structs.replace(latest.state, **changes)
            life.reported(state)
            v.live.on_component_event(state)

        def shown() -> Any:
            return next(each for each in reader.view["instances"] if each["name"] == "talker")

        with following([reader]):
            await asyncio.sleep(1)
            before = len(reader.of("patch"))
            for number in range(100):
                report(parameters={"count": number})
                await asyncio.sleep(0.05)
            patches = [each.document.get("instances", {}) for each in reader.of("patch")[before:]]
            values = [value["value"] for each in patches if "talker" in each for value in each["talker"]["parameters"]]
            assert fewest <= len(values) <= len(patches) <= most and values[-1] >= 80
            await asyncio.sleep(2 * SOON)  # nothing has been sent just before
            latest = life.latest("talker")
            assert latest is not None
            (name, known), *_ = latest.state.functionalities.items()
            report(functionalities={name: structs.replace(known, mode="other", since=0.0)})
            await asyncio.sleep(2 * TOGETHER)
            assert shown()["functionalities"][0]["mode"] == "other"

    viewed("talker", tmp_path, body)


def test_a_client_that_does_not_read_is_owed_the_difference_alone(tmp_path: Path) -> None:
    async def body(v: Viewed) -> None:
        stalled = Reader(v.live)
        await stalled.take()
        entries = len(v.live.table._entries)
        for component in ("NewTalker", "Talker") * 5:
            await v.manager.change(replace("talker", component))
        await asyncio.sleep(1)
        v.live.refresh(measurements=True)
        # Nothing is kept for it: the shared table has an entry more for each instance that has gone, and the clients
        # that read share what is encoded.
        assert len(v.live.table._entries) <= entries + 11 and len(v.live.table._patches) <= 1
        while not stalled.of("patch"):
            await stalled.take()
        (patch,) = stalled.of("patch")
        assert patch.document["n"] == v.live.table.n and stalled.view == v.document()

    viewed("talker", tmp_path, body)


def test_a_client_that_returns_gets_what_it_has_missed(tmp_path: Path) -> None:
    async def body(v: Viewed) -> None:
        first = Reader(v.live)
        while await first.take() is not None and not first.of("view"):
            pass
        await first.close()
        events = v.manager.events.last
        await v.manager.change(replace("talker", "NewTalker"))
        await asyncio.sleep(0.2)
        again = Reader(v.live, first.messages[-1].id, view=first.view)
        while len(again.of("event")) < v.manager.events.last - events:
            await again.take()
        assert [message.kind for message in again.messages[:2]] == ["patch", "event"]
        assert again.view == v.document()
        assert [message.document["n"] for message in again.of("event")] == [
            *range(events + 1, v.manager.events.last + 1)
        ]
        # Without the number of an event, those that are past are not sent.
        short = Reader(v.live, f"{v.live.manager}:{first.view['n']}", view=first.view)
        await short.take()
        assert short.view == v.document() and short.messages[0].kind == "patch"

    viewed("talker", tmp_path, body)


@pytest.mark.parametrize("since", ["0123456789abcdef:1.5", "MANAGER:0", "MANAGER:999999", "MANAGER:x", "7", "é", ""])
def test_a_client_of_another_manager_gets_the_whole_view(since: str, tmp_path: Path) -> None:
    async def body(v: Viewed) -> None:
        reader = Reader(v.live, since.replace("MANAGER", v.live.manager))
        message = await reader.take()
        assert message is not None and message.kind == "view" and reader.view == v.document()
        await reader.close()

    viewed("talker", tmp_path, body)


def test_a_stream_ends_with_the_manager_after_the_last_difference(tmp_path: Path) -> None:
    async def body(v: Viewed) -> None:
        reader = Reader(v.live)
        following = asyncio.ensure_future(reader.follow())
        await asyncio.sleep(1)
        await v.live.lifecycle.take_down()
        await asyncio.wait_for(following, 1)
        assert reader.messages[-1].kind in {"patch", "event"}
        assert reader.view["phase"] == "down" and reader.view["instances"] == []
        assert reader.of("event")[-1].document["kind"] == "down"

    viewed("talker", tmp_path, body)


def test_what_deviates_is_said(tmp_path: Path) -> None:
    async def body(v: Viewed) -> None:
        await asyncio.sleep(3)
        assert {each["name"]: each["deviation"] for each in v.document()["instances"]} == {
            "listener": None,
            "talker": None,
        }
        assert v.document()["valid"]
        v.simulator.faults.freeze("talker", 20)
        await asyncio.sleep(15)
        assert not v.component("talker")["answers"] and v.component("talker")["deviation"] == "it does not answer"
        assert v.component("listener")["deviation"] is not None
        assert [each["kind"] for each in v.document()["silences"]][:1] == ["not_answering"] and not v.document()[
            "valid"
        ]
        await asyncio.sleep(30)
        assert v.component("talker")["answers"] and v.component("talker")["deviation"] is None
        v.simulator.faults.kill("talker")
        await asyncio.sleep(1)
        (crashed,) = v.document()["crashed"]
        assert (crashed["name"], crashed["role"], crashed["status"]) == ("talker", "talker", -9)
        assert "listen is in mode degraded" in v.component("listener")["deviation"]
        (topic,) = v.document()["topics"]
        assert (topic["satisfied"], topic["publishers"], topic["subscribers"]) == (False, [], ["listener.in"])

    viewed("talker", tmp_path, body)


def test_the_beginning_of_a_mode_stays_while_it_lasts(tmp_path: Path) -> None:
    async def body(v: Viewed) -> None:
        since = v.component("talker")["functionalities"][0]["since"]
        await asyncio.sleep(30)
        v.live.refresh(measurements=True)
        assert v.component("talker")["functionalities"][0]["since"] == since
        v.simulator.faults.kill("talker")
        await asyncio.sleep(1)
        (listen,) = v.component("listener")["functionalities"]
        assert listen["mode"] == "degraded" and v.now() - 1.1 <= listen["since"] <= v.now()

    viewed("talker", tmp_path, body)


def test_the_timeline_has_the_modes_and_earlier_views_are_as_they_were(tmp_path: Path) -> None:
    async def body(v: Viewed) -> None:
        began = v.now()
        await asyncio.sleep(2)
        before = v.document()
        at_before = v.now()
        v.simulator.faults.kill("talker")
        await asyncio.sleep(2)
        crashed, at_crashed = v.document(), v.now()
        await v.manager.change(PlanRequest(restart=("talker",)))
        await asyncio.sleep(2)

        def earlier(at: float) -> dict[str, object]:
            document = v.live.document_at(at)
            assert document is not None
            return without_figures(json.loads(document))

        for at, view in ((at_before, before), (at_crashed, crashed)):
            then = earlier(at)
            for field in ("instances", "topics", "crashed", "valid", "revision"):
                assert then[field] == without_figures(view)[field], (at, field)
        assert v.live.document_at(began - 1000) is None
        timeline = v.live.timeline(began, v.now())
        modes = [each for each in timeline.modes if each.functionality == "listen"]
        assert [(each.mode, each.level) for each in modes] == [("normal", 0), ("degraded", 1), ("normal", 0)]
        assert modes[0].ended == modes[1].began and modes[1].ended == modes[2].began and modes[2].ended is None
        assert at_before < modes[1].began < at_crashed
        talker = [(each.mode, each.ended is None) for each in timeline.modes if each.instance == "talker"]
        assert talker[0] == ("normal", False)
        only = v.live.timeline(began, at_before)
        assert {(each.functionality, each.mode) for each in only.modes} == {("listen", "normal"), ("talk", "normal")}

    viewed("talker", tmp_path, body)
