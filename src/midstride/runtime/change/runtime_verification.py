"""Changes that are verified: the plan before it begins, and the live configuration after each of its steps.

Alloy takes half a second or more to start, during which functionalities would stay degraded. So the whole plan is
verified beforehand, with all its intermediate configurations. After each step the reported configuration is compared
with these, and Alloy runs again only if it is none of them.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from dataclasses import dataclass
from threading import Event
from typing import Final

from midstride.errors import VerificationError
from midstride.model.configuration import Configuration
from midstride.plan.plan import Plan
from midstride.runtime.change_observer import ChangeObserver
from midstride.runtime.instance_life import SILENCE, LifeTable
from midstride.runtime.records.events import EventLog
from midstride.runtime.watch.observed_configuration import observe
from midstride.verify.checking import AlloyOptions, verify_configuration, verify_plan
from midstride.verify.verdict import Verdict

# How long Alloy may take, while other commands wait (s).
LIMIT: Final = 60.0


class Verifier:
    """Runs Alloy without blocking the manager's event loop. Cancelling it terminates the Alloy process."""

    async def plan(self, plan: Plan) -> Verdict:
        return await self._beside(lambda options: verify_plan(plan, options=options))

    async def configuration(self, configuration: Configuration) -> Verdict:
        return await self._beside(
            lambda options: verify_configuration(configuration, subject="the live configuration", options=options)
        )

    async def _beside(self, ask: Callable[[AlloyOptions], Verdict]) -> Verdict:
        stop = Event()
        try:
            return await asyncio.to_thread(ask, AlloyOptions(limit=LIMIT, stop=stop))
        finally:
            stop.set()


@dataclass(slots=True)
class StepVerifier(ChangeObserver):
    """Verifies the live configuration after each step of a plan; ``judged`` are those that were verified with it."""

    verifier: Verifier
    judged: tuple[Configuration, ...]
    life: LifeTable
    events: EventLog

    async def step_done(self, configuration: Configuration) -> None:
        """Raises VerificationError if the live configuration is unknown, or is not known to be valid."""
        found, silent = observe(configuration, self.life)
        if silent:
            raise VerificationError(
                f"the live configuration is unknown: {', '.join(silent)} has reported nothing for more than "
                f"{SILENCE:g} s"
            )
        if found in self.judged:
            return
        verdict = await self.verifier.configuration(found)
        self.events.add("verified", str(verdict), verdict=verdict)
        if not verdict.holds:
            raise VerificationError(verdict.words)
