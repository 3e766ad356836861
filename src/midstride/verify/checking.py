"""Verifies configurations and plans: encodes them, runs Alloy, traces the answer back."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from threading import Event
from typing import Any

from midstride.errors import AlloyFailed, PlanRefused, VerificationError
from midstride.model.configuration import Configuration
from midstride.model.specification import Specification, initial
from midstride.plan.forms.plan_forms import decode_plan
from midstride.plan.plan import Plan
from midstride.plan.specification_diff import differences
from midstride.verify.alloy_atoms import TooLarge
from midstride.verify.alloy_text import VERDICT
from midstride.verify.export import Dump, dump_configuration, dump_plan
from midstride.verify.run import TIME_LIMIT, Alloy, SolverOutcome, find
from midstride.verify.trace import confirm, findings, first_failure, instance, step_to_explain
from midstride.verify.verdict import Answer, Finding, Verdict

Detail = Callable[[int | None], Dump]


@dataclass(frozen=True, slots=True)
class AlloyOptions:
    """The options of a run of Alloy.

    The Analyzer (None: the one that is found), its time limit (s), what receives the Alloy text, and an event that
    stops it early.
    """

    alloy: Alloy | Path | None = None
    limit: float = TIME_LIMIT
    keep: Callable[[str], None] = lambda _: None
    stop: Event | None = None


def verify_plan(
    plan: Plan | Mapping[str, Any],
    name: str = "plan",
    *,
    start: Specification | None = None,
    options: AlloyOptions | None = None,
) -> Verdict:
    """Verify that every step of a plan (or of its document) is allowed, has its stated effect and keeps the system
    valid.

    If ``start`` is given, the plan must start from that specification. UNKNOWN, with the reason, where Alloy gives no
    answer: it is missing, it takes too long, the plan is too large. Raises SpecificationError for an invalid document.
    """
    try:
        known = plan if isinstance(plan, Plan) else decode_plan(plan)
    except PlanRefused as error:  # it refers to something that does not exist, so it has no encoding
        return _invalid_plan(str(error))
    if start is not None and (found := differences(start, known.change.specification)):
        first = "; ".join(line.strip() for line in str(found[0]).splitlines())
        more = f" (and {len(found) - 1} more)" if len(found) > 1 else ""
        return _invalid_plan(f"it starts from a specification that differs from {start.name}: {first}{more}")
    subject = f"the plan of {len(known.steps)} steps"
    return _verified(subject, lambda number: dump_plan(known, name, number), options or AlloyOptions())


def verify_configuration(
    configuration: Configuration,
    name: str = "configuration",
    subject: str = "the configuration",
    *,
    options: AlloyOptions | None = None,
) -> Verdict:
    """Verify that a configuration is valid. UNKNOWN as for :func:`verify_plan`."""
    return _verified(subject, lambda _: dump_configuration(configuration, name, subject), options or AlloyOptions())


def verify_specification(specification: Specification, *, options: AlloyOptions | None = None) -> Verdict:
    """Verify that the initial configuration of a specification is valid. UNKNOWN as for :func:`verify_plan`."""
    return verify_configuration(
        initial(specification), specification.name, "the initial configuration", options=options
    )


def _verdict(dump: Dump, alloy: Alloy, options: AlloyOptions, detail: Detail) -> Verdict:
    """The verdict on a dump; ``detail`` encodes one step with the reasons for its failure. Raises AlloyFailed."""
    begun, scope = time.monotonic(), dump.scope
    outcomes = _solve(dump, alloy, "*", options.limit, options.stop)
    answer = instance(dump, outcomes)
    failed = first_failure(dump, answer) is not None
    if (number := step_to_explain(dump, answer)) is not None:
        dump = detail(number)
        outcomes = _solve(dump, alloy, VERDICT, max(1.0, begun + options.limit - time.monotonic()), options.stop)
    found = tuple(findings(dump, outcomes))
    if failed and not found:
        raise AlloyFailed(f"Alloy contradicts itself: it refuses step {number} in the plan, but not on its own")
    if not found:
        confirm(dump, outcomes)
    return Verdict(
        answer=Answer.VIOLATED if found else Answer.HOLDS,
        subject=dump.subject,
        scope=scope,
        by=alloy.name,
        findings=found,
        seconds=round(time.monotonic() - begun, 3),
        steps=tuple(step.describe() for step in dump.steps or ()),
    )


def _solve(dump: Dump, alloy: Alloy, commands: str, limit: float, stop: Event | None) -> dict[str, SolverOutcome]:
    with tempfile.TemporaryDirectory(prefix="midstride-verify-") as folder:
        source = Path(folder) / "dump.als"
        source.write_text(dump.text, encoding="utf-8")
        return alloy.solve(source, commands, limit=limit, stop=stop)


def _invalid_plan(because: str) -> Verdict:
    finding = Finding("document", None, "the plan", "its document", because)
    return Verdict(Answer.VIOLATED, "the plan", "read, not executed", "Midstride", findings=(finding,))


def _verified(subject: str, dump: Detail, options: AlloyOptions) -> Verdict:
    try:
        whole = dump(None)
        options.keep(whole.text)
        alloy = options.alloy if isinstance(options.alloy, Alloy) else find(options.alloy)
        return _verdict(whole, alloy, options, dump)
    except (TooLarge, VerificationError) as error:
        return Verdict(Answer.UNKNOWN, subject, "nothing was verified", "Alloy", because=str(error))
