"""What an import makes of a launch file, in the form of the answers of launch."""

from __future__ import annotations

import os
import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from midstride.errors import SpecificationError
from midstride.lang import load
from midstride.launch_files.launch_import import Imported, import_launch_file
from midstride.model.specification import Specification
from tests.launch_files.launched_processes import (
    DEFAULT_LIMIT,
    OTHER,
    cases,
    for_others,
    plain,
    shortened,
    split,
    surroundings,
)

# What launch 3.7 refuses by its own faults, and later versions take.
LATER = {"include-let.launch.xml", "if-any-or-all.launch.xml"}


def processes(path: Path, arguments: Mapping[str, str], environment: Mapping[str, str], folder: Path) -> Found:
    """The import of a launch file, written to ``folder``, and the processes of its specification."""
    target = folder / f"{path.name}.stride"
    imported = import_launch_file(path, arguments, environment, target, run_python=True, run_commands=True, ros=2)
    target.write_text(imported.text, encoding="utf-8")
    for name, text in imported.parameter_files.items():
        (folder / name).write_text(text, encoding="utf-8")
    loaded = load(target)
    assert [str(each) for each in loaded.diagnostics if each.severity == "error"] == [], imported.text
    system = loaded.require()
    said = "\n".join(map(str, imported.findings))
    alone = [_process(system, name, environment) for name, node in system.nodes.items() if node.container is None]
    shared = [_container(system, name) for name in system.containers if f"`{name}` is started elsewhere" not in said]
    classes = [str(system.component_of(name).run) for name, node in system.nodes.items() if node.container is not None]
    return Found(imported, [*alone, *shared], classes)


class Found:
    """``processes`` are in the order of the nodes; ``loaded`` into those of containers are these classes."""

    def __init__(self, imported: Imported, processes: list[dict[str, Any]], loaded: list[str]) -> None:
        self.imported = imported
        self.processes = processes
        self.loaded = [run.partition(" ")[0] for run in loaded]

    @property
    def kinds(self) -> dict[str, int]:
        return self.imported.findings.counts()


def _container(system: Specification, name: str) -> dict[str, Any]:
    program = system.containers[name]
    namespace, _, own_name = name.rpartition("/")
    words, _ = split(shlex.split(program.run))
    found: dict[str, Any] = {
        "program": f"{program.package}/{words[0]}",
        "arguments": words[1:],
        "name": own_name,
    }
    found |= {"prefix": shlex.split(program.prefix)} if program.prefix else {}
    found |= {"environment": dict(program.environment)} if program.environment else {}
    return found | ({"namespace": f"/{namespace}"} if namespace else {})


def _process(system: Specification, name: str, environment: Mapping[str, str]) -> dict[str, Any]:
    node = system.nodes[name]
    component = system.components[node.component]
    prefix = Path(environment["AMENT_PREFIX_PATH"].partition(os.pathsep)[0])
    words = shlex.split(str(component.run))
    own, rules = split(words)
    namespace, _, own_name = node.role.rpartition("/")
    found: dict[str, Any] = {
        "program": shortened(own[0], prefix) if component.package is None else f"{component.package}/{own[0]}",
        "arguments": [shortened(word, prefix) for word in own[1:]],
        "name": own_name,
    }
    if namespace:
        found["namespace"] = f"/{namespace}"
    before = shlex.split(component.prefix or "")
    if before[:1] == ["env"] and before[1:2] and before[1].startswith("--chdir="):
        found["folder"], before = before[1].removeprefix("--chdir="), before[2:]
    if before:
        found["prefix"] = before
    if component.environment:
        found["environment"] = {
            key: value and shortened(value, prefix) for key, value in sorted(component.environment.items())
        }
    if remaps := [[*rule.partition(":=")[::2]] for option, rule in rules if option == "-r"]:
        found["remaps"] = remaps
    parameters = dict(system.instance(name).parameters)
    if component.unnamed:  # what is stated is in its sections, for whatever name its program gives it
        parameters = {}
        for section in (each for each in node.sections if each.matches(node.role)):
            parameters |= section.parameters
    if parameters:
        found["parameters"] = {key: plain(parameters[key]) for key in sorted(parameters)}
    of_others: dict[str, Any] = {}
    for section in (each for each in node.sections if each.matches(OTHER)):
        of_others |= section.parameters
    if of_others := for_others(of_others):
        found["others"] = of_others
    if others := [[option, value] for option, value in rules if option not in {"-r", "-p", "--params-file"}]:
        found["ros_arguments"] = others
    if node.respawn is not None:
        found["respawn"] = True
    for signal in ("sigterm", "sigkill"):
        seconds = None if component.stop is None else getattr(component.stop, signal)
        if seconds not in (None, DEFAULT_LIMIT):
            found[signal] = seconds
    if own[:2] == ["sh", "-c"]:
        found["shell"] = True
    return found


