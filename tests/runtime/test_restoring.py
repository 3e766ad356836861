"""What the local reflex has degraded is restored by the manager once its input is back, in virtual time."""

from __future__ import annotations

import asyncio
import copy
import itertools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from msgspec import structs

from midstride.codec.specification_form import decode_specification
from midstride.model.component import FunctionalityRef
from midstride.model.specification import initial
from midstride.plan.request import PlanRequest
from midstride.runtime.manager import Manager
from midstride.runtime.options import NO_OPTIONS, SystemOptions
from midstride.runtime.process.component_client import ComponentClient
from midstride.runtime.restore.restoring import _Record, lacking
from midstride.runtime.timeouts import within
from midstride.runtime.workspace import Workspace
from midstride.wire.channel import ComponentReport
from midstride.wire.commands import ModesCommand
from midstride.wire.frames import StateChanged
from midstride.wire.state import (
    ComponentState,
    FieldSamples,
    FunctionalityState,
    LinkState,
    Measured,
    MeasuredResponses,
)
from tests.planting import plant
from tests.runtime.systems import request
from tests.runtime.test_reflex import CHAIN, Chain, in_chain

# How long it takes at most: the input is measured over 1 s, has to stay for 1 s, and both show in reports (s).
RESTORED = 4.0
NORMAL = ["normal"] * 4


def modes(chain: Chain) -> list[str]:
    return [chain.mode(name) for name in CHAIN]


def words(chain: Chain, kind: str) -> list[str]:
    return [event.words for event in chain.manager.log() if event.kind == kind]


async def seconds_until(chain: Chain, holds: Callable[[], bool], at_most: float) -> float:
    began = chain.simulator.clock.steady()
    async with within(at_most):
        while not holds():
            await asyncio.sleep(0.01)
    return chain.simulator.clock.steady() - began


async def restored(chain: Chain, at_most: float = RESTORED) -> float:
    """How long it takes until all are in their normal modes (s)."""
    return await seconds_until(chain, lambda: modes(chain) == NORMAL, at_most)


async def fall(chain: Chain, fault: str = "silent") -> None:
    (chain.folder / fault).touch()
    await seconds_until(chain, lambda: modes(chain)[1:] == ["degraded"] * 3, 10.0)


async def restoring(chain: Chain, name: str = "b") -> str | None:
    [found] = [each for each in (await chain.manager.status()).instances if each.name == name]
    return found.functionalities[0].restoring


def test_a_lock_that_holds_recovery_back_delays_restoring_and_uses_up_no_attempt(tmp_path: Path) -> None:
    async def body(chain: Chain) -> None:
        chain.manager.lock("a person is inside", "alice", None, holds_recovery=True)
        await fall(chain)
        (chain.folder / "silent").unlink()
        await asyncio.sleep(20.0)
        assert modes(chain)[1:] == ["degraded"] * 3 and words(chain, "restore") == []
        held = await restoring(chain)
        assert held is not None and held.startswith("restored when that may happen: the system is locked by alice")
        chain.manager.unlock("alice")
        await restored(chain)
        assert words(chain, "restore") == ["what b.work relies on is back: it is restored (1 of 5 in 60 s)"]

    in_chain(tmp_path, body)


@pytest.mark.parametrize("fault", ["silent", "slow", "hung"])
def test_what_fell_comes_back_without_a_command_and_says_so(tmp_path: Path, fault: str) -> None:
    async def body(chain: Chain) -> None:
        await fall(chain, fault)
        await asyncio.sleep(10.0)
        assert modes(chain)[1:] == ["degraded"] * 3 and words(chain, "restore") == []
        if fault == "hung":  # a, whose call hangs, has to come back first
            assert await restoring(chain, "a") == "restored when its call has returned"
        else:
            assert await restoring(chain) == "restored when input in is back"
        (chain.folder / fault).unlink()
        assert await restored(chain) >= (1.0 if fault == "hung" else 1.9)
        await asyncio.sleep(3.0)
        assert modes(chain) == NORMAL and (await chain.manager.status()).valid
        first = "a.work" if fault == "hung" else "b.work"
        assert f"what {first} relies on is back: it is restored (1 of 5 in 60 s)" in words(chain, "restore")
        assert words(chain, "command")[1:] == [f"restore {first}"] and words(chain, "outcome")[-1] == "done"
        history = await chain.manager.history(9)
        assert history.changes[-1].command.startswith(f"restore {first}") and history.changes[-1].outcome == "done"
        assert "restore" in [each.kind for each in history.incidents]
        assert await restoring(chain) is None

    in_chain(tmp_path, body)


