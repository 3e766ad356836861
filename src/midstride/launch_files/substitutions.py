"""Substitutions such as ``$(var name)`` in the text of a launch file: their grammar, and their values.

The grammar is that of ``launch/frontend/grammar.lark`` of ROS 2. A launch file may be a stranger's: so ``command``,
which runs a program, is carried out only if the user says so, and ``file-content`` reads only files that an import may
read.
"""

from __future__ import annotations

import math
import re
import shlex
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final, TypeAlias

from midstride.launch_files.context import Context
from midstride.launch_files.expression import evaluate, shortened
from midstride.launch_files.findings import Tolerated, UnknownValue
from midstride.launch_files.own_session import run_command

MAX_NESTING: Final = 32
# The words of PyYAML, and those that launch adds.
_YAML_TRUE: Final = frozenset("1 true True TRUE yes Yes YES on On ON".split())
_YAML_FALSE: Final = frozenset("0 false False FALSE no No NO off Off OFF".split())
_NAME: Final = re.compile(r"[A-Za-z][A-Za-z0-9_-]*")
_ESCAPE: Final = re.compile(r"\\(.)")
# What text within the parentheses of a substitution may consist of, by the quotes around it.
_TEXT: Final = {
    "": re.compile(r"""(?:\\["'()$\\]|\\|[^ '"\\$()]|\$(?!\())+"""),
    "'": re.compile(r"""(?:\\['()$\\]|\\|[^ '\\$()]|\$(?!\())+"""),
    '"': re.compile(r"""(?:\\["()$\\]|\\|[^ "\\$()]|\$(?!\())+"""),
}
# The same where a quoted value is all of an argument.
_QUOTED: Final = {
    "'": re.compile(r"(?:\\['$\\]|\\|[^'\\$]|\$(?!\())+"),
    '"': re.compile(r'(?:\\["$\\]|\\|[^"\\$]|\$(?!\())+'),
}
_OUTSIDE: Final = re.compile(r"(?:\\\$|[^$]|\$(?!\())+")

Template: TypeAlias = "tuple[str | SubstitutionCall, ...]"


@dataclass(frozen=True, slots=True)
class SubstitutionCall:
    """A substitution with its arguments; ``text`` is how it is written."""

    name: str
    arguments: tuple[Template, ...]
    text: str


def substituted(text: str, context: Context) -> str:
    """``text`` with the values of its substitutions. Raises UnknownValue."""
    return performed(parse(text), context)


def parse(text: str) -> Template:
    """Raises UnknownValue for what is not of the grammar."""
    return _Parser(text).template() if text else ()


class _Parser:
    def __init__(self, text: str) -> None:
        self.text = text
        self.at = 0
        self.depth = 0

    def template(self) -> Template:
        parts = self._parts(_OUTSIDE, "")
        if self.at < len(self.text):
            raise self._invalid()
        return parts

    def _parts(self, pattern: re.Pattern[str], quote: str) -> Template:
        """Text that matches ``pattern``, and substitutions."""
        parts: list[str | SubstitutionCall] = []
        while self.at < len(self.text):
            if self.text.startswith("$(", self.at):
                parts.append(self._call(quote))
            elif match := pattern.match(self.text, self.at):
                parts.append(_ESCAPE.sub(r"\1", match[0]))
                self.at = match.end()
            else:
                break
        return tuple(parts)

    def _call(self, quote: str) -> SubstitutionCall:
        start = self.at
        self.depth += 1
        match = _NAME.match(self.text, start + 2)
        if match is None or self.depth > MAX_NESTING:
            raise self._invalid()
        self.at = match.end()
        arguments = []
        while self.at < len(self.text) and self.text[self.at] == " ":
            self.at += 1
            arguments.append(self._argument(quote))
        self._take(")")
        self.depth -= 1
        return SubstitutionCall(match[0], tuple(arguments), self.text[start : self.at])

    def _argument(self, quote: str) -> Template:
        opened = self.text[self.at : self.at + 1]
        if not quote and opened in _QUOTED:
            self.at += 1
            parts = self._parts(_QUOTED[opened], opened)
            self._take(opened)
            return parts or ("",)
        parts = self._parts(_TEXT[quote], quote)
        if not parts:
            raise self._invalid()
        return parts

    def _take(self, character: str) -> None:
        if not self.text.startswith(character, self.at):
            raise self._invalid()
        self.at += 1

    def _invalid(self) -> UnknownValue:
        return UnknownValue(f"`{shortened(self.text)}` is not a valid substitution")


