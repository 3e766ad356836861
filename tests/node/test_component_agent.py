"""What the agent does with news from the data thread while its own thread comes and goes."""

from __future__ import annotations

import asyncio
import threading
from types import SimpleNamespace
from typing import Any, cast

import pytest

from midstride.node.control.component_agent import Agent

# A functionality that an exception has degraded.
RUNNER: Any = SimpleNamespace(name="talk", state=lambda: SimpleNamespace(mode="degraded", because="it raised"))


class Bumps(list[str]):
    """The revision, as far as it is asked for."""

    bump = list.append


def agent(loop: asyncio.AbstractEventLoop | None) -> tuple[Agent, Bumps, list[str]]:
    """An agent of which nothing runs but what takes the news; with its revision, and what it reports."""
    made = cast(Any, Agent.__new__(Agent))
    made._loop, made._revision = loop, Bumps()
    reports: list[str] = []
    made._report_degraded = reports.append
    made.report_state = lambda: reports.append("the state")
    return made, made._revision, reports


@pytest.mark.parametrize("loop", ["not yet", "no longer"])
def test_before_its_thread_runs_and_after_that_a_degradation_counts_and_nothing_is_reported(loop: str) -> None:
    closed = None
    if loop == "no longer":
        closed = asyncio.new_event_loop()
        closed.close()
    found, revision, reports = agent(closed)
    found._degraded(RUNNER)
    found._parameter_changed()
    assert (revision, reports) == (["talk is in mode degraded: it raised"], [])


def test_while_its_thread_runs_it_reports_from_there() -> None:
    async def main() -> None:
        found, revision, reports = agent(asyncio.get_running_loop())

        def news() -> None:
            found._degraded(RUNNER)
            found._parameter_changed()

        thread = threading.Thread(target=news)
        thread.start()
        thread.join()
        assert (len(revision), reports) == (1, [])
        await asyncio.sleep(0)
        assert reports == ["talk is in mode degraded: it raised", "the state"]

    asyncio.run(main())
