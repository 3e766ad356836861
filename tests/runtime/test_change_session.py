"""The change session: one change from its request to its report, whatever happens on the way."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable, Coroutine
from dataclasses import dataclass, field
from dataclasses import replace as changed
from pathlib import Path
from typing import Any

import pytest
from msgspec import UNSET, structs

from midstride.backends.simulator.virtual_loop import run
from midstride.errors import BackendError
from midstride.model.component import FunctionalityRef
from midstride.model.configuration import Configuration
from midstride.model.specification import initial
from midstride.model.wording import counted
from midstride.plan.plan import Plan
from midstride.plan.request import PlanRequest
from midstride.runtime.backend_protocol import Exited
from midstride.runtime.change.change_session import ChangeSession
from midstride.runtime.change.runtime_verification import Verifier
from midstride.runtime.instance_life import LatestState
from midstride.runtime.records.measure import WINDOW_PERIODS
from midstride.runtime.records.reports import Outcome
from midstride.runtime.records.state_store import StateStore
from midstride.verify.verdict import Answer, Verdict
from midstride.wire import replies
from midstride.wire.commands import AttachCommand, AwaitWriteCommand, ModesCommand, RecordCommand, RecordsCommand
from midstride.wire.state import ComponentState
from tests.planting import plant
from tests.runtime.scripted import REFUSED, TIMEOUT, ReconcilingBench, reported
from tests.runtime.systems import example, replace

TALKER = example("talker")
REPLACEMENT = replace("talker", "NewTalker")
LISTEN, TALK = FunctionalityRef("listener", "listen"), FunctionalityRef("talker", "talk")
HOLDS = Verdict(Answer.HOLDS, "the plan", "exact", "Alloy")
UNKNOWN = Verdict(Answer.UNKNOWN, "the plan", "nothing was judged", "Alloy", because="there is no Java here")
# What a change ends with at a subscriber whose recording has been lost, or is empty.
TAIL = WINDOW_PERIODS * 0.1


@dataclass
class ScriptedVerifier(Verifier):
    verdict: Verdict = HOLDS
    judged: list[Any] = field(default_factory=list)

    async def plan(self, plan: Plan) -> Verdict:
        self.judged.append(plan)
        return self.verdict

    async def configuration(self, configuration: Configuration) -> Verdict:
        self.judged.append(configuration)
        return self.verdict


@dataclass
class SessionBench(ReconcilingBench):
    """The talker's example, running, and a session that changes it. Its talkers come up at once."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self.busy = True  # during a command
        self.verifier = ScriptedVerifier()
        self.session = ChangeSession(self.reconciler, self.backend, self.journal, self.verifier)
        target = self.specification.with_node(changed(self.specification.nodes["talker"], component="NewTalker"))
        self.startable(target.instance("talker", "talker_2"), self.specification.instance("talker"))


def session(path: Path, body: Callable[[SessionBench], Coroutine[Any, Any, None]]) -> None:
    async def main() -> None:
        bench = SessionBench(initial(TALKER), path, TALKER)
        try:
            await body(bench)
        finally:
            await bench.reconciler.close()

    run(main())


# -- changes that are not begun ------------------------------------------------------------------------


async def refused(s: SessionBench, words: str, request: PlanRequest = REPLACEMENT, **options: Any) -> Outcome:
    outcome = await s.session.change(request, **options)
    assert outcome.outcome == "refused" and words in str(outcome.because)
    assert outcome.plan is None and outcome.swaps == []
    assert s.client.sent == [] and s.backend.launches == []
    assert (s.system.configuration, s.system.specification, s.system.revision) == (initial(TALKER), TALKER, 0)
    return outcome


def test_a_change_that_was_shown_at_another_revision_is_refused(tmp_path: Path) -> None:
    async def body(s: SessionBench) -> None:
        await refused(s, "the configuration has changed since the plan was shown", expected=7)
        assert (await s.session.change(REPLACEMENT, expected=0)).outcome == "done"

    session(tmp_path, body)


def test_a_change_that_cannot_be_planned_is_refused(tmp_path: Path) -> None:
    async def body(s: SessionBench) -> None:
        await refused(s, "Nonsense", replace("talker", "Nonsense"))
        [outcome] = [event for event in s.events.since() if event.kind == "outcome"]
        assert outcome.outcome == "refused" and outcome.words.startswith("refused: ")

    session(tmp_path, body)


