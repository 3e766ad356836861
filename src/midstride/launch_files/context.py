"""What holds at a place of a launch file: variables, the namespace, and what groups set for the nodes in them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TypeAlias

from midstride.lang.source import Span
from midstride.launch_files.findings import UnknownValue
from midstride.launch_files.packages import Packages
from midstride.model.component import ParameterValue

# A parameter with its value, or a parameter file.
Setting: TypeAlias = "tuple[str, ParameterValue] | ParameterFileName"


@dataclass(frozen=True, slots=True)
class ParameterFileName:
    """A parameter file by its path. ``text``: its text, if its substitutions are carried out. ``span``: named there."""

    path: str
    text: str | None
    span: Span


@dataclass(slots=True)
class Context:
    """A scope. ``file`` is the absolute path of the launch file; a variable may have no known value, and says why.

    ``variables_set``: those of the environment, None for one that is taken away.
    """

    packages: Packages
    environment: Mapping[str, str]
    file: str
    variables: dict[str, str | UnknownValue] = field(default_factory=dict)
    namespace: str = ""
    remaps: list[tuple[str, str]] = field(default_factory=list)
    settings: list[Setting] = field(default_factory=list)
    variables_set: dict[str, str | None] = field(default_factory=dict)

    def scoped(self, forwarding: bool = True) -> Context:
        """A copy, for a group. Without ``forwarding``, it has none of the variables."""
        if not forwarding:
            return Context(self.packages, self.environment, self.file)
        return replace(
            self,
            variables=dict(self.variables),
            remaps=list(self.remaps),
            settings=list(self.settings),
            variables_set=dict(self.variables_set),
        )

    def variable(self, name: str, default: str | None = None) -> str:
        """Raises UnknownValue."""
        value = self.variables.get(name, default)
        if value is None:
            raise UnknownValue(f"`{name}` is not set", "argument")
        if isinstance(value, UnknownValue):
            raise UnknownValue(str(value), value.kind)
        return value

    def global_parameter(self, name: str) -> str:
        """What `set_parameter` has set. Raises UnknownValue."""
        for setting in reversed(self.settings):
            if isinstance(setting, tuple) and setting[0] == name:
                return str(setting[1])
        raise UnknownValue(f"the global parameter `{name}` is not set by the launch files that were read")

    def set_environment(self, name: str, value: str) -> None:
        """For the processes that are started from here on, and for `env`."""
        self.environment = {**self.environment, name: value}
        self.variables_set[name] = value
