"""What manages the lifecycle nodes of a system: Midstride (`gate lifecycle`), or a lifecycle manager; never both.

Nav2's manager is recognised by its parameters: `node_names` has its nodes, `autostart` whether it activates them by
itself, and `bond_timeout` after how long without a message (s) it takes one for dead, and deactivates all.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, Literal, TypeAlias

from midstride.model.graph_names import resolved

# What is asked for: that the lifecycle manager that there is goes on, or that Midstride takes its place.
Management: TypeAlias = Literal["manager", "midstride"]
MANAGEMENTS: Final[tuple[Management, ...]] = ("manager", "midstride")

NODE_NAMES: Final = "node_names"
AUTOSTART: Final = "autostart"
BOND_TIMEOUT: Final = "bond_timeout"
# What Nav2's manager has for it where none is stated (s); it has no bonds where that is 0.
DEFAULT_BOND_TIMEOUT: Final = 4.0


def managed_nodes(manager: str, parameters: Mapping[str, object]) -> tuple[str, ...]:
    """Return the full names of the nodes that ``manager`` (a full name) manages, as Nav2's does; none if it is none."""
    named = parameters.get(NODE_NAMES)
    if not isinstance(named, list) or AUTOSTART not in parameters:
        return ()
    return tuple(resolved(each, manager) for each in named if isinstance(each, str) and each)


def has_bonds(parameters: Mapping[str, object]) -> bool:
    """Return whether Nav2's manager, with these parameters, watches its nodes by bonds."""
    timeout = parameters.get(BOND_TIMEOUT, DEFAULT_BOND_TIMEOUT)
    return not isinstance(timeout, float | int) or timeout > 0
