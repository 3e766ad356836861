"""What is lower after a change than before it, and whether the plan led there."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from midstride.backends.simulator import Simulator
from midstride.model.configuration import Instance
from midstride.model.specification import Node, Specification
from midstride.plan.request import PlanRequest
from midstride.runtime.manager import Manager
from midstride.runtime.records.reports import DegradedFunctionality, Outcome, UpReport
from midstride.runtime.workspace import Workspace
from tests.runtime.systems import EXAMPLES, example, managed, replace, rewritten


def told(lowered: list[DegradedFunctionality]) -> list[tuple[str, str | None, str | None, bool]]:
    return [(each.functionality, each.before, each.after, each.planned) for each in lowered]


def raising(folder: Path, program: str, call: int) -> Path:
    """The talker's example, in which the function `normal` of one program raises in its ``call``-th call."""
    counted = f"""calls = []


def normal() -> None:
    calls.append(1)
    if len(calls) >= {call}:
        raise ValueError("no voice")
"""
    return rewritten(
        "talker",
        folder,
        lambda name, text: text.replace("def normal() -> None:\n", counted) if name == program else text,
    )


def up(directory: Path, workspace: Path, specification: Specification | None = None) -> tuple[UpReport, list[str]]:
    """The report of `up`, and the words of the event."""
    simulator = Simulator()

    async def main() -> tuple[UpReport, list[str]]:
        manager = Manager(specification or example("talker", directory), simulator, Workspace(workspace), directory)
        report = await manager.up()
        words = [event.words for event in manager.log() if event.kind == "up"]
        await manager.close()
        return report, words

    return simulator.run(main())


def test_a_removal_that_lowers_others_for_good_says_so_before_and_after(tmp_path: Path) -> None:
    async def body(manager: Manager, _: Simulator) -> None:
        outcome = await manager.change(PlanRequest(remove=("detector",)))
        assert told(outcome.remaining_degradations) == [("controller.control", "normal", "degraded", True)]
        afterwards = "afterwards controller.control is in mode degraded instead of normal"
        words = {event.kind: event.words for event in manager.log()}
        assert words["plan"].endswith(f"disruption 0; {afterwards}")
        assert words["outcome"] == f"done; {afterwards.replace('afterwards', 'Afterwards:')}"
        # What is lower already is not said again.
        again = await manager.change(PlanRequest(add=(Node("second", "Detector"),)))
        assert told(again.remaining_degradations) == []
        back = await manager.change(PlanRequest(to=example("obstacle")))
        assert (back.outcome, back.remaining_degradations) == ("done", [])

    managed("obstacle", tmp_path, body)


def test_a_change_that_lowers_nothing_says_nothing(tmp_path: Path) -> None:
    async def body(manager: Manager, _: Simulator) -> Outcome:
        return await manager.change(replace("talker", "NewTalker", "paper"))

    outcome = managed("talker", tmp_path, body)
    assert (outcome.outcome, outcome.remaining_degradations) == ("done", [])


def test_an_added_node_in_a_lower_mode_than_its_normal_one_is_named(tmp_path: Path) -> None:
    async def body(manager: Manager, _: Simulator) -> Outcome:
        return await manager.change(PlanRequest(add=(Node("second", "Listener"),)))

    assert told(managed("talker", tmp_path, body).remaining_degradations) == [
        ("second.listen", "normal", "degraded", True)
    ]


@pytest.mark.parametrize("call", [1, 3])
def test_a_node_that_raises_in_its_first_calls_is_in_the_report_of_the_change(call: int, tmp_path: Path) -> None:
    """It is added, so nothing is measured: without a further wait the report would come before the call."""
    directory = raising(tmp_path / "programs", "new_talker.py", call)
    specification = example("talker", directory)
    attachments = specification.nodes["talker"].attachments

    async def body(manager: Manager, _: Simulator) -> Outcome:
        await manager.change(PlanRequest(remove=("talker",)))
        return await manager.change(PlanRequest(add=(Node("loud", "NewTalker", attachments),)))

    outcome = managed("talker", tmp_path, body, directory=directory)
    assert outcome.outcome == "done"
    assert told(outcome.remaining_degradations) == [("loud.talk", "normal", "degraded", False)]
    assert str(outcome.remaining_degradations[0].because).startswith("mode normal raised: ValueError: no voice\n")


def test_what_relies_on_a_replacement_that_raises_while_it_is_watched_is_named_as_well(tmp_path: Path) -> None:
    directory = raising(tmp_path / "programs", "new_talker.py", 20)

    async def body(manager: Manager, _: Simulator) -> Outcome:
        return await manager.change(replace("talker", "NewTalker"))

    outcome = managed("talker", tmp_path, body, directory=directory)
    assert told(outcome.remaining_degradations) == [
        ("listener.listen", "normal", "degraded", False),
        ("talker.talk", "normal", "degraded", False),
    ]
    assert outcome.remaining_degradations[0].because == "talker_2.talk entered mode degraded unexpectedly"


