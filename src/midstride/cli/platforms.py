"""The back end of a system that may have other hosts."""

from __future__ import annotations

from midstride import backends
from midstride.runtime.backend_protocol import Backend
from midstride.runtime.hosts.hosts_backend import HostsBackend
from midstride.runtime.workspace import Workspace


def make_backend(name: str, workspace: Workspace, *, middleware_settings: bool = True) -> Backend:
    """Make a back end as :func:`midstride.backends.make` does; on ROS 2, also for components on other hosts.

    Raises BackendError.
    """
    own = backends.make(name, workspace, middleware_settings=middleware_settings)
    return HostsBackend(own, workspace, middleware_settings=middleware_settings) if name == "ros2" else own
