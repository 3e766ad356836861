"""The counterpart of ``Plane`` in _control_plane_worker.py for versions whose commands travelled over ROS services."""

from __future__ import annotations

import uuid
from typing import Any

from _control_plane_event import Happened


class Plane:
    """One control plane, for one worker."""

    def backend(self, name: str, workspace: Any) -> Any:
        from midstride import backends

        return backends.make(name, logs=workspace.logs)

    def connect(self, backend: Any, token: str) -> None:
        """Use ``backend`` without a manager."""
        self._backend, self._token = backend, token

    def connect_manager(self, manager: Any) -> None:
        """Use what a manager uses."""
        self.connect(manager._backend, manager._link._token)

    async def ping(self, instance: str, timeout: float) -> None:
        """Raises BackendError where no reply comes."""
        from midstride.wire.messages import Command

        await self._backend.call(instance, Command("ping", {}, uuid.uuid4().hex, self._token, None), timeout)

    def request(self, **wanted: Any) -> Any:
        from midstride.plan.request import Request

        return Request(**wanted)

    def outcome(self, result: Any) -> tuple[str, str | None]:
        return result["outcome"], result["because"]

    def events(self, manager: Any, since: int) -> list[Any]:
        return [
            Happened(*(each[name] for name in ("n", "at", "kind", "words"))) for each in manager.events.since(since)
        ]
