"""Proposes the ports and functionalities of each node of a graph, as text of the Stride language."""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import count
from typing import Final

from midstride.capture.observed import ObservedEndpoint, ObservedGraph
from midstride.capture.probe import Dependence, Dependences, ProbeVerdict
from midstride.capture.rates import MeasuredRate, measured
from midstride.capture.response_times import MeasuredAnswers, measured_answers
from midstride.lang.token_stream import RESERVED
from midstride.model.contract import DEFAULT_QOS, QoS
from midstride.model.wording import KIND_WORDS, counted

FUNCTIONALITY: Final = "main"
# Those of servers and of clients, if there are any.
SERVING: Final = "serve"
CALLING: Final = "call"
SHORT: Final = 70
# From what asks for no assumption to what does.
_VERDICTS: Final[tuple[ProbeVerdict, ...]] = ("independent", "indirect", "undecided", "depends")
_NOT_IN_NAMES: Final = re.compile(r"[^A-Za-z0-9_]+")


@dataclass(frozen=True, slots=True)
class ProposedPort:
    """A port. ``own_topic`` is what the program calls the topic.

    ``rate``, ``answers`` and ``note`` say what was measured.
    ``probed``: of an input, what a probe has found of it and each output, by name; empty where there was none.
    """

    name: str
    endpoint: ObservedEndpoint
    own_topic: str
    rate: MeasuredRate | None = None
    answers: MeasuredAnswers | None = None
    note: str = ""
    probed: Mapping[str, Dependence] = field(default_factory=dict)
    lazy: bool = False

    @property
    def contract(self) -> str:
        return contract_text(self.endpoint.type, self.endpoint.qos)

    @property
    def stated_topic(self) -> str:
        """``own_topic`` as the language has it: with its namespace, if it is a word of the language."""
        if self.own_topic not in RESERVED:
            return self.own_topic
        return f"{self.endpoint.node.rpartition('/')[0]}/{self.own_topic}"

    def declaration(self, *, of_program: bool = True) -> str:
        """The port as a component states it; ``of_program``: one whose program does not use Midstride's API."""
        own = f" as {self.stated_topic}" if of_program and self.stated_topic != self.name else ""
        words = KIND_WORDS[self.endpoint.kind]
        if self.endpoint.output:
            return f"{words.output} {self.name}{own}{' lazy' if of_program and self.lazy else ''}"
        return f"{words.input} {self.name} : {self.contract}{own}"

    @property
    def is_service(self) -> bool:
        """Return whether it is a server or a client, of a service or ROS action."""
        return self.endpoint.kind != "topic"

    @property
    def other_name(self) -> str | None:
        """Another name that the program may have for the topic: ``imu/data`` and ``~/data`` are the same for the node
        ``imu``.

        They are not for its replacement, whose node is ``imu_2``.
        """
        node, private = self.endpoint.node, self.own_topic.startswith("~/")
        if not private or self.endpoint.topic != f"{node}/{self.own_topic.removeprefix('~/')}":
            return None
        return f"{node.rpartition('/')[2]}/{self.own_topic.removeprefix('~/')}"

    @property
    def attachment(self) -> str:
        return f"{self.name} {'->' if self.endpoint.output else '<-'} {self.endpoint.topic}"


def contract_text(type_: str, qos: QoS, rate: float | None = None) -> str:
    """A contract; ``rate`` in Hz. What is ROS 2's default in a profile is left out."""
    plain = replace(
        qos,
        reliability=qos.reliability if not qos.is_reliable else None,
        durability=qos.durability if qos.is_transient_local else None,
        liveliness=qos.liveliness if qos.liveliness == "manual_by_topic" else None,
    )
    words = [type_, "" if rate is None else f"@ {rate:g} Hz", "" if plain == DEFAULT_QOS else str(plain)]
    return " ".join(filter(None, words))


