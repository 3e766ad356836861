"""Parameter values that were set while a component ran, and what a change makes of each (docs/semantics.md section 6).

They travel to the replacement where it declares the parameter. Where the specification changed the same value, the file
wins. Pure: the runtime says which values were set, and does what is decided here.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Annotated, ClassVar, Final, Literal, TypeAlias

from immutables import Map
from msgspec import UNSET, UnsetType, structs

from midstride.codec.form import Form, field
from midstride.codec.parameter import ValueForm, json_value
from midstride.errors import PlanRefused
from midstride.model.component import (
    ROS_PARAMETERS,
    ComponentSpec,
    ParameterValue,
    same_value,
    value_fits,
    value_kind,
)
from midstride.model.specification import Specification
from midstride.plan.change import Change

Values: TypeAlias = Mapping[str, ParameterValue]
Fate: TypeAlias = Literal[
    "kept",
    "file_wins",
    "left_behind",
    "not_kept",
    "late",
    "refused",
    "set",
    "set_back",
    "not_set",
    "not_set_back",
]
Origin: TypeAlias = Literal["set", "unknown", "node"]
_NONE: Final[Mapping[str, Origin]] = Map()
# How a value was set, in words.
SET_BY: Final[Mapping[Origin, str]] = {
    "set": "set at run time",
    "unknown": "set at run time by a ROS tool, or by the node itself",
    "node": "set at run time by the node itself",
}


class RuntimeValue(Form, frozen=True, kw_only=True, omit_defaults=False, forbid_unknown_fields=False):
    """A parameter value that was set while the node ran, and what becomes of it in a change.

    `kept`: the node keeps it. `file_wins`: the specification changed the value as well. `left_behind`: the new
    component does not declare the parameter.
    `not_kept`: the request says to start from the file. `late`: it was set on the old instance when the new one had
    taken over, and the new one refused it. `refused`: the new node, which does not use Midstride's API, refused it.

    Of a change that sets parameters: `set`: the node has the value. `set_back`: the change was rolled back, and the
    node had the value for `seconds`; `not_set_back`: it has it still. `not_set`: it has not accepted it.

    `origin`: `unknown` where a node without Midstride's API has another value than at its start, and that is not known
    to have been set: a ROS tool has set it, or the node itself. `node`: the node itself has, as nothing has asked it to
    set that parameter. `set_at`: when a request has set it, where that was noted.
    """

    what: ClassVar[str] = "a parameter value"

    node: str
    parameter: str
    value: ValueForm
    fate: Fate
    origin: Origin = "set"
    seconds: Annotated[float, field("a number of seconds", "at most so long")] | UnsetType = UNSET
    set_at: (
        Annotated[float, field("a time in Unix seconds", "when a request has set it (Unix time, s)")] | UnsetType
    ) = UNSET
    words: Annotated[str, field("a text", "the same for people")]


def decide(
    before: Specification,
    after: Specification,
    role: str,
    values: Values,
    *,
    keep: bool = True,
    unknown: Mapping[str, Origin] = _NONE,
) -> tuple[RuntimeValue, ...]:
    """Decide about the ``values`` of a role, set while it ran, when its node changes from ``before`` to ``after``.

    Values that the target declares anyway are left out. Without ``keep``, the target's values are used. ``unknown``:
    the parameters of which it is not known that they were set by a request, with what is known of them.
    Raises PlanRefused where a value that would travel is of a type that the new component does not take.
    """
    decided = _decisions(before, after, role, values, keep)
    return tuple(
        runtime_value(role, name, values[name], fate, words, unknown.get(name, "set")) for name, fate, words in decided
    )


def _decisions(
    before: Specification, after: Specification, role: str, values: Values, keep: bool
) -> Iterator[tuple[str, Fate, str]]:
    """Yield the name, the fate and its words of each value that is listed."""
    was, will = before.component_of(role).parameters, after.component_of(role)
    declares = after.instance(role).parameters
    for name, value in sorted(values.items()):
        if name not in declares:
            if not keep:
                yield name, "not_kept", "not kept, as requested"
            elif name in was:
                yield name, "left_behind", _left_behind(will.name)
            elif name in ROS_PARAMETERS:
                yield name, "kept", "kept"
            else:
                yield name, "kept", f"kept if the program of {will.name} declares it"
        elif same_value(declares[name], value):
            continue
        elif not keep:
            yield name, "not_kept", f"not kept, as requested; it becomes {declares[name]!r}"
        elif _file_changed(before, after, role, name):
            yield name, "file_wins", f"the file wins and changes it to {declares[name]!r}"
        elif not value_fits(value, default := _default(will, name, declares[name])):
            raise PlanRefused(
                f"{role} has {name} = {value!r}, set at run time, and {will.name} takes {value_kind(default)}: set "
                "another value, or start from the file with --declared-parameters"
            )
        else:
            yield name, "kept", "kept"


def _default(component: ComponentSpec, name: str, value: ParameterValue) -> ParameterValue:
    """Of ROS, or of a program that declares its parameters itself, the ``value`` of the node."""
    declared = component.parameters.get(name)
    return value if declared is None else declared.value


def _file_changed(before: Specification, after: Specification, role: str, name: str) -> bool:
    """Return whether the specification's own value of a parameter changes.

    That another component has another default is not such a change: it says nothing about the value for this node.
    """
    old, new = before.nodes[role], after.nodes[role]
    if same_value(before.instance(role).parameters.get(name), after.instance(role).parameters[name]):
        return False
    return old.component == new.component or not same_value(old.parameters.get(name), new.parameters.get(name))


def of_change(
    change: Change,
    values: Mapping[str, Values],
    *,
    keep: bool = True,
    unknown: Mapping[str, Mapping[str, Origin]] | None = None,
) -> tuple[RuntimeValue, ...]:
    """Decide about the ``values`` (by role) in a change: those of roles that get a new instance or are set in place.

    ``unknown``: by role, as in :func:`decide`. Raises PlanRefused as that does.
    """
    unsure = unknown or {}
    concerned = {instance.role: values.get(instance.role, {}) for instance in change.coming}
    for instance, parameters in change.parameters:
        role = change.role_of(instance)
        concerned[role] = {name: value for name, value in values.get(role, {}).items() if name in parameters}
    roles = sorted(role for role in concerned if role in change.specification.nodes)
    decided = (
        decide(change.specification, change.target, role, concerned[role], keep=keep, unknown=unsure.get(role, _NONE))
        for role in roles
    )
    return tuple(value for each in decided for value in each)


def time_of(at: float) -> str:
    """A Unix time (s) in local time, as ``2026-11-27 14:03:22``."""
    return time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(at))


def with_times(values: Sequence[RuntimeValue], times: Callable[[str], Mapping[str, float]]) -> tuple[RuntimeValue, ...]:
    """``values`` with when a request has set each (Unix time, s), where that is known: ``times`` of its role say it."""

    def timed(value: RuntimeValue) -> RuntimeValue:
        at = times(value.node).get(value.parameter)
        if at is None or value.set_at is not UNSET or value.origin != "set":
            return value
        return structs.replace(value, set_at=at, words=f"{value.words} (a request has set it at {time_of(at)})")

    return tuple(map(timed, values))


def left_behind(role: str, name: str, value: ParameterValue, component: str, origin: Origin = "set") -> RuntimeValue:
    """The parameter is not declared by the component that replaces the role's."""
    return runtime_value(role, name, value, "left_behind", _left_behind(component), origin)


def _left_behind(component: str) -> str:
    return f"not declared by {component}, left behind"


def setting(
    role: str, name: str, value: ParameterValue, fate: Fate, fate_words: str, seconds: float | UnsetType = UNSET
) -> RuntimeValue:
    """The fate of a value that a change sets."""
    words = f"{role}: {name} = {value!r}: {fate_words}"
    form = json_value(value)
    return RuntimeValue(node=role, parameter=name, value=form, fate=fate, seconds=seconds, words=words)


def runtime_value(
    role: str, name: str, value: ParameterValue, fate: Fate, fate_words: str, origin: Origin = "set"
) -> RuntimeValue:
    """The fate of one value; ``fate_words`` is the same for people."""
    words = f"{role}: {name} = {value!r}, {SET_BY[origin]}: {fate_words}"
    return RuntimeValue(node=role, parameter=name, value=json_value(value), fate=fate, origin=origin, words=words)
