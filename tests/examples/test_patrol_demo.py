"""The demonstration of the patrol robot, from start to end."""

from __future__ import annotations

import asyncio
import io
from collections.abc import Callable, Coroutine
from pathlib import Path
from types import ModuleType
from typing import Any
from xml.etree import ElementTree

import pytest
from rich.console import Console

from midstride.backends.simulator import Simulator, virtual_loop
from midstride.cli import example as examples
from midstride.lang.load import load
from midstride.plan.request import PlanRequest
from midstride.runtime.manager import Manager
from midstride.runtime.workspace import Workspace
from tests.docs.test_snippets import snippets
from tests.examples.conftest import EXAMPLES

FOLDER = EXAMPLES / "patrol"
NOTHING_LOST = ("the lidar driver is replaced", "a bad version is deployed", "the manager dies")


def test_the_map_shows_the_robot_the_people_and_the_walls(patrol: Callable[[str], ModuleType]) -> None:
    state = {"x": 3.2, "y": 2.5, "heading": 1.6, "people": [[10.1, 3.5], [19.9, 15.9]]}
    lines = patrol("picture").hall_map(state, "full").plain.splitlines()
    assert {len(line) for line in lines} == {42} and len(lines) == 18
    assert lines[-4][1 + 6] == "↑"  # two rows above the lowest one
    assert lines[-5][1 + 20] == "o" and lines[1][40] == "o"
    assert lines[-10][1 + 12 : 1 + 28] == "▒" * 16 and "▒" not in lines[-4]


def test_the_animation_shows_where_it_was_in_which_mode_and_what_happened(patrol: Callable[[str], ModuleType]) -> None:
    animate = patrol("animate")
    people = ((5.0, 5.0), (6.0, 5.0))
    frames = [
        animate.Frame(3.0, 3.0, 3.0, "full", people, ""),
        animate.Frame(3.5, 3.0, -3.0, "slow", people, "it hangs"),
        animate.Frame(4.0, 3.0, -3.0, "slow", people, "it hangs"),
    ]
    root = ElementTree.fromstring(animate.drawn(frames))
    moved = [each.attrib for each in root.iter("{http://www.w3.org/2000/svg}animateTransform")]
    assert next(each["values"] for each in moved if each["type"] == "translate") == "3.00 3.00;3.50 3.00;4.00 3.00"
    # It turns on past straight back, and not the whole way round.
    assert [each["values"] for each in moved if each["type"] == "rotate"] == ["172;188;188"]
    stepped = [each.attrib for each in root.iter("{http://www.w3.org/2000/svg}animate")]
    shown = [(each["values"], each["keyTimes"]) for each in stepped if each["attributeName"] == "r"]
    assert shown == [("6;4", "0.0000;0.3333")]
    assert {each.text for each in root.iter("{http://www.w3.org/2000/svg}text")} >= {"it hangs", "controller: slow"}
    assert (FOLDER / "patrol.svg").stat().st_size < 300_000


@pytest.mark.full
def test_in_virtual_time(monkeypatch: pytest.MonkeyPatch, patrol: Callable[[str], ModuleType]) -> None:
    monkeypatch.setenv("MIDSTRIDE_DEMO", "")
    out = Console(file=io.StringIO(), width=160)
    run: Callable[..., Coroutine[Any, Any, list[dict[str, Any]]]] = patrol("demo").run
    rows = virtual_loop.run(run(examples.find("patrol"), "sim", out))
    assert [row["outcome"] for row in rows] == ["done"] * 8, rows
    for row in rows:
        degrades = row["name"] not in NOTHING_LOST
        assert (row["degraded"] > 0, row["slowest"] != "full") == (degrades, degrades), row
        assert (row["uncommanded"], row["near_misses"]) == (0, 0)
    assert isinstance(out.file, io.StringIO)
    assert "the perception is upgraded" in out.file.getvalue()


@pytest.mark.full
def test_the_component_of_the_readme_is_added_to_the_running_robot(tmp_path: Path) -> None:
    programs = tmp_path / "examples" / "patrol"
    programs.mkdir(parents=True)
    for file in FOLDER.iterdir():
        if file.suffix in {".py", ".stride"}:
            (programs / file.name).write_bytes(file.read_bytes())
    for snippet in snippets(FOLDER / "README.md"):
        if "file" in snippet.options:
            (tmp_path / snippet.options["file"]).write_text(snippet.text)
    robot, extended = (load(programs / f"{name}.stride").require() for name in ("patrol", "with_beeper"))
    simulator = Simulator()

    async def main() -> None:
        manager = Manager(robot, simulator, Workspace(tmp_path), programs)
        await manager.up()
        try:
            before = set(manager.configuration.instances)
            outcome = await manager.change(PlanRequest(to=extended))
            assert (outcome.outcome, outcome.below_baseline_seconds) == ("done", {})
            assert set(manager.configuration.instances) == before | {"beeper"}
            assert (await manager.why("beeper.warn")).mode == "quiet"
        finally:
            await manager.close()

    simulator.run(main())


@pytest.mark.full
def test_two_robots_by_namespace_do_not_disturb_each_other(tmp_path: Path) -> None:
    simulator = Simulator()

    async def main() -> None:
        manager = Manager(load(FOLDER / "fleet.stride").require(), simulator, Workspace(tmp_path), FOLDER)
        await manager.up()
        try:
            halls = [simulator.processes[f"robot{number}/world"]._program._main.__dict__ for number in (1, 2)]
            await asyncio.sleep(5.0)
            assert all(hall["state"].progress > 2.0 for hall in halls)
            simulator.faults.kill("robot2/lidar_detector")
            await asyncio.sleep(0.2)
            drive = [(await manager.why(f"robot{number}/controller.drive")).mode for number in (1, 2)]
            assert drive == ["full", "slow"]
        finally:
            await manager.close()

    simulator.run(main())
