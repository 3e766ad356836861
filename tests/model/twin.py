"""The slow, obvious twin of the model: docs/semantics.md sections 1, 3, 4 and 5, over plain dicts and sets.

It shares nothing with the model but the JSON form, from which it reads. Every question is answered by walking
the whole configuration; sets of field values are compared by trying values out.
"""

from __future__ import annotations

import copy
from collections.abc import Iterator
from dataclasses import dataclass, field
from decimal import Decimal
from itertools import product
from typing import Any

from midstride.codec.component_form import encode_component
from midstride.codec.contract_form import PredicateForm
from midstride.codec.form import encode
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
from midstride.model.component import Connector
from midstride.model.configuration import Configuration
from midstride.model.contract import Contract, Predicate

Document = dict[str, Any]
Port = tuple[str, str]
Functionality = tuple[str, str]


# -- contracts (section 1); nothing is None --------------------------------------------------------------


def of_contract(contract: Contract) -> Document | None:
    return encode(PredicateForm.of(contract)) if isinstance(contract, Predicate) else None


def satisfies(p: Document | None, q: Document | None) -> bool:
    if p is None or q is None:
        return False
    if p["type"] != q["type"]:
        return False
    if "rate" in q and not ("rate" in p and p["rate"] >= q["rate"]):
        return False
    if "within_seconds" in q and not ("within_seconds" in p and p["within_seconds"] <= q["within_seconds"]):
        return False
    if not _strong_enough(p.get("qos", {}), q.get("qos", {})):
        return False
    return all(
        path in p.get("where", {}) and _subset(p["where"][path], needed) for path, needed in q.get("where", {}).items()
    )


_STRENGTH = {
    "reliability": ("reliable", {"best_effort": 0, "reliable": 1}),
    "durability": ("volatile", {"volatile": 0, "transient_local": 1}),
    "liveliness": ("automatic", {"automatic": 0, "manual_by_topic": 1}),
}


def _strong_enough(offered: Document, requested: Document) -> bool:
    for policy, (default, rank) in _STRENGTH.items():
        if rank[offered.get(policy, default)] < rank[requested.get(policy, default)]:
            return False
    never = float("inf")
    return all(
        offered.get(period, never) <= requested.get(period, never) for period in ("deadline_seconds", "lease_seconds")
    )


def _holds(value: Any, constraint: Document) -> bool:
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    for relation, bound in constraint.items():
        if relation == "=":
            if not _same(value, bound):
                return False
        elif relation == "in":
            if not any(_same(value, member) for member in bound):
                return False
        elif not number or not {
            ">=": lambda v, b: v >= b,
            ">": lambda v, b: v > b,
            "<=": lambda v, b: v <= b,
            "<": lambda v, b: v < b,
        }[relation](value, bound):
            return False
    return number or bool(constraint)  # {} is any number


def _same(one: Any, other: Any) -> bool:
    return isinstance(one, bool) == isinstance(other, bool) and bool(one == other)


def _subset(given: Document, needed: Document) -> bool:
    """By trial: beside and between all the values that either speaks of, and far out."""
    values: list[Any] = [False, True, "", 10**9, -(10**9)]
    for constraint in (given, needed):
        for bound in constraint.values():
            values.extend(bound if isinstance(bound, list) else [bound])
    numbers = [value for value in values if not isinstance(value, (bool, str))]
    values.extend(number + step for number in numbers for step in (-0.125, 0.125))
    return all(_holds(value, needed) for value in values if _holds(value, given))


# -- configurations (section 2) --------------------------------------------------------------------------


@dataclass
class State:
    live: dict[str, Document] = field(default_factory=dict)  # instance -> its component's document
    attached: set[tuple[str, str, str]] = field(default_factory=set)  # instance, port, connector
    modes: dict[Functionality, int] = field(default_factory=dict)
    parameters: dict[str, Document] = field(default_factory=dict)
    connectors: dict[str, Document] = field(default_factory=dict)
    environment: list[Document] = field(default_factory=list)
    capacity: dict[str, float] = field(default_factory=dict)

    def functionalities(self) -> Iterator[tuple[Functionality, Document]]:
        for name, component in self.live.items():
            for functionality, body in component["functionalities"].items():
                yield (name, functionality), body

    def mode(self, f: Functionality, index: int | None = None) -> Document:
        modes = list(self.live[f[0]]["functionalities"][f[1]]["modes"].values())
        found: Document = modes[self.modes[f] if index is None else index]
        return found


