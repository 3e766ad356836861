"""Classes of services and ROS actions where no ROS is installed: those that ROS's own examples use."""

from __future__ import annotations

from functools import cache
from typing import Any, Final

from midstride.backends.simulator.messages import SimulatedMessage, fields_class

_FIBONACCI: Final = {"Goal": "int32 order", "Result": "int32[] sequence", "Feedback": "int32[] sequence"}
_ADD: Final = {"Request": "int64 a\nint64 b", "Response": "int64 sum"}
_EMPTY: Final = {"Request": "", "Response": ""}
_SET: Final = {"Request": "bool data", "Response": "bool success\nstring message"}
_TRIGGER: Final = {"Request": "", "Response": "bool success\nstring message"}

# The parts of each, as their files define them. The type store of `rosbags` has messages only.
SERVICE_TYPES: Final[dict[str, dict[str, str]]] = {
    "std_srvs/srv/Empty": _EMPTY,
    "std_srvs/srv/SetBool": _SET,
    "std_srvs/srv/Trigger": _TRIGGER,
    "example_interfaces/srv/AddTwoInts": _ADD,
    "example_interfaces/srv/SetBool": _SET,
    "example_interfaces/srv/Trigger": _TRIGGER,
    "example_interfaces/action/Fibonacci": _FIBONACCI,
    "action_tutorials_interfaces/action/Fibonacci": {**_FIBONACCI, "Feedback": "int32[] partial_sequence"},
    "test_msgs/action/Fibonacci": _FIBONACCI,
}


@cache
def service_class(name: str) -> type:
    """The class of ``pkg/srv/Name`` or ``pkg/action/Name``. Raises KeyError for one that is not known."""
    package, folder, short = name.split("/")
    parts: dict[str, type[SimulatedMessage]] = {
        part: _part(f"{name}_{part}", text) for part, text in SERVICE_TYPES[name].items()
    }
    attributes: dict[str, Any] = {"__msgtype__": name, "__module__": f"{package}.{folder}", **parts}
    return type(short, (), attributes)


def _part(name: str, text: str) -> type[SimulatedMessage]:
    from rosbags.typesys import get_types_from_msg

    ((constants, fields),) = get_types_from_msg(text, name).values()
    return fields_class(name, constants, fields)
