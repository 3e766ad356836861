"""Finding a running system again: what an earlier manager knew, and what its components say now."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace as changed
from pathlib import Path
from typing import Any, Literal

import pytest
from immutables import Map
from msgspec import structs

from midstride.errors import BackendError, ProtocolError, Unreachable
from midstride.lang.load import load_text
from midstride.model.configuration import Configuration, Instance
from midstride.model.specification import Node, Specification, initial
from midstride.runtime.backend_protocol import Handle, RemainingProcess
from midstride.runtime.records.state_store import SavedInstance
from midstride.runtime.restore.half_done import HalfDone
from midstride.runtime.restore.half_done_values import HalfDoneValues
from midstride.runtime.restore.recovery import _redundant, recover
from midstride.wire.commands import (
    AnswerCommand,
    GateCommand,
    ObserveCommand,
    RecordCommand,
    ResolveCutsCommand,
    SetParametersCommand,
)
from midstride.wire.state import NOT_WELCOMED, ComponentState, GateState, LinkState
from tests.model import build
from tests.model.build import work
from tests.runtime.scripted import REFUSED, TALKER, TIMEOUT, UNREACHABLE, Bench, bench, instance, reported, talking

OUT, NEW_OUT = build.port("talker.out"), build.port("talker_2.out")
NEW = instance("talker_2", TALKER, "talker")
RUNNING = talking()
SPECIFICATION = Specification(
    "bench",
    RUNNING.context.connectors,
    Map({kind.component.name: kind.component for kind in RUNNING.instances.values()}),
    Map({name: Node(name, found.component.name) for name, found in RUNNING.instances.items()}),
)
SERVING = """system serving
topic /chat : std_msgs/msg/String @ 50 Hz
service /count : rcl_interfaces/srv/ListParameters
component Talker {
  run "talker" gate preload
  output out
  server count
  functionality talk {
    produces out, count
    mode normal { guarantee out : std_msgs/msg/String @ 50 Hz  guarantee count : rcl_interfaces/srv/ListParameters }
    mode off { }
  }
}
node talker : Talker { out -> /chat  count -> /count }
"""
# A manager that was killed during a hand-over has left both: one of them publishes.
TWICE = RUNNING.with_instance(NEW).with_attachment(NEW_OUT, "/chatter")


def entry(live: Instance) -> SavedInstance:
    return SavedInstance(live, None if live.component.run is None else Handle(live.name, 4711, 12.5))


async def recovered(b: Bench, *saved: Instance, targets: Sequence[Specification] = ()) -> Configuration:
    known = saved or tuple(b.configuration.instances[name] for name in sorted(b.configuration.instances))
    for name in b.client.life.handles:  # this manager does not know yet that another one has started them
        b.client.life.adopted(name, None)
    entries: Sequence[SavedInstance] = [entry(instance) for instance in known]
    values = HalfDoneValues(b.client, b.system.values, {}, SPECIFICATION)
    return await recover(entries, SPECIFICATION, HalfDone(b.launcher, b.client, b.events, values), targets)


def test_what_still_runs_is_in_the_model_as_it_reports_it(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        b.client.report(reported(b.configuration.instances["listener"], b.configuration, modes={"work": "degraded"}))
        assert await recovered(b) == RUNNING.with_modes({work("listener"): 1})
        assert sorted(b.client.life.handles) == ["listener", "talker"]
        assert b.words("adopted") == ["listener was reattached unchanged", "talker was reattached unchanged"]
        assert b.client.of(GateCommand) == [] and b.backend.ended == []

    bench(RUNNING, tmp_path, body)


def test_the_model_has_the_modes_that_components_are_in_after_everything_was_looked_at(tmp_path: Path) -> None:
    """What was under way may have been settled since a component was looked at first: a cut, a mode."""

    async def body(b: Bench) -> None:
        listener = b.configuration.instances["listener"]
        later = reported(listener, b.configuration, modes={"work": "degraded"}, revision=2)
        b.client.reply("listener", ObserveCommand, reported(listener, b.configuration), later)
        assert await recovered(b) == RUNNING.with_modes({work("listener"): 1})

    bench(RUNNING, tmp_path, body)


def test_what_no_longer_runs_is_not_in_the_model(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        b.backend.running.discard("talker")
        assert await recovered(b) == RUNNING.without_instance("talker")
        assert b.words("gone") == ["talker is no longer running"]

    bench(RUNNING, tmp_path, body)


def test_a_component_that_runs_and_does_not_answer_stops_the_recovery(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        b.client.disconnect("talker")
        with pytest.raises(Unreachable, match=r"talker runs .* but does not answer"):
            await recovered(b)
        assert b.backend.ended == []

    bench(RUNNING, tmp_path, body)


@pytest.mark.parametrize("answer", [TIMEOUT, UNREACHABLE, ProtocolError("it speaks version 99")])
def test_a_component_started_by_hand_that_greets_and_does_not_answer_is_left_out(
    answer: Exception, tmp_path: Path
) -> None:
    running = talking(talker=build.source("Talker"))

    async def body(b: Bench) -> None:
        b.backend.running.add("talker")
        b.client.reply("talker", ObserveCommand, answer)
        assert await recovered(b) == running.without_instance("talker")
        (note,) = b.words("note")
        assert note.startswith(("talker runs, but does not answer", "it speaks version 99"))
        assert note.endswith("it is left out until it does") and b.client.disconnected == ["talker"]

    bench(running, tmp_path, body)


def test_recordings_of_an_earlier_manager_end(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        b.client.reply("listener", RecordCommand, REFUSED)  # which does not matter
        await recovered(b)
        assert [(sent.how, sent.instance) for sent in b.client.sent if isinstance(sent.command, RecordCommand)] == [
            ("undo", "listener")
        ], "the talker has no inputs"
        assert b.client.of(RecordCommand) == [RecordCommand(inputs=["in"], on=False)]

    bench(RUNNING, tmp_path, body)


# -- half-done changes ---------------------------------------------------------------------------------


def test_cuts_under_way_are_settled_before_one_of_two_instances_is_ended(tmp_path: Path) -> None:
    """The new sides first, so that only one of both writes; what they show after that counts."""

    async def body(b: Bench) -> None:
        gates: tuple[dict[str, Literal["open", "closed"]], ...] = ({"out /chatter": "closed"}, {"out /chatter": "open"})
        for name, order in (("talker", gates), ("talker_2", gates[::-1])):
            states = (reported(b.configuration.instances[name], b.configuration, gates=each) for each in order)
            b.client.reply(name, ObserveCommand, *states)
        b.client.reply("talker", ResolveCutsCommand, REFUSED)  # a node without Midstride's API
        assert await recovered(b) == RUNNING
        settled = [
            (sent.instance, sent.command.new) for sent in b.client.sent if isinstance(sent.command, ResolveCutsCommand)
        ]
        assert settled == [(name, new) for new in (True, False) for name in ("listener", "talker", "talker_2")]
        assert [name for name, _ in b.backend.ended] == ["talker_2"]

    bench(TWICE, tmp_path, body)


@pytest.mark.parametrize(("published", "other"), [("talker", "talker_2"), ("talker_2", "talker")])
def test_of_two_instances_of_a_role_the_one_behind_its_gate_is_ended(
    published: str, other: str, tmp_path: Path
) -> None:
    async def body(b: Bench) -> None:
        b.client.report(reported(b.configuration.instances[other], b.configuration, gates={"out /chatter": "closed"}))
        assert await recovered(b) == b.configuration.without_instance(other)
        assert [name for name, _ in b.backend.ended] == [other]
        words = f"stopped {other}, which an earlier manager had left half done, within 0 ms; {published} goes on; "
        assert b.words("half_done") == [
            words + "it wrote on no topic of a port, and nothing is known to have been lost with it"
        ]
        assert b.client.of(GateCommand) == []

    bench(TWICE, tmp_path, body)


@pytest.mark.parametrize("refuses", [False, True])
def test_what_the_end_of_a_half_done_instance_has_cost_is_said(refuses: bool, tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        found = b.configuration.instances
        b.client.report(reported(found["talker"], b.configuration, parameters={"gain": 1.0, "unit": "m"}))
        parameters: dict[str, Any] = {"gain": 50.0, "unit": "m"}
        state = reported(found["talker_2"], b.configuration, keeps_state=True, parameters=parameters)
        b.client.report(structs.replace(state, declared={"gain": 1.0, "unit": "mm"}))
        b.backend.killed["talker_2"] = [RemainingProcess(None, "python3", 3.0)]
        b.launcher.on_killed = lambda name, seconds, words, unfinished: b.events.add(
            "killed", words, instance=name, seconds=seconds, unfinished=unfinished
        )
        if refuses:
            b.client.reply("talker", SetParametersCommand, REFUSED)
        assert await recovered(b) == b.configuration.without_instance("talker_2")
        (words,) = b.words("half_done")
        (killed,) = b.words("killed")
        assert words.startswith(
            "stopped talker_2, which an earlier manager had left half done, within 0 ms; talker goes on; "
        )
        late = "too late, after the hand-over: gain = 50.0, set at run time: the component refused it"
        fate = late if refuses else "kept"
        assert f"; talker: gain = 50.0, set at run time: {fate}; talker: unit = 'm', set at run time: kept" in words
        sent = [
            (each.instance, each.command) for each in b.client.sent if isinstance(each.command, SetParametersCommand)
        ]
        assert sent == [("talker", SetParametersCommand(parameters={"gain": 50.0}, declared={}))]
        assert "; not measurable here: " in words
        assert "which instance wrote on /chatter: both talker_2 and talker could until the one was ended; " in words
        assert "what has changed in the state of talker_2: talker has its own; " in words
        assert words.endswith(f"{killed}: what it does at its end is lost")

    bench(TWICE, tmp_path, body)


def test_one_that_was_just_started_ends_without_a_loss_beside_another_one_of_its_role(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        state = reported(NEW, b.configuration, parameters={"gain": 50.0, "unit": "m"})
        state = structs.replace(state, declared={"gain": 1.0, "unit": "m"}, waiting=NOT_WELCOMED)
        b.client.report(state)
        assert await recovered(b) == RUNNING
        assert b.words("half_done") == [
            "stopped talker_2, which an earlier manager had just started, within 0 ms; talker goes on; it wrote on no "
            "topic of a port, and nothing is known to have been lost with it"
        ]
        assert b.client.of(SetParametersCommand) == [], "what was set on the one that goes on stays as it is"

    bench(RUNNING.with_instance(NEW), tmp_path, body)


def test_where_only_the_one_that_is_ended_wrote_its_topic_may_have_been_silent(tmp_path: Path) -> None:
    fenced = {"/chatter": LinkState(gate="open", count=0, fenced=True)}

    async def body(b: Bench) -> None:
        found = b.configuration.instances
        b.client.report(reported(found["talker"], b.configuration, gates={"out /chatter": "closed"}))
        b.client.report(structs.replace(reported(found["talker_2"], b.configuration), ports={"out": fenced}))
        await recovered(b)
        (words,) = b.words("half_done")
        assert words.endswith(
            "for how long /chatter was silent: talker_2 wrote there until it was ended, and only talker may since"
        )

    bench(TWICE, tmp_path, body)


@pytest.mark.parametrize(("stays", "other"), [("talker", "talker_2"), ("talker_2", "talker")])
def test_the_instance_that_stays_answers_requests_and_has_the_other_one_stop_first(
    stays: str, other: str, tmp_path: Path
) -> None:
    async def body(b: Bench) -> None:
        instances = b.configuration.instances
        b.client.report(reported(instances[stays], b.configuration, answers=False))
        b.client.report(reported(instances[other], b.configuration, gates={"out /chatter": "closed"}))
        await recovered(b)
        [sent] = [sent for sent in b.client.sent if isinstance(sent.command, AnswerCommand)]
        assert sent == ("change", stays, AnswerCommand(peer=other, address=b.client.address(other)))
        assert [name for name, _ in b.backend.ended] == [other]

    bench(TWICE, tmp_path, body)


def test_the_last_instance_of_a_role_answers_requests(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        b.client.report(reported(b.configuration.instances["talker"], b.configuration, answers=False))
        await recovered(b)
        assert b.client.of(AnswerCommand) == [AnswerCommand()]

    bench(RUNNING, tmp_path, body)


@pytest.mark.parametrize(("answers", "other"), [("listener", "listener_2"), ("listener_2", "listener")])
def test_of_two_instances_without_outputs_the_one_that_answers_stays(answers: str, other: str, tmp_path: Path) -> None:
    listener = RUNNING.instances["listener"].component
    configuration = RUNNING.with_instance(instance("listener_2", listener, "listener"))

    async def body(b: Bench) -> None:
        b.client.report(reported(b.configuration.instances[other], b.configuration, answers=False))
        assert await recovered(b) == b.configuration.without_instance(other)

    bench(configuration, tmp_path, body)


def test_the_instance_that_publishes_stays_where_the_other_one_still_has_the_server() -> None:
    """A manager was killed between the cut and the change of who answers."""
    specification = load_text(SERVING).require()
    (old,) = initial(specification).instances.values()
    new = changed(old, name="talker_2")

    def state(name: str, out: GateState, count: GateState) -> ComponentState:
        found = reported(old, initial(specification), answers=name == "talker")
        ports = {"out": {"/chat": LinkState(gate=out, count=0)}, "count": {"/count": LinkState(gate=count, count=0)}}
        return structs.replace(found, instance=name, ports=ports)

    found = {"talker": (old, state("talker", "closed", "open")), "talker_2": (new, state("talker_2", "open", "closed"))}
    assert _redundant(found) == ["talker"]


def test_of_two_instances_that_do_the_same_the_first_stays(tmp_path: Path) -> None:
    ninth, tenth = (instance(f"talker_{number}", TALKER, "talker") for number in (9, 10))
    configuration = RUNNING.without_instance("talker").with_instance(ninth).with_instance(tenth)

    async def body(b: Bench) -> None:
        assert list((await recovered(b)).instances_by_role["talker"]) == ["talker_9"]

    bench(configuration, tmp_path, body)


def test_a_half_done_instance_that_cannot_be_ended_is_left_out(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        b.backend.fail_end["talker_2"] = BackendError("the kernel keeps it")
        assert await recovered(b) == RUNNING
        assert "talker_2" in b.client.life.handles, "`down` tries again"
        assert b.words("half_done") == [
            "talker_2, which an earlier manager had left half done, could not be ended: the kernel keeps it; "
            "`midstride down` tries again"
        ]

    bench(RUNNING.with_instance(NEW), tmp_path, body)


def test_the_last_instance_of_a_role_has_its_gate_opened(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        talker = b.configuration.instances["talker"]
        b.client.report(reported(talker, b.configuration, gates={"out /chatter": "closed"}))
        assert await recovered(b) == RUNNING
        [gate] = [sent for sent in b.client.sent if isinstance(sent.command, GateCommand)]
        assert gate == ("change", "talker", GateCommand(port="out", topic="/chatter", gate="open"))

    bench(RUNNING, tmp_path, body)


def test_a_gate_that_a_cut_has_opened_meanwhile_is_left_as_it_is(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        talker = b.configuration.instances["talker"]
        gates: list[dict[str, Literal["open", "closed"]]] = [{"out /chatter": "closed"}, {"out /chatter": "open"}]
        b.client.reply("talker", ObserveCommand, *(reported(talker, b.configuration, gates=gate) for gate in gates))
        assert await recovered(b) == RUNNING
        assert b.client.of(GateCommand) == []

    bench(RUNNING, tmp_path, body)


def test_topics_of_no_specification_are_left_out(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        talker = b.configuration.instances["talker"]
        b.client.report(reported(talker, b.configuration, gates={"out /elsewhere": "closed"}))
        assert await recovered(b) == RUNNING
        assert b.client.of(GateCommand) == []

    bench(RUNNING, tmp_path, body)


def test_a_topic_whose_contract_was_being_changed_keeps_the_earlier_one(tmp_path: Path) -> None:
    """The old and the new connector of a topic exist side by side during such a change."""
    [chatter] = SPECIFICATION.connectors.values()
    later = changed(chatter, name="/chatter (new)", max_publishers=3)
    target = changed(SPECIFICATION, connectors=Map({later.name: later}))

    async def body(b: Bench) -> None:
        assert await recovered(b, targets=[target]) == RUNNING

    bench(RUNNING, tmp_path, body)


# -- components started by hand ------------------------------------------------------------------------

BY_HAND = talking(talker=build.source("Talker"))


def test_a_component_that_was_started_by_hand_is_found_again(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        b.backend.running.add("talker")
        assert await recovered(b) == BY_HAND
        assert list(b.client.life.handles) == ["listener"], "it is not this manager's to end"

    bench(BY_HAND, tmp_path, body)


def test_one_that_belongs_to_another_system_by_now_is_left_alone(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        b.backend.running.add("talker")
        b.client.reply("talker", ObserveCommand, REFUSED)
        assert await recovered(b) == BY_HAND.without_instance("talker")
        assert b.backend.ended == []

    bench(BY_HAND, tmp_path, body)


def test_a_saved_instance_has_the_parameters_it_was_saved_with(tmp_path: Path) -> None:
    async def body(b: Bench) -> None:
        tuned = changed(b.configuration.instances["talker"], parameters=Map(gain=3))
        found = await recovered(b, tuned, b.configuration.instances["listener"])
        assert found.instances["talker"].parameters == Map(gain=3)

    bench(RUNNING, tmp_path, body)
