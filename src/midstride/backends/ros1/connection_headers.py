"""The request of a subscriber in its connection header, and the answer of the publisher in its own.

ROS 1 has neither QoS nor numbered messages. But either side of a connection may add to its header, and a side that does
not know the addition ignores it. A Midstride subscriber puts its request at the end of its message definition, as a
comment; a Midstride publisher answers in a field of its header.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from typing import Final

from midstride.model.contract import QoS

_REQUESTED: Final = "# midstride: "
_GRANTED: Final = "midstride"
_REFUSED: Final = "midstride_unmet"


def request(definition: str, qos: QoS) -> str:
    """The message definition with a request for numbered messages and for this QoS."""
    stated = {name: value for name, value in asdict(qos).items() if value is not None}
    return f"{definition.rstrip()}\n{_REQUESTED}{json.dumps(stated)}\n"


def requested(header: Mapping[str, str]) -> QoS | None:
    """The QoS that the header of a subscriber requests; None where it requests nothing."""
    last = header.get("message_definition", "").rstrip().rpartition("\n")[2]
    if not last.startswith(_REQUESTED):
        return None
    try:
        return QoS(**json.loads(last.removeprefix(_REQUESTED)))
    except (ValueError, TypeError, RecursionError):
        return None


def grant(header: Mapping[str, str], endpoint: str, offered: QoS) -> dict[str, str]:
    """The fields with which a publisher answers: none where nothing was requested.

    A subscriber that requests more than is offered gets no messages, and the reason.
    """
    qos = requested(header)
    if qos is None:
        return {}
    unmet = qos.unmet_by(offered)
    return {_GRANTED: endpoint, **({_REFUSED: "; ".join(unmet)} if unmet else {})}


def publisher_of(header: Mapping[str, str]) -> str | None:
    """The endpoint that grants numbered messages on this connection; None where they come as ROS 1 sends them."""
    return header.get(_GRANTED)


def is_compatible(header: Mapping[str, str]) -> bool:
    """Return whether the QoS that is offered meets the request; a publisher that does not say so is taken to meet
    it.
    """
    return _REFUSED not in header
