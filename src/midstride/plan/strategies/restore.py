"""The plan that restores functionalities, and changes nothing else."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

from midstride.model.component import FunctionalityRef
from midstride.model.configuration import Configuration
from midstride.model.specification import Specification
from midstride.plan.change import Change
from midstride.plan.disruption import Levels
from midstride.plan.estimate import Estimate
from midstride.plan.plan import Plan
from midstride.plan.strategies.plan_builder import PlanBuilder


def restore(
    configuration: Configuration,
    specification: Specification,
    modes: Mapping[FunctionalityRef, int],
    measured: Mapping[str, Estimate],
) -> Plan:
    """The upgrades to the better ``modes``, upstream first. ``modes`` are valid in ``configuration``."""
    raised = configuration.with_modes(dict(modes))
    change = replace(Change.none(specification, configuration, measured), final=raised, pending=tuple(sorted(modes)))
    levels = Levels(change)
    return Plan.of("minimal", PlanBuilder.at_start(levels).raise_to(dict(modes)).steps, levels)
