"""Parameters set at run time, on the simulator: they travel with a replacement, and nothing is dropped silently."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from dataclasses import replace as changed
from pathlib import Path
from typing import Any

import msgspec
import pytest
from immutables import Map

from midstride.backends.simulator import Simulator
from midstride.errors import BackendError, CommandRefused, ManagerError, PlanRefused
from midstride.model.component import ParameterSpec, ParameterValue, Resource
from midstride.model.specification import Specification
from midstride.plan.change import Change
from midstride.plan.request import PlanRequest
from midstride.runtime.change.parameter_transfer import ParameterTransfer
from midstride.runtime.manager import Manager
from midstride.runtime.records.reports import Outcome
from midstride.runtime.workspace import Workspace
from midstride.wire.commands import SetParametersCommand
from midstride.wire.replies import PreviousParameters
from tests.runtime.scripted import TALKER, Bench, bench, instance, reported, talking
from tests.runtime.systems import EXAMPLES, example, managed, replace, saved

# Says its parameters. Accepts a gain of at least 0 and at most LIMIT.
TUNED = """
from midstride import Component
from std_msgs.msg import String

comp = Component("talker")
out = comp.create_output("out", String)
talk = comp.create_functionality("talk", outputs=[out])

def check(value):
    print("gain becomes", value)
    if not 0 <= value <= LIMIT:
        raise ValueError("it must be from 0 to LIMIT")

gain = comp.parameter("gain", DEFAULT, on_change=check)
label = comp.parameter("label", "plain", on_change=lambda value: None)
talk.set_normal_mode(lambda: out.write(String(data=f"{gain.value} {label.value}")), rate=10, outputs=[out])
talk.set_degraded_mode(lambda: None)
comp.start()
"""
RESTART = PlanRequest(restart=("talker",))
REPLACE = replace("talker", "NewTalker")


def source(default: object = 1.5, limit: int = 100) -> str:
    return TUNED.replace("DEFAULT", repr(default)).replace("LIMIT", str(limit))


def tuned(folder: Path, new: str = source(2.5), declares: bool = True, new_gain: ParameterValue = 2.5) -> Specification:
    """The talker's example, whose talkers have parameters; ``declares``: also in the specification."""
    specification = example("talker")
    components = specification.components
    for name, text, gain in (("Talker", source(), 1.5), ("NewTalker", new, new_gain)):
        (folder / f"{name}.py").write_text(text)
        values = {"gain": gain, "label": "plain"} if declares else {}
        declared = Map({key: ParameterSpec(value, changeable=True) for key, value in values.items()})
        run = f"python3 {folder / f'{name}.py'}"
        components = components.set(name, changed(components[name], run=run, parameters=declared))
    return changed(specification, components=components)


def test_what_is_set_while_values_are_carried_over_is_carried_over_the_next_time(tmp_path: Path) -> None:
    new = instance("talker_2", TALKER, role="talker")
    start = talking()

    async def body(b: Bench) -> None:
        change = Change(
            b.specification, b.specification, start, start, start, start, ("talker",), (new,), Map(talker="talker_2")
        )
        # In a roll-back the values go back to the instance that was there before, as they are.
        transfer = ParameterTransfer(b.client, b.system.values, change, (), keep=True, carried={"talker_2": Map()})

        def set_meanwhile(command: SetParametersCommand) -> PreviousParameters:
            b.client.report(reported(new, parameters={"gain": 3.0}, declared={"gain": 1.0}))
            b.system.values.report(b.client.states["talker_2"])
            return PreviousParameters(before={})

        b.client.report(reported(start.instances["talker"], parameters={"gain": 1.0}))
        b.client.report(reported(new, parameters={"gain": 2.0}, declared={"gain": 1.0}))
        b.client.reply("talker", SetParametersCommand, set_meanwhile, PreviousParameters(before={}))
        for _ in range(3):
            await transfer.leaving("talker_2", start)
        assert [each.parameters for each in b.client.of(SetParametersCommand, "talker")] == [
            {"gain": 2.0},
            {"gain": 3.0},
        ]

    bench(start, tmp_path, body)


