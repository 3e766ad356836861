"""One change that is carried out, as a value: what it is to do, what records it, and what follows it."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Collection, Coroutine, Sequence
from dataclasses import dataclass, field
from typing import Any

from msgspec import UNSET, UnsetType

from midstride.model.action import Action, Handover, Remove
from midstride.model.configuration import Configuration
from midstride.model.specification import Specification
from midstride.plan.forms.plan_forms import PlanPreview
from midstride.plan.plan import Plan
from midstride.runtime.backend_protocol import Exited
from midstride.runtime.change.change_phases import CHANGE_PHASES, OUTCOMES, ChangeEvent, ChangePhase
from midstride.runtime.change.parameter_transfer import ParameterTransfer
from midstride.runtime.change_observer import ChangeObserver
from midstride.runtime.records.journal import JournalEntry
from midstride.runtime.records.reports import OutcomeKind
from midstride.runtime.watch.subscriber_recording import Recording
from midstride.verify.verdict import Verdict


@dataclass(slots=True)
class RunningChange:
    """The change of a running system to ``target`` by ``plan``; ``preview`` is the plan's form.

    ``entry`` records it in the journal, and ``recording`` what subscribers receive meanwhile; ``parameters`` carries
    over what was set at run time. ``patience``: after how long a hung component that is being replaced is fenced (s).
    ``before`` is the configuration that it started from, and ``missing_before`` what had exited by then. ``verdict`` is
    Alloy's on the plan, if it was asked.

    ``brief``: new publishers are accepted after their first calls, and their rates are judged afterwards, until
    ``hurried``, if given, is set.

    ``partial``: an instance that cannot be created is left out, and its steps end with the creations; by role,
    ``left_out`` says why. The caller plans the rest again without these roles.

    ``require`` is called with the steps of each round before it begins, and raises MidstrideError where the change must
    not go on. ``commanding`` is held while an action sends commands to components that run already, and to which the
    response to a crash may send some: a component refuses the second of two changes at one revision.
    """

    plan: Plan
    target: Specification
    preview: PlanPreview
    entry: JournalEntry
    recording: Recording
    parameters: ParameterTransfer
    patience: float
    before: Configuration
    missing_before: dict[str, Exited] = field(default_factory=dict)
    verdict: Verdict | UnsetType = UNSET
    partial: bool = False
    brief: bool = False
    hurried: asyncio.Event | None = None
    left_out: dict[str, str] = field(default_factory=dict)
    phase: ChangePhase = ChangePhase.PLANNED
    outcome: OutcomeKind | None = None  # until its steps have ended
    because: str | None = None  # why it is not done
    observers: list[ChangeObserver] = field(default_factory=list)
    commanding: asyncio.Lock = field(default_factory=asyncio.Lock)
    require: Callable[[Sequence[int]], None] = lambda _: None
    actions: list[Action] = field(init=False)
    leaving: frozenset[str] = field(init=False)  # the instances that the plan removes
    _steps: asyncio.Task[None] | None = None  # until they have ended

    def __post_init__(self) -> None:
        self.actions = [step.action for step in self.plan.steps]
        self.leaving = frozenset(action.instance for action in self.actions if isinstance(action, Remove))
        self.observers.append(self.recording)

    def happened(self, event: ChangeEvent, because: str | None = None) -> None:
        """Enter the next state. ``because``: why it is not done, if that is known now."""
        self.phase = CHANGE_PHASES.after(self.phase, event, "the change")
        self.outcome, self.because = OUTCOMES.get(event, self.outcome), because or self.because

    async def take(self, steps: Coroutine[Any, Any, None]) -> None:
        """Await ``steps``, which carry the plan out; cancelled by :meth:`interrupt`, also before they begin."""
        self._steps = asyncio.ensure_future(steps)
        if self.recording.broken_off.is_set():
            self._steps.cancel()
        try:
            await self._steps
        except asyncio.CancelledError:
            if self.phase is ChangePhase.PLANNED:
                self.happened(ChangeEvent.CALLED_OFF)
            raise
        finally:
            self._steps = None

    def interrupt(self) -> None:
        """The manager is to end: roll back what is being carried out; what has been is only reported, not measured."""
        self.recording.broken_off.set()
        if self._steps is not None:
            self._steps.cancel()

    # -- what its observers learn --------------------------------------------------------------------------

    def moved(self, configuration: Configuration, instances: Collection[str]) -> None:
        for observer in self.observers:
            observer.moved(configuration, instances)

    async def performed(self, action: Action) -> None:
        for observer in self.observers:
            await observer.performed(action)

    async def step_done(self, configuration: Configuration) -> None:
        for observer in self.observers:
            await observer.step_done(configuration)

    async def before_handover(self, configuration: Configuration, action: Handover) -> None:
        for observer in self.observers:
            await observer.before_handover(configuration, action)

    async def crashed(self) -> None:
        for observer in self.observers:
            await observer.crashed()

    async def unless_hurried(self, watching: asyncio.Future[None], by_default: bool) -> None:
        """Await ``watching``; where it is done by default, only until the next command waits."""
        hurried = self.hurried if by_default else None
        hurrying = asyncio.ensure_future((hurried or asyncio.Event()).wait())
        both: set[asyncio.Future[Any]] = {watching, hurrying}
        try:
            await asyncio.wait(both, return_when=asyncio.FIRST_COMPLETED)
            if watching.done():
                watching.result()
        finally:
            for task in both:
                task.cancel()
            await asyncio.gather(*both, return_exceptions=True)
