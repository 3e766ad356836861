"""The arguments that a node without Midstride's API is started with: its name, its topics and its parameters."""

from __future__ import annotations

from dataclasses import replace as replaced
from pathlib import Path
from typing import Final

from midstride.backends.naming import topics_of
from midstride.backends.ros2.manager.component_containers import LoadRequest, container_arguments, container_name
from midstride.backends.ros2.manager.own_names import StartName
from midstride.backends.ros2.manager.parameter_file import ALL, parameter_file, parameters_text, write_parameters
from midstride.backends.ros2.names import enclave_of, system_tag
from midstride.errors import StartFailed
from midstride.foreign import build
from midstride.foreign.mode_parameters import typed
from midstride.foreign.page import PAGE
from midstride.foreign.preloading import PRELOAD, StartedPrograms
from midstride.foreign.relayed_program import private_topics
from midstride.model.component import ComponentSpec
from midstride.model.instance_names import full_name, split_name
from midstride.runtime.backend_protocol import Launch

ENV_PAGE: Final = "MIDSTRIDE_GATE_PAGE"
ENV_NODE: Final = "MIDSTRIDE_GATE_NODE"
# The services and topics of a ROS action, behind its name.
_PARTS_OF_ACTION: Final = tuple(
    f"/_action/{x}" for x in ("send_goal", "cancel_goal", "get_result", "feedback", "status")
)
# Of what is only described, instead of a number or a name that is made when the process is started.
GIVEN_AT_THE_START: Final = "(given at the start)"


class StartArguments:
    """The arguments of nodes whose files of parameters, and whose page of gates, are in ``folder``."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def describe(
        self, launch: Launch, component: ComponentSpec, name: StartName, started: StartedPrograms
    ) -> tuple[list[str], dict[str, str], dict[str, str]]:
        """Describe a start: the arguments behind the command, the environment, and the file of the parameters.

        ``started``: what the command starts. Nothing is written. Raises StartFailed.
        """
        node = name.full or full_name(launch.instance, launch.namespace)
        if component.gate == "relay":
            topics = topics_of(component, node, launch.topics) | private_topics(component, launch.instance)
            launch = replaced(launch, topics=topics)
        path = parameter_file(self._folder.absolute(), launch.process or launch.instance)
        variables = dict(started.environment)
        text = parameters_text(launch.sections, name.full or ALL, self._of_process(launch, component, name))
        if loads_library(launch, component, started):
            variables[PRELOAD] = started.preloaded(build.library_path(started.environment))
            variables |= {ENV_PAGE: str((self._folder / PAGE).absolute()), ENV_NODE: GIVEN_AT_THE_START}
        enclave = GIVEN_AT_THE_START if component.unnamed else ""
        arguments = ros_arguments(launch, component, name, path if text else None, enclave)
        return arguments, variables, {str(path): text} if text else {}

    def _values(self, launch: Launch, component: ComponentSpec, name: StartName) -> dict[str, object]:
        """The values of the parameters of the node."""
        given = {**launch.parameters, **launch.set_parameters}
        if name.full and component.unnamed:  # what the sections have for all nodes is among these
            own = name.original or name.full
            matching = [section.parameters for section in launch.sections if section.matches(own)]
            given = {key: value for values in (*matching, launch.set_parameters) for key, value in values.items()}
        return typed(component, given, {})

    def _of_process(self, launch: Launch, component: ComponentSpec, name: StartName) -> dict[str, object]:
        """The values that its process is started with: none where that is shared, as a request to load has them."""
        return {} if launch.process else self._values(launch, component, name)

    def of(self, launch: Launch, component: ComponentSpec, name: StartName) -> list[str]:
        """Return the arguments behind the command; the parameters are in a file, which is deleted with the process.

        Raises BackendError.
        """
        path = parameter_file(self._folder.absolute(), launch.process or launch.instance)
        values = self._of_process(launch, component, name)
        written = write_parameters(path, launch.sections, name.full or ALL, values)
        enclave = enclave_for(launch, component)
        return ros_arguments(launch, component, name, path if written else None, enclave)

    def load_request(self, launch: Launch, component: ComponentSpec, name: StartName) -> LoadRequest | None:
        """Return the request that loads the node of the instance into its container; None where it has none."""
        if launch.load is None:
            return None
        matching = (section.parameters for section in launch.sections if section.matches(name.full))
        values = {key: value for section in matching for key, value in section.items()}
        return LoadRequest(
            container_name(launch),
            component.package or "",
            launch.load.plugin,
            name.full,
            (*launch.load.remaps, *_remaps(launch, component)),
            values | self._values(launch, component, name),
            launch.load.extra,
        )


def loads_library(launch: Launch, component: ComponentSpec, started: StartedPrograms) -> bool:
    """Return whether the process gets the library of the gate.

    Raises StartFailed where it needs it, and cannot load it.

    A node of which only the services need the library goes without it where it cannot be had, or loaded.
    """
    if not component.loads_library:
        return False
    available = build.is_available(started.environment)
    why = started.why_not(build.library_path(started.environment) if available else None)
    if component.preloads and why is not None:
        raise StartFailed(f"{launch.instance} cannot have a gate in its process: {why}")
    return component.preloads or (available and why is None)


def enclave_for(launch: Launch, component: ComponentSpec) -> str:
    """The enclave in which a node is found whose program names it itself; empty for any other."""
    return enclave_of(system_tag(launch.token), launch.instance) if component.unnamed else ""


def ros_arguments(
    launch: Launch, component: ComponentSpec, name: StartName, parameters: Path | None = None, enclave: str = ""
) -> list[str]:
    """Return the arguments behind the command: the node's name, the topics of its ports, and its file of parameters."""
    files = [] if parameters is None else ["--params-file", str(parameters)]
    if launch.load is not None:  # further nodes that a composable node makes do read the arguments of the process
        return ["--ros-args", *container_arguments(container_name(launch)), *files]
    own, namespace = split_name(name.full) if name.full else ("", f"/{launch.namespace}")
    of_one = f"{split_name(name.original)[0]}:" if name.original else ""  # further nodes keep their names
    remaps = [f"{of_one}__node:={own}"] if name.passed else []
    if component.unnamed:
        namespace = f"/{launch.namespace}"
    remaps += [f"__ns:={namespace}"] if namespace != "/" else []  # else a further node may have its own
    remaps += _remaps(launch, component)
    arguments = [part for remap in remaps for part in ("-r", remap)]
    arguments += ["--enclave", enclave] if enclave else []
    arguments += files
    return ["--ros-args", *arguments] if arguments else []


def _remaps(launch: Launch, component: ComponentSpec) -> list[str]:
    """The rules by which the topics of the ports get their names."""
    named = ((port, component.topic_of(port), topic) for port, topic in launch.topics.items())
    found: list[str] = []
    for port, own, topic in named:
        if own == topic:
            continue
        found.append(f"{own}:={topic}")
        if component.kind_of(port) == "action":  # of which rcl remaps the parts, and not the name
            found += [f"{own}{part}:={topic}{part}" for part in _PARTS_OF_ACTION]
    return found
