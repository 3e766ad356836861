"""Actions as formulas of the Alloy specification: precondition, whole action, and the reasons for a failure."""

from __future__ import annotations

from collections.abc import Hashable, Mapping
from dataclasses import dataclass
from typing import TypeVar

from midstride.model.action import (
    Action,
    Attach,
    Create,
    Degrade,
    Detach,
    Handover,
    Remove,
    SetParameters,
    Upgrade,
)
from midstride.model.component import FunctionalityRef, PortRef
from midstride.verify.world_encoder import WorldEncoder

_Key = TypeVar("_Key", bound=Hashable)


class NotEncoded(Exception):
    """An action refers to something for which the dump has no atom; the message names it."""


@dataclass(frozen=True, slots=True)
class Formula:
    """An action in a configuration.

    ``whole`` holds between the configurations before and after iff the precondition ``may`` holds before and the effect
    is the action's. ``clauses`` are the parts of the precondition that need no witness, each with its message if it
    fails. ``lacking`` is the set of functionality -> assumption that would no longer be satisfied, ``attached`` that of
    topic -> port that would have to be detached first.
    """

    may: str
    whole: str
    clauses: tuple[tuple[str, str], ...] = ()
    lacking: str = "none -> none"
    attached: str = "none -> none"


def formula(encoder: WorldEncoder, action: Action, before: str, after: str) -> Formula:
    """``action`` from the system ``before`` to the system ``after``. Raises NotEncoded."""
    s, t = before, after
    match action:
        case Create():
            return _create(_component(encoder, action.instance.name), s, t)
        case Remove():
            return _remove(_component(encoder, action.instance), s, t)
        case Attach():
            return _attach(_port(encoder, action.port), _connector(encoder, action.connector), s, t)
        case Detach():
            return _detach(_port(encoder, action.port), _connector(encoder, action.connector), s, t)
        case Degrade():
            return _modes(encoder, action.modes, s, t, "degrade_all")
        case Upgrade():
            return _modes(encoder, action.modes, s, t, "upgrade_all")
        case Handover():
            return _handover(encoder, action, s, t)
        case SetParameters():
            return _set(_component(encoder, action.instance), s, t)
    raise TypeError(f"no formula for {action!r}")


def _create(c: str, s: str, t: str) -> Formula:
    return Formula(
        f"can_create_within[{s}, {c}]",
        f"can_create_within[{s}, {c}] and create[{s}, {t}, {c}]",
        (
            ("it is already live", f"{c} not in {s}.comps"),
            ("a resource would be exceeded", f"capacities_hold[{s}.comps + {c}]"),
        ),
    )


def _remove(c: str, s: str, t: str) -> Formula:
    return Formula(
        f"can_remove[{s}, {c}]",
        f"remove[{s}, {t}, {c}]",
        (("it is not live", f"{c} in {s}.comps"),),
        attached=f"{s}.roles & Connector -> ports[{c}]",
    )


def _attach(p: str, k: str, s: str, t: str) -> Formula:
    return Formula(
        f"can_attach_within[{s}, {k}, {p}]",
        f"can_attach_within[{s}, {k}, {p}] and attach[{s}, {t}, {k}, {p}]",
        (
            ("its component is not live", f"{p} in ports[{s}.comps]"),
            ("it is already attached there", f"{k} -> {p} not in {s}.roles"),
            ("the contracts do not fit", f"fits[{k}, {p}]"),
            ("the cap on publishers would be exceeded", f"cap_holds[{s}, {s}.roles + {k} -> {p}, {k}]"),
        ),
    )


def _detach(p: str, k: str, s: str, t: str) -> Formula:
    roles = f"{s}.roles - {k} -> {p}"
    return Formula(
        f"can_detach[{s}, {k}, {p}]",
        f"detach[{s}, {t}, {k}, {p}]",
        (("it is not attached there", f"{k} -> {p} in {s}.roles"),),
        lacking=_unsatisfied(s, f"{s}.comps.funcs", roles, f"{s}.cur_mode"),
    )


