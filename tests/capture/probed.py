"""Systems of twenty nodes that are made up, whose gates count what the nodes would write, without time passing."""

from __future__ import annotations

import math
import random
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from itertools import pairwise
from typing import Literal

from midstride.capture.probe import Count, ProbedPort

Kind = Literal["timer", "held", "each", "all", "falls back", "bursts"]


@dataclass
class Output:
    """``needs``: the topics of the inputs that it depends on. ``rate`` (Hz): of a timer; at most, of another one.

    A `timer` needs none. The others write for each message (`each`), for one message of each input (`all`), on a timer
    as long as they have heard something within ``patience`` s (`held`), or at half their rate without (`falls back`).
    `bursts` is a timer in bursts with long pauses. ``regular``: whether its gaps are equal, or those of chance.
    """

    topic: str
    kind: Kind
    rate: float
    needs: tuple[str, ...] = ()
    regular: bool = True
    patience: float = 0.3


@dataclass
class MadeUp:
    """``nodes``: the topics of the inputs of each, and its outputs."""

    seed: int
    nodes: dict[str, tuple[tuple[str, ...], list[Output]]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.noise = random.Random(self.seed)
        self.rates = cache(self._rates)
        self.seconds = 0.0

    def ports(self) -> list[ProbedPort]:
        return [
            port
            for node, (inputs, outputs) in self.nodes.items()
            for port in (
                *(ProbedPort(node, topic, False) for topic in inputs),
                *(ProbedPort(node, output.topic, True) for output in outputs),
            )
        ]

    def edges(self) -> set[tuple[str, str, str]]:
        """What truly depends on what."""
        return {
            (node, topic, output.topic)
            for node, (_, outputs) in self.nodes.items()
            for output in outputs
            for topic in output.needs
        }

    def _rates(self, closed: ProbedPort | None, after: float) -> dict[str, float]:
        """The rate of each topic (Hz), ``after`` so long with an input closed."""
        rates = {output.topic: output.rate for _, outputs in self.nodes.values() for output in outputs}
        for _ in range(2 * len(self.nodes)):  # until nothing changes any more
            before = dict(rates)
            for node, (_, outputs) in self.nodes.items():
                for output in outputs:
                    heard = [
                        0.0 if closed == (node, topic, False) else before.get(topic, 0.0) for topic in output.needs
                    ]
                    rates[output.topic] = rate_of(output, heard, after)
            if rates == before:
                break
        return rates

    def watch(self, closed: ProbedPort | None, settling: float, counting: float) -> Mapping[ProbedPort, Count]:
        self.seconds += settling + counting
        rates = self.rates(closed, settling)
        kinds = {output.topic: output for _, outputs in self.nodes.values() for output in outputs}
        written = {topic: self.count(kinds[topic], rate, counting) for topic, rate in rates.items()}
        found = {}
        for port in self.ports():
            count = written.get(port.topic, Count(0, 0, counting))
            held = count.passed + int(self.rates(None, 0.0).get(port.topic, 0.0) * settling) if port == closed else 0
            found[port] = Count(0, held, counting) if port == closed else count
        return found

    def count(self, output: Output, rate: float, counting: float) -> Count:
        """What is written within a window: some of it late, on a machine with other things to do."""
        times: list[float] = []
        at = self.noise.uniform(0, 1 / rate) if rate else math.inf
        if output.kind == "bursts":
            begun = self.noise.uniform(-9.0, counting)
            times = [begun + 0.02 * number for number in range(50) if 0 <= begun + 0.02 * number < counting]
            at = math.inf
        while at < counting:
            times.append(at)
            at += self.noise.uniform(0.8, 1.2) / rate if output.regular else self.noise.expovariate(rate)
        edges = [0.0, *times, counting]
        return Count(len(times), 0, max(later - earlier for earlier, later in pairwise(edges)))


def rate_of(output: Output, heard: list[float], after: float) -> float:
    """What an output writes (Hz) when its inputs are heard at these rates."""
    if output.kind == "each":
        return min(output.rate, sum(heard))
    if output.kind == "all":
        return min([output.rate, *heard])
    silent = any(not rate for rate in heard)
    if output.kind == "held":
        return 0.0 if silent and after >= output.patience else output.rate
    return output.rate / 2 if output.kind == "falls back" and silent else output.rate


def made_up(seed: int) -> MadeUp:
    """Twenty nodes: sensors, filters behind them, and nodes with several inputs and outputs; some of it in a loop."""
    draw = random.Random(seed)
    system = MadeUp(seed)
    topics: dict[str, float] = {}
    for number in range(20):
        node = f"/node{number}"
        inputs = tuple(draw.sample(sorted(topics), min(len(topics), draw.randrange(4)))) if number > 4 else ()
        outputs = []
        for index in range(draw.randrange(1, 4)):
            topic, rate = f"/topic{number}_{index}", draw.choice((4.0, 5.0, 10.0, 20.0, 50.0))
            needs = tuple(sorted(draw.sample(inputs, draw.randrange(len(inputs) + 1))))
            regular = draw.random() < 0.7
            kind: Kind = "bursts" if draw.random() < 0.1 else "timer"
            if needs:
                kind = draw.choice(("held", "falls back", "all", "all") if len(needs) > 1 else ("held", "each", "all"))
            if kind in ("each", "all"):
                rate = min([1000.0, *(topics[each] for each in needs)])
            else:
                needs = () if kind in ("timer", "bursts") else needs
            outputs.append(Output(topic, kind, rate, needs, regular))
            topics[topic] = 0.0 if kind == "bursts" else rate
        topics = {topic: rate for topic, rate in topics.items() if rate}
        system.nodes[node] = (inputs, outputs)
    # A filter of the first sensor hears what a later node makes of it, as well.
    first = next(iter(topics))
    system.nodes["/controller"] = (
        (first, "/state"),
        [Output("/command", "held", 20.0, (first,)), Output("/report", "each", 20.0, ("/state",))],
    )
    system.nodes["/plant"] = (("/command",), [Output("/state", "held", 20.0, ("/command",))])
    return system
