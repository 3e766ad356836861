"""What a component reports: its registration, once, and its state, after every change."""

from __future__ import annotations

from typing import Any, Final, Literal, TypeAlias

import msgspec

GateState: TypeAlias = Literal["open", "closed"]


class WireValue(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """The base of everything on the wire: unknown and missing fields are refused by name."""


class Endpoint(WireValue, frozen=True, kw_only=True):
    """An endpoint of a component's node that is neither a port nor one of ROS's own."""

    kind: Literal["topic", "service", "ROS action"]
    name: str


class FunctionalityState(WireValue, frozen=True, kw_only=True):
    """``since``: seconds in this mode. ``busy``: for how many seconds a call of user code has been running."""

    mode: str
    since: float
    because: str
    busy: float | None = None


# What a component waits for that has been started, and is not yet part of its system.
NOT_WELCOMED: Final = "no manager has welcomed it yet"


class LinkState(WireValue, frozen=True, kw_only=True):
    """One attachment. ``count`` messages have passed, ``gated`` have not; an input has no gate."""

    gate: GateState | None
    count: int
    gated: int = 0


class ComponentState(WireValue, frozen=True, kw_only=True):
    """``revision`` counts the component's changes. ``waiting``: what it waits for, if anything.

    ``node``: the full name of its ROS node, None where there is none. ``answers``: it answers requests to the node's
    services; of several instances of a role, one does.
    ``simulated_time``: its ROS clock follows ``/clock``, and gains ``clock_speed`` seconds in each second (0: it stands
    still, or that is not known yet). ``stopping`` is how long it may take to end in order (s).
    ``ports`` maps port -> topic -> attachment. ``imported`` counts the modules that its process has imported: where it
    has grown, so may have the files of its program. ``declared`` has the parameters that were set while it ran, each
    with the value that it was started with.
    """

    instance: str
    uuid: str
    pid: int
    revision: int
    functionalities: dict[str, FunctionalityState]
    ports: dict[str, dict[str, LinkState]]
    parameters: dict[str, Any]
    stopping: float
    waiting: str | None = None
    simulated_time: bool = False
    imported: int = 0
    clock_speed: float = 1.0
    node: str | None = None
    answers: bool = True
    declared: dict[str, Any] = msgspec.field(default_factory=dict)

    def set_values(self) -> dict[str, Any]:
        """The values of the parameters that were set while it ran."""
        return {name: self.parameters[name] for name in self.declared}
