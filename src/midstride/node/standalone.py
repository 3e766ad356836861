"""``python3 talker.py --standalone out:=/chatter``: a component that runs without a manager."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Final

from midstride.errors import NodeError
from midstride.model.component import ComponentSpec, InputAlternatives

FLAG: Final = "--standalone"
_REMAPPING: Final = re.compile(r"(?P<port>(?!__)[A-Za-z_]\w*):=(?P<topic>[^\s:=]+)\Z")

StandaloneTopics = Mapping[str, Sequence[str]]


def remappings(arguments: Sequence[str], component: ComponentSpec) -> StandaloneTopics | None:
    """The topics of each port by ``--standalone``; None where that is not given. Raises NodeError for a wrong port.

    The remappings are what follows the flag as ``port:=/topic``; every other argument is the author's or ROS's
    (a launch file of ROS 1 adds ``__name:=…``).
    """
    if FLAG not in arguments:
        return None
    attachments: dict[str, list[str]] = {}
    for argument in arguments[arguments.index(FLAG) + 1 :]:
        match = _REMAPPING.match(argument)
        if match is None:
            break
        port, topic = match["port"], match["topic"]
        if port not in component.ports():
            listed = ", ".join(component.ports()) or "none"
            raise NodeError(f"{FLAG} {argument}: there is no port {port}; the ports of {component.name} are: {listed}")
        attachments.setdefault(port, []).append(topic)
    return attachments


def best_modes(component: ComponentSpec, attachments: StandaloneTopics) -> dict[str, str]:
    """The best mode of each functionality, assuming that an attached topic meets its assumptions."""
    modes = {}
    for functionality in component:
        for mode in functionality.modes:
            named = [assumption.inputs for assumption in mode.assumptions if isinstance(assumption, InputAlternatives)]
            if all(any(port in attachments for port in alternatives) for alternatives in named):
                modes[functionality.name] = mode.name
                break
    return modes
