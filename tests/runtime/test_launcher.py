"""The launcher: a process started, its registration checked, its end; every way in which that fails."""

from __future__ import annotations

import asyncio
from asyncio import CancelledError
from collections.abc import Container
from dataclasses import replace as changed
from pathlib import Path

import pytest
from immutables import Map

from midstride.errors import BackendError, NodeError, StartFailed, Unreachable
from midstride.model.component import KILL_AT_ONCE, ComponentSpec, ParameterSpec, StopTimes
from midstride.model.configuration import Instance
from midstride.runtime.backend_protocol import Exited, Handle, Launch, RemainingProcess
from midstride.runtime.instance_life import ConnectionEvent, InstanceLife, ProcessState
from midstride.runtime.options import SystemOptions
from midstride.runtime.process.launcher import ADOPT_TIMEOUT, RELEASE_TIMEOUT, STOP_GRACE, Launcher, stop_times
from midstride.runtime.process.pending_starts import REGISTRATION_TIMEOUT
from midstride.wire.commands import ObserveCommand, ReleaseCommand, WelcomeCommand
from midstride.wire.state import Endpoint, GoalCounts
from tests.model import build
from tests.planting import plant
from tests.runtime.scripted import (
    LISTENER,
    REFUSED,
    TIMEOUT,
    TOKEN,
    UNREACHABLE,
    Bench,
    bench,
    instance,
    reported,
    started,
)

NOTHING = build.system({}, [])
CAMERA = instance("front/camera", started(build.source("Camera"), "python3 'my camera.py' --fast"))
BY_HAND = instance("camera", build.source("Camera"))


