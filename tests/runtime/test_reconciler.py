"""The reconciler: crashes and degradations are taken into the model at once, and what relied on them is lowered."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import pytest

from midstride.backends.simulator.virtual_loop import run
from midstride.errors import RevisionChanged, StartFailed
from midstride.model.configuration import Configuration
from midstride.runtime.backend_protocol import Exited
from midstride.runtime.change.mode_changes import DRAIN_TIMEOUT
from midstride.runtime.change.reconciler import DETACH_INTERVAL
from midstride.runtime.process.component_client import Disconnected
from midstride.wire import replies
from midstride.wire.commands import CancelCutCommand, DetachCommand, ModesCommand
from midstride.wire.state import LinkState
from tests.model import build
from tests.model.build import work
from tests.runtime.scripted import (
    LISTENER,
    REFUSED,
    TALKER,
    TIMEOUT,
    UNREACHABLE,
    ReconcilingBench,
    instance,
    reported,
    started,
    talking,
)

TALKER_EXITED = Exited("talker", -9, "no device")
DEGRADED_LISTENER = {work("listener"): 1}


def reconciling(
    configuration: Configuration, path: Path, body: Callable[[ReconcilingBench], Coroutine[Any, Any, None]]
) -> None:
    async def main() -> None:
        r = ReconcilingBench(configuration, path)
        try:
            await body(r)
        finally:
            await r.reconciler.close()

    run(main())


async def moment() -> None:
    """Until what has been set off is done."""
    await asyncio.sleep(0.001)


# -- crashes -------------------------------------------------------------------------------------------


def test_a_crash_takes_the_instance_out_of_the_model_and_lowers_what_relied_on_it(tmp_path: Path) -> None:
    async def body(r: ReconcilingBench) -> None:
        r.exits(TALKER_EXITED)
        await moment()
        assert r.system.configuration == talking().without_instance("talker").with_modes(DEGRADED_LISTENER)
        assert r.client.of(ModesCommand) == [
            ModesCommand(modes={"work": "degraded"}, because="talker exited unexpectedly", timeout=DRAIN_TIMEOUT)
        ]
        [event] = [event for event in r.events.since() if event.kind == "exited"]
        assert (event.words, event.log) == ("talker exited unexpectedly (status -9)", "no device")
        assert "talker" not in r.client.life.handles and r.client.disconnected == ["talker"]
        assert r.saved() == ["listener"]
        assert {**r.system.life.missing, **r.system.life.exits} == {"talker": TALKER_EXITED}

    reconciling(talking(), tmp_path, body)


def test_of_one_that_the_model_has_no_more_the_connection_is_given_up(tmp_path: Path) -> None:
    """As of the old instance of a change that ended meanwhile: another process may get its name."""

    async def body(r: ReconcilingBench) -> None:
        r.system.moved(talking().without_instance("talker"))
        r.exits(TALKER_EXITED)
        await moment()
        assert r.client.disconnected == ["talker"]

    reconciling(talking(), tmp_path, body)


def test_what_nothing_relies_on_lowers_nothing(tmp_path: Path) -> None:
    async def body(r: ReconcilingBench) -> None:
        r.exits(Exited("listener", None))
        await moment()
        assert r.system.configuration == talking().without_instance("listener") and r.system.revision == 1
        assert r.client.sent == []
        assert r.words("exited") == ["listener exited unexpectedly"]

    reconciling(talking(), tmp_path, body)


def test_two_crashes_at_once_are_one_step(tmp_path: Path) -> None:
    """The filter is not lowered: it is no longer there when what it relied on is looked at."""
    configuration = build.system(
        {"talker": TALKER, "filter": started(build.filter_()), "listener": LISTENER},
        ["talker.out /raw", "filter.in /raw", "filter.out /chatter", "listener.in /chatter"],
        modes={"talker.work": 0, "filter.work": 0, "listener.work": 0},
    )

    async def body(r: ReconcilingBench) -> None:
        r.exits(TALKER_EXITED)
        r.exits(Exited("filter", 1))
        await moment()
        assert r.client.changes == [("listener", "modes")]
        assert list(r.system.configuration.instances) == ["listener"]
        because = "filter exited unexpectedly; talker exited unexpectedly"
        assert [command.because for command in r.client.of(ModesCommand)] == [because]

    reconciling(configuration, tmp_path, body)


def test_an_exit_during_a_start_fails_the_start_and_is_no_crash(tmp_path: Path) -> None:
    async def body(r: ReconcilingBench) -> None:
        starting = asyncio.ensure_future(r.launcher.registered(instance("second", build.source())))
        await moment()
        r.exits(Exited("second", 1))
        with pytest.raises(StartFailed, match="second exited with status 1 before it registered"):
            await starting
        assert r.system.revision == 0 and r.kinds() == []

    reconciling(talking(), tmp_path, body)


def test_a_component_that_was_started_by_hand_is_gone_with_its_connection(tmp_path: Path) -> None:
    async def body(r: ReconcilingBench) -> None:
        r.reconciler.on_component_event(Disconnected("listener"))  # it has a process, whose exit is the news
        r.reconciler.on_component_event(Disconnected("unheard of"))
        await moment()
        assert r.system.revision == 0
        r.client.states.pop("talker")
        r.reconciler.on_component_event(Disconnected("talker"))
        await moment()
        assert sorted(r.system.configuration.instances) == ["listener"]
        assert r.words("exited") == ["talker exited unexpectedly"]
        assert r.backend.disconnections == ["talker"], "only the control connection knows of it"

    reconciling(talking(talker=build.source("Talker")), tmp_path, body)


@pytest.mark.parametrize("name", ["talker", "listener"])
def test_a_component_that_cannot_be_reached_and_may_run_stays_in_the_model(name: str, tmp_path: Path) -> None:
    async def body(r: ReconcilingBench) -> None:
        r.reconciler.on_component_event(Disconnected(name, exited=False))
        r.reconciler.on_component_event(Disconnected("unheard of", exited=False))
        await moment()
        assert r.system.revision == 0 and r.words("exited") == []
        assert r.words("note") == [f"{name} cannot be reached any more; its process may still run"]

    reconciling(talking(talker=build.source("Talker")), tmp_path, body)


def test_of_a_component_whose_exit_is_known_it_is_not_said_that_it_may_run(tmp_path: Path) -> None:
    async def body(r: ReconcilingBench) -> None:
        r.exits(TALKER_EXITED)
        r.reconciler.on_component_event(Disconnected("talker", exited=False))
        await moment()
        assert r.words("note") == []

    reconciling(talking(), tmp_path, body)


def test_what_could_not_be_lowered_is_lowered_the_next_time(tmp_path: Path) -> None:
    async def body(r: ReconcilingBench) -> None:
        r.client.reply("listener", ModesCommand, TIMEOUT)
        r.exits(TALKER_EXITED)
        await moment()
        assert r.system.configuration == talking().without_instance("talker")
        r.client.reply("listener", ModesCommand)
        await r.reconciler.reconcile()
        assert r.system.configuration == talking().without_instance("talker").with_modes(DEGRADED_LISTENER)
        assert r.client.of(ModesCommand)[-1].because == "what it relied on was gone before it could be degraded"
        await r.reconciler.reconcile()
        assert len(r.client.of(ModesCommand)) == 2, "it is done"

    reconciling(talking(), tmp_path, body)


def test_a_component_that_did_not_answer_is_degraded_as_soon_as_it_answers_again(tmp_path: Path) -> None:
    """As after SIGSTOP and SIGCONT: no command and no crash is needed."""

    async def body(r: ReconcilingBench) -> None:
        listener = reported(r.configuration.instances["listener"], talking())
        r.client.reply("listener", ModesCommand, TIMEOUT, TIMEOUT, None)
        r.exits(TALKER_EXITED)
        await moment()
        for attempts in (2, 3):
            r.client.report(listener)
            r.client.report(listener)  # during the attempt
            await moment()
            assert len(r.client.of(ModesCommand)) == attempts
        r.degrades("listener")
        await moment()
        assert len(r.client.of(ModesCommand)) == 3
        assert r.system.configuration == talking().without_instance("talker").with_modes(DEGRADED_LISTENER)

    reconciling(talking(), tmp_path, body)


def test_a_component_that_refuses_to_degrade_is_not_asked_again_at_each_report(tmp_path: Path) -> None:
    async def body(r: ReconcilingBench) -> None:
        r.client.reply("listener", ModesCommand, REFUSED)
        r.exits(TALKER_EXITED)
        await moment()
        r.client.report(reported(r.configuration.instances["listener"], talking()))
        await moment()
        assert len(r.client.of(ModesCommand)) == 1
        await r.reconciler.reconcile()
        assert len(r.client.of(ModesCommand)) == 2

    reconciling(talking(), tmp_path, body)


def test_a_component_that_has_just_changed_is_degraded_all_the_same(tmp_path: Path) -> None:
    """It was stopped, and carries out what it was sent before that between being observed and being degraded."""

    async def body(r: ReconcilingBench) -> None:
        r.client.reply("listener", ModesCommand, RevisionChanged("it is at revision 11"), None)
        r.exits(TALKER_EXITED)
        await moment()
        assert len(r.client.of(ModesCommand)) == 2
        assert r.system.configuration == talking().without_instance("talker").with_modes(DEGRADED_LISTENER)

    reconciling(talking(), tmp_path, body)


def test_a_degradation_that_was_carried_out_late_is_not_called_unexpected(tmp_path: Path) -> None:
    """The component was stopped when the command arrived, and reads it once it continues."""

    async def body(r: ReconcilingBench) -> None:
        r.client.reply("listener", ModesCommand, TIMEOUT)
        r.exits(TALKER_EXITED)
        await moment()
        r.degrades("listener")
        await moment()
        assert r.system.configuration == talking().without_instance("talker").with_modes(DEGRADED_LISTENER)
        assert r.words("degraded") == ["listener.work entered mode degraded"]
        assert r.reconciler.degraded == set() and len(r.client.of(ModesCommand)) == 1

    reconciling(talking(), tmp_path, body)


def test_what_could_not_be_lowered_and_crashes_as_well_is_forgotten(tmp_path: Path) -> None:
    async def body(r: ReconcilingBench) -> None:
        r.client.reply("listener", ModesCommand, UNREACHABLE)
        r.exits(TALKER_EXITED)
        await moment()
        r.exits(Exited("listener", -9))
        await moment()
        assert list(r.system.configuration.instances) == []
        assert len(r.client.of(ModesCommand)) == 1

    reconciling(talking(), tmp_path, body)


# -- degradations --------------------------------------------------------------------------------------


def test_a_component_that_degrades_is_believed_and_what_relies_on_it_is_lowered(tmp_path: Path) -> None:
    async def body(r: ReconcilingBench) -> None:
        r.degrades("talker")
        await moment()
        assert r.system.configuration == talking().with_modes({work("talker"): 1, work("listener"): 1})
        assert r.client.changes == [("listener", "modes")], "the talker has degraded already"
        assert r.client.accepted == ["talker"]
        assert r.reconciler.degraded == {work("talker")}
        [event, _] = [event for event in r.events.since() if event.kind == "degraded"]
        assert event.words == "talker.work entered mode degraded unexpectedly" and event.functionality == "talker.work"
        r.degrades("talker")
        await moment()
        assert r.system.revision == 2, "it is no news"

    reconciling(talking(), tmp_path, body)


def test_a_component_in_a_better_mode_than_it_should_be_is_left_alone(tmp_path: Path) -> None:
    """A mode change of a plan may be under way; and raising is a plan's affair."""

    async def body(r: ReconcilingBench) -> None:
        r.client.report(reported(r.configuration.instances["listener"], talking()))
        await r.reconciler.reconcile()
        assert r.system.revision == 0 and r.client.sent == []

    reconciling(talking().with_modes(DEGRADED_LISTENER), tmp_path, body)


