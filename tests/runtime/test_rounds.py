"""The executor where a plan overlaps: several steps in one round, and processes that start before their step."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

import pytest
from immutables import Map

from midstride.errors import BackendError, StartFailed, StepFailed
from midstride.model.action import Action, Attach, Create, Remove, Upgrade
from midstride.model.component import StopTimes
from midstride.model.configuration import Configuration
from midstride.plan.overlap import Overlap, one_by_one
from midstride.runtime.backend_protocol import Exited, Handle, Launch, RemainingProcess
from midstride.runtime.change_observer import ChangeObserver
from midstride.runtime.records.journal import Journal
from midstride.runtime.records.journal_records import NewChange
from midstride.wire.commands import AttachCommand, DetachCommand, ModesCommand
from midstride.wire.replies import PreviousModes
from tests.model import build
from tests.runtime.scripted import LISTENER, REFUSED, TALKER, Bench, Moves, ScriptedBackend, bench, instance

OLD = {name: instance(name, TALKER) for name in ("first", "second", "third")}
REMOVALS = [Remove(name) for name in OLD]
AT_ONCE = Overlap(((0, 1, 2),), {})


def idle() -> Configuration:
    """Three talkers that are attached to nothing."""
    return build.system(dict.fromkeys(OLD, TALKER), [], modes={})


class Ending:
    """The processes of a bench end only when they may."""

    def __init__(self, b: Bench) -> None:
        self.may = {name: asyncio.Event() for name in OLD}
        self.begun: list[str] = []
        self._backend = b.backend
        b.backend.end = self._end  # type: ignore[method-assign]

    async def _end(self, instance: str, stop: StopTimes) -> list[RemainingProcess]:
        self.begun.append(instance)
        await self.may[instance].wait()
        return await ScriptedBackend.end(self._backend, instance, stop)

    async def have_begun(self) -> None:
        while len(self.begun) < len(OLD):
            await asyncio.sleep(0.01)


def test_the_steps_of_one_round_are_taken_at_once_and_each_is_in_the_model_when_it_is_done(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        ending = Ending(b)
        running = asyncio.ensure_future(b.carry_out(REMOVALS, AT_ONCE))
        await ending.have_begun()
        assert b.kinds() == ["step"] * 3
        await asyncio.sleep(1)
        ending.may["third"].set()
        await asyncio.sleep(1)
        assert set(b.system.configuration.instances) == {"first", "second"}
        assert b.kinds() == ["step"] * 3, "the round has not ended"
        ending.may["first"].set()
        ending.may["second"].set()
        await running
        assert not b.system.configuration.instances
        assert [(event.kind, event.index) for event in b.events.since()] == [
            (kind, index) for kind in ("step", "step_done") for index in range(3)
        ]
        times = [(time.step, time.began, round(time.seconds)) for time in b.executor.times]
        assert times == [(1, 0.0, 2), (2, 0.0, 2), (3, 0.0, 1)]

    bench(idle(), tmp_path, body)


def test_when_each_step_began_and_how_long_it_took_is_counted_from_the_beginning_of_the_change(tmp_path: Path) -> None:
    seconds = {"first": 1.0, "second": 3.0, "third": 0.5}

    async def body(b: Bench) -> None:
        async def end(instance: str, stop: StopTimes) -> list[RemainingProcess]:
            await asyncio.sleep(seconds[instance])
            return await ScriptedBackend.end(b.backend, instance, stop)

        b.backend.end = end  # type: ignore[method-assign]
        await asyncio.sleep(100.0)
        await b.carry_out(REMOVALS, Overlap(((0,), (1, 2)), {}))
        assert [(each.step, round(each.began, 3), round(each.seconds, 3)) for each in b.executor.times] == [
            (1, 0.0, 1.0),
            (2, 1.0, 3.0),
            (3, 1.0, 0.5),
        ]

    bench(idle(), tmp_path, body)


def test_where_one_of_a_round_fails_the_others_end_and_are_undone(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        b.startable(*OLD.values())
        ending = Ending(b)
        b.backend.fail_end["second"] = BackendError("the kernel keeps it")
        entry = await b.journal.begin(NewChange("apply", None, None, b.specification, 3))
        b.entry = entry
        running = asyncio.ensure_future(b.carry_out(REMOVALS, AT_ONCE))
        await ending.have_begun()
        ending.may["second"].set()
        await asyncio.sleep(1)
        assert not running.done(), "the others may still end their processes"
        for name in ("first", "third"):
            ending.may[name].set()
        with pytest.raises(StepFailed, match=r"^remove second: the kernel keeps it$") as failed:
            await running
        assert failed.value.outcome == "rolled_back"
        assert b.system.configuration == idle()
        assert [launch.instance for launch in b.backend.launches] in (["third", "first"], ["first", "third"])
        assert b.words("step_failed") == ["remove second failed: the kernel keeps it"]
        assert [event.index for event in b.events.since() if event.kind == "step_done"] == [0, 2]
        [change] = (await b.journal.history(9)).changes
        assert [step.outcome for step in change.steps] == ["done", "failed", "done"]

    bench(idle(), tmp_path, body)


def test_cancelled_in_a_round_it_waits_for_the_end_of_each_step_and_undoes_all(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        b.startable(*OLD.values())
        ending = Ending(b)
        running = asyncio.ensure_future(b.carry_out(REMOVALS, AT_ONCE))
        await ending.have_begun()
        running.cancel()
        for name in OLD:
            await asyncio.sleep(1)
            assert not running.done()
            ending.may[name].set()
        with pytest.raises(asyncio.CancelledError):
            await running
        assert b.system.configuration == idle()
        assert sorted(launch.instance for launch in b.backend.launches) == sorted(OLD)

    bench(idle(), tmp_path, body)


def test_a_crash_is_responded_to_when_the_round_has_ended(tmp_path: Path) -> None:
    """What responds sends commands, as the steps do; so it is called without the lock that they hold."""

    async def body(b: Bench) -> None:
        performed: list[str] = []

        class Response(ChangeObserver):
            async def performed(self, action: Action) -> None:
                async with b.change.commanding:
                    performed.append(str(action))

        b.observers.append(Response())
        await b.carry_out(UPGRADES, AT_ONCE)
        assert performed == [str(each) for each in UPGRADES]

    bench(idle(), tmp_path, body)


@pytest.mark.parametrize("overlap", [AT_ONCE, one_by_one(REMOVALS)])
def test_a_crash_is_responded_to_while_a_process_ends(overlap: Overlap, tmp_path: Path) -> None:
    """Nothing is commanded but what is removed, and that the response leaves alone."""

    async def body(b: Bench) -> None:
        ending = Ending(b)
        running = asyncio.ensure_future(b.carry_out(REMOVALS, overlap))
        while not ending.begun:
            await asyncio.sleep(0.01)
        await asyncio.wait_for(b.change.commanding.acquire(), 1)
        b.change.commanding.release()
        for each in ending.may.values():
            each.set()
        await running

    bench(idle(), tmp_path, body)


UPGRADES = [Upgrade(Map({build.work(name): 0})) for name in OLD]


def changing_modes(b: Bench, seconds: dict[str, float]) -> list[tuple[str, float]]:
    """Each talker changes its modes when its call has returned; what is returned lists when."""
    changed: list[tuple[str, float]] = []

    def reply(name: str) -> object:
        async def enter() -> PreviousModes:
            await asyncio.sleep(seconds[name])
            changed.append((name, round(b.clock.steady(), 1)))
            return PreviousModes(before={})

        return lambda _: enter()

    for name in OLD:
        b.client.reply(name, ModesCommand, reply(name))
    return changed


def test_components_whose_modes_change_in_one_round_are_commanded_at_once(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        changed, begun = changing_modes(b, {"first": 3.0, "second": 1.0, "third": 2.0}), b.clock.steady()
        await b.carry_out(UPGRADES, AT_ONCE)
        assert [(name, round(at - begun)) for name, at in changed] == [("second", 1), ("third", 2), ("first", 3)]
        assert set(b.system.configuration.modes.values()) == {0}

    bench(idle(), tmp_path, body)


def test_where_one_of_them_refuses_the_others_go_back_to_their_modes(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        changing_modes(b, {"first": 3.0, "second": 1.0, "third": 2.0})
        b.client.reply("second", ModesCommand, REFUSED)
        with pytest.raises(StepFailed, match=r"^upgrade second\.work from degraded to normal: ") as failed:
            await b.carry_out(UPGRADES, AT_ONCE)
        assert failed.value.outcome == "rolled_back"
        assert b.system.configuration == idle()
        last = {name: b.client.of(ModesCommand, name)[-1].modes for name in ("first", "third")}
        assert last == {name: {"work": "degraded"} for name in ("first", "third")}

    bench(idle(), tmp_path, body)


def test_what_is_begun_at_once_is_durable_before_and_the_next_manager_says_which(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        ending = Ending(b)
        b.entry = await b.journal.begin(NewChange("apply", None, None, b.specification, 4))
        fourth = instance("fourth", LISTENER)
        b.startable(fourth)
        actions = [Create(fourth), *REMOVALS]
        running = asyncio.ensure_future(b.carry_out(actions, Overlap(((0,), (1, 2, 3)), {0: [0]})))
        await ending.have_begun()
        [interrupted] = await b.journal.take_over()
        assert str(interrupted) == "the manager ended during steps 2 to 4 of 4"
        for each in ending.may.values():
            each.set()
        await running

    bench(idle(), tmp_path, body)


ATTACHMENTS = [Attach(build.port(f"{name}.out"), "/chatter") for name in OLD]


def test_where_one_attachment_of_a_round_fails_the_others_are_detached_again(tmp_path: Path) -> None:
    unattached = build.system(dict.fromkeys(OLD, TALKER), [], topics={"/chatter": build.at(5.0)})

    async def body(b: Bench) -> None:
        b.client.reply("second", AttachCommand, REFUSED)
        with pytest.raises(StepFailed, match=r"^attach second\.out to /chatter: ") as failed:
            await b.carry_out(ATTACHMENTS, AT_ONCE)
        assert failed.value.outcome == "rolled_back"
        assert b.system.configuration == unattached
        detached = {name: len(b.client.of(DetachCommand, name)) for name in OLD}
        assert detached == {"first": 1, "second": 1, "third": 1}, "what was refused may have been done"

    bench(unattached, tmp_path, body)


# -- processes that start before their step -------------------------------------------------------------

NEW = {name: instance(name, TALKER) for name in ("one", "two", "three")}
ATTACH = Attach(build.port("one.out"), "/chatter")
CREATE_ATTACH_CREATE = [Create(NEW["one"]), ATTACH, Create(NEW["two"])]


class SlowStarts:
    """The back end of a bench starts the process of ``name`` only when it may."""

    def __init__(self, b: Bench, name: str) -> None:
        self.begun, self.may = asyncio.Event(), asyncio.Event()
        self._name, self._backend = name, b.backend
        b.backend.start = self._start  # type: ignore[method-assign]

    async def _start(self, launch: Launch) -> Handle:
        if launch.instance == self._name:
            self.begun.set()
            await self.may.wait()
        return await ScriptedBackend.start(self._backend, launch)


def test_cancelled_between_two_rounds_it_takes_everything_back_and_leaves_no_process(tmp_path: Path) -> None:
    """The step is done, and the process of a later one is just being started."""

    async def body(b: Bench) -> None:
        b.startable(NEW["one"])
        starts = SlowStarts(b, "two")
        creations = [Create(each) for each in NEW.values()]
        overlap = Overlap(one_by_one(creations).rounds, {0: [0, 1, 2]})
        running = asyncio.ensure_future(b.carry_out(creations, overlap))
        await starts.begun.wait()
        while "one" not in b.system.configuration.instances:
            await asyncio.sleep(0.01)
        running.cancel()
        await asyncio.sleep(1)
        assert not running.done()
        starts.may.set()
        with pytest.raises(asyncio.CancelledError):
            await running
        await asyncio.sleep(10)
        assert b.system.configuration == idle()
        assert b.saved() == [] and not b.backend.running & NEW.keys()

    bench(idle(), tmp_path, body)


def test_cancelled_when_every_step_is_done_it_takes_nothing_back(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        b.startable(*NEW.values())
        creations = [Create(each) for each in NEW.values()]
        overlap = Overlap(one_by_one(creations).rounds, {0: [0, 1, 2]})
        running = asyncio.ensure_future(b.carry_out(creations, overlap))
        add = b.events.add

        def cancel_at_the_last(kind: str, words: str, **fields: Any) -> Any:
            if kind == "step_done" and fields["index"] == len(NEW) - 1:
                running.cancel()
            return add(kind, words, **fields)

        b.events.add = cancel_at_the_last  # type: ignore[method-assign]
        await running
        assert b.executor.interrupted
        assert set(b.system.configuration.instances) == {*OLD, *NEW}

    bench(idle(), tmp_path, body)


def test_a_process_starts_before_its_turn_and_is_in_the_model_at_its_step(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        overlap = Overlap(one_by_one(CREATE_ATTACH_CREATE).rounds, {0: [0, 2]})
        running = asyncio.ensure_future(b.carry_out(CREATE_ATTACH_CREATE, overlap))
        await asyncio.sleep(1)
        assert [launch.instance for launch in b.backend.launches] == ["one", "two"]
        assert b.saved() == ["one", "two"], "the next manager must find both"
        b.client.register(NEW["two"])
        await asyncio.sleep(1)
        assert not {"one", "two"} & set(b.system.configuration.instances)
        b.client.register(NEW["one"])
        await running
        assert {"one", "two"} <= set(b.system.configuration.instances)
        assert len(b.backend.launches) == 2

    bench(build.system({"listener": LISTENER}, ["listener.in /chatter"], modes={}), tmp_path, body)


def test_a_process_does_not_start_before_what_its_step_waits_for(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        b.startable(*NEW.values())
        launched: list[int] = []
        b.observers.append(Moves(lambda: launched.append(len(b.backend.launches))))
        actions = [*REMOVALS, Create(NEW["one"])]
        await b.carry_out(actions, Overlap(one_by_one(actions).rounds, {2: [3]}))
        assert launched == [0, 0, 1, 1], "it is started when two steps are done, before the third is"

    bench(idle(), tmp_path, body)


def test_a_process_that_exits_before_its_turn_ends_the_change_at_the_next_step(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        b.startable(NEW["one"])
        b.observers.append(Moves(lambda: b.launcher.exited(Exited("two", 2, "no such file"))))
        actions = [*CREATE_ATTACH_CREATE[:2], Remove("first"), CREATE_ATTACH_CREATE[2]]
        overlap = Overlap(one_by_one(actions).rounds, {0: [0, 3]})
        with pytest.raises(StepFailed, match=r"^create two \(Talker\): two exited with status 2") as failed:
            await b.carry_out(actions, overlap)
        assert failed.value.outcome == "rolled_back"
        assert "first" not in [name for name, _ in b.backend.ended]
        assert b.system.configuration == idle() and b.saved() == []
        b.observers.clear()
        await b.carry_out(REMOVALS)
        assert not b.system.configuration.instances, "what failed is forgotten"

    bench(idle(), tmp_path, body)


def test_a_process_that_cannot_start_before_its_turn_leaves_nothing(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        b.startable(NEW["one"], NEW["three"])
        b.backend.fail_start["two"] = StartFailed("cannot start `./nosuch`")
        actions = [Create(NEW["one"]), ATTACH, Create(NEW["three"]), Create(NEW["two"])]
        with pytest.raises(StepFailed, match=r"^create two \(Talker\): cannot start `./nosuch`"):
            await b.carry_out(actions, Overlap(one_by_one(actions).rounds, {0: [0, 2, 3]}))
        assert b.backend.running == {"listener"} and b.saved() == []

    bench(build.system({"listener": LISTENER}, ["listener.in /chatter"], modes={}), tmp_path, body)


@pytest.mark.parametrize("launched", [False, True])
def test_a_manager_that_is_superseded_leaves_no_process_that_it_has_started_ahead(
    launched: bool, tmp_path: Path
) -> None:
    """The other one takes over before the start, or while the process is being started."""

    async def body(b: Bench) -> None:
        other = Journal(b.journal.path, b.backend.name)
        b.entry = await b.journal.begin(NewChange("apply", None, None, b.specification, 3))
        start = b.backend.start

        async def start_and_lose(launch: Launch) -> Handle:
            if (launch.instance == "two") == launched:
                await other.take_over()
            return await start(launch)

        b.backend.start = start_and_lose  # type: ignore[method-assign]
        overlap = Overlap(one_by_one(CREATE_ATTACH_CREATE).rounds, {0: [0, 2]})
        with pytest.raises(StepFailed, match="nothing is rolled back, since another manager has taken over"):
            await b.carry_out(CREATE_ATTACH_CREATE, overlap)
        assert [launch.instance for launch in b.backend.launches] == (["one", "two"] if launched else ["one"])
        assert "two" not in b.backend.running
        other.close()

    bench(build.system({"listener": LISTENER}, ["listener.in /chatter"], modes={}), tmp_path, body)


# -- the roll-back ----------------------------------------------------------------------------------------

CREATIONS = [Create(new) for new in NEW.values()]
LAST_FAILS = Attach(build.port("nobody.out"), "/chatter")


class EndingCreated(Ending):
    """The processes that the change has created end only when they may."""

    def __init__(self, b: Bench) -> None:
        super().__init__(b)
        self.may = {name: asyncio.Event() for name in NEW}


def test_what_a_change_has_created_in_a_row_is_removed_at_once_in_a_roll_back(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        b.startable(*NEW.values())
        ending = EndingCreated(b)
        running = asyncio.ensure_future(b.carry_out([*CREATIONS, LAST_FAILS]))
        await ending.have_begun()
        assert sorted(ending.begun) == sorted(NEW)
        for each in ending.may.values():
            each.set()
        with pytest.raises(StepFailed) as failed:
            await running
        assert failed.value.outcome == "rolled_back"
        assert b.system.configuration == idle() and b.saved() == []

    bench(idle(), tmp_path, body)


def test_what_cannot_be_removed_does_not_keep_the_others(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        b.startable(*NEW.values())
        b.backend.fail_end["two"] = BackendError("the kernel keeps it")
        with pytest.raises(StepFailed, match=r"the roll-back failed: remove two: the kernel keeps it$") as failed:
            await b.carry_out([*CREATIONS, LAST_FAILS])
        assert failed.value.outcome == "failed"
        assert set(b.system.configuration.instances) == {*OLD, "two"}
        assert b.words("rollback_failed") == ["the roll-back is incomplete: remove two: the kernel keeps it"]

    bench(idle(), tmp_path, body)


def test_processes_that_a_change_has_removed_in_a_row_start_side_by_side_in_a_roll_back(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        running = asyncio.ensure_future(b.carry_out([*REMOVALS, LAST_FAILS]))
        await asyncio.sleep(1)
        launched = [launch.instance for launch in b.backend.launches]
        assert launched[:2] == ["third", "second"], "how many start at once depends on the machine"
        assert b.saved() == sorted(launched), "the next manager must find them"
        for old in OLD.values():
            b.client.register(old)
        with pytest.raises(StepFailed) as failed:
            await running
        assert failed.value.outcome == "rolled_back"
        assert b.system.configuration == idle()
        assert len(b.backend.launches) == 3

    bench(idle(), tmp_path, body)


@pytest.mark.parametrize("lost", OLD)
def test_one_that_cannot_start_again_does_not_keep_the_others(lost: str, tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        b.startable(*OLD.values())
        b.backend.fail_start[lost] = StartFailed("cannot start `./nosuch`")
        with pytest.raises(StepFailed, match=f"create {lost} .*: cannot start `./nosuch`$") as failed:
            await b.carry_out([*REMOVALS, LAST_FAILS])
        assert failed.value.outcome == "failed"
        assert set(b.system.configuration.instances) == OLD.keys() - {lost}
        assert b.saved() == sorted(OLD.keys() - {lost})
        assert len(b.words("rollback_failed")) == 1

    bench(idle(), tmp_path, body)
