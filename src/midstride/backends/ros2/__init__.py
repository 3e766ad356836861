"""ROS 2: what a component's process is given (:func:`create_host`), and the manager's side (:func:`create_backend`).

Importing this package imports no ROS: that happens where one of the two is called, and a clear error
says so where there is none.
"""

from __future__ import annotations

import inspect
from collections.abc import Collection, Iterator
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from midstride.backends import common_messages
from midstride.errors import BackendError
from midstride.node.component_host import Host

if TYPE_CHECKING:  # the process of a component imports this package, and none of those
    from midstride.capture.observed import ObservedGraph
    from midstride.runtime.backend_protocol import Backend
    from midstride.runtime.process.reaper import Reaper

__all__ = ["create_backend", "create_host", "load", "observe", "prepare"]


def _require_rclpy() -> None:
    try:
        import rclpy  # noqa: F401
    except ImportError as error:
        raise BackendError(
            f"ROS 2 cannot be imported ({error}): source your ROS's setup file, "
            "or `pip install '.[ros2]'` in a clone of Midstride"
        ) from error


def create_host(name: str, namespace: str) -> Host:
    """The host of the component ``name``, which joins ROS 2 when it is run. Raises BackendError without ROS 2."""
    _require_rclpy()
    from midstride.backends.ros2.component.host import Ros2Host

    return Ros2Host(name, namespace)


def load() -> None:
    """Import what a component needs, before the component is known. Raises BackendError."""
    _require_rclpy()
    from rclpy.type_support import check_for_type_support

    from midstride.backends.ros2.component import host  # noqa: F401
    from midstride.node.author import component_class  # noqa: F401

    for type_ in (*common_messages.types("rclpy"), *_types_of_every_node()):
        check_for_type_support(type_)  # which loads it
    inspect.getmodule(inspect.currentframe())  # rclpy's logger does, and it then walks all that has been imported


def _types_of_every_node() -> Iterator[Any]:
    from rcl_interfaces.msg import ParameterEvent

    from midstride.backends.ros2.component.parameter_services import SERVICES

    yield from (ParameterEvent, *SERVICES.values())
    with suppress(ImportError):  # older ROS has no such service
        from type_description_interfaces.srv import GetTypeDescription

        yield GetTypeDescription


def prepare() -> None:
    """Import it, and join ROS 2. Raises BackendError."""
    load()
    from midstride.backends.ros2.component import early_join

    early_join.join()


def create_backend(
    control: Path, *, logs: Path | None = None, guardian: Reaper | None = None, middleware_settings: bool = True
) -> Backend:
    """See :class:`..processes.ProcessBackend` and :mod:`.dds_profiles`. Raises BackendError without ROS 2."""
    _require_rclpy()
    from midstride.backends.ros2.manager.backend import Ros2Backend

    return Ros2Backend(control, logs=logs, guardian=guardian, middleware_settings=middleware_settings)


def observe(seconds: float, nodes: Collection[str] = (), gates: Path | None = None) -> ObservedGraph:
    """See :func:`.manager.observer.observe`.

    ``gates``: the folder of the page of a system, where the library in its nodes shows how long their servers take to
    answer, and when they publish. Raises BackendError without ROS 2.
    """
    _require_rclpy()
    from midstride.backends.ros2.manager import observer, seen_answers, seen_nodes, seen_writes

    if gates is None:
        return observer.observe(seconds, nodes)
    seen = seen_nodes.SeenNodes(gates)
    answers = seen_answers.SeenAnswers(seen)

    def looked(_: ObservedGraph) -> bool:
        answers.look()
        return False

    graph = observer.observe(seconds, nodes, looked, seen_writes.SeenWrites(seen))
    graph.took = answers.took
    return graph