async def set_by_a_tool(simulator: Simulator, instance: str, name: str, value: object) -> None:
    """As `ros2 param set` does: on the data thread of the component, not by a command of the manager."""
    process = simulator.processes[instance]
    parameter = process._program._main.__dict__[name]
    done = asyncio.Event()

    def work() -> None:
        parameter.change(value)
        done.set()

    process.enqueue(work)
    while not done.is_set():
        await asyncio.sleep(0.001)
    await asyncio.sleep(0.01)


async def values(manager: Manager, instance: str) -> tuple[dict[str, Any], dict[str, Any]]:
    """The values of its parameters, and the declared ones of those that were set at run time."""
    state = await manager.peek(instance)
    return state.parameters, state.declared


def fates(outcome: Outcome) -> dict[str, str]:
    return {value.parameter: value.fate for value in outcome.parameters}


def scenario(
    folder: Path, body: Callable[[Manager, Simulator], Awaitable[None]], specification: Specification | None = None
) -> None:
    managed("talker", folder / "workspace", body, specification=specification or tuned(folder))


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "workspace").mkdir()
    return tmp_path


STRATEGIES = pytest.mark.parametrize("strategy", ["minimal", "paper", "quiesce"])


@STRATEGIES
@pytest.mark.parametrize("declares", [True, False], ids=["declared in the file", "declared by the program alone"])
def test_a_value_set_by_a_tool_travels_to_the_replacement(folder: Path, strategy: str, declares: bool) -> None:
    async def body(manager: Manager, simulator: Simulator) -> None:
        await set_by_a_tool(simulator, "talker", "gain", 1.7)
        assert await values(manager, "talker") == ({"gain": 1.7, "label": "plain"}, {"gain": 1.5})
        for old, new in (("talker", "talker_2"), ("talker_2", "talker_3")):
            outcome = await manager.change(changed(RESTART, strategy=strategy))
            assert (outcome.outcome, fates(outcome)) == ("done", {"gain": "kept"}), outcome.because
            assert await values(manager, new) == ({"gain": 1.7, "label": "plain"}, {"gain": 1.5}), old
        words = "talker: gain = 1.7, set at run time: kept"
        assert [each.words for each in outcome.parameters] == [words]
        planned = words if declares else f"{words} if the program of Talker declares it"
        assert outcome.plan is not None and outcome.plan.parameters is not msgspec.UNSET
        assert [each.words for each in outcome.plan.parameters] == [planned]
        outcome = await manager.change(changed(REPLACE, strategy=strategy))
        assert (outcome.outcome, fates(outcome)) == ("done", {"gain": "kept"})
        assert await values(manager, "talker_2") == ({"gain": 1.7, "label": "plain"}, {"gain": 2.5})

    scenario(folder, body, tuned(folder, declares=declares))


def test_a_value_travels_past_a_stand_in_that_lacks_the_parameter(folder: Path) -> None:
    specification = tuned(folder)
    components = specification.components
    for name in ("Talker", "NewTalker"):
        components = components.set(name, changed(components[name], resource_usage=Map(gpu=1.0)))
    lacking = source().replace('gain = comp.parameter("gain", 1.5, on_change=check)', "").replace("{gain.value}", "")
    (folder / "Light.py").write_text(lacking)
    light = changed(
        components["Talker"], name="Light", run=f"python3 {folder / 'Light.py'}", resource_usage=Map(), parameters=Map()
    )
    resources = Map(gpu=Resource("gpu", 1.0))
    specification = changed(specification, components=components.set("Light", light), resources=resources)

    async def body(manager: Manager, simulator: Simulator) -> None:
        await set_by_a_tool(simulator, "talker", "gain", 1.7)
        outcome = await manager.change(changed(REPLACE, detours=True))
        assert (outcome.outcome, fates(outcome)) == ("done", {"gain": "kept"}), outcome.because
        assert outcome.plan is not None and outcome.plan.detours
        assert [each.stand_in for each in outcome.plan.detours] == ["Light"]
        assert await values(manager, "talker_2") == ({"gain": 1.7, "label": "plain"}, {"gain": 2.5})

    scenario(folder, body, specification)


