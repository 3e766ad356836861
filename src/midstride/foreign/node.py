"""A node without Midstride's API, as its agent knows it: its record, its gates and its state."""

from __future__ import annotations

import asyncio
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import replace as replaced
from pathlib import Path
from typing import Any, Final

from immutables import Map
from msgspec.structs import replace

from midstride.errors import BackendError, CommandRefused
from midstride.foreign.gates import Gates
from midstride.foreign.page import SEND_GOAL
from midstride.foreign.page_layout import PagePort
from midstride.foreign.record import ForeignRecord
from midstride.foreign.reported_states import ReportedStates
from midstride.model.component import ComponentSpec, same_value
from midstride.node.author.message_times import window_of
from midstride.node.control.response_watch import ResponseWatch
from midstride.wire.state import (
    NOT_WELCOMED,
    THIS_HOST,
    ComponentState,
    Endpoint,
    FunctionalityState,
    GateState,
    LinkState,
    Measured,
    MeasuredResponses,
    UndeclaredTopic,
)

TICK: Final = 0.005
# How often an agent looks whether a baton has moved, or a lifecycle node has left its state (s).
WATCH: Final = 0.05
# The services by which any program sets parameters of a node.
SETTING: Final = ("set_parameters", "set_parameters_atomically")
# The shortest interval between two counts from which a rate is computed (s).
SAMPLE: Final = 0.2


