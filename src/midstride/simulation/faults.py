"""The menu of faults: what is drawn for a seed, when it strikes, and what it does to the platform."""

from __future__ import annotations

import random
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Final, Literal, TypeAlias, cast, get_args

from midstride.backends.simulator.injected_faults import RequestFault
from midstride.simulation.platform import Platform

FaultKind: TypeAlias = Literal[
    "crash",
    "freeze",
    "hang",
    "slow start",
    "failed start",
    "lost request",
    "lost reply",
    "refused request",
    "unreachable",
    "delayed request",
    "delayed reply",
    "repeated request",
    "repeated reply",
    "slow rate",
    "silence",
    "exception",
    "lost messages",
    "delayed messages",
    "no discovery",
    "clock jump",
    "full disk",
    "manager killed",
    "manager killed at a write",
    "torn write",
    "manager superseded",
    "link cut",
    "link cut one way",
    "link cut twice",
    "slow link",
    "lossy link",
    "host process killed",
]
# Faults of the line between two hosts, which are drawn besides where there are two; and those of declared hosts.
_CUTS: Final[tuple[FaultKind, ...]] = ("link cut", "link cut one way")
OF_LINKS: Final[tuple[FaultKind, ...]] = (*_CUTS, "link cut twice", "slow link", "lossy link", "host process killed")
KINDS: Final[tuple[FaultKind, ...]] = tuple(each for each in get_args(FaultKind) if each not in OF_LINKS)
_OF_HOSTS: Final[tuple[FaultKind, ...]] = tuple(each for each in KINDS if each != "clock jump")
# For how long a line is back before it is cut again (s): a connection is being made.
BACK: Final = (0.05, 0.4, 1.0)
# How late messages are at most (s): what is under way when the faults end arrives while the system settles.
LONGEST_DELAY: Final = 0.3
# Faults that make calls of a component's code late.
LATE: Final[frozenset[str]] = frozenset({"freeze", "hang", "clock jump"})
# Faults that keep the two sides of a hand-over from hearing of each other in time.
DEAFENING: Final[frozenset[str]] = LATE | {
    "lost request",
    "lost reply",
    "unreachable",
    "refused request",
    "delayed request",
    "delayed reply",
    *OF_LINKS,
}
# Faults in spite of which a change is done, where calls hang for less time than it waits for them.
HARMLESS: Final[frozenset[str]] = frozenset(
    {"hang", "repeated request", "repeated reply", "lost messages", "delayed messages"}
)
# Faults that stop no component.
OF_THE_MANAGER: Final[frozenset[str]] = frozenset(
    {"manager killed", "manager killed at a write", "torn write", "full disk", "manager superseded"}
)
# Faults after which a publisher still learns in time that it was replaced.
PROMPT: Final = OF_THE_MANAGER | {"hang", "slow start", "failed start", "slow rate", "silence", "exception"}
_REQUEST_FAULTS: Final[dict[FaultKind, RequestFault]] = {
    "lost request": "lost_request",
    "lost reply": "lost_reply",
    "refused request": "refused",
    "unreachable": "unreachable",
    "delayed request": "delayed_request",
    "delayed reply": "delayed_reply",
    "repeated request": "repeated_request",
    "repeated reply": "repeated_reply",
}
# What a stand-in that misbehaves does in every mode (:mod:`midstride.simulation.puppet`).
_MISBEHAVIOUR: Final[dict[FaultKind, dict[str, object]]] = {
    "slow rate": {"every": 5},
    "silence": {"silent": True},
    "exception": {"raise": "a drawn fault"},
}
# How many requests a change makes, about: a fault strikes at one of them.
REQUESTS: Final = 40
# The requests of a hand-over at which a fault strikes on purpose: between any two of them, another side knows more.
CRITICAL: Final = ("meet", "cut_out", "cut_in", "await_cut", "taken", "cancel_cut")
# What keeps one side of a hand-over from hearing of the other for longer than it waits; of requests, so many.
LOSSES: Final[tuple[FaultKind, ...]] = ("lost request", "lost reply", "unreachable")
STALLS: Final[tuple[FaultKind, ...]] = (*LOSSES, "freeze", "hang")
LASTING: Final = 20
# For how long a call of an old side hangs that is to agree on a cut (s): longer than the moments that it is offered are
# ahead, so that the hand-over is tried again; and less long than a change waits for it.
BUSY: Final = 3.0
# How many requests a step makes at most, or two hand-overs at once, where that is more than three.
REQUESTS_OF: Final = {"handover": 36, "create": 6}


@dataclass(frozen=True, slots=True)
class Fault:
    """``step``: it strikes ``after`` requests after the first step of that kind, else after the change began.

    ``op``: at the next request of that kind, and if ``involved`` at the instance that it is for.

    ``involved``: at an instance of a role that the change names, else at any. ``seconds`` is how long it lasts, or how
    much is delayed; ``times`` how many requests or messages it affects.
    """

    kind: FaultKind
    step: str | None
    after: int
    involved: bool
    seconds: float
    times: int
    op: str | None = None

    def __str__(self) -> str:
        if self.op is not None:
            return f"{self.kind} at `{self.op}`"
        where = "of the change" if self.step is None else f"from the first {self.step} on"
        return f"{self.kind} at request {self.after} {where}"


def draw(random: random.Random, steps: Sequence[str], hosts: bool = False) -> list[Fault]:
    """At least two faults, most of them during the steps of these kinds; in some runs only the manager fails.

    ``hosts``: without a clock of the whole system, of which each host has another one.
    """
    kinds = sorted(OF_THE_MANAGER) if random.random() < 0.2 else KINDS
    if hosts and kinds is KINDS:
        kinds = _OF_HOSTS
    return [_draw(random, steps, kinds) for _ in range(random.choice((2, 2, 2, 3, 4)))]