def ports_of(
    graph: ObservedGraph,
    node: str,
    remaps: Mapping[str, str],
    findings: Dependences | None = None,
    services: Collection[ObservedEndpoint] = (),
) -> list[ProposedPort]:
    """The ports of a node; ``remaps`` has what its program calls topics and services, by their full names.

    ``services``: the servers and clients that become ports.
    """
    ports: list[ProposedPort] = []
    used: set[str] = set()
    endpoints = [*graph.of_node(node), *(each for each in graph.services_of(node) if each in services)]
    for endpoint in endpoints:
        name = _port_name(endpoint, endpoints, used)
        used.add(name)
        own = own_name(endpoint, remaps)
        rate, answers, note = None, None, ""
        if endpoint.output and endpoint.kind == "topic":
            rate, note = _measured(graph, endpoint)
        elif endpoint.output:
            answers, note = _answered(graph, endpoint)
        lazy = endpoint.output and (node, endpoint.topic) in graph.lazy
        ports.append(ProposedPort(name, endpoint, own, rate, answers, note, lazy=lazy))
    return [
        port if port.endpoint.output else replace(port, probed=_probed(port, ports, findings or {})) for port in ports
    ]


def _probed(port: ProposedPort, ports: Iterable[ProposedPort], findings: Dependences) -> dict[str, Dependence]:
    keys = {
        each.name: (port.endpoint.node, port.endpoint.topic, each.endpoint.topic)
        for each in ports
        if each.endpoint.output
    }
    return {name: findings[key] for name, key in keys.items() if key in findings}


def merged(variants: Iterable[list[ProposedPort]]) -> list[ProposedPort]:
    """The ports of nodes that share a component: it depends on what one of them depends on, and is as slow as one."""
    found = []
    for same in zip(*variants, strict=True):
        slowest = max(same, key=_late) if same[0].is_service else min(same, key=_bound)
        probed = {
            name: max((port.probed[name] for port in same if name in port.probed), key=_weight)
            for name in dict.fromkeys(name for port in same for name in port.probed)
        }
        lazy = any(port.lazy for port in same)
        measured = {"rate": slowest.rate, "answers": slowest.answers, "note": slowest.note}
        found.append(replace(same[0], probed=probed, lazy=lazy, **measured))
    return found


def _bound(port: ProposedPort) -> float:
    """The rate that the port can be relied on for; 0: none is known."""
    return 0.0 if port.rate is None else port.rate.bound


def _late(port: ProposedPort) -> float:
    """The bound that the port can be relied on for; infinite: none is known."""
    return math.inf if port.answers is None else port.answers.bound


def _weight(finding: Dependence) -> int:
    return _VERDICTS.index(finding.verdict)


def node_block(ports: Iterable[ProposedPort]) -> str:
    """The attachments of a node in braces, on one line if that is short."""
    attachments = [port.attachment for port in ports]
    line = f"{{ {'   '.join(attachments)} }}"
    return line if len(line) <= SHORT else "\n".join(["{", *attachments, "}"])


def _measured(graph: ObservedGraph, endpoint: ObservedEndpoint) -> tuple[MeasuredRate | None, str]:
    times = graph.times(endpoint)
    if endpoint.type in graph.unreadable and (endpoint.node, endpoint.topic) not in graph.counted:
        return None, "rate not measured: the package of its type is not here"
    if times is None:
        return None, "rate not measured: several nodes publish on the topic"
    if (rate := measured(times)) is None:
        return None, f"rate not measured: {counted(len(times), 'message')} in {graph.seconds:.3g} s"
    return rate, str(rate)


def _answered(graph: ObservedGraph, endpoint: ObservedEndpoint) -> tuple[MeasuredAnswers | None, str]:
    took = graph.took.get((endpoint.node, endpoint.topic))
    if took is None:
        return None, "no bound: what it takes to answer is seen with a gate inside, under `midstride up`"
    if (answers := measured_answers(took)) is None:
        return None, f"no bound: {counted(len(took), 'request')} answered in {graph.seconds:.3g} s"
    return answers, str(answers)