def performed(template: Template, context: Context) -> str:
    """The text of a template, with the values of its substitutions. Raises UnknownValue."""
    return "".join(part if isinstance(part, str) else _call(part, context) for part in template)


def _call(call: SubstitutionCall, context: Context) -> str:
    if call.name == "if" and 2 <= len(call.arguments) <= 3:  # only the branch that is chosen needs a value
        condition = typed_truth(performed(call.arguments[0], context))
        chosen = call.arguments[1:2] if condition else call.arguments[2:]
        return "".join(performed(argument, context) for argument in chosen)
    # Launch takes an empty text in quotes for an empty list, and compares with how Python writes that.
    empty = "[]" if call.name in {"equals", "not-equals"} else ""
    values = [empty if argument == ("",) else performed(argument, context) for argument in call.arguments]
    function = _FUNCTIONS.get(call.name)
    if function is None and call.name not in _ONLY_IN_LAUNCH:
        raise _unknown(call)
    if function is None:
        raise UnknownValue(f"`{shortened(call.text)}`: the substitution `{call.name}` is not carried out here")
    low, high, perform = function
    if not low <= len(values) <= high:
        raise _miscounted(call)
    return perform(context, values)


def _unknown(call: SubstitutionCall) -> UnknownValue:
    return UnknownValue(f"`{shortened(call.text)}`: there is no substitution `{call.name}`")


def _miscounted(call: SubstitutionCall) -> UnknownValue:
    return UnknownValue(f"`{shortened(call.text)}`: wrong number of arguments")


def check_calls(template: Template) -> None:
    """Raise UnknownValue for the first substitution that launch has not, or not with so many arguments."""
    for call in (part for part in template if isinstance(part, SubstitutionCall)):
        for argument in call.arguments:
            check_calls(argument)
        if call.name in _NOT_IN_LAUNCH:
            raise Tolerated(f"`{shortened(call.text)}`: {_NOT_IN_LAUNCH[call.name]}")
        count = _ONLY_IN_LAUNCH.get(call.name)
        if count is None and call.name not in _FUNCTIONS:
            raise _unknown(call)
        low, high = _FUNCTIONS[call.name][:2] if count is None else count
        if not low <= len(call.arguments) <= high:
            raise _miscounted(call)


def truth(text: str) -> bool:
    """Return whether ``text`` is true, as launch reads conditions. Raises UnknownValue if it is neither true nor
    false.
    """
    word = text.strip().lower()
    if word in {"true", "1"}:
        return True
    if word in {"false", "0"}:
        return False
    raise UnknownValue(f"`{shortened(text)}` is neither true nor false", "condition")


def typed_truth(text: str) -> bool:
    """Return whether ``text`` is true where launch wants a boolean of YAML. Raises UnknownValue."""
    if text in _YAML_TRUE or text in _YAML_FALSE:
        return text in _YAML_TRUE
    raise UnknownValue(f"`{shortened(text)}` is neither true nor false", "condition")


def _word(value: bool) -> str:
    return str(value).lower()


def _equal(left: str, right: str) -> bool:
    words = {"true", "false", "1", "0"}
    if left.lower() in words and right.lower() in words:
        return truth(left) == truth(right)
    try:
        return math.isclose(float(left), float(right))
    except ValueError:
        return left == right


def _environment(context: Context, values: Sequence[str]) -> str:
    value = context.environment.get(values[0], values[1] if len(values) > 1 else None)
    if value is None:
        raise UnknownValue(f"the environment variable `{values[0]}` is not set")
    return value