def test_a_better_mode_that_lacks_its_support_is_left_again(tmp_path: Path) -> None:
    """A command of a step that was taken back has been carried out after all, once the component went on."""
    configuration = talking().with_modes(DEGRADED_LISTENER).without_instance("talker")

    async def body(r: ReconcilingBench) -> None:
        r.client.report(reported(r.configuration.instances["listener"], talking()))
        await moment()
        assert [command.modes for command in r.client.of(ModesCommand, "listener")] == [{"work": "degraded"}]
        assert r.system.configuration == configuration
        assert r.words("note") == ["listener.work is in mode normal, by its own report"]

    reconciling(configuration, tmp_path, body)


def test_an_output_that_has_handed_over_after_all_is_detached(tmp_path: Path) -> None:
    """A hand-over that the manager could not follow has been carried out: the old side must not write again later."""

    async def body(r: ReconcilingBench) -> None:
        r.client.report(reported(r.configuration.instances["talker"], talking(), gates={"out /chatter": "closed"}))
        await r.reconciler.reconcile()
        assert r.words("note") == [
            "talker.out is not attached to /chatter any more, by its own report",
            "talker.out has been taken off /chatter, where a hand-over had closed its gate",
        ]
        [detached] = r.client.of(DetachCommand, "talker")
        assert (detached.port, detached.topic) == ("out", "/chatter")

    reconciling(talking(), tmp_path, body)