def of_configuration(s: Configuration) -> State:
    world = s.context
    return State(
        live={name: encode_component(instance.component) for name, instance in s.instances.items()},
        attached={(port.instance, port.port, connector) for port, connector in s.attachments()},
        modes={(ref.instance, ref.functionality): index for ref, index in s.modes.items()},
        parameters={name: dict(instance.parameters) for name, instance in s.instances.items()},
        connectors={
            name: {"guarantee": encode(PredicateForm.of(c.guarantee)), "cap": _cap(c), "topic": c.topic}
            for name, c in world.connectors.items()
        },
        environment=[
            {"guarantee": encode(PredicateForm.of(offer.guarantee)), "topic": offer.topic}
            for offer in world.environment
        ],
        capacity={name: resource.capacity for name, resource in world.resources.items()},
    )


def _cap(connector: Connector) -> int | None:
    """A service or ROS action has at most one server, whatever is stated."""
    _, folder, _ = connector.guarantee.type.split("/")
    return 1 if folder in ("srv", "action") else connector.max_publishers


# -- validity (section 3) --------------------------------------------------------------------------------


def connector_satisfied(s: State, k: str) -> bool:
    needed = s.connectors[k]["guarantee"]
    for f, body in s.functionalities():
        for output in body.get("produces", []):
            guarantee = s.mode(f).get("guarantees", {}).get(output)
            if (f[0], output, k) in s.attached and satisfies(guarantee, needed):
                return True
    topic = s.connectors[k]["topic"]
    return any(e["topic"] == topic and satisfies(e["guarantee"], needed) for e in s.environment)


def input_satisfied(s: State, i: Port) -> bool:
    assumption = s.live[i[0]]["inputs"][i[1]]
    return any(
        (*i, k) in s.attached and connector_satisfied(s, k) and satisfies(s.connectors[k]["guarantee"], assumption)
        for k in s.connectors
    )


def assumption_satisfied(s: State, f: Functionality, a: str | Document) -> bool:
    if isinstance(a, str):
        return input_satisfied(s, (f[0], a))
    if "any_of" in a:
        return any(input_satisfied(s, (f[0], name)) for name in a["any_of"])
    component = s.live[f[0]]
    for name in component["functionalities"][f[1]].get("uses", []):
        if input_satisfied(s, (f[0], name)) and satisfies(component["inputs"][name], a):
            return True
    return any(e["topic"] is None and satisfies(e["guarantee"], a) for e in s.environment)


def satisfied(s: State, f: Functionality) -> bool:
    return all(assumption_satisfied(s, f, a) for a in s.mode(f).get("assumes", []))


def ports_of(component: Document) -> set[str]:
    return {*component.get("inputs", {}), *component.get("outputs", [])}


def caps_hold(s: State) -> bool:
    for name, connector in s.connectors.items():
        publishers = [a for a in s.attached if a[2] == name and a[1] in s.live[a[0]].get("outputs", [])]
        outside = [e for e in s.environment if e["topic"] == connector["topic"]]
        if connector["cap"] is not None and len(publishers) + len(outside) > connector["cap"]:
            return False
    return True


def capacities_hold(s: State) -> bool:
    held: dict[str, Decimal] = {}
    for component in s.live.values():
        for resource, amount in component.get("holds", {}).items():
            held[resource] = held.get(resource, Decimal(0)) + Decimal(str(amount))
    return all(amount <= Decimal(str(s.capacity.get(resource, 1))) for resource, amount in held.items())


def valid(s: State) -> bool:
    everybody_satisfied = all(satisfied(s, f) for f, _ in s.functionalities())
    only_ports_of_live = all(c in s.live and p in ports_of(s.live[c]) for c, p, _ in s.attached)
    return everybody_satisfied and only_ports_of_live and caps_hold(s) and capacities_hold(s)


# -- actions (section 4) ---------------------------------------------------------------------------------


