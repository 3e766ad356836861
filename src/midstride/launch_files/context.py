"""The context at a place of a launch file: variables, the namespace, and what is set for the nodes that follow."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

from midstride.lang.source import Span
from midstride.launch_files.allowed_files import ReadableFiles
from midstride.launch_files.findings import UnknownValue
from midstride.launch_files.packages import Packages
from midstride.model.component import ParameterValue


@dataclass(frozen=True, slots=True)
class ParametersGiven:
    """Parameters that launch gives to a node's process: a file at a path, one that launch writes, or one parameter.

    ``path``: of a file that is there; ``text``: that of the file, if it is not what is at the path.
    ``rule``: NAME:=VALUE, which follows ``-p``. ``values``: of the node alone, by dotted name, which ROS does not read
    from any text. ``span``: where it is stated.
    """

    span: Span
    path: str | None = None
    text: str | None = None
    rule: str | None = None
    values: Mapping[str, ParameterValue] | None = None


class Stated(NamedTuple):
    """A value of the parameter server, and where it is stated."""

    value: Any
    span: Span


@dataclass(slots=True)
class IncludeTrace:
    """The launch file that launch itself takes for the current one: the last that was begun, up to launch 3.7.

    ``differing``: the substitutions that have another value there than here.
    """

    current: str
    differing: list[str] = field(default_factory=list)


@dataclass(slots=True)
class Context:
    """A scope. ``file`` is the absolute path of the launch file; a variable may have no known value, and says why.

    ``namespace`` is absolute, or None if none was stated. ``variables_set``: those of the environment, None for one
    that is taken away. ``remaps`` and ``settings``, as in launch, are shared with the enclosing scope once they have
    anything: what a group adds to them then stays.
    """

    packages: Packages
    files: ReadableFiles
    environment: Mapping[str, str]
    file: str
    trace: IncludeTrace
    run_commands: bool = False
    variables: dict[str, str | UnknownValue] = field(default_factory=dict)
    namespace: str | None = None
    remaps: list[tuple[str, str]] = field(default_factory=list)
    settings: list[ParametersGiven] = field(default_factory=list)
    variables_set: dict[str, str | None] = field(default_factory=dict)

    def scoped(self, forwarding: bool = True) -> Context:
        """A copy, for a group. Without ``forwarding``, it has only the environment that the launch file began with."""
        scope = replace(
            self,
            variables=dict(self.variables),
            remaps=self.remaps or [],
            settings=self.settings or [],
            variables_set=dict(self.variables_set),
        )
        if not forwarding:
            scope.forget()
            scope.reset_environment()
        return scope

    def forget(self) -> None:
        """Without variables, namespace, and what is set for nodes, which are variables of launch as well."""
        self.variables, self.namespace, self.remaps, self.settings = {}, None, [], []

    def reset_environment(self) -> None:
        """Restore the environment that launch was started with."""
        self.environment, self.variables_set = self.packages.environment, {}

    def variable(self, name: str, default: str | None = None) -> str:
        """Raises UnknownValue."""
        value = self.variables.get(name, default)
        if value is None:
            raise UnknownValue(f"`{name}` is not set", "argument")
        if isinstance(value, UnknownValue):
            raise UnknownValue(str(value), value.kind)
        return value

    def global_parameter(self, name: str) -> str:
        """The value that `set_parameter` has set. Raises UnknownValue."""
        for setting in self.settings:
            if setting.rule is not None and setting.rule.startswith(f"{name}:="):
                return setting.rule.removeprefix(f"{name}:=")
        raise UnknownValue(f"the global parameter `{name}` is not set by the launch files that were read")

    def set_environment(self, name: str, value: str | None) -> None:
        """For the processes that are started from here on, and for `env`. None takes it away."""
        environment = dict(self.environment)
        if value is None:
            environment.pop(name, None)
        else:
            environment[name] = value
        self.environment = environment
        self.variables_set[name] = value

    def current_file(self) -> str:
        """For `filename`."""
        if self.trace.current != self.file:
            self.trace.differing.append("filename")
        return self.file

    def current_folder(self) -> str:
        """For `dirname`."""
        if os.path.dirname(self.trace.current) != os.path.dirname(self.file):
            self.trace.differing.append("dirname")
        return os.path.dirname(self.file)

    def read(self, path: str) -> str:
        """The text of any file that may be read. Raises UnknownValue."""
        if not os.path.isabs(path):
            raise UnknownValue(f"`{path}` is relative to the folder in which launch is started")
        return self.files.source(os.path.normpath(path)).text


@dataclass(slots=True)
class RoslaunchContext(Context):
    """A scope of roslaunch.

    ``declared``: the arguments that are declared in it; with ``replaces``, one may be declared and set once more.
    ``private``: the parameters that all nodes which follow have.
    """

    declared: set[str] = field(default_factory=set)
    replaces: bool = False
    private: dict[str, Stated] = field(default_factory=dict)

    def inner(self, namespace: str | None) -> RoslaunchContext:
        """A scope in this one. Once it has any, the private parameters are shared with it."""
        return replace(
            self,
            namespace=namespace,
            variables=dict(self.variables),
            remaps=list(self.remaps),
            variables_set=dict(self.variables_set),
            declared=set(self.declared),
            private=self.private or {},
            replaces=False,
        )

    def add_remap(self, old: str, new: str) -> None:
        """Have ``old`` renamed for the nodes that follow, whatever it was before."""
        self.remaps = [*((each, to) for each, to in self.remaps if each != old), (old, new)]
