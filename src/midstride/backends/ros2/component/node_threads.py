"""The two nodes of a component's process, each spun by a thread: data and control.

The *data* node has the name of the role (started by hand: of the instance) and runs user code. The hidden *control*
node serves its parameter services, and answers while user code runs.
"""

from __future__ import annotations

import sys
import threading
import time
import traceback
from collections.abc import Callable, Mapping
from typing import Any, Final

import rclpy
from rclpy.executors import ExternalShutdownException, ShutdownException, SingleThreadedExecutor
from rclpy.signals import SignalHandlerOptions

from midstride.backends.ros2 import middleware, names
from midstride.backends.ros2.component import early_join
from midstride.backends.ros2.component.admitting_node import AdmittingNode
from midstride.backends.ros2.component.data_node import DataNode
from midstride.backends.ros2.component.diagnostics_publisher import DiagnosticsPublisher
from midstride.backends.ros2.component.parameter_services import ParameterServices
from midstride.errors import NodeError
from midstride.model.instance_names import full_name, split_name
from midstride.node.data.functionality_runner import CAUGHT
from midstride.node.legible import legible
from midstride.node.request_admission import RequestAdmission

# A node that was started by hand looks for another one of its name before it joins (s); each looks after it has joined.
# So of two, the one that was started by hand gives way.
LOOK_BEFORE: Final = 0.5
# An instance that leaves may show one of its two nodes for longer than the other one, but not for so long (s).
LEAVING: Final = 1.0
# How long the threads may take to end (s).
_JOIN: Final = 2.0
# A process announces that its nodes have no endpoints left, and leaves ROS this much later (s). rmw_dds_common handles
# such announcements on its own thread, and keeps for good what it handles after the process has left.
_TOLD: Final = 0.1


class ExecutorThread:
    """Spins a SingleThreadedExecutor in a thread until it is stopped; survives what user callbacks raise."""

    def __init__(self, name: str, context: Any, failed: Callable[[str], None]) -> None:
        """``failed`` is called, in the thread, with the traceback of whatever a callback raised."""
        self.executor: Any = SingleThreadedExecutor(context=context)
        self._context = context
        self._failed = failed
        self._stopping = False
        self._thread = threading.Thread(target=self._spin, name=name, daemon=True)

    def start(self) -> None:
        self._thread.start()

    def stop(self, timeout: float) -> bool:
        """Stop and join it; False where a callback does not return in time. Blocks.

        The thread must be out of the middleware before the context is shut down, or that aborts.
        """
        self._stopping = True
        if self._thread.is_alive():
            self.executor.create_task(lambda: None)  # a mere wake-up would let it go back to waiting
            self._thread.join(timeout)
        if self._thread.is_alive():
            return False
        self.executor.shutdown()
        return True

    def is_alive(self) -> bool:
        return self._thread.is_alive()

    def _spin(self) -> None:
        while not self._stopping and self._context.ok():
            try:
                self._spin_once()
            except (ExternalShutdownException, ShutdownException):
                return
            except CAUGHT:
                self._failed(legible(traceback.format_exc()))

    def _spin_once(self) -> None:
        """Wait for a callback and call it. Raises what it raises."""
        task, _, _ = self.executor.wait_for_ready_callbacks()
        try:
            task()
        except SystemExit as error:  # rclpy lets it through, and would keep the task for ever
            task.set_exception(error)
        task.result()


