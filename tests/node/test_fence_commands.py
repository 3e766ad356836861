"""Whether a component is free to hand over, and to leave its modes, while calls of its code go on."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import Any, cast

import pytest

from midstride.backends.simulator.virtual_loop import run
from midstride.node.control.fence_commands import Fencing
from midstride.node.data.functionality_runner import FunctionalityRunner
from midstride.wire.commands import AwaitIdleCommand


class Data:
    """A data thread that is free."""

    async def run(self, function: Any, timeout: float) -> Any:
        return function()

    def busy(self) -> str:
        return " (busy: drive)"


class Runner(SimpleNamespace):
    awaits = FunctionalityRunner.awaits


@pytest.mark.parametrize(
    ("driven", "leaving", "free"),
    [("none", [], True), ("none", ["talk"], True), ("none", ["drive"], False), ("rate", [], False)],
)
def test_an_async_call_on_entry_keeps_a_component_from_leaving_that_mode_alone(
    driven: str, leaving: list[str], free: bool
) -> None:
    async def scenario() -> None:
        loop = asyncio.get_running_loop()
        host = SimpleNamespace(steady=lambda: round(loop.time() * 1e9), sleep=asyncio.sleep)
        runners = [
            Runner(name="drive", asynchronous=True, driven=driven),
            Runner(name="talk", asynchronous=False, driven="none"),
        ]
        fencing = Fencing(cast(Any, None), cast(Any, host), cast(Any, Data()), cast(Any, runners), lambda: None)
        found = await fencing.await_idle(AwaitIdleCommand(timeout=1.0, leaving=leaving))
        assert found.busy == (None if free else "user code did not return within 1 s (busy: drive)")

    run(scenario())