@pytest.mark.full
def test_a_publisher_that_flaps_has_its_dependants_wait_longer_each_time_and_at_last_stay_degraded(
    tmp_path: Path,
) -> None:
    async def body(chain: Chain) -> None:
        delays = []
        for _ in range(5):
            await fall(chain)
            (chain.folder / "silent").unlink()
            delays.append(await restored(chain, 30.0))
        assert [round(after - before) for before, after in itertools.pairwise(delays)] == [1, 2, 4, 8]
        await fall(chain)
        (chain.folder / "silent").unlink()
        await asyncio.sleep(100.0)
        assert modes(chain)[1:] == ["degraded"] * 3
        remedy = "`midstride apply` with the system's file restores it"
        because = f"it will not be restored again: 5 attempts within 60 s did not last; {remedy}"
        assert await restoring(chain) == because
        assert words(chain, "restore_ended") == [f"b.work {because.removeprefix('it ')}"]
        assert (await chain.manager.change(PlanRequest(to=chain.manager.specification))).outcome == "done"
        assert modes(chain) == NORMAL
        await fall(chain)  # a command has restored it: what was counted begins anew
        (chain.folder / "silent").unlink()
        assert await restored(chain) < RESTORED

    in_chain(tmp_path, body)


@pytest.mark.full
def test_an_input_that_is_back_only_for_a_moment_restores_nothing(tmp_path: Path) -> None:
    async def body(chain: Chain) -> None:
        await fall(chain)
        for _ in range(20):
            (chain.folder / "silent").unlink()
            await asyncio.sleep(1.5)
            (chain.folder / "silent").touch()
            await asyncio.sleep(1.5)
            assert modes(chain)[1:] == ["degraded"] * 3
        (chain.folder / "silent").unlink()
        await restored(chain)
        assert words(chain, "command")[1:] == ["restore b.work"]

    in_chain(tmp_path, body)


@pytest.mark.parametrize("resumes", ["before", "after"])
def test_the_next_manager_restores_what_fell_without_one(tmp_path: Path, resumes: str) -> None:
    async def body(chain: Chain) -> None:
        await chain.manager.close()
        await fall(chain)
        if resumes == "before":
            (chain.folder / "silent").unlink()
            await asyncio.sleep(3.0)
        chain.manager = await taken_over(chain)
        try:
            assert modes(chain) == NORMAL if resumes == "before" else modes(chain)[1:] == ["degraded"] * 3
            if resumes == "after":
                await asyncio.sleep(10.0)
                assert words(chain, "degraded") == words(chain, "restore") == []
                (chain.folder / "silent").unlink()
            await restored(chain)
            await asyncio.sleep(5.0)
            assert modes(chain) == NORMAL and (await chain.manager.status()).valid
        finally:
            await chain.manager.close()

    in_chain(tmp_path, body)


async def taken_over(chain: Chain, options: SystemOptions = NO_OPTIONS) -> Manager:
    workspace = Workspace(chain.folder.parent / "system")
    manager = Manager(chain.manager.specification, chain.simulator, workspace, chain.folder, options=options)
    await manager.up()
    return manager


