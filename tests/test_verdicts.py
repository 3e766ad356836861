"""What may be said from which facts: the headline is the weakest, and no other module composes one."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pytest

import midstride
from midstride.model.component import ComponentSpec
from midstride.verdicts import assessment, change_facts, conditions, unmeasured
from midstride.verdicts.conditions import EXIT_STATUS
from tests.model import build

SOURCE = Path(midstride.__file__).parent
# Parts of sentences that claim something of a system's work, as other modules once wrote them.
CLAIMS = re.compile(
    r"fell below|fallen below|was below its level|Nothing degrades:|Exited unexpectedly meanwhile"
    r"|unexpectedly meanwhile|not measurable here",
    re.IGNORECASE,
)


def test_no_other_module_composes_what_is_said_of_the_work_of_a_system() -> None:
    files = [*SOURCE.rglob("*.py"), *(path for path in SOURCE.rglob("*.js") if "vendor" not in path.parts)]
    found = {str(path.relative_to(SOURCE)) for path in files if CLAIMS.search(path.read_text(encoding="utf-8"))}
    labels = {"cli/render.py", "server/dashboard/plan/outcome.js", "server/dashboard/change/parts.js"}
    own = {path for path in found if path.startswith("verdicts/")}
    assert own and found - own <= labels, found - own
    for name in labels:  # which only label what the manager has said
        text = (SOURCE / name).read_text(encoding="utf-8")
        assert {match.lower() for match in CLAIMS.findall(text)} <= {"not measurable here"}, name


LOST = change_facts.below_level("talker.talk", 1.2)
UNKNOWN = unmeasured.unmeasured_exchange("driver", "no ports are stated", together=0.4)


def test_the_headline_is_the_weakest_of_what_is_known() -> None:
    assert assessment.assessed([None]).headline == "Nothing fell below its level."
    unknown = assessment.assessed([UNKNOWN, None])
    assert (unknown.verdict, unknown.lines) == ("not_measurable", [unknown.headline])
    assert unknown.headline == (
        "Nothing is known to have fallen below its level. Not measurable here: what driver does: no ports are stated. "
        "It was never down: both instances ran for 400 ms."
    )
    both = assessment.assessed([UNKNOWN, LOST])
    assert (both.verdict, both.headline) == ("lost", "Lost: talker.talk for 1.20 s; 1 not measurable here.")
    assert both.lines == [
        f"Not measurable here: {UNKNOWN.words}.",
        "talker.talk was below its level for 1.20 s.",
    ]
    assert (both.lost_seconds, both.lasting) == (1.2, False)


def test_a_plan_with_a_node_that_nothing_measures_does_not_say_that_nothing_degrades() -> None:
    assert assessment.expected([]).headline.startswith("Nothing degrades: ")
    side = change_facts.will_be_exchanged("driver", "no ports are stated", side_by_side=True, seconds=2.0)
    assert assessment.expected([side]).headline.startswith(
        "Nothing is known to degrade. Not measurable here: what driver"
    )
    after = change_facts.will_be_exchanged("driver", "no ports are stated", side_by_side=False, seconds=2.0)
    assert (after.verdict, "about 2.00 s" in after.words) == ("lost", True)
    assert assessment.expected([side, after]).verdict == "lost"


def test_a_node_without_ports_that_was_down_is_lost_for_as_long() -> None:
    down = unmeasured.unmeasured_exchange("driver", "no ports are stated", down=1.1)
    assert (down.verdict, down.seconds) == ("lost", None)
    assert down.words.startswith(
        "driver was down, for how long is not known: exchanged within 1.10 s, and when its new"
    )
    assert unmeasured.unmeasured_exchange("driver", "no ports are stated", done=False).verdict == "not_measurable"


@pytest.mark.parametrize(("passed", "seconds"), [(100, None), (91, None), (60, 2.0), (0, 5.0)])
def test_an_output_was_silent_if_its_count_lacks_more_than_its_rate_tolerates(
    passed: int, seconds: float | None
) -> None:
    found = change_facts.written("/chat", "talker.out", passed, 5.0, 20.0)
    assert (None if found is None else found.seconds) == seconds


@pytest.mark.parametrize(("rate", "unknown"), [(0.0, False), (1.0, True), (100.0, False)])
def test_a_count_that_lacks_nothing_leaves_a_silence_open_where_it_tolerates_one(rate: float, unknown: bool) -> None:
    assert (change_facts.silent_between_counts("/chat", "talker.out", 4.0, rate) is not None) == unknown


def test_less_than_a_period_without_an_active_lifecycle_node_loses_nothing() -> None:
    assert change_facts.inactive("/chat", "talker.out", 0.015, 50.0) is None
    for rate in (None, 50.0):
        found = change_facts.inactive("/chat", "talker.out", 8.02, rate)
        assert found is not None and (found.verdict, found.seconds, found.at_most) == ("lost", 8.02, True)
        what = "/chat was silent while no node that writes talker.out was active"
        assert found.words == f"{what}, for at most 8.02 s, and until it wrote again"


def test_a_time_that_may_be_shorter_is_said_to_be_the_longest() -> None:
    bound = change_facts.below_level("planner.plan", 2.0, at_most=True)
    assert bound.words == "planner.plan was below its level for at most 2.00 s"
    found = assessment.assessed([bound, LOST])
    assert found.headline == "Lost: planner.plan until a node was active again, at most 2.00 s, talker.talk for 1.20 s."
    assert found.in_short == "lost at most 2.00 s"
    assert assessment.assessed([change_facts.below_level("talker.talk", 2.0), bound]).in_short == "lost 2.00 s"
    assert assessment.assessed([UNKNOWN]).in_short == "not measurable"


def gated(gate: str | None, *, ports: bool) -> ComponentSpec:
    found = build.source("Camera") if ports else ComponentSpec.of("Camera")
    return replace(found, gate=gate)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("gate", "ports", "because"),
    [
        (None, True, None),
        (None, False, None),
        ("preload", True, None),
        ("relay", True, None),
        ("lifecycle", True, None),
        ("lifecycle preload", True, None),
        ("none", True, "nothing counts messages (`gate none`)"),
        ("preload", False, "no ports are stated"),
        ("none", False, "no ports are stated"),
        ("lifecycle", False, "no ports are stated"),
    ],
)
def test_what_nothing_measures_is_known_for_every_kind_of_gate(
    gate: str | None, ports: bool, because: str | None
) -> None:
    assert unmeasured.why_unmeasured(gated(gate, ports=ports)) == because


def test_the_condition_of_a_system_is_about_its_nodes() -> None:
    up = conditions.system_condition(2, 2, [])
    assert (up.state, up.headline, EXIT_STATUS[up.state]) == ("up", "up, all 2 nodes run", 0)
    hung = conditions.system_condition(2, 2, ["talker does not answer"], answering=1)
    assert hung.headline == "degraded, all 2 nodes run, 1 of them without an answer: talker does not answer"
    lost = conditions.system_condition(2, 0, ["host arm cannot be reached"], answering=0, unreachable=1)
    assert lost.headline.startswith("degraded, 0 of 2 nodes run, and whether 1 more does is not known: host arm")
    dead = conditions.system_condition(2, 1, ["talker exited unexpectedly"])
    assert dead.headline == "degraded, 1 of 2 nodes run: talker exited unexpectedly"
    assert EXIT_STATUS[dead.state] == 3
    none = conditions.system_condition(1, 0, ["driver exited unexpectedly"])
    assert (none.headline, EXIT_STATUS[none.state]) == ("down: none of its 1 node runs", 1)
    unknown = conditions.system_condition(1, 1, [], ["what driver does (no ports are stated)"])
    assert unknown.headline == "up, its node runs; not measurable here: what driver does (no ports are stated)"


def test_a_rate_that_is_somewhat_too_low_is_named_and_no_fault() -> None:
    slow = conditions.writes_less("source.out", 175.0, 200.0)
    found = conditions.system_condition(3, 3, [], slow=[slow])
    assert found.headline == "up, all 3 nodes run; below its rate: source.out writes 175 Hz, and guarantees 200 Hz"
    assert (found.state, conditions.is_far_below(175.0, 200.0)) == ("up", False)
    assert conditions.is_far_below(66.0, 200.0) and conditions.is_far_below(None, 200.0)


def test_what_a_killed_process_loses_is_said_whatever_its_words() -> None:
    lost = "what it does at its end is lost"
    assert change_facts.killed("camera", "camera had to be killed").words == f"camera had to be killed: {lost}"
    words = f"camera: on_stop did not return within 4 s, and its child was killed (SIGKILL): {lost}"
    assert change_facts.killed("camera", words, unfinished=True).words == words