def _modes(encoder: WorldEncoder, modes: Mapping[FunctionalityRef, int], s: str, t: str, name: str) -> Formula:
    pairs = sorted(modes.items())
    to = " + ".join(f"{_functionality(encoder, ref)} -> {_mode(encoder, ref, index)}" for ref, index in pairs)
    to = to or "none -> none"
    fs = " + ".join(_functionality(encoder, ref) for ref, _ in pairs) or "none"
    worse = name == "degrade_all"
    among = f"{s}.comps.funcs" if worse else f"({fs})"
    direction = (
        f"all f: {fs} | ({to})[f] in {s}.cur_mode[f].worse"
        if worse
        else f"all f: {fs} | {s}.cur_mode[f] in ({to})[f].worse"
    )
    return Formula(
        f"can_{name}[{s}, {to}]",
        f"{name}[{s}, {t}, {to}]",
        (
            ("no functionality is named", f"some {fs}"),
            ("a functionality named is not live", f"{fs} in {s}.comps.funcs"),
            (f"a mode named is not {'worse' if worse else 'better'} than the current one", direction),
        ),
        lacking=_unsatisfied(s, among, f"{s}.roles", f"({s}.cur_mode ++ ({to}))"),
    )


def _handover(encoder: WorldEncoder, action: Handover, s: str, t: str) -> Formula:
    swaps = [
        (_connector(encoder, swap.connector), _output(encoder, swap.old), _output(encoder, swap.new))
        for swap in action.swaps
    ]
    # Checked here because the specification cannot express it: a repeated swap is the same tuple, an input is in none.
    outputs = [each for each in swaps if all(port in encoder.atoms.sigs["Output"] for port in each[1:])]
    swap = " + ".join(" -> ".join(each) for each in outputs) or "none -> none -> none"
    new = " and ".join(f"satisfies_now[{s}, {k}, {n}]" for k, _, n in outputs) or "some univ"
    once = "some univ" if len(set(swaps)) == len(swaps) else "some none"
    only = "some univ" if len(outputs) == len(swaps) else "some none"
    return Formula(
        f"{once} and {only} and can_handover_within[{s}, {swap}]",
        f"{once} and {only} and can_handover_within[{s}, {swap}] and handover[{s}, {t}, {swap}]",
        (
            ("no swap is named", "some univ" if swaps else "some none"),
            ("a port occurs twice on one topic", f"{once} and each_once[{swap}]"),
            ("a port is not an output of a live component", f"{only} and ({_ports(outputs)}) in {s}.comps.outputs"),
            ("the old output is not attached", f"leaving[{swap}] in {s}.roles"),
            ("the new output is already attached", f"no coming[{swap}] & {s}.roles"),
            ("the new output does not satisfy the topic in its current mode", new),
            (
                "the cap on publishers would be exceeded",
                f"all k: leaving[{swap}].Output | cap_holds[{s}, {s}.roles + coming[{swap}] - leaving[{swap}], k]",
            ),
        ),
    )


def _ports(swaps: list[tuple[str, str, str]]) -> str:
    return " + ".join(dict.fromkeys(port for _, old, new in swaps for port in (old, new))) or "none"


def _set(c: str, s: str, t: str) -> Formula:
    """The model checks whether a parameter is changeable, since the specification has no parameters."""
    return Formula(
        f"{c} in {s}.comps", f"{c} in {s}.comps and unchanged[{s}, {t}]", (("it is not live", f"{c} in {s}.comps"),)
    )


def _unsatisfied(s: str, among: str, roles: str, mode: str) -> str:
    return f"unsatisfied[{s}, {among}, {roles}, {mode}]"


def _lookup(table: Mapping[_Key, str], key: _Key, kind: str) -> str:
    atom = table.get(key)
    if atom is None:
        raise NotEncoded(f"there is no {kind} {key}")
    return atom


def _component(encoder: WorldEncoder, name: str) -> str:
    return _lookup(encoder.components, name, "component")


def _port(encoder: WorldEncoder, ref: PortRef) -> str:
    return _lookup(encoder.ports, ref, "port")


def _output(encoder: WorldEncoder, ref: PortRef) -> str:
    port = _port(encoder, ref)
    if port not in encoder.atoms.sigs["Output"]:
        raise NotEncoded(f"{ref} is an input, not an output")
    return port


def _connector(encoder: WorldEncoder, name: str) -> str:
    return _lookup(encoder.connectors, name, "topic")


def _functionality(encoder: WorldEncoder, ref: FunctionalityRef) -> str:
    return _lookup(encoder.functionalities, ref, "functionality")


def _mode(encoder: WorldEncoder, ref: FunctionalityRef, index: int) -> str:
    atom = encoder.modes.get((ref, index))
    if atom is None:
        raise NotEncoded(f"{ref} has no mode number {index}")
    return atom
