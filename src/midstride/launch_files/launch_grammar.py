"""The grammar of launch files in XML and YAML as ROS's launch has it: its elements, their attributes and types.

launch (3.7, with launch_ros 0.28) reads a whole file before it carries out any of it, and refuses the file for one
attribute that it does not know, also in an element whose condition does not hold. An import goes on, and names what
launch refuses. The rules are those of the `parse` methods of launch's actions and of ``Entity.get_attr``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Final

from midstride.launch_files.entity import Entity, EntityValue
from midstride.launch_files.expression import shortened
from midstride.launch_files.findings import ImportFindings, Tolerated, UnknownValue
from midstride.launch_files.ros_arguments import words_of
from midstride.launch_files.substitutions import SubstitutionCall, Template, check_calls, parse
from midstride.launch_files.values import coerced, plain, type_named, value_of

# How launch reads an attribute. Raises UnknownValue with the reason for which it refuses it.
_Reading = Callable[[Entity, str], None]


@dataclass(frozen=True, slots=True)
class _Element:
    """``parts``: the elements that belong to it; ``has_actions``: others are carried out in it. ``open``: launch does
    not look at what else it has."""

    required: Mapping[str, _Reading] = field(default_factory=dict)
    optional: Mapping[str, _Reading] = field(default_factory=dict)
    parts: Mapping[str, _Element] = field(default_factory=dict)
    has_actions: bool = False
    open: bool = False


def check_grammar(root: Entity, findings: ImportFindings) -> None:
    """Name in ``findings`` each place for which launch refuses the launch file."""
    if root.form == "value" or (root.form == "mapping" and not root.has_children):
        findings.refuse("`launch` has no list of elements", root.span)
    for child in root.children:
        _check_action(child, findings)


def _check_action(entity: Entity, findings: ImportFindings) -> None:
    element = _ACTIONS.get(entity.tag)
    if element is None:
        findings.refuse(f"it has no element `{entity.tag}`", entity.span, left_out=True)
        return
    if entity.tag in _LATER:
        findings.refuse(_LATER[entity.tag], entity.span)
    _check(entity, element, findings)


def _check(entity: Entity, element: _Element, findings: ImportFindings) -> None:
    if entity.form == "value" or (entity.form == "list" and not element.has_actions):
        findings.refuse(f"`{entity.tag}` has no attributes, and wants a mapping", entity.span)
        return
    if element.has_actions and entity.typed and not entity.has_children:
        findings.refuse(f"`{entity.tag}` has no `children`", entity.span)
    _check_attributes(entity, element, findings)
    if "if" in entity.attributes and "unless" in entity.attributes and "if" in element.optional:
        findings.refuse(BOTH_CONDITIONS, entity.span, left_out=True)
    for child in entity.children:
        is_action = child.tag not in element.parts if not entity.typed else not child.listed
        if element.has_actions and is_action:
            if child.tag not in element.parts:  # launch passes over a `keep` among the children in YAML
                _check_action(child, findings)
        elif child.tag in element.parts and child.listed is entity.typed:
            if child.tag == "param":
                _check_parameter(child, findings)
            else:
                _check(child, element.parts[child.tag], findings)
        elif not element.open:
            findings.refuse(f"`{child.tag}` is no part of `{entity.tag}`", child.span, left_out=True)
    if entity.tag == "include":
        for child in entity.named("let"):
            findings.refuse("`let` in `include` is for later versions than 3.7", child.span)
    for name in ("name", "namespace") if entity.tag in {"node_container", "lifecycle_node"} else ():
        if name not in entity.attributes:
            findings.refuse(f"`{entity.tag}` has no `{name}`", entity.span)
    if entity.tag == "load_composable_node" and not any(entity.named("composable_node")):
        findings.refuse("`load_composable_node` has no `composable_node`", entity.span)


def _check_attributes(entity: Entity, element: _Element, findings: ImportFindings) -> None:
    known = {**element.required, **element.optional}
    for name in entity.attributes:
        if name.endswith("-sep") and not entity.typed and name.removesuffix("-sep") in entity.attributes:
            continue  # with the attribute itself
        if name not in known and not element.open:
            findings.refuse(f"`{entity.tag}` has no attribute `{name}`", entity.span, left_out=True)
    for name in element.required:
        if name not in entity.attributes:
            findings.refuse(f"`{entity.tag}` has no `{name}`", entity.span, left_out=True)
    for name, reading in known.items():
        if name in entity.attributes:
            _read(entity, name, reading, findings)


def _read(entity: Entity, name: str, reading: _Reading, findings: ImportFindings) -> None:
    try:
        if f"{name}-sep" in entity.attributes and not entity.typed and reading is not _value:
            raise Tolerated(f"it is no list, and `{name}-sep` would split it")
        reading(entity, name)
    except UnknownValue as error:
        of = f"`{name}` of `{entity.tag}`"
        findings.refuse(str(error), entity.span, left_out=not isinstance(error, Tolerated), of=of)


def _check_parameter(entity: Entity, findings: ImportFindings, nested: bool = False) -> None:
    if entity.form in {"value", "list"}:
        findings.refuse("`param` has no attributes, and wants a mapping", entity.span)
        return
    stated = entity.attributes
    if not nested and "from" in stated:
        if "name" in stated:
            findings.refuse("it has both `name` and `from`", entity.span, left_out=True)
        element = _Element({"from": _text}, {"name": _text, "allow_substs": _allows_substitutions})
        _check(entity, element, findings)
        return
    if not nested and "name" not in stated:
        findings.refuse("`param` has neither `name` nor `from`", entity.span, left_out=True)
        return
    if not nested and "allow_substs" in stated:
        findings.refuse("`allow_substs` is for parameter files", entity.span, left_out=True)
    optional = {"type": _type, "value": _value, **({} if nested else {"allow_substs": _anything})}
    inner = [child for child in entity.named("param") if child.listed is entity.typed]
    _check(entity, _Element({"name": _text}, optional, {"param": _PARAMETER}), findings)
    if inner and "value" in stated:
        findings.refuse("it has both `value` and nested parameters", entity.span, left_out=True)
    if inner and stated.get("type") != "yaml" and "type" in stated:
        findings.refuse("it has both `type` and nested parameters", entity.span)
    if not inner and "value" not in stated:
        findings.refuse("`param` has no `value`", entity.span, left_out=True)


# -- how launch reads attributes ----------------------------------------------------------------------------------


class _NotPerformed(Exception):
    """A value is read as far as it can be without what its substitutions are."""


BOTH_CONDITIONS: Final = "it has both `if` and `unless`, which launch refuses"


def text_of(entity: Entity, name: str) -> str:
    """The text of an attribute, which launch wants to be text. Raises UnknownValue."""
    if name not in entity.attributes:
        raise UnknownValue(f"`{entity.tag}` has no `{name}`", "unsupported")
    value = entity.attributes[name]
    if not isinstance(value, str):
        message = f"`{name}: {plain(value)}` is no text, which launch wants; write it in quotes"
        raise UnknownValue(message, "unsupported")
    return value


def not_from_0(value: object) -> UnknownValue:
    """The error for a value that is left out since it is no time."""
    return UnknownValue(f"`{shortened(str(value))}` is not a number from 0", "unsupported")


def _anything(entity: Entity, name: str) -> None:
    pass


def _plain(entity: Entity, name: str) -> None:
    text_of(entity, name)


def _text(entity: Entity, name: str) -> None:
    check_calls(parse(text_of(entity, name)))


def _words(entity: Entity, name: str) -> None:
    text = text_of(entity, name)
    check_calls(parse(text))
    words_of(text, lambda template: "x")


def _of_type(entity: Entity, name: str, kind: type) -> EntityValue:
    """Of a stated type, or text; in XML, text that can be read as of the type is. Raises UnknownValue."""
    value = entity.attributes[name]
    if entity.typed:
        if not isinstance(value, (str, kind)):
            raise _mistyped(entity, name, kind)
        return value
    try:
        return coerced(str(value), (kind, False), or_text=True)
    except UnknownValue:
        raise _mistyped(entity, name, kind) from None


_NOUNS: Final = {bool: "boolean", float: "floating-point number, as `5.0` is", int: "integer"}


def _mistyped(entity: Entity, name: str, kind: type) -> Tolerated:
    value = shortened(plain(entity.attributes[name]))
    return Tolerated(f"`{value}` is no {_NOUNS[kind]}", "unsupported")


def _boolean(entity: Entity, name: str) -> None:
    _of_type(entity, name, bool)


def _boolean_or_substitution(entity: Entity, name: str) -> None:
    value = _of_type(entity, name, bool)
    if isinstance(value, str) and not _has_calls(value):
        raise _mistyped(entity, name, bool)


def _allows_substitutions(entity: Entity, name: str) -> None:
    if isinstance(_of_type(entity, name, bool), str):
        if _has_calls(str(entity.attributes[name])):
            raise UnknownValue("launch carries out no substitution in `allow_substs`", "unsupported")
        raise _mistyped(entity, name, bool)


def _integer(entity: Entity, name: str) -> None:
    _of_type(entity, name, int)


def _seconds(entity: Entity, name: str) -> None:
    """launch compares it with 0 as it is read, so it carries out no substitution in it."""
    value = entity.attributes[name]
    try:
        meant = float(value) if isinstance(value, (str, int, float)) else -1.0
    except ValueError:
        meant = 0.0 if isinstance(value, str) and _has_calls(value) else -1.0
    if meant < 0:
        raise not_from_0(value)
    if isinstance(_of_type(entity, name, float), str):
        raise _mistyped(entity, name, float)


def _period(entity: Entity, name: str) -> None:
    value = _of_type(entity, name, float)
    if isinstance(value, str) and not _has_calls(value):
        try:
            float(value)
        except ValueError:
            raise _mistyped(entity, name, float) from None


def _number_or_substitution(entity: Entity, name: str) -> None:
    value = _of_type(entity, name, float)
    if isinstance(value, str) and not _has_calls(value):
        raise _mistyped(entity, name, float)


def _shutdown(entity: Entity, name: str) -> None:
    if (text := text_of(entity, name)) != "shutdown":
        raise Tolerated(f"`{shortened(text)}` is not `shutdown`, and nothing else can be done there", "unsupported")


def _type(entity: Entity, name: str) -> None:
    type_named(entity.attributes[name])


def _value(entity: Entity, name: str) -> None:
    def perform(template: Template) -> str:
        check_calls(template)
        raise _NotPerformed

    separator = entity.attributes.get(f"{name}-sep")
    if separator == "" and not entity.typed:
        raise Tolerated(f"`{name}-sep` is empty", "parameters")
    with suppress(_NotPerformed):
        value_of(entity, name, perform)


def _has_calls(text: str) -> bool:
    template = parse(text)
    check_calls(template)
    return any(isinstance(part, SubstitutionCall) for part in template)


# -- the elements ---------------------------------------------------------------------------------------------------


def _texts(names: str) -> dict[str, _Reading]:
    return dict.fromkeys(names.split(), _text)


_CONDITIONS: Final = _texts("if unless")


def _action(required: str = "", optional: str = "", **parts: _Element) -> _Element:
    return _Element(_texts(required), {**_CONDITIONS, **_texts(optional)}, parts)


_PAIR: Final = _Element(_texts("name value"))
_PROCESS: Final[Mapping[str, _Reading]] = {
    **_CONDITIONS,
    **_texts("cwd name launch-prefix output respawn"),
    **dict.fromkeys(("sigterm_timeout", "sigkill_timeout", "respawn_delay"), _seconds),
    **dict.fromkeys(("shell", "emulate_tty"), _boolean),
    "on_exit": _shutdown,
    "respawn_max_retries": _integer,
}
_REMAP: Final = _Element(_texts("from to"))
_PARAMETER: Final = _Element()
_NODE: Final = _Element(
    _texts("exec"),
    {**_PROCESS, **_texts("exec_name pkg namespace"), "args": _words, "ros_args": _words},
    {"env": _PAIR, "remap": _REMAP, "param": _PARAMETER},
)
_COMPOSABLE: Final = _Element(
    _texts("pkg plugin name"),
    {**_CONDITIONS, **_texts("namespace")},
    {"param": _PARAMETER, "remap": _REMAP, "extra_arg": _PAIR},
)
_ACTIONS: Final[Mapping[str, _Element]] = {
    "arg": _Element(
        {"name": _plain},
        {**_CONDITIONS, "default": _text, "description": _plain},
        {"choice": _Element({"value": _plain}, open=True)},
    ),
    "let": _action("name value"),
    "group": _Element({}, {**_CONDITIONS, "scoped": _boolean, "forwarding": _boolean}, {"keep": _PAIR}, True),
    "include": _action("file", arg=_PAIR, let=_PAIR),
    "push-ros-namespace": _action("namespace"),
    "push_ros_namespace": _action("namespace"),
    "set_remap": _action("from to"),
    "set_parameter": _action("name value"),
    "set_parameters_from_file": _action("filename"),
    "set_use_sim_time": _action("value"),
    "set_ros_log_dir": _action("new_log_dir"),
    "set_env": _action("name value"),
    "append_env": _Element(
        _texts("name value"), {**_CONDITIONS, "separator": _text, "prepend": _boolean_or_substitution}
    ),
    "unset_env": _action("name"),
    "reset_env": _action(),
    "reset": _action(keep=_PAIR),
    "timer": _Element({"period": _period}, {**_CONDITIONS, "cancel_on_shutdown": _boolean_or_substitution}, {}, True),
    "ros_timer": _Element({"period": _number_or_substitution}, _CONDITIONS, {}, True),
    "shutdown": _action(optional="reason"),
    "log": _action("message"),
    "node": _NODE,
    "lifecycle_node": _NODE,
    "node_container": _Element(_NODE.required, _NODE.optional, {**_NODE.parts, "composable_node": _COMPOSABLE}),
    "load_composable_node": _action("target", composable_node=_COMPOSABLE),
    "executable": _Element({"cmd": _words}, _PROCESS, {"env": _PAIR}),
}
_LATER: Final = {"lifecycle_node": "up to launch_ros 0.28, it has no element `lifecycle_node`"}
