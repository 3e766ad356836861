"""What a subscriber asks of a publisher in its connection header, and what the publisher grants in its own.

ROS 1 knows neither QoS nor numbered messages. But either side of a connection may say more than it must,
and who does not know of it passes it over. A Midstride subscriber asks at the end of its message definition,
where it is a comment; a Midstride publisher answers with a field of its own.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict
from typing import Final

from midstride.model.contract import QoS

_ASKED: Final = "# midstride: "
_GRANTED: Final = "midstride"
_REFUSED: Final = "midstride_unmet"


def ask(definition: str, qos: QoS) -> str:
    """The message definition with the wish for numbered messages, and with the QoS that is requested."""
    stated = {name: value for name, value in asdict(qos).items() if value is not None}
    return f"{definition.rstrip()}\n{_ASKED}{json.dumps(stated)}\n"


def asked(header: Mapping[str, str]) -> QoS | None:
    """What the header of a subscriber asks; None where it asks for nothing."""
    last = header.get("message_definition", "").rstrip().rpartition("\n")[2]
    if not last.startswith(_ASKED):
        return None
    try:
        return QoS(**json.loads(last.removeprefix(_ASKED)))
    except (ValueError, TypeError):
        return None


def grant(header: Mapping[str, str], endpoint: str, offered: QoS) -> dict[str, str]:
    """The fields with which a publisher answers: none to who has not asked.

    One who requests more than is offered gets no messages, and is told why.
    """
    requested = asked(header)
    if requested is None:
        return {}
    unmet = requested.unmet_by(offered)
    return {_GRANTED: endpoint, **({_REFUSED: "; ".join(unmet)} if unmet else {})}


def publisher_of(header: Mapping[str, str]) -> str | None:
    """The endpoint that grants numbered messages on this connection; None where they are as ROS 1 sends them."""
    return header.get(_GRANTED)


def is_compatible(header: Mapping[str, str]) -> bool:
    """Whether the QoS that is offered meets what was requested, as far as anybody says so."""
    return _REFUSED not in header
