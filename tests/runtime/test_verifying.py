"""Changes that are verified: nothing begins unless the plan holds, and no step stands unless what is live does."""

from __future__ import annotations

import asyncio
import copy
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest

from midstride.backends.simulator import Simulator
from midstride.model.component import FunctionalityRef
from midstride.model.configuration import Configuration
from midstride.plan.plan import Plan
from midstride.plan.request import Request
from midstride.runtime import runtime_verification
from midstride.runtime.manager import Manager
from midstride.runtime.runtime_verification import Verifier
from midstride.verify.checking import Asking
from midstride.verify.verdict import Answer, Finding, Verdict
from midstride.wire.messages import Command, Reply
from tests.runtime.systems import managed, replace, snapshot

UNKNOWN = Verdict(Answer.UNKNOWN, "the plan", "nothing was judged", "Alloy", because="there is no Java here")
VIOLATED = Verdict(
    Answer.VIOLATED, "what is live", "exact", "Alloy", (Finding("cap", None, "the configuration", "/cmd", "too many"),)
)


def holds(subject: str) -> Verdict:
    return Verdict(Answer.HOLDS, subject, "exact", "Alloy")


@dataclass
class Scripted(Verifier):
    """Answers as the test says, and notes what it was asked."""

    of_plan: Verdict = field(default_factory=lambda: holds("the plan"))
    of_live: Verdict = field(default_factory=lambda: holds("what is live"))
    plans: list[Plan] = field(default_factory=list)
    seen: list[Configuration] = field(default_factory=list)

    async def plan(self, plan: Plan) -> Verdict:
        self.plans.append(plan)
        return self.of_plan

    async def configuration(self, configuration: Configuration) -> Verdict:
        self.seen.append(configuration)
        return self.of_live


class Lying(Simulator):
    """Components that tell the manager something else than is so, once armed."""

    def __init__(self, lie: Callable[[str, dict[str, Any]], dict[str, Any] | None]) -> None:
        super().__init__()
        self.lie = lie
        self.armed = False

    async def call(self, instance: str, command: Command, timeout: float) -> Reply:
        reply = await super().call(instance, command, timeout)
        if self.armed and command.op == "observe" and reply.ok:
            told = self.lie(instance, copy.deepcopy(dict(reply.result)))
            return Reply(reply.revision, refused="not now") if told is None else Reply(reply.revision, told)
        return reply


def changed(
    folder: Path, verifier: Verifier, simulator: Simulator | None = None, strategy: str = "paper"
) -> tuple[dict[str, Any], dict[str, Any], dict[str, Any], list[dict[str, Any]]]:
    """The outcome of replacing the talker, what there was before and after, and the events."""

    async def body(
        manager: Manager, simulator: Simulator
    ) -> tuple[dict[str, Any], dict[str, Any], dict[str, Any], list[dict[str, Any]]]:
        before = await snapshot(manager, simulator)
        since = manager.log()[-1]["n"]
        if isinstance(simulator, Lying):
            simulator.armed = True
        outcome = await manager.change(replace("talker", "NewTalker", strategy), verify=True)
        if isinstance(simulator, Lying):
            simulator.armed = False
        return outcome, before, await snapshot(manager, simulator), manager.log(since)

    return managed("talker", folder, body, simulator, verifier=verifier)


@pytest.mark.parametrize("strategy", ["paper", "minimal"])
def test_a_plan_that_holds_is_carried_out_and_alloy_is_asked_once(tmp_path: Path, strategy: str) -> None:
    verifier = Scripted()
    outcome, _, after, events = changed(tmp_path, verifier, strategy=strategy)
    assert (outcome["outcome"], outcome["verdict"]["verdict"]) == ("done", "holds")
    assert [step.describe() for plan in verifier.plans for step in plan.steps] != []
    assert verifier.seen == []  # what was live after each step had been judged with the plan
    assert "talker_2" in after["components"]
    kinds = [event["kind"] for event in events]
    assert kinds.index("verifying") < kinds.index("verified") < kinds.index("plan")


@pytest.mark.parametrize("verdict", [UNKNOWN, VIOLATED], ids=["unknown", "violated"])
def test_nothing_is_begun_unless_the_plan_holds(tmp_path: Path, verdict: Verdict) -> None:
    outcome, before, after, events = changed(tmp_path, Scripted(of_plan=verdict))
    assert (outcome["outcome"], outcome["because"]) == ("refused", verdict.words)
    assert outcome["verdict"] == verdict.to_document()
    assert after == before
    assert not any(event["kind"] in {"plan", "step"} for event in events)
    assert events[-1]["kind"] == "outcome"


def degraded_by_itself(instance: str, state: dict[str, Any]) -> dict[str, Any]:
    if instance == "talker_2":
        state["functionalities"]["talk"]["mode"] = "degraded"
    return state