def test_the_old_side_of_a_cut_is_told_that_it_may_write_again_before_it_is_taken_to_have_handed_over(
    tmp_path: Path,
) -> None:
    async def body(r: ReconcilingBench) -> None:
        r.client.owe("talker", CancelCutCommand(cut="1", freed=True))
        r.client.report(reported(r.configuration.instances["talker"], talking(), gates={"out /chatter": "closed"}))
        await r.reconciler.reconcile()
        r.client.assert_order(("talker", "undo cancel_cut"), ("talker", "undo detach"))

    reconciling(talking(), tmp_path, body)


def test_an_output_that_a_hand_over_has_left_closed_is_detached_also_where_the_model_does_not_have_it(
    tmp_path: Path,
) -> None:
    """It could not be reached when it was to be detached: its gate opens again once the new side has gone."""
    configuration = talking().without_attachment(build.port("talker.out"), "/chatter").with_modes(DEGRADED_LISTENER)

    async def body(r: ReconcilingBench) -> None:
        left = reported(r.configuration.instances["talker"], talking(), gates={"out /chatter": "closed"})
        r.busy = True
        r.client.report(left)
        await moment()
        assert r.client.sent == [], "the gate of the new side of a hand-over in progress is closed too"
        r.busy = False
        r.client.reply("talker", DetachCommand, TIMEOUT, replies.Detached(acknowledged=True, last=None))
        for _ in range(5):
            r.client.report(left)
            await moment()
        assert len(r.client.of(DetachCommand)) == 1 and r.words("note") == [], "commands wait while it is tried"
        await asyncio.sleep(DETACH_INTERVAL)
        r.client.report(left)
        await moment()
        assert r.words("note") == ["talker.out has been taken off /chatter, where a hand-over had closed its gate"]
        assert [(each.port, each.topic) for each in r.client.of(DetachCommand)] == 2 * [("out", "/chatter")]
        assert r.system.configuration == configuration

    reconciling(configuration, tmp_path, body)


