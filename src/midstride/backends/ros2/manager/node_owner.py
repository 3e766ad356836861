"""The program that has a node of the graph, in words: one of a Midstride system, or another one of this computer.

Fast DDS names the process of an endpoint; of any middleware, the control node of a component names its system.
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Final

from midstride.backends.ros2 import names
from midstride.backends.ros2.middleware import PIDS, NodeProcess
from midstride.runtime.process import reaper
from midstride.runtime.process.reaper import environment_value, process_info
from midstride.wire.environment import ENV_CONTROL, ENV_INSTANCE, ENV_TOKEN

if TYPE_CHECKING:  # it imports rclpy, which this is tested without
    from midstride.backends.ros2.manager.graph import Graph

# How much of a command line is shown (characters).
_SHOWN: Final = 120
ELSEWHERE: Final = "whose it is, is not known here: it is on another computer, or of another user"


def node_owner(graph: Graph, node: str, control: Path) -> str:
    """Return which program has the node of that full name, beside those of the system with this folder of sockets."""
    shown = graph.processes()
    here = _host_in(shown, graph)
    own = [process for name, process in shown if name == node]
    pids = [pid for process in own for pid in pids_of(process, here)]
    others = [pid for pid in pids if environment_value(pid, ENV_CONTROL) != str(control.absolute())]
    if pids:
        return described((others or pids)[0])
    for instance in graph.of_name(node):
        if instance is None or not instance.system:
            continue
        pid = _pid_of_instance(instance)
        if pid is not None and environment_value(pid, ENV_CONTROL) == str(control.absolute()):
            continue
        unknown = f"it is {instance.instance.strip('/')} of another Midstride system; {ELSEWHERE}"
        return unknown if pid is None else described(pid)
    if not graph.rmw.fast_dds:
        return f"whose it is, is not known: {graph.rmw.identifier} does not tell which process has a node"
    return ELSEWHERE


def described(pid: int) -> str:
    """Return what this process is: an instance of a Midstride system, or its command line."""
    control, instance = (environment_value(pid, name) for name in (ENV_CONTROL, ENV_INSTANCE))
    if control and instance:
        folder = Path(control).parent
        return f"it is {instance} of the Midstride system {folder.name} ({folder}), process {pid}"
    try:
        words = Path(f"/proc/{pid}/cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace").strip()
    except OSError:
        words = ""
    words = words if len(words) <= _SHOWN else f"{words[:_SHOWN]}…"
    return f"it is process {pid}" + (f" (`{words}`)" if words else "")


def host_of(graph: Graph) -> bytes | None:
    """Return the name of this computer in the middleware; None where it has none."""
    return _host_in(graph.processes(), graph)


def _host_in(shown: Iterable[tuple[str, NodeProcess]], graph: Graph) -> bytes | None:
    return next((process.host for name, process in shown if name == graph.own_name), None)


def pids_of(process: NodeProcess, here: bytes | None) -> list[int]:
    """The processes of this computer that it may be, of which the middleware names the number modulo PIDS.

    One in another container may have the number of any process: so it has to have loaded Fast DDS.
    """
    if process.pid is None or process.host != here:
        return []
    last = int(Path("/proc/sys/kernel/pid_max").read_text())
    found = [pid for pid in range(process.pid, last + 1, PIDS) if process_info(pid) is not None]
    return [pid for pid in found if _has_fast_dds(pid)]


def _has_fast_dds(pid: int) -> bool:
    try:
        return b"/libfast" in Path(f"/proc/{pid}/maps").read_bytes()
    except OSError:  # it has ended, or is another user's
        return False


def _pid_of_instance(instance: names.InstanceNode) -> int | None:
    """The process of an instance of a system whose processes may be looked at; None where there is none."""
    own = instance.instance.strip("/")
    for process in reaper.processes():
        if environment_value(process.pid, ENV_INSTANCE) == own:
            token = environment_value(process.pid, ENV_TOKEN)
            if token and names.system_tag(token) == instance.system:
                return process.pid
    return None
