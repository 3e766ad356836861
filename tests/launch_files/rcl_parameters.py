"""The parameters that ROS's own parser gives a node for the arguments of its process, without a process or a node."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from typing import Any

from tests.rcl_parser import parsing, sections_of_rcl


class Unreadable(Exception):
    """The parser refuses an argument: a node with it does not start."""


def effective(rules: Sequence[tuple[str, str]], node: str) -> dict[str, Any]:
    """The parameters of the node with this full name, in the order of precedence of rclcpp.

    ``rules``: arguments of the process in their order, ``-p`` with a rule or ``--params-file`` with a path. Raises
    Unreadable.
    """
    with parsing() as (library, into):
        for option, rule in rules:
            if option == "--params-file":
                done = library.rcl_parse_yaml_file(os.fsencode(rule), into)
            else:
                name, _, value = rule.partition(":=")
                of, _, parameter = name.rpartition(":")
                if not re.fullmatch(r"[A-Za-z_][\w./~{}]*", parameter):
                    raise Unreadable(rule)
                section = "/**" if not of else of if of.startswith("/") else f"/{of}"
                done = library.rcl_parse_yaml_value(section.encode(), parameter.encode(), value.encode(), into)
            if not done:
                library.reset_error()
                raise Unreadable(rule)
        found: dict[str, Any] = {}
        for section, values in sections_of_rcl(into.contents):
            pattern = (section if section.startswith("/") else f"/{section}").replace("/*", r"(/\w+)")
            if re.fullmatch(pattern, node):
                found |= values
        return found
