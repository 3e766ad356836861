"""The manager of the lifecycle nodes of a system: Midstride (`gate lifecycle`), or a lifecycle manager; never both.

Nav2's manager is recognised by its parameters: `node_names` has its nodes, and `autostart` whether it activates them by
itself or `bond_timeout` after how long without a message (s) it takes one for dead, and deactivates all.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
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
    if not isinstance(named, list) or not (AUTOSTART in parameters or BOND_TIMEOUT in parameters):
        return ()
    return tuple(resolved(each, manager) for each in named if isinstance(each, str) and each)


def has_bonds(parameters: Mapping[str, object]) -> bool:
    """Return whether Nav2's manager, with these parameters, watches its nodes by bonds."""
    timeout = bond_timeout(parameters)
    return timeout is None or timeout > 0


def bond_timeout(parameters: Mapping[str, object]) -> float | None:
    """Return after how long Nav2's manager, with these parameters, takes a node for dead (s); None: it is no number."""
    timeout = parameters.get(BOND_TIMEOUT, DEFAULT_BOND_TIMEOUT)
    return timeout if isinstance(timeout, float | int) else None


def broken_bond(node: str, manager: str, timeout: float | None, is_assumed: bool = False) -> str:
    """Say why ``node`` must not end while ``manager`` (both full names) has a bond with it of ``timeout`` (s).

    ``is_assumed``: the bond is that of Nav2's manager, as nothing is stated for this one.
    """
    seconds = "" if timeout is None else f" of {timeout:g} s"
    unless = f"; if it has none, as it is not Nav2's, state `{BOND_TIMEOUT} = 0.0` for it" if is_assumed else ""
    return (
        f"lifecycle manager {manager} has a bond{seconds} with {node}, which another process cannot continue, and "
        f"deactivates all of its nodes when it breaks{unless}"
    )


def why_it_stays(instance: str, reasons: Iterable[str]) -> str:
    """Say that ``instance`` cannot end for ``reasons``, as a lifecycle manager would notice, and what to do."""
    return (
        f"{instance} cannot be replaced or removed: {'; '.join(reasons)}. Let Midstride manage its lifecycle: remove "
        "the manager first, then declare `gate lifecycle preload` (`midstride import` and `midstride capture` do so "
        "with `--lifecycle midstride`)"
    )
