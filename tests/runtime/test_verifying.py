"""Changes that are verified: nothing begins unless the plan holds, and no step stands unless what is live does."""

from __future__ import annotations

import asyncio
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
from msgspec import UNSET, structs

from midstride.backends.simulator import Simulator
from midstride.model.component import FunctionalityRef
from midstride.model.configuration import Configuration
from midstride.plan.plan import Plan
from midstride.plan.request import PlanRequest
from midstride.runtime.change import runtime_verification
from midstride.runtime.change.runtime_verification import Verifier
from midstride.runtime.instance_life import SILENCE
from midstride.runtime.manager import Manager
from midstride.runtime.records.reports import Event, LiveConfiguration, Outcome
from midstride.verify.checking import AlloyOptions
from midstride.verify.verdict import Answer, Finding, Verdict
from midstride.wire.state import ComponentState
from tests.runtime.systems import managed, replace, snapshot

UNKNOWN = Verdict(Answer.UNKNOWN, "the plan", "nothing was judged", "Alloy", because="there is no Java here")
VIOLATED = Verdict(
    Answer.VIOLATED,
    "the live configuration",
    "exact",
    "Alloy",
    findings=(Finding("cap", None, "the configuration", "/cmd", "too many"),),
)


def holds(subject: str) -> Verdict:
    return Verdict(Answer.HOLDS, subject, "exact", "Alloy")


@dataclass
class Scripted(Verifier):
    """Answers as the test says, and notes what it was asked."""

    of_plan: Verdict = field(default_factory=lambda: holds("the plan"))
    of_live: Verdict = field(default_factory=lambda: holds("the live configuration"))
    plans: list[Plan] = field(default_factory=list)
    seen: list[Configuration] = field(default_factory=list)

    async def plan(self, plan: Plan) -> Verdict:
        self.plans.append(plan)
        return self.of_plan

    async def configuration(self, configuration: Configuration) -> Verdict:
        self.seen.append(configuration)
        return self.of_live


class Lying(Simulator):
    """Components that report something else than is so, or nothing, once armed."""

    def __init__(self, lie: Callable[[ComponentState], ComponentState | None]) -> None:
        super().__init__()
        self.lie = lie
        self.armed = False
        self.control.rewrite_state = lambda state: self.lie(state) if self.armed else state


def with_mode(state: ComponentState, functionality: str, mode: str) -> ComponentState:
    view = structs.replace(state.functionalities[functionality], mode=mode)
    return structs.replace(state, functionalities={**state.functionalities, functionality: view})


def changed(
    folder: Path, verifier: Verifier, simulator: Simulator | None = None, strategy: str = "paper"
) -> tuple[Outcome, dict[str, Any], dict[str, Any], list[Event]]:
    """The outcome of replacing the talker, what there was before and after, and the events."""

    async def body(
        manager: Manager, simulator: Simulator
    ) -> tuple[Outcome, dict[str, Any], dict[str, Any], list[Event]]:
        before = await snapshot(manager, simulator)
        since = manager.log()[-1].n
        if isinstance(simulator, Lying):
            simulator.armed = True
            await asyncio.sleep(2 * SILENCE)
        outcome = await manager.change(replace("talker", "NewTalker", strategy), verify=True)
        if isinstance(simulator, Lying):
            simulator.armed = False
        return outcome, before, await snapshot(manager, simulator), manager.log(since)

    return managed("talker", folder, body, simulator, verifier=verifier)


@pytest.mark.parametrize("strategy", ["paper", "minimal"])
def test_a_plan_that_holds_is_carried_out_and_alloy_is_asked_once(tmp_path: Path, strategy: str) -> None:
    verifier = Scripted()
    outcome, _, after, events = changed(tmp_path, verifier, strategy=strategy)
    assert isinstance(outcome.verdict, Verdict)
    assert (outcome.outcome, outcome.verdict.answer) == ("done", Answer.HOLDS)
    assert [step.describe() for plan in verifier.plans for step in plan.steps] != []
    assert verifier.seen == []  # what was live after each step had been judged with the plan
    assert "talker_2" in after["components"]
    kinds = [event.kind for event in events]
    assert kinds.index("verifying") < kinds.index("verified") < kinds.index("plan")


@pytest.mark.parametrize("verdict", [UNKNOWN, VIOLATED], ids=["unknown", "violated"])
def test_nothing_is_begun_unless_the_plan_holds(tmp_path: Path, verdict: Verdict) -> None:
    outcome, before, after, events = changed(tmp_path, Scripted(of_plan=verdict))
    assert (outcome.outcome, outcome.because) == ("refused", verdict.words)
    assert outcome.verdict == verdict
    assert after == before
    assert not any(event.kind in {"plan", "step"} for event in events)
    assert events[-1].kind == "outcome"


def degraded_by_itself(state: ComponentState) -> ComponentState:
    return with_mode(state, "talk", "degraded") if state.instance == "talker_2" else state


def test_where_components_stand_otherwise_alloy_judges_what_is_live(tmp_path: Path) -> None:
    verifier = Scripted()
    outcome, *_ = changed(tmp_path, verifier, Lying(degraded_by_itself))
    assert outcome.outcome == "done"
    assert verifier.seen
    assert {configuration.modes[FunctionalityRef("talker_2", "talk")] for configuration in verifier.seen} == {1}


