"""The measured cost of a plan: how long each functionality is below its baseline while the plan is carried out.

The levels are those of docs/semantics.md section 6, by role. Only the time from the start of the first step to the end
of the last one counts.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable

from midstride.model.component import FunctionalityRef
from midstride.model.configuration import Configuration
from midstride.plan.change import Change
from midstride.plan.disruption import Levels
from midstride.runtime.change_observer import ChangeObserver
from midstride.runtime.instance_life import LifeTable
from midstride.runtime.manager_clock import Clock
from midstride.runtime.watch.observed_configuration import with_failures


class DegradationTimer(ChangeObserver):
    """Sums the seconds below the baseline; :meth:`moved` must be called with each configuration as it is reached.

    What has exited or degraded unexpectedly, by ``life``, counts as well. The cost of a step
    depends on what it changes: at the start, only functionalities that the change lowered beforehand are below.
    """

    def __init__(self, change: Change, clock: Clock, life: LifeTable) -> None:
        self._change = change
        self._clock = clock
        self._life = life
        self._levels = Levels(change)
        self._since = clock.steady()
        lowered = dict.fromkeys(change.start.instances[ref.instance].role for ref in change.lowered)
        self._below = set(self._levels.fallen(change.start, lowered))
        self._seconds: defaultdict[FunctionalityRef, float] = defaultdict(float)

    def moved(self, configuration: Configuration, instances: Iterable[str]) -> None:
        """A step has led to ``configuration``, now, and has changed ``instances``; or one of these has failed."""
        self._count()
        for role in {self._change.role_of(instance) for instance in instances}:
            instances_of = configuration.instances_by_role.get(role, ())
            actual = with_failures(configuration, instances_of, self._life)
            self._below -= {counted.ref for counted in self._levels.counted(role)}
            self._below |= self._levels.below(actual, role).keys()

    def _count(self) -> None:
        now = self._clock.steady()
        for ref in self._below:
            self._seconds[ref] += now - self._since
        self._since = now

    def stop(self) -> dict[str, float]:
        """The seconds below the baseline of each functionality that has been below it, by role."""
        self._count()
        return {str(ref): round(seconds, 6) for ref, seconds in sorted(self._seconds.items())}
