"""The instance that this process is, and the platform it runs on: read once, in ``Component.start``.

The manager passes it to a component's process in environment variables (:mod:`midstride.wire.environment`). In the
simulator many components share one process, so there it is in a context variable.
"""

from __future__ import annotations

import importlib
import importlib.util
import json
import os
import sys
from collections.abc import Mapping
from contextvars import ContextVar
from dataclasses import dataclass, field
from typing import Any, Final, cast

from midstride.codec.parameter import from_json
from midstride.errors import NodeError
from midstride.model.component import DEFAULT_STOP
from midstride.node.component_host import HostFactory
from midstride.node.loaded_program import process_started
from midstride.wire.environment import (
    ENV_BACKEND,
    ENV_DIAGNOSTICS,
    ENV_INSTANCE,
    ENV_NAMESPACE,
    ENV_NODE,
    ENV_PARAMETERS,
    ENV_PATIENCE,
    ENV_SET_PARAMETERS,
    ENV_STANDBY,
    ENV_TOKEN,
)

# Back ends that a component finds by itself: the library that shows that the platform is installed, and our module.
# Each module has `create_host(name, namespace) -> Host`.
BACKENDS: Final = {"ros2": ("rclpy", "midstride.backends.ros2"), "ros1": ("rospy", "midstride.backends.ros1")}


@dataclass(frozen=True, slots=True)
class ProcessContext:
    """``instance`` is None where the component's own name is used; ``token`` is empty where it was started by hand.

    ``set_parameters`` are values that were set while its predecessor ran, ``parameters`` those that are declared.
    ``node`` is the name of the ROS node, None where that is the instance's. ``standby``: another instance answers
    requests to the node's services. ``patience``: for how long its goals go on once another one takes new ones (s).
    ``diagnostics``: it publishes on ``/diagnostics``.
    """

    factory: HostFactory | None = None
    instance: str | None = None
    namespace: str = ""
    token: str = ""
    parameters: Mapping[str, Any] = field(default_factory=dict)
    set_parameters: Mapping[str, Any] = field(default_factory=dict)
    arguments: tuple[str, ...] = ()
    pid: int | None = None
    node: str | None = None
    standby: bool = False
    patience: float = DEFAULT_STOP.patience
    diagnostics: bool = True
    # What it has imported, and when it started (unix ns).
    modules: Mapping[str, Any] = field(default_factory=lambda: sys.modules)
    started: int = 0


current: Final[ContextVar[ProcessContext | None]] = ContextVar("midstride_process_context", default=None)


def find() -> ProcessContext:
    """The context of the caller: the simulator's, else that of the environment."""
    simulated = current.get()
    if simulated is not None:
        return simulated
    return ProcessContext(
        instance=os.environ.get(ENV_INSTANCE) or None,
        namespace=os.environ.get(ENV_NAMESPACE, ""),
        token=os.environ.get(ENV_TOKEN, ""),
        parameters=_parameters(ENV_PARAMETERS),
        set_parameters=_parameters(ENV_SET_PARAMETERS),
        arguments=tuple(sys.argv[1:]),
        node=os.environ.get(ENV_NODE) or None,
        standby=bool(os.environ.get(ENV_STANDBY)),
        patience=float(os.environ.get(ENV_PATIENCE) or DEFAULT_STOP.patience),
        diagnostics=os.environ.get(ENV_DIAGNOSTICS) != "0",
        started=process_started(),
    )


def installed() -> str | None:
    """The ROS that this Python can import, ROS 2 first; None where there is none."""
    return next((name for name, (library, _) in BACKENDS.items() if importlib.util.find_spec(library)), None)


def host_factory(context: ProcessContext) -> HostFactory:
    """The factory of the platform that this process runs on. Raises NodeError where there is none."""
    if context.factory is not None:
        return context.factory
    name = os.environ.get(ENV_BACKEND) or installed()
    if name is None:
        raise NodeError(
            "no ROS can be imported (neither rclpy nor rospy): source your ROS's setup file, "
            "or `pip install '.[ros2]'` in a clone of Midstride, or run it in the simulator"
        )
    if name not in BACKENDS:
        raise NodeError(f"{ENV_BACKEND}={name!r} is not a back end: write one of {', '.join(BACKENDS)}")
    try:
        module = importlib.import_module(BACKENDS[name][1])
    except ImportError as error:
        raise NodeError(f"the back end {name} cannot be loaded: {error}") from error
    return cast(HostFactory, module.create_host)


def _parameters(variable: str) -> dict[str, Any]:
    text = os.environ.get(variable, "")
    if not text:
        return {}
    try:
        document = json.loads(text)
    except (ValueError, RecursionError) as error:
        raise NodeError(f"{variable} is not JSON: {error}") from None
    if not isinstance(document, dict):
        raise NodeError(f"{variable} must be a JSON object of parameter values, not {text!r}")
    return {name: from_json(value) for name, value in document.items()}
