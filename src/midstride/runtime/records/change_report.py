"""One change of the history, whole: its plan, the specifications before and after, what happened, and the figures."""

from __future__ import annotations

from typing import Annotated, TypeVar

import msgspec
from msgspec import Meta

from midstride.codec.form import Report
from midstride.codec.specification_form import SpecificationForm
from midstride.codec.writing import to_json
from midstride.errors import ManagerError
from midstride.plan.forms.plan_forms import PlanPreview
from midstride.runtime.records.change_history import ChangeRecord, Incident, read_change, read_incidents
from midstride.runtime.records.disk import Database, Statement
from midstride.runtime.records.mode_recorder import ModeInterval
from midstride.runtime.records.reports import Event, Outcome

F = TypeVar("F")

_LATEST = "SELECT max(number) FROM changes"
_RECORD = "SELECT plan, outcome, timeline FROM records WHERE change = ?"
_VERSIONS = "SELECT before, after FROM changes WHERE number = ?"


class ChangeTimeline(Report, frozen=True, kw_only=True):
    """The course of a change; times in unix seconds. ``modes``: of its nodes, and of all that was lowered."""

    since: float
    until: float
    modes: list[ModeInterval]
    events: list[Event]


class ChangeReport(Report, frozen=True, kw_only=True):
    """A change of the history. Null: not recorded, as by an earlier version, or because the manager ended meanwhile."""

    change: ChangeRecord
    plan: PlanPreview | None
    before: Annotated[SpecificationForm | None, Meta(description="the specification it began with")]
    after: Annotated[SpecificationForm | None, Meta(description="the one it was to lead to")]
    outcome: Annotated[Outcome | None, Meta(description="as it was reported, without the plan")]
    timeline: ChangeTimeline | None
    incidents: Annotated[list[Incident], Meta(description="from its beginning to its end")]


def recorded(number: int, outcome: Outcome, timeline: ChangeTimeline) -> Statement:
    """The statement that adds to the record of a change how it went; its plan is there from the beginning."""
    update = """
    INSERT INTO records (change, outcome, timeline) VALUES (?, ?, ?)
    ON CONFLICT (change) DO UPDATE SET outcome = excluded.outcome, timeline = excluded.timeline
    """
    without = msgspec.structs.replace(outcome, plan=None)
    return update, (number, *(to_json(form).decode() for form in (without, timeline)))


def read_report(database: Database, number: int | None) -> ChangeReport | None:
    """Change ``number``, by default the latest; None if there is none.

    Raises sqlite3.Error, ManagerError for the record of another version, ValueError where it is damaged.
    """
    number = database.read(_LATEST)[0][0] if number is None else number
    change = read_change(database, number)
    if change is None:
        return None
    plan, outcome, timeline = next(iter(database.read(_RECORD, change.number)), (None, None, None))
    (before, after) = (_specification(database, version) for version in database.read(_VERSIONS, change.number)[0])
    went = _decode(timeline, ChangeTimeline, change.number)
    until = went.until if went is not None else change.at + (change.seconds or 0.0)
    return ChangeReport(
        change=change,
        plan=_decode(plan, PlanPreview, change.number),
        before=before,
        after=after,
        outcome=_decode(outcome, Outcome, change.number),
        timeline=went,
        incidents=read_incidents(database, change.at, until),
    )


def existing(found: ChangeReport | None, number: int | None) -> ChangeReport:
    """The report that :func:`read_report` has found. Raises ManagerError where it has found none."""
    if found is None:
        which = "no change yet" if number is None else f"no change {number}"
        raise ManagerError(f"the history has {which}; `midstride history` lists them")
    return found


def _specification(database: Database, version: int) -> SpecificationForm | None:
    found = database.read("SELECT form FROM specifications WHERE version = ?", version)
    return _decode(found[0][0], SpecificationForm, None) if found else None


def _decode(text: str | None, form: type[F], number: int | None) -> F | None:
    if text is None:
        return None
    try:
        return msgspec.json.decode(text, type=form)
    except msgspec.ValidationError as error:
        of = "a specification" if number is None else f"change {number}"
        raise ManagerError(f"another version of Midstride has recorded {of}: {error}") from None
