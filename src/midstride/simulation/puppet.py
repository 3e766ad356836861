"""A component made from a description: ``python3 -m midstride.simulation.puppet '{"component": …}'``.

It runs any component of the model on any back end. The description is JSON::

    {"component": <the component's document, its name in it>,
     "modes": {"talk.normal": {"rate": 50, "sleep": 0.5, "pause": 0.5, "raise": "words", "at_call": 3,
                               "silent": true, "every": 5, "driven": "message", "sync": 0.05}},
     "refuse": {"speed": [13]}, "on_stop": {"write": "bye", "sleep": 1, "timeout": 2},
     "at_import": {"sleep": 1, "raise": "words", "exit": 3}, "keeps_state": true, "stateless": true,
     "latest": ["in"], "wrong_type": "out", "endless": true, "goals": 0.3, "later": {"cancel": 4, "fetch": [0, 9]}}

Everything but ``component`` is optional. A mode that guarantees a rate is called at the highest rate that it
guarantees; one that only assumes inputs, for every message; one that assumes clients alone, at 5 Hz; any other, once.
A call writes one message to each output that its mode guarantees: the text of the message it answers, or else
"instance mode n". ``sleep`` blocks and ``pause`` awaits before the write; with ``at_call``, these and ``raise`` apply
to that call only. With ``every``, each fifth call writes, say, and no other. A call also sends a request by each client
that its mode assumes, or a goal where none is in progress. A server responds with "instance n", but not while its mode
is ``silent``; a goal takes ``goals`` seconds, and its result is such a text. The result of a goal is asked for at once;
with ``later``, so many calls later, as ``fetch`` lists them for successive goals, and each goal whose number ``cancel``
divides is cancelled at the first of them. The exported state has the instance, and lists what was received, called and
imported; by client, how many requests were sent, what was responded, and how many ended without a response; and by
server, how many were served.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Final

from midstride.backends.common_messages import message_class
from midstride.codec.component_form import decode_component
from midstride.model import component as model
from midstride.model.contract import Predicate, satisfies
from midstride.node.author.client_ports import ActionClientPort, ClientPort
from midstride.node.author.component_class import Component
from midstride.node.author.declared_contracts import guarantee
from midstride.node.author.functionality import Functionality
from midstride.node.author.modes import approximate
from midstride.node.author.ports import Input, Output, any_of
from midstride.node.author.server_ports import ServerPort

# How often a mode is called that assumes clients alone (Hz), and how long a goal takes (s).
ASKING: Final = 5.0
GOAL_SECONDS: Final = 0.3
# How often a server that is silent looks whether it still is (s).
SILENCE_LOOK: Final = 0.1


@dataclass
class _Accepted:
    """A goal of an action client. ``links``: its attachments when that was accepted."""

    handle: Any
    links: Any
    number: int
    fetched: Callable[[Any], object]
    calls: int = 0


class Puppet:
    """``description`` as a component; :meth:`start` runs it."""

    def __init__(
        self,
        description: dict[str, Any],
        type_of: Callable[[str], type] | None = None,
        imported: Callable[[str], object] = lambda exporter: None,
    ) -> None:
        """``type_of``: the class of a message type, by default that of the installed ROS or of the simulator.

        ``imported`` is called with the instance whose state has been imported.
        """
        self._description = description
        self._type_of = type_of or message_class
        self._declared: model.ComponentSpec = decode_component(description["component"])
        self._modes: dict[str, dict[str, Any]] = description.get("modes", {})
        self.component = Component(self._declared.name)
        self._inputs: dict[str, Input] = {}
        self.outputs: dict[str, Output] = {}
        self._received: dict[str, list[str]] = {}
        self._calls: dict[str, int] = {}
        self._imported: Any = None
        self._on_imported = imported
        # By server, how many requests or goals it has served; by client, those that it has sent.
        self._served: dict[str, int] = {}
        self._asked: dict[str, int] = {}
        self._responded: dict[str, list[str]] = {}
        self._unanswered: dict[str, int] = {}
        # By action client, the accepted goal whose result has not been asked for yet, and the calls since.
        self._accepted: dict[str, _Accepted] = {}
        self.functionalities: dict[str, Functionality] = {}
        self._ports()
        for functionality in self._declared:
            self._functionality(functionality)
        for name, parameter in self._declared.parameters.items():
            self.component.parameter(name, parameter.value, self._changed(name) if parameter.changeable else None)
        if not description.get("stateless"):
            self.component.on_export_state(self._export)
        if description.get("keeps_state"):
            self.component.on_import_state(self._import)
        if (stop := description.get("on_stop")) is not None:
            self.component.on_stop(lambda: self._stop(stop), timeout=stop.get("timeout", 2.0))

    @property
    def clients(self) -> tuple[ClientPort, ...]:
        return tuple(port for port in self._inputs.values() if isinstance(port, ClientPort))

    def start(self) -> None:
        self.component.start()

    # -- declaring ---------------------------------------------------------------------------------

    def _ports(self) -> None:
        for name in self._declared.input_order:
            self._inputs[name] = self._input(name, self._declared.inputs[name])
        for name in self._declared.outputs:
            self.outputs[name] = self._output(name)

    def _input(self, name: str, predicate: Predicate) -> Input:
        type_ = self._type_of(predicate.type)
        match predicate.kind:
            case "service":
                return self.component.create_client(name, type_, predicate.within)
            case "action":
                return self.component.create_action_client(name, type_, predicate.within)
        where, missed = dict(predicate.fields) or None, self._declared.tolerates.get(name)
        return self.component.create_input(name, type_, predicate.rate, predicate.qos, where, missed)

    def _output(self, name: str) -> Output:
        endpoint = self._declared.output_endpoint(name)
        type_, qos = endpoint if endpoint is not None else ("std_msgs/msg/String", None)
        kind, owner = self._declared.kind_of(name), self._declared.owner(name)
        if kind == "topic":
            return self.component.create_output(name, self._type_of(type_), qos)
        offered = [mode.guarantee(name) for mode in owner.modes]
        bounds = [each.within for each in offered if isinstance(each, Predicate) and each.within is not None]
        within = max(bounds, default=None)
        if kind == "service":
            serve = self._server(name, owner.name)
            return self.component.create_server(name, self._type_of(type_), serve, within)
        return self.component.create_action_server(name, self._type_of(type_), self._executor(name), within)

    def _server(self, name: str, functionality: str) -> Callable[[Any, Any], Any]:
        def behaviour() -> dict[str, Any]:
            return self._modes.get(f"{functionality}.{self.functionalities[functionality].mode}", {})

        async def later(response: Any) -> Any:
            while behaviour().get("silent"):
                await self.component.clock.sleep(SILENCE_LOOK)
            return response

        def serve(request: Any, response: Any) -> Any:
            count = self._served[name] = self._served.get(name, 0) + 1
            if "raise" in behaviour():
                raise RuntimeError(behaviour()["raise"])
            set_text(response, f"{self.component.instance} {count}")
            return later(response) if behaviour().get("silent") else response

        return serve

    def _executor(self, name: str) -> Callable[[Any], Any]:
        async def execute(goal: Any) -> Any:
            count = self._served[name] = self._served.get(name, 0) + 1
            await self.component.clock.sleep(self._description.get("goals", GOAL_SECONDS))
            if goal.is_cancel_requested:
                goal.canceled()
            else:
                goal.succeed()
            result = self.outputs[name].type.Result()  # type: ignore[attr-defined]
            set_text(result, f"{self.component.instance} {count}")
            return result

        return execute

    def _functionality(self, declared: model.FunctionalitySpec) -> None:
        functionality = self.component.create_functionality(
            declared.name,
            inputs=[self._inputs[name] for name in declared.inputs],
            outputs=[self.outputs[name] for name in declared.outputs],
            weight=declared.weight,
        )
        self.functionalities[declared.name] = functionality
        last = declared.last_mode
        for index, mode in enumerate(declared.modes):
            self._mode(functionality, declared, mode, "first" if index == 0 else "last" if index == last else "between")

    def _mode(
        self, functionality: Functionality, declared: model.FunctionalitySpec, mode: model.Mode, place: str
    ) -> None:
        key = f"{declared.name}.{mode.name}"
        behaviour = self._modes.get(key, {})
        assumed = [ports for each in mode.assumptions if (ports := self._assumed(declared, each))]
        inputs = [any_of(*ports) if len(ports) > 1 else ports[0] for ports in assumed]
        outputs = [self.outputs[name] for name in declared.outputs if name in mode.guarantees]
        topical = {n: p for n, p in mode.guarantees.items() if p.kind == "topic"}
        promises = {self.outputs[n]: guarantee(p.rate, dict(p.fields) or None) for n, p in topical.items()}
        clients = [port for port in inputs_of(assumed) if isinstance(port, ClientPort)]
        driving = [port for port in inputs_of(assumed) if not isinstance(port, ClientPort)]
        rates = [predicate.rate for predicate in mode.guarantees.values() if predicate.rate is not None]
        rate = behaviour.get("rate", max(rates, default=None))
        if behaviour.get("driven") == "message":
            rate = None
        if rate is None and clients and not driving:
            rate = ASKING
        function: Any = self._call(key, outputs, behaviour, (), clients)
        sync = None
        if rate is None and driving:
            if "sync" in behaviour:
                sync = approximate(behaviour["sync"])
                function = self._call(key, outputs, behaviour, tuple(driving), clients)
            else:
                function = {port: self._call(key, outputs, behaviour, (port,), clients) for port in driving}
        arguments: dict[str, Any] = {"rate": rate, "outputs": outputs, "guarantees": promises}
        if place == "first":
            functionality.set_normal_mode(function, inputs=inputs, sync=sync, name=mode.name, **arguments)
        elif place == "between":
            functionality.set_mode(mode.name, function, inputs=inputs, sync=sync, **arguments)
        else:
            functionality.set_degraded_mode(function, name=mode.name, **arguments)

    def _assumed(self, declared: model.FunctionalitySpec, assumption: model.Assumption) -> list[Input]:
        """The inputs that can meet the assumption; none where only the environment can."""
        if isinstance(assumption, Predicate):
            names = [name for name in declared.inputs if satisfies(self._declared.inputs[name], assumption)]
        else:
            names = list(assumption.inputs)
        return [self._inputs[name] for name in names]

    # -- behaving ----------------------------------------------------------------------------------

    def _call(
        self,
        key: str,
        outputs: list[Output],
        behaviour: dict[str, Any],
        inputs: tuple[Input, ...],
        clients: list[ClientPort],
    ) -> Callable[..., Any]:
        """The function of a mode: called with one message of each of ``inputs``; it also asks by ``clients``."""

        def begin(messages: tuple[Any, ...]) -> tuple[str, dict[str, Any]]:
            """Decide what to write, and what applies to this call."""
            calls = self._calls[key] = self._calls.get(key, 0) + 1
            texts = [text_of(message) for message in messages]
            for port, text in zip(inputs, texts, strict=True):
                self._received.setdefault(port.name, []).append(text)
            words = " ".join(texts) if texts else f"{self.component.instance} {key.rpartition('.')[2]} {calls}"
            return words, behaviour if behaviour.get("at_call", calls) == calls else {}

        def finish(words: str, applies: dict[str, Any]) -> None:
            if "raise" in applies:
                raise RuntimeError(applies["raise"])
            if not behaviour.get("silent") and self._calls[key] % behaviour.get("every", 1) == 0:
                for output in outputs:
                    if not isinstance(output, ServerPort):
                        self._write(output, words)
            for client in clients:
                self._ask(client)

        def blocking(*messages: Any) -> None:
            words, applies = begin(messages)
            if "sleep" in applies:
                time.sleep(applies["sleep"])
            finish(words, applies)

        async def awaiting(*messages: Any) -> None:
            words, applies = begin(messages)
            if "pause" in applies:
                await self.component.clock.sleep(applies["pause"])
            finish(words, applies)

        return awaiting if "pause" in behaviour else blocking

    def _write(self, output: Output, words: str) -> None:
        if self._description.get("wrong_type") == output.name:
            output.write(object())
            return
        message = output.type()
        set_text(message, words)
        output.write(message)

    def _ask(self, client: ClientPort) -> None:
        """Send a request, or a goal where none is in progress."""
        name = client.name
        asked, ended = self._asked.get(name, 0), len(self._responded.get(name, ())) + self._unanswered.get(name, 0)
        if not client.attached or (isinstance(client, ActionClientPort) and asked > ended):
            self._follow(client)
            return
        self._asked[name] = asked + 1

        def noted(future: Any, words: Callable[[Any], str]) -> None:
            if future.exception() is not None:
                self._unanswered[name] = self._unanswered.get(name, 0) + 1
            else:
                self._responded.setdefault(name, []).append(words(future.result()))

        def given(future: Any) -> None:
            if future.exception() is not None or not future.result().accepted:
                noted(future, lambda _: "rejected")
                return
            self._accepted[name] = _Accepted(future.result(), client.links, asked + 1, fetched)
            if "later" not in self._description:
                self._fetch(name)

        def fetched(future: Any) -> None:
            noted(future, lambda result: f"status {result.status}")

        type_: Any = client.type
        if isinstance(client, ActionClientPort):
            client.send_goal_async(type_.Goal()).add_done_callback(given)
        else:
            client.call_async(type_.Request()).add_done_callback(lambda future: noted(future, text_of))

    def _follow(self, client: ClientPort) -> None:
        """At a call while a goal of ``client`` is in progress: cancel it, or ask for its result, if it is time."""
        if (goal := self._accepted.get(client.name)) is None:
            return
        if goal.links != client.links:  # it was detached meanwhile
            del self._accepted[client.name]
            self._unanswered[client.name] = self._unanswered.get(client.name, 0) + 1
            return
        later: dict[str, Any] = self._description["later"]
        if goal.calls == 0 and goal.number % later["cancel"] == 0:
            goal.handle.cancel_goal_async()
        goal.calls += 1
        if goal.calls > later["fetch"][goal.number % len(later["fetch"])]:
            self._fetch(client.name)

    def _fetch(self, name: str) -> None:
        goal = self._accepted.pop(name)
        goal.handle.get_result_async().add_done_callback(goal.fetched)

    def _changed(self, name: str) -> Callable[[Any], None]:
        def on_change(value: Any) -> None:
            if value in self._description.get("refuse", {}).get(name, []):
                raise ValueError(f"{name} cannot be {value}")

        return on_change

    # -- callbacks -------------------------------------------------------------------------------------

    def _export(self) -> bytes:
        latest = {name: text_of(self._inputs[name].latest) for name in self._description.get("latest", [])}
        document = {
            "exporter": self.component.instance,
            "received": self._received,
            "calls": self._calls,
            "imported": self._imported,
            "latest": latest,
            "asked": self._asked,
            "responded": self._responded,
            "unanswered": self._unanswered,
            "served": self._served,
        }
        return json.dumps(document).encode()

    def _import(self, state: bytes) -> None:
        self._imported = json.loads(state)
        self._on_imported(self._imported["exporter"])

    def _stop(self, stop: dict[str, Any]) -> None:
        if "sleep" in stop:
            time.sleep(stop["sleep"])
        if "write" in stop:
            for output in self.outputs.values():
                if not isinstance(output, ServerPort):
                    self._write(output, stop["write"])


# The fields that a text is in, if any: of messages, and of responses.
_TEXT: Final = ("data", "message")


def inputs_of(assumptions: list[list[Input]]) -> list[Input]:
    """The inputs of the assumptions, each once."""
    return list(dict.fromkeys(port for ports in assumptions for port in ports))


def text_of(message: Any) -> str:
    """The text of a message that has one, else its type."""
    texts = (getattr(message, field, None) for field in _TEXT)
    return next((text for text in texts if isinstance(text, str)), type(message).__name__)


def set_text(message: Any, text: str) -> None:
    """Set the field of ``message`` that has a text, if one has."""
    for field in _TEXT:
        if isinstance(getattr(message, field, None), str):
            setattr(message, field, text)
            return


def main(arguments: list[str]) -> None:
    description = json.loads(arguments[0])
    at_import = description.get("at_import", {})
    if "sleep" in at_import:
        time.sleep(at_import["sleep"])
    if "raise" in at_import:
        raise RuntimeError(at_import["raise"])
    if "exit" in at_import:
        sys.exit(at_import["exit"])
    while description.get("endless"):
        time.sleep(0.1)
    Puppet(description).start()


if __name__ == "__main__":
    main(sys.argv[1:])