def test_where_components_stand_otherwise_alloy_judges_what_is_live(tmp_path: Path) -> None:
    verifier = Scripted()
    outcome, *_ = changed(tmp_path, verifier, Lying(degraded_by_itself))
    assert outcome["outcome"] == "done"
    assert verifier.seen
    assert {configuration.modes[FunctionalityRef("talker_2", "talk")] for configuration in verifier.seen} == {1}


@pytest.mark.parametrize("verdict", [UNKNOWN, VIOLATED], ids=["unknown", "violated"])
def test_a_step_after_which_what_is_live_does_not_hold_is_taken_back(tmp_path: Path, verdict: Verdict) -> None:
    outcome, before, after, events = changed(tmp_path, Scripted(of_live=verdict), Lying(degraded_by_itself))
    assert outcome["outcome"] == "rolled_back"
    # After the step before, talker_2 in its degraded mode is what was judged after its creation.
    assert outcome["because"] == f"attach talker_2.out to /chatter: {verdict.words}"
    assert after == before
    assert [event["kind"] for event in events if event["kind"] in {"step_failed", "rolled_back"}] == [
        "step_failed",
        "rolled_back",
    ]


def without_its_output(instance: str, state: dict[str, Any]) -> dict[str, Any]:
    if instance == "talker_2":
        state["ports"]["out"] = {topic: {**view, "gate": "closed"} for topic, view in state["ports"]["out"].items()}
    return state


def test_what_stands_behind_a_closed_gate_is_not_attached(tmp_path: Path) -> None:
    verifier = Scripted()
    outcome, *_ = changed(tmp_path, verifier, Lying(without_its_output))
    assert outcome["outcome"] == "done"
    assert verifier.seen
    assert all(
        "talker_2" in configuration.instances and not configuration.attached_ports("talker_2")
        for configuration in verifier.seen
    )


def test_a_component_that_does_not_answer_is_no_pass(tmp_path: Path) -> None:
    silences = iter([None])

    def silent(instance: str, state: dict[str, Any]) -> dict[str, Any] | None:
        """Once, after the first step."""
        degraded = state["functionalities"].get("listen", {}).get("mode") == "degraded"
        return next(silences, state) if degraded else state

    outcome, before, after, _ = changed(tmp_path, Scripted(), Lying(silent))
    assert outcome["outcome"] == "rolled_back"
    told = "what is live is not known: listener did not answer"
    assert outcome["because"] == f"degrade listener.listen from normal to degraded: {told}"
    assert after == before


def test_the_configuration_is_told_as_the_components_tell_it(tmp_path: Path) -> None:
    def lying(instance: str, state: dict[str, Any]) -> dict[str, Any] | None:
        if instance == "listener":
            return None
        state["functionalities"]["talk"]["mode"] = "degraded"
        return state

    async def body(manager: Manager, simulator: Simulator) -> dict[str, Any]:
        assert isinstance(simulator, Lying)
        honest = await manager.live()
        assert honest["silent"] == []
        assert honest["configuration"]["modes"] == {"listener.listen": "normal", "talker.talk": "normal"}
        simulator.armed = True
        return await manager.live()

    told = managed("talker", tmp_path, body, Lying(lying))
    assert told["silent"] == ["listener"]
    assert told["configuration"]["modes"] == {"listener.listen": "normal", "talker.talk": "degraded"}
    assert told["configuration"]["attachments"] == [["listener.in", "/chatter"], ["talker.out", "/chatter"]]


# -- beside the manager's loop -------------------------------------------------------------------------------


def test_the_loop_goes_on_while_alloy_is_asked_and_who_is_cancelled_stops_it(monkeypatch: pytest.MonkeyPatch) -> None:
    asked, ended = threading.Event(), threading.Event()

    def endless(_: Any, *, asking: Asking, **__: Any) -> Verdict:
        assert asking.stop is not None
        asked.set()
        if asking.stop.wait(30):
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
    assert (outcome["outcome"], outcome["because"]) == ("done", None)
    assert outcome["verdict"]["by"] == "Alloy 6.2.0"
    assert "talker_2" in after["components"]
    assert [event["words"] for event in events if event["kind"] == "verified"] == [
        "HOLDS: the plan of 4 steps (exact: 5 configurations, 28 atoms; Alloy 6.2.0)"
    ]


def test_without_java_nothing_is_begun(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MIDSTRIDE_ALLOY", str(tmp_path / "nowhere.jar"))
    outcome, before, after, _ = changed(tmp_path, Verifier())
    assert outcome["outcome"] == "refused"
    assert outcome["because"].startswith("UNKNOWN: the plan of 7 steps: there is no Alloy Analyzer at")
    assert after == before


def test_an_unverified_change_asks_nobody(tmp_path: Path) -> None:
    verifier = Scripted(of_plan=VIOLATED)

    async def body(manager: Manager, _: Simulator) -> dict[str, Any]:
        return await manager.change(Request(replace=(("talker", "NewTalker"),)))

    outcome = managed("talker", tmp_path, body, verifier=verifier)
    assert outcome["outcome"] == "done"
    assert (verifier.plans, "verdict" in outcome) == ([], False)
