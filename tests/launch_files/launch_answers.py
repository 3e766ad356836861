"""What ROS's own `launch` starts for the launch files of the catalogue, written to answers.json; nothing is started.

Run it where `launch`, `launch_ros`, `launch_xml` and `launch_yaml` can be imported, as in a shell with ROS sourced:
`python -m tests.launch_files.launch_answers [--to FILE]`. `launch` does all of its work, in virtual time, but it starts
no process: a process begins at once and ends well after an hour. Written as well is what an import's own process finds
in the launch files in Python, for machines without launch, and which imports differ from launch, with a finding.
"""

from __future__ import annotations

import asyncio
import importlib.metadata
import json
import logging
import os
import re
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Final
from unittest import mock

from tests.launch_files.launched_processes import (
    DEFAULT_LIMIT,
    OTHER,
    cases,
    environment_change,
    for_others,
    plain,
    prefix_folder,
    shortened,
    split,
    surroundings,
)
from tests.rcl_parser import Unreadable, effective

ANSWERS: Final = Path(__file__).parent / "answers.json"
LIFETIME: Final = 3600.0  # seconds that each process would run
_CAUGHT: Final = "Caught exception in launch (see debug for traceback): "
PROCESS_ID: Final = 4_000_000  # none that runs


class _VirtualTime(asyncio.SelectorEventLoop):
    """Whatever waits is due at once, in the order of its times."""

    def __init__(self) -> None:
        super().__init__()
        self.now = 0.0
        selector: Any = self._selector  # type: ignore[attr-defined]
        select = selector.select

        def at_once(timeout: float | None = None) -> Any:
            self.now += timeout or 0.0
            return select(0)

        selector.select = at_once

    def time(self) -> float:
        return self.now


class _Recorder:
    """Notes each process that launch would start."""

    def __init__(self, prefix: Path) -> None:
        self.prefix = prefix
        self.before: dict[str, str] = {}
        self.processes: list[dict[str, Any]] = []
        self.components: list[str] = []
        self.log_errors: list[str] = []

    async def execute(self, action: Any, context: Any) -> None:
        """In place of `ExecuteLocal.__execute_process`."""
        from launch.events.process import ProcessExited, ProcessStarted

        details = dict(action.process_details)
        self.processes.append(self.process(action, details, context))
        details["pid"] = PROCESS_ID + len(self.processes)
        await context.emit_event(ProcessStarted(**details))
        await asyncio.sleep(LIFETIME)
        await context.emit_event(ProcessExited(returncode=0, **details))
        action._ExecuteLocal__cleanup()

    def process(self, action: Any, details: dict[str, Any], context: Any) -> dict[str, Any]:
        import launch_ros.actions

        words: list[str] = [str(word) for word in details["cmd"]]
        described = action.process_description
        before = len(words) - len(described.cmd)
        own, rules = split(words[before:])
        is_node = isinstance(action, launch_ros.actions.Node)
        found: dict[str, Any] = {
            "kind": "node" if is_node else "program",
            "program": self._text(own[0]).removeprefix("<prefix>/lib/") if own else "",
            "arguments": [self._text(word) for word in own[1:]],
        }
        if type(action).__name__ != "Node" and is_node:
            found["kind"] = type(action).__name__
        if before:
            found["prefix"] = words[:before]
        if action.shell:
            found["shell"] = True
        if details["cwd"]:
            found["folder"] = self._text(details["cwd"])
        if change := environment_change(self.before, details["env"]):
            found["environment"] = {name: value and self._text(value) for name, value in change.items()}
        remaps = [rule.partition(":=") for option, rule in rules if option == "-r"]
        names = [new for old, _, new in remaps if old == "__node"]
        namespaces = [new for old, _, new in remaps if old == "__ns"]
        found["name"] = names[0] if names else None
        if namespaces:
            found["namespace"] = namespaces[0]
        if kept := [[old, new] for old, _, new in remaps if old not in {"__node", "__ns"}]:
            found["remaps"] = kept
        full = f"{namespaces[0].rstrip('/') if namespaces else ''}/{names[0] if names else os.path.basename(own[0])}"
        settings = [rule for rule in rules if rule[0] in {"-p", "--params-file"}]
        try:
            if parameters := effective(settings, full):
                found["parameters"] = {name: plain(parameters[name]) for name in sorted(parameters)}
            if of_others := for_others(effective(settings, OTHER)):
                found["others"] = of_others
        except Unreadable as error:
            found["refused"] = shortened(str(error), self.prefix)
        if others := [[option, value] for option, value in rules if option not in {"-r", "-p", "--params-file"}]:
            found["ros_arguments"] = others
        if action._ExecuteLocal__respawn:
            found["respawn"] = {
                "delay": action._ExecuteLocal__respawn_delay or 0.0,
                "retries": action._ExecuteLocal__respawn_max_retries,
            }
        for name in ("sigterm", "sigkill"):
            limit = "".join(context.perform_substitution(part) for part in getattr(action, f"{name}_timeout"))
            if float(limit) != DEFAULT_LIMIT:
                found[name] = float(limit)
        if context.asyncio_loop.time() > 0:
            found["after"] = context.asyncio_loop.time() if context.asyncio_loop.time() < LIFETIME else "exit"
        return found

    def _text(self, text: str) -> str:
        return shortened(text, self.prefix)


