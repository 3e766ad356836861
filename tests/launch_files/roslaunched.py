"""What a launch file of ROS 1 comes to, in a form in which roslaunch and an import can be compared.

As a program, where roslaunch can be imported, this writes its answers, and starts nothing:
`python -m tests.launch_files.roslaunched FOLDER…`, with folders for `sys.path`, such as that of roslaunch's source.
"""

from __future__ import annotations

import json
import os
import shlex
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

CATALOGUE: Final = Path(__file__).parent / "roslaunch_catalogue"
ANSWERS: Final = Path(__file__).parent / "roslaunch_answers.json"
ENVIRONMENT: Final = {"ROS_PACKAGE_PATH": str(CATALOGUE / "src"), "MADE_UP": "made up"}
# What Midstride states itself.
_OWN: Final = ("__name:=", "__ns:=")


def cases() -> Iterator[tuple[str, Path, list[str]]]:
    """The name of each case, its launch file, and the arguments that the first line of that states in a comment."""
    for path in sorted(CATALOGUE.glob("*.launch")):
        first = path.read_text(encoding="utf-8").splitlines()[0]
        arguments = first.removeprefix("<!-- arguments: ").removesuffix(" -->") if "arguments: " in first else ""
        yield path.name, path, shlex.split(arguments)


def portable(value: Any) -> Any:
    """``value`` with the folder of the catalogue named instead of its path, and of a type that JSON has."""
    if isinstance(value, dict):
        return {portable(key): portable(each) for key, each in value.items()}
    if isinstance(value, (list, tuple)):
        return [portable(each) for each in value]
    if isinstance(value, str):
        return value.replace(str(CATALOGUE), "CATALOGUE")
    return value if isinstance(value, (bool, int, float)) or value is None else repr(value)


def own_words(words: Sequence[str]) -> list[str]:
    return [word for word in words if not word.startswith(_OWN)]


def answer(path: Path, arguments: Sequence[str]) -> dict[str, Any]:
    """The nodes and the parameters of the server as roslaunch has them before it starts anything, or its error."""
    import roslaunch.config
    import roslaunch.xmlloader
    from rosgraph.names import canonicalize_name, ns_join

    loader = roslaunch.xmlloader.XmlLoader(resolve_anon=False)
    loader.ignore_unset_args = False
    config = roslaunch.config.ROSLaunchConfig()
    try:
        loader.load(str(path), config, argv=list(arguments), verbose=False)
        nodes = {}
        for node in config.nodes:
            machine = config._select_machine(node)
            nodes[ns_join(node.namespace, node.name)] = {
                "program": [node.package, node.type],
                "words": own_words([*shlex.split(node.args), *(f"{old}:={new}" for old, new in node.remap_args)]),
                "environment": dict(node.env_args),
                "prefix": shlex.split(node.launch_prefix or ""),
                "respawn": node.respawn_delay if node.respawn else None,
                "host": _host(machine) if machine.name and machine.address != "localhost" else None,
            }
    except Exception as error:
        return {"error": f"{type(error).__name__}: {error}".replace(str(CATALOGUE), "CATALOGUE").splitlines()[0]}
    parameters: dict[str, Any] = {}
    for key, parameter in config.params.items():
        parameters.update(_flat(canonicalize_name(key), parameter.value))
    return {"nodes": portable(nodes), "parameters": portable(parameters)}


def _host(machine: Any) -> str:
    return f"{machine.user}@{machine.address}" if machine.user else str(machine.address)


def _flat(name: str, value: Any) -> Iterator[tuple[str, Any]]:
    if isinstance(value, dict):
        for key, each in value.items():
            yield from _flat(f"{name.rstrip('/')}/{key}", each)
    else:
        yield name, value


def imported(path: Path, arguments: Mapping[str, str], folder: Path, environment: Mapping[str, str]) -> dict[str, Any]:
    """The same of an import, with what it ``said``, and whether something is left out or refused for that."""
    import yaml  # type: ignore[import-untyped, unused-ignore]  # with its stubs or without

    from midstride.errors import SpecificationError
    from midstride.launch_files.launch_import import import_launch_file
    from tests.launch_files.support import specification

    try:
        found = import_launch_file(path, arguments, environment, folder / "imported.stride", run_commands=True, ros=1)
    except SpecificationError as error:
        return {"error": str(error)}
    system = specification(found, folder)
    nodes, parameters = {}, {}
    for name, node in system.nodes.items():
        component = system.components[node.component]
        _, package, program, *words = shlex.split(component.run or "")
        host = system.hosts.get(node.host)
        nodes[f"/{node.role}"] = {
            "program": [package, program],
            "words": words,
            "environment": dict(component.environment),
            "prefix": shlex.split(component.prefix or ""),
            "respawn": None if node.respawn is None else node.respawn.delay,
            "host": None if host is None else host.ssh,
        }
        for each, value in system.instance(name).parameters.items():
            parameters[f"/{node.role}/{each.replace('.', '/')}"] = value
    for name, text in found.parameter_files.items():
        if name.endswith(".rosparam.yaml"):
            parameters.update(_flat("/", yaml.safe_load(text)))
    said = {str(each): each.left_out or each.kind == "refused" for each in found.findings}
    return {"nodes": portable(nodes), "parameters": portable(parameters), "said": said}


def main(folders: Sequence[str]) -> None:
    sys.path[:0] = folders
    os.environ.update(ENVIRONMENT)
    answers = {name: answer(path, arguments) for name, path, arguments in cases()}
    ANSWERS.write_text(json.dumps(answers, indent=1, sort_keys=True) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
