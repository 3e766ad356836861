"""The action driver: what each action of the model sends to components, and what it leaves where it fails."""

from __future__ import annotations

import asyncio
from dataclasses import replace as changed
from pathlib import Path
from typing import Any

import pytest
from immutables import Map

from midstride.errors import CallTimeout, CommandRefused, MidstrideError, StepFailed
from midstride.model.action import (
    Action,
    Attach,
    Create,
    Degrade,
    Detach,
    Handover,
    Remove,
    SetParameters,
    Swap,
    Upgrade,
)
from midstride.model.component import Connector
from midstride.model.configuration import Configuration, SystemContext, configure
from midstride.model.specification import Specification
from midstride.runtime.backend_protocol import Exited
from midstride.runtime.change.mode_changes import DRAIN_TIMEOUT, HELD_LONGER, lower_modes
from midstride.runtime.change_observer import ChangeObserver
from midstride.runtime.handover.fences import DEFAULT_WAIT
from midstride.runtime.handover.new_publishers import ATTACH_TIMEOUT, DETACH_TIMEOUT
from midstride.runtime.records.reports import ModeSkew
from midstride.runtime.records.state_store import LeftState
from midstride.wire.commands import (
    AnswerCommand,
    AttachCommand,
    AwaitCutCommand,
    AwaitRateCommand,
    AwaitWriteCommand,
    Command,
    CutInCommand,
    CutOutCommand,
    DetachCommand,
    ExportStateCommand,
    GridCommand,
    HoldCommand,
    ImportStateCommand,
    ModesCommand,
    PrepareStateCommand,
    SetParametersCommand,
)
from midstride.wire.replies import (
    Answers,
    Attached,
    CutResult,
    Detached,
    Done,
    ExportedState,
    GatedWrites,
    Grid,
    LastWrite,
    PreviousModes,
    PreviousParameters,
    RateVerdict,
    StateOffer,
)
from tests.model import build
from tests.model.build import work
from tests.runtime.scripted import (
    LISTENER,
    REFUSED,
    TALKER,
    TIMEOUT,
    UNREACHABLE,
    Bench,
    bench,
    instance,
    reported,
    started,
    talking,
)

OUT, IN, NEW_OUT = build.port("talker.out"), build.port("listener.in"), build.port("talker_2.out")
NEW = instance("talker_2", TALKER, role="talker")
EXPORTED = ExportedState(state=b"what the old one knows")
HANDOVER = Handover((Swap("/chatter", OUT, NEW_OUT),))


def replacing(role: str = "talker") -> Configuration:
    """``talker`` is about to be handed over to ``talker_2``, of the same role or another."""
    new = instance("talker_2", TALKER, role=role)
    return talking().with_instance(new).with_modes({work("talker_2"): 0})


async def perform(b: Bench, action: Action) -> None:
    await b.driver.perform(action, "for the test")


# -- attaching and detaching ---------------------------------------------------------------------------


def test_a_port_is_attached_once_it_is_matched_with_the_other_side(tmp_path: Path) -> None:
    instances = {"talker": TALKER, "second": TALKER, "listener": LISTENER}
    configuration = build.system(instances, ["talker.out /chatter", "second.out /chatter"])

    async def body(b: Bench) -> None:
        await perform(b, Attach(IN, "/chatter"))
        attach = AttachCommand(
            port="in", topic="/chatter", peers=2, timeout=ATTACH_TIMEOUT, rate=5.0, await_ready=False
        )
        assert b.client.commands() == [attach]
        await perform(b, Attach(build.port("second.out"), "/chatter"))
        [attach] = b.client.of(AttachCommand, "second")
        assert attach.peers == 0, "an output waits for subscribers, and there is none"

    bench(configuration, tmp_path, body)