def test_a_chain_that_fell_while_the_manager_was_cut_off_is_restored(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nothing reaches the manager meanwhile, so that each component falls by its own reflex."""

    async def body(chain: Chain) -> None:
        with monkeypatch.context() as cut:
            plant(cut, ComponentClient, "_on_report", lambda *_, **__: None)
            await fall(chain)
            assert words(chain, "degraded") == []
        (chain.folder / "silent").unlink()
        await restored(chain)
        assert words(chain, "command")[1:] == ["restore b.work"]

    in_chain(tmp_path, body)


def test_what_its_own_code_has_degraded_stays_so(tmp_path: Path) -> None:
    """The source raises an exception, which degrades what relies on it as well."""

    async def body(chain: Chain) -> None:
        await fall(chain, "raises")
        (chain.folder / "raises").unlink()
        await asyncio.sleep(20.0)
        assert modes(chain) == ["degraded"] * 4 and words(chain, "command")[1:] == []
        await chain.manager.change(PlanRequest(to=chain.manager.specification))
        assert modes(chain) == NORMAL

    in_chain(tmp_path, body)


def test_what_a_person_has_degraded_stays_so(tmp_path: Path) -> None:
    """c is lowered by its control socket; then b falls, and comes back without it."""

    async def body(chain: Chain) -> None:
        workspace = Workspace(chain.folder.parent / "system")
        state = chain.simulator.state("c")
        assert state is not None
        lower = ModesCommand(modes={"work": "degraded"}, because="its camera is being cleaned")
        assert (await request(workspace, chain.simulator, "c", lower, state.revision)).ok
        await asyncio.sleep(1.0)
        await fall(chain)
        (chain.folder / "silent").unlink()
        await seconds_until(chain, lambda: chain.mode("b") == "normal", RESTORED)
        await asyncio.sleep(20.0)
        assert modes(chain) == ["normal", "normal", "degraded", "degraded"]
        assert await restoring(chain, "c") is None
        assert words(chain, "command")[1:] == ["restore b.work"]
        assert (await chain.manager.change(PlanRequest(to=chain.manager.specification))).outcome == "done"
        assert modes(chain) == NORMAL

    in_chain(tmp_path, body)


def test_a_restore_that_fails_is_tried_again_later(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    refused: list[float] = []

    async def body(chain: Chain) -> None:
        change = ComponentClient.change

        async def refusing(self: ComponentClient, instance: str, command: object) -> object:
            if isinstance(command, ModesCommand) and command.modes == {"work": "normal"} and instance == "b":
                refused.append(chain.simulator.clock.steady())
                if len(refused) <= 2:
                    command = ModesCommand(modes={"work": "no such mode"}, because="")
            return await change(self, instance, command)  # type: ignore[arg-type]

        await fall(chain)
        plant(monkeypatch, ComponentClient, "change", refusing)
        (chain.folder / "silent").unlink()
        await restored(chain, 20.0)
        assert len(refused) == 3
        await asyncio.sleep(3.0)  # it is measured
        assert [round(later - before) for before, later in itertools.pairwise(refused)] == [3, 5]
        outcomes = [event.outcome for event in chain.manager.log() if event.kind == "outcome"]
        assert outcomes[1:] == ["rolled_back", "rolled_back", "done"]
        assert (await chain.manager.status()).valid

    in_chain(tmp_path, body)


def test_a_manager_that_takes_the_system_down_or_leaves_it_restores_nothing_more(tmp_path: Path) -> None:
    async def body(chain: Chain) -> None:
        await fall(chain)
        chain.manager._restorer.stop()
        (chain.folder / "silent").unlink()
        await asyncio.sleep(20.0)
        assert modes(chain)[1:] == ["degraded"] * 3 and words(chain, "restore") == []

    in_chain(tmp_path, body)


def test_how_often_something_has_fallen_is_forgotten_with_its_instance_and_not_before(tmp_path: Path) -> None:
    """Commands end, and reports come, in between; the next instance begins anew."""

    async def body(chain: Chain) -> None:
        restorer, ref = chain.manager._restorer, FunctionalityRef("b", "work")
        for number in (1, 2):
            await fall(chain)
            (chain.folder / "silent").unlink()
            await restored(chain, 10.0)
            await asyncio.sleep(3.0)  # it is measured
            assert len(restorer._records[ref].attempts.made) == number
        ran = restorer._records[ref].attempts
        assert ran.runs_since is not None and 0.0 < ran.ran < 60.0, "the time between the two falls counts"
        assert (await chain.manager.change(PlanRequest(restart=("b",)))).outcome == "done"
        assert ref not in restorer._records

    in_chain(tmp_path, body)


@pytest.mark.parametrize(
    ("record", "due"),
    [
        (_Record(fallen=True, number=1, supported_since=5.0), 6.0),  # the first time after 1 s, then longer each time
        (_Record(fallen=True, number=3, supported_since=5.0), 9.0),
        (_Record(fallen=True, conditional=True, number=1, supported_since=5.0), 5.0),  # as soon as the condition holds
        (_Record(fallen=True, number=1), None),
        (_Record(fallen=True, number=1, supported_since=5.0, left="5 attempts did not last"), None),
        (_Record(number=1, supported_since=5.0), None),
    ],
)
def test_when_something_is_due_to_be_restored(record: _Record, due: float | None) -> None:
    assert record.due() == due


def test_a_command_that_restores_comes_first_and_begins_the_count_anew(tmp_path: Path) -> None:
    async def body(chain: Chain) -> None:
        for _ in range(8):
            await fall(chain)
            (chain.folder / "silent").unlink()
            await asyncio.sleep(1.0)
            await chain.manager.change(PlanRequest(to=chain.manager.specification))
            assert modes(chain) == NORMAL
        assert words(chain, "restore") == words(chain, "restore_ended") == []

    in_chain(tmp_path, body)


@pytest.mark.full
def test_with_keep_degraded_only_a_command_restores(tmp_path: Path) -> None:
    async def body(chain: Chain) -> None:
        await chain.manager.close()
        chain.manager = await taken_over(chain, SystemOptions(keep_degraded=True))
        try:
            await fall(chain)
            (chain.folder / "silent").unlink()
            await asyncio.sleep(20.0)
            assert modes(chain)[1:] == ["degraded"] * 3 and await restoring(chain) is None
        finally:
            await chain.manager.close()

    in_chain(tmp_path, body)


def test_a_chain_that_falls_again_and_again_while_the_manager_is_cut_off_comes_back_as_a_whole(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each time, each falls by its own reflex; what is further down does not wait once more for what is before it."""

    async def body(chain: Chain) -> None:
        for number in range(1, 4):
            with monkeypatch.context() as cut:
                plant(cut, ComponentClient, "_on_report", lambda *_, **__: None)
                await fall(chain)
            (chain.folder / "silent").unlink()
            assert await restored(chain, 10.0) < RESTORED + 2 ** (number - 1)
            await asyncio.sleep(3.0)
            assert words(chain, "command")[1:] == ["restore b.work"] * number

    in_chain(tmp_path, body)


def test_a_dependant_that_does_not_answer_when_the_others_are_restored_is_restored_later(tmp_path: Path) -> None:
    async def body(chain: Chain) -> None:
        await fall(chain)
        chain.simulator.faults.freeze("c", 12.0)
        await asyncio.sleep(4.0)
        (chain.folder / "silent").unlink()
        await seconds_until(chain, lambda: chain.mode("b") == "normal", RESTORED)
        await restored(chain, 20.0)
        assert words(chain, "command")[1:] == ["restore b.work", "restore c.work"]

    in_chain(tmp_path, body)


@pytest.mark.parametrize(("busy", "hangs"), [(0.05, False), (2.0, True)])
def test_a_degraded_mode_that_is_at_work_is_no_call_that_hangs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, busy: float, hangs: bool
) -> None:
    """Each report shows a call under way, of which only a long one may hang."""
    on_report = ComponentClient._on_report

    def at_work(self: ComponentClient, instance: str, frame: ComponentReport) -> None:
        if isinstance(frame, StateChanged):
            views = {name: structs.replace(view, busy=busy) for name, view in frame.state.functionalities.items()}
            frame = StateChanged(state=structs.replace(frame.state, functionalities=views))
        on_report(self, instance, frame)

    async def body(chain: Chain) -> None:
        plant(monkeypatch, ComponentClient, "_on_report", at_work)
        await fall(chain)
        (chain.folder / "silent").unlink()
        await asyncio.sleep(RESTORED)
        assert (modes(chain) != NORMAL) is hangs

    in_chain(tmp_path, body)


