"""The node author's API: a component with its ports and functionalities.

The paper's section 5.2. A component is declared, then started; nothing is connected until the
manager attaches it, and nothing outside the object is touched before ``start()``.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Iterable, Sequence
from typing import Any, TypeVar

from midstride.errors import NodeError
from midstride.model import component as model
from midstride.model.component import ParameterValue
from midstride.model.contract import QoS
from midstride.node.agent import Agent
from midstride.node.clock import ComponentClock
from midstride.node.contracts import (
    Where,
    check_name,
    check_qos,
    check_rate,
    check_seconds,
    check_type,
    check_weight,
    field_constraints,
    predicate,
)
from midstride.node.declaration import declare
from midstride.node.declared_parts import DeclaredParts
from midstride.node.functionality import Functionality
from midstride.node.modes import listed
from midstride.node.parameters import Parameter, check_parameter
from midstride.node.ports import Input, Output
from midstride.node.process_context import find, host_factory
from midstride.node.standalone import remappings

F = TypeVar("F", bound=Callable[..., Any])


class Component:
    """A node of the system: declare ports and functionalities, then ``start()`` (semantics.md section 2).

    ``name`` is the default; the manager may give the instance another one (``instance``). ``clock`` is its ROS clock,
    ``logger`` its ROS logger. Everything that declares raises NodeError where it is used wrongly, or after ``start()``:
    the message says what to write instead, and nothing has been declared.
    """

    def __init__(self, name: str) -> None:
        self.name = check_name(name, "Component()")
        self.instance = name
        self.clock = ComponentClock()
        self._parts = DeclaredParts()
        self._started = False

    @property
    def logger(self) -> Any:
        host = self.clock.host
        return logging.getLogger(f"midstride.{self.name}") if host is None else host.logger

    # -- declaring ---------------------------------------------------------------------------------

    def create_input(
        self,
        name: str,
        type: type,
        rate: float | None = None,
        qos: QoS | int | None = None,
        where: Where | None = None,
    ) -> Input:
        """An input port, with what it assumes of the topic it will be attached to (semantics.md section 1).

        ``type`` is the message class; ``rate`` the least rate in Hz, None where any will do. ``qos`` is what the
        subscription requests: a QoS, or a depth alone; what it does not state is ROS's default. ``where`` constrains
        fields: ``{"width": at_least(640), "encoding": {"rgb8", "bgr8"}}``. Raises NodeError.
        """
        where_ = f"input {self._new_port(name)}"
        message_type = check_type(type, where_)
        fields = field_constraints(where, message_type, where_)
        assumption = predicate(message_type, check_rate(rate, where_), check_qos(qos, where_), fields)
        self._parts.inputs[name] = Input(name, message_type, assumption)
        return self._parts.inputs[name]

    def create_output(self, name: str, type: type, qos: QoS | int | None = None) -> Output:
        """An output port; attached to no topic until the manager does so.

        What it guarantees is up to the modes of the one functionality it belongs to; ``type`` and ``qos``, as for an
        input, are the same in all of them (semantics.md section 2, M3). Raises NodeError.
        """
        where = f"output {self._new_port(name)}"
        self._parts.outputs[name] = Output(name, check_type(type, where), check_qos(qos, where))
        return self._parts.outputs[name]

    def create_functionality(
        self, name: str, inputs: Sequence[Input] = (), outputs: Sequence[Output] = (), weight: float = 1
    ) -> Functionality:
        """What the component does with ``inputs`` for ``outputs``: declare its modes on what this returns.

        An input may serve several functionalities, an output has one. ``weight``, greater than 0, says how much its
        loss matters when a plan is made: the unit of disruption is this times seconds (semantics.md section 6).
        Raises NodeError.
        """
        self._declaring(f"functionality {name}")
        where = f"functionality {check_name(name, 'create_functionality()')}"
        if name in self._parts.functionalities:
            raise NodeError(f"{where} exists already; give this one another name")
        check_weight(weight, where)
        own_inputs = self._own(where, inputs, self._parts.inputs.values(), Input, "inputs")
        own_outputs = self._own(where, outputs, self._parts.outputs.values(), Output, "outputs")
        for port in own_outputs:
            for other in self._parts.functionalities.values():
                if port in other.outputs:
                    raise NodeError(
                        f"{where}: output {port.name} belongs to functionality {other.name} already; an output has one "
                        "owner: create another output, or give both jobs to one functionality"
                    )
        self._parts.functionalities[name] = Functionality(name, own_inputs, own_outputs, float(weight), self._declaring)
        return self._parts.functionalities[name]

    def parameter(
        self, name: str, default: ParameterValue, on_change: Callable[[Any], None] | None = None
    ) -> Parameter:
        """A ROS parameter. Its ``value`` is the one in force; ``on_change(value)`` makes it changeable in place.

        ``on_change`` is called between two calls of the modes; what it raises refuses the change. Without it, another
        value means another instance (semantics.md section 6). Values are booleans, numbers, words, or lists of one of
        these, of the type that ``default`` has. Before ``start()`` the value is the manager's where the manager gave
        one, else the default. Raises NodeError.
        """
        self._declaring(f"parameter {name}")
        check_parameter(name, default)
        if name in self._parts.parameters:
            raise NodeError(f"parameter {name} exists already")
        parameter = Parameter(name, default, on_change)
        given = find().parameters
        if name in given:
            parameter.begin_with(given[name])
        self._parts.parameters[name] = parameter
        return parameter

    def on_setup(self, fn: F) -> F:
        """``fn(node)`` is called with the ROS node before registration, where user code runs: for transforms, services.

        ``node`` is rclpy's node on ROS 2, the module rospy on ROS 1 (there a process is one node), and None in the
        simulator. What is no port is live from then on (semantics.md section 7). What ``fn`` raises ends the start.
        """
        self._parts.hooks.setup = self._hook("on_setup", fn)
        return fn

    def on_export_state(self, fn: F) -> F:
        """``fn() -> bytes``: what a replacement of this component should know. Called just before the hand-over.

        What it raises fails that step (semantics.md section 7, State).
        """
        self._parts.hooks.export_state = self._hook("on_export_state", fn)
        return fn

    def on_import_state(self, fn: F) -> F:
        """``fn(state: bytes)``: take up what the replaced component knew. What it raises fails that step."""
        self._parts.hooks.import_state = self._hook("on_import_state", fn)
        return fn

    def on_stop(self, fn: F, timeout: float = 2.0) -> F:
        """``fn()`` is called after the last call of any mode, while outputs are still open: a last zero velocity.

        It may be async. The component ends after ``timeout`` seconds even if it has not returned; what it raises is
        logged. Raises NodeError.
        """
        self._parts.hooks.stop = self._hook("on_stop", fn)
        self._parts.hooks.stop_timeout = check_seconds(timeout, "on_stop(timeout=)")
        return fn

    # -- running -----------------------------------------------------------------------------------

    def declaration(self) -> model.ComponentSpec:
        """What the component is, in the model's terms. Raises NodeError where it is incomplete."""
        return declare(
            self.name,
            list(self._parts.inputs.values()),
            list(self._parts.outputs.values()),
            list(self._parts.functionalities.values()),
            list(self._parts.parameters.values()),
        )

    def start(self) -> None:
        """Run until stopped: by the manager, SIGTERM or SIGINT. Signal handlers are set here and nowhere else.

        Started by the manager, it announces itself and waits, degraded and unattached, for orders;
        so it does when started by hand. ``--standalone out:=/chatter`` on the command line attaches
        it and runs its best modes, with nobody managing it; other arguments are left alone.

        Raises NodeError where the declaration is incomplete or breaks a rule of semantics.md section 2, where no ROS
        can be imported, or where the node's name is taken; BackendError where the platform cannot be joined.
        """
        self._declaring("start()")
        declaration = self.declaration()
        surroundings = find()
        standalone = remappings(surroundings.arguments, declaration)
        factory = host_factory(surroundings)
        self._started = True
        host = factory(surroundings.instance or self.name, surroundings.namespace)
        self.instance, self.clock.host = host.instance, host
        pid = os.getpid() if surroundings.pid is None else surroundings.pid
        agent = Agent(self._parts, declaration, host, surroundings.token, pid, standalone)
        host.run(agent.main)

    # -- checking ----------------------------------------------------------------------------------

    def _declaring(self, what: str) -> None:
        if self._started:
            raise NodeError(f"{what}: component {self.name} has been started; declare everything before start()")

    def _new_port(self, name: object) -> str:
        port = check_name(name, "a port's name")
        self._declaring(f"port {port}")
        if port in self._parts.inputs or port in self._parts.outputs:
            raise NodeError(f"port {port} exists already; give this one another name")
        return port

    def _own(self, where: str, ports: object, own: Iterable[Any], kind: type[Any], what: str) -> tuple[Any, ...]:
        found = tuple(listed(ports, where, what))
        known = list(own)
        for port in found:
            if not isinstance(port, kind) or port not in known:
                made = "create_input" if kind is Input else "create_output"
                raise NodeError(
                    f"{where}: {what}= has {port!r}, which is not of this component; write what {made} gave"
                )
        if len(set(found)) < len(found):
            raise NodeError(f"{where}: {what}= names a port twice")
        return found

    def _hook(self, name: str, fn: F) -> F:
        self._declaring(f"{name}()")
        if not callable(fn):
            raise NodeError(f"{name}({fn!r}): write a function")
        return fn

    def __repr__(self) -> str:
        return f"<component {self.name}>"