class ComponentNodes:
    """``system`` is that whose manager started the process, empty if none did.

    ``shares_name``: nodes without the API have that name beside it, or had it. How many, only the manager knows, so it
    alone looks for others; each that ends may be in the graph for some time more.
    ``failed`` is called with the traceback of what a callback raised.
    Raises NodeError where the name is taken.
    """

    def __init__(
        self,
        instance: str,
        name: str,
        namespace: str,
        *,
        admission: RequestAdmission,
        system: str,
        shares_name: bool = False,
        parameters: Mapping[str, Any],
        set_parameters: Mapping[str, Any],
        failed: Callable[[str], None],
    ) -> None:
        self._own_context = not rclpy.ok()
        if self._own_context and not early_join.become_default():
            rclpy.init(args=sys.argv, signal_handler_options=SignalHandlerOptions.NO)
        self._context = rclpy.utilities.get_default_context()
        self._control = early_join.hidden_node(
            names.control(instance, name, system), AdmittingNode, admission=admission, namespace=namespace
        )
        early_join.leave()
        self._full_name = full_name(name, namespace)
        self._system = system
        try:
            if not system:
                self._check_free()
        except NodeError:
            self._leave_ros()
            raise
        pinned = ["--ros-args", "-r", f"__node:={name}", "-r", f"__ns:={namespace}"] if system else None
        self.data: Any = DataNode(
            name,
            admission,
            namespace=namespace,
            cli_args=pinned,
            start_parameter_services=False,
            parameters=parameters,
            set_parameters=set_parameters,
        )
        self._full_name = self.data.get_fully_qualified_name()
        self.control_name = self._control.get_fully_qualified_name()
        self._checked_until = time.monotonic() + (0.0 if shares_name else middleware.of_this_process().name_delay)
        self._foreign_since: float | None = None  # since when the graph has shown another node of its name
        self._data_thread = ExecutorThread("midstride-data", self._context, failed)
        self._control_thread = ExecutorThread("midstride-control", self._context, failed)
        self.data_executor = self._data_thread.executor
        self.data_executor.add_node(self.data)
        self._control_thread.executor.add_node(self._control)
        self.parameter_services = ParameterServices(
            self._control, self._control_thread.executor, self.data, self.data_executor
        )
        self.diagnostics = DiagnosticsPublisher(
            self._control, self._control_thread.executor, self._full_name, full_name(instance, namespace)
        )
        self._data_thread.start()
        self._control_thread.start()

    def check(self, *, managed: bool) -> bool:
        """Return whether another node of the component's name may yet appear. To be repeated, soon as long as it may.

        ``managed``: a manager knows the component, and may start more instances of its role. Raises NodeError where the
        component cannot go on: ROS was shut down, one of its threads has ended, or another node has its name.
        """
        if not self._context.ok():
            raise NodeError("rclpy was shut down from within the component; leave that to start()")
        for of, thread in (("the author's", self._data_thread), ("the control node's", self._control_thread)):
            if not thread.is_alive():
                raise NodeError(f"the thread of {of} callbacks has ended: its log says what ended it")
        now = time.monotonic()
        if now >= self._checked_until and self._foreign_since is None:
            return False
        if not self._is_foreign_in_graph(managed):
            self._foreign_since = None
        elif self._foreign_since is None:
            self._foreign_since = now
        elif now - self._foreign_since > LEAVING:
            self._refuse_name()
        return True

    def _is_foreign_in_graph(self, managed: bool) -> bool:
        """Return whether more nodes have the name than the role has instances: one until a manager starts others."""
        listed = self._control.get_node_names_and_namespaces_with_enclaves()  # once: others may come and go meanwhile
        in_graph = [(full_name(name, inside), enclave) for name, inside, enclave in listed]
        nodes = names.outside(self._full_name, in_graph, self._system)
        if nodes <= 1:
            return False
        if not (self._system or managed):
            return True
        return nodes > max(1, names.instances_of(self._full_name, (name for name, _ in in_graph), self._system))

    def _check_free(self) -> None:
        """Raises NodeError where a node of our name appears soon, before ours has joined."""
        deadline = time.monotonic() + LOOK_BEFORE
        while split_name(self._full_name) not in self._control.get_node_names_and_namespaces():
            if time.monotonic() >= deadline:
                return
            time.sleep(0.02)
        self._refuse_name()

    def _refuse_name(self) -> None:
        raise NodeError(
            f"a node {self._full_name} is running already; end it, or give this one another name "
            "(two of one name would both answer)"
        )

    def leave(self) -> bool:
        """Leave ROS; False where user code does not return, so that the process exits without waiting for it."""
        # Threads first, then the nodes, then ROS: any other order aborts the process.
        control_left = self._control_thread.stop(_JOIN)
        data_left = self._data_thread.stop(_JOIN)
        if control_left and data_left:
            self.data.destroy_node()
            self._leave_ros()
        elif self._own_context:
            self._context.try_shutdown()
        return data_left

    def _leave_ros(self) -> None:
        if not self._own_context:  # the process stays
            self._control.destroy_node()
            return
        for publisher in list(self._control.publishers):
            self._control.destroy_publisher(publisher)
        for service in list(self._control.services):
            self._control.destroy_service(service)
        time.sleep(_TOLD)
        self._control.destroy_node()
        self._context.try_shutdown()