# -- which inputs lack what they assume ----------------------------------------------------------------------

IMAGE = {"type": "sensor_msgs/msg/Image", "rate": 20, "where": {"width": {">=": 640}}}
CAMERAS = {
    "system": "cameras",
    "topics": {"/left": IMAGE, "/right": IMAGE},
    "components": {
        "Camera": {
            "outputs": ["out"],
            "functionalities": {
                "look": {"produces": ["out"], "modes": {"normal": {"guarantees": {"out": IMAGE}}, "off": {}}}
            },
        },
        "Pilot": {
            "inputs": {"left": IMAGE, "right": IMAGE},
            "functionalities": {
                "drive": {
                    "uses": ["left", "right"],
                    "modes": {
                        "stereo": {"assumes": ["left", "right"]},
                        "mono": {"assumes": [{"any_of": ["left", "right"]}]},
                        "image": {"assumes": [IMAGE]},
                        "stop": {},
                    },
                }
            },
        },
    },
    "nodes": {
        "left": {"component": "Camera", "attachments": {"out": ["/left"]}},
        "right": {"component": "Camera", "attachments": {"out": ["/right"]}},
        "pilot": {"component": "Pilot", "attachments": {"left": ["/left"], "right": ["/right"]}},
    },
}
PILOT = FunctionalityRef("pilot", "drive")


