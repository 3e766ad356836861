"""The grammar of the launch files of ROS 1: their elements, and the attributes of these.

roslaunch passes over an element and an attribute that it does not know, with a warning, and refuses a whole launch
file for an attribute that is missing or has no valid value, once it has come to that element.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Final, NamedTuple

from midstride.launch_files.entity import Entity
from midstride.launch_files.findings import ImportFindings, UnknownValue


class _Element(NamedTuple):
    """``parts``: the elements that may be in it, where these are not carried out by themselves."""

    required: frozenset[str]
    optional: frozenset[str]
    parts: frozenset[str]


def _element(required: str = "", optional: str = "", parts: str = "") -> _Element:
    return _Element(*(frozenset(names.split()) for names in (required, f"{optional} if unless", parts)))


# What roslaunch takes for a name of the graph, in canonical form.
LEGAL_NAME: Final = re.compile(r"[~/A-Za-z][\w/]*", re.ASCII)
# Attributes of `machine` that roslaunch refuses since ROS Fuerte.
BEFORE_FUERTE: Final = ("ros-hostname", "ros-ip", "ros-package-path", "ros-root")
_NODE: Final = "args clear_params cwd launch-prefix machine ns output required respawn respawn_delay"
_ELEMENTS: Final[Mapping[str, _Element]] = {
    "arg": _element("name", "default doc value"),
    "env": _element("name value"),
    "group": _element(optional="clear_params ns"),
    "include": _element("file", "clear_params ns pass_all_args", parts="arg env"),
    "machine": _element(
        "address name", " ".join(("default env-loader password ssh-port timeout user", *BEFORE_FUERTE)), "env"
    ),
    "node": _element("name pkg type", _NODE, parts="env param remap rosparam"),
    "param": _element("name", "binfile command textfile type value"),
    "remap": _element("from to"),
    "rosparam": _element(optional="command file ns param subst_value"),
}
# What roslaunch itself does not carry out.
NOT_LAUNCHED: Final = {
    "test": "roslaunch does not start a `test`: that is for `rostest`",
    "master": "roslaunch passes over `master`",
}


def refused(reason: str) -> UnknownValue:
    """The error for something for which roslaunch refuses the launch file."""
    return UnknownValue(f"roslaunch refuses this file: {reason}", "refused")


def check_element(entity: Entity, findings: ImportFindings) -> None:
    """Name what roslaunch passes over in an element. Raises UnknownValue for one that it refuses."""
    element = _ELEMENTS[entity.tag]
    for name in sorted(element.required):
        if name not in entity.attributes:
            raise refused(f"`{entity.tag}` has no `{name}`")
    for name in entity.attributes:
        if name not in element.required | element.optional:
            message = f"roslaunch passes over `{name}`, which is no attribute of `{entity.tag}`"
            findings.add("unsupported", message, entity.span, left_out=False)
    for child in entity.children if entity.tag != "group" else ():
        if child.tag not in element.parts:
            message = f"roslaunch passes over `{child.tag}`, which is no part of `{entity.tag}`"
            findings.add("unsupported", message, child.span, left_out=False)