def _draw(random: random.Random, steps: Sequence[str], kinds: Sequence[str]) -> Fault:
    op = random.choice(CRITICAL) if "handover" in steps and random.random() < 0.25 else None
    step = "handover" if op is not None else random.choice(steps) if steps and random.random() < 0.75 else None
    after = 0 if op is not None else random.randrange(REQUESTS if step is None else REQUESTS_OF.get(step, 3))
    stalls = op is not None and kinds in (KINDS, _OF_HOSTS) and random.random() < 0.4
    kind = cast("FaultKind", random.choice(STALLS if stalls else kinds))
    if stalls and kind == "hang":
        return Fault(kind, "handover", 0, involved=True, seconds=BUSY, times=1, op="cut_out")
    return Fault(
        kind=kind,
        step=step,
        after=after,
        involved=random.random() < 0.6,
        seconds=random.choice((0.005, 0.03, 0.1, 0.3, 1.0, 3.0, 8.0)),
        times=LASTING if stalls else random.choice((1, 1, 2, 3) if op is None else (1, 2)),
        op=op,
    )


def draw_of_links(seed: int, steps: Sequence[str]) -> list[Fault]:
    """At most one fault of the line between two hosts, at a request by which a hand-over is agreed.

    By numbers that nothing else is drawn from.
    """
    drawn = random.Random(f"the line between two hosts, {seed}")
    kind = drawn.choice((*_CUTS, None))
    if kind is None or "handover" not in steps:
        return []
    op = drawn.choice((*CRITICAL, "claim", "claim"))
    seconds = drawn.choice((0.1, 0.3, 1.0, 1.3, 2.0, 4.0))
    return [Fault(kind, "handover", 0, involved=True, seconds=seconds, times=1, op=op)]


def draw_of_hosts(random: random.Random, steps: Sequence[str]) -> list[Fault]:
    """One or two faults of the lines between declared hosts, or of a host process, at any request of the change."""
    found = []
    for _ in range(random.choice((1, 1, 2))):
        kind = random.choice(OF_LINKS)
        step = random.choice(steps) if steps and random.random() < 0.75 else None
        after = random.randrange(REQUESTS if step is None else REQUESTS_OF.get(step, 3))
        seconds = random.choice((0.3, 1.0, 3.0, 6.0, 8.0, 15.0))
        found.append(Fault(kind, step, after, involved=False, seconds=seconds, times=1))
    return found


def _strike_hosts(fault: Fault, platform: Platform, random: random.Random) -> str | None:
    """A line between hosts, or a host process: in words, where there is one."""
    hosts, links = platform.host_names(), platform.network.links
    if fault.kind == "host process killed":
        running = [far for _, far in sorted(platform.far.items()) if far.runs]
        if not running:
            return None
        (far := random.choice(running)).kill()
        return far.name
    lines = [(one, other) for one in hosts for other in hosts if one != other]
    if not lines:
        return None
    if platform.far:
        one, other = random.choice(lines)
        lines = [(one, other), (other, one)]
    chosen = [random.choice(lines)] if fault.kind == "link cut one way" else lines
    for line in chosen:
        match fault.kind:
            case "slow link":
                links.slow(*line, min(fault.seconds, 1.0) * 0.3)
            case "lossy link":
                links.lose(*line, random.choice((0.005, 0.05, 0.3)))
            case _:
                links.cut(*line, fault.seconds)
                if fault.kind == "link cut twice":
                    back = fault.seconds + random.choice(BACK)
                    platform.later(back, partial(links.cut, *line, fault.seconds))
    return f"between {' and '.join(chosen[0])}" if platform.far else "between the hosts"


def strike(fault: Fault, platform: Platform, names: list[str], random: random.Random) -> str | None:
    """Let ``fault`` strike one of the instances in ``names``: the instance or topic concerned, or None if none is.

    Faults of the manager and of its disk are not the platform's.
    """
    faults, time = platform.faults, platform.time
    match fault.kind:
        case "slow start":
            platform.starting = fault.seconds if fault.seconds > 0.1 else 5 * fault.seconds
            return "starts"
        case "failed start":
            platform.next_start_fails = True
            return "the next start"
        case kind if kind in OF_LINKS:
            return _strike_hosts(fault, platform, random)
        case "clock jump":
            time.drive(1.0, time.ros_now() + round(random.choice((-1, 1)) * fault.seconds * 1e9))
            return "/clock"
    running = [process for name in names if (process := platform.standing(name)) is not None]
    if not running:
        return None
    target = random.choice(running)
    match fault.kind:
        case "crash":
            faults.kill(target.instance)
        case "freeze":
            faults.freeze(target.instance, fault.seconds)
        case "hang":
            faults.hang(target.instance, fault.seconds)
        case "no discovery":
            faults.stop_discovery(target.instance)
        case "slow rate" | "silence" | "exception":
            for behaviour in target.modes.values():
                behaviour.update(_MISBEHAVIOUR[fault.kind])
        case "lost messages" | "delayed messages":
            topics = sorted(name for name, topic in platform.network.topics.items() if topic.writers)
            if not topics:
                return None
            topic = random.choice(topics)
            if fault.kind == "lost messages":
                faults.drop(topic, 3 * fault.times)
            else:
                faults.delay(topic, min(fault.seconds, LONGEST_DELAY))
            return topic
        case kind:
            faults.fail_next(
                target.instance, fault.op, _REQUEST_FAULTS[cast("FaultKind", kind)], fault.times, 0, fault.seconds
            )
    return target.instance
