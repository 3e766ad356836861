"""The capabilities of each implementation of ROS 2's middleware interface (rmw), chosen once by its identifier.

What one cannot tell is unknown: None, an empty answer, and a sentence in :meth:`RmwImplementation.limits`, which
`midstride status` shows. Nothing is guessed. The sources, as read in ros2/rmw_fastrtps, ros2/rmw_cyclonedds and
ros2/rmw_zenoh:

- *Processes.* An endpoint's gid is its GUID in both DDS, and begins with that of the participant, one for each
  context (DDSI-RTPS 9.3.1). rmw_zenoh hashes the key expression of the liveliness token into it.
  Fast DDS has the low 16 bits of the process's number in it, and 16 random bits of the process, before the number of
  the participant (GuidUtils.hpp in eProsima/Fast-DDS): so contexts of one process are known to be of one.
- *Acknowledgements.* Both DDS wait for their readers. rmw_zenoh returns success unchecked (ros2/rmw_zenoh#215).
- *Numbers.* rmw_fastrtps and rmw_zenoh number each publisher's messages; rmw_zenoh denied it by mistake until
  ros2/rmw_zenoh#920. rmw_cyclonedds does not.
- *Identities.* All three show an endpoint under the same gid in every process.
- *Writers.* With a message, rmw_cyclonedds gives a handle of the receiving process in place of the publisher's GUID.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final, NamedTuple

from midstride.node.component_host import MessageInfo

# How many bytes the identity of an endpoint has. Where a gid has more, as all have on Humble, the others are 0.
IDENTITY: Final = 16
_PARTICIPANT: Final = 12  # bytes of a GUID that name its participant (DDSI-RTPS 9.3.1)
# Of a GUID of Fast DDS: the bytes that name the vendor and the computer, and those that name the process as well.
_HOST: Final = 4
_PROCESS: Final = 8
# How many values of a process's number it has.
PIDS: Final = 2**16
_UNSUPPORTED: Final = 2**64 - 1  # RMW_MESSAGE_INFO_SEQUENCE_NUMBER_UNSUPPORTED
_NOTHING: Final = MessageInfo(None, None, None)
# How long after its lease the end of a process may take to show (s).
_NOTICE: Final = 5.0


class NodeProcess(NamedTuple):
    """The process of a node, as the middleware names it: ``key`` is equal for nodes of one process.

    ``host`` is equal on one computer; ``pid`` is the process's number modulo ``PIDS``. Both are None where they are not
    told.
    """

    key: bytes
    host: bytes | None = None
    pid: int | None = None


@dataclass(frozen=True, slots=True)
class RmwImplementation:
    """The capabilities of one implementation; the defaults are those of an unknown one.

    ``fast_dds``: Midstride has discovery settings for it (:mod:`.dds_profiles`). ``lease``: for how long the graph
    shows a process that was killed, by default (s); of an unknown one, the longest known. ``name_delay``: how late the
    name of a node may come to be known (s), where the first message about it is lost.
    """

    identifier: str
    fast_dds: bool = False
    participant: int | None = None
    acknowledges: bool = False
    numbers_messages: bool = False
    names_writers: bool = False
    shares_identities: bool = False
    lease: float = 20.0
    name_delay: float = 4.0

    def process_of(self, info: Any) -> bytes | None:
        """The process that has an endpoint of the graph: equal for those of one process. None if that is unknown."""
        return None if self.participant is None else bytes(info.endpoint_gid)[: self.participant]

    def node_process(self, info: Any) -> NodeProcess | None:
        """The process that an endpoint of the graph belongs to; None if that is not told.

        Except with Fast DDS, it is that of one ROS context: a process that makes a second one is not known to be one.
        """
        return self.process_with(bytes(info.endpoint_gid))

    def process_with(self, gid: bytes) -> NodeProcess | None:
        """The process that has the endpoint of that identity; None if that is not told."""
        if not self.fast_dds:
            return None if self.participant is None else NodeProcess(gid[: self.participant])
        return NodeProcess(gid[:_PROCESS], gid[:_HOST], int.from_bytes(gid[_HOST : _HOST + 2], "little"))

    @property
    def linger(self) -> float:
        """For how long the graph may show a process that has ended without leaving ROS (s)."""
        return self.lease + _NOTICE

    def message_info(self, info: Any) -> MessageInfo:
        """The facts of rclpy's dictionary about a message; one that is absent is None, never 0."""
        if not info:
            return _NOTHING
        number, gid = info.get("publication_sequence_number"), info.get("publisher_gid")
        data = gid.get("data") if isinstance(gid, dict) else gid
        writer = bytes(data)[:IDENTITY].hex() if data else None
        return MessageInfo(
            source=info.get("source_timestamp") or None,
            number=None if number in (None, _UNSUPPORTED) or not self.numbers_messages else int(number),
            publisher=writer if self.names_writers else None,
            writer=writer,
        )

    def limits(self) -> Iterator[str]:
        """Sentences, one for each thing that the implementation does not tell, with what follows from that."""
        if self.participant is None:
            yield (
                f"processes: {self.identifier} does not tell which process an endpoint belongs to; where several "
                "instances have one node name, the graph does not tell them apart"
            )
        if not self.acknowledges:
            yield (
                f"acknowledgements: {self.identifier} does not tell whether messages have arrived; whether an output's "
                "last ones did before it was detached is unknown"
            )
        if not self.numbers_messages:
            yield f"sequence numbers: {self.identifier} gives none; a report has no figure that needs them"


_KNOWN: Final = (
    RmwImplementation("rmw_fastrtps_cpp", True, _PARTICIPANT, True, True, True, True),
    RmwImplementation("rmw_fastrtps_dynamic_cpp", True, _PARTICIPANT, True, True, True, True),
    RmwImplementation(
        "rmw_cyclonedds_cpp", participant=_PARTICIPANT, acknowledges=True, shares_identities=True, lease=10.0
    ),
    RmwImplementation("rmw_zenoh_cpp", numbers_messages=True, names_writers=True, shares_identities=True, lease=10.0),
)


def identity_of(info: Any) -> str:
    """The identity of an endpoint of the graph, which every process sees as the same where identities are shared."""
    return bytes(info.endpoint_gid)[:IDENTITY].hex()


def of_identifier(identifier: str) -> RmwImplementation:
    """The implementation of that identifier; for any other, one that tells nothing."""
    return next((each for each in _KNOWN if each.identifier == identifier), RmwImplementation(identifier))


def of_this_process() -> RmwImplementation:
    """The implementation that rclpy uses here. Imports rclpy, which loads it."""
    from rclpy.utilities import get_rmw_implementation_identifier

    return of_identifier(str(get_rmw_implementation_identifier()))
