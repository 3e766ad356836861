"""The relays of one system: the orders that they are started with, and the nodes of the programs behind them."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from midstride.backends.naming import topics_of
from midstride.backends.ros2.manager.own_names import OwnNames, StartName
from midstride.backends.ros2.manager.start_arguments import StartArguments, enclave_for
from midstride.codec.component_form import NamedComponentForm
from midstride.codec.parameter import json_values
from midstride.errors import BackendError
from midstride.foreign.relayed_program import RelayOrder, order_file, private_topics
from midstride.model.component import ComponentSpec
from midstride.model.instance_names import full_name
from midstride.runtime.backend_protocol import Launch

log = logging.getLogger(__name__)


class Relays:
    """``folder``: of the gates; the orders are in it. ``own_names``: those that programs give their nodes."""

    def __init__(self, folder: Path, own_names: OwnNames) -> None:
        self._folder = folder
        self._own_names = own_names
        self._arguments = StartArguments(folder)
        self._nodes: dict[str, str] = {}  # by instance, the full name of its program's node; empty until it is known
        self._unfound: set[str] = set()  # whose relay has still to find the node
        self.names: set[str] = set()  # the full names of the nodes, also of those that have ended

    def prepare(
        self,
        launch: Launch,
        component: ComponentSpec,
        name: StartName,
        command: Sequence[str],
        environment: Mapping[str, str | None],
        predecessor: str,
    ) -> Path:
        """The file of the order of a relay; the arguments are those of :class:`RelayOrder`. Raises BackendError."""
        node = name.full or full_name(launch.instance, launch.namespace)
        topics = topics_of(component, node, launch.topics) | private_topics(component, launch.instance)
        order = RelayOrder(
            command=[*command, *self._arguments.of(replace(launch, topics=topics), component, name)],
            node=name.full,
            declaration=NamedComponentForm.of(component),
            topics=topics,
            environment=dict(environment),
            real={port: topic for port, topic in launch.topics.items() if component.has_output(port)},
            stated=json_values(launch.parameters),
            taken_over=json_values(launch.set_parameters),
            enclave=enclave_for(launch, component),
            unnamed=not name.passed,
            role=launch.role,
            predecessor=predecessor,
        )
        path = order_file(self._folder, launch.instance)
        order.write(path)
        self._note(launch.instance, order)
        return path

    def adopt(self, instance: str) -> None:
        """The process of an earlier manager runs; it may be a relay."""
        with suppress(BackendError):
            self._note(instance, RelayOrder.read(order_file(self._folder, instance)))

    def _note(self, instance: str, order: RelayOrder) -> None:
        if order.enclave:
            self._unfound.add(instance)
        self._nodes[instance] = order.node
        if order.node:
            self.names.add(order.node)

    def reported(self, instance: str) -> None:
        """Read from its order the name of the program's node: a relay that reports has written it there."""
        if instance not in self._unfound:
            return
        try:
            order = RelayOrder.read(order_file(self._folder, instance))
            if order.unnamed and order.node:
                self._own_names.note(order.role, order.node)
        except BackendError as error:
            log.error("how the node of %s is called is not known: %s", instance, error)
            return
        self._note(instance, order)
        self._unfound.discard(instance)

    def node_of(self, instance: str) -> str | None:
        """The full name of the node of the program, empty until it is known; None of what is no relay."""
        return self._nodes.get(instance)

    def runs(self, node: str) -> bool:
        """Return whether a program behind a relay has the node of this full name."""
        return node in self._nodes.values()

    def gone(self, instance: str) -> None:
        """Forget ``instance``, whose process has ended."""
        self._unfound.discard(instance)
        if self._nodes.pop(instance, None) is not None:
            order_file(self._folder, instance).unlink(missing_ok=True)
