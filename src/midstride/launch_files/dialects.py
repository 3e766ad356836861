"""The two dialects of launch files: that of ROS 2's `launch`, and that of ROS 1's `roslaunch`."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Final, Literal, NamedTuple, TypeAlias

from midstride.launch_files.entity import Entity
from midstride.launch_files.findings import UnknownValue

Ros: TypeAlias = Literal[1, 2]

# Elements of a launch file, or of a group, that only one of the two has.
_ELEMENTS: Final[dict[str, Ros]] = {
    **dict.fromkeys("machine param remap rosparam test".split(), 1),
    **dict.fromkeys(
        """append_env composable_node executable let lifecycle_node load_composable_node node_container
        push-ros-namespace push_ros_namespace reset reset_env ros_timer set_env set_parameter set_parameters_from_file
        set_remap set_use_sim_time timer unset_env""".split(),
        2,
    ),
}
# What the other dialect refuses or passes over in an element: it decides where no element does.
_ATTRIBUTES: Final[dict[str, frozenset[str]]] = {
    "arg": frozenset({"value", "doc"}),
    "group": frozenset({"ns", "clear_params"}),
    "include": frozenset({"ns", "clear_params", "pass_all_args"}),
}
_SUBSTITUTIONS: Final[dict[Ros, re.Pattern[str]]] = {
    1: re.compile(r"\$\(\s*(?:arg|find)\s"),
    2: re.compile(r"\$\((?:var|find-pkg-share|find-pkg-prefix|exec-in-pkg|find-exec|file-content)\s"),
}


class _Mark(NamedTuple):
    """Something that only one dialect has; one that is not ``certain`` may be a mistake in the other."""

    ros: Ros
    what: str
    entity: Entity
    certain: bool

    @property
    def place(self) -> str:
        return f"{self.what} in line {self.entity.span.source.position(self.entity.span.start)[0]}"


def dialect_of(root: Entity) -> Ros:
    """The dialect of a launch file; that of ROS 2 where nothing shows it. Raises UnknownValue where it mixes both."""
    found = _decisive(root)
    if len(found) == 2 and found[1].certain:
        message = f"it mixes ROS 1 ({found[1].place}) and ROS 2 ({found[2].place}); `--ros 1` or `--ros 2` chooses"
        raise UnknownValue(message, "include")
    return 1 if list(found) == [1] else 2


def require_dialect(root: Entity, ros: Ros) -> None:
    """Raise UnknownValue for a launch file that is of the other dialect only."""
    found = _decisive(root)
    if found and ros not in found:
        other = 3 - ros
        message = f"it is a launch file of ROS {other}; with `--ros {other}`, all of them are read as such"
        raise UnknownValue(message, "include")


def _decisive(root: Entity) -> dict[Ros, _Mark]:
    """The first mark of each dialect; of those that are certain, if there are any."""
    marks = list(_marks(root.children))
    certain = [mark for mark in marks if mark.certain]
    return {mark.ros: mark for mark in reversed(certain or marks)}


def _marks(entities: list[Entity]) -> Iterator[_Mark]:
    for entity in entities:
        if entity.tag in _ELEMENTS:
            yield _Mark(_ELEMENTS[entity.tag], f"`{entity.tag}`", entity, True)
        if entity.tag == "node" and ("exec" in entity.attributes or "type" in entity.attributes):
            word = "exec" if "exec" in entity.attributes else "type"
            yield _Mark(2 if word == "exec" else 1, f"`{word}` of `node`", entity, True)
        for name in _ATTRIBUTES.get(entity.tag, ()):
            if name in entity.attributes:
                yield _Mark(1, f"`{name}` of `{entity.tag}`", entity, False)
        yield from _of_substitutions(entity)
        if entity.tag == "group":
            yield from _marks(entity.children)


def _of_substitutions(entity: Entity) -> Iterator[_Mark]:
    """The marks in the attributes of an element that is no group, and of what is in it."""
    for value in entity.attributes.values():
        for ros, pattern in _SUBSTITUTIONS.items():
            if isinstance(value, str) and (match := pattern.search(value)):
                yield _Mark(ros, f"`{match[0].strip()} …)`", entity, False)
    if entity.tag != "group":
        for child in entity.children:
            yield from _of_substitutions(child)