def link(rate: float | None, violating: int = 0, covered: float = 1.0, count: int = 100) -> LinkState:
    width = FieldSamples(constraint="width >= 640", checked=100, violations=5, run=violating)
    measured = Measured(window=1.0, covered=covered, rate=rate)
    return LinkState(gate=None, count=count, measured=measured, fields={"width": width})


GOOD, SLOW = link(19.0), link(16.0)


@pytest.mark.parametrize(
    ("left", "right", "expected"),
    [
        (GOOD, GOOD, 0),
        (GOOD, SLOW, 1),
        (SLOW, GOOD, 1),
        (SLOW, SLOW, 3),
        (link(0.0), link(None), 3),
        (link(20.0, violating=1), link(20.0, covered=0.9), 3),  # not what is assumed; not measured for long enough
        (link(20.0, violating=1), GOOD, 1),
        (GOOD, link(None, covered=0.0, count=0), 0),  # nothing is concluded of what has never been received
    ],
)
def test_the_best_mode_is_restored_whose_inputs_are_back(left: LinkState, right: LinkState, expected: int) -> None:
    configuration = initial(decode_specification(CAMERAS)).with_modes({PILOT: 3})
    state = reported(left, right)
    missing = [list(lacking(configuration, PILOT, index, state)) for index in range(3)]
    assert [*map(bool, missing), False].index(False) == expected
    # What the model does not support is not judged by what is measured.
    dark = configuration.with_modes({FunctionalityRef(name, "look"): 1 for name in ("left", "right")})
    assert not any(list(lacking(dark, PILOT, index, state)) for index in range(3))


def test_only_inputs_that_can_satisfy_an_assumption_are_looked_at_for_it() -> None:
    """Images that flow do not make up for a scan that does not."""
    scan = {"type": "sensor_msgs/msg/LaserScan", "rate": 20}
    document: Any = copy.deepcopy(CAMERAS)
    document["topics"]["/left"] = scan
    look = {"produces": ["out"], "modes": {"normal": {"guarantees": {"out": scan}}, "off": {}}}
    document["components"]["Lidar"] = {"outputs": ["out"], "functionalities": {"look": look}}
    document["nodes"]["left"]["component"] = "Lidar"
    pilot = document["components"]["Pilot"]
    pilot["inputs"]["left"] = scan
    pilot["functionalities"]["drive"]["modes"] = {"scan": {"assumes": [scan]}, "stop": {}}
    configuration = initial(decode_specification(document)).with_modes({PILOT: 1})
    assert list(lacking(configuration, PILOT, 0, reported(SLOW, GOOD))) == ["left"]


def test_a_client_whose_server_breaks_its_bound_is_not_restored() -> None:
    configuration = initial(decode_specification(CAMERAS)).with_modes({PILOT: 3})
    kept = MeasuredResponses(within=0.05, tolerated=5.0, silent=1.0)
    broken = structs.replace(kept, silent=6.0, broken="has not answered a request")

    def lacks(responses: MeasuredResponses) -> list[str]:
        left = LinkState(gate=None, count=0, responses=responses)
        return list(lacking(configuration, PILOT, 0, reported(left, GOOD)))

    assert lacks(kept) == []
    assert lacks(broken) == ["left"]


def reported(left: LinkState, right: LinkState) -> ComponentState:
    return ComponentState(
        instance="pilot",
        uuid="",
        pid=1,
        revision=1,
        functionalities={"drive": FunctionalityState(mode="stop", since=1.0, because="", reflex=True)},
        ports={"left": {"/left": left}, "right": {"/right": right}},
        parameters={},
        stopping=1.0,
    )
