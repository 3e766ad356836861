"""A component made from a description: ``python3 -m midstride.simulation.puppet '{"component": …}'``.

It runs any component of the model on any back end. The description is JSON::

    {"component": <the component's document, its name in it>,
     "modes": {"talk.normal": {"rate": 50, "sleep": 0.5, "pause": 0.5, "raise": "words", "at_call": 3,
                               "silent": true, "every": 5, "driven": "message", "sync": 0.05}},
     "refuse": {"speed": [13]}, "on_stop": {"write": "bye", "sleep": 1, "timeout": 2},
     "at_import": {"sleep": 1, "raise": "words", "exit": 3}, "keeps_state": true, "stateless": true,
     "latest": ["in"], "wrong_type": "out", "endless": true}

Everything but ``component`` is optional. A mode that guarantees a rate is called at the highest rate that it
guarantees; one that only assumes inputs, for every message; one that does neither, once. A call writes one message to
each output that its mode guarantees: the text of the message it answers, or else "instance mode n". ``sleep`` blocks
and ``pause`` awaits before the write; with ``at_call``, these and ``raise`` apply to that call only. With ``every``,
each fifth call writes, say, and no other. The exported state lists what was received, called and imported.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable
from typing import Any

from midstride.backends.common_messages import message_class
from midstride.codec.component_form import decode_component
from midstride.model import component as model
from midstride.model.contract import Predicate, satisfies
from midstride.node.author.component_class import Component
from midstride.node.author.declared_contracts import guarantee
from midstride.node.author.functionality import Functionality
from midstride.node.author.modes import approximate
from midstride.node.author.ports import Input, Output, any_of


class Puppet:
    """``description`` as a component; :meth:`start` runs it."""

    def __init__(self, description: dict[str, Any], type_of: Callable[[str], type] | None = None) -> None:
        """``type_of``: the class of a message type, by default that of the installed ROS or of the simulator."""
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

    def start(self) -> None:
        self.component.start()

    # -- declaring ---------------------------------------------------------------------------------

    def _ports(self) -> None:
        for name in self._declared.input_order:
            predicate = self._declared.inputs[name]
            where = dict(predicate.fields) or None
            missed = self._declared.tolerates.get(name)
            self._inputs[name] = self.component.create_input(
                name, self._type_of(predicate.type), predicate.rate, predicate.qos, where, missed
            )
        for name in self._declared.outputs:
            endpoint = self._declared.output_endpoint(name)
            type_, qos = endpoint if endpoint is not None else ("std_msgs/msg/String", None)
            self.outputs[name] = self.component.create_output(name, self._type_of(type_), qos)

    def _functionality(self, declared: model.FunctionalitySpec) -> None:
        functionality = self.component.create_functionality(
            declared.name,
            inputs=[self._inputs[name] for name in declared.inputs],
            outputs=[self.outputs[name] for name in declared.outputs],
            weight=declared.weight,
        )
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
        promises = {self.outputs[n]: guarantee(p.rate, dict(p.fields) or None) for n, p in mode.guarantees.items()}
        rates = [predicate.rate for predicate in mode.guarantees.values() if predicate.rate is not None]
        rate = behaviour.get("rate", max(rates, default=None))
        if behaviour.get("driven") == "message":
            rate = None
        function: Any = self._call(key, outputs, behaviour, ())
        sync = None
        if rate is None and inputs:
            named = list(dict.fromkeys(port for ports in assumed for port in ports))
            if "sync" in behaviour:
                sync = approximate(behaviour["sync"])
                function = self._call(key, outputs, behaviour, tuple(named))
            else:
                function = {port: self._call(key, outputs, behaviour, (port,)) for port in named}
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
        self, key: str, outputs: list[Output], behaviour: dict[str, Any], inputs: tuple[Input, ...]
    ) -> Callable[..., Any]:
        """The function of a mode: called with one message of each of ``inputs``."""

        def begin(messages: tuple[Any, ...]) -> tuple[str, dict[str, Any]]:
            """What to write, and what applies to this call."""
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
                    self._write(output, words)

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
        if isinstance(getattr(message, "data", None), str):
            message.data = words
        output.write(message)

    def _changed(self, name: str) -> Callable[[Any], None]:
        def on_change(value: Any) -> None:
            if value in self._description.get("refuse", {}).get(name, []):
                raise ValueError(f"{name} cannot be {value}")

        return on_change

    # -- callbacks -------------------------------------------------------------------------------------

    def _export(self) -> bytes:
        latest = {name: text_of(self._inputs[name].latest) for name in self._description.get("latest", [])}
        document = {"received": self._received, "calls": self._calls, "imported": self._imported, "latest": latest}
        return json.dumps(document).encode()

    def _import(self, state: bytes) -> None:
        self._imported = json.loads(state)

    def _stop(self, stop: dict[str, Any]) -> None:
        if "sleep" in stop:
            time.sleep(stop["sleep"])
        if "write" in stop:
            for output in self.outputs.values():
                self._write(output, stop["write"])


def text_of(message: Any) -> str:
    """The text of a message that has one, else its type."""
    data = getattr(message, "data", None)
    return data if isinstance(data, str) else type(message).__name__


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
