"""The names of nodes whose programs name them, as launch leaves it to them where it states none.

A node is found in the graph by the enclave that its process is started with: rcl announces it with each node, and it
has no other meaning as long as ROS's security is off. The name is found at the first start and kept, so that the
sections of parameter files that are for it are known when another instance is started, which has to have another name.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import count
from pathlib import Path
from typing import Final

import msgspec

from midstride.errors import BackendError, StartFailed
from midstride.model.component import ComponentSpec
from midstride.model.instance_names import full_name, split_name
from midstride.runtime.backend_protocol import Launch

FILE: Final = "own-names"


@dataclass(frozen=True, slots=True)
class StartName:
    """The name that a node is started with: its ``full`` name, empty where that is not known yet.

    ``passed``: whether it is passed to the process; ``original``: the full name of the one node of the process that it
    is for, where that is known. ``shared``: the instance that it replaces has it as well.
    """

    full: str
    passed: bool = True
    original: str = ""
    shared: bool = False


def named(full: str, component: ComponentSpec) -> StartName:
    """The full name ``full`` for a node of ``component``, which may state which node of its process is meant."""
    inside = split_name(full)[1]
    return StartName(full, original=full_name(component.renames, inside.strip("/")) if component.renames else "")


class OwnNames:
    """By role, the full name that its program gives its node; kept in ``folder``."""

    def __init__(self, folder: Path) -> None:
        self._path = folder / FILE
        self._names: dict[str, str] | None = None

    def _read(self) -> dict[str, str]:
        if self._names is None:
            try:
                self._names = msgspec.json.decode(self._path.read_bytes(), type=dict[str, str])
            except (OSError, msgspec.DecodeError):
                self._names = {}
        return self._names

    def known(self, role: str) -> str:
        """The name that its program has given its node so far; empty where none is known."""
        return self._read().get(role, "")

    def note(self, role: str, name: str) -> None:
        """Raises BackendError."""
        if (names := self._read()).get(role) == name:
            return
        names[role] = name
        try:
            self._path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
            self._path.write_bytes(msgspec.json.encode(names))
        except OSError as error:
            raise BackendError(f"{self._path} cannot be written: {error.strerror or error}") from None

    def start_name(
        self, launch: Launch, component: ComponentSpec, runs: Callable[[str], bool], owner: Callable[[str], str]
    ) -> StartName:
        """Return what the node of an instance is called.

        ``runs``: whether a node of that full name is in the graph; ``owner``: whose it is, in words.

        It is the role's where no node has that name, as after a crash, or where the old one has ended first; else, and
        behind a relay, that of the instance. A replacement gets another number than its instance has where a node
        outside the system has that name. Raises StartFailed.
        """
        if not component.unnamed:
            role = full_name(launch.role or launch.instance, launch.namespace)
            if component.gate != "relay" and not runs(role):
                return named(role, component)
            name = launch.instance
            if name != launch.role and runs(full_name(name, launch.namespace)):
                names = (f"{launch.role}_{number}" for number in count(2))
                name = next(each for each in names if not runs(full_name(each, launch.namespace)))
            return named(full_name(name, launch.namespace), component)
        own = self.known(launch.role)
        if not own or not runs(own):
            return StartName(own, passed=False)
        number = launch.instance.removeprefix(launch.role)
        if not number:
            words = f"a node {own} is running already: {owner(own)}; end it, or name the node"
            raise StartFailed(f"{launch.instance}: {words}")
        name, namespace = split_name(own)
        return StartName(full_name(name + number, namespace), original=own)

    def shared_name(self, node: str, launch: Launch, component: ComponentSpec) -> StartName | None:
        """The name ``node``, of the one that the instance replaces; None where it cannot be given to its program."""
        if not component.unnamed:
            return replace(named(node, component), shared=True)
        own = self.known(launch.role)
        if not own:
            return None
        return StartName(node, passed=own != node, original="" if own == node else own, shared=True)