class ForeignNode:
    """The node of ``record``, whose file is in ``folder``. ``gates`` is None where nothing holds its outputs back.

    ``requests``: those gates, or the part in the page of a node of which the library hands over the requests alone.

    ``others``: what the components with an agent inside report.
    """

    def __init__(
        self,
        record: ForeignRecord,
        folder: Path,
        gates: Gates | None,
        others: ReportedStates,
        requests: Gates | None = None,
    ) -> None:
        self.record = record
        self.unwritten: str | None = None  # why its file has an earlier one
        self.gates = gates
        self.requests = requests or gates
        self.component = record.declaration.declared()
        # As of the last time that the node was asked: its parameters, and those set while it ran with what they were.
        self.parameters: dict[str, Any] = {}
        self.declared: dict[str, Any] = {}
        self.unread_parameters = False  # it has not answered when it was last asked for them
        # By parameter, when a request has set it last (Unix time, s), and the value; whether these are all requests.
        self.settings: dict[str, tuple[float, Any]] = {}
        self._all_settings = False
        self._noted = 0  # how many of them have been looked at
        self._unreadable = 0  # how many of those cannot be read
        # Those of a request, of which these are the bytes.
        self.settings_in: Callable[[bytes], Mapping[str, Any]] | None = None
        self.differences: list[str] = []  # in which way the graph shows another node than the declared one
        self.undeclared: list[UndeclaredTopic] = []  # its topics that are no ports
        self.serves: list[Endpoint] = []  # its services and ROS actions that others may rely on
        self.lifecycle_callers: list[str] = []  # the nodes that call its lifecycle services
        self.managed: list[str] = []  # why it must not end, as a lifecycle manager would take all of its nodes down
        self.starting: list[str] = []  # the instances of which it is not known yet whether they manage it
        self.calls: list[str] = []  # the services and ROS actions that it is a client of
        self.keeps_name: Callable[[], bool] = lambda: False  # a successor with such a gate gets its name
        self.keeps_state = False  # it offers the service that exports its state
        self.looked = True  # these are known, or nothing can know them
        self.shown = False  # the graph has shown something of it
        # Of a lifecycle node without a gate inside: for how long its outputs have been silent in all (s).
        self.inactive: Callable[[], float] | None = None
        self.unfinished: str | None = None  # what it has left unanswered as it ends, and which goals
        self._unanswered: float | None = None  # since when it has not answered (monotonic s)
        self.others = others
        self._folder = folder
        self._since = dict.fromkeys(record.modes, time.monotonic())
        self._because = dict.fromkeys(record.modes, "started")
        self._counts: dict[str, deque[tuple[float, int]]] = {}
        # By server or client with a bound: what is seen of the server, and where that was found.
        self._bounds: dict[str, tuple[ResponseWatch, PagePort | None]] = {}

    async def comes_true(self, condition: Callable[[], bool], timeout: float, every: float = TICK) -> bool:
        """Wait until ``condition`` holds, no longer than ``timeout`` (s); whether it does. ``every``: in s."""
        loop = asyncio.get_running_loop()
        deadline = loop.time() + timeout
        while not condition():
            if loop.time() >= deadline:
                return False
            await asyncio.sleep(every)
        return True

    def answered(self, answers: bool) -> None:
        """Note whether the node answered when it was last asked."""
        if answers:
            self._unanswered = None
        elif self._unanswered is None:
            self._unanswered = time.monotonic()

    def change_record(self, **changes: Any) -> None:
        """Change these fields of the record, also in its file; if the disk refuses, ``unwritten`` says why."""
        self.record = replace(self.record, **changes)
        self.write_record()

    def write_record(self) -> None:
        try:
            self.record.write(self._folder)
        except BackendError as error:  # its gates must close all the same
            self.unwritten = str(error)
        else:
            self.unwritten = None

    def adjust(self, port: str) -> None:
        """Open or close the gate of an output, as its attachment and the mode of its functionality say."""
        if self.gates is None or not self.component.has_output(port) or self.component.is_service(port):
            return
        owner = self.component.owner(port)
        works = self.record.modes[owner.name] != owner.modes[-1].name
        self.gates.set_gate(port, works and self.record.links.get(port) == "open")

    def set_links(self, links: Mapping[str, GateState | None]) -> None:
        """Open, close or take away (None) attachments, by port."""
        changed = {**self.record.links, **links}
        self.change_record(links={port: gate for port, gate in changed.items() if gate is not None})
        for port in links:
            self.adjust(port)

    def require_attached(self, port: str, topic: str) -> None:
        """Raises CommandRefused."""
        if port not in self.record.links or self.record.topics[port] != topic:
            raise CommandRefused(f"{port} is not attached to {topic}")

    def require_modes(self, modes: Mapping[str, str]) -> None:
        """Raises CommandRefused if a functionality or one of its modes is not declared."""
        for name, mode in modes.items():
            found = self.component.functionalities.get(name)
            if found is None or mode not in [each.name for each in found.modes]:
                raise CommandRefused(f"{self.record.instance} has no functionality {name} with a mode {mode!r}")

    def seconds_in_mode(self, functionality: str) -> float:
        return time.monotonic() - self._since[functionality]

    def due(self, seconds: float) -> float | None:
        """The part of the last ``seconds`` that counts on the node's ROS clock; None where that is not known."""
        return self.others.due(seconds) if self.record.simulated_time else seconds

    def enter_modes(self, modes: Mapping[str, str], because: str) -> None:
        fallen = {name: why for name, why in self.record.fallen.items() if name not in modes}
        self.change_record(modes={**self.record.modes, **modes}, fallen=fallen)
        for name in modes:
            self._since[name], self._because[name] = time.monotonic(), because
            for port in self.component.functionalities[name].outputs:
                self.adjust(port)

    def state(self) -> ComponentState:
        record = self.record
        set_at = self._set_at()
        unknown = [name for name in self.declared if name not in record.requested and name not in set_at]
        known = self._all_settings  # what no request has asked for is the node's own
        functionalities = {
            name: FunctionalityState(
                mode=mode,
                since=self.seconds_in_mode(name),
                because=record.fallen.get(name, self._because[name]),
                reflex=name in record.fallen,
            )
            for name, mode in record.modes.items()
        }
        return ComponentState(
            instance=record.instance,
            uuid=record.uuid,
            pid=record.pid,
            revision=record.revision,
            functionalities=functionalities,
            ports={port: {record.topics[port]: self._link(port)} for port in record.links},
            parameters=self.parameters,
            declared=self.declared,
            stopping=0.0,
            waiting=None if record.welcomed else NOT_WELCOMED,
            differences=self.differences,
            undeclared=self.undeclared,
            serves=self.serves,
            lifecycle_callers=self.lifecycle_callers,
            managed=self.managed,
            starting=self.starting,
            calls=self.calls,
            looked=self.looked,
            shown=self.shown,
            keeps_state=self.keeps_state,
            unanswered=None if self._unanswered is None else time.monotonic() - self._unanswered,
            node=record.node,
            keeps_name=self.keeps_name(),
            answers=self.answers and (self.gates is None or self.gates.writes_unstated),
            imported=1,
            host=THIS_HOST,
            unread_parameters=self.unread_parameters,
            unknown_origin=unknown,
            own_values=[
                name for name in unknown if known and name not in self.settings and name not in record.taken_over
            ],
            set_at=set_at,
            simulated_time=record.simulated_time,
            clock_speed=self.others.speed if record.simulated_time else 1.0,
            unfinished=self.unfinished,
            goals=None if self.requests is None else self.requests.page.goal_counts(self.requests.index),
        )

    def note_settings(self) -> None:
        """Note what requests have asked the node to set since its start, where the library notes it."""
        if self.requests is None or self.settings_in is None:
            return
        services = [f"{self.record.node}/{name}" for name in SETTING]
        taken = [self.requests.taken(service) for service in services]
        try:
            noted = [each for each in self.requests.settings() if each.service in services]
        except BackendError:  # what is not known counts as such
            noted = []
        for at, _, request in noted[self._noted :]:  # each is read once: there may be thousands
            try:
                self.settings |= {name: (at, value) for name, value in self.settings_in(request).items()}
            except BackendError:  # what it has set is not known, either
                self._unreadable += 1
        self._noted = max(self._noted, len(noted))
        self._all_settings = None not in taken and sum(filter(None, taken)) == len(noted) - self._unreadable

    def _set_at(self) -> dict[str, float]:
        """By parameter that still has the value of a request: when that was made (Unix time, s)."""
        found = ((name, self.settings[name]) for name in self.declared if name in self.settings)
        return {name: at for name, (at, value) in found if same_value(value, self.parameters.get(name))}

    @property
    def answers(self) -> bool:
        """Return whether it answers requests to the services that the instances of its role share."""
        return self.requests is None or self.requests.answers

    def gate_states(self) -> dict[str, GateState | None]:
        """By attached port. An output is open where the node also has the baton; inputs have none."""
        return {port: self._gate_state(port) for port in self.record.links}

    def _gate_state(self, port: str) -> GateState | None:
        if not self.component.has_output(port):
            return None
        if self.component.is_service(port):
            return "open" if self.record.links[port] == "open" and self.answers else "closed"
        return "open" if self.record.links[port] == "open" and (not self.gates or self.gates.has_it(port)) else "closed"

    def responses(self, port: str) -> MeasuredResponses | None:
        """Return what is seen of the server at an attached port; None where no bound is stated, or nothing is seen.

        In simulated time, a bound is one of the time on ``/clock``; nothing is seen where that is not known.
        """
        record, component, gates = self.record, self.component, self.requests
        within = component.stated_bound(port, record.modes) if port in record.links else None
        if within is None or gates is None:
            self._bounds.pop(port, None)
            return None
        watch, known = self._bounds.get(port, (None, None))
        if watch is None or watch.within != within:
            watch = ResponseWatch(within, component.tolerates.get(port))
        page, service = gates.page, record.topics[port]
        if component.kind_of(port) == "action":
            service += SEND_GOAL
        server = page.server(service, gates.index if component.has_output(port) else None, known)
        self._bounds[port] = watch, server
        if server is None:
            watch.look(None, (0, 0), 0, 0)
            return None if component.has_output(port) else self.others.responses(record.topics[port], watch)
        index = server.node - 1
        process = int(server.node), int(page.layout.nodes[index].pid)
        speed = min(1.0, self.others.speed) if record.simulated_time else 1.0
        watch.look(server, process, page.beat(index), time.monotonic_ns(), self.due, speed)
        return watch.responses if speed else None

    def _link(self, port: str) -> LinkState:
        gates = self.gates
        if self.component.is_service(port):
            return LinkState(gate=self._gate_state(port), count=0, responses=self.responses(port))
        if gates is None:
            silent = None if self.inactive is None or not self.component.has_output(port) else self.inactive()
            return LinkState(gate=self._gate_state(port), count=0, inactive=silent)
        entry = gates.entry(port)
        return LinkState(
            gate=self._gate_state(port),
            count=entry.passed,
            gated=entry.gated,
            measured=self._measured(port, gates),
            fenced=self.component.has_output(port) and gates.fenced(port),
            by_input=gates.answers_inputs(port) if self.component.has_output(port) else None,
            kept_out=self.component.has_output(port) and gates.is_kept_out(port),
        )

    def past_the_gate(self) -> list[str]:
        """The outputs that could not be kept out of intra-process communication, in words."""
        return [
            f"output {port} uses intra-process communication: subscriptions in the process of {self.record.node} get "
            f"what it publishes on {self.record.topics[port]} past the gate; have the program create the node with "
            "`use_intra_process_comms(false)`, or declare `gate none`"
            for port in ([] if self.gates is None else self.gates.past_the_gate())
        ]

    def _measured(self, port: str, gates: Gates) -> Measured | None:
        """From the counts at each report, so less exact than a component's own figures; there is no jitter.

        None in simulated time.
        """
        if self.record.simulated_time:
            return None
        now = time.monotonic()
        window = window_of(self.component.stated_rate(port, self.record.modes))
        seen, total = self._counts.setdefault(port, deque()), gates.total(port)
        if not seen or now - seen[-1][0] >= SAMPLE:
            seen.append((now, total))
        while len(seen) > 2 and seen[1][0] <= now - window:
            seen.popleft()
        covered, age = now - seen[0][0], gates.age(port)
        rate = None if age is None or covered < SAMPLE else (total - seen[0][1]) / covered
        return Measured(window=window, covered=min(window, covered), rate=rate, age=age)


def of_services(component: ComponentSpec) -> ComponentSpec:
    """``component`` without ports: of its node, the library hands over the requests alone."""
    return without_ports(component, list(component.ports()))


def of_topics(component: ComponentSpec) -> ComponentSpec:
    """``component`` with the ports that have a gate and messages: its publishers and subscriptions."""
    return without_ports(component, component.service_ports())


def without_ports(component: ComponentSpec, missing: list[str]) -> ComponentSpec:
    """``component`` as a node is that lacks the endpoints of these ports."""
    if not missing:
        return component
    kept = {
        name: replaced(
            found,
            inputs=tuple(port for port in found.inputs if port not in missing),
            outputs=tuple(port for port in found.outputs if port not in missing),
            modes=tuple(
                replaced(
                    mode,
                    assumptions=(),
                    guarantees=Map({port: g for port, g in mode.guarantees.items() if port not in missing}),
                )
                for mode in found.modes
            ),
        )
        for name, found in component.functionalities.items()
    }
    return replaced(
        component,
        inputs=Map({name: p for name, p in component.inputs.items() if name not in missing}),
        input_order=tuple(name for name in component.input_order if name not in missing),
        outputs=tuple(name for name in component.outputs if name not in missing),
        functionalities=Map(kept),
    )
