"""The node author's API: a component with its ports and functionalities.

See section 5.2 of the paper. A component is declared, then started. It is connected to no topic until the manager
attaches it, and nothing outside the object is touched before ``start()``.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

from midstride.errors import NodeError
from midstride.model import component as model
from midstride.model.component import ParameterValue
from midstride.model.contract import Predicate, QoS
from midstride.node.author import declared_contracts
from midstride.node.author.author_clock import ComponentClock
from midstride.node.author.client_ports import ActionClientPort, ClientPort
from midstride.node.author.declaration import DeclaredParts, declare
from midstride.node.author.declared_contracts import FieldConditions, check_service, check_within
from midstride.node.author.declared_parameters import Parameter, check_parameter
from midstride.node.author.functionality import Functionality
from midstride.node.author.modes import listed
from midstride.node.author.ports import Input, Output
from midstride.node.author.server_ports import ActionServerPort, RequestFunction, ServerPort
from midstride.node.control.component_agent import Agent
from midstride.node.loaded_program import ProgramFiles
from midstride.node.process_context import find, host_factory
from midstride.node.standalone import remappings

F = TypeVar("F", bound=Callable[..., Any])
P = TypeVar("P", Input, Output)


class Component:
    """A node of the system: declare its ports, functionalities and parameters, then call ``start()``.

    ``name`` is the component's own name; it must be a ROS name. Every declaring method raises NodeError if it is used
    wrongly, or after ``start()``; the message says what to write instead, and nothing has been declared. What these
    terms mean is in docs/semantics.md section 2.
    """

    def __init__(self, name: str) -> None:
        #: The name given to the constructor.
        self.name = declared_contracts.check_name(name, "Component()")
        #: The name of this instance. The manager may choose another one than ``name``: ``talker_2``.
        self.instance = name
        #: The node's ROS clock.
        self.clock = ComponentClock()
        self._parts = DeclaredParts()
        self._started = False

    @property
    def logger(self) -> Any:
        """The node's ROS logger; before ``start()``, a logger of Python's ``logging``."""
        host = self.clock.host
        return logging.getLogger(f"midstride.{self.name}") if host is None else host.logger

    # -- declaring ---------------------------------------------------------------------------------

    def create_input(
        self,
        name: str,
        type: type,
        rate: float | None = None,
        qos: QoS | int | None = None,
        where: FieldConditions | None = None,
        tolerates: int | None = None,
        condition: bool = False,
    ) -> Input:
        """An input port, with what it assumes about any topic that it is attached to (docs/semantics.md section 1).

        - ``type`` is the message class.
        - ``rate`` is the least rate in Hz; None if any will do.
        - ``qos`` is what the subscription requests: a QoS, or just a depth. Policies that it leaves out have ROS's
          defaults.
        - ``where`` constrains fields: ``{"width": at_least(640), "encoding": {"rgb8", "bgr8"}}``. A value is a set of
          values, a single value, ``at_least(…)``, ``at_most(…)`` or ``between(…, …)``.
        - ``tolerates`` is how many messages in succession may be missed before a mode that assumes this input is left
          (docs/protocols/reflex.md); None: 10, and silence of at least 5 s. It needs a rate. What the specification
          states takes precedence.
        - ``condition``: the last message alone decides, by ``where``, whether what it assumes holds: a mode that
          assumes it is left at once, and restored at once (docs/protocols/reflex.md).

        Raises NodeError.
        """
        where_ = f"input {self._new_port(name)}"
        message_type = declared_contracts.check_type(type, where_)
        fields = declared_contracts.field_constraints(where, message_type, where_)
        hertz, profile = declared_contracts.check_rate(rate, where_), declared_contracts.check_qos(qos, where_)
        assumption = Predicate(declared_contracts.type_name(message_type), hertz, profile, fields)
        missed = declared_contracts.check_missed(tolerates, assumption, where_)
        if condition and not fields:
            raise NodeError(f"{where_}: a condition needs a constraint, else every message meets it; write where=")
        self._parts.inputs[name] = Input(name, message_type, assumption, missed, condition)
        return self._parts.inputs[name]

    def create_output(self, name: str, type: type, qos: QoS | int | None = None) -> Output:
        """An output port. It is attached to no topic until the manager attaches it.

        It belongs to one functionality, whose modes state what it guarantees. ``type`` and ``qos`` are written as for
        an input, and are the same in all modes (rule M3 of docs/semantics.md section 2). Raises NodeError.
        """
        where = f"output {self._new_port(name)}"
        self._parts.outputs[name] = Output(
            name, declared_contracts.check_type(type, where), declared_contracts.check_qos(qos, where)
        )
        return self._parts.outputs[name]

    def create_server(
        self,
        name: str,
        type: type,
        function: RequestFunction,
        within: float | None = None,
        refusal: RequestFunction | None = None,
    ) -> ServerPort:
        """A server of a service, on ROS 2. The topic that the manager attaches it to is the name of the service.

        It belongs to one functionality, as an output does, and serves in the modes that have it among their
        ``outputs=``. ``function(request, response)`` fills the response, and returns it or None; it may be async, and
        runs on the thread of the modes. If it raises, its functionality goes to its degraded mode.

        - ``type`` is the class of the service.
        - ``within`` is the bound within which a request is answered (s); it must be at least as good as the one that
          the specification states.
        - ``refusal(request, response)`` fills the response in modes that do not serve. Without it, the service is not
          in the graph in those modes, so that clients see that it is not ready. Requests that have arrived are answered
          before it leaves.

        Each request is answered by one instance across a replacement (docs/protocols/services.md). Raises NodeError.
        """
        where = f"server {self._new_port(name)}"
        service, bound = check_service(type, where), check_within(within, where)
        for each in (function, refusal):
            if each is not None and not callable(each):
                raise NodeError(f"{where}: {each!r} is not a function; it is called with a request and a response")
        server = ServerPort(name, service, function, bound, refusal)
        self._parts.outputs[name] = server
        return server

    def create_client(self, name: str, type: type, within: float | None = None) -> ClientPort:
        """A client of a service, on ROS 2. A mode that relies on it names it in ``inputs=``.

        Such a mode is left when the server is not in the graph any more, or where a response takes longer than its
        bound (docs/protocols/reflex.md). Messages drive a mode, and clients do not: ``rate=`` has it called.
        ``within`` is the bound within which a request must be answered (s), None if any will do. Raises NodeError.
        """
        where = f"client {self._new_port(name)}"
        client = ClientPort(name, check_service(type, where), check_within(within, where))
        self._parts.inputs[name] = client
        return client

    def create_action_server(
        self,
        name: str,
        type: type,
        function: Callable[[Any], Any],
        within: float | None = None,
        accepts: Callable[[Any], bool] | None = None,
        cancels: Callable[[Any], bool] | None = None,
    ) -> ActionServerPort:
        """A server of a ROS action, on ROS 2, as :meth:`create_server` is one of a service.

        ``function(goal)`` executes an accepted goal, which is rclpy's handle of it, and returns the result. It should
        be async: it runs on the thread of the modes. If it raises, the goal is aborted, and its functionality goes to
        its degraded mode. Goals are rejected in modes that do not serve, and if ``accepts(goal_request)`` is False;
        ``cancels(goal)``: whether a goal may be cancelled (None: always). Goals in progress go on when the mode
        changes. ``within`` is the bound within which a goal is accepted or rejected (s). Raises NodeError.
        """
        where = f"action server {self._new_port(name)}"
        action, bound = check_service(type, where, "action"), check_within(within, where)
        for each in (function, accepts, cancels):
            if each is not None and not callable(each):
                raise NodeError(f"{where}: {each!r} is not a function; it is called with a goal")
        server = ActionServerPort(name, action, function, bound, accepts, cancels)
        self._parts.outputs[name] = server
        return server

    def create_action_client(self, name: str, type: type, within: float | None = None) -> ActionClientPort:
        """A client of a ROS action, on ROS 2, as :meth:`create_client` is one of a service.

        ``within`` is the bound within which a goal must be accepted or rejected (s). Raises NodeError.
        """
        where = f"action client {self._new_port(name)}"
        client = ActionClientPort(name, check_service(type, where, "action"), check_within(within, where))
        self._parts.inputs[name] = client
        return client

    def create_functionality(
        self, name: str, inputs: Sequence[Input] = (), outputs: Sequence[Output] = (), weight: float = 1
    ) -> Functionality:
        """A computation from ``inputs`` to ``outputs``. Declare its modes on the functionality that this returns.

        Functionalities may share an input, but an output belongs to one. ``weight``, greater than 0, says how much the
        loss of this functionality matters; the planner minimises weight times levels lost times seconds
        (docs/semantics.md section 6). Raises NodeError.
        """
        self._declaring(f"functionality {name}")
        where = f"functionality {declared_contracts.check_name(name, 'create_functionality()')}"
        if name in self._parts.functionalities:
            raise NodeError(f"{where} exists already; give this one another name")
        importance = declared_contracts.check_weight(weight, where)
        own_inputs = self._own(where, inputs, self._parts.inputs, "inputs")
        own_outputs = self._own(where, outputs, self._parts.outputs, "outputs")
        for port in own_outputs:
            for other in self._parts.functionalities.values():
                if port in other.outputs:
                    raise NodeError(
                        f"{where}: output {port.name} already belongs to functionality {other.name}; an output has one "
                        "owner: create another output, or give both tasks to one functionality"
                    )
        self._parts.functionalities[name] = Functionality(name, own_inputs, own_outputs, importance, self._declaring)
        return self._parts.functionalities[name]

    def parameter(
        self, name: str, default: ParameterValue, on_change: Callable[[Any], None] | None = None
    ) -> Parameter:
        """A ROS parameter. Its ``value`` is the current one; with ``on_change(value)`` it can change at run time.

        ``on_change`` is called between two calls of the modes; if it raises, the change is refused. Without it, another
        value requires another instance (docs/semantics.md section 6). A value that was set at run time travels to a
        replacement, which is started with it and whose ``on_change`` is then called with it (section 7).

        Values are booleans, numbers, strings, or lists of one of these, of the type of ``default``. Before ``start()``,
        ``value`` is the one that the manager passed, else the default. Raises NodeError.
        """
        self._declaring(f"parameter {name}")
        check_parameter(name, default)
        if name in self._parts.parameters:
            raise NodeError(f"parameter {name} exists already")
        parameter = Parameter(name, default, on_change)
        context = find()
        if name in context.parameters:
            parameter.begin_with(context.parameters[name])
        if name in context.set_parameters:
            parameter.keep(context.set_parameters[name])
        self._parts.parameters[name] = parameter
        return parameter

    def on_setup(self, fn: F) -> F:
        """``fn(node)`` is called once, before the component registers: to create services or transform broadcasters.

        ``node`` is rclpy's node on ROS 2, the module ``rospy`` on ROS 1 (where a process is one node), and None in the
        simulator. ``fn`` runs on the thread of the modes. What it creates is active from then on; the specification
        declares it with ``allows`` (docs/protocols/state.md). If ``fn`` raises, the component does not start.
        """
        self._parts.callbacks.setup = self._callback("on_setup", fn)
        return fn

    def on_export_state(self, fn: F) -> F:
        """``fn() -> bytes``: the state for a replacement of this component.

        Called once, after the last write of this component and before the first of its replacement: no call of a mode
        comes in between. If it raises, the hand-over is rolled back, and this component continues
        (docs/protocols/state.md).
        """
        self._parts.callbacks.export_state = self._callback("on_export_state", fn)
        return fn

    def on_import_state(self, fn: F) -> F:
        """``fn(state: bytes)``: restore the state of the replaced component.

        Called between two calls of the modes, which have run until then, with their outputs held back: replace what
        they have computed. If it raises, the hand-over is rolled back.
        """
        self._parts.callbacks.import_state = self._callback("on_import_state", fn)
        return fn

    def on_export_changes(self, fn: F) -> F:
        """``fn() -> bytes``: what has changed since ``on_export_state`` was last called.

        For a state that takes longer than a period to move: it is exported and imported as a whole while this component
        works, and only the changes move between the last write and the first. It may be called more than once for one
        ``on_export_state``. Used where the replacement has ``on_import_changes``.
        """
        self._parts.callbacks.export_changes = self._callback("on_export_changes", fn)
        return fn

    def on_import_changes(self, fn: F) -> F:
        """``fn(changes: bytes)``: add the changes to the state that ``on_import_state`` was called with."""
        self._parts.callbacks.import_changes = self._callback("on_import_changes", fn)
        return fn

    def on_stop(self, fn: F, timeout: float = 2.0) -> F:
        """``fn()`` is called when the component ends, after the last call of any mode: to write zero velocity, say.

        Outputs can still be written. ``fn`` may be async. The component ends after ``timeout`` seconds even if ``fn``
        has not returned; its exceptions are logged. A call that is under way when it ends has as long before. Raises
        NodeError.
        """
        self._parts.callbacks.stop = self._callback("on_stop", fn)
        self._parts.callbacks.stop_timeout = declared_contracts.check_seconds(timeout, "on_stop(timeout=)")
        return fn

    # -- running -----------------------------------------------------------------------------------

    @property
    def is_live(self) -> bool:
        """Return whether a message that a mode writes now is published on some topic.

        False behind the gate: before this component takes over from another, and after another has taken over from it.
        Ask it on the data thread before you act otherwise than by an output, as with a device or a service. A component
        without outputs has no gate, and is live while an input is attached; where its state moves, its modes are only
        called while it is the one that works (docs/protocols/state.md).
        """
        outputs = self._parts.outputs.values()
        if not outputs:
            return any(port.attached for port in self._parts.inputs.values())
        return any(link.is_live for port in outputs for link in port.links)

    def declaration(self) -> model.ComponentSpec:
        """The component in the model's terms. Raises NodeError where it is incomplete."""
        return declare(self.name, self._parts)

    def start(self) -> None:
        """Run until the manager, SIGTERM or SIGINT stops it. Installs the handlers of these signals.

        The component waits, degraded and unattached, until its manager attaches it and upgrades it, whether the manager
        started it or you did. With ``--standalone out:=/chatter`` on the command line it attaches itself and runs its
        best modes without a manager. It ignores other arguments.

        Raises NodeError if the declaration is incomplete or breaks a rule of docs/semantics.md section 2, if no ROS can
        be imported, or if the node's name is in use; BackendError if the platform cannot be joined.
        """
        self._declaring("start()")
        declaration = self.declaration()
        context = find()
        standalone = remappings(context.arguments, declaration)
        factory = host_factory(context)
        self._started = True
        host = factory(context.instance or self.name, context.namespace)
        if self._parts.services and not host.has_services:
            names = ", ".join(port.name for port in self._parts.services)
            raise NodeError(f"component {self.name} has servers or clients ({names}), which need ROS 2: run it there")
        self.instance, self.clock.host = host.instance, host
        pid = os.getpid() if context.pid is None else context.pid
        program = ProgramFiles(context.modules, context.started)
        agent = Agent(
            self._parts,
            declaration,
            host,
            context.token,
            pid,
            standalone,
            program,
            context.diagnostics,
            context.patience,
        )
        host.run(agent.main)

    def _declaring(self, what: str) -> None:
        if self._started:
            raise NodeError(f"{what}: component {self.name} has been started; declare everything before start()")

    def _new_port(self, name: object) -> str:
        port = declared_contracts.check_name(name, "a port's name")
        self._declaring(f"port {port}")
        if port in self._parts.ports:
            raise NodeError(f"port {port} exists already; give this one another name")
        return port

    def _own(self, where: str, ports: object, declared: Mapping[str, P], what: str) -> tuple[P, ...]:
        found = tuple(listed(ports, where, what))
        for port in found:
            if not any(port is own for own in declared.values()):
                made = f"create_{what.removesuffix('s')}"
                raise NodeError(
                    f"{where}: {what}= has {port!r}, which is not a port of this component; write what {made} returned"
                )
        if len(set(found)) < len(found):
            raise NodeError(f"{where}: {what}= names a port twice")
        return found

    def _callback(self, name: str, fn: F) -> F:
        self._declaring(f"{name}()")
        if not callable(fn):
            raise NodeError(f"{name}({fn!r}): pass a function")
        return fn

    def __repr__(self) -> str:
        return f"<component {self.name}>"