def _port_name(endpoint: ObservedEndpoint, all_: Iterable[ObservedEndpoint], used: set[str]) -> str:
    parts = [_NOT_IN_NAMES.sub("_", part) for part in endpoint.topic.strip("/").split("/")]
    twice = sum(each.topic == endpoint.topic for each in all_) > 1
    ending = ("_out" if endpoint.output else "_in") if twice else ""
    names = ["_".join(parts[-count:]) + ending for count in range(1, len(parts) + 1)]
    names += [f"{names[-1]}_{number}" for number in range(2, len(used) + 3)]
    return next(name for name in names if name not in used and name not in RESERVED and not name[0].isdigit())


def own_name(endpoint: ObservedEndpoint, remaps: Mapping[str, str]) -> str:
    """Return the program's name of the topic or service: one relative to the node or its namespace means the same."""
    topic, node = endpoint.topic, endpoint.node
    if topic in remaps:
        return remaps[topic]
    namespace = node.rpartition("/")[0] + "/"
    if topic.startswith(f"{node}/"):
        return f"~/{topic.removeprefix(f'{node}/')}"
    return topic.removeprefix(namespace) if topic.startswith(namespace) else topic


def component_text(ports: Iterable[ProposedPort], heard: set[str], rates: bool, own_topics: bool = True) -> list[str]:
    """The statements of a component with these ports.

    An input is assumed if its topic is in ``heard``, the topics with a publisher in the specification. With ``rates``,
    guarantees state the proposed bounds. What was probed decides further: outputs that depend on other inputs are in a
    functionality for them, and an input on which no output depends is not assumed.

    Servers and clients have functionalities apart: nothing shows which outputs need which server, and a gate that
    closed because a server has gone would make one loss two.
    """
    ports = list(ports)
    if not ports:
        return []
    inputs = [port for port in ports if not port.endpoint.output and not port.is_service]
    outputs = [port for port in ports if port.endpoint.output and not port.is_service]
    servers = [port for port in ports if port.endpoint.output and port.is_service]
    clients = [port for port in ports if not port.endpoint.output and port.is_service]

    lines: list[str] = []
    for port in [*inputs, *outputs, *servers, *clients]:
        if own_topics and port.other_name is not None:
            lines.append(f"# `{port.stated_topic}`, or `{port.other_name}`: see what the program calls it")
        if port.lazy and not own_topics:
            lines.append(f"# with a gate: `{port.declaration()}`, as it had gone when nothing subscribed to it")
        lines.append(port.declaration(of_program=own_topics))
    lines += _of_topics(inputs, outputs, heard, rates)
    lines += _functionality(SERVING, [], servers, heard, rates) if servers else ()
    lines += _functionality(CALLING, clients, [], heard, rates) if clients else ()
    return lines


def _of_topics(inputs: list[ProposedPort], outputs: list[ProposedPort], heard: set[str], rates: bool) -> Iterator[str]:
    """The functionalities from inputs to outputs."""
    groups: dict[frozenset[str], list[ProposedPort]] = {}
    for port in outputs:
        groups.setdefault(frozenset(each.name for each in inputs if _needs(port, each)), []).append(port)
    if len(groups) < 2:
        if inputs or outputs:
            yield from _functionality(FUNCTIONALITY, inputs, outputs, heard, rates)
        return
    used = frozenset[str]().union(*groups)
    for number, (needed, members) in enumerate(groups.items()):
        # What none of them depends on belongs to the first one.
        own = [port for port in inputs if port.name in needed or (number == 0 and port.name not in used)]
        yield from _functionality(f"make_{members[0].name}", own, members, heard, rates)


def _needs(output: ProposedPort, input_: ProposedPort) -> bool:
    found = input_.probed.get(output.name)
    return found is None or found.verdict in ("depends", "undecided")