@contextmanager
def _no_effect(recorder: _Recorder) -> Iterator[None]:
    import launch.actions.execute_local
    import launch_ros.actions.lifecycle_node
    import launch_ros.actions.load_composable_nodes
    import launch_ros.actions.ros_timer
    import launch_ros.actions.set_use_sim_time

    def load(action: Any, context: Any) -> None:
        for description in action._LoadComposableNodes__composable_node_descriptions:
            plugin = description.node_plugin
            recorder.components.append("".join(context.perform_substitution(part) for part in plugin))

    local: Any = launch.actions.execute_local.ExecuteLocal
    loading: Any = launch_ros.actions.load_composable_nodes.LoadComposableNodes
    timer: Any = launch_ros.actions.ros_timer.ROSTimer
    with (
        mock.patch.multiple(
            local, _ExecuteLocal__execute_process=lambda action, context: recorder.execute(action, context)
        ),
        mock.patch.object(loading, "execute", load),
        mock.patch.object(timer, "_wait_to_fire_event", launch.actions.TimerAction._wait_to_fire_event),
        mock.patch.object(launch_ros.actions.lifecycle_node, "get_ros_node", mock.MagicMock()),
        mock.patch.object(launch_ros.actions.set_use_sim_time, "get_ros_node", mock.MagicMock()),
    ):
        yield


class _Errors(logging.Handler):
    def __init__(self, into: list[str]) -> None:
        super().__init__(logging.ERROR)
        self.into = into

    def emit(self, record: logging.LogRecord) -> None:
        self.into.append(record.getMessage())


def answer(path: Path, arguments: dict[str, str], prefix: Path) -> dict[str, Any]:
    """The processes of a launch file, or what launch says of the error."""
    import launch
    import launch.logging
    from launch.actions import IncludeLaunchDescription
    from launch.launch_description_sources import AnyLaunchDescriptionSource

    recorder = _Recorder(prefix)
    kept = dict(os.environ)
    loop = _VirtualTime()
    asyncio.set_event_loop(loop)
    handler = _Errors(recorder.log_errors)
    logger = launch.logging.get_logger("launch")
    logger.addHandler(handler)
    try:
        service = launch.LaunchService(noninteractive=True)
        include = IncludeLaunchDescription(AnyLaunchDescriptionSource(str(path)), launch_arguments=arguments.items())
        service.include_launch_description(launch.LaunchDescription([include]))
        recorder.before = dict(os.environ)
        with _no_effect(recorder):
            status = loop.run_until_complete(service.run_async())
    finally:
        logger.removeHandler(handler)
        os.environ.clear()
        os.environ.update(kept)
        loop.close()
    found: dict[str, Any] = {"processes": recorder.processes}
    if recorder.components:
        found["components"] = recorder.components
    if status != 0:
        errors = (
            [each for each in recorder.log_errors if "Caught exception" in each] or recorder.log_errors or ["failed"]
        )
        words = re.sub(r" at 0x\w+", "", errors[0]).replace(_CAUGHT, "")
        # A set has another order in each process.
        words = re.sub(r"\{('[^{}]*')\}", lambda found: f"{{{', '.join(sorted(found[1].split(', ')))}}}", words)
        found["error"] = shortened(words, prefix)[:300]
    return found


def in_python(name: str, prefix: Path, folder: Path) -> list[list[Any]]:
    """What is found in the launch files in Python of a case, if it has any."""
    from midstride.errors import SpecificationError
    from midstride.launch_files import launch_interpreter
    from tests.launch_files.imported_processes import processes
    from tests.launch_files.recorded_python import recording

    found: list[list[Any]] = []
    ((path, arguments),) = ((path, arguments) for case, path, arguments in cases() if case == name)
    with mock.patch.object(launch_interpreter, "carried_out", recording(found, prefix)), suppress(SpecificationError):
        processes(path, arguments, dict(os.environ), folder)
    return found


def main(words: list[str]) -> int:
    to = Path(words[1]) if words[:1] == ["--to"] else ANSWERS
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        prefix = prefix_folder(folder)
        os.environ.update({**surroundings(prefix, os.environ), "ROS_LOG_DIR": name})
        os.environ.pop("MADE_UP_UNSET", None)
        answers = {case: answer(path, arguments, prefix) for case, path, arguments in cases()}
        document: dict[str, Any] = {
            "versions": {each: importlib.metadata.version(each) for each in ("launch", "launch_ros")},
            "answers": answers,
        }
        if to == ANSWERS:
            from tests.launch_files.imported_processes import imported

            python = {case: in_python(case, prefix, folder) for case in answers}
            document["python"] = {case: found for case, found in python.items() if found}
            document["differing"] = [case for case in answers if imported(case, answers, prefix, folder)[0]]
    to.write_text(json.dumps(document, indent=1, sort_keys=True, allow_nan=False) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
