"""The action for launch files, against the interface that ROS 2's `launch` documents: it is on no package index.

What is used of it: `ExecuteProcess(cmd=…, name=…, output=…, sigterm_timeout=…)`, its `parse` and `_parse_cmdline`,
`expose_action`, `Entity.get_attr` and `Parser.parse_substitution`. Where `launch` can be imported, it is used itself.
"""

from __future__ import annotations

import importlib
import shlex
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

EXAMPLE = Path(__file__).parents[2] / "examples" / "talker" / "talker.stride"


class DocumentedProcess:
    """ExecuteProcess, as documented."""

    def __init__(self, *, cmd: list[Any], **options: Any) -> None:
        self.cmd, self.options = list(cmd), options

    @classmethod
    def parse(
        cls, entity: DocumentedEntity, parser: DocumentedParser, ignore: list[str]
    ) -> tuple[type, dict[str, Any]]:
        assert ignore == ["cmd"]
        name = entity.get_attr("name", optional=True)
        return cls, {} if name is None else {"name": parser.parse_substitution(name)}

    @classmethod
    def _parse_cmdline(cls, text: str, parser: DocumentedParser) -> list[Any]:
        return [parser.parse_substitution(word) for word in shlex.split(text)]


class DocumentedEntity:
    def __init__(self, **attributes: str) -> None:
        self.attributes = attributes

    def get_attr(self, name: str, *, optional: bool = False) -> str | None:
        if name not in self.attributes and not optional:
            raise AttributeError(name)
        return self.attributes.get(name)


class DocumentedParser:
    def parse_substitution(self, text: str) -> tuple[str, str]:
        return "substitution", text


@pytest.fixture
def exposed(monkeypatch: pytest.MonkeyPatch) -> Iterator[dict[str, Any]]:
    """The exposed actions of a `launch` that has just what is documented."""
    found: dict[str, Any] = {}

    def expose_action(name: str) -> Callable[[Any], Any]:
        return lambda action: found.setdefault(name, action)

    names = "launch", "launch.actions", "launch.frontend"
    launch, actions, frontend = (ModuleType(name) for name in names)
    actions.ExecuteProcess = DocumentedProcess  # type: ignore[attr-defined]
    frontend.expose_action = expose_action  # type: ignore[attr-defined]
    for name, module in zip(names, (launch, actions, frontend), strict=True):
        monkeypatch.setitem(sys.modules, name, module)
    own = "midstride.launch", "midstride.backends.ros2.manager.launch_action"
    for name in own:
        monkeypatch.delitem(sys.modules, name, raising=False)
    importlib.import_module("midstride.launch")
    yield found
    for name in own:
        sys.modules.pop(name, None)


def test_the_launch_action_runs_the_command_that_stays(exposed: dict[str, Any]) -> None:
    action = exposed["midstride"](specification="a.stride", arguments=["--use-sim-time"], respawn=True)
    head = [sys.executable, "-m", "midstride", "up", "a.stride", "--backend", "ros2", "--stop-on-exit"]
    assert action.cmd == [*head, "--use-sim-time"]
    assert action.options == {"name": "midstride", "output": "screen", "sigterm_timeout": "30", "respawn": True}


def test_the_element_of_the_launch_action(exposed: dict[str, Any]) -> None:
    entity = DocumentedEntity(specification="$(dirname)/a.stride", backend="$(var b)", args="--spares 2", name="robot")
    made, options = exposed["midstride"].parse(entity, DocumentedParser())
    action = made(**options)
    assert action.cmd[4] == ("substitution", "$(dirname)/a.stride") and action.cmd[6] == ("substitution", "$(var b)")
    assert action.cmd[-2:] == [("substitution", "--spares"), ("substitution", "2")]
    assert action.options["name"] == ("substitution", "robot")
    with pytest.raises(AttributeError):
        made.parse(DocumentedEntity(), DocumentedParser())


@pytest.mark.full
@pytest.mark.skipif(importlib.util.find_spec("launch_xml") is None, reason="ROS 2's launch is on no package index")
def test_a_real_launch_brings_a_system_up_and_ends_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from launch import LaunchDescription, LaunchService
    from launch.actions import RegisterEventHandler, Shutdown
    from launch.event_handlers import OnProcessIO
    from launch_xml import Parser

    importlib.import_module("midstride.launch")
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    file = tmp_path / "talker.launch.xml"
    element = f'<midstride specification="{EXAMPLE}" backend="$(var b)"/>'
    file.write_text(f'<launch><arg name="b" default="sim"/>{element}</launch>')
    printed: list[str] = []

    def read(event: Any) -> Any:
        printed.append(event.text.decode())
        return Shutdown(reason="it is up") if "talker is up" in printed[-1] else None

    service = LaunchService()
    root, parser = Parser.load(str(file))
    handler = RegisterEventHandler(OnProcessIO(on_stdout=read))
    service.include_launch_description(LaunchDescription([handler, parser.parse_description(root)]))
    assert service.run() == 0
    assert "talker is down." in "".join(printed)
