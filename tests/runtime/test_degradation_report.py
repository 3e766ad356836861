"""What is lower after a change than before it, role by role: as planned, and unexpectedly."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from immutables import Map

from midstride.model.configuration import Configuration
from midstride.model.specification import Node, Specification
from midstride.runtime.records.reports import DegradedFunctionality
from midstride.runtime.watch.degradation_report import degradations_in_words, remaining_degradations
from tests.model import build
from tests.model.build import work
from tests.runtime.scripted import LISTENER, TALKER, Bench, bench, instance, reported, talking

SPECIFICATION = Specification(
    "chat",
    components=Map({each.name: each for each in (TALKER, LISTENER)}),
    nodes=Map(
        talker=Node("talker", "Talker", Map(out=("/chatter",))),
        listener=Node("listener", "Listener", Map({"in": ("/chatter",)})),
    ),
)
WHOLE = talking()
FALLEN = WHOLE.with_modes({work("listener"): 1})


def remaining(
    folder: Path,
    now: Configuration,
    start: Configuration = WHOLE,
    planned: Configuration = WHOLE,
    prepare: Callable[[Bench], object] = lambda _: None,
) -> list[DegradedFunctionality]:
    async def body(b: Bench) -> list[DegradedFunctionality]:
        prepare(b)
        return remaining_degradations(b.system, start, planned)

    return bench(now, folder, body, specification=SPECIFICATION)


def test_nothing_is_lower_where_everything_is_as_before(tmp_path: Path) -> None:
    assert remaining(tmp_path, WHOLE) == []


def test_what_was_lower_before_is_not_a_result_of_the_change(tmp_path: Path) -> None:
    assert remaining(tmp_path, FALLEN, start=FALLEN) == []


def test_what_the_plan_lowers_is_called_planned(tmp_path: Path) -> None:
    [found] = remaining(tmp_path, FALLEN, planned=FALLEN)
    expected = DegradedFunctionality(
        functionality="listener.work", before="normal", after="degraded", planned=True, because=None
    )
    assert found == expected
    assert degradations_in_words([found]) == "listener.work is in mode degraded instead of normal"


def test_what_has_fallen_besides_has_the_reason_that_its_component_gives(tmp_path: Path) -> None:
    def prepare(b: Bench) -> None:
        b.client.report(reported(b.configuration.instances["listener"], FALLEN))

    [found] = remaining(tmp_path, FALLEN, prepare=prepare)
    assert (found.planned, found.because) == (False, "it entered degraded")


def test_a_role_that_nothing_serves_any_more_has_no_mode(tmp_path: Path) -> None:
    [found] = remaining(tmp_path, WHOLE.without_instance("listener"))
    assert (found.functionality, found.before, found.after, found.planned) == ("listener.work", "normal", None, False)
    without = WHOLE.without_instance("listener")
    [found] = remaining(tmp_path, without, planned=without)
    assert (found.after, found.planned, found.because) == (None, True, None)


def test_one_whose_output_is_not_attached_serves_nothing(tmp_path: Path) -> None:
    off = WHOLE.without_attachment(build.port("talker.out"), "/chatter")
    [found] = remaining(tmp_path, off)
    assert (found.functionality, found.after) == ("talker.work", None)


def test_of_two_instances_the_better_one_counts(tmp_path: Path) -> None:
    other = instance("listener_2", LISTENER, "listener")
    both = FALLEN.with_instance(other).with_attachment(build.port("listener_2.in"), "/chatter")
    assert remaining(tmp_path, both.with_modes({work("listener_2"): 0})) == []


def test_a_new_role_is_lower_if_it_is_not_in_its_best_mode(tmp_path: Path) -> None:
    before = WHOLE.without_instance("listener")
    assert remaining(tmp_path, WHOLE, start=before) == []
    [found] = remaining(tmp_path, FALLEN, start=before)
    assert (found.before, found.after, found.planned) == ("normal", "degraded", False)


def test_a_role_that_was_not_there_and_is_not_planned_is_left_out(tmp_path: Path) -> None:
    without = WHOLE.without_instance("listener")
    assert remaining(tmp_path, without, start=without, planned=without) == []