def test_a_role_that_has_lost_its_instance_during_a_change_is_named(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: Simulator) -> Outcome:
        change = asyncio.ensure_future(manager.change(replace("talker", "NewTalker")))
        while not any(event.kind == "measuring" for event in manager.log()):
            await asyncio.sleep(0.001)
        simulator.faults.kill("talker_2")
        return await change

    outcome = managed("talker", tmp_path, body)
    assert told(outcome.remaining_degradations) == [
        ("listener.listen", "normal", "degraded", False),
        ("talker.talk", "normal", None, False),
    ]
    assert outcome.remaining_degradations[1].because == "talker_2 exited unexpectedly (status -9)"


def test_a_role_that_was_missing_before_is_not_a_loss_of_the_change(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: Simulator) -> None:
        simulator.faults.kill("talker")
        await asyncio.sleep(1)
        outcome = await manager.change(PlanRequest(add=(Node("second", "Talker"),)))
        assert (outcome.outcome, told(outcome.remaining_degradations)) == ("done", [])
        (crashed,) = (await manager.status()).crashed
        assert crashed.remedy == "`midstride restart talker` restores it"
        restored = await manager.change(PlanRequest(restart=("talker",)))
        assert (restored.outcome, restored.remaining_degradations) == ("done", [])
        status = await manager.status()
        assert status.valid and status.crashed == []
        assert all(row.normal for each in status.instances for row in each.functionalities)

    managed("talker", tmp_path, body)


def test_a_change_that_is_rolled_back_lowers_nothing(tmp_path: Path) -> None:
    directory = raising(tmp_path / "programs", "new_talker.py", 1)

    async def body(manager: Manager, _: Simulator) -> Outcome:
        return await manager.change(replace("talker", "NewTalker"))

    outcome = managed("talker", tmp_path, body, directory=directory)
    assert (outcome.outcome, outcome.remaining_degradations) == ("rolled_back", [])


@pytest.mark.parametrize("call", [1, 3])
def test_up_says_what_has_raised_and_what_has_fallen_with_it(call: int, tmp_path: Path) -> None:
    report, words = up(raising(tmp_path / "programs", "talker.py", call), tmp_path)
    assert told(report.degraded) == [
        ("listener.listen", "normal", "degraded", False),
        ("talker.talk", "normal", "degraded", False),
    ]
    assert words == [
        "talker is up: 2 components; degraded: listener.listen is in mode degraded instead of normal, "
        "talker.talk is in mode degraded instead of normal"
    ]


def test_up_says_what_cannot_be_in_its_normal_mode_as_specified(tmp_path: Path) -> None:
    specification = example("talker").without_node("talker")
    report, _ = up(EXAMPLES / "talker", tmp_path, specification)
    assert told(report.degraded) == [("listener.listen", "normal", "degraded", True)]


def test_the_time_in_which_the_old_one_is_down_is_counted_from_its_exception_on(tmp_path: Path) -> None:
    """It raises while its replacement starts, at 10 Hz."""
    flag, seconds = tmp_path / "raise", 2.0
    directory = rewritten(
        "talker",
        tmp_path / "programs",
        lambda name, text: (
            text.replace(
                "def normal() -> None:\n", f"def normal() -> None:\n    assert not os.path.exists({str(flag)!r})\n"
            ).replace("from midstride", "import os\n\nfrom midstride", 1)
            if name == "talker.py"
            else text
        ),
    )

    async def body(manager: Manager, simulator: Simulator) -> Outcome:
        registered = manager._launcher.registered

        async def late(instance: Instance) -> None:
            flag.touch()
            await simulator.clock.sleep(seconds)
            await registered(instance)

        manager._launcher.registered = late  # type: ignore[method-assign]
        return await manager.change(replace("talker", "NewTalker"))

    outcome = managed("talker", tmp_path, body, directory=directory)
    assert (outcome.outcome, outcome.remaining_degradations) == ("done", [])
    assert list(outcome.below_baseline_seconds) == ["talker.talk"]
    assert seconds - 0.15 < outcome.below_baseline_seconds["talker.talk"] < outcome.seconds


def test_a_crash_of_the_old_one_is_counted_from_then_on(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: Simulator) -> Outcome:
        registered = manager._launcher.registered

        async def late(instance: Instance) -> None:
            simulator.faults.kill("talker")
            await simulator.clock.sleep(2.0)
            await registered(instance)

        manager._launcher.registered = late  # type: ignore[method-assign]
        return await manager.change(replace("talker", "NewTalker"))

    outcome = managed("talker", tmp_path, body)
    assert (outcome.outcome, outcome.unexpected_exits) == ("done", ["talker"]), outcome.because
    assert 2.0 <= outcome.below_baseline_seconds["talker.talk"] < outcome.seconds