@pytest.mark.parametrize("link", [None, LinkState(gate="closed", count=0, fenced=True)])
def test_an_output_that_is_gone_or_fenced_is_not_detached(link: LinkState | None, tmp_path: Path) -> None:
    async def body(r: ReconcilingBench) -> None:
        state = reported(r.configuration.instances["talker"], talking())
        ports = {"out": {} if link is None else {"/chatter": link}}
        r.client.report(msgspec.structs.replace(state, ports=ports))
        await r.reconciler.reconcile()
        assert r.client.of(DetachCommand) == []

    reconciling(talking(), tmp_path, body)


def test_the_output_of_a_lifecycle_node_that_is_slow_to_become_active_again_is_not_detached(tmp_path: Path) -> None:
    configuration = talking(talker=replace(TALKER, gate="lifecycle"))

    async def body(r: ReconcilingBench) -> None:
        r.client.report(reported(r.configuration.instances["talker"], talking(), gates={"out /chatter": "closed"}))
        await r.reconciler.reconcile()
        r.client.report(reported(r.configuration.instances["talker"], talking()))
        await r.reconciler.reconcile()
        assert r.client.of(DetachCommand) == []
        assert r.system.configuration.attached_ports("talker") == configuration.attached_ports("talker") != []

    reconciling(configuration, tmp_path, body)


# -- commands ------------------------------------------------------------------------------------------


