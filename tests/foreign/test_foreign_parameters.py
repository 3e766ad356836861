"""Parameters of nodes that do not use Midstride's API: set, read, and taken over by what replaces the node."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import pytest

from midstride.backends.simulator.virtual_loop import run
from midstride.codec.component_form import NamedComponentForm
from midstride.errors import BackendError, CommandRefused, ManagerError, PlanRefused
from midstride.foreign.foreign_parameters import ForeignParameters
from midstride.foreign.gates import Gates
from midstride.foreign.node import ForeignNode
from midstride.foreign.page import KnownSetting
from midstride.foreign.record import ForeignRecord
from midstride.foreign.reported_states import ReportedStates
from midstride.foreign.services import ParameterAccess
from midstride.lang.load import load, load_text
from midstride.model.component import ComponentSpec
from midstride.model.specification_checks import check, errors
from midstride.plan.request import PlanRequest
from midstride.runtime.manager import Manager
from midstride.runtime.records.status_forms import ParameterStatus
from midstride.runtime.workspace import Workspace
from midstride.wire.commands import SetParametersCommand
from tests.foreign.simulated import SimulatedRos, managed

TEXT = """system drive

component Driver {
  run "driver" gate GATE
  parameters { changeable speed = 1.0, gain = 2 }
  functionality drive {
    mode normal { }
    mode slow {
      parameters { gain = 5 }
    }
    mode degraded { }
  }
}

component Other like Driver { run "other" gate GATE }

