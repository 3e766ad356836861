"""The inputs on which each output of a node depends: one input at a time is closed, and opened again.

Each input is closed ROUNDS times, and all are open for as long before and after. An output *depends* on the input if in
every round it wrote less while that was closed, in all of them at most SLOWED times as fast, and if such a difference
had a probability below SIGNIFICANCE were there none: by the exact conditional test of two Poisson rates (Przyborowski
and Wilenski, Biometrika 31, 1940), which errs on the safe side for messages that come more regularly than by chance.
What is too rare, irregular or unsteady for that is *undecided*, after MOST_ROUNDS rounds where more of them help.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final, Literal, NamedTuple, Protocol, TypeAlias

from midstride.model.wording import counted

ROUNDS: Final = 2
MOST_ROUNDS: Final = 6
# What a closed input does has this part of the time to show: a node may go on for a moment with what it has.
SETTLING: Final = 0.2
SIGNIFICANCE: Final = 0.001
# An output has slowed if it wrote at most so much of what it wrote before and after.
SLOWED: Final = 0.75
# A count of messages before that differs by more deviations from the one after has changed for another reason.
_STEADY: Final = 3.0
# With fewer messages held back, nothing was tried.
FEWEST_HELD: Final = 3

ProbeVerdict: TypeAlias = Literal["depends", "indirect", "independent", "undecided"]


class ProbedPort(NamedTuple):
    """A port of a running node, by the full names of both."""

    node: str
    topic: str
    output: bool


@dataclass(frozen=True, slots=True)
class Count:
    """The messages that a port has let pass, its longest silence (s), and the messages that a closed input has held
    back.
    """

    passed: int
    held: int = 0
    longest: float = 0.0


Window: TypeAlias = Mapping[ProbedPort, Count]


class ProbedGates(Protocol):
    """The gates of running nodes."""

    def ports(self) -> Collection[ProbedPort]:
        """The ports of the nodes that run."""

    def watch(self, closed: ProbedPort | None, settling: float, counting: float) -> Window:
        """Count what passes within ``counting`` s, after ``settling`` s in which nothing counts.

        ``closed`` is closed meanwhile, and open when this returns or raises. A node that has ended is left out.
        """


@dataclass(frozen=True, slots=True)
class Dependence:
    """The finding whether an output depends on an input, and the evidence in words.

    ``more``: whether more rounds may decide it.
    """

    verdict: ProbeVerdict
    because: str
    more: bool = False


#: By full name of the node, topic of the input and topic of the output.
Dependences: TypeAlias = Mapping[tuple[str, str, str], Dependence]


class _Trial(NamedTuple):
    before: Window
    closed: Window
    after: Window


def probed_inputs(ports: Iterable[ProbedPort]) -> list[ProbedPort]:
    """The inputs that are worth closing: those of nodes that have outputs."""
    ports = set(ports)
    writing = {port.node for port in ports if port.output}
    return sorted(port for port in ports if not port.output and port.node in writing)


def duration(inputs: int, seconds: float) -> float:
    """The time that it takes to probe so many inputs in ROUNDS rounds, each closed for ``seconds`` at a time (s)."""
    return (2 * ROUNDS * inputs + 1) * seconds


def probe(
    gates: ProbedGates,
    ports: Iterable[ProbedPort],
    seconds: float,
    progress: Callable[[ProbedPort, int], None] = lambda port, number: None,
) -> Dependences:
    """Close each of the inputs among ``ports`` for ``seconds`` at a time; what was found of it and each output.

    ``progress`` is called before each time, with the number of the round.
    """
    ports = set(ports)
    settling, counting = SETTLING * seconds, (1 - SETTLING) * seconds
    inputs = probed_inputs(ports)
    trials: dict[ProbedPort, list[_Trial]] = {each: [] for each in inputs}
    found: dict[tuple[ProbedPort, ProbedPort], Dependence] = {}
    again = set(inputs)
    before = gates.watch(None, settling, counting) if inputs else {}
    for number in range(MOST_ROUNDS):
        for each in inputs:
            if each not in again:
                continue
            progress(each, number)
            closed = gates.watch(each, settling, counting)
            after = gates.watch(None, settling, counting)
            trials[each].append(_Trial(before, closed, after))
            before = after
            pairs = [(each, port) for port in ports if port.node == each.node and port != each]
            found |= {pair: _judged(*pair, trials[each], counting) for pair in pairs}
            if number >= ROUNDS - 1 and not any(found[pair].more for pair in pairs if pair[1].output):
                again.remove(each)
    _resolve(found)
    return {(one.node, one.topic, two.topic): finding for (one, two), finding in found.items() if two.output}


def _judged(closed: ProbedPort, port: ProbedPort, trials: Sequence[_Trial], counting: float) -> Dependence:
    """Return whether messages of ``port`` became fewer when ``closed`` was closed."""
    windows = [window for trial in trials for window in trial]
    if any(each not in window for window in windows for each in (closed, port)):
        return Dependence("undecided", "the node ended meanwhile")
    rounds = [(trial.before[port], trial.closed[port], trial.after[port]) for trial in trials]
    held = sum(trial.closed[closed].held for trial in trials)
    opened = sum(before.passed + after.passed for before, _, after in rounds)
    through = sum(count.passed for _, count, _ in rounds)
    rates = opened / (2 * len(rounds) * counting), through / (len(rounds) * counting)
    longest = max(max(before.longest, after.longest) for before, _, after in rounds)
    evidence = f"{rates[0]:.3g} Hz, and {rates[1]:.3g} Hz while it was closed, {held} messages held back"
    if held < FEWEST_HELD:
        return Dependence("undecided", f"only {counted(held, 'message')} could be held back", held > 0)
    if (2 / 3) ** opened >= SIGNIFICANCE:
        words = f"too rare to judge: {opened} messages in {2 * len(rounds) * counting:.3g} s"
        return Dependence("undecided", words, opened > 0)
    if longest > counting / 2:
        return Dependence("undecided", f"too irregular to judge: silent for {longest:.2g} s with all inputs open")
    if any((b.passed - a.passed) ** 2 > _STEADY**2 * (b.passed + a.passed) for b, _, a in rounds):
        return Dependence("undecided", "its rate before and after was not the same")
    if rates[1] > SLOWED * rates[0]:
        return Dependence("independent", evidence)
    slower = all(2 * count.passed < before.passed + after.passed for before, count, after in rounds)
    if slower and probability(through, opened) < SIGNIFICANCE:
        return Dependence("depends", evidence)
    return Dependence("undecided", f"inconclusive: {evidence}", True)


def probability(closed: int, opened: int) -> float:
    """The probability of at most ``closed`` of all messages in a third of the time, if the rate is constant."""
    total = closed + opened
    factorials = math.lgamma(total + 1)
    return math.fsum(
        math.exp(
            factorials
            - math.lgamma(count + 1)
            - math.lgamma(total - count + 1)
            - count * math.log(3)
            + (total - count) * math.log(2 / 3)
        )
        for count in range(closed + 1)
    )


def _resolve(found: dict[tuple[ProbedPort, ProbedPort], Dependence]) -> None:
    """Mark what depends on an input through the topics of other nodes only.

    That is so where another input of the node fell silent as well when this one was closed, where the output depends
    on that one, and where a way over topics leads from this one to that one.
    """
    direct = {pair for pair, finding in found.items() if finding.verdict == "depends" and pair[1].output}
    for closed, output in sorted(direct):
        others = direct - {(closed, output)}
        through = sorted(
            other
            for (one, other), finding in found.items()
            if one == closed and not other.output and finding.verdict == "depends" and (other, output) in others
        )
        for other in through:
            if other in _reached(closed, others, found):
                direct = others
                found[closed, output] = Dependence("indirect", f"only through {other.topic}")
                break


def _reached(
    start: ProbedPort,
    direct: Collection[tuple[ProbedPort, ProbedPort]],
    found: Iterable[tuple[ProbedPort, ProbedPort]],
) -> set[ProbedPort]:
    """Every port that ``start`` leads to, by direct dependence and by topics."""
    ports = {port for pair in found for port in pair}
    reached, open_ = {start}, [start]
    while open_:
        port = open_.pop()
        after = (
            [each for each in ports if not each.output and each.topic == port.topic]
            if port.output
            else [output for one, output in direct if one == port]
        )
        open_ += [each for each in after if each not in reached]
        reached.update(after)
    return reached
