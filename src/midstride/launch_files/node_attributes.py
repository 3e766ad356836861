"""The attributes of a node's element in a launch file: arguments, parameters, times of its process, its namespace."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from contextlib import suppress
from typing import Any

from midstride.lang.source import Span
from midstride.launch_files.context import Context, ParametersGiven
from midstride.launch_files.element_attributes import command_words
from midstride.launch_files.entity import Entity
from midstride.launch_files.expression import shortened
from midstride.launch_files.findings import UnknownValue
from midstride.launch_files.interpreter import Interpreter
from midstride.launch_files.launch_grammar import not_from_0, text_of
from midstride.launch_files.launched_nodes import LaunchedNode, LaunchedRespawn
from midstride.launch_files.launched_parameters import written_file
from midstride.launch_files.ros_arguments import RosArguments, words_of
from midstride.launch_files.substitutions import performed, substituted, typed_truth
from midstride.launch_files.values import value_of
from midstride.model.component_rules import MAX_NUMBER


class NodeAttributes(Interpreter[Context]):
    """Reads what elements state of processes; what of that is left out is noted in ``findings``."""

    def words(self, entity: Entity, attribute: str, context: Context) -> list[str]:
        """The words of an attribute, as a shell splits them; none where it is not stated, or not known."""
        if attribute not in entity.attributes:
            return []
        try:
            return words_of(text_of(entity, attribute), lambda template: performed(template, context))
        except UnknownValue as error:
            self.findings.leave_out(f"`{attribute}` of a node", error, entity.span)
            return []

    def given_by_arguments(self, ros: RosArguments, span: Span) -> Iterator[ParametersGiven]:
        """The parameters among the arguments of a program."""
        for option, value in ros.parameters:
            if option == "-p":
                yield ParametersGiven(span, rule=value)
            elif os.path.isabs(value):
                yield ParametersGiven(span, path=value)
            else:
                message = f"the parameter file `{value}` is left out: it is relative to the folder of the process"
                self.findings.add("parameters", message, span)

    def prefix(self, entity: Entity, node: LaunchedNode, context: Context) -> list[str]:
        """The words before the program: its own, or those that the variable `launch-prefix` has for all processes."""
        try:
            if "launch-prefix" in entity.attributes:
                return command_words(self.text(entity, "launch-prefix", context))
            text = context.variable("launch-prefix", "")
            applies = re.match(context.variable("launch-prefix-filter", ""), os.path.basename(node.command[0]))
            return command_words(text) if applies else []
        except (UnknownValue, re.error) as error:
            kind = error.kind if isinstance(error, UnknownValue) else "unsupported"
            self.findings.add(kind, f"`launch-prefix` of `{node.role}` is left out: {error}", entity.span)
            return []

    def respawn(self, entity: Entity, context: Context) -> LaunchedRespawn | None:
        """The restarts of the process by launch; None where there are none. Raises UnknownValue."""
        if "respawn" not in entity.attributes or not typed_truth(self.text(entity, "respawn", context)):
            return None
        delay = self._number(entity, "respawn_delay")
        retries = self._number(entity, "respawn_max_retries")
        return LaunchedRespawn(max(delay or 0.0, 0.0), -1 if retries is None else int(retries))

    def stop(self, entity: Entity, context: Context) -> Iterator[str]:
        """The way in which the process is ended: what of `stop` is stated, by the element or for the whole launch."""
        for name in ("sigterm", "sigkill"):
            attribute = f"{name}_timeout"
            stated = entity.attributes.get(attribute, context.variables.get(attribute))
            if attribute in entity.attributes and isinstance(stated, str):
                try:
                    stated = self.substituted(stated, context)
                except UnknownValue as error:
                    self.findings.leave_out(f"`{attribute}` of a node", error, entity.span)
                    continue
            seconds = _seconds(stated)
            if seconds is not None:
                yield f"{name} {seconds:g} s"
            elif attribute in entity.attributes:
                self.findings.leave_out(f"`{attribute}` of a node", not_from_0(stated), entity.span)

    def _number(self, entity: Entity, attribute: str) -> float | None:
        """A number that the node states; launch carries out no substitutions in it."""
        if attribute not in entity.attributes:
            return None
        stated = entity.attributes[attribute]
        try:
            found = float(stated) if isinstance(stated, (int, float, str)) else None
            if found is not None and abs(found) <= 1e9 and (attribute != "respawn_delay" or found >= 0):
                return found
        except ValueError:
            pass
        self.findings.leave_out(f"`{attribute}` of a node", not_from_0(stated), entity.span)
        return None

    def remaps(self, entity: Entity, context: Context) -> Iterator[tuple[str, str]]:
        """The names that the element gives others, each with the new one."""
        for remap in entity.named("remap"):
            try:
                old, new = self.text(remap, "from", context), self.text(remap, "to", context)
                if not new or old in {"__node", "__ns"}:
                    raise UnknownValue(f"launch passes `-r {shortened(old)}:={shortened(new)}`", "unsupported")
                yield old, new
            except UnknownValue as error:
                self.findings.leave_out("a remapping", error, remap.span)

    def settings(self, entity: Entity, section: str, context: Context) -> Iterator[ParametersGiven]:
        """The parameters in an element; launch writes a file with the ``section`` for each value."""
        for parameter in entity.named("param"):
            try:
                if "from" in parameter.attributes:
                    yield self._file(parameter, context)
                elif "allow_substs" in parameter.attributes:
                    raise UnknownValue("`allow_substs` is for parameter files", "unsupported")
                else:
                    text = written_file(section, self._values(parameter, context))
                    yield ParametersGiven(parameter.span, text=text)
            except UnknownValue as error:
                what = parameter.attributes.get("name", parameter.attributes.get("from", ""))
                if error.kind == "include":
                    error.kind = "parameters"
                self.findings.leave_out(f"the parameter or file `{what}`", error, parameter.span)

    def _file(self, entity: Entity, context: Context) -> ParametersGiven:
        if "name" in entity.attributes:
            raise UnknownValue("it has both `name` and `from`", "unsupported")
        path = self.path(entity, "from", context)
        stated = entity.attributes.get("allow_substs", False)
        if isinstance(stated, str) and "$(" in stated:
            raise UnknownValue("launch carries out no substitution in `allow_substs`", "unsupported")
        if not self.boolean(entity, "allow_substs", context, False):
            return ParametersGiven(entity.span, path=path)
        return ParametersGiven(entity.span, path, substituted(self.files.source(path, ".yaml", ".yml").text, context))

    def _values(self, entity: Entity, context: Context) -> dict[str, Any]:
        """The parameters that an element states, as a nested mapping. Raises UnknownValue."""
        name, nested = self.text(entity, "name", context), list(entity.named("param"))
        if nested and "value" in entity.attributes:
            raise UnknownValue("it has both `value` and nested parameters", "unsupported")
        if not nested:
            return {name: value_of(entity, "value", lambda template: performed(template, context))}
        values: dict[str, Any] = {}
        for each in nested:
            values |= self._values(each, context)
        return {name: values}


def _seconds(stated: object) -> float | None:
    """A number from 0 that the language has; None where ``stated`` is none."""
    with suppress(ValueError):
        if isinstance(stated, (int, float, str)) and 0 <= (found := float(stated)) <= MAX_NUMBER:
            return found
    return None