def allowed(s: State, action: Action) -> bool:
    """Whether the precondition holds, by carrying the action out and looking at everything."""
    if isinstance(action, Create):
        return action.instance.name not in s.live and capacities_hold(effect(s, action))
    if isinstance(action, Remove):
        return action.instance in s.live and not any(c == action.instance for c, _, _ in s.attached)
    if isinstance(action, (Attach, Detach)):
        (c, p), k = action.port, action.connector
        if c not in s.live or p not in ports_of(s.live[c]) or k not in s.connectors:
            return False
        if isinstance(action, Detach):
            return (c, p, k) in s.attached and everybody(effect(s, action))
        if (c, p, k) in s.attached:
            return False
        if p in s.live[c].get("inputs", {}):
            return satisfies(s.connectors[k]["guarantee"], s.live[c]["inputs"][p])
        return satisfies(guaranteed(s, (c, p), 0), s.connectors[k]["guarantee"]) and caps_hold(effect(s, action))
    if isinstance(action, (Degrade, Upgrade)):
        if not action.modes:
            return False
        for (c, f), index in action.modes.items():
            if c not in s.live or f not in s.live[c]["functionalities"]:
                return False
            if not 0 <= index < len(s.live[c]["functionalities"][f]["modes"]):
                return False
            if not (index > s.modes[c, f] if isinstance(action, Degrade) else index < s.modes[c, f]):
                return False
        after = effect(s, action)
        if isinstance(action, Degrade):
            return everybody(after)  # those outside, and each of F in its new mode
        return all(satisfied(after, (c, f)) for c, f in action.modes)
    if isinstance(action, Handover):
        return bool(action.swaps) and _handover_allowed(s, action)
    assert isinstance(action, SetParameters)
    if action.instance not in s.live:
        return False
    if action.before is not None:
        return True
    declared = s.live[action.instance].get("parameters", {})
    for name, value in action.parameters.items():
        if name not in declared or not declared[name].get("changeable"):
            return False
        like = declared[name]["value"]
        if type(value) is not type(like) and not (type(value) is int and type(like) is float):
            return False
    return True


def _handover_allowed(s: State, action: Handover) -> bool:
    seen: list[tuple[str, str, str]] = []
    for swap in action.swaps:
        for c, p in (swap.old, swap.new):
            if c not in s.live or p not in s.live[c].get("outputs", []):
                return False
            seen.append((c, p, swap.connector))
        if swap.connector not in s.connectors:
            return False
        if (*swap.old, swap.connector) not in s.attached or (*swap.new, swap.connector) in s.attached:
            return False
        if not satisfies(guaranteed(s, swap.new), s.connectors[swap.connector]["guarantee"]):
            return False
    return len(set(seen)) == len(seen) and caps_hold(effect(s, action))


def everybody(s: State) -> bool:
    return all(satisfied(s, f) for f, _ in s.functionalities())


def guaranteed(s: State, output: Port, index: int | None = None) -> Document | None:
    for f, body in s.functionalities():
        if f[0] == output[0] and output[1] in body.get("produces", []):
            found: Document | None = s.mode(f, index).get("guarantees", {}).get(output[1])
            return found
    raise AssertionError(f"nobody owns {output}")


def effect(s: State, action: Action) -> State:
    after = State(
        dict(s.live),
        set(s.attached),
        dict(s.modes),
        copy.deepcopy(s.parameters),
        s.connectors,
        s.environment,
        s.capacity,
    )
    if isinstance(action, Create):
        name = action.instance.name
        after.live[name] = encode_component(action.instance.component)
        after.parameters[name] = dict(action.instance.parameters)
        for functionality, body in after.live[name]["functionalities"].items():
            after.modes[name, functionality] = len(body["modes"]) - 1
    elif isinstance(action, Remove):
        del after.live[action.instance], after.parameters[action.instance]
        after.modes = {f: index for f, index in s.modes.items() if f[0] != action.instance}
    elif isinstance(action, Attach):
        after.attached.add((*action.port, action.connector))
    elif isinstance(action, Detach):
        after.attached.remove((*action.port, action.connector))
    elif isinstance(action, (Degrade, Upgrade)):
        after.modes.update({(ref.instance, ref.functionality): index for ref, index in action.modes.items()})
    elif isinstance(action, Handover):
        after.attached -= {(*swap.old, swap.connector) for swap in action.swaps}
        after.attached |= {(*swap.new, swap.connector) for swap in action.swaps}
    elif isinstance(action, SetParameters) and action.before is None:
        after.parameters[action.instance].update(action.parameters)
    return after


# -- best (section 5) ------------------------------------------------------------------------------------


def with_modes(s: State, modes: dict[Functionality, int]) -> State:
    return State(s.live, s.attached, modes, s.parameters, s.connectors, s.environment, s.capacity)


def best(s: State) -> dict[Functionality, int]:
    """The greatest fixed point as F2 says it: all at their best, lower one that is unsatisfied, until none is."""
    modes = dict.fromkeys((f for f, _ in s.functionalities()), 0)
    while True:
        unsatisfied = [f for f in modes if not satisfied(with_modes(s, modes), f)]
        if not unsatisfied:
            return modes
        modes[unsatisfied[0]] += 1


def valid_assignments(s: State) -> list[dict[Functionality, int]]:
    """Every assignment of modes in which everybody is satisfied, by trying them all."""
    names = [f for f, _ in s.functionalities()]
    ranges = [range(len(body["modes"])) for _, body in s.functionalities()]
    candidates = (dict(zip(names, indices, strict=True)) for indices in product(*ranges))
    return [modes for modes in candidates if everybody(with_modes(s, modes))]