def differences(launched: Mapping[str, Any], imported: Mapping[str, Any]) -> list[str]:
    """What differs between a process of launch and one of an import."""
    launched, imported = dict(launched), dict(imported)
    for key in ("kind", "after", "refused"):
        launched.pop(key, None)
    if launched.get("namespace") == "/":
        del launched["namespace"]  # where the node of an import is as well
    if launched["name"] is None:
        del launched["name"], imported["name"]
    if "respawn" in launched:
        launched["respawn"] = True
    if "shell" not in launched:
        imported.pop("shell", None)
    if launched.pop("shell", False) and imported.pop("shell", False):  # one word for the shell, instead of several
        for each in (launched, imported):
            del each["program"], each["arguments"]
    if launched.get("program") == "ros2" and launched["arguments"][:1] == ["run"]:
        _, package, program, *rest = launched["arguments"]
        launched["program"], launched["arguments"] = f"{package}/{program}", rest
    return [
        f"{key}: {launched.get(key)!r} in launch, {imported.get(key)!r} imported"
        for key in sorted({*launched, *imported})
        if repr(launched.get(key)) != repr(imported.get(key))
    ]


def compared(answer: dict[str, Any], found: Found) -> list[str]:
    """What an import differs in from what launch starts, however it is said."""
    expected, given = list(answer["processes"]), list(found.processes)
    different = []
    for process in expected:
        name = process["name"]
        same = [each for each in given if name is None or each["name"] == name]
        if not same:
            different.append(f"{process} is not imported")
            continue
        best = min(same, key=lambda each: len(differences(process, each)))
        given.remove(best)
        different += differences(process, best)
    return [*different, *(f"{process} is not launched" for process in given)]


def imported(name: str, answers: dict[str, Any], prefix: Path, folder: Path) -> tuple[list[str], list[str]]:
    """What differs for a file of the catalogue, and what was said: findings, or why nothing was imported."""
    path, arguments = next((path, arguments) for case, path, arguments in cases() if case == name)
    answer = answers[name]
    try:
        found = processes(path, arguments, surroundings(prefix, os.environ), folder)
    except SpecificationError as error:
        return ([] if "error" in answer else ["nothing is imported"]), [str(error)]
    said = [str(finding) for finding in found.imported.findings]
    if "error" in answer:
        return ([] if name in LATER else [f"launch refuses it: {answer['error']}"]), said
    left_out = [each for each in answer.get("components", ()) if each not in found.loaded]
    missing = len(left_out) - found.kinds.get("composable", 0)
    different = compared(answer, found) + ["a component is not named"] * max(missing, 0)
    late = sum("after" in process for process in answer["processes"])
    if found.kinds.get("later", 0) < late or (
        0 < late < len(answer["processes"]) and " before " not in found.imported.text
    ):
        different.append("what is started later is not")
    endless = any(process.get("respawn", {}).get("retries", 0) < 0 for process in answer["processes"])
    return different + ["it is not restarted without end"] * (endless and "restart" not in found.kinds), said
