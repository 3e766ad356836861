"""What a probe finds in systems that are made up, against what they are made of."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import pytest

from midstride.capture.probe import (
    MOST_ROUNDS,
    ROUNDS,
    Count,
    Dependence,
    Dependences,
    ProbedPort,
    duration,
    probability,
    probe,
)
from tests.capture.probed import MadeUp, Output, made_up

SECONDS = 3.0
IN, OUT = ProbedPort("/node", "/in", False), ProbedPort("/node", "/out", True)


def depends(findings: Dependences) -> set[tuple[str, str, str]]:
    return {edge for edge, finding in findings.items() if finding.verdict == "depends"}


def shares(seeds: range) -> tuple[float, float]:
    """Which share of what is found is true, and which share of what is true is found."""
    right = false = missed = 0
    for seed in seeds:
        system = made_up(seed)
        true, found = system.edges(), depends(probe(system, system.ports(), SECONDS))
        right, false, missed = right + len(true & found), false + len(found - true), missed + len(true - found)
    assert right > 15 * len(seeds)
    print(f"{right} found, {false} of them false, {missed} missed")
    return right / (right + false), right / (right + missed)


def test_dependences_of_twenty_nodes_are_precise_and_complete() -> None:
    assert min(shares(range(6))) >= 0.95


@pytest.mark.full
def test_dependences_of_many_systems_are_precise_and_complete() -> None:
    precision, completeness = shares(range(100, 150))
    assert precision >= 0.99 and completeness >= 0.95


def test_what_depends_through_other_nodes_only_is_no_dependence_of_the_node() -> None:
    system = MadeUp(
        1,
        {
            "/sensor": ((), [Output("/scan", "timer", 10.0)]),
            "/controller": (
                ("/scan", "/state"),
                [Output("/command", "held", 20.0, ("/scan",)), Output("/report", "each", 20.0, ("/state",))],
            ),
            "/plant": (("/command",), [Output("/state", "each", 20.0, ("/command",))]),
        },
    )
    findings = probe(system, system.ports(), SECONDS)
    assert depends(findings) == system.edges()
    assert findings["/controller", "/scan", "/report"] == Dependence("indirect", "only through /state")
    assert findings["/controller", "/state", "/command"].verdict == "independent"
    assert system.seconds == pytest.approx(duration(3, SECONDS)) and duration(3, SECONDS) == 39.0


def test_in_a_loop_each_output_keeps_what_it_depends_on_itself() -> None:
    """Whichever input is closed, everything stops."""
    system = MadeUp(
        1,
        {
            "/node": (
                ("/back", "/other_back"),
                [Output("/out", "held", 20.0, ("/back",)), Output("/other", "held", 20.0, ("/other_back",))],
            ),
            "/one": (("/out",), [Output("/other_back", "held", 20.0, ("/out",))]),
            "/two": (("/other",), [Output("/back", "held", 20.0, ("/other",))]),
        },
    )
    assert depends(probe(system, system.ports(), SECONDS)) == system.edges()


@dataclass
class Scripted:
    """One node, of whose output ``count`` says what is counted: in which window, and whether the input is closed."""

    count: Callable[[int, bool], Count | None]
    held: int = 10
    windows: int = 0

    def ports(self) -> list[ProbedPort]:
        return [IN, OUT]

    def watch(self, closed: ProbedPort | None, settling: float, counting: float) -> Mapping[ProbedPort, Count]:
        assert (settling, counting) == pytest.approx((0.6, 2.4))
        self.windows += 1
        count = self.count(self.windows, closed is not None)
        found = {IN: Count(0, self.held) if closed else Count(self.held)}
        return found if count is None else {**found, OUT: count}


@pytest.mark.parametrize(
    ("count", "held", "rounds", "verdict", "words"),
    [
        (lambda _, closed: Count(0 if closed else 12), 10, ROUNDS, "depends", "5 Hz, and 0 Hz while it was closed"),
        (lambda _, closed: Count(5 if closed else 12), 10, 3, "depends", "2.08 Hz while it was closed"),
        (lambda _, closed: Count(11 if closed else 12), 10, ROUNDS, "independent", "4.58 Hz while it was closed"),
        (lambda _, closed: Count(0 if closed else 12), 0, ROUNDS, "undecided", "only 0 messages could be held back"),
        (lambda _, closed: Count(0 if closed else 12), 1, 3, "depends", "3 messages held back"),
        (
            lambda _, closed: Count(0 if closed else 1),
            10,
            MOST_ROUNDS,
            "undecided",
            "too rare to judge: 12 messages in",
        ),
        (lambda _, closed: Count(0), 10, ROUNDS, "undecided", "too rare to judge: 0 messages"),
        (lambda _, closed: Count(0 if closed else 12, 0, 1.3), 10, ROUNDS, "undecided", "silent for 1.3 s with all"),
        (
            lambda number, _: Count(30 if number < 3 else 0),
            10,
            ROUNDS,
            "undecided",
            "before and after was not the same",
        ),
        # It stopped once by chance while the input was closed, and once it did not.
        (lambda number, _: Count(0 if number == 2 else 40), 10, 5, "independent", "held back"),
        (lambda number, _: None if number == 3 else Count(10), 10, ROUNDS, "undecided", "the node ended meanwhile"),
    ],
    ids=[
        "stops",
        "slows",
        "goes on",
        "nothing to hold back",
        "a slow input",
        "a slow output",
        "silent",
        "irregular",
        "stops for good",
        "once by chance",
        "dies",
    ],
)
def test_verdicts(count: Callable[[int, bool], Count | None], held: int, rounds: int, verdict: str, words: str) -> None:
    gates = Scripted(count, held)
    (finding,) = probe(gates, gates.ports(), SECONDS).values()
    assert (finding.verdict, gates.windows) == (verdict, 2 * rounds + 1)
    assert words in finding.because


def test_the_inputs_of_a_node_without_outputs_stay_open() -> None:
    gates = Scripted(lambda number, closed: None)
    assert probe(gates, [IN], SECONDS) == {} and gates.windows == 0


def test_the_probability_is_that_of_the_binomial_distribution() -> None:
    for closed, opened in ((0, 12), (3, 20), (40, 110), (700, 1500)):
        total = closed + opened
        exact = sum(math.comb(total, count) * 2 ** (total - count) for count in range(closed + 1)) / 3**total
        assert probability(closed, opened) == pytest.approx(exact, rel=1e-9)
