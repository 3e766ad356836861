"""The attributes of the elements of launch files, with their substitutions carried out."""

from __future__ import annotations

import os
import re
import shlex
from typing import Final

from midstride.launch_files.allowed_files import ReadableFiles
from midstride.launch_files.context import Context
from midstride.launch_files.entity import Entity
from midstride.launch_files.expression import shortened
from midstride.launch_files.findings import ImportFindings, UnknownValue
from midstride.launch_files.launch_grammar import BOTH_CONDITIONS, text_of
from midstride.launch_files.substitutions import substituted, truth, typed_truth
from midstride.launch_files.values import plain

# Of a name that is made here; with a number after it, it is still one of the language.
MAX_NAME: Final = 200
_NAME: Final = re.compile(rf"[A-Za-z_][A-Za-z0-9_]{{0,{MAX_NAME}}}")


class ElementAttributes:
    """Reads attributes; notes in ``findings`` what of them is assumed."""

    def __init__(self, files: ReadableFiles, findings: ImportFindings) -> None:
        self.files = files
        self.findings = findings

    def applies(self, entity: Entity, context: Context) -> bool:
        """Return whether the conditions of the element hold. Raises UnknownValue."""
        if "if" in entity.attributes and "unless" in entity.attributes:
            raise UnknownValue(BOTH_CONDITIONS, "condition")
        for attribute, wanted in (("if", True), ("unless", False)):
            if attribute in entity.attributes:
                try:
                    value = truth(self.text(entity, attribute, context))
                except UnknownValue as error:
                    raise UnknownValue(
                        f"its condition `{attribute}` has no known value: {error}", "condition"
                    ) from None
                if value is not wanted:
                    return False
        return True

    def substituted(self, text: str, context: Context) -> str:
        """``text`` with the values of its substitutions. Raises UnknownValue."""
        return substituted(text, context)

    def text(self, entity: Entity, attribute: str, context: Context) -> str:
        """The value of an attribute, with its substitutions carried out. Raises UnknownValue."""
        return self.substituted(text_of(entity, attribute), context)

    def variable_name(self, entity: Entity, context: Context) -> str:
        """The name of a variable of the environment. Raises UnknownValue."""
        name = self.text(entity, "name", context)
        if not name or "=" in name:
            raise UnknownValue(f"`{shortened(name)}` is not the name of a variable", "refused")
        return name

    def boolean(self, entity: Entity, attribute: str, context: Context, otherwise: bool) -> bool:
        """Raises UnknownValue."""
        value = entity.attributes.get(attribute, otherwise)
        return value if isinstance(value, bool) else typed_truth(self.substituted(plain(value), context))

    def flag(self, entity: Entity, attribute: str, otherwise: bool) -> bool:
        """Return whether an attribute is set in which launch carries out no substitution: any text there sets it.

        In XML, the words of YAML for true and false are no text.
        """
        value = entity.attributes.get(attribute, otherwise)
        try:
            true = value if isinstance(value, bool) else typed_truth(plain(value))
            if true or not isinstance(value, str) or not entity.typed:
                return true
            raise UnknownValue(plain(value))
        except UnknownValue:
            message = (
                f"launch takes any text for true in `{attribute}` of `{entity.tag}`, `{shortened(plain(value))}` too"
            )
            self.findings.add("unsupported", message, entity.span, left_out=False)
            return True

    def path(self, entity: Entity, attribute: str, context: Context) -> str:
        """An absolute path; a relative one is looked for beside the launch file. Raises UnknownValue."""
        text = self.text(entity, attribute, context)
        if not text or "\0" in text:
            raise UnknownValue("this is not a file name", "include")
        folder = os.path.dirname(context.file)
        path = os.path.normpath(os.path.join(folder, text))
        elsewhere = not os.path.isabs(text) and os.path.realpath(folder) != os.path.realpath(os.getcwd())
        if elsewhere and os.path.exists(path):
            message = f"`{text}` is relative to the folder in which launch is started; here, to that of the launch file"
            self.findings.add("include", message, entity.span, left_out=False)
        return path

    def joined(self, base: str | None, more: str | None) -> str | None:
        """``more`` in the namespace ``base``, as an absolute one; None if there is neither. Raises UnknownValue."""
        if more is None:
            return base
        parts = more if more.startswith("/") else f"{(base or '').rstrip('/')}/{more}"
        self.namespace(parts)
        return parts.rstrip("/") or "/"

    def namespace(self, stated: str | None) -> str:
        """Without outer slashes. Raises UnknownValue."""
        found = (stated or "").strip("/")
        if "//" in (stated or "") or (found and not all(_NAME.fullmatch(part) for part in found.split("/"))):
            raise UnknownValue(f"`{stated}` is not a namespace", "name")
        return found


def command_words(text: str) -> list[str]:
    """The words of a command, as a shell splits it. Raises UnknownValue."""
    try:
        return shlex.split(text)
    except ValueError as error:
        raise UnknownValue(f"a command cannot be split into words: {error}", "unsupported") from None
