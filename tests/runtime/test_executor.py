"""The executor: steps in order, each checked and acknowledged before the model moves on, taken back where one fails."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import replace as changed
from pathlib import Path
from typing import Any

import pytest
from immutables import Map

from midstride.backends.simulator.virtual_clock import PROCESSORS, SimulatedClock
from midstride.errors import BackendError, EndUnknown, StartFailed, StepFailed
from midstride.model.action import Attach, Create, Degrade, Detach, Remove, SetParameters
from midstride.model.component import KILL_AT_ONCE, ParameterSpec
from midstride.model.configuration import Configuration
from midstride.runtime.backend_protocol import Exited
from midstride.runtime.change.executor import _estimates
from midstride.runtime.change.mode_changes import lower_modes
from midstride.runtime.change_observer import ChangeObserver
from midstride.runtime.process import pacing, pending_starts
from midstride.wire.commands import AttachCommand, Command, DetachCommand, ModesCommand, SetParametersCommand
from midstride.wire.replies import Attached, Detached
from tests.model import build
from tests.model.build import work
from tests.planting import plant
from tests.runtime.scripted import (
    LISTENER,
    REFUSED,
    TALKER,
    TIMEOUT,
    UNREACHABLE,
    Bench,
    Moves,
    bench,
    instance,
    started,
    talking,
)

OUT, IN = build.port("talker.out"), build.port("listener.in")
MOST = pacing.MOST_EACH * PROCESSORS
SECOND = instance("second", TALKER)
# The listener's functionality, then the talker's port, and the two back again.
DEGRADE, DETACH = Degrade(Map({work("listener"): 1})), Detach(OUT, "/chatter")


def test_each_step_is_carried_out_and_only_then_in_the_model(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        start = b.system.configuration
        sent: list[int] = []
        moves = Moves(lambda: sent.append(len(b.client.changes)))
        b.observers.append(moves)
        await b.carry_out([DEGRADE, DETACH])
        first = DEGRADE.effect(start)
        assert moves.seen == [(first, ["listener"]), (DETACH.effect(first), ["talker"])] and sent == [1, 2]
        assert b.system.configuration == moves.seen[-1][0] and b.system.revision == 2
        assert b.client.changes == [("listener", "modes"), ("talker", "detach")]
        assert b.words() == [
            "1/2 degrade listener.work from normal to degraded",
            "1/2 done",
            "2/2 detach talker.out from /chatter",
            "2/2 done",
        ]
        assert [(event.kind, event.index, event.total) for event in b.events.since()] == [
            (kind, index, 2) for index in (0, 1) for kind in ("step", "step_done")
        ]

    bench(talking(), tmp_path, body)


def test_a_step_whose_precondition_does_not_hold_reaches_no_component(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        start = b.system.configuration
        with pytest.raises(StepFailed, match=r"detach talker\.out from /chatter: cannot detach") as failed:
            await b.carry_out([DETACH])
        assert failed.value.outcome == "rolled_back"
        assert b.client.sent == []
        assert (b.system.configuration, b.system.revision) == (start, 0)

    bench(talking(), tmp_path, body)


def test_what_was_done_before_a_failure_is_undone_last_first(tmp_path: Path) -> None:
    configuration = build.system(
        {"talker": TALKER, "listener": LISTENER, "other": TALKER},
        ["talker.out /chatter", "listener.in /chatter"],
        modes={"talker.work": 0, "listener.work": 0},
    )

    async def body(b: Bench) -> None:
        b.client.reply("other", AttachCommand, REFUSED)
        with pytest.raises(StepFailed) as failed:
            await b.carry_out([DEGRADE, DETACH, Attach(build.port("other.out"), "/chatter"), Remove("talker")])
        assert failed.value.outcome == "rolled_back"
        assert str(failed.value) == f"attach other.out to /chatter: {REFUSED}"
        b.client.assert_order(
            ("listener", "modes"),
            ("talker", "detach"),
            ("other", "attach"),
            ("other", "undo detach"),  # the failed step leaves nothing either
            ("talker", "attach"),
            ("listener", "modes"),
        )
        assert [command.modes for command in b.client.of(ModesCommand, "listener")] == [
            {"work": "degraded"},
            {"work": "normal"},
        ]
        assert b.system.configuration == configuration
        assert b.backend.ended == []
        assert b.kinds()[-3:] == ["step_failed", "rollback", "rolled_back"]
        assert b.change.outcome == "rolled_back" and b.change.because == str(failed.value)

    bench(configuration, tmp_path, body)


def test_nothing_returns_to_an_instance_that_may_end_at_any_time(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        b.backend.fail_end["talker"] = EndUnknown("it may still end")
        with pytest.raises(StepFailed) as failed:
            await b.carry_out([DEGRADE, DETACH, Remove("talker")])
        assert failed.value.outcome == b.change.outcome == "failed"
        stays = "what has been done stays, as nothing can return to an instance that may end at any time"
        assert str(failed.value) == f"remove talker: it may still end; {stays}"
        assert b.client.changes == [("listener", "modes"), ("talker", "detach")]
        assert b.system.configuration == DETACH.effect(DEGRADE.effect(talking()))

    bench(talking(), tmp_path, body)


def test_a_roll_back_that_fails_is_in_the_reason_and_goes_on(tmp_path: Path) -> None:
    other = Degrade(Map({work("other"): 1}))
    configuration = build.system(
        {"talker": TALKER, "listener": LISTENER, "other": TALKER},
        ["talker.out /chatter", "listener.in /chatter"],
        modes={"talker.work": 0, "listener.work": 0, "other.work": 0},
    )

    async def body(b: Bench) -> None:
        b.client.reply("talker", AttachCommand, TIMEOUT)
        remove = Remove("listener")  # which is attached, so it fails
        with pytest.raises(StepFailed) as failed:
            await b.carry_out([other, DEGRADE, DETACH, remove])
        assert failed.value.outcome == "failed"
        assert f"; and the roll-back failed: attach talker.out to /chatter: {TIMEOUT}; upgrade listener" in str(
            failed.value
        )
        b.client.assert_order(("talker", "attach"), ("talker", "undo detach"), ("other", "modes"))
        assert b.system.configuration == DETACH.effect(DEGRADE.effect(configuration)), "the model says what is so"
        assert b.kinds()[-1] == "rollback_failed"

    bench(configuration, tmp_path, body)


def test_what_the_change_created_is_killed_where_it_does_not_answer(tmp_path: Path) -> None:
    """A frozen new component does not keep the system from its old state."""

    async def body(b: Bench) -> None:
        b.backend.instances["second"] = SECOND
        b.client.reply("second", DetachCommand, TIMEOUT)
        b.client.reply("listener", ModesCommand, REFUSED)
        attach = Attach(build.port("second.out"), "/chatter")
        with pytest.raises(StepFailed) as failed:
            await b.carry_out([Create(SECOND), attach, DEGRADE])
        assert (failed.value.outcome, str(failed.value).count("roll-back")) == ("rolled_back", 0)
        assert b.backend.ended == [("second", KILL_AT_ONCE)]
        assert b.system.configuration == talking()
        assert "second was created by this change and does not answer: it was killed" in b.words()

    bench(talking(), tmp_path, body)


def test_beside_one_that_has_exited_the_other_one_is_killed(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        b.crash("talker")
        assert await b.executor._back._kill(["talker", "listener"])
        assert b.backend.ended == [("listener", KILL_AT_ONCE)]

    bench(talking(), tmp_path, body)


def test_what_is_measured_is_named_by_its_kind_and_a_start_beside_another_is_not_measured() -> None:
    create, third = Create(SECOND), Create(instance("third", TALKER))
    assert _estimates(create, talking(), [create, DETACH]) == "create Talker"
    assert _estimates(create, talking(), [create, third]) is None
    assert _estimates(Remove("listener"), talking(), []) == "remove Listener"
    assert _estimates(DETACH, talking(), []) == "detach"


def test_a_created_component_that_is_silent_is_not_asked_before_it_is_killed(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        b.backend.instances["second"] = SECOND

        async def freezes(_: Command[Any]) -> Any:
            del b.client.states["second"]
            return TIMEOUT

        b.client.reply("second", AttachCommand, freezes)
        with pytest.raises(StepFailed) as failed:
            await b.carry_out([DEGRADE, Create(SECOND), Attach(build.port("second.out"), "/chatter")])
        assert failed.value.outcome == "rolled_back"
        assert b.backend.ended == [("second", KILL_AT_ONCE)]
        assert b.system.configuration == talking()

    bench(talking(), tmp_path, body)


def test_a_step_that_is_rejected_once_it_is_done_is_undone_as_well(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        class Rejection(ChangeObserver):
            async def step_done(self, configuration: Configuration) -> None:
                assert configuration == DEGRADE.effect(talking())
                raise BackendError("this is not what was asked for")

        b.observers.append(Rejection())
        with pytest.raises(
            StepFailed, match=r"degrade listener\.work from normal to degraded: this is not what was asked for"
        ):
            await b.carry_out([DEGRADE, DETACH])
        assert b.client.changes == [("listener", "modes"), ("listener", "modes")]
        assert b.system.configuration == talking()

    bench(talking(), tmp_path, body)


def test_an_unexpected_error_is_taken_back_and_logged(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    async def body(b: Bench) -> None:
        b.client.reply("talker", DetachCommand, KeyError("what is this?"))
        with pytest.raises(StepFailed, match=r"internal error: KeyError: 'what is this\?'") as failed:
            await b.carry_out([DEGRADE, DETACH])
        assert failed.value.outcome == "rolled_back"
        assert b.system.configuration == talking()

    bench(talking(), tmp_path, body)
    assert "Traceback" in caplog.text


def slow(b: Bench, command: type[Command[Any]], reply: Any) -> tuple[asyncio.Event, asyncio.Event]:
    """The talker replies to such a command when it may: set when it has been asked, and when it may."""
    asked, may = asyncio.Event(), asyncio.Event()

    async def replied() -> Any:
        asked.set()
        await may.wait()
        return reply

    b.client.reply("talker", command, lambda _: replied())
    return asked, may


def test_cancelled_during_a_step_it_waits_for_its_end_and_takes_everything_back(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        detaching, answered = slow(b, DetachCommand, Detached(acknowledged=True, last=None))
        running = asyncio.ensure_future(b.carry_out([DEGRADE, DETACH]))
        await detaching.wait()
        running.cancel()
        await asyncio.sleep(1)
        assert not running.done(), "the component may still carry the command out"
        answered.set()
        with pytest.raises(asyncio.CancelledError):
            await running
        b.client.assert_order(("talker", "detach"), ("talker", "attach"), ("listener", "modes"))
        assert b.system.configuration == talking()
        assert "step_failed" in b.kinds() and "the manager is shutting down" in b.words("step_failed")[0]

    bench(talking(), tmp_path, body)


def test_cancelled_during_a_creation_it_is_broken_off_at_once(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        running = asyncio.ensure_future(b.carry_out([Create(SECOND)]))
        await asyncio.sleep(1)
        assert b.saved() == ["second"]
        running.cancel()
        with pytest.raises(asyncio.CancelledError):
            await running
        assert b.clock.steady() == 1.0
        assert b.backend.running == {"talker", "listener"} and b.saved() == []
        assert b.system.configuration == talking()

    bench(talking(), tmp_path, body)


def test_cancelled_while_it_rolls_back_it_takes_everything_back(tmp_path: Path) -> None:
    """The reason why it failed is what the change ends with: the manager's end has not caused it."""

    async def body(b: Bench) -> None:
        asked, may = slow(b, AttachCommand, Attached(matched=1))
        b.backend.fail_start["second"] = StartFailed("there is no such program")
        running = asyncio.ensure_future(b.carry_out([DEGRADE, DETACH, Create(SECOND)]))
        await asked.wait()
        for _ in range(2):  # however often
            running.cancel()
            await asyncio.sleep(1)
        assert not running.done()
        may.set()
        with pytest.raises(StepFailed, match="there is no such program") as failed:
            await running
        assert failed.value.outcome == "rolled_back" and b.executor.interrupted
        assert b.system.configuration == talking()

    bench(talking(), tmp_path, body)


