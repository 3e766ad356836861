"""The life of an instance: its tables, what each query answers in each state, and what is kept of the transitions."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from pathlib import Path
from typing import Any

import pytest

from midstride import transitions
from midstride.backends.simulator.virtual_clock import SimulatedClock
from midstride.backends.simulator.virtual_loop import run
from midstride.runtime.backend_protocol import Exited, Handle
from midstride.runtime.instance_life import (
    CONNECTIONS,
    FENCES,
    KEPT,
    PROCESSES,
    SILENCE,
    STOPPED,
    ConnectionEvent,
    ConnectionState,
    InstanceLife,
    LifeTable,
    ProcessEvent,
    ProcessState,
)
from midstride.runtime.records.reports import FencedInstance
from midstride.transitions import POLICY, ForbiddenTransition, Transitions
from tests.runtime.scripted import TALKER, instance, reported, talking

HANDLE = Handle("talker", 7, 1.0)
EXITED = Exited("talker", -9)
MODEL = {"talker": instance("talker", TALKER)}
DOCS = Path(__file__).parents[2] / "docs"


def living(body: Callable[[LifeTable, SimulatedClock], Coroutine[Any, Any, None]]) -> None:
    async def main() -> None:
        clock = SimulatedClock()
        clock.follow(asyncio.get_running_loop())
        await body(LifeTable(clock), clock)

    run(main())


def table() -> LifeTable:
    return LifeTable(SimulatedClock())


def after(*events: ProcessEvent) -> LifeTable:
    """A table in which these have happened to the talker."""
    life = table()
    for event in events:
        match event:
            case ProcessEvent.STARTED:
                life.started("talker", HANDLE)
            case ProcessEvent.EXITED | ProcessEvent.KILLED:
                life.exited(EXITED, event)
            case ProcessEvent.MISSED:
                life.missed("talker", "talker", EXITED)
            case _:
                life.record("talker", event)
    return life


RUNNING = (ProcessEvent.STARTED, ProcessEvent.REGISTERED)
STOPPING = (*RUNNING, ProcessEvent.END_BEGUN)
CRASHED = (*RUNNING, ProcessEvent.EXITED)


@pytest.mark.parametrize(
    ("events", "state"),
    [
        ((), ProcessState.ABSENT),
        ((ProcessEvent.STARTED,), ProcessState.STARTING),
        (RUNNING, ProcessState.RUNNING),
        (STOPPING, ProcessState.STOPPING),
        ((*STOPPING, ProcessEvent.ENDED), ProcessState.ABSENT),
        ((*STOPPING, ProcessEvent.END_FAILED), ProcessState.STUCK),
        ((*STOPPING, ProcessEvent.END_FAILED, ProcessEvent.STARTED), ProcessState.STARTING),
        ((*STOPPING, ProcessEvent.END_FAILED, ProcessEvent.EXITED), ProcessState.EXITED),
        ((*STOPPING, ProcessEvent.END_FAILED, ProcessEvent.MISSED, ProcessEvent.END_BEGUN), ProcessState.MISSING),
        ((*STOPPING, ProcessEvent.EXITED, ProcessEvent.ENDED), ProcessState.EXITED),
        ((ProcessEvent.STARTED, ProcessEvent.EXITED, ProcessEvent.REGISTERED), ProcessState.EXITED),
        ((*STOPPING, ProcessEvent.KILLED), ProcessState.EXITED),
        (CRASHED, ProcessState.EXITED),
        ((*CRASHED, ProcessEvent.END_BEGUN, ProcessEvent.ENDED), ProcessState.EXITED),
        ((*CRASHED, ProcessEvent.MISSED), ProcessState.MISSING),
        ((*CRASHED, ProcessEvent.MISSED, ProcessEvent.STARTED), ProcessState.STARTING),
        ((*CRASHED, ProcessEvent.MISSED, ProcessEvent.REPLACED), ProcessState.ABSENT),
    ],
)
def test_a_process_is_in_one_state_and_the_queries_follow(
    events: tuple[ProcessEvent, ...], state: ProcessState
) -> None:
    life = after(*events)
    assert life["talker"].process is state
    assert life.is_ending("talker") == (state is ProcessState.STOPPING)
    assert life.has_exited("talker") == life.is_gone("talker") == (state is ProcessState.EXITED)
    assert life.exits == ({"talker": EXITED} if state is ProcessState.EXITED else {})
    assert life.missing == ({"talker": EXITED} if state is ProcessState.MISSING else {})


@pytest.mark.parametrize("states", [PROCESSES, CONNECTIONS, FENCES])
def test_every_state_can_be_reached_and_left(states: Transitions[Any, Any]) -> None:
    for state in states.table:
        assert any(state in row.values() for other, row in states.table.items() if other is not state)
        assert any(following is not state for following in states.table[state].values())


def test_what_must_not_happen_raises() -> None:
    with pytest.raises(ForbiddenTransition, match="talker: REGISTERED must not happen in the state ABSENT"):
        table().record("talker", ProcessEvent.REGISTERED)
    with pytest.raises(ForbiddenTransition, match="talker: STARTED must not happen in the state RUNNING"):
        after(*RUNNING, ProcessEvent.STARTED)
    with pytest.raises(ForbiddenTransition, match="talker: REFUSED must not happen in the state NONE"):
        table().record("talker", ConnectionEvent.REFUSED)


def test_in_production_what_must_not_happen_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(POLICY, "on_forbidden", transitions.survive)
    life = after(*RUNNING, ProcessEvent.STARTED)
    assert life["talker"].process is ProcessState.RUNNING and life.handles == {"talker": HANDLE}


def test_the_latest_transitions_are_kept_with_time_and_reason() -> None:
    async def body(life: LifeTable, clock: SimulatedClock) -> None:
        life.started("talker", HANDLE)
        started = clock.steady()
        await asyncio.sleep(3)
        life.exited(EXITED)
        assert [(each.event, each.at - started, each.because) for each in life["talker"].history] == [
            (ProcessEvent.STARTED, 0.0, "talker: its process was started, or is awaited"),
            (ProcessEvent.EXITED, 3.0, "talker exited unexpectedly"),
        ]
        for _ in range(KEPT):
            life.record("talker", ConnectionEvent.DISCONNECTED)
        assert [each.event for each in life["talker"].history] == [ConnectionEvent.DISCONNECTED] * KEPT

    living(body)


def test_silence_is_the_time_since_the_last_report() -> None:
    async def body(life: LifeTable, clock: SimulatedClock) -> None:
        state = reported(talking().instances["talker"])
        life.record("talker", ConnectionEvent.OPENED)
        assert life.responsive("talker") is None and not life.is_silent("talker"), "it has not reported yet"
        life.reported(state)
        await asyncio.sleep(SILENCE)
        assert life.responsive("talker") == state
        await asyncio.sleep(0.001)
        assert life.responsive("talker") is None and life.is_silent("talker") and not life.is_stopped("talker")
        await asyncio.sleep(STOPPED - SILENCE)
        assert life.is_stopped("talker")
        life.record("talker", ConnectionEvent.BROKEN)
        assert life.latest("talker") is None and not life.is_silent("talker") and not life.is_stopped("talker")

    living(body)


def test_a_connection_that_cannot_be_reopened_shows_an_exit_before_the_back_end_does() -> None:
    life = after(*RUNNING)
    for event in (ConnectionEvent.OPENED, ConnectionEvent.BROKEN):
        life.record("talker", event)
        assert not life.is_gone("talker")
    life.record("talker", ConnectionEvent.REFUSED)
    assert life.is_gone("talker") and not life.has_exited("talker")
    life.record("talker", ConnectionEvent.OPENED)
    assert not life.is_gone("talker") and life["talker"].connection is ConnectionState.OPEN


def test_one_that_is_missing_and_cannot_be_started_again_is_missed_for_the_latest_reason() -> None:
    """As by the next manager, where its host cannot be reached: no process has been started meanwhile."""

    async def body(life: LifeTable, clock: SimulatedClock) -> None:
        life.missed("talker", "talker", EXITED)
        life.missed("talker", "talker", Exited("talker", None, because="host arm cannot be reached"))
        assert [exit.words for exit in life.missing.values()] == ["host arm cannot be reached"]

    living(body)


def test_those_that_have_exited_are_missed_by_their_roles_and_others_are_forgotten() -> None:
    life = after(*CRASHED)
    life.started("talker_2", Handle("talker_2", 8, 1.0))
    life.exited(Exited("talker_2", 1))
    assert life.take_exited(MODEL) == ["talker"]
    assert life.exits == {} and life.missing == {"talker": EXITED} and life["talker"].role == "talker"
    assert life.handles == {"talker_2": Handle("talker_2", 8, 1.0)}, "what is left of it can still be ended"


def test_one_whose_restoring_is_undone_is_missing_as_before() -> None:
    life = after(*CRASHED)
    life.take_exited(MODEL)
    before = life.missing
    life.adopted("listener", None)
    life.exited(Exited("listener", None))
    life.take_exited({"listener": MODEL["talker"]})
    life.started("talker", HANDLE)
    life.record("talker", ProcessEvent.END_BEGUN)
    life.record("talker", ProcessEvent.ENDED)
    assert list(life.missing) == ["listener"]
    life.miss_again(before, {})
    assert list(life.missing) == ["talker", "listener"] and life.missing["talker"] is EXITED
    assert life["talker"].role == "talker"


def test_the_exit_of_an_earlier_process_of_that_name_is_not_that_of_the_next_one() -> None:
    life = after(*CRASHED)
    life.take_exited({})
    assert life["talker"].is_owned, "what is left of it can still be ended"
    life.started("talker", HANDLE)
    assert life["talker"].exit is None


def test_one_that_was_restored_is_not_missing() -> None:
    life = after(*CRASHED)
    life.take_exited(MODEL)
    before = life.missing
    life.started("talker", HANDLE)
    life.record("talker", ProcessEvent.REGISTERED)
    life.miss_again(before, MODEL)
    assert life.missing == {} and life["talker"].process is ProcessState.RUNNING


def test_of_one_that_has_ended_nothing_is_kept() -> None:
    life = after(*STOPPING)
    life.record("talker", ConnectionEvent.OPENED)
    life.record("talker", ConnectionEvent.DISCONNECTED)
    life.record("talker", ProcessEvent.ENDED)
    assert life["talker"] == InstanceLife()


def documented() -> dict[str, set[str]]:
    """The states of each fact, as the page on the life of an instance has them."""
    (text,) = [
        text for path in DOCS.rglob("*.md") if "# The life of an instance\n" in (text := path.read_text("utf-8"))
    ]
    found: dict[str, set[str]] = {}
    fact = ""
    for line in text.partition("| fact |")[2].partition("\n\n")[0].splitlines()[2:]:
        named, states = (cell.strip() for cell in line.split("|")[1:3])
        fact = named or fact
        found.setdefault(fact, set()).update(states.strip("`") for states in states.split(", "))
    return found


def test_the_documented_states_are_those_of_the_code() -> None:
    tables: dict[str, Transitions[Any, Any]] = {"process": PROCESSES, "connection": CONNECTIONS, "fence": FENCES}
    assert documented() == {
        fact: {state.name.lower() for state in transitions.table} for fact, transitions in tables.items()
    }


def test_the_next_change_may_fence_again_what_the_one_before_has_fenced() -> None:
    life, fenced = after(ProcessEvent.STARTED), FencedInstance(instance="talker", how="killed", because="", words="")
    life.fence(fenced, [])
    with pytest.raises(ForbiddenTransition):
        life.fence(fenced, [])
    life.begin_change()
    assert life.fenced == {}
    life.fence(fenced, [])
    assert life.fenced == {"talker": fenced}