def _functionality(
    name: str, inputs: Sequence[ProposedPort], outputs: Sequence[ProposedPort], heard: set[str], rates: bool
) -> Iterator[str]:
    yield f"functionality {name} {{"
    if inputs:
        yield "uses " + ", ".join(port.name for port in inputs)
    if outputs:
        yield "produces " + ", ".join(port.name for port in outputs)
    yield "mode normal {"
    for port in inputs:
        probed = [(each.name, port.probed[each.name]) for each in outputs if each.name in port.probed]
        evidence = "".join(f"; {output} {_in_words(finding)}" for output, finding in probed).removeprefix("; ")
        if outputs and not any(_needs(each, port) for each in outputs):
            yield f"# `{port.name}` is not assumed: {evidence}"
        elif port.endpoint.topic in heard:
            yield f"assume {port.name}" + (f"  # probed: {evidence}" if evidence else "")
        else:
            nothing = "serves what `{}` calls" if port.is_service else "publishes what `{}` receives"
            yield f"# no node here {nothing.format(port.name)}"
    for port in outputs:
        bound = port.rate.bound if rates and port.rate is not None else None
        contract = contract_text(port.endpoint.type, port.endpoint.qos, bound)
        if rates and port.answers is not None:
            verb = "accepts" if port.endpoint.kind == "action" else "responds"
            contract += f" {verb} within {_duration(port.answers.bound)}"
        yield f"guarantee {port.name} : {contract}" + (f"  # {port.note}" if port.note else "")
    yield from ("}", "mode degraded { }", "}")


def _duration(seconds: float) -> str:
    """A duration as the language has it."""
    return f"{seconds * 1e3:g} ms" if seconds < 1 else f"{seconds:g} s"


def _in_words(finding: Dependence) -> str:
    words = {
        "depends": "depends on it",
        "indirect": "depends on it",
        "independent": "does not depend on it",
        "undecided": "is not decided",
    }
    return f"{words[finding.verdict]} ({finding.because})"


def topic_lines(graph: ObservedGraph, topics: Iterable[str], rated: Iterable[ProposedPort]) -> list[str]:
    """The declarations of topics, services and ROS actions, each with what all of its publishers offer.

    The rate is the lowest bound of the ``rated`` ports, if these are all of its publishers.
    """
    bounds: dict[str, list[float]] = {}
    for port in rated:
        if port.rate is not None:
            bounds.setdefault(port.endpoint.topic, []).append(port.rate.bound)
    lines = []
    for topic in topics:
        endpoints = graph.on(topic)
        publishers = [each for each in endpoints if each.output]
        types = sorted({each.type for each in publishers or endpoints})
        profile = (
            _weakest([each.qos for each in publishers]) if publishers else _needed([each.qos for each in endpoints])
        )
        known = bounds.get(topic, [])
        rate = min(known) if known and len(known) == len(publishers) else None
        lines.append(f"{endpoints[0].kind} {topic} : {contract_text(types[0], profile, rate)}")
    return lines


def _weakest(profiles: list[QoS]) -> QoS:
    """The QoS that every one of these profiles offers."""
    deadlines, leases = [each.deadline for each in profiles], [each.lease for each in profiles]
    return QoS(
        reliability=None if all(each.is_reliable for each in profiles) else "best_effort",
        durability="transient_local" if all(each.is_transient_local for each in profiles) else None,
        deadline=None if None in deadlines else max(each for each in deadlines if each is not None),
        lease=None if None in leases else max(each for each in leases if each is not None),
        liveliness="manual_by_topic" if all(each.liveliness == "manual_by_topic" for each in profiles) else None,
    )


def _needed(profiles: list[QoS]) -> QoS:
    """The QoS that is enough for every one of these profiles."""
    deadlines = [each.deadline for each in profiles if each.deadline is not None]
    leases = [each.lease for each in profiles if each.lease is not None]
    return QoS(
        durability="transient_local" if any(each.is_transient_local for each in profiles) else None,
        deadline=min(deadlines, default=None),
        lease=min(leases, default=None),
        liveliness="manual_by_topic" if any(each.liveliness == "manual_by_topic" for each in profiles) else None,
    )


def free_name(base: str, used: Collection[str], ending: str = "") -> str:
    """``base``, or with the first number after ``ending`` that makes it a name that is not in ``used``."""
    return next(name for number in count(1) if (name := base if number == 1 else f"{base}{ending}{number}") not in used)