def test_nothing_is_begun_that_could_not_be_written_down(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    async def body(s: SessionBench) -> None:
        s.store.close()

        def full(self: object) -> None:
            raise OSError("no space left")

        plant(monkeypatch, StateStore, "_open", full)
        await refused(s, "no space left")

    session(tmp_path, body)


@pytest.mark.parametrize("verdict", [UNKNOWN, structs.replace(UNKNOWN, answer=Answer.VIOLATED)])
def test_nothing_is_begun_unless_the_plan_holds_where_that_is_asked_for(verdict: Verdict, tmp_path: Path) -> None:
    async def body(s: SessionBench) -> None:
        s.verifier.verdict = verdict
        outcome = await refused(s, verdict.words, verify=True)
        assert outcome.verdict == verdict
        assert s.kinds() == ["verifying", "verified", "outcome"]

    session(tmp_path, body)


# -- changes that are done -----------------------------------------------------------------------------


def test_a_change_moves_configuration_and_specification_on_and_is_measured(tmp_path: Path) -> None:
    async def body(s: SessionBench) -> None:
        outcome = await s.session.change(REPLACEMENT)
        assert (outcome.outcome, outcome.because, outcome.below_baseline_seconds) == ("done", None, {})
        assert outcome.verdict is UNSET and s.verifier.judged == []
        assert s.client.listeners == [s.reconciler.on_component_event], "none of those that followed the change"
        target = TALKER.with_node(changed(TALKER.nodes["talker"], component="NewTalker"))
        assert s.system.specification == target
        assert sorted(s.system.configuration.instances) == ["listener", "talker_2"]
        assert s.system.configuration.context == target.context
        saved = StateStore(s.store.path).load()
        assert saved is not None and saved.specification == target
        assert s.saved() == ["listener", "talker_2"]
        assert outcome.plan is not None and len(outcome.plan.steps) == s.system.revision
        [swap] = outcome.swaps
        assert (swap.topic, swap.subscriber) == ("/chatter", "listener.in")
        assert outcome.seconds < s.clock.steady() == pytest.approx(TAIL, abs=0.1)
        steps = ["step", "step_done"] * len(outcome.plan.steps)
        assert s.kinds() == ["plan", *steps, "measuring", "measured", "outcome"]

    session(tmp_path, body)


def test_the_report_has_the_modes_in_which_a_change_found_what_it_replaces(tmp_path: Path) -> None:
    """Since when is known from a report that may be old, however little is reported during the change."""

    async def body(s: SessionBench) -> None:
        s.client.life.latest = lambda name: LatestState(aged(s.client.states[name]), s.clock.steady() - 2.0)  # type: ignore[method-assign]
        await asyncio.sleep(10.0)
        begun = time.time()
        await s.session.change(REPLACEMENT)
        timeline = (await s.journal.report()).timeline
        assert timeline is not None
        [old] = [each for each in timeline.modes if each.instance == "talker"]
        assert old.mode == "normal" and begun - old.began == pytest.approx(32.0, abs=1.0)

    session(tmp_path, body)


def aged(state: ComponentState) -> ComponentState:
    """Its functionalities have been in their modes for 30 s."""
    views = {name: structs.replace(view, since=30.0) for name, view in state.functionalities.items()}
    return structs.replace(state, functionalities=views)


def test_recording_begins_before_the_first_step_and_ends_after_the_last(tmp_path: Path) -> None:
    async def body(s: SessionBench) -> None:
        await s.session.change(REPLACEMENT)
        sent = [(entry.instance, entry.command) for entry in s.client.sent]
        [begin, end] = [index for index, (_, command) in enumerate(sent) if isinstance(command, RecordCommand)]
        changes = [index for index, (name, _) in enumerate(sent) if name == "talker_2"]
        assert begin < min(changes) < max(changes) < end == len(sent) - 1
        assert sent[end] == ("listener", RecordCommand(inputs=["in"], on=False))

    session(tmp_path, body)


def test_the_seconds_below_the_baseline_are_measured(tmp_path: Path) -> None:
    async def body(s: SessionBench) -> None:
        async def slowly() -> object:
            await asyncio.sleep(0.5)
            return replies.Attached(matched=1)

        s.client.reply("talker_2", AttachCommand, lambda _: slowly())
        outcome = await s.session.change(replace("talker", "NewTalker", "paper"))
        assert outcome.outcome == "done"
        # Nothing takes time but the attachment, with the talker away and the listener degraded.
        assert outcome.below_baseline_seconds == {"listener.listen": 0.5, "talker.talk": 0.5} and outcome.seconds == 0.5

    session(tmp_path, body)


def test_a_verified_change_is_checked_after_each_step(tmp_path: Path) -> None:
    """The new talker is attached where it should not be for a while, which is not what was judged."""

    async def body(s: SessionBench) -> None:
        s.client.states["talker_2"] = elsewhere("degraded")
        judge = s.verifier.configuration

        async def judge_once(configuration: Configuration) -> Verdict:
            s.client.states["talker_2"] = reported(TALKER.instance("talker", "talker_2"))
            return await judge(configuration)

        s.verifier.configuration = judge_once  # type: ignore[method-assign]
        outcome = await s.session.change(REPLACEMENT, verify=True)
        assert outcome.outcome == "done" and outcome.verdict == HOLDS
        assert outcome.plan is not None
        assert isinstance(s.verifier.judged[0], Plan) and len(s.verifier.judged) > 1
        assert all(isinstance(judged, Configuration) for judged in s.verifier.judged[1:])

    session(tmp_path, body)


# -- changes that fail ---------------------------------------------------------------------------------


def test_a_change_that_is_rolled_back_leaves_what_was(tmp_path: Path) -> None:
    async def body(s: SessionBench) -> None:
        s.client.reply("talker_2", AwaitWriteCommand, TIMEOUT)
        outcome = await s.session.change(REPLACEMENT)
        assert outcome.outcome == "rolled_back" and str(TIMEOUT) in str(outcome.because)
        assert (s.system.configuration, s.system.specification) == (initial(TALKER), TALKER)
        saved = StateStore(s.store.path).load()
        assert saved is not None and saved.specification == TALKER
        assert s.saved() == ["listener", "talker"] and s.backend.running == {"listener", "talker"}
        assert len(outcome.swaps) == 1, "what subscribers saw of it is measured as well"
        (words,) = s.words("outcome")
        # The script's components count nothing.
        assert words.startswith(f"rolled_back: {outcome.because}; /chatter was silent for about ")

    session(tmp_path, body)


# The caps of the target hold as soon as the change begins.
CAPPED = PlanRequest(
    to=changed(
        TALKER, connectors=TALKER.connectors.set("/chatter", changed(TALKER.connectors["/chatter"], max_publishers=1))
    ).with_node(changed(TALKER.nodes["talker"], component="NewTalker"))
)


def test_a_roll_back_leaves_the_caps_as_they_were_too(tmp_path: Path) -> None:
    async def body(s: SessionBench) -> None:
        s.client.reply("talker_2", AwaitWriteCommand, REFUSED)
        outcome = await s.session.change(CAPPED)
        assert outcome.outcome == "rolled_back", outcome.because
        assert s.system.configuration == initial(TALKER)

    session(tmp_path, body)


def test_a_roll_back_that_fails_leaves_the_model_where_the_system_is(tmp_path: Path) -> None:
    async def body(s: SessionBench) -> None:
        s.client.reply("talker_2", AwaitWriteCommand, REFUSED)
        s.backend.fail_end["talker_2"] = BackendError("the kernel keeps it")
        outcome = await s.session.change(REPLACEMENT)
        assert outcome.outcome == "failed" and "the kernel keeps it" in str(outcome.because)
        assert "talker_2" in s.system.configuration.instances and s.system.specification == TALKER
        assert "talker_2" in s.saved()

    session(tmp_path, body)


def test_a_step_after_which_what_is_live_does_not_hold_is_taken_back(tmp_path: Path) -> None:
    async def body(s: SessionBench) -> None:
        s.client.reply("talker_2", AwaitWriteCommand, lambda _: _unless(s))
        outcome = await s.session.change(REPLACEMENT, verify=True)
        assert outcome.outcome == "rolled_back" and "there is no Java here" in str(outcome.because), outcome.because
        assert outcome.verdict == HOLDS, "the plan's"
        assert s.system.configuration == initial(TALKER)

    session(tmp_path, body)


def elsewhere(mode: str) -> ComponentState:
    instance = TALKER.instance("talker", "talker_2")
    return reported(instance, modes={"talk": mode}, gates={"out /elsewhere": "open"})


def _unless(s: SessionBench) -> object:
    """From now on, the new talker is attached where it should not be, and whether that is valid is unknown."""
    s.verifier.verdict = UNKNOWN
    s.client.states["talker_2"] = elsewhere("normal")
    return replies.GatedWrites(gated=1, wrong_type=None)


@pytest.mark.parametrize("request_", [REPLACEMENT, CAPPED], ids=["replacement", "capped"])
def test_a_change_that_is_cancelled_leaves_what_was_and_no_recording(request_: PlanRequest, tmp_path: Path) -> None:
    async def body(s: SessionBench) -> None:
        async def waits() -> object:
            await asyncio.sleep(3)
            return replies.GatedWrites(gated=1, wrong_type=None)

        s.client.reply("talker_2", AwaitWriteCommand, lambda _: waits())
        changing = asyncio.ensure_future(s.session.change(request_))
        await asyncio.sleep(1)
        changing.cancel()
        with pytest.raises(asyncio.CancelledError):
            await changing
        assert s.system.configuration == initial(TALKER) and s.system.specification == TALKER
        assert s.client.of(RecordCommand)[-1] == RecordCommand(inputs=["in"], on=False)
        assert not s.commands.is_measuring

    session(tmp_path, body)


# -- what happens meanwhile ----------------------------------------------------------------------------


def test_what_crashes_or_degrades_meanwhile_is_in_the_report(tmp_path: Path) -> None:
    async def body(s: SessionBench) -> None:
        def measured(_: RecordsCommand) -> Exception:
            assert s.commands.is_measuring
            s.client.report(reported(s.system.configuration.instances["talker_2"], modes={"talk": "degraded"}))
            s.exits(Exited("listener", -9))
            return TIMEOUT

        s.reconciler.degraded.add(LISTEN)  # before: another report's
        s.client.reply("listener", RecordsCommand, measured)
        outcome = await s.session.change(REPLACEMENT)
        assert (outcome.outcome, outcome.unexpected_exits, outcome.unexpected_degradations) == (
            "done",
            ["listener"],
            ["talker_2.talk"],
        )
        [swap] = outcome.swaps
        assert (swap.gap, swap.missed, swap.lost, swap.duplicates) == (None, None, None, None)
        assert not s.commands.is_measuring
        assert list(s.system.configuration.instances) == ["talker_2"]

    session(tmp_path, body)


def test_a_crash_during_the_steps_is_handled_before_measuring(tmp_path: Path) -> None:
    async def body(s: SessionBench) -> None:
        def dies(_: AwaitWriteCommand) -> Exception:
            s.exits(Exited("talker", -9))
            return TIMEOUT

        s.client.reply("talker_2", AwaitWriteCommand, dies)
        outcome = await s.session.change(REPLACEMENT)
        assert (outcome.outcome, outcome.unexpected_exits) == ("rolled_back", ["talker"])
        kinds = s.kinds()
        assert kinds.index("degraded") < kinds.index("measuring")
        assert s.client.of(ModesCommand, "listener")[-1].because == "talker exited unexpectedly"
        assert dict(s.system.configuration.modes) == {LISTEN: 1}

    session(tmp_path, body)


def test_a_role_that_is_filled_again_is_missing_no_longer(tmp_path: Path) -> None:
    async def body(s: SessionBench) -> None:
        s.busy = False
        s.exits(Exited("talker", -9))
        await asyncio.sleep(0.1)
        assert list(s.system.life.missing) == ["talker"]
        s.busy = True
        for instance in (TALKER.instance("talker"), TALKER.instance("talker", "talker_2")):
            s.startable(instance)
        outcome = await s.session.change(PlanRequest(to=TALKER))
        assert outcome.outcome == "done", outcome.because
        assert outcome.unexpected_exits == [], "that was before"
        assert s.system.life.missing == {}

    session(tmp_path, body)


def test_a_role_that_has_left_the_specification_is_missing_no_longer(tmp_path: Path) -> None:
    async def body(s: SessionBench) -> None:
        s.busy = False
        s.exits(Exited("listener", -9))
        await asyncio.sleep(0.1)
        assert list(s.system.life.missing) == ["listener"]
        s.busy = True
        outcome = await s.session.change(PlanRequest(to=TALKER.without_node("listener")))
        assert outcome.outcome == "done", outcome.because
        assert s.system.life.missing == {}

    session(tmp_path, body)


def test_planning_changes_nothing(tmp_path: Path) -> None:
    async def body(s: SessionBench) -> None:
        plan, target = await s.session.planner.plan(REPLACEMENT)
        assert plan.steps and target.nodes["talker"].component == "NewTalker"
        assert s.system.specification == TALKER and s.client.sent == [] and s.kinds() == []

    session(tmp_path, body)


@pytest.mark.parametrize(("count", "words"), [(0, "0 steps"), (1, "1 step"), (2, "2 steps")])
def test_things_are_counted_in_words(count: int, words: str) -> None:
    assert counted(count, "step") == words