def _command(context: Context, values: Sequence[str]) -> str:
    """The output of a program, as ``launch.substitutions.Command`` has it."""
    on_errors = values[1] if len(values) > 1 else "fail"
    if context.run_commands and on_errors not in {"fail", "ignore", "warn", "capture"}:
        shown = shortened(values[0])
        raise UnknownValue(f"`{shortened(on_errors)}` is not a way to treat what `{shown}` writes to its errors")
    output, errors = command_output(values[0], context, "`$(command …)`", on_errors == "fail")
    return output + (errors if on_errors == "capture" else "")


def command_output(text: str, context: Context, what: str, no_errors: bool) -> tuple[str, str]:
    """The output and the errors of a command that ``what`` states. Raises UnknownValue.

    ``no_errors``: it fails also by writing to its errors.
    """
    shown = shortened(text)
    if not context.run_commands:
        raise UnknownValue(f"{what} runs a program, `{shown}`; `--run-commands` carries it out", "command")
    try:
        words = shlex.split(text)
        done = run_command(words, context.environment) if words else None
    except (OSError, ValueError, TimeoutError) as error:
        raise UnknownValue(f"`{shown}` has failed: {error}", "command") from None
    if done is None:
        raise UnknownValue(f"{what} has no command")
    status, output, errors = done
    if status != 0 or (errors and no_errors):
        said = (errors.strip().splitlines() or [f"exit status {status}"])[-1]
        what = f"exit status {status}: {said}" if status else f"it has written to its errors: {said}"
        raise UnknownValue(f"`{shown}` has failed: {shortened(what)}", "command")
    return output, errors


def _found_executable(context: Context, values: Sequence[str]) -> str:
    path = shutil.which(values[0], path=context.environment.get("PATH", ""))
    if path is None:
        raise UnknownValue(f"there is no executable `{values[0]}` in the PATH")
    return path


_Function: TypeAlias = Callable[[Context, Sequence[str]], str]
_MANY: Final = 64
# The least and the largest number of arguments, and the value. What ROS looks up elsewhere is not here.
_FUNCTIONS: Final[dict[str, tuple[int, int, _Function]]] = {
    "var": (1, 2, lambda context, values: context.variable(*values)),
    "env": (1, 2, _environment),
    "optenv": (1, 2, lambda context, values: context.environment.get(values[0], "".join(values[1:]))),
    "dirname": (0, 0, lambda context, values: context.current_folder()),
    "filename": (0, 0, lambda context, values: context.current_file()),
    "find-pkg-share": (1, 1, lambda context, values: context.packages.share(values[0])),
    "find-pkg-prefix": (1, 1, lambda context, values: context.packages.prefix(values[0])),
    "param": (1, 1, lambda context, values: context.global_parameter(values[0])),
    "exec-in-pkg": (2, 2, lambda context, values: context.packages.executable(values[1], values[0])),
    "find-exec": (1, 1, _found_executable),
    "file-content": (1, 1, lambda context, values: context.read(values[0])),
    "command": (1, 2, _command),
    "eval": (1, 1, lambda context, values: evaluate(values[0])),
    "equals": (2, 2, lambda context, values: _word(_equal(*values))),
    "not-equals": (2, 2, lambda context, values: _word(not _equal(*values))),
    "not": (1, 1, lambda context, values: _word(not typed_truth(values[0]))),
    "and": (2, 2, lambda context, values: _word(all(map(typed_truth, values)))),
    "or": (2, 2, lambda context, values: _word(any(map(typed_truth, values)))),
    "all": (1, _MANY, lambda context, values: _word(all(map(typed_truth, values)))),
    "any": (1, _MANY, lambda context, values: _word(any(map(typed_truth, values)))),
}
# How many arguments launch takes where that differs, and for what is not carried out here.
_ONLY_IN_LAUNCH: Final = {
    "if": (2, 3),
    "eval": (1, 2),
    "param": (1, 2),
    "anon": (1, 1),
    "log_dir": (0, 0),
    "launch_log_dir": (0, 0),
}
# What launch 3.7 does not carry out.
_NOT_IN_LAUNCH: Final = {
    "optenv": "launch has no substitution `optenv`; write `$(env NAME DEFAULT)`",
    **dict.fromkeys(("any", "all"), "launch carries it out after 3.7 only"),
}
