"""The order of a manager for a rehearsal, and the result (:mod:`midstride.simulation.rehearsal`)."""

from __future__ import annotations

from typing import Annotated

from msgspec import Meta

from midstride.codec.form import Form, Report
from midstride.codec.specification_form import SpecificationForm
from midstride.plan.forms.request_form import ChangeRequest


class RehearsalOrder(Form, frozen=True, kw_only=True):
    """An order to rehearse a change of the system of a specification, ``seeds`` of them from ``first`` on.

    No seed is begun after ``within`` seconds.
    """

    specification: SpecificationForm
    request: ChangeRequest
    seeds: int
    first: int
    within: float


class RehearsedSeed(Report, frozen=True):
    """The result of one seed: the invariants that it violates, and how the change and its recovery ended."""

    seed: int
    problems: list[str]
    outcomes: list[str]


class Rehearsal(Report, frozen=True, kw_only=True):
    """The results of the seeds, as `midstride simulate --json` prints them."""

    seeds: int
    outcomes: Annotated[dict[str, int], Meta(description="how often the change ended in each way")]
    faults: Annotated[
        dict[str, dict[str, int]],
        Meta(description="by kind of fault: how often it struck, and how often each branch of recovery followed"),
    ]
    failed: Annotated[list[RehearsedSeed], Meta(description="those that violate an invariant")]
