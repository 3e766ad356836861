"""A plan: the steps from a running configuration to a target, and what they cost (docs/semantics.md section 6)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Final, Literal, TypeAlias

from midstride.model.component import FunctionalityRef
from midstride.model.configuration import Configuration
from midstride.plan import container_moves, explain, host_moves
from midstride.plan.change import Change
from midstride.plan.disruption import DIGITS, Levels, follow
from midstride.plan.explain import Degradation, LevelShift
from midstride.plan.programs_last import programs_last
from midstride.plan.runtime_values import RuntimeValue
from midstride.plan.schedule import Schedule, makespan, schedule
from midstride.plan.step import Step
from midstride.verdicts.assessment import Assessment

_EPSILON: Final = 1e-6

ProofSpace: TypeAlias = Literal["direct", "detours"]


@dataclass(frozen=True, slots=True)
class BoundPart:
    """A part of a lower bound: what the creations and removals of ``roles`` lose at least, whatever the others do."""

    roles: tuple[str, ...]
    bound: float


@dataclass(frozen=True)
class Plan:
    """A sequence of steps, each valid, that ends in ``best`` of the target.

    ``disruption`` is in weighted functionality-seconds, ``makespan`` the critical path of the
    steps that do not commute, ``seconds`` the plain sum; what the executor makes of it is in between
    (:func:`midstride.plan.overlap.duration`). ``fallen`` names roles' functionalities
    that are ever below the baseline. ``proved_minimal`` is claimed only where it is proved.
    ``proof_space``: the plans that ``lower_bound`` speaks of, without detours or with them as well.
    ``besides``: what it loses beyond the model, where that is known of what runs.
    ``certificate``: parts that add up to ``lower_bound``, from which a check can start; empty where there is none.
    ``parameters``: what becomes of the values that were set at run time. ``remarks``: what it does besides, and why.
    """

    strategy: str
    change: Change
    steps: tuple[Step, ...]
    disruption: float
    lower_bound: float
    proved_minimal: bool
    makespan: float
    seconds: float
    degraded: tuple[FunctionalityRef, ...]
    parameters: tuple[RuntimeValue, ...] = ()
    remarks: tuple[str, ...] = ()
    proof_space: ProofSpace = "direct"
    certificate: tuple[BoundPart, ...] = ()
    besides: tuple[Assessment, ...] = ()

    @classmethod
    def of(
        cls,
        strategy: str,
        steps: Sequence[Step],
        levels: Levels,
        lower_bound: float = 0.0,
        critical_path: float | None = None,
        certificate: tuple[BoundPart, ...] = (),
    ) -> Plan:
        """The plan that consists of ``steps``, with its costs; no plan has less disruption than ``lower_bound``.

        A bound above the plan's own disruption refutes itself: then nothing is claimed. ``critical_path`` (s) is the
        makespan where it is known already.
        """
        if (ordered := programs_last(steps, levels.change)) != tuple(steps):
            steps, critical_path = ordered, None
        *_, (_, meter) = follow(levels, steps)
        # Sums of floats in another order may differ by less than any plan does.
        if lower_bound > meter.disruption + _EPSILON:
            lower_bound, certificate = 0.0, ()
        is_minimal = meter.disruption - lower_bound < _EPSILON
        return cls(
            strategy=strategy,
            change=levels.change,
            steps=tuple(steps),
            disruption=meter.disruption,
            lower_bound=meter.disruption if is_minimal else round(lower_bound, DIGITS),
            proved_minimal=is_minimal,
            makespan=makespan(steps, levels) if critical_path is None else critical_path,
            seconds=round(sum(step.seconds for step in steps), DIGITS),
            degraded=tuple(sorted(meter.fallen)),
            certificate=certificate,
            remarks=(*host_moves.in_words(levels.change), *container_moves.in_words(levels.change)),
        )

    def configurations(self) -> Iterator[Configuration]:
        """The configurations on the way: the start, and then one after each step."""
        configuration = self.change.start
        yield configuration
        for step in self.steps:
            configuration = step.action.effect(configuration)
            yield configuration

    @cached_property
    def degradations(self) -> tuple[Degradation, ...]:
        """The reason why each functionality degrades, from which step to which, and for how long."""
        return explain.degradations(self.change, self.steps)

    @cached_property
    def level_shifts(self) -> tuple[LevelShift, ...]:
        """The functionalities that are in another mode after the plan than before it."""
        return explain.level_shifts(self.change, self.steps)

    @cached_property
    def schedule(self) -> Schedule:
        """The steps that commute, and what falls or rises by each."""
        return schedule(self.steps, Levels(self.change))

    @property
    def dependencies(self) -> tuple[tuple[int, ...], ...]:
        """For each step, the earlier ones with which it does not commute, and for which it must wait."""
        return self.schedule.dependencies