def test_the_new_program_reads_the_kept_value_before_it_starts(folder: Path) -> None:
    new = source(2.5).replace("comp.start()", "print('begins with', gain.value)\ncomp.start()")

    async def body(manager: Manager, simulator: Simulator) -> None:
        await set_by_a_tool(simulator, "talker", "gain", 1.7)
        assert (await manager.change(REPLACE)).outcome == "done"
        assert "begins with 1.7" in simulator.log("talker_2")

    scenario(folder, body, tuned(folder, new))


def test_a_value_set_back_to_the_declared_one_counts_as_not_set(folder: Path) -> None:
    async def body(manager: Manager, simulator: Simulator) -> None:
        await set_by_a_tool(simulator, "talker", "gain", 1.7)
        await set_by_a_tool(simulator, "talker", "gain", 1.5)
        outcome = await manager.change(REPLACE)
        assert (outcome.outcome, outcome.parameters) == ("done", [])
        assert await values(manager, "talker_2") == ({"gain": 2.5, "label": "plain"}, {})

    scenario(folder, body)


# -- set while a change is under way -------------------------------------------------------------------


def at_command(manager: Manager, instance: str, name: str, work: Callable[[], Awaitable[None]], nth: int = 1) -> None:
    """Do ``work`` right before the ``nth`` command ``name`` to ``instance`` is sent from now on."""
    client, counted = manager._client, 0
    send = client._send

    async def sending(to: str, command: Any, revision: int | None) -> Any:
        nonlocal counted
        if (to, command.name) == (instance, name):
            counted += 1
            if counted == nth:
                await work()
        return await send(to, command, revision)

    client._send = sending  # type: ignore[method-assign, assignment]


@pytest.mark.parametrize(
    ("instance", "command"),
    [
        pytest.param("talker_2", "welcome", id="while the new process starts"),
        pytest.param("talker_2", "await_write", id="before the cut"),
        pytest.param("talker_2", "cut_in", id="when the cut is agreed"),
        pytest.param("talker", "detach", id="after the cut"),
    ],
)
@pytest.mark.parametrize("value", [1.9, 1.5], ids=["another value", "back to the declared value"])
def test_a_value_set_during_the_change_is_not_lost(folder: Path, instance: str, command: str, value: float) -> None:
    async def body(manager: Manager, simulator: Simulator) -> None:
        await set_by_a_tool(simulator, "talker", "gain", 1.7)
        at_command(manager, instance, command, lambda: set_by_a_tool(simulator, "talker", "gain", value))
        outcome = await manager.change(RESTART)
        assert outcome.outcome == "done", outcome.because
        declared, kept = ({"gain": 1.5}, {"gain": "kept"}) if value != 1.5 else ({}, {})
        assert await values(manager, "talker_2") == ({"gain": value, "label": "plain"}, declared)
        assert fates(outcome) == kept
        assert [each.value for each in outcome.parameters] == [value] * len(kept)

    scenario(folder, body)


def test_a_value_set_as_the_old_one_is_being_ended_is_not_lost(folder: Path) -> None:
    async def body(manager: Manager, simulator: Simulator) -> None:
        end = manager._launcher.end

        async def ending(name: str, *, asked: bool = False, whole: bool = False) -> None:
            await set_by_a_tool(simulator, name, "gain", 1.9)
            await end(name)

        manager._launcher.end = ending  # type: ignore[method-assign]
        outcome = await manager.change(RESTART)
        assert (outcome.outcome, fates(outcome)) == ("done", {"gain": "kept"})
        assert await values(manager, "talker_2") == ({"gain": 1.9, "label": "plain"}, {"gain": 1.5})

    scenario(folder, body)


def test_a_value_that_comes_too_late_and_is_refused_is_in_the_report(folder: Path) -> None:
    async def body(manager: Manager, simulator: Simulator) -> None:
        at_command(manager, "talker", "detach", lambda: set_by_a_tool(simulator, "talker", "gain", 50.0))
        outcome = await manager.change(REPLACE)
        assert outcome.outcome == "done"
        (late,) = outcome.parameters
        assert (late.fate, late.value) == ("late", 50.0)
        assert "too late, after the hand-over: gain = 50.0" in late.words
        assert "it must be from 0 to 10" in late.words
        assert await values(manager, "talker_2") == ({"gain": 2.5, "label": "plain"}, {})

    scenario(folder, body, tuned(folder, source(2.5, limit=10)))


