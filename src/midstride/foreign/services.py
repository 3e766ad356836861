"""Requests of an agent to the node that it answers for: its lifecycle state and its parameters."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Protocol

from midstride.errors import BackendError


class NoAnswer(BackendError):
    """The node has not answered a request in time, or does not serve it. ``sent``: the request may have reached it."""

    def __init__(self, words: str, *, sent: bool = False) -> None:
        super().__init__(words)
        self.sent = sent


class ParameterSetter(Protocol):
    """Sets the parameters of a node."""

    async def set_parameters(self, values: Mapping[str, Any], timeout: float) -> str | None:
        """Set all of these parameters or none, in ``timeout`` (s); None, or why the node refuses. Raises NoAnswer."""


class ParameterAccess(ParameterSetter, Protocol):
    """Reads and sets the parameters of a node."""

    async def parameters(self, timeout: float) -> dict[str, Any]:
        """The values of all parameters that have one, said in ``timeout`` (s). Raises NoAnswer."""

    def offers_parameters(self) -> bool:
        """Return whether the node can be asked for its parameters now, as far as can be seen."""


class StateAccess(Protocol):
    """Exports and imports the state of a node that offers it (docs/protocols/foreign-state.md)."""

    async def export_state(self, timeout: float) -> bytes | str:
        """The state, said in ``timeout`` (s), or why the node exports none. Raises NoAnswer."""

    async def import_state(self, state: bytes, timeout: float) -> str | None:
        """Have the node take over ``state`` in ``timeout`` (s); None, or why the node refuses. Raises NoAnswer."""


class NodeServices(ParameterAccess, StateAccess, Protocol):
    """The services that a node of ROS 2 has without code of its author. Times are in s; each raises NoAnswer."""

    def close(self) -> None:
        """Nothing is asked any more."""

    def settings_in(self, request: bytes) -> Mapping[str, Any]:
        """The parameters that a request is to set, of which these are the bytes in DDS, and their values.

        Raises BackendError where they cannot be read.
        """

    async def lifecycle_state(self, timeout: float) -> str:
        """The label of the state: `unconfigured`, `inactive`, `active`, `finalized`, or that of a transition."""

    async def transition(self, name: str, state: str, timeout: float) -> bool:
        """Have a lifecycle node in ``state`` make a transition, such as `configure`; whether it has succeeded."""