@pytest.mark.parametrize(("own", "given"), [({}, True), ({"use_sim_time": False}, False)])
def test_clock_drives_every_node_that_does_not_say_otherwise(own: dict[str, bool], given: bool, tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        launcher = Launcher(b.backend, b.client, tmp_path, SystemOptions(use_sim_time=True))
        await launcher.start(changed(CAMERA, parameters=Map(own)))
        assert b.backend.launches[-1].parameters == {"use_sim_time": given}

    bench(NOTHING, tmp_path, body)


def test_a_process_is_started_as_its_command_says_and_welcomed(tmp_path: Path) -> None:
    tuned = changed(CAMERA, component=changed(CAMERA.component, parameters=Map(gain=ParameterSpec(1, True))))
    tuned = changed(tuned, parameters=Map(gain=3))

    async def body(b: Bench) -> None:
        assert await b.launcher.start(tuned)
        assert not await b.launcher.start(tuned), "it is coming up already"
        arguments = ("python3", "my camera.py", "--fast")
        name = "front/camera"
        launch = Launch(name, "front", arguments, TOKEN, tmp_path, {"gain": 3}, node=name, role=name)
        assert b.backend.launches == [launch]
        registering = asyncio.ensure_future(b.launcher.registered(tuned))
        await asyncio.sleep(1)
        assert not registering.done() and b.client.sent == []
        b.client.register(tuned)
        await registering
        [(how, name, welcome)] = [sent for sent in b.client.sent if sent.how == "change"]
        assert (how, name) == ("change", "front/camera") and isinstance(welcome, WelcomeCommand) and welcome.manager
        assert b.client.life.handles == {"front/camera": Handle("front/camera", 101, 1.0, "/logs/front/camera.log")}
        assert len(b.backend.launches) == 1

    bench(NOTHING, tmp_path, body)


def test_the_wait_for_the_first_of_several_processes_leaves_no_wait_for_the_others(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        rear = changed(CAMERA, name="rear/camera", role="rear/camera")
        for each in (CAMERA, rear):
            await b.launcher.start(each)
        before = asyncio.all_tasks()
        first = asyncio.ensure_future(b.launcher.pending.first_decided([CAMERA.name, rear.name], 60.0))
        await asyncio.sleep(1)
        b.client.register(rear)
        assert await first == rear.name
        await asyncio.sleep(0)
        assert asyncio.all_tasks() <= before

    bench(NOTHING, tmp_path, body)


@pytest.mark.parametrize(("stopping", "grace"), [(0.0, STOP_GRACE), (12.0, 12.0)])
def test_a_component_has_the_time_to_end_that_it_asks_for(stopping: float, grace: float, tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        b.startable(CAMERA)
        b.client.report(reported(CAMERA, stopping=stopping))
        await b.launcher.registered(CAMERA)
        await b.launcher.end("front/camera")
        assert b.backend.ended == [("front/camera", StopTimes(0.0, grace))]
        assert b.client.disconnected == ["front/camera"] and b.client.life.handles == {}

    bench(NOTHING, tmp_path, body)


def test_a_program_without_the_api_is_ended_as_launch_does_and_a_relay_has_the_time_for_that(tmp_path: Path) -> None:
    """The relay ends its program itself: with SIGINT, after 5 s with SIGTERM, after 5 s more with SIGKILL."""
    preload, relay = (changed(CAMERA.component, gate=gate) for gate in ("preload", "relay"))
    slow = StopTimes(20.0, 1.0)
    assert stop_times(changed(preload, stop=slow)) == slow
    assert stop_times(changed(relay, stop=slow)) == StopTimes(0.0, 21.0 + STOP_GRACE)
    assert stop_times(preload) == StopTimes(5.0, 5.0)
    assert stop_times(relay) == StopTimes(0.0, 10.0 + STOP_GRACE)
    assert stop_times(relay, 12.0) == StopTimes(0.0, 22.0)

    async def body(b: Bench) -> None:
        b.backend.name = "ros2"
        gated = changed(CAMERA, component=preload)
        b.startable(gated)
        await b.launcher.start(gated)
        assert await b.launcher.abandon("front/camera") is None, "also one that has not registered"
        assert b.backend.ended == [("front/camera", StopTimes())]
        # A change that states other times needs no new process for them.
        b.client.register(gated)
        await b.launcher.registered(gated)
        b.launcher.redeclared([changed(gated, component=changed(preload, stop=slow)), BY_HAND])
        await b.launcher.end("front/camera")
        assert b.backend.ended[1:] == [("front/camera", slow)]

    bench(NOTHING, tmp_path, body)


@pytest.mark.parametrize(
    ("killed", "what"),
    [
        (RemainingProcess(101, "python3", 3.0), "front/camera"),
        (RemainingProcess(7, "sleep", 3.0), "`sleep` (process 7), which front/camera had started,"),
        (RemainingProcess(None, "talker", 3.0), "`talker`, behind the relay front/camera,"),
    ],
)
def test_what_had_to_be_killed_is_said(killed: RemainingProcess, what: str, tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        said: list[tuple[str, float, str, bool]] = []
        b.launcher.on_killed = lambda *told: said.append(told)
        b.startable(CAMERA)
        await b.launcher.registered(CAMERA)
        b.backend.killed["front/camera"] = [killed]
        await b.launcher.end("front/camera")
        words = f"{what} had not ended 3 s after it was asked to, and was killed (SIGKILL)"
        assert said == [("front/camera", 3.0, words, False)]

    bench(NOTHING, tmp_path, body)


def test_goals_are_known_of_what_has_crashed_and_not_of_what_has_its_name_then(tmp_path: Path) -> None:
    name = CAMERA.name

    async def body(b: Bench) -> None:
        said: list[tuple[str, float, str, bool]] = []
        b.launcher.on_killed = lambda *told: said.append(told)
        b.client.listeners.append(b.launcher.on_component_event)
        b.startable(CAMERA)
        await b.launcher.registered(CAMERA)
        b.client.life.record(name, ConnectionEvent.OPENED)
        b.launcher.begin_change()
        b.client.report(reported(CAMERA, goals=GoalCounts(accepted=3, ended=1), unfinished="it had a goal"))
        b.crash(name)
        b.client.disconnect(name)
        assert b.launcher.goals[name].in_progress == 2 and b.launcher.has_ended(name)
        b.client.life.missed(name, name, Exited(name, -9))
        assert b.launcher.has_ended(name)
        await b.launcher.registered(CAMERA)
        b.client.report(reported(CAMERA))
        assert (b.launcher.ended_goals[name].in_progress, b.launcher.goals[name]) == (2, GoalCounts())
        await b.launcher.end(name)
        assert b.launcher.ended_goals[name].in_progress == 2, "of the first one"
        assert said == [], "the new one has left nothing unfinished"
        b.launcher.begin_change()
        assert (b.launcher.goals, b.launcher.has_ended(name)) == ({}, False)

    bench(NOTHING, tmp_path, body)


def test_what_was_released_has_not_ended(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        b.client.listeners.append(b.launcher.on_component_event)
        b.client.report(reported(BY_HAND, goals=GoalCounts(accepted=3, ended=1)))
        await b.launcher.release("camera")
        assert b.launcher.goals["camera"].in_progress == 2 and not b.launcher.has_ended("camera")

    bench(build.system({"camera": BY_HAND.component}, []), tmp_path, body)


@pytest.mark.parametrize(("run", "words"), [("", "has an empty `run` command"), ("echo 'x", "cannot be split")])
def test_a_command_that_is_none_is_refused(run: str, words: str, tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        for _ in range(2):  # the first try leaves nothing in the way of another
            with pytest.raises(StartFailed, match=words):
                await b.launcher.start(instance("camera", started(build.source("Camera"), run)))
        assert b.backend.launches == [] and b.client.life.handles == {}

    bench(NOTHING, tmp_path, body)


@pytest.mark.parametrize("error", [StartFailed("no such program"), NodeError("no such socket"), CancelledError()])
def test_a_back_end_that_cannot_start_it_can_be_tried_again(error: BaseException, tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        b.backend.fail_start["front/camera"] = error
        with pytest.raises(type(error)):
            await b.launcher.start(CAMERA)
        assert b.client.life.handles == {}
        del b.backend.fail_start["front/camera"]
        b.startable(CAMERA)
        await b.launcher.registered(CAMERA)

    bench(NOTHING, tmp_path, body)


@pytest.mark.parametrize(
    ("started_", "words"),
    [
        (CAMERA, "it was started with `python3 'my camera.py' --fast`.*Its log: /logs/front/camera.log"),
        (BY_HAND, "it is started elsewhere"),
    ],
)
def test_a_component_that_does_not_register_is_ended(started_: Instance, words: str, tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        with pytest.raises(StartFailed, match=rf"{started_.name} did not register within .* s .*{words}"):
            await b.launcher.registered(started_)
        assert b.clock.steady() == pytest.approx(REGISTRATION_TIMEOUT)
        assert b.backend.running == set() and b.client.life.handles == {}
        assert [name for name, _ in b.backend.ended] == [launch.instance for launch in b.backend.launches]

    bench(NOTHING, tmp_path, body)


@pytest.mark.parametrize(
    ("exited", "words"),
    [
        (Exited("front/camera", 3, "no device\n"), r"front/camera exited with status 3 before it registered:\nno dev"),
        (Exited("front/camera", -9), "front/camera was killed by signal 9 .* and wrote nothing to its log"),
        (Exited("front/camera", None), "front/camera ended before it registered"),
    ],
)
def test_a_process_that_exits_first_says_how(exited: Exited, words: str, tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        registering = asyncio.ensure_future(b.launcher.registered(CAMERA))
        await asyncio.sleep(1)
        b.launcher.exited(Exited("another", 1))
        b.launcher.exited(exited)
        b.launcher.exited(exited)
        with pytest.raises(StartFailed, match=words):
            await registering
        assert b.clock.steady() == 1.0, "it is not waited for any longer"

    bench(NOTHING, tmp_path, body)


def test_one_that_states_how_long_it_takes_has_that_time_besides(tmp_path: Path) -> None:
    """And one that does not is named with how long it was waited for, and with what to state."""
    slow = changed(CAMERA, component=changed(CAMERA.component, startup_seconds=40.0))

    async def body(b: Bench) -> None:
        with pytest.raises(StartFailed, match=r"within 30 s .*If it needs longer, state `takes 60 s` after its `run`"):
            await b.launcher.registered(CAMERA)
        begun = b.clock.steady()
        registering = asyncio.ensure_future(b.launcher.registered(slow))
        await asyncio.sleep(REGISTRATION_TIMEOUT + 39.0)
        assert not registering.done()
        b.client.register(slow)
        await registering
        assert b.clock.steady() - begun == pytest.approx(REGISTRATION_TIMEOUT + 39.0, abs=1.0)

    bench(NOTHING, tmp_path, body)


def test_another_component_of_that_name_is_not_taken_for_it(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        b.client.register(CAMERA, token="another system's")
        with pytest.raises(StartFailed, match="another node called front/camera is running already"):
            await b.launcher.registered(CAMERA)
        assert b.client.sent == [], "it is not this system's"
        assert [name for name, _ in b.backend.ended] == ["front/camera"]

    bench(NOTHING, tmp_path, body)


def test_one_that_was_started_by_hand_has_no_token(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        b.client.register(BY_HAND, token="")
        await b.launcher.registered(BY_HAND)
        assert (b.backend.launches, b.client.life.handles) == ([], {})

    bench(NOTHING, tmp_path, body)


OTHER = started(build.source("Camera", rate=1.0))
EXTRA = (Endpoint(kind="service", name="/camera/reset"),)


@pytest.mark.parametrize(
    ("component", "endpoints", "words"),
    [
        (OTHER, (), "front/camera is not the Camera that was declared: .*1 Hz"),
        (CAMERA.component, EXTRA, "its node has service /camera/reset, which component Camera does not allow"),
    ],
)
def test_a_component_that_is_not_as_declared_is_ended(
    component: ComponentSpec, endpoints: tuple[Endpoint, ...], words: str, tmp_path: Path
) -> None:
    async def body(b: Bench) -> None:
        b.client.register(changed(CAMERA, component=component), endpoints=endpoints)
        with pytest.raises(StartFailed, match=words):
            await b.launcher.registered(CAMERA)
        assert b.client.sent == [] and b.backend.running == set()

    bench(NOTHING, tmp_path, body)


def test_one_that_refuses_its_welcome_is_ended(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        b.startable(CAMERA)
        b.client.reply("front/camera", WelcomeCommand, REFUSED)
        with pytest.raises(StartFailed, match=f"registered but could not be accepted: {REFUSED}"):
            await b.launcher.registered(CAMERA)
        assert b.backend.running == set()

    bench(NOTHING, tmp_path, body)


@pytest.mark.parametrize(
    ("status", "log", "words"),
    [
        (1, "no device\n", r"exited with status 1 before it was accepted:\nno device"),
        (-11, "", "was killed by signal 11"),
    ],
)
def test_one_that_has_ended_before_it_was_accepted_is_not_said_to_refuse(
    status: int, log: str, words: str, tmp_path: Path
) -> None:
    """A program without the API counts as registered at once, so it may have ended by then."""

    async def body(b: Bench) -> None:
        b.startable(CAMERA)
        b.client.reply("front/camera", ObserveCommand, REFUSED)
        await b.launcher.start(CAMERA)
        ended = Exited("front/camera", status, log)
        b.client.life.exited(ended)
        b.launcher.exited(ended)
        with pytest.raises(StartFailed, match=f"front/camera {words}"):
            await b.launcher.registered(CAMERA)

    bench(NOTHING, tmp_path, body)


def test_one_that_does_not_answer_has_time_while_others_start(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        other = changed(CAMERA, name="front/other")
        await b.launcher.start(other)
        b.startable(CAMERA)
        b.client.reply("front/camera", ObserveCommand, TIMEOUT, TIMEOUT, reported(CAMERA))
        await b.launcher.registered(CAMERA)
        assert len(b.client.of(ObserveCommand, "front/camera")) == 3
        assert "front/camera" in b.backend.running

        await b.launcher.end("front/camera")
        await b.launcher.abandon("front/other")
        b.client.reply("front/camera", ObserveCommand, TIMEOUT, reported(CAMERA))
        with pytest.raises(StartFailed, match=f"registered but could not be accepted: {TIMEOUT}"):
            await b.launcher.registered(CAMERA)
        assert b.backend.running == set()

    bench(NOTHING, tmp_path, body)


def test_one_that_was_stopped_has_no_more_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    async def body(b: Bench) -> None:
        await b.launcher.start(changed(CAMERA, name="front/other"))
        b.startable(CAMERA)
        b.client.reply("front/camera", ObserveCommand, TIMEOUT, reported(CAMERA))
        plant(monkeypatch, b.backend, "is_stopped", lambda instance: instance == "front/camera")
        with pytest.raises(StartFailed, match=f"registered but could not be accepted: {TIMEOUT}"):
            await b.launcher.registered(CAMERA)

    bench(NOTHING, tmp_path, body)


def test_a_start_that_is_cancelled_leaves_no_process(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        registering = asyncio.ensure_future(b.launcher.registered(CAMERA))
        await asyncio.sleep(1)
        registering.cancel()
        with pytest.raises(asyncio.CancelledError):
            await registering
        assert b.backend.running == set()
        b.startable(CAMERA)
        await b.launcher.registered(CAMERA)

    bench(NOTHING, tmp_path, body)


def test_abandoning_never_fails_and_keeps_what_could_not_be_ended(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        await b.launcher.abandon("unheard of")
        assert b.backend.ended == []
        await b.launcher.start(CAMERA)
        b.backend.fail_end["front/camera"] = BackendError("the kernel keeps it")
        await b.launcher.abandon("front/camera")
        assert list(b.client.life.handles) == ["front/camera"]
        assert b.client.life["front/camera"].process is ProcessState.STUCK
        with pytest.raises(BackendError, match="the kernel keeps it"):
            await b.launcher.end("front/camera")
        del b.backend.fail_end["front/camera"]
        await b.launcher.end("front/camera")
        assert b.client.life["front/camera"] == InstanceLife()

    bench(NOTHING, tmp_path, body)


def test_what_is_left_of_one_that_has_exited_is_ended_as_far_as_it_can_be(tmp_path: Path) -> None:
    """Its handle is kept until then, so that the next attempt, or the next manager, can end it."""

    async def body(b: Bench) -> None:
        name, exited = CAMERA.name, Exited(CAMERA.name, -9)
        await b.launcher.start(CAMERA)
        b.client.life.exited(exited)
        b.backend.fail_end[name] = BackendError("the kernel keeps it")
        for state in (ProcessState.EXITED, ProcessState.ABSENT):
            with pytest.raises(BackendError, match="the kernel keeps it"):
                await b.launcher.end(name)
            assert b.client.life[name].process is state and list(b.client.life.handles) == [name]
            b.client.life.take_exited({})  # it is not in the model: no role misses it
        b.backend.fail_end.clear()
        await b.launcher.end(name)
        assert b.client.life[name] == InstanceLife()

    bench(NOTHING, tmp_path, body)


@pytest.mark.parametrize("before", [True, False])
def test_one_that_exits_before_it_is_killed_or_meanwhile_has_exited(
    before: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    async def body(b: Bench) -> None:
        async def end(instance: str, stop: StopTimes) -> list[RemainingProcess]:
            b.client.life.exited(Exited(instance, 1))
            return []

        await b.launcher.start(CAMERA)
        if before:
            b.client.life.exited(Exited(CAMERA.name, 1))
        else:
            monkeypatch.setattr(b.backend, "end", end)
        await b.launcher.kill(CAMERA.name)
        assert b.client.life.exits == {CAMERA.name: Exited(CAMERA.name, None)} and b.client.life.handles == {}

    bench(NOTHING, tmp_path, body)


def test_one_that_exits_as_it_is_accepted_is_not_running(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        await b.launcher.start(CAMERA)
        b.client.register(CAMERA)
        b.client.life.exited(Exited(CAMERA.name, 1))
        await b.launcher.registered(CAMERA)
        assert b.client.life.has_exited(CAMERA.name)

    bench(NOTHING, tmp_path, body)


def test_one_whose_role_misses_it_can_be_ended_and_stays_missing(tmp_path: Path) -> None:
    """Its restart could not be undone: what was started is stuck, and exits later."""

    async def body(b: Bench) -> None:
        name, before = CAMERA.name, Exited(CAMERA.name, 1)
        await b.launcher.start(CAMERA)
        b.backend.fail_end[name] = BackendError("the kernel keeps it")
        await b.launcher.abandon(name)
        b.client.life.miss_again({name: before}, {})
        assert b.client.life.missing == {name: before} and list(b.client.life.handles) == [name]
        with pytest.raises(BackendError, match="the kernel keeps it"):
            await b.launcher.end(name)
        b.client.life.exited(Exited(name, -9))
        b.backend.fail_end.clear()
        await b.launcher.end(name)
        await b.launcher.abandon(name)  # as where a restart fails before it has started a process
        assert b.client.life.missing == {name: Exited(name, -9)} and b.client.life.handles == {}

    bench(NOTHING, tmp_path, body)


@pytest.mark.parametrize("again", [True, False])
def test_one_that_is_stuck_is_started_again_or_exits_after_all(again: bool, tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        await b.launcher.start(CAMERA)
        b.backend.fail_end[CAMERA.name] = BackendError("the kernel keeps it")
        await b.launcher.abandon(CAMERA.name)
        if again:
            await b.launcher.start(CAMERA)
            assert b.client.life[CAMERA.name].process is ProcessState.STARTING
        else:
            b.client.life.exited(Exited(CAMERA.name, -9))
            assert b.client.life.has_exited(CAMERA.name)

    bench(NOTHING, tmp_path, body)


def test_one_that_was_started_by_hand_is_released(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        b.attend(BY_HAND)
        await b.launcher.release("camera")
        assert b.client.commands("camera") == [ReleaseCommand(timeout=RELEASE_TIMEOUT)]
        assert b.client.disconnected == ["camera"]
        b.client.reply("camera", ReleaseCommand, UNREACHABLE)
        await b.launcher.release("camera")  # it has ended: nothing is left to release
        b.client.reply("camera", ReleaseCommand, TIMEOUT)
        with pytest.raises(type(TIMEOUT)):
            await b.launcher.release("camera")

    bench(NOTHING, tmp_path, body)


# -- components of an earlier manager ------------------------------------------------------------------

HANDLE = Handle("front/camera", 4711, 12.5)


def test_a_component_that_still_runs_is_adopted(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        assert await b.launcher.adopt(HANDLE, CAMERA.component) is None, "its process has ended"
        assert b.client.life.handles == {}
        b.backend.running.add("front/camera")
        b.client.register(CAMERA)
        state = reported(CAMERA, stopping=8.0)
        b.client.report(state)
        assert await b.launcher.adopt(HANDLE, CAMERA.component) == state
        assert b.client.life.handles == {"front/camera": HANDLE}
        await b.launcher.end("front/camera")
        assert b.backend.ended == [("front/camera", StopTimes(0.0, 8.0))]

    bench(NOTHING, tmp_path, body)


@pytest.mark.parametrize("owned", [True, False])
def test_a_component_that_runs_and_does_not_answer(owned: bool, tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        b.backend.running.add("front/camera")
        words = (
            r"front/camera runs \(process 4711\), but does not" if owned else "front/camera runs, but does not answer"
        )
        with pytest.raises(Unreachable, match=words):
            await b.launcher.adopt(HANDLE, CAMERA.component, owned=owned)
        assert b.clock.steady() == ADOPT_TIMEOUT

    bench(NOTHING, tmp_path, body)


def test_a_component_of_another_system_is_not_adopted(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        b.backend.running.add("listener")
        b.client.register(instance("listener", LISTENER), token="another system's")
        b.client.reply("listener", ObserveCommand, REFUSED)
        assert await b.launcher.adopt(Handle("listener"), CAMERA.component, owned=False) is None
        assert b.client.life.handles == {}

    bench(NOTHING, tmp_path, body)


def test_the_graph_forgets_what_was_started_and_not_recorded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    async def ended(token: str, known: Container[str], stop: StopTimes) -> list[str]:
        assert token == TOKEN and "talker" in known
        return ["late"]

    async def body(b: Bench) -> None:
        plant(monkeypatch, b.backend, "end_orphans", ended)
        assert await b.launcher.end_orphans({"talker"}) == ["late"]
        assert b.backend.ended == [("late", KILL_AT_ONCE)]

    bench(NOTHING, tmp_path, body)


def test_a_program_without_the_api_is_started_on_its_topics_under_its_own_name(tmp_path: Path) -> None:
    gated = changed(CAMERA, component=changed(CAMERA.component, gate="preload"), name="front/camera_2")

    async def body(b: Bench) -> None:
        with pytest.raises(StartFailed, match=r"has a gate \(`gate preload`\), and the back end .* has none"):
            await b.launcher.start(gated)
        b.backend.name = "ros2"
        assert await b.launcher.start(gated, topics={"out": "/image"})
        launch = b.backend.launches[-1]
        assert (launch.node, launch.foreign, launch.topics) == (
            "front/camera_2",
            gated.component,
            {"out": "/image"},
        )
        assert not b.launcher.takes_spare(gated)
        b.backend.name = "ros1"
        with pytest.raises(StartFailed, match=r"`gate preload`\), and the back end ros1 has `gate relay` only"):
            await b.launcher.start(changed(gated, name="front/camera_3"))
        relayed = changed(CAMERA, component=changed(CAMERA.component, gate="relay"), name="front/camera_4")
        assert await b.launcher.start(relayed)
        assert b.backend.launches[-1].node == "front/camera_4_relay"
        unnamed = changed(relayed, component=changed(relayed.component, unnamed=True), name="front/camera_5")
        with pytest.raises(
            StartFailed, match=r"the back end ros1 passes each program the name of its node: omit `unnamed`"
        ):
            await b.launcher.start(unnamed)

    bench(NOTHING, tmp_path, body)