# -- refused -------------------------------------------------------------------------------------------


def test_a_value_of_the_wrong_type_is_a_refused_plan(folder: Path) -> None:
    async def body(manager: Manager, simulator: Simulator) -> None:
        await set_by_a_tool(simulator, "talker", "gain", 1.7)
        words = "talker has gain = 1.7, set at run time, and NewTalker takes a string"
        with pytest.raises(PlanRefused, match=words):
            await manager.plan(REPLACE)
        outcome = await manager.change(REPLACE)
        assert outcome.outcome == "refused" and words in str(outcome.because)
        assert list(simulator.processes) == ["listener", "talker"]
        outcome = await manager.change(changed(REPLACE, declared_parameters=True))
        assert (outcome.outcome, fates(outcome)) == ("done", {"gain": "not_kept"}), outcome.because
        assert await values(manager, "talker_2") == ({"gain": "soft", "label": "plain"}, {})

    new = source("soft").replace("not 0 <= value <= 100", "not value")
    scenario(folder, body, tuned(folder, new, new_gain="soft"))


@pytest.mark.parametrize(
    ("when", "strategy"),
    [
        ("before the change", "minimal"),
        ("before the change", "paper"),
        ("before the change", "quiesce"),
        ("before the cut", "minimal"),
    ],
)
def test_a_value_that_the_new_callback_refuses_rolls_the_change_back(folder: Path, when: str, strategy: str) -> None:
    async def body(manager: Manager, simulator: Simulator) -> None:
        async def set_it() -> None:
            await set_by_a_tool(simulator, "talker", "gain", 50.0)

        if when == "before the change":
            await set_it()
        else:
            at_command(manager, "talker_2", "await_write", set_it)
        await set_by_a_tool(simulator, "talker", "label", "left")
        outcome = await manager.change(changed(REPLACE, strategy=strategy))
        assert outcome.outcome == "rolled_back"
        assert "gain = 50.0, set at run time: " in str(outcome.because)
        assert "it must be from 0 to 10" in str(outcome.because)
        assert outcome.parameters == []
        expected = {"gain": 50.0, "label": "left"}, {"gain": 1.5, "label": "plain"}
        assert await values(manager, "talker") == expected
        assert sorted(simulator.processes) == ["listener", "talker"]

    scenario(folder, body, tuned(folder, source(2.5, limit=10)))


def test_what_is_set_on_the_new_side_before_a_roll_back_returns_to_the_old_one(folder: Path) -> None:
    async def body(manager: Manager, simulator: Simulator) -> None:
        await set_by_a_tool(simulator, "talker", "label", "left")

        end, failed = manager._launcher.end, False

        async def ending(name: str, *, asked: bool = False, whole: bool = False) -> None:
            nonlocal failed
            if name == "talker" and not failed:
                failed = True
                await set_by_a_tool(simulator, "talker_2", "gain", 3.0)
                raise BackendError("a fault of the test")
            await end(name)

        manager._launcher.end = ending  # type: ignore[method-assign]
        outcome = await manager.change(REPLACE)
        assert (outcome.outcome, outcome.parameters) == ("rolled_back", []), outcome.because
        assert await values(manager, "talker") == (
            {"gain": 3.0, "label": "left"},
            {"gain": 1.5, "label": "plain"},
        )

    scenario(folder, body)


def test_a_parameter_that_the_new_component_does_not_declare_is_left_behind(folder: Path) -> None:
    async def body(manager: Manager, simulator: Simulator) -> None:
        await set_by_a_tool(simulator, "talker", "label", "left")
        outcome = await manager.change(REPLACE)
        (label,) = outcome.parameters
        assert (outcome.outcome, label.fate) == ("done", "left_behind")
        assert label.words == "talker: label = 'left', set at run time: not declared by NewTalker, left behind"
        assert await values(manager, "talker_2") == ({"gain": 2.5}, {})

    lines = [line for line in source(2.5).splitlines() if not line.startswith("label")]
    new = "\n".join(lines).replace(" {label.value}", "")
    scenario(folder, body, tuned(folder, new, declares=False))


