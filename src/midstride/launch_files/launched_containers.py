"""Composable nodes in launch files: they share the process of their container, or each gets one for itself."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Final, Literal, TypeAlias, get_args

from midstride.lang.source import Span
from midstride.launch_files.context import ParametersGiven
from midstride.launch_files.findings import ImportFindings
from midstride.launch_files.launched_nodes import LaunchedContainer, LaunchedNode, LaunchedSystem, LoadedNode
from midstride.model.component import DEFAULT_CONTAINER, ContainerProgram

# What becomes of the composable nodes that share a process: they do, or each gets its own, or they are left out.
Containers: TypeAlias = Literal["keep", "split", "omit"]
CONTAINERS: Final[tuple[Containers, ...]] = get_args(Containers)
_INTRA_PROCESS: Final = "use_intra_process_comms:="


def left_out(plugin: str) -> str:
    """Say that a component is left out, and what takes it over."""
    message = f"the component `{plugin}` is left out: it would share the process of its container"
    return f"{message}; with `--containers keep` it does, and with `--containers split` it has its own"


def keep_containers(system: LaunchedSystem, findings: ImportFindings) -> None:
    """Have each node that a container loads share its process, as in the launch file."""
    started = {f"/{node.role}": node for node in system.nodes}
    for target in dict.fromkeys(each.target for each in system.loaded):
        container, name = started.get(target), target.strip("/") or "container"
        loaded = [each for each in system.loaded if each.target == target]
        span = (container or loaded[0].node).span
        if container is not None:
            system.nodes.remove(container)
        roles = {node.role for node in (*system.nodes, *(each.node for each in system.loaded))}
        while name in roles or name in system.containers:
            name = f"{name}_container"
        program = _program(container, f"the container `{name}`", span, findings)
        system.containers[name] = LaunchedContainer(program, container)
        system.nodes += [_shared(each, container, name) for each in loaded]
        for message in _kept_in_words(name, container, loaded):
            findings.add("composable", message, span, left_out=False)


def _shared(loaded: LoadedNode, container: LaunchedNode | None, name: str) -> LaunchedNode:
    """The node in the container ``name``, which is started as ``container`` is."""
    node = replace(loaded.node, shares=name)
    if container is None:
        return node
    return replace(
        node,
        settings=(*_of_further_nodes(node, container), *node.settings),
        respawn=container.respawn,
        later=node.later or container.later,
        at=max(node.at, container.at),
    )


def _serialized(node: LaunchedNode) -> tuple[str, ...]:
    """The extra arguments without that for communication within the process, which passes the gate."""
    return tuple(each for each in node.extra if not each.startswith(_INTRA_PROCESS))


def _program(container: LaunchedNode | None, what: str, span: Span, findings: ImportFindings) -> ContainerProgram:
    if container is None:
        return DEFAULT_CONTAINER
    if container.package:
        return ContainerProgram(replace(container, container=None).run(), container.package)
    message = f"{what} is `{DEFAULT_CONTAINER.run}` here: in the launch file it is no program of a package"
    findings.add("composable", message, span)
    return DEFAULT_CONTAINER


def split_containers(system: LaunchedSystem, findings: ImportFindings) -> None:
    """Have each node that a container loads loaded into its own process, and leave out these containers."""
    started = {f"/{node.role}": node for node in system.nodes}
    for target in dict.fromkeys(each.target for each in system.loaded):
        container = started.get(target)
        loaded = [each for each in system.loaded if each.target == target]
        system.nodes += [_alone(each, container, findings) for each in loaded]
        if container is not None:
            system.nodes.remove(container)
        for message in _in_words(target, container, loaded):
            findings.add("composable", message, (container or loaded[0].node).span, left_out=False)


def _alone(loaded: LoadedNode, container: LaunchedNode | None, findings: ImportFindings) -> LaunchedNode:
    """The node with its own process, which is started as its ``container`` is."""
    node = replace(loaded.node, extra=_serialized(loaded.node))
    if container is None:
        return node
    return replace(
        node,
        container=_program(container, f"the container of `{node.role}`", node.span, findings),
        settings=(*_of_further_nodes(node, container), *node.settings),
        environment={**container.environment},
        prefix=container.prefix,
        respawn=container.respawn,
        stop=container.stop,
        later=node.later or container.later,
        at=max(node.at, container.at),
    )


def _of_further_nodes(node: LaunchedNode, container: LaunchedNode) -> Sequence[ParametersGiven]:
    """The parameter files of the container: a node that a component makes reads them, and the component does not."""
    own = {given.path for given in node.settings}
    return [given for given in container.settings if given.path is not None and given.path in own]


def _in_words(target: str, container: LaunchedNode | None, loaded: Sequence[LoadedNode]) -> Iterator[str]:
    names = ", ".join(f"`{each.node.role}`" for each in loaded)
    where = f"the container `{target.strip('/')}`"
    if container is None:
        where += ", which is started elsewhere,"
    alone = "a process of its own" if len(loaded) == 1 else "a process each"
    yield f"{names} of {where} get{'s' if len(loaded) == 1 else ''} {alone}, and the container is left out"
    if shared := _of_one_process(loaded):
        yield (
            f"{shared} had intra-process communication: what they exchange is serialized now, and passes through the "
            "middleware"
        )
    yield from _lost(where, container, loaded)


def _kept_in_words(name: str, container: LaunchedNode | None, loaded: Sequence[LoadedNode]) -> Iterator[str]:
    where = f"the container `{name}`"
    if container is None:
        yield f"{where} is started elsewhere; here it is `{DEFAULT_CONTAINER.run}`, with what is named for it alone"
    if shared := _of_one_process(loaded):
        yield (
            f"{shared} have intra-process communication: what they publish on a port with a gate is serialized all the "
            "same, and passes through the middleware"
        )
    yield from _lost(where, container, loaded)


def _lost(where: str, container: LaunchedNode | None, loaded: Sequence[LoadedNode]) -> Iterator[str]:
    """Yield what the nodes had in the launch file, and have not here."""
    if container is not None:
        own = {given.path for each in loaded for given in each.node.settings}
        files = [given.path for given in container.settings if given.path is not None and given.path not in own]
        if files or any(given.path is None for given in container.settings):
            what = ", ".join(f"`{os.path.basename(path)}`" for path in files) or "the values"
            yield (
                f"{what} of {where} are left out: nodes that a component makes would read them; name them in "
                "`parameters` of the component that needs them"
            )


def _of_one_process(loaded: Sequence[LoadedNode]) -> str:
    """The nodes with intra-process communication, in words; empty where it is not several."""
    shared = [f"`{each.node.role}`" for each in loaded if any(_is_intra_process(extra) for extra in each.node.extra)]
    return ", ".join(shared) if len(shared) > 1 else ""


def _is_intra_process(extra: str) -> bool:
    return extra.startswith(_INTRA_PROCESS) and extra.removeprefix(_INTRA_PROCESS).lower() == "true"
