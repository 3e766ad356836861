"""The order of a manager to `midstride host` on another host, and the line of JSON with which that answers.

The order arrives on standard input, so nothing of it is in the arguments of a process. Nothing in the answer is taken
for a command or a path of the manager's host: its texts are bounded, and the path of the socket, which OpenSSH passes
back to the host, has to look like one.
"""

from __future__ import annotations

import re
from typing import Annotated, Final, TypeAlias

import msgspec
from msgspec import Meta

from midstride.errors import ProtocolError

# The variables of the manager's environment that decide which nodes a process can reach: those of a host are the same.
SHARED_VARIABLES: Final = ("ROS_DOMAIN_ID", "RMW_IMPLEMENTATION", "MIDSTRIDE_DIAGNOSTICS")
# The longest line of either side (bytes), and the longest path of a socket that a forwarding takes.
LONGEST_LINE: Final = 64 * 1024
LONGEST_SOCKET: Final = 107
_SOCKET: Final = re.compile(r"/[A-Za-z0-9_./@+~=,-]+/host\.sock")
_NAME: Final = re.compile(r"[A-Za-z][A-Za-z0-9_\-]*")
# A word at the start of the line, as a login shell may print others before it.
HOST_MARK: Final = '{"midstride_host":'
Text: TypeAlias = Annotated[str, Meta(max_length=4096)]


class HostOrder(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """``folder``: the one of the host's declaration. ``variables``: some of ``SHARED_VARIABLES``.

    ``reads``: it is no manager's. A host process that runs serves it as well, with whatever settings.
    """

    protocol: int
    system: str
    host: str
    backend: str = "ros2"
    folder: str | None = None
    middleware_settings: bool = True
    variables: dict[str, str] = {}
    reads: bool = False

    @classmethod
    def read(cls, line: bytes) -> HostOrder:
        """Raises ProtocolError for one that is not well formed."""
        try:
            order = msgspec.json.decode(line, type=cls)
        except (msgspec.DecodeError, UnicodeDecodeError) as error:
            raise ProtocolError(
                f"standard input has no order of a manager ({error}): `midstride host` is started by one, over SSH"
            ) from None
        for name in (order.system, order.host):
            if not _NAME.fullmatch(name):
                raise ProtocolError(f"{name!r} cannot name a system or a host")
        return msgspec.structs.replace(
            order, variables={name: order.variables[name] for name in SHARED_VARIABLES if name in order.variables}
        )


class HostReport(msgspec.Struct, frozen=True, kw_only=True):
    """The host process as it was found or started. ``problem``: why there is none, and what to do.

    ``lingers``: processes of the user outlive the last login, None where that is not known; ``kills``: logind kills
    those of a session that ends. ``range``: the discovery range that is set there.
    """

    midstride_host: int
    version: Text = ""
    problem: Text | None = None
    socket: Text = ""
    components: Text = ""
    user: Text = ""
    free_bytes: int = 0
    range: Text = ""
    lingers: bool | None = None
    kills: bool | None = None

    @classmethod
    def read(cls, line: bytes) -> HostReport:
        """Raises ProtocolError for what is no report, or has a socket whose path cannot be one."""
        try:
            report = msgspec.json.decode(line, type=cls)
        except (msgspec.DecodeError, UnicodeDecodeError) as error:
            raise ProtocolError(f"its `midstride host` answers with something else: {error}") from None
        if report.problem is None:
            if not _SOCKET.fullmatch(report.socket) or len(report.socket) > LONGEST_SOCKET:
                raise ProtocolError(
                    f"the socket of its host process, {report.socket!r}, has a path that SSH cannot forward: state a "
                    'shorter `folder "/…"` of letters, digits and `._-`'
                )
            if not report.components.startswith("/"):
                raise ProtocolError("its `midstride host` does not say where its components listen")
        return report