@pytest.mark.parametrize("verdict", [UNKNOWN, VIOLATED], ids=["unknown", "violated"])
def test_a_step_after_which_what_is_live_does_not_hold_is_taken_back(tmp_path: Path, verdict: Verdict) -> None:
    outcome, before, after, events = changed(tmp_path, Scripted(of_live=verdict), Lying(degraded_by_itself))
    assert outcome.outcome == "rolled_back"
    # After the step before, talker_2 in its degraded mode is what was judged after its creation.
    assert outcome.because == f"attach talker_2.out to /chatter: {verdict.words}"
    assert after == before
    assert [event.kind for event in events if event.kind in {"step_failed", "rolled_back"}] == [
        "step_failed",
        "rolled_back",
    ]


def without_its_output(state: ComponentState) -> ComponentState:
    if state.instance != "talker_2":
        return state
    closed = {topic: structs.replace(link, gate="closed") for topic, link in state.ports["out"].items()}
    return structs.replace(state, ports={**state.ports, "out": closed})


def test_what_stands_behind_a_closed_gate_is_not_attached(tmp_path: Path) -> None:
    verifier = Scripted()
    outcome, *_ = changed(tmp_path, verifier, Lying(without_its_output))
    assert outcome.outcome == "done"
    assert verifier.seen
    assert all(
        "talker_2" in configuration.instances and not configuration.attached_ports("talker_2")
        for configuration in verifier.seen
    )


def test_a_component_that_does_not_answer_is_no_pass(tmp_path: Path) -> None:
    def silent(state: ComponentState) -> ComponentState | None:
        return None if state.instance == "listener" else state

    outcome, before, after, _ = changed(tmp_path, Scripted(), Lying(silent))
    assert outcome.outcome == "rolled_back"
    unknown = "the live configuration is unknown: listener has reported nothing for more than 2 s"
    assert outcome.because == f"degrade listener.listen from normal to degraded: {unknown}"
    assert after == before


def test_the_configuration_is_told_as_the_components_tell_it(tmp_path: Path) -> None:
    def lying(state: ComponentState) -> ComponentState | None:
        return None if state.instance == "listener" else with_mode(state, "talk", "degraded")

    async def body(manager: Manager, simulator: Simulator) -> LiveConfiguration:
        assert isinstance(simulator, Lying)
        honest = await manager.live()
        assert honest.silent == []
        assert honest.configuration.modes == {"listener.listen": "normal", "talker.talk": "normal"}
        simulator.armed = True
        await asyncio.sleep(2 * SILENCE)
        return await manager.live()

    told = managed("talker", tmp_path, body, Lying(lying))
    assert told.silent == ["listener"]
    # The talker reports that it has degraded by itself, so the listener has been lowered; it does not say so.
    assert told.configuration.modes == {"listener.listen": "degraded", "talker.talk": "degraded"}
    assert told.configuration.attachments == [("listener.in", "/chatter"), ("talker.out", "/chatter")]


# -- beside the manager's loop -------------------------------------------------------------------------------


def test_the_loop_goes_on_while_alloy_is_asked_and_who_is_cancelled_stops_it(monkeypatch: pytest.MonkeyPatch) -> None:
    asked, ended = threading.Event(), threading.Event()

    def endless(_: Any, *, options: AlloyOptions, **__: Any) -> Verdict:
        assert options.stop is not None
        asked.set()
        if options.stop.wait(30):
            ended.set()
        return UNKNOWN

    monkeypatch.setattr(runtime_verification, "verify_configuration", endless)

    async def main() -> float:
        begun = time.monotonic()
        task = asyncio.ensure_future(Verifier().configuration(Configuration()))
        while not asked.is_set():
            await asyncio.sleep(0.001)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        return time.monotonic() - begun

    assert asyncio.run(main()) < 20
    assert ended.wait(10)


@pytest.mark.alloy
def test_alloy_itself_lets_a_hand_over_pass(tmp_path: Path) -> None:
    outcome, _, after, events = changed(tmp_path, Verifier(), strategy="minimal")
    assert (outcome.outcome, outcome.because) == ("done", None)
    assert isinstance(outcome.verdict, Verdict)
    assert outcome.verdict.by == "Alloy 6.2.0"
    assert "talker_2" in after["components"]
    assert [event.words for event in events if event.kind == "verified"] == [
        "HOLDS: the plan of 4 steps (exact: 5 configurations, 28 atoms; Alloy 6.2.0)"
    ]


def test_without_java_nothing_is_begun(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MIDSTRIDE_ALLOY", str(tmp_path / "nowhere.jar"))
    outcome, before, after, _ = changed(tmp_path, Verifier())
    assert outcome.outcome == "refused"
    assert str(outcome.because).startswith("UNKNOWN: the plan of 7 steps: there is no Alloy Analyzer at")
    assert after == before


def test_an_unverified_change_asks_nobody(tmp_path: Path) -> None:
    verifier = Scripted(of_plan=VIOLATED)

    async def body(manager: Manager, _: Simulator) -> Outcome:
        return await manager.change(PlanRequest(replace=(("talker", "NewTalker"),)))

    outcome = managed("talker", tmp_path, body, verifier=verifier)
    assert outcome.outcome == "done"
    assert (verifier.plans, outcome.verdict) == ([], UNSET)