def test_inputs_become_ready_together_before_what_relies_on_them(tmp_path: Path) -> None:
    instances = {"talker": TALKER, "second": LISTENER, "listener": LISTENER}

    async def body(b: Bench) -> None:
        begun = b.clock.steady()
        for name in ("second", "listener"):
            b.client.reply(name, AttachCommand, Attached(matched=1, ready_in=0.3))
            await perform(b, Attach(build.port(f"{name}.in"), "/chatter"))
        assert b.clock.steady() == begun
        await perform(b, Upgrade(Map({work("talker"): 0})))
        assert b.clock.steady() == pytest.approx(begun + 0.3)

    bench(build.system(instances, ["talker.out /chatter"]), tmp_path, body)


def test_a_port_does_not_wait_for_the_other_side_where_its_process_has_exited(tmp_path: Path) -> None:
    """Nor where its connection has closed, which is known first."""
    instances = {"talker": TALKER, "second": TALKER, "third": TALKER, "listener": LISTENER}
    attached = ["talker.out /chatter", "second.out /chatter", "third.out /chatter"]

    async def body(b: Bench) -> None:
        b.crash("second")
        b.client.lose("third")
        await perform(b, Attach(IN, "/chatter"))
        [attach] = b.client.of(AttachCommand)
        assert attach.peers == 1

    bench(build.system(instances, attached), tmp_path, body)


