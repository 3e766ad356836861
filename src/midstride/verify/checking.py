"""Verdicts on configurations and plans: dump, run Alloy, trace back (what `midstride verify` and the manager call)."""

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
from midstride.plan.decoding import decode_plan
from midstride.plan.plan import Plan
from midstride.plan.specification_diff import differences
from midstride.verify.alloy_atoms import TooLarge
from midstride.verify.alloy_text import VERDICT
from midstride.verify.export import Dump, dump_configuration, dump_plan
from midstride.verify.run import TIME_LIMIT, Alloy, SolverOutcome, find
from midstride.verify.trace import confirm, findings, first_failure, instance, unexplained
from midstride.verify.verdict import Answer, Finding, Verdict

Detail = Callable[[int | None], Dump]


@dataclass(frozen=True, slots=True)
class Asking:
    """How Alloy is asked: by which Analyzer (None: the one that is found), how long it may take (s), who keeps the text
    it is asked with, and what ends it before its time."""

    alloy: Alloy | Path | None = None
    limit: float = TIME_LIMIT
    keep: Callable[[str], None] = lambda _: None
    stop: Event | None = None


def verify_plan(
    plan: Plan | Mapping[str, Any],
    name: str = "plan",
    *,
    start: Specification | None = None,
    asking: Asking | None = None,
) -> Verdict:
    """Whether every step of a plan (or of its document) may be taken, does what it says and keeps the system valid.

    Where ``start`` is given, the plan must be one of that specification. UNKNOWN where an answer cannot be had, with
    the reason: no Analyzer, no time, too large. Raises SpecificationError where the document is no plan.
    """
    try:
        known = plan if isinstance(plan, Plan) else decode_plan(plan)
    except PlanRefused as error:  # what it speaks of is not there: nothing of it can be told to Alloy
        return _unfit(str(error))
    if start is not None and (found := differences(start, known.start)):
        first = "; ".join(line.strip() for line in str(found[0]).splitlines())
        more = f" (and {len(found) - 1} more)" if len(found) > 1 else ""
        return _unfit(f"it starts from another specification than the {start.name} given: {first}{more}")
    subject = f"the plan of {len(known.steps)} steps"
    return _judged(subject, lambda number: dump_plan(known, name, number), asking or Asking())


def verify_configuration(
    configuration: Configuration,
    name: str = "configuration",
    told: str = "the configuration",
    *,
    asking: Asking | None = None,
) -> Verdict:
    """Whether a configuration is valid. UNKNOWN as above."""
    return _judged(told, lambda _: dump_configuration(configuration, name, told), asking or Asking())


def verify_specification(specification: Specification, *, asking: Asking | None = None) -> Verdict:
    """Whether the configuration that a specification starts as is valid. UNKNOWN as above."""
    return verify_configuration(
        initial(specification), specification.name, "the configuration it starts as", asking=asking
    )


def _judge(dump: Dump, alloy: Alloy, asking: Asking, detail: Detail) -> Verdict:
    """The verdict on a dump; ``detail`` dumps one step with what makes it fail. Raises AlloyFailed."""
    begun, scope = time.monotonic(), dump.scope
    outcomes = _solve(dump, alloy, "*", asking.limit, asking.stop)
    answer = instance(dump, outcomes)
    failed = first_failure(dump, answer) is not None
    if (number := unexplained(dump, answer)) is not None:
        dump = detail(number)
        outcomes = _solve(dump, alloy, VERDICT, max(1.0, begun + asking.limit - time.monotonic()), asking.stop)
    found = tuple(findings(dump, outcomes))
    if failed and not found:
        raise AlloyFailed(f"Alloy contradicts itself: it refuses step {number}, and by itself it finds nothing wrong")
    if not found:
        confirm(dump, outcomes)
    return Verdict(
        answer=Answer.VIOLATED if found else Answer.HOLDS,
        subject=dump.subject,
        scope=scope,
        by=alloy.told,
        findings=found,
        seconds=round(time.monotonic() - begun, 3),
        steps=tuple(step.describe() for step in dump.steps or ()),
    )


def _solve(dump: Dump, alloy: Alloy, commands: str, limit: float, stop: Event | None) -> dict[str, SolverOutcome]:
    with tempfile.TemporaryDirectory(prefix="midstride-verify-") as folder:
        source = Path(folder) / "dump.als"
        source.write_text(dump.text, encoding="utf-8")
        return alloy.solve(source, commands, limit=limit, stop=stop)


def _unfit(because: str) -> Verdict:
    finding = Finding("document", None, "the plan", "its document", because)
    return Verdict(Answer.VIOLATED, "the plan", "read, not executed", "Midstride", (finding,))


def _judged(subject: str, dump: Detail, asking: Asking) -> Verdict:
    try:
        whole = dump(None)
        asking.keep(whole.text)
        alloy = asking.alloy if isinstance(asking.alloy, Alloy) else find(asking.alloy)
        return _judge(whole, alloy, asking, dump)
    except (TooLarge, VerificationError) as error:
        return Verdict(Answer.UNKNOWN, subject, "nothing was judged", "Alloy", because=str(error))