def test_cancelled_where_it_cannot_take_back_it_says_so(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        detaching, may = slow(b, DetachCommand, Detached(acknowledged=True, last=None))
        b.client.reply("talker", AttachCommand, REFUSED)
        running = asyncio.ensure_future(b.carry_out([DEGRADE, DETACH]))
        await detaching.wait()
        running.cancel()
        may.set()
        with pytest.raises(StepFailed, match="the manager is shutting down; and the roll-back failed") as failed:
            await running
        assert failed.value.outcome == "failed"

    bench(talking(), tmp_path, body)


def test_creations_in_a_row_are_started_at_once(tmp_path: Path) -> None:
    third = instance("third", TALKER)

    async def body(b: Bench) -> None:
        b.client.life.adopted("third", None)
        b.crash("third")
        running = asyncio.ensure_future(b.carry_out([Create(SECOND), Create(third)]))
        await asyncio.sleep(1)
        assert [launch.instance for launch in b.backend.launches] == ["second", "third"]
        assert b.system.life.exits == {}, "another process has the name"
        assert b.system.configuration == talking(), "none of them has registered"
        b.client.register(third)
        b.client.register(SECOND)
        await running
        assert set(b.system.configuration.instances) == {"talker", "listener", "second", "third"}
        assert len(b.backend.launches) == 2

    bench(talking(), tmp_path, body)


def registering_one_a_second(tmp_path: Path, idle: Callable[[float], float]) -> list[int]:
    """How many processes were starting each second, while one registered; ``idle`` is that of the processors."""
    many = [instance(f"extra_{number}", TALKER) for number in range(3 * MOST)]
    starting = []

    async def body(b: Bench) -> None:
        b.clock.idle = lambda: idle(b.clock.steady())  # type: ignore[method-assign]
        running = asyncio.ensure_future(b.carry_out([Create(each) for each in many]))
        for each in many:
            await asyncio.sleep(1)
            starting.append(b.launcher.pending.count())
            assert each.name in b.backend.running, "the next one is always starting"
            b.client.register(each)
        await running
        assert [launch.instance for launch in b.backend.launches] == [each.name for each in many]

    bench(talking(), tmp_path, body)
    return starting


def test_on_busy_processors_one_start_for_each_is_under_way(tmp_path: Path) -> None:
    counts = registering_one_a_second(tmp_path, lambda now: 0.04 * now)
    assert set(counts[:-PROCESSORS]) == {PROCESSORS}


def test_on_idle_processors_more_are_under_way_up_to_a_bound(tmp_path: Path) -> None:
    """They wait for something else, as a driver for its device."""
    counts = registering_one_a_second(tmp_path, lambda now: 0.6 * now)
    assert counts[0] > PROCESSORS and max(counts) == MOST


def hung(tmp_path: Path, others: int, every: float) -> tuple[float, str]:
    """When the run fails and why, if the first process never registers, and the others do, one after ``every`` (s)."""
    frozen, *rest = many = [instance(f"extra_{number}", TALKER) for number in range(others + 1)]
    failed: list[tuple[float, str]] = []

    async def body(b: Bench) -> None:
        async def register() -> None:
            for each in rest:
                await asyncio.sleep(every)
                b.client.register(each)

        registering = asyncio.ensure_future(register())
        with pytest.raises(StepFailed) as error:
            await b.carry_out([Create(each) for each in many])
        failed.append((b.clock.steady(), str(error.value)))
        registering.cancel()
        assert b.backend.running == {"talker", "listener"} and b.saved() == []

    bench(talking(), tmp_path, body)
    assert f"{frozen.name} did not register within" in failed[0][1]
    return failed[0]


def test_while_others_register_a_start_has_more_time(tmp_path: Path) -> None:
    others = PROCESSORS - 1
    at, why = hung(tmp_path, others, every=20)
    assert at == pytest.approx(20 * others + pending_starts.REGISTRATION_TIMEOUT)
    assert f"within {at:g} s" in why


def test_registration_is_not_awaited_without_limit_while_others_register(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plant(monkeypatch, SimulatedClock, "processors", lambda self: 100)
    at, _ = hung(tmp_path, 50, every=20)
    assert at == pytest.approx(pending_starts.REGISTRATION_LIMIT)


def test_where_one_creation_fails_what_was_started_ahead_is_ended(tmp_path: Path) -> None:
    third = instance("third", TALKER)

    async def body(b: Bench) -> None:
        b.startable(third)
        with pytest.raises(StepFailed, match="second did not register"):
            await b.carry_out([Create(SECOND), Create(third), DEGRADE])
        assert b.backend.running == {"talker", "listener"}
        assert b.saved() == []

    bench(talking(), tmp_path, body)


@pytest.mark.parametrize("exits", [True, False])
def test_the_component_that_could_not_start_is_named_and_not_the_one_beside_it(exits: bool, tmp_path: Path) -> None:
    """The second one waits for the third before it registers, say: it is not to blame, and not waited for."""
    third = instance("third", TALKER)

    async def body(b: Bench) -> None:
        if not exits:
            b.backend.fail_start["third"] = StartFailed("cannot start `./nosuch --x`")
        running = asyncio.ensure_future(b.carry_out([Create(SECOND), Create(third), DEGRADE]))
        while "third" not in [launch.instance for launch in b.backend.launches]:
            await asyncio.sleep(0.01)
        b.launcher.exited(Exited("third", 2, "no such file"))
        expected = (
            r"third exited with status 2 before it registered:\nno such file" if exits else "cannot start `./nosuch"
        )
        with pytest.raises(StepFailed, match=rf"^create third \(Talker\): {expected}"):
            await running
        assert b.clock.steady() < 5
        (failed,) = [event for event in b.events.since() if event.kind == "step_failed"]
        assert failed.index == 1 and failed.words.startswith("create third (Talker) failed: ")
        assert b.backend.running == {"talker", "listener"} and b.saved() == []

    bench(talking(), tmp_path, body)


def test_what_cannot_be_ended_again_is_kept_for_the_next_manager(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        b.backend.fail_end["second"] = BackendError("the kernel keeps it")
        with pytest.raises(StepFailed, match="second did not register"):
            await b.carry_out([Create(SECOND)])
        assert b.saved() == ["second"]

    bench(talking(), tmp_path, body)


def test_what_the_next_manager_finds_follows_the_steps(tmp_path: Path) -> None:
    tuned = started(
        build.component("Tuned", {}, [], [build.mode("normal")], parameters={"gain": ParameterSpec(1, True)})
    )

    async def body(b: Bench) -> None:
        added = instance("tuned", tuned)
        b.startable(added)
        await b.carry_out([Create(added), SetParameters("tuned", Map(gain=2))])
        [saved] = b.saved_instances()
        assert saved == changed(added, parameters=Map(gain=2)) == b.system.configuration.instances["tuned"]
        assert b.client.of(SetParametersCommand, "tuned") == [SetParametersCommand(parameters={"gain": 2})]
        with pytest.raises(StepFailed):
            await b.carry_out([Remove("tuned"), Remove("talker")])  # which is attached, so it fails
        assert b.saved_instances() == [saved], "the roll-back has started it again"
        await b.carry_out([Remove("tuned")])
        assert b.saved() == []

    bench(talking(), tmp_path, body)


def test_what_a_roll_back_could_not_start_again_is_not_saved(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        b.startable(SECOND)
        await b.carry_out([Create(SECOND)])
        b.backend.instances.clear()  # it does not register any more
        with pytest.raises(
            StepFailed, match=r"the roll-back failed: create second \(Talker\): second did not register"
        ):
            await b.carry_out([Remove("second"), Remove("talker")])  # which is attached, so it fails
        assert b.backend.running == {"talker", "listener"} and b.saved() == []

    bench(talking(), tmp_path, body)


# -- lowering ------------------------------------------------------------------------------------------


def test_lowering_needs_no_precondition_and_notes_only_those_that_answer(tmp_path: Path) -> None:
    """The talker is lowered while the listener relies on it; its failure does not keep the listener from following."""

    async def body(b: Bench) -> None:
        b.client.reply("talker", ModesCommand, UNREACHABLE)
        left = await lower_modes(
            {work("talker"): 1, work("listener"): 1},
            "the camera exited unexpectedly",
            b.client,
            b.system,
            b.events,
        )
        assert left == {work("talker"): UNREACHABLE}
        [command] = b.client.of(ModesCommand, "listener")
        assert command.because == "the camera exited unexpectedly"
        assert b.words("degraded") == ["degrade listener.work from normal to degraded"]
        assert b.words("note") == [f"degrade talker.work from normal to degraded failed: {UNREACHABLE}"]
        assert b.client.changes == [("listener", "modes"), ("talker", "modes")], "it is not raised again"

    bench(talking(), tmp_path, body)


def test_where_nothing_can_be_lowered_the_model_stays(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        b.client.reply("listener", ModesCommand, TIMEOUT)
        left = await lower_modes({work("listener"): 1}, "", b.client, b.system, b.events)
        assert left == {work("listener"): TIMEOUT}
        assert await lower_modes({}, "", b.client, b.system, b.events) == {}
        assert (b.system.configuration, b.system.revision) == (talking(), 0)

    bench(talking(), tmp_path, body)