node driver : Driver { parameters { speed = 2.0 } }
"""
RESTART = PlanRequest(restart=("driver",))
REPLACE = PlanRequest(replace=(("driver", "Other"),))
GATES = pytest.mark.parametrize("gate", ["none", "lifecycle"])
BY_A_TOOL = "set at run time by a ROS tool, or by the node itself"


def text(gate: str = "none") -> str:
    return TEXT.replace("GATE", gate)


async def looked_at(manager: Manager, node: str = "driver") -> dict[str, ParameterStatus]:
    (report,) = await manager.parameters(node)
    return {each.name: each for each in report.parameters}


async def begun(simulator: SimulatedRos) -> None:
    """Wait until the new node has been started."""
    for _ in range(1000):
        if "driver_2" in simulator.nodes:
            return
        await asyncio.sleep(0.01)
    raise AssertionError("no second node has been started within 10 s")


@GATES
def test_midstride_shows_and_sets_the_parameters_of_the_node(gate: str, tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: SimulatedRos) -> None:
        driver = simulator.nodes["driver"]
        assert {name: each.value for name, each in (await looked_at(manager)).items()} == driver.values
        driver.values["own"] = 2.5  # by a ROS tool: what is said is what the node has now
        assert (await looked_at(manager))["own"].value == 2.5
        report = await manager.set_parameters("driver", {"speed": 3})
        (speed,) = report.parameters
        assert (speed.value, speed.declared, speed.set_at_run_time) == (3.0, 2.0, True)
        assert (driver.values["speed"], type(driver.values["speed"])) == (3.0, float)
        own = (await looked_at(manager))["own"]
        assert (own.origin, own.set_at_run_time, bool(speed.origin)) == ("unknown", True, False)

        driver.rejects["speed"] = "the driver is locked"
        with pytest.raises(CommandRefused, match=r"driver refuses speed = 4\.0, own = 9\.0: the driver is locked"):
            await manager.set_parameters("driver", {"speed": 4.0, "own": 9.0})
        with pytest.raises(CommandRefused, match=r"it has no sped; did you mean `speed`\?"):
            await manager.set_parameters("driver", {"sped": 4.0})
        assert (driver.values["own"], driver.values["speed"]) == (2.5, 3.0)

    managed(tmp_path, text(gate), body)


def test_a_node_that_does_not_answer_is_waited_for_briefly_and_nothing_is_set(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: SimulatedRos) -> None:
        driver = simulator.nodes["driver"]
        await looked_at(manager)
        driver.hung = True
        begun = simulator.time.steady()
        with pytest.raises(CommandRefused, match=r"its node /driver has not said its parameters within 1 s; nothing"):
            await manager.set_parameters("driver", {"speed": 3.0})
        (report,) = await manager.parameters("driver")
        assert report.unread and "its parameter services do not answer" in str(report.unread)
        assert [each.name for each in report.parameters] == ["gain", "own", "speed"]
        assert simulator.time.steady() - begun < 5.0
        with pytest.raises(PlanRefused, match="did you mean `driver`"):
            await manager.parameters("drivr")
        simulator.die("driver")
        await asyncio.sleep(1)
        with pytest.raises(ManagerError, match="driver is not running"):
            await manager.parameters("driver")

    managed(tmp_path, text(), body)


def test_a_node_that_sets_what_it_is_asked_to_and_then_hangs_is_not_said_to_have_its_old_values(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: SimulatedRos) -> None:
        driver = simulator.nodes["driver"]
        await looked_at(manager)
        driver.forgets = True
        with pytest.raises(CommandRefused, match="whether it has them now is not known"):
            await manager.set_parameters("driver", {"speed": 3.0})

    managed(tmp_path, text(), body)


@GATES
def test_what_a_tool_has_set_travels_to_each_replacement(gate: str, tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: SimulatedRos) -> None:
        await looked_at(manager)
        simulator.nodes["driver"].values |= {"own": 2.5}
        await manager.set_parameters("driver", {"speed": 3.0})
        await looked_at(manager)
        plan = await manager.plan(REPLACE)
        words = [
            f"driver: own = 2.5, {BY_A_TOOL}: kept if the program of Other declares it",
            "driver: speed = 3.0, set at run time: kept",
        ]
        assert [each.words for each in plan.parameters] == words
        words[0] = f"driver: own = 2.5, {BY_A_TOOL}: kept"
        outcome = await manager.change(REPLACE)
        assert (outcome.outcome, outcome.because) == ("done", None)
        assert [each.words for each in outcome.parameters] == words
        assert [(each.origin, each.fate) for each in outcome.parameters] == [("unknown", "kept"), ("set", "kept")]
        assert simulator.nodes["driver_2"].values == {"own": 2.5, "speed": 3.0, "gain": 2}
        # It had them from its start: no service has set them.
        assert not [event for event in simulator.events if event.startswith("driver_2 set") and "gain" not in event]
        outcome = await manager.change(RESTART)
        assert [each.words for each in outcome.parameters] == words
        assert simulator.of("driver").values == {"own": 2.5, "speed": 3.0, "gain": 2}
        outcome = await manager.change(PlanRequest(restart=("driver",), declared_parameters=True))
        assert outcome.outcome == "done"
        assert simulator.of("driver").values == {"own": 1.5, "speed": 2.0, "gain": 2}

    managed(tmp_path, text(gate), body)


def test_what_is_set_while_the_new_node_starts_is_set_on_it_before_the_old_one_ends(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: SimulatedRos) -> None:
        await looked_at(manager)
        changing = asyncio.ensure_future(manager.change(RESTART))
        await begun(simulator)
        simulator.nodes["driver"].values["own"] = 2.5
        outcome = await changing
        assert (outcome.outcome, [each.fate for each in outcome.parameters]) == ("done", ["kept"])
        assert simulator.nodes["driver_2"].values["own"] == 2.5
        assert [event for event in simulator.events if " set own" in event] == ["driver_2 set own=2.5"]

    managed(tmp_path, text(), body)


@pytest.mark.parametrize(
    ("other", "fate", "words"),
    [
        ({"lacks": {"own"}}, "left_behind", "not declared by Other, left behind"),
        ({"rejects": {"own": "it is read-only"}}, "refused", "driver_2 refuses own = 2.5: it is read-only"),
    ],
)
def test_what_cannot_travel_is_named(other: dict[str, Any], fate: str, words: str, tmp_path: Path) -> None:
    """What the old node itself may have set is no reason to keep it."""

    async def body(manager: Manager, simulator: SimulatedRos) -> None:
        await looked_at(manager)
        changing = asyncio.ensure_future(manager.change(REPLACE))
        await begun(simulator)
        simulator.nodes["driver"].values["own"] = 2.5
        outcome = await changing
        assert (outcome.outcome, outcome.because) == ("done", None)
        (own,) = outcome.parameters
        assert (own.parameter, own.origin, own.fate) == ("own", "unknown", fate)
        assert own.words.startswith(f"driver: own = 2.5, {BY_A_TOOL}: ") and words in own.words

    managed(tmp_path, text(), body, {"Other": other})


def test_values_survive_a_crash_and_another_manager(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: SimulatedRos) -> None:
        await looked_at(manager)
        await manager.set_parameters("driver", {"speed": 3.0})
        simulator.nodes["driver"].values["own"] = 2.5
        await asyncio.sleep(5)  # until it has been looked at
        simulator.die("driver")
        await asyncio.sleep(1)
        outcome = await manager.change(RESTART)
        assert (outcome.outcome, outcome.because) == ("done", None)
        assert simulator.of("driver").values == {"own": 2.5, "speed": 3.0, "gain": 2}
        await manager.close()
        await simulator.manager_killed()
        simulator.of("driver").values["own"] = 3.5
        specification = load(tmp_path / "system.stride").require()
        second = Manager(specification, simulator, Workspace(tmp_path / "system"), tmp_path)
        await second.up()
        found = await looked_at(second)
        assert {name: (each.value, each.set_at_run_time) for name, each in found.items()} == {
            "gain": (2, False),
            "own": (3.5, True),
            "speed": (3.0, True),
        }
        assert (await second.change(RESTART)).outcome == "done"
        assert simulator.of("driver").values == {"own": 3.5, "speed": 3.0, "gain": 2}
        await second.close()

    managed(tmp_path, text(), body)


def test_that_it_is_not_known_what_was_set_is_said(tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: SimulatedRos) -> None:
        driver = simulator.nodes["driver"]
        await looked_at(manager)
        driver.values["own"] = 2.5
        await looked_at(manager)
        driver.hung = True
        await simulator.time.sleep(5)
        plan = await manager.plan(RESTART)
        unknown = "whether parameters of driver were set since it last said its parameters is not known"
        assert any(remark.startswith(unknown) for remark in plan.remarks)
        outcome = await manager.change(RESTART)
        assert outcome.outcome == "done" and outcome.own_state["driver_2"].startswith(unknown)
        assert simulator.nodes["driver_2"].values["own"] == 2.5, "that was known before"

    managed(tmp_path, text(), body)


# -- changeable parameters ---------------------------------------------------------------------------


def test_a_changeable_parameter_is_set_in_place_and_one_that_a_mode_states_when_that_is_left(tmp_path: Path) -> None:
    mode = "mode normal { parameters { speed = 0.5 } }"

    async def body(manager: Manager, simulator: SimulatedRos) -> None:
        driver = simulator.nodes["driver"]
        assert driver.values["speed"] == 0.5
        target = load_text(both.replace("speed = 2.0", "speed = 4.0, own = 7.5")).require()
        outcome = await manager.change(PlanRequest(to=target))
        assert (outcome.outcome, outcome.because, sorted(simulator.nodes)) == ("done", None, ["driver"])
        assert (driver.values["speed"], driver.values["own"]) == (0.5, 7.5)

    both = text().replace("mode normal { }", mode).replace("gain = 5", "gain = 5, speed = 0.1")
    both = both.replace("changeable speed", "changeable own = 1.5, changeable speed")
    managed(tmp_path, both, body)


@GATES
def test_apply_sets_a_changeable_parameter_and_the_file_wins(gate: str, tmp_path: Path) -> None:
    async def body(manager: Manager, simulator: SimulatedRos) -> None:
        driver = simulator.nodes["driver"]
        await manager.set_parameters("driver", {"speed": 3.0})
        target = load_text(text(gate).replace("speed = 2.0", "speed = 4.0")).require()
        simulator.events.clear()
        outcome = await manager.change(PlanRequest(to=target))
        assert (outcome.outcome, outcome.because) == ("done", None)
        assert [each.fate for each in outcome.parameters] == ["file_wins"]
        assert simulator.events == ["driver set speed=4.0"]
        speed = (await looked_at(manager))["speed"]
        assert (speed.value, speed.set_at_run_time) == (4.0, False)
        driver.rejects["speed"] = "too fast"
        again = load_text(text(gate).replace("speed = 2.0", "speed = 9.0")).require()
        outcome = await manager.change(PlanRequest(to=again))
        assert outcome.outcome == "rolled_back" and "driver refuses speed = 9.0: too fast" in str(outcome.because)
        assert (await looked_at(manager))["speed"].value == 4.0
        assert (await manager.change(RESTART)).outcome == "done"
        assert simulator.of("driver").values["speed"] == 4.0

    managed(tmp_path, text(gate), body)


def test_with_every_gate_a_parameter_may_be_changeable() -> None:
    for gate in ("preload", "relay"):
        assert errors(check(load_text(text(gate)).require())) == []


def test_a_noted_request_that_cannot_be_read_hides_no_other_one(tmp_path: Path) -> None:
    noted = [KnownSetting(1.0, "/driver/set_parameters", each) for each in (b"gain", b"\xff", b"speed")]
    taken = {"/driver/set_parameters": 1, "/driver/set_parameters_atomically": 0}
    requests = SimpleNamespace(taken=taken.get, settings=lambda: noted[: taken["/driver/set_parameters"]])
    record = ForeignRecord(
        instance="driver",
        node="/driver",
        token="a token",
        uuid="driver",
        pid=1,
        started=0,
        declaration=NamedComponentForm.of(ComponentSpec.of("Driver")),
        index=0,
        topics={},
        modes={},
    )
    node = ForeignNode(record, tmp_path, None, ReportedStates(), cast(Gates, requests))

    def settings_in(request: bytes) -> dict[str, Any]:
        if request == b"\xff":
            raise BackendError("it cannot be read")
        return {request.decode(): 2}

    node.settings_in = settings_in
    node.note_settings()
    assert (set(node.settings), node._all_settings) == ({"gain"}, True)
    for number in (2, 3):
        taken["/driver/set_parameters"] = number
        node.note_settings()
        node.note_settings()  # it is looked at once
        assert not node._all_settings  # what the unreadable one has set is not known
    assert set(node.settings) == {"gain", "speed"}


class Offered:
    """The services of a node that offers them once it is ``offers``."""

    offers = False

    def __init__(self) -> None:
        self.values: dict[str, Any] = {"gain": 2}

    def offers_parameters(self) -> bool:
        return self.offers

    async def parameters(self, timeout: float) -> dict[str, Any]:
        return dict(self.values)

    async def set_parameters(self, values: Mapping[str, Any], timeout: float) -> str | None:
        self.values |= values
        return None


def test_a_node_without_parameter_services_is_waited_for_once(tmp_path: Path) -> None:
    """A hand-over asks for its parameters several times, and each would last a second longer."""
    component = load_text(text()).require().components["Driver"]
    declaration = NamedComponentForm.of(component)
    record = ForeignRecord(
        instance="driver",
        node="/driver",
        token="",
        uuid="",
        pid=0,
        started=0,
        declaration=declaration,
        index=None,
        topics={},
        modes={"drive": "normal"},
    )
    node, services = ForeignNode(record, tmp_path, None, ReportedStates()), Offered()
    parameters = ForeignParameters(node, cast(ParameterAccess, services))

    async def body() -> None:
        loop = asyncio.get_running_loop()
        begun = loop.time()
        await asyncio.gather(parameters.read(), parameters.read())
        waited = loop.time() - begun
        assert (node.unread_parameters, round(waited, 1)) == (True, 1.0)
        begun = loop.time()
        await parameters.read()
        assert (node.unread_parameters, loop.time()) == (True, begun)
        words = r"its node /driver offers no services for its parameters that the graph has shown within 1 s; nothing"
        with pytest.raises(CommandRefused, match=words):
            await parameters.set(SetParametersCommand(parameters={"gain": 3}))
        assert round(loop.time() - begun, 1) == 1.0  # each time anew, as discovery may be late
        loop.call_later(0.5, setattr, services, "offers", True)
        await parameters.set(SetParametersCommand(parameters={"gain": 3}))
        assert (node.unread_parameters, node.parameters) == (False, {"gain": 3})

    run(body())
