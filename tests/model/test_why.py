"""Chains of reasons cut short: they begin as the whole ones do, end where those end, and stay cheap together."""

from __future__ import annotations

import time

from hypothesis import given

from midstride.lang import load_text
from midstride.model.configuration import Configuration
from midstride.model.diagnosis import Diagnosis, reasons_against
from midstride.model.rules import Evaluator
from midstride.model.specification import Specification, initial
from tests.large_systems import chain
from tests.model import build
from tests.strategies.systems import specifications


@given(specifications())
def test_short_chains_begin_and_end_as_the_whole_ones(specification: Specification) -> None:
    configuration = initial(specification)
    why = Diagnosis(configuration)
    for ref in configuration.modes:
        whole = reasons_against(configuration, ref)
        assert why.chain(ref, most=10_000) == whole
        short = why.chain(ref, most=1)
        assert bool(short) == bool(whole)
        for reason in short:
            assert reason.removeprefix("… root cause: ") in whole


def dead(nodes: int) -> Configuration:
    """A chain of nodes that nothing feeds well enough."""
    return initial(
        load_text(chain(nodes).replace("String @ 50 Hz", "String @ 1 Hz")).specification or Specification("")
    )


def test_the_end_of_a_long_chain_is_told() -> None:
    configuration = dead(50)
    (last,) = (ref for ref in configuration.modes if ref.instance == "n49")
    told = Diagnosis(configuration).chain(last)
    assert len(told) == 5
    assert told[0].startswith("n49.filter cannot be in mode normal: it assumes in: no publisher satisfies /t49")
    assert told[-1].startswith("… root cause: n0.filter cannot be in mode ")
    assert "environment source: rate: 1 Hz is offered, at least 10 Hz is needed" in told[-1]


def test_all_chains_together_cost_no_more_than_the_system() -> None:
    def seconds(nodes: int) -> float:
        configuration = dead(nodes)
        start = time.process_time()
        why = Diagnosis(configuration)
        for ref in configuration.modes:
            why.chain(ref)
        return time.process_time() - start

    small, large = min(seconds(200) for _ in range(3)), min(seconds(1600) for _ in range(3))
    assert large < 8 * 3 * small


def test_an_input_on_a_topic_that_guarantees_too_little_is_explained() -> None:
    """That is so while the topic's contract changes."""
    topics = {"/chatter": build.at(1)}
    found = build.system({"listener": build.sink("Listener")}, ["listener.in /chatter"], topics=topics)
    assert Evaluator(found).why_input_unsatisfied(build.port("listener.in")) == (
        "/chatter does not satisfy what input listener.in assumes (rate: 1 Hz is offered, at least 5 Hz is needed)"
    )