@pytest.mark.parametrize("error", [REFUSED, TIMEOUT, UNREACHABLE])
def test_an_attachment_that_fails_is_undone(error: MidstrideError, tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        b.client.reply("talker", AttachCommand, error)
        with pytest.raises(type(error)):
            await perform(b, Attach(OUT, "/chatter"))
        assert b.client.changes == [("talker", "attach"), ("talker", "undo detach")]

    bench(build.system({"talker": TALKER}, [], topics={"/chatter": build.at(5.0)}), tmp_path, body)


def test_a_detachment_that_fails_is_undone(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        b.client.reply("talker", DetachCommand, TIMEOUT)
        with pytest.raises(CallTimeout):
            await perform(b, Detach(OUT, "/chatter"))
        assert [(sent.how, sent.command) for sent in b.client.sent] == [
            ("change", DetachCommand(port="out", topic="/chatter", timeout=DETACH_TIMEOUT)),
            ("undo", AttachCommand(port="out", topic="/chatter", timeout=DETACH_TIMEOUT)),
        ]
        assert b.driver.last_numbers == {}

    bench(talking(), tmp_path, body)


def test_a_detachment_keeps_the_last_number_and_says_what_is_not_known(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        b.client.reply("talker", DetachCommand, Detached(acknowledged=None, last=41))
        b.client.reply("listener", DetachCommand, Detached(acknowledged=None, last=None))
        await perform(b, Detach(OUT, "/chatter"))
        await perform(b, Detach(IN, "/chatter"))
        assert b.driver.last_numbers == {OUT: 41}
        assert b.words("note") == ["talker.out: unknown whether its last messages on /chatter arrived"]

    bench(talking(), tmp_path, body)


def two_contracts(*attachments: str) -> Configuration:
    """The topic /chatter by the contract it had, ``/chatter``, and the one it will have, ``/chatter'``."""
    connectors = {name: Connector(name, build.at(5.0), topic="/chatter") for name in ("/chatter", "/chatter'")}
    pairs = [(build.port(port), name) for port, name in (text.split() for text in attachments)]
    return configure(SystemContext(Map(connectors)), [instance("talker", TALKER)], pairs)


def test_another_contract_of_a_topic_needs_no_second_endpoint(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        await perform(b, Attach(OUT, "/chatter'"))
        assert b.client.sent == []

    bench(two_contracts("talker.out /chatter"), tmp_path, body)


def test_an_endpoint_that_another_contract_of_its_topic_needs_is_kept(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        await perform(b, Detach(OUT, "/chatter"))
        assert b.client.sent == []
        b.system.configuration = b.system.configuration.without_attachment(OUT, "/chatter")
        await perform(b, Detach(OUT, "/chatter'"))
        assert b.client.commands() == [DetachCommand(port="out", topic="/chatter", timeout=DETACH_TIMEOUT)]

    bench(two_contracts("talker.out /chatter", "talker.out /chatter'"), tmp_path, body)


# -- processes that have ended -------------------------------------------------------------------------


@pytest.mark.parametrize("action", [Detach(OUT, "/chatter"), Degrade(Map({work("talker"): 1})), Remove("talker")])
def test_nothing_is_taken_from_a_process_that_has_ended(action: Action, tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        b.crash("talker")
        await perform(b, action)
        assert b.client.sent == [] and b.backend.ended == []

    bench(talking(), tmp_path, body)


@pytest.mark.parametrize(("log", "said"), [("", ""), ("no camera\n", ":\nno camera")])
def test_what_is_replaced_stays_where_its_successor_has_exited(log: str, said: str, tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        plan = b.change.plan
        b.change.plan = changed(plan, change=changed(plan.change, replaced=Map(talker="talker_2")))
        b.system.life.exited(Exited("talker_2", 3, log))
        with pytest.raises(StepFailed) as failed:
            await perform(b, Remove("talker"))
        assert str(failed.value) == f"talker_2, which replaces talker, exited with status 3{said}"
        assert b.backend.ended == []

    bench(replacing(), tmp_path, body)


@pytest.mark.parametrize("action", [Detach(OUT, "/chatter"), Degrade(Map({work("talker"): 1}))])
def test_the_end_of_its_connection_is_known_before_the_end_of_a_process(action: Action, tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        b.client.lose("talker")
        await perform(b, action)
        assert await lower_modes({work("talker"): 1}, "", b.client, b.system, b.events) == {}
        assert b.client.sent == []

    bench(talking(), tmp_path, body)


def test_of_several_only_those_that_run_are_degraded(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        b.crash("listener")
        await perform(b, Degrade(Map({work("listener"): 1, work("talker"): 1})))
        assert b.client.changes == [("talker", "modes")]

    bench(talking(), tmp_path, body)


def test_a_process_that_has_ended_cannot_be_given_anything(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        b.crash("listener")
        b.client.reply("listener", ModesCommand, UNREACHABLE)
        with pytest.raises(type(UNREACHABLE)):
            await perform(b, Upgrade(Map({work("listener"): 0})))

    bench(talking().with_modes({work("listener"): 1}), tmp_path, body)


# -- modes and parameters ------------------------------------------------------------------------------


def test_modes_are_sent_by_name_with_the_reason(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        await perform(b, Degrade(Map({work("talker"): 1, work("listener"): 1})))
        timeout = DRAIN_TIMEOUT
        hold = HoldCommand(functionalities=["work"], seconds=timeout + HELD_LONGER, timeout=timeout)
        modes = ModesCommand(modes={"work": "degraded"}, because="for the test", timeout=timeout)
        for name in ("listener", "talker"):
            assert (b.client.of(HoldCommand, name), b.client.of(ModesCommand, name)) == ([hold], [modes])
            for other in ("listener", "talker"):
                b.client.assert_order((name, "hold"), (other, "modes"))

    bench(talking(), tmp_path, body)


def test_the_modes_of_one_instance_change_without_a_hold(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        await perform(b, Degrade(Map({work("listener"): 1})))
        assert b.client.changes == [("listener", "modes")] and b.driver.modes.skews == []

    bench(talking(), tmp_path, body)


def test_several_instances_change_at_once_when_all_of_them_are_held_and_the_skew_is_known(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        slow = asyncio.Event()

        async def held() -> Done:
            await slow.wait()
            return Done()

        b.client.reply("listener", HoldCommand, lambda _: held())
        b.client.reply("listener", ModesCommand, PreviousModes(before={}, at=5_000_000))
        b.client.reply("talker", ModesCommand, PreviousModes(before={}, at=3_500_000))
        performing = asyncio.ensure_future(perform(b, Degrade(Map({work("talker"): 1, work("listener"): 1}))))
        await asyncio.sleep(1)
        assert b.client.changes == [("listener", "hold"), ("talker", "hold")], "nothing changes while a call runs"
        slow.set()
        await performing
        assert b.driver.modes.skews == [ModeSkew("degrade", ["listener.work", "talker.work"], 0.0015)]

    bench(talking(), tmp_path, body)


def test_where_one_component_cannot_be_held_no_mode_changes(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        b.client.reply("talker", HoldCommand, REFUSED, Done())
        with pytest.raises(CommandRefused):
            await perform(b, Degrade(Map({work("talker"): 1, work("listener"): 1})))
        assert b.client.of(ModesCommand) == []
        ends = [(sent.instance, sent.command) for sent in b.client.sent if sent.how == "undo"]
        assert ends == [(name, HoldCommand(functionalities=[], seconds=0.0)) for name in ("listener", "talker")]

    bench(talking(), tmp_path, body)


def test_where_one_component_does_not_change_its_mode_the_others_go_back(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        b.client.reply("talker", ModesCommand, REFUSED)
        with pytest.raises(CommandRefused):
            await perform(b, Degrade(Map({work("talker"): 1, work("listener"): 1})))
        for name in ("listener", "talker"):
            b.client.assert_order((name, "hold"), ("listener", "modes"), ("listener", "undo modes"))
        # What has refused has changed nothing, and an undo would wait for the call that hangs there as well.
        assert ("talker", "undo modes") not in b.client.changes
        assert [command.modes for command in b.client.of(ModesCommand, "listener")][1] == {"work": "normal"}

    bench(talking(), tmp_path, body)


def test_parameters_are_set_as_given(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        await perform(b, SetParameters("talker", Map(gain=2)))
        assert b.client.commands("talker") == [SetParametersCommand(parameters={"gain": 2})]

    bench(talking(), tmp_path, body)


def test_a_setting_that_is_rolled_back_restores_what_was_set_at_run_time(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        b.client.reply(
            "talker", SetParametersCommand, PreviousParameters(before={"gain": 4, "rate": 1}, declared={"gain": 0})
        )
        await perform(b, SetParameters("talker", Map(gain=2, rate=2)))
        b.roll_back()
        await perform(b, SetParameters("talker", Map(gain=1, rate=1)))
        assert b.client.commands("talker") == [
            SetParametersCommand(parameters={"gain": 2, "rate": 2}),
            SetParametersCommand(parameters={"gain": 4, "rate": 1}, declared={"gain": 0, "rate": 1}),
        ]

    bench(talking(), tmp_path, body)


# -- state ---------------------------------------------------------------------------------------------


def test_what_replaces_a_removed_instance_has_its_state(tmp_path: Path) -> None:
    other = instance("other", TALKER)

    async def body(b: Bench) -> None:
        b.client.reply("talker", ExportStateCommand, EXPORTED)
        b.startable(NEW, other)
        await perform(b, Remove("talker"))
        assert [name for name, _ in b.backend.ended] == ["talker"]
        await perform(b, Create(other))
        await perform(b, Create(NEW))
        assert EXPORTED.state is not None
        assert b.client.of(ImportStateCommand, "talker_2") == [
            ImportStateCommand(state=EXPORTED.state, exporter="uuid of talker")
        ]
        assert b.client.of(ImportStateCommand, "other") == [], "it is of another role"

    bench(talking(), tmp_path, body)


@pytest.mark.parametrize("error", [TIMEOUT, UNREACHABLE])
def test_what_no_longer_answers_is_removed_without_its_state(error: MidstrideError, tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        b.client.reply("talker", ExportStateCommand, error)
        await perform(b, Remove("talker"))
        assert b.words("note") == [f"the state of talker is lost: {error}"]
        assert [name for name, _ in b.backend.ended] == ["talker"]

    bench(talking(), tmp_path, body)


def test_what_cannot_export_its_state_is_not_removed(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        b.client.reply("talker", ExportStateCommand, REFUSED)
        with pytest.raises(CommandRefused):
            await perform(b, Remove("talker"))
        assert b.backend.ended == []

    bench(talking(), tmp_path, body)


def test_what_leaves_may_take_as_long_to_export_its_state_as_the_change_waits_for_it(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        b.begin(Remove("talker"))
        await perform(b, Remove("talker"))
        [export] = b.client.of(ExportStateCommand, "talker")
        assert export.timeout == pytest.approx(DEFAULT_WAIT, abs=0.1)

    bench(talking(), tmp_path, body)


def test_what_was_started_by_hand_is_released_and_left_running(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        await perform(b, Remove("talker"))
        b.client.assert_order(("talker", "export_state"), ("talker", "release"))
        assert b.backend.ended == []
        assert b.words("note") == ["talker was started elsewhere: it is released, and left running"]

    bench(talking(talker=build.source("Talker")), tmp_path, body)


def test_a_state_that_is_refused_fails_the_step_but_not_a_roll_back(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        b.client.reply("talker", ExportStateCommand, EXPORTED)
        b.client.reply("talker_2", ImportStateCommand, REFUSED)
        b.startable(NEW)
        await perform(b, Remove("talker"))
        with pytest.raises(CommandRefused):
            await perform(b, Create(NEW))
        await b.launcher.abandon("talker_2")
        b.roll_back()
        await perform(b, Create(NEW))
        assert b.words("note") == [f"talker_2 did not restore its state: {REFUSED}"]
        assert b.driver.own_state == {}, "a roll-back brings back what was"

    bench(talking(), tmp_path, body)


def test_a_state_left_by_an_earlier_manager_that_is_refused_is_in_the_report(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        b.system.exported["talker"] = LeftState("", b"what an earlier one knew")
        b.begin(Create(NEW))
        b.client.reply("talker_2", ImportStateCommand, REFUSED)
        b.startable(NEW)
        await perform(b, Create(NEW))
        words = f"talker_2 did not restore its state: {REFUSED}"
        assert b.words("note") == [words]
        assert b.driver.own_state == {"talker_2": f"{words}; lost is the state that the last talker had exported"}

    bench(talking(), tmp_path, body)


def test_a_roll_back_exports_nothing_from_what_it_removes(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        b.roll_back()
        await perform(b, Remove("talker"))
        assert [sent.how for sent in b.client.sent] == ["peek"], "for what was set on it last"

    bench(talking(), tmp_path, body)


# -- handing over --------------------------------------------------------------------------------------


def test_state_travels_at_the_cut_of_a_role(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        b.client.reply("talker_2", PrepareStateCommand, StateOffer(exports="whole"))
        seen: list[list[str]] = []

        class Before(ChangeObserver):
            async def before_handover(self, configuration: Configuration, action: Handover) -> None:
                assert (configuration, action) == (b.system.configuration, HANDOVER)
                seen.append([command.name for command in b.client.commands()])

        b.observers.append(Before())
        b.begin(HANDOVER)
        await perform(b, HANDOVER)
        assert seen == [[]]
        [prepare] = b.client.of(PrepareStateCommand, "talker_2")
        assert (prepare.peer, prepare.bulk) == ("talker", False)
        [out], [into] = b.client.of(CutOutCommand, "talker"), b.client.of(CutInCommand, "talker_2")
        assert out.state is not None and out.state == into.state
        assert (out.state.cuts, out.state.at, out.state.changes, out.state.required) == (1, out.at, False, True)
        assert b.client.of(ImportStateCommand) == []
        assert b.client.of(ExportStateCommand) == []

    bench(replacing(), tmp_path, body)


def test_the_bulk_of_a_state_travels_before_the_cut(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        b.client.reply("talker_2", PrepareStateCommand, StateOffer(exports="changes"))
        await perform(b, HANDOVER)
        assert [prepare.bulk for prepare in b.client.of(PrepareStateCommand, "talker_2")] == [False, True]
        [out] = b.client.of(CutOutCommand, "talker")
        assert out.state is not None and out.state.changes

    bench(replacing(), tmp_path, body)


def test_one_that_keeps_no_state_hands_none_on(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        await perform(b, HANDOVER)
        assert b.client.of(PrepareStateCommand, "talker_2")
        [out], [into] = b.client.of(CutOutCommand, "talker"), b.client.of(CutInCommand, "talker_2")
        assert out.state is None and into.state is None

    bench(replacing(), tmp_path, body)


def test_another_role_has_a_state_of_its_own(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        await perform(b, HANDOVER)
        assert b.client.of(CutOutCommand, "talker") and b.client.of(PrepareStateCommand) == []

    bench(replacing(role="second talker"), tmp_path, body)


def test_a_state_that_cannot_be_had_fails_the_hand_over_but_not_a_roll_back(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        b.client.reply("talker_2", PrepareStateCommand, REFUSED)
        with pytest.raises(StepFailed, match=str(REFUSED)):
            await perform(b, HANDOVER)
        assert b.client.of(CutOutCommand) == []
        b.roll_back()
        await perform(b, HANDOVER)
        assert b.words("note") == [f"talker_2 keeps its own state: {REFUSED}"]
        assert b.client.of(CutOutCommand)

    bench(replacing(), tmp_path, body)


def test_in_a_roll_back_the_state_is_not_required_at_the_cut_either(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        b.client.reply("talker_2", PrepareStateCommand, StateOffer(exports="whole"))
        b.client.reply("talker_2", AwaitCutCommand, CutResult(outcome="done", because="it raised"))
        b.roll_back()
        await perform(b, HANDOVER)
        [out] = b.client.of(CutOutCommand, "talker")
        assert out.state is not None and not out.state.required
        assert b.words("note") == ["talker_2 keeps its own state: it raised"]

    bench(replacing(), tmp_path, body)


@pytest.mark.parametrize(("late", "reported"), [(0.099, {}), (0.25, {"talker_2": 0.25})])
def test_a_first_slot_that_waited_for_the_state_is_reported(
    late: float, reported: dict[str, float], tmp_path: Path
) -> None:
    """From one period on, which is 0.1 s here."""

    async def body(b: Bench) -> None:
        def written(_: object) -> CutResult:
            at = b.client.of(CutInCommand, "talker_2")[0].at
            write = LastWrite(number=1, source=at + round(late * 1e9))
            return CutResult(outcome="done", first={"out /chatter": write})

        b.client.reply("talker_2", PrepareStateCommand, StateOffer(exports="whole"))
        b.client.reply("talker_2", AwaitCutCommand, written)
        await perform(b, HANDOVER)
        assert b.driver.late == reported
        assert [words for words in b.words("note") if "late" in words] == [
            "talker_2 wrote its first slot 250 ms late, after its state had moved" for _ in reported
        ]

    bench(replacing(), tmp_path, body)


def test_the_last_number_before_a_hand_over_is_kept_and_its_warnings_are_reported(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        last: dict[str, LastWrite | None] = {"out /chatter": LastWrite(number=17, source=5)}
        b.client.reply("talker", AwaitCutCommand, CutResult(outcome="done", last=last))
        b.client.reply("talker", GridCommand, Grid(trigger="rate", now=0, epoch=0, period=0.1, readers=3))
        await perform(b, HANDOVER)
        assert b.driver.last_numbers == {OUT: 17}
        [note] = b.words("note")
        assert "talker.out had 3 readers on /chatter, and talker_2.out has found 1 of them" in note

    bench(replacing(), tmp_path, body)


def test_a_hand_over_that_fails_keeps_no_number(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        b.client.reply("talker_2", AwaitWriteCommand, GatedWrites(gated=0, wrong_type=None))
        with pytest.raises(StepFailed):
            await perform(b, HANDOVER)
        assert b.driver.last_numbers == {}

    bench(replacing(), tmp_path, body)


@pytest.mark.parametrize(("guaranteed", "rate"), [(10.0, 10.0), (None, 0.0)])
def test_a_new_publisher_is_watched_at_the_rate_that_it_guarantees_if_any(
    guaranteed: float | None, rate: float, tmp_path: Path
) -> None:
    """Of one that guarantees none, only whether it raises."""
    promised = changed(build.at(10.0), rate=guaranteed)
    modes = [build.mode("normal", out=promised), build.mode("degraded")]
    source = started(build.component("Talker", {}, ["out"], modes))
    new = instance("talker_2", source, role="talker")
    configuration = talking(talker=source).with_instance(new).with_modes({work("talker_2"): 0})

    async def body(b: Bench) -> None:
        await perform(b, HANDOVER)
        b.client.reply("talker_2", AwaitRateCommand, RateVerdict(reached=False, rate=0.0, pause=0.0, failed=False))
        await b.driver.watch(HANDOVER)
        command = b.client.of(AwaitRateCommand, "talker_2")[-1]
        assert (command.rate, command.until, command.timeout) == (rate, "broken", 5.0)
        assert b.words("watching") == ["watching talker_2.out for 5 s"]

    bench(configuration, tmp_path, body, specification=Specification("bench", timing=Map({"watch_after": 5.0})))


# -- what degrades by itself ---------------------------------------------------------------------------


def test_a_functionality_that_has_fallen_already_is_degraded_all_the_same(tmp_path: Path) -> None:
    """It has refused, since its fall has changed its revision; one that refuses for another reason fails the step."""
    degrade = Degrade(Map({work("listener"): 1}))

    async def fallen(b: Bench) -> None:
        def falls(_: object) -> CommandRefused:
            b.client.report(reported(b.configuration.instances["listener"], modes={"work": "degraded"}))
            return REFUSED

        b.client.reply("listener", ModesCommand, falls, PreviousModes(before={"work": "degraded"}))
        await perform(b, degrade)
        assert len(b.client.of(ModesCommand, "listener")) == 2

    async def other(b: Bench) -> None:
        b.client.reply("listener", ModesCommand, REFUSED)
        with pytest.raises(CommandRefused):
            await perform(b, degrade)

    bench(talking(), tmp_path / "fallen", fallen)
    bench(talking(), tmp_path / "other", other)


@pytest.mark.parametrize("command", [PrepareStateCommand, AttachCommand, AwaitWriteCommand, GridCommand, CutInCommand])
@pytest.mark.parametrize("name", ["talker", "talker_2"])
def test_a_side_that_degraded_is_the_reason_whatever_is_refused(
    name: str, command: type[Command[Any]], tmp_path: Path
) -> None:
    async def body(b: Bench) -> None:
        def degrades(_: object) -> CommandRefused:
            b.client.report(reported(b.configuration.instances[name], modes={"work": "degraded"}))
            return REFUSED

        b.client.reply("talker" if command is GridCommand else "talker_2", command, degrades)
        with pytest.raises(
            StepFailed, match=rf"^{name}\.work entered mode degraded unexpectedly: it entered degraded$"
        ):
            await perform(b, HANDOVER)

    bench(replacing(), tmp_path, body)


def test_what_a_step_itself_degraded_is_not_the_reason(tmp_path: Path) -> None:
    both = Degrade(Map({work("listener"): 1, work("talker"): 1}))

    async def body(b: Bench) -> None:
        b.client.reply("talker", ModesCommand, REFUSED)
        b.client.reply("listener", ModesCommand, PreviousModes(before={}), TIMEOUT)  # its roll-back fails
        with pytest.raises(CommandRefused):
            await perform(b, both)

    bench(talking(), tmp_path, body)


# -- requests to the node's services -----------------------------------------------------------------


def standing_by(b: Bench, *names: str) -> None:
    for name in names:
        b.client.report(reported(b.configuration.instances[name], b.configuration, answers=False))


def answering(b: Bench) -> list[tuple[str, AnswerCommand]]:
    return [(sent.instance, sent.command) for sent in b.client.sent if isinstance(sent.command, AnswerCommand)]


@pytest.mark.parametrize("role", ["talker", "other"])
def test_a_replacement_answers_requests_once_it_has_taken_over(role: str, tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        standing_by(b, "talker_2")
        await perform(b, HANDOVER)
        expected = [("talker_2", AnswerCommand(peer="talker", address=b.client.address("talker")))]
        assert answering(b) == (expected if role == "talker" else [])
        names = [sent.command.name for sent in b.client.sent]
        if role == "talker":
            assert names.index("await_cut") < names.index("answer") < names.index("detach")

    bench(replacing(role), tmp_path, body)


def test_a_replacement_that_answers_already_is_not_asked_to(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        b.client.report(reported(b.configuration.instances["talker_2"], b.configuration))
        await perform(b, HANDOVER)
        assert answering(b) == []

    bench(replacing(), tmp_path, body)


def test_a_replacement_that_could_not_answer_at_first_is_asked_again(tmp_path: Path) -> None:
    """Before its predecessor ends: what has waited at both would be dropped then."""

    async def body(b: Bench) -> None:
        standing_by(b, "talker_2")
        b.client.reply("talker_2", AnswerCommand, REFUSED, CallTimeout("it is late"), Answers())
        await perform(b, HANDOVER)
        command = AnswerCommand(peer="talker", address=b.client.address("talker"))
        assert answering(b) == [("talker_2", command)] * 3
        assert b.words("note") == []

    bench(replacing(), tmp_path, body)


def test_a_replacement_that_cannot_answer_yet_is_noted_and_has_the_topic(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        standing_by(b, "talker_2")
        b.client.reply("talker_2", AnswerCommand, REFUSED)
        await perform(b, HANDOVER)
        assert b.words("note") == [f"talker_2 does not answer requests to talker yet: {REFUSED}"]

    bench(replacing(), tmp_path, body)


def test_a_replacement_without_outputs_answers_requests_before_the_old_one_ends(tmp_path: Path) -> None:
    new = instance("listener_2", LISTENER, role="listener")
    configuration = talking().with_instance(new).without_attachment(IN, "/chatter")

    async def body(b: Bench) -> None:
        standing_by(b, "listener_2")
        ended: list[list[Any]] = []

        def answers(_: Any) -> Answers:
            ended.append(list(b.backend.ended))
            return Answers()

        b.client.reply("listener_2", AnswerCommand, answers)
        await perform(b, Remove("listener"))
        assert answering(b)[0] == ("listener_2", AnswerCommand(peer="listener", address=b.client.address("listener")))
        assert ended[0] == [] and b.backend.ended

    bench(configuration, tmp_path, body)


@pytest.mark.parametrize("how", ["it has crashed", "it does not respond"])
def test_a_replacement_answers_requests_although_the_old_one_cannot_say_which_it_handled(
    how: str, tmp_path: Path
) -> None:
    new = instance("listener_2", LISTENER, role="listener")
    configuration = talking().with_instance(new).without_attachment(IN, "/chatter")

    async def body(b: Bench) -> None:
        standing_by(b, "listener_2")
        if how == "it has crashed":
            b.crash("listener")
        else:
            b.client.reply("listener_2", AnswerCommand, REFUSED)
        await perform(b, Remove("listener"))
        assert answering(b)[-1] == ("listener_2", AnswerCommand())

    bench(configuration, tmp_path, body)


def test_a_replacement_is_started_on_standby_and_a_first_instance_is_not(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        for name, role in (("talker_2", "talker"), ("other", "other")):
            created = instance(name, TALKER, role)
            b.startable(created)
            await perform(b, Create(created))
        assert [(launch.node, launch.standby) for launch in b.backend.launches] == [("talker", True), ("other", False)]

    bench(talking(), tmp_path, body)