# -- the file ------------------------------------------------------------------------------------------


def stating(specification: Specification, **stated: ParameterValue) -> Specification:
    node = changed(specification.nodes["talker"], parameters=Map(stated))
    return changed(specification, nodes=specification.nodes.set("talker", node))


def test_where_the_file_changed_the_value_as_well_the_file_wins(folder: Path) -> None:
    specification = tuned(folder)

    async def body(manager: Manager, simulator: Simulator) -> None:
        await set_by_a_tool(simulator, "talker", "gain", 1.7)
        await set_by_a_tool(simulator, "talker", "label", "left")
        outcome = await manager.change(PlanRequest(to=specification))
        assert (outcome.outcome, outcome.plan and outcome.plan.steps, outcome.parameters) == ("done", [], [])
        outcome = await manager.change(PlanRequest(to=stating(specification, gain=4.0)))
        (gain,) = outcome.parameters
        assert (outcome.outcome, gain.fate) == ("done", "file_wins")
        assert gain.words == "talker: gain = 1.7, set at run time: the file wins and changes it to 4.0"
        assert await values(manager, "talker") == ({"gain": 4.0, "label": "left"}, {"label": "plain"})

    scenario(folder, body, specification)


def test_a_value_set_just_before_that_of_the_file_is_in_the_report(folder: Path) -> None:
    specification = tuned(folder)

    async def body(manager: Manager, simulator: Simulator) -> None:
        at_command(manager, "talker", "set", lambda: set_by_a_tool(simulator, "talker", "gain", 1.9))
        outcome = await manager.change(PlanRequest(to=stating(specification, gain=4.0)))
        assert outcome.plan is not None and not outcome.plan.parameters
        assert (outcome.outcome, fates(outcome)) == ("done", {"gain": "file_wins"})

    scenario(folder, body, specification)


def test_apply_with_declared_parameters_sets_them_back_in_place(folder: Path) -> None:
    specification = tuned(folder)

    async def body(manager: Manager, simulator: Simulator) -> None:
        await set_by_a_tool(simulator, "talker", "gain", 1.7)
        outcome = await manager.change(PlanRequest(to=specification, declared_parameters=True))
        assert (outcome.outcome, fates(outcome)) == ("done", {"gain": "not_kept"})
        assert outcome.plan is not None and [step.action for step in outcome.plan.steps] == ["set"]
        assert await values(manager, "talker") == ({"gain": 1.5, "label": "plain"}, {})

    scenario(folder, body, specification)


# -- crashes and restarts ------------------------------------------------------------------------------


def test_after_a_crash_apply_brings_the_values_back(folder: Path) -> None:
    specification = tuned(folder)

    async def body(manager: Manager, simulator: Simulator) -> None:
        await set_by_a_tool(simulator, "talker", "gain", 1.7)
        simulator.processes["talker"].kill()
        await asyncio.sleep(0.5)
        outcome = await manager.change(PlanRequest(to=specification))
        assert (outcome.outcome, fates(outcome)) == ("done", {"gain": "kept"})
        assert await values(manager, "talker") == ({"gain": 1.7, "label": "plain"}, {"gain": 1.5})
        simulator.processes["talker"].kill()
        await asyncio.sleep(0.5)
        outcome = await manager.change(PlanRequest(to=specification, declared_parameters=True))
        assert (outcome.outcome, fates(outcome)) == ("done", {"gain": "not_kept"})
        assert await values(manager, "talker") == ({"gain": 1.5, "label": "plain"}, {})

    scenario(folder, body, specification)