def test_during_a_command_nothing_is_changed_beside_it(tmp_path: Path) -> None:
    async def body(r: ReconcilingBench) -> None:
        r.busy = True
        async with r.reconciler.command("a test"):
            r.exits(TALKER_EXITED)
            r.degrades("listener")
            await moment()
            assert r.system.revision == 0
            assert r.words("exited"), "but it is known at once"
        assert r.system.configuration == talking().without_instance("talker").with_modes(DEGRADED_LISTENER)
        assert r.client.sent == [], "the listener has degraded by itself"

    reconciling(talking(), tmp_path, body)


def test_a_command_begins_with_what_has_happened(tmp_path: Path) -> None:
    async def body(r: ReconcilingBench) -> None:
        r.busy = True
        r.exits(TALKER_EXITED)
        async with r.reconciler.command("a test"):
            assert "talker" not in r.system.configuration.instances

    reconciling(talking(), tmp_path, body)


def test_a_command_may_expect_what_has_been_reported_unless_the_model_lacks_it(tmp_path: Path) -> None:
    """The worst mode of a functionality may have raised: that changes nothing but the revision of its component."""

    async def body(r: ReconcilingBench) -> None:
        r.busy = True
        for name in ("talker", "listener"):
            r.client.report(reported(r.configuration.instances[name], talking()))
        async with r.reconciler.command("a test"):
            assert r.client.accepted == ["listener", "talker"]
        r.client.accepted.clear()
        r.degrades("talker")
        r.reconciler._accept_reported()
        assert r.client.accepted == ["listener"]

    reconciling(talking(), tmp_path, body)


def test_a_command_that_fails_is_followed_by_what_has_happened_meanwhile(tmp_path: Path) -> None:
    async def body(r: ReconcilingBench) -> None:
        async def command() -> None:
            async with r.reconciler.command("a test"):
                r.exits(TALKER_EXITED)
                raise ValueError("no such thing")

        r.busy = True
        with pytest.raises(ValueError, match="no such thing"):
            await command()
        await moment()
        assert "talker" not in r.system.configuration.instances

    reconciling(talking(), tmp_path, body)


def test_the_reconciler_waits_for_its_turn(tmp_path: Path) -> None:
    async def body(r: ReconcilingBench) -> None:
        async with r.commands.lock:
            r.exits(TALKER_EXITED)
            await moment()
            assert r.system.revision == 0
        await moment()
        assert r.system.revision == 2

    reconciling(talking(), tmp_path, body)


def test_waiting_for_crashes_includes_those_that_are_being_reconciled(tmp_path: Path) -> None:
    async def body(r: ReconcilingBench) -> None:
        answered = asyncio.Event()

        async def reply() -> object:
            await answered.wait()
            return None

        r.client.reply("listener", ModesCommand, lambda _: reply())
        await r.reconciler.reconcile_crashes()
        r.exits(TALKER_EXITED)
        await moment()
        assert r.system.life.exits == {}
        waiting = asyncio.ensure_future(r.reconciler.reconcile_crashes())
        await moment()
        assert not waiting.done()
        answered.set()
        await waiting
        assert r.system.configuration.modes[work("listener")] == 1

    reconciling(talking(), tmp_path, body)


def test_an_error_while_it_works_alone_is_reported_and_the_next_crash_is_handled(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    async def body(r: ReconcilingBench) -> None:
        is_gone, r.client.life.is_gone = r.client.life.is_gone, None  # type: ignore[method-assign, assignment]
        r.exits(TALKER_EXITED)
        await moment()
        assert "reconciling failed: internal error: TypeError" in r.words("note")[0]
        r.client.life.is_gone = is_gone  # type: ignore[method-assign]
        r.exits(Exited("listener", 1))
        await moment()
        assert list(r.system.configuration.instances) == []

    reconciling(talking(), tmp_path, body)
    assert "Traceback" in caplog.text


def test_closing_ends_what_is_under_way(tmp_path: Path) -> None:
    async def body(r: ReconcilingBench) -> None:
        async with r.commands.lock:
            r.exits(TALKER_EXITED)
            await moment()
            await r.reconciler.close()
        await moment()
        assert r.system.revision == 0

    reconciling(talking(), tmp_path, body)
