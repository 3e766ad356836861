"""The state of a component that has nothing to report, for tests that are about a part of it."""

from __future__ import annotations

from typing import Any

from midstride.wire.state import ComponentState


def bare_state(instance: str, **stated: Any) -> ComponentState:
    """The state of ``instance``, with what is ``stated``."""
    nothing: dict[str, Any] = {
        "uuid": "u",
        "pid": 1,
        "revision": 1,
        "functionalities": {},
        "ports": {},
        "parameters": {},
        "stopping": 0.0,
    }
    return ComponentState(instance=instance, **{**nothing, **stated})