@pytest.mark.parametrize("crashes", [False, True], ids=["the component lives", "the component has crashed"])
def test_a_new_manager_knows_the_values(folder: Path, crashes: bool) -> None:
    specification, simulator = tuned(folder), Simulator()
    workspace = Workspace(folder / "workspace")

    async def main() -> None:
        first = Manager(specification, simulator, workspace, EXAMPLES / "talker")
        await first.up()
        await set_by_a_tool(simulator, "talker", "gain", 1.7)
        assert saved(workspace).values == {"talker": {"gain": 1.7}}
        if crashes:
            simulator.processes["talker"].kill()
            await asyncio.sleep(0.5)
        await first.close()
        if not crashes:
            await set_by_a_tool(simulator, "talker", "gain", 1.8)
        second = Manager(specification, simulator, workspace, EXAMPLES / "talker")
        await second.up()
        gain = 1.7 if crashes else 1.8
        assert await values(second, "talker") == ({"gain": gain, "label": "plain"}, {"gain": 1.5})
        assert saved(workspace).values == {"talker": {"gain": gain}}
        outcome = await second.change(RESTART)
        assert (outcome.outcome, fates(outcome)) == ("done", {"gain": "kept"})
        outcome = await second.change(changed(RESTART, declared_parameters=True))
        assert (outcome.outcome, fates(outcome)) == ("done", {"gain": "not_kept"})
        assert saved(workspace).values == {}
        await second.close()

    simulator.run(main())


def test_a_removed_node_forgets_its_values(folder: Path) -> None:
    specification = tuned(folder)

    async def body(manager: Manager, simulator: Simulator) -> None:
        await set_by_a_tool(simulator, "talker", "gain", 1.7)
        assert (await manager.change(PlanRequest(remove=("talker",)))).outcome == "done"
        outcome = await manager.change(PlanRequest(to=specification))
        assert (outcome.outcome, outcome.parameters) == ("done", [])
        assert await values(manager, "talker") == ({"gain": 1.5, "label": "plain"}, {})

    scenario(folder, body, specification)


# -- midstride param set -------------------------------------------------------------------------------


def test_the_manager_sets_a_parameter_by_the_component_s_own_callback(folder: Path) -> None:
    async def body(manager: Manager, simulator: Simulator) -> None:
        report = await manager.set_parameters("talker", {"gain": 3})
        (gain,) = report.parameters
        assert (report.instance, gain.name, gain.value, gain.declared, gain.set_at_run_time) == (
            "talker",
            "gain",
            3.0,
            1.5,
            True,
        )
        status = await manager.status()
        (shown,) = (each for each in status.instances if each.name == "talker")
        assert [(each.name, each.value, each.set_at_run_time) for each in shown.parameters] == [
            ("gain", 3.0, True),
            ("label", "plain", False),
        ]
        for name, value, words in (
            ("gain", -1.0, "it must be from 0 to 100"),
            ("gain", "loud", "takes a value like 1.5"),
            ("no_such", 1, "there is no parameter no_such; the parameters are: gain, label"),
            ("midstride.state", "x", "shows the state of the component and cannot be set"),
        ):
            with pytest.raises(CommandRefused, match=words) as refused:
                await manager.set_parameters("talker", {name: value})
            last = manager.log()[-1]
            assert (last.kind, last.outcome, last.words) == ("parameters", "refused", f"refused: {refused.value}")
        assert await values(manager, "talker") == ({"gain": 3.0, "label": "plain"}, {"gain": 1.5})
        with pytest.raises(PlanRefused, match="there is no node `talkr`; did you mean `talker`"):
            await manager.set_parameters("talkr", {"gain": 1})
        assert (await manager.change(RESTART)).outcome == "done"
        await manager.set_parameters("talker", {"label": "role"})
        await manager.set_parameters("talker_2", {"label": "instance"})
        assert await values(manager, "talker_2") == (
            {"gain": 3.0, "label": "instance"},
            {"gain": 1.5, "label": "plain"},
        )
        simulator.processes["talker_2"].kill()
        await asyncio.sleep(0.5)
        with pytest.raises(ManagerError, match="talker is not running; `midstride restart talker` restores it"):
            await manager.set_parameters("talker", {"gain": 1})

    scenario(folder, body)


def test_a_setting_during_a_change_waits_and_reaches_the_new_instance(folder: Path) -> None:
    async def body(manager: Manager, simulator: Simulator) -> None:
        changing = asyncio.ensure_future(manager.change(RESTART))
        await asyncio.sleep(0.2)
        assert not changing.done()
        report = await manager.set_parameters("talker", {"gain": 3.0})
        assert changing.done() and report.instance == "talker_2"
        assert "`param set talker gain = 3.0` waits for `restart talker`" in [e.words for e in manager.log()]

    scenario(folder, body)
