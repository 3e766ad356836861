"""The content of a report, as data: a change of the history, a plan, or the plans of several strategies."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Final

from msgspec import Meta

from midstride import __version__
from midstride.codec.form import Report, encode
from midstride.codec.specification_form import decode_specification
from midstride.errors import MidstrideError
from midstride.plan.forms.plan_forms import decode_plan
from midstride.runtime.records.change_report import ChangeReport
from midstride.server.report.file import report_file
from midstride.server.report.views import modelled_view
from midstride.server.view.view_forms import SystemView

# The version of this form. A later one may add fields; what is there keeps its meaning.
VERSION: Final = 1


class ReportDocument(Report, frozen=True, kw_only=True):
    """The data in a report file. Either `change` or `plans` is given; a plan is as POST /plan answers."""

    version: int
    midstride: Annotated[str, Meta(description="the version of Midstride that has written it")]
    written: Annotated[float, Meta(description="unix seconds")]
    system: str
    backend: str | None
    title: str
    change: dict[str, Any] | None
    plans: Annotated[dict[str, dict[str, Any]] | None, Meta(description="by strategy; `refused`: why there is none")]
    before: Annotated[SystemView | None, Meta(description="the system as modelled when the plan began")]
    after: Annotated[SystemView | None, Meta(description="and when all its steps are done")]
    required: Annotated[list[str], Meta(description="what changes require, of a plan for which it was not judged")]


def change_file(found: ChangeReport, system: str, backend: str = "") -> str:
    """The file of a change of the history. ``backend``: "" where it is not known (any more)."""
    change = encode(found)
    whole = None if found.plan is None else {**change["plan"], "start": change["before"], "target": change["after"]}
    views = _views(whole, system, backend, found.change.at)
    return _file(system, found.change.by or found.change.command, views, backend=backend or None, change=change)


def plan_file(plans: Mapping[str, dict[str, Any]], system: str, title: str) -> str:
    """The file of plans by strategy: documents as POST /plan answers, or with ``refused``."""
    first = next((plan for plan in plans.values() if "refused" not in plan), None)
    return _file(system, title, _views(first, system, "", time.time()), plans=dict(plans), required=_required(first))


def _file(
    system: str,
    title: str,
    views: tuple[SystemView | None, SystemView | None],
    *,
    backend: str | None = None,
    change: dict[str, Any] | None = None,
    plans: dict[str, dict[str, Any]] | None = None,
    required: Sequence[str] = (),
) -> str:
    before, after = views
    document = ReportDocument(
        version=VERSION,
        midstride=__version__,
        written=time.time(),
        system=system,
        backend=backend,
        title=title,
        change=change,
        plans=plans,
        before=before,
        after=after,
        required=list(required),
    )
    return report_file(document, f"{title} - {system}")


def _required(plan: Mapping[str, Any] | None) -> list[str]:
    """The requirements for changes, of the specification that ``plan`` starts from, unless the plan says whether they
    hold.
    """
    if plan is None or plan.get("start") is None or "requires" in plan:
        return []
    return [str(requirement) for requirement in decode_specification(plan["start"]).requirements]


def _views(
    plan: dict[str, Any] | None, system: str, backend: str, at: float
) -> tuple[SystemView | None, SystemView | None]:
    """The system before and after a plan, where both of its specifications are known."""
    if plan is None or plan.get("start") is None or plan.get("target") is None:
        return None, None
    try:
        change = decode_plan(plan).change
    except MidstrideError:  # the plan of a version that planned otherwise: it is shown in words
        return None, None
    start, final = change.start, change.final
    return modelled_view(start, system, backend, at), modelled_view(final, system, backend, at)
